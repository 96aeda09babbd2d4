"""The detector of vehicles, as a stage: what it takes for one, and what not."""

from __future__ import annotations

import numpy as np
from vehicle_runs import START_NS, replayed, road

from groundtrace.pipeline.conformance import check_stage
from groundtrace.pipeline.gates import Candidates, GateState
from groundtrace.simulate.road import VehicleOptions
from groundtrace.vehicles.presence import Persistence, PresenceParameters, VehiclePresence
from groundtrace_codecs.events import CandidateBlock, Presence

ANTENNAS = VehicleOptions()
WALKED = VehicleOptions(layout="stations", passes=1, duration_s=120, walkers=1, impacts=10, seed=2)


def test_the_detector_conforms() -> None:
    _, blocks = road(ANTENNAS)
    found = check_stage(VehiclePresence, [b.slice(0, len(b)) for b in blocks][:4])
    assert len(found.trace_times)


def test_a_car_is_heard_from_before_it_passes_until_after() -> None:
    events = replayed(ANTENNAS, "vehicle-tracks")
    spans = [e for e in events if isinstance(e, Presence)]
    assert {e.channel for e in spans} == {"A1", "A2", "A3", "B1", "B2", "B3"}
    for span in spans:
        start_s, end_s = (span.time_ns - START_NS) / 1e9, (span.end_ns - START_NS) / 1e9
        assert start_s < 14 if span.channel[0] == "A" else start_s < 16
        assert end_s > 17
        assert span.value > 10


def test_footsteps_and_impacts_are_no_vehicle_and_a_gate_says_why() -> None:
    simulation, _ = road(WALKED)
    near = np.array([x.time_ns for x in simulation.labels if x.kind == "waypoint"])
    away: list[tuple[bool, int]] = []
    for block in replayed(WALKED, "vehicle-passes", stages=1):
        if isinstance(block, CandidateBlock) and block.spec.stage == "presence":
            gates = [g.name for g in block.spec.gates]
            loud = block.value[:, 0] > 8
            for row in np.flatnonzero(loud):
                if np.abs(near - block.time_ns[row]).min() > 8e9:
                    failed = np.flatnonzero(~(block.margin[row] >= 0))
                    away.append((bool(block.accepted[row]), int(failed[0]) if len(failed) else -1))
    assert len(away) > 10
    assert sum(accepted for accepted, _ in away) == 0
    impulsive = sum(first == gates.index("impulsiveness") for _, first in away)
    assert impulsive > 0.6 * len(away)


def candidates(times_s: list[float]) -> Candidates:
    times = (np.array(times_s) * 1e9).astype(np.int64)
    return Candidates(times, np.zeros(len(times), np.int32), np.zeros((len(times), 1), np.float32))


def test_what_lasts_is_counted_over_a_single_failure_and_over_blocks() -> None:
    alive = np.array([True, True, False, True, False, False, False, True])
    times = [0.5 * k for k in range(8)]
    whole = Persistence().values(candidates(times), (), alive, 1.0, GateState())
    assert whole.tolist() == [0, 0.5, 0, 1.5, 0, 0, 0, 0]
    carry, parts = GateState(), []
    for a, b in ((0, 3), (3, 4), (4, 8)):
        parts += Persistence().values(candidates(times[a:b]), (), alive[a:b], 1.0, carry).tolist()
    assert parts == whole.tolist()


def test_a_clock_that_was_set_back_starts_anew() -> None:
    carry = GateState()
    Persistence().values(candidates([10.0, 10.5]), (), np.ones(2, np.bool_), 1.0, carry)
    found = Persistence().values(candidates([2.0, 2.5]), (), np.ones(2, np.bool_), 1.0, carry)
    assert found.tolist() == [0, 0.5]


def test_all_thresholds_are_gates() -> None:
    named = {g.parameter for g in VehiclePresence.gates}
    assert named <= set(PresenceParameters.__dataclass_fields__)
    assert [g.name for g in VehiclePresence.gates][-1] == "lasting"
