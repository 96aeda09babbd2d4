"""Paths, magnetic fields, idle time and further sensors of the walk simulator."""

from __future__ import annotations

import numpy as np
import pytest
from simulated_walks import walked

from groundtrace.cli.main import application
from groundtrace.errors import SimulationError
from groundtrace.simulate.gait import WalkOptions
from groundtrace.simulate.walk import simulate_walk
from groundtrace_codecs.recording import Recording


@pytest.fixture(scope="module")
def epfl():
    return walked(path="epfl", seed=3, gnss=True)


def norm_ut(walk):
    return np.linalg.norm(walk.values["mag"], axis=1) * 1e6


def test_the_loop_of_epfl_has_two_straights_of_100_m_and_closes(epfl):
    places = {p.label: [] for p in epfl.of_kind("waypoint")}
    for point in epfl.of_kind("waypoint"):
        places[point.label].append((point.x_m, point.y_m))
    corners = np.array(places["start"] + places["turn"] + places["stop"])
    legs = np.hypot(*np.diff(corners, axis=0).T)
    assert legs == pytest.approx([100, 30, 100, 30], abs=0.6)
    assert np.hypot(*corners[-1]) < 0.6
    steps = np.array([(s.x_m, s.y_m) for s in epfl.of_kind("step")])
    assert np.hypot(*np.diff(steps, axis=0).T).sum() == pytest.approx(260, abs=2)


def test_the_second_straight_is_strongly_disturbed_and_the_first_weakly(epfl):
    strong = [d for d in epfl.of_kind("disturbed") if d.value > 10e-6]
    weak = [d for d in epfl.of_kind("disturbed") if d.value <= 10e-6]
    assert len(strong) >= 5
    assert len(weak) == 3
    corners = epfl.seconds(epfl.of_kind("waypoint", "turn"))
    assert (epfl.seconds(strong) > corners[1]).all()
    assert (epfl.seconds(strong) < corners[2]).all()
    assert (epfl.seconds(weak) < corners[0]).all()


def test_the_field_is_that_of_the_earth_outside_disturbed_spans(epfl):
    inside = np.zeros(len(epfl.time_s["mag"]), bool)
    for span in epfl.of_kind("disturbed"):
        ends = ((span.time_ns - epfl.start_ns) / 1e9, (span.end_ns - epfl.start_ns) / 1e9)
        inside[slice(*np.searchsorted(epfl.time_s["mag"], ends))] = True
    field = norm_ut(epfl)
    assert np.abs(field[~inside] - 48).max() < 2 + 5 * 0.85
    assert np.abs(field[inside] - 48).max() > 10
    smooth = np.convolve(field, np.ones(10) / 10, "valid")
    assert np.abs(np.diff(smooth)).max() < 3  # uT in 20 ms: no jumps


def test_positions_of_satellites_follow_the_path_within_metres(epfl):
    latitude, longitude, altitude = epfl.values["gnss"].T
    x_m = np.radians(longitude - 6.5657) * 6_378_137 * np.cos(np.radians(46.5197))
    y_m = np.radians(latitude - 46.5197) * 6_378_137
    headings = epfl.of_kind("heading")
    seconds = epfl.seconds(headings)
    for found, true in ((x_m, [h.x_m for h in headings]), (y_m, [h.y_m for h in headings])):
        off = found - np.interp(epfl.time_s["gnss"], seconds, true)
        assert 0.3 < np.sqrt(np.mean(off**2)) < 6
    assert epfl.rates_hz["gnss"] == 1
    assert altitude == pytest.approx(400, abs=20)


def test_disturbances_come_by_number_on_any_path():
    walk = walked(path="straight", disturbances=4, duration_s=60.0, seed=2)
    spans = walk.of_kind("disturbed")
    assert 2 <= len(spans) <= 4
    assert all(8e-6 < s.value < 1.3e-4 for s in spans)


def test_iron_of_the_carrier_shifts_and_stretches_the_field():
    plain, hard, soft = (
        walked(path="loop", duration_s=40.0, hard_iron_t=h, soft_iron=s)
        for h, s in ((None, None), (20e-6, None), (None, 0.2))
    )
    shift = hard.values["mag"] - plain.values["mag"]
    assert np.linalg.norm(shift, axis=1) == pytest.approx(20e-6, abs=3e-8)
    assert shift.std(axis=0).max() < 2e-8
    stretch = np.linalg.norm(soft.values["mag"] - plain.values["mag"], axis=1)
    assert 0 <= stretch.min() < stretch.max() <= 0.2 * 52e-6


