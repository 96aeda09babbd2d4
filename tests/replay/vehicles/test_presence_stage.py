"""The detector of vehicles, as a stage: what it takes for one, and what not."""

from __future__ import annotations

import numpy as np
from vehicle_runs import START_NS, replayed, road

from groundtrace.pipeline.conformance import check_stage
from groundtrace.simulate.road import VehicleOptions
from groundtrace.vehicles.presence import PresenceParameters, VehiclePresence
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


def test_footsteps_and_impacts_are_seldom_a_vehicle() -> None:
    simulation, _ = road(WALKED)
    near = np.array([x.time_ns for x in simulation.labels if x.kind == "waypoint"])
    blows = [x.time_ns for x in simulation.labels if x.kind in ("step", "impact")]
    struck = [t for t in blows if np.abs(near - t).min() > 8e9]
    assert len(struck) > 10
    heard = 0
    for block in replayed(WALKED, "vehicle-passes", stages=1):
        if isinstance(block, CandidateBlock):
            times = block.time_ns[block.accepted]
            heard += sum(bool((np.abs(times - t) < 0.3e9).any()) for t in struck)
    assert heard < 0.25 * len(struck)


def test_all_thresholds_are_gates() -> None:
    named = {g.parameter for g in VehiclePresence.gates}
    assert named <= set(PresenceParameters.__dataclass_fields__)
