"""The walk: what the waist feels agrees with the steps that were planned."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pytest

from groundtrace.errors import SimulationError
from groundtrace.simulate.gait import WalkOptions
from groundtrace.simulate.walk import simulate_walk

if TYPE_CHECKING:
    from groundtrace.simulate.recording import Simulation


def values_of(simulation: Simulation, source: int = 0) -> np.ndarray:
    return np.concatenate([block.values for block in simulation.sources[source][2]])


def of_kind(simulation: Simulation, kind: str) -> list:
    return [label for label in simulation.labels if label.kind == kind]


def start_ns_of(simulation: Simulation) -> int:
    return next(iter(simulation.sources[0][2])).start_ns


@pytest.fixture(scope="module")
def walk() -> Simulation:
    return simulate_walk()


def test_the_default_walk_has_three_streams(walk):
    streams = [stream for stream, _, _ in walk.sources]
    assert [s.topic for s in streams] == ["/imu/waist", "/mag/waist", "/baro/waist"]
    assert [s.rate_hz for s in streams] == [100, 50, 10]
    assert [len(values_of(walk, i)) for i in range(3)] == [6000, 3000, 600]
    assert [c.name for c in streams[0].channels] == [
        *("acc_x", "acc_y", "acc_z"),
        *("gyro_x", "gyro_y", "gyro_z"),
    ]
    assert {s.placement for s in streams} == {"waist"}


def test_gravity_is_felt_standing_and_lies_along_no_axis(walk):
    still = values_of(walk)[:450, :3].mean(axis=0)
    assert np.linalg.norm(still) == pytest.approx(9.81, abs=0.1)
    assert (np.abs(still) < 0.97 * 9.81).all()
    assert (np.abs(still) > 0.5).sum() >= 2
    assert values_of(walk)[:450, :3].std(axis=0).max() < 0.06


def test_vertical_acceleration_peaks_just_after_each_contact(walk):
    acceleration = values_of(walk)[:, :3]
    up = acceleration[:450].mean(axis=0)
    vertical = acceleration @ (up / np.linalg.norm(up))
    contacts = [(s.time_ns - start_ns_of(walk)) / 1e9 for s in of_kind(walk, "step")]
    index = np.rint(np.array(contacts)[2:-2] * 100).astype(int)
    cycle = vertical[index[:, None] + np.arange(-25, 30)].mean(axis=0)
    assert 4 <= np.argmax(cycle) - 25 <= 12
    assert cycle.max() > 12
    assert cycle[20] < vertical.mean() < cycle[27]


def test_steps_alternate_and_keep_the_planned_pace(walk):
    for span in of_kind(walk, "walking"):
        steps = [s for s in of_kind(walk, "step") if span.time_ns <= s.time_ns < span.end_ns]
        assert {a.label + b.label for a, b in pairwise(steps)} == {
            "leftright",
            "rightleft",
        }
        gaps = np.diff([s.time_ns for s in steps]) / 1e9
        assert gaps.std() < 0.05 * gaps.mean()
        assert 0.5 < gaps.mean() < 0.7


def test_every_step_lies_in_a_walking_span(walk):
    spans = of_kind(walk, "walking")
    assert len(spans) == 2
    for step in of_kind(walk, "step"):
        assert any(s.time_ns <= step.time_ns < s.end_ns for s in spans)


def test_the_gyroscope_sees_the_turn(walk):
    values = values_of(walk)
    up = values[:450, :3].mean(axis=0)
    rate = (values[:, 3:] - values[:450, 3:].mean(axis=0)) @ (up / np.linalg.norm(up))
    assert rate[2400:2900].sum() / 100 == pytest.approx(np.pi / 2, abs=0.25)
    headings = [h.value for h in of_kind(walk, "heading")]
    assert headings[0] == 0
    assert headings[-1] == pytest.approx(np.pi / 2, abs=1e-3)


def test_the_magnetometer_turns_with_the_body_and_keeps_its_length(walk):
    field = values_of(walk, 1)
    assert np.linalg.norm(field, axis=1) == pytest.approx(48.3e-6, abs=2e-6)
    assert np.linalg.norm(field[:200].mean(axis=0) - field[-200:].mean(axis=0)) > 20e-6


def test_fidgeting_moves_the_sensor_without_steps(walk):
    values, start_ns = values_of(walk), start_ns_of(walk)
    assert not [s for s in of_kind(walk, "step") if 35 < (s.time_ns - start_ns) / 1e9 < 38.5]
    fidgeting, still = values[3550:3800].std(axis=0), values[:450].std(axis=0)
    assert fidgeting.max() > 5 * still.max()


def test_waypoints_are_where_the_path_starts_turns_and_stops(walk):
    points = of_kind(walk, "waypoint")
    assert [p.label for p in points] == ["start", "turn", "stop", "start", "stop"]
    assert points[0].x_m == pytest.approx(0, abs=0.01)
    assert points[2].y_m > 5
    assert (points[2].x_m, points[2].y_m) == (points[3].x_m, points[3].y_m)


def test_places_advance_by_the_step_length(walk):
    steps = of_kind(walk, "step")[3:30]
    paces = np.hypot(np.diff([s.x_m for s in steps]), np.diff([s.y_m for s in steps]))
    assert np.median(paces) == pytest.approx(0.70, abs=0.03)


def test_same_seed_same_walk_and_another_seed_another():
    first, again = (
        simulate_walk(WalkOptions(duration_s=12)),
        simulate_walk(WalkOptions(duration_s=12)),
    )
    other = simulate_walk(WalkOptions(duration_s=12, seed=9))
    assert values_of(first).tobytes() == values_of(again).tobytes()
    assert first.labels == again.labels
    assert first.labels != other.labels


@pytest.mark.parametrize("rate_hz", [6.0, 25.0, 128.5, 400.0])
def test_any_rate_gives_its_samples_and_truth_inside(rate_hz):
    simulation = simulate_walk(WalkOptions(rate_hz=rate_hz, duration_s=70))
    assert len(values_of(simulation)) == round(70 * rate_hz)
    blocks = list(simulation.sources[0][2])
    times = [label.time_ns for label in simulation.labels]
    assert times == sorted(times)
    assert blocks[0].start_ns <= times[0]
    assert max(times) < blocks[-1].end_ns


@pytest.mark.parametrize("duration_s", [0.001, 3.0, 7.5])
def test_short_walks_are_cut_not_broken(duration_s):
    simulation = simulate_walk(WalkOptions(duration_s=duration_s))
    assert np.isfinite(values_of(simulation)).all()


@pytest.mark.parametrize(
    "options",
    [
        WalkOptions(rate_hz=1),
        WalkOptions(rate_hz=1000),
        WalkOptions(duration_s=0),
        WalkOptions(placement="hat"),
    ],
)
def test_impossible_walks_are_refused(options):
    with pytest.raises(SimulationError, match=r"expected .*, found"):
        simulate_walk(options)