def test_idle_time_moves_the_sensor_without_steps():
    walk = walked(path="random", with_idle=True, duration_s=400.0, person=1)
    idles = walk.of_kind("idle")
    assert {x.label for x in idles} == {"sit", "reach", "handle", "ride"}
    steps = walk.seconds(walk.of_kind("step"))
    force = np.linalg.norm(walk.values["imu"][:, :3], axis=1)
    still = force[:350].std()
    for idle in idles:
        start_s, end_s = walk.seconds([idle])[0], (idle.end_ns - walk.start_ns) / 1e9
        assert not ((steps > start_s) & (steps < end_s)).any()
        if end_s - start_s > 2:
            near = slice(*np.searchsorted(walk.time_s["imu"], (start_s, end_s)))
            assert force[near].std() > 2 * still


@pytest.mark.parametrize("rate_hz", [6.0, 30.0, 100.0, 400.0])
def test_any_rate_gives_its_samples_with_truth_inside(rate_hz):
    walk = walked(types=True, with_idle=True, gnss=True, rate_hz=rate_hz, duration_s=31.0)
    assert len(walk.values["imu"]) == round(31 * rate_hz)
    assert np.isfinite(walk.values["imu"]).all()
    times = [x.time_ns for x in walk.labels]
    assert times == sorted(times)
    assert max(x.end_ns or x.time_ns for x in walk.labels) < walk.end_ns


@pytest.mark.parametrize("duration_s", [0.001, 3.0, 12.3, 150.0])
@pytest.mark.parametrize("path", ["straight", "l", "loop", "epfl", "random"])
def test_a_given_length_cuts_the_walk_or_goes_on(path, duration_s):
    walk = walked(path=path, duration_s=duration_s, rate_hz=25.0)
    assert len(walk.values["imu"]) == max(1, round(duration_s * 25))
    if duration_s == 150.0:
        steps = walk.seconds(walk.of_kind("step"))
        assert steps[-1] > (90 if path == "random" else 140)


def test_the_same_seed_gives_the_same_walk_and_another_seed_another():
    first, again, other = (walked(types=True, duration_s=30.0, seed=s) for s in (6, 6, 7))
    assert first.values["imu"].tobytes() == again.values["imu"].tobytes()
    assert first.values["mag"].tobytes() == again.values["mag"].tobytes()
    assert first.labels == again.labels
    assert first.labels != other.labels


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"placement": "hat"}, "placement: expected waist or trunk"),
        ({"path": "moon"}, "path: expected straight or l"),
        ({"person": -1}, "person: expected 0 or more, found -1"),
        ({"disturbances": 51}, "disturbances: expected 0 to 50, found 51"),
        ({"hard_iron_t": 1.0}, "hard_iron_t: expected 0 to 1e-4 T, found 1.0"),
        ({"soft_iron": float("nan")}, "soft_iron: expected 0 to 0.3, found nan"),
        ({"rate_hz": 5.0}, "rate_hz: expected 6 to 400, found 5.0"),
    ],
)
def test_impossible_options_are_refused_in_one_line(options, said):
    with pytest.raises(SimulationError) as caught:
        simulate_walk(WalkOptions(**options))
    assert str(caught.value).startswith(f"simulate walk: {said}")
    assert "\n" not in str(caught.value)


def test_the_command_writes_what_the_simulator_gives(tmp_path, capsys):
    out = tmp_path / "walk.mcap"
    line = f"simulate walk -o {out} --types --path loop --duration-s 20 --placement trunk --gnss"
    application()(line, result_action="return_value")
    simulation = simulate_walk(
        WalkOptions(types=True, path="loop", duration_s=20.0, placement="trunk", gnss=True)
    )
    assert "step" in capsys.readouterr().out
    with Recording.open(out) as recording:
        assert recording.labels == simulation.labels
        topics = {s.topic for s in recording.streams}
        assert topics == {"/imu/trunk", "/mag/trunk", "/baro/trunk", "/gnss"}
        assert recording.metadata["simulation"] == simulation.metadata["simulation"]
