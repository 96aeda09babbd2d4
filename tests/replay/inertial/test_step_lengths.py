"""Models of the length of a step, known places and heights."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from groundtrace.inertial.body_motion import LevelFrameMotion
from groundtrace.inertial.steps import (
    BELIEFS,
    Barometer,
    ReckoningParameters,
    StepShape,
    shape_of,
    stair_length,
    step_length,
    waypoints_of,
)
from groundtrace.pipeline.parameters import given_waypoints
from groundtrace_codecs.events import Label
from groundtrace_codecs.geometry import TangentPlane
from groundtrace_codecs.signals import NS_PER_S, Channel, SignalBlock, Stream

P = ReckoningParameters()
SHAPE = StepShape(swing=16.0, rise_m=0.04, peak_end_s=0.2)


def test_fixed_calibrated_and_by_height_need_no_signal() -> None:
    assert step_length(SHAPE, "", 0.5, replace(P, step_length="fixed", length_m=0.6)) == 0.6
    calibrated = replace(P, step_length="calibrated", calibrated_m=70.0, calibrated_steps=100)
    assert step_length(SHAPE, "", 0.5, calibrated) == pytest.approx(0.7)
    tall = replace(P, step_length="height", height_m=1.8, height_part=0.4)
    assert step_length(SHAPE, "", 0.5, tall) == pytest.approx(0.72)


def test_weinberg_takes_the_fourth_root_of_the_swing() -> None:
    assert step_length(SHAPE, "", 0.5, replace(P, weinberg=0.35)) == pytest.approx(0.7)


def test_the_pendulum_takes_the_chord_of_what_the_leg_swings_up() -> None:
    p = replace(P, step_length="pendulum", pendulum=1.0, height_m=1.0 / 0.53)
    assert step_length(SHAPE, "", 0.5, p) == pytest.approx(2 * math.sqrt(2 * 0.04 - 0.04**2))
    assert math.isfinite(step_length(StepShape(1.0, 9.0, 0.0), "", 0.5, p))


def test_by_cadence_and_by_the_peak_s_end_and_by_both_beliefs() -> None:
    by = {m: replace(P, step_length=m) for m in ("weinberg", "cadence", "interval", "fused")}
    length = {model: step_length(SHAPE, "", 0.25, p) for model, p in by.items()}
    assert length["cadence"] == pytest.approx(P.cadence_part * P.height_m * 2)
    assert length["interval"] == pytest.approx(P.interval_mps * 0.2)
    low, high = sorted((length["weinberg"], length["cadence"]))
    assert low < length["fused"] < high
    # of two beliefs the surer one, by its inverse variance
    sure = BELIEFS["weinberg"] ** -2, BELIEFS["cadence"] ** -2
    middle = sure[0] * math.log(length["weinberg"]) + sure[1] * math.log(length["cadence"])
    assert math.log(length["fused"]) == pytest.approx(middle / sum(sure))
    assert math.isfinite(step_length(StepShape(0.0, 0.0, 0.0), "", 0.25, by["fused"]))


def test_steps_back_and_aside_are_shorter() -> None:
    ahead = step_length(SHAPE, "forward", 0.5, P)
    assert step_length(SHAPE, "backward", 0.5, P) == pytest.approx(P.backward * ahead)
    assert step_length(SHAPE, "left", 0.5, P) == step_length(SHAPE, "right", 0.5, P) < ahead


def motion(rise_m: float, step_s: float, rate_hz: float = 100.0) -> LevelFrameMotion:
    n = round((step_s + 0.1) * rate_hz) + 1
    time_s = np.arange(n) / rate_hz - 0.05
    wave = 2 * math.pi / step_s
    up = -0.5 * rise_m * wave**2 * np.cos(wave * time_s)
    times = np.rint(time_s * NS_PER_S).astype(np.int64)
    acceleration = np.stack([0 * up, 0 * up, up], axis=1)
    still = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
    return LevelFrameMotion(times, still, acceleration, np.full((n, 3), np.nan), *np.zeros((2, n)))


def test_the_rise_of_a_body_that_bobs_is_found_from_its_acceleration() -> None:
    shape = shape_of(motion(0.05, 0.5), 0, NS_PER_S // 2)
    assert shape.rise_m == pytest.approx(0.05, rel=0.1)
    assert shape.swing == pytest.approx(0.05 * (4 * math.pi) ** 2, rel=0.1)
    assert shape.peak_end_s == pytest.approx(0.25, abs=0.03)


def test_a_step_of_hardly_any_samples_has_no_shape() -> None:
    assert shape_of(motion(0.05, 0.5, 20.0).between(0, 1), 0, 1) == StepShape(0.0, 0.0, 0.0)


def test_degrees_become_metres_to_the_east_and_north() -> None:
    plane = TangentPlane((10.0, 20.0))
    start = (math.radians(46.5), math.radians(6.6))
    assert plane.map_position(*start) == pytest.approx((10.0, 20.0))
    x, y = plane.map_position(start[0] + math.radians(1e-3), start[1] + math.radians(1e-3))
    # a degree of latitude and of longitude at 46.5 degrees: 111.163 km and 76.77 km (WGS 84)
    assert (x - 10, y - 20) == (pytest.approx(76.77, abs=0.05), pytest.approx(111.16, abs=0.05))


def test_the_date_line_is_no_way_around_the_world() -> None:
    plane = TangentPlane()
    plane.map_position(0.0, math.radians(179.9999))
    x, _ = plane.map_position(0.0, math.radians(-179.9999))
    assert x == pytest.approx(22.26, abs=0.05)


LABELS = (
    Label(3, "waypoint", x_m=3.0, y_m=0.0),
    Label(1, "waypoint", x_m=1.0, y_m=0.0),
    Label(2, "waypoint", x_m=2.0, y_m=0.0),
    Label(2, "step", x_m=9.0, y_m=9.0),
    Label(4, "waypoint"),
)


@pytest.mark.parametrize(
    ("updates", "times"),
    [("none", []), ("gnss", []), ("first-two", [1, 2]), ("waypoints", [1, 2, 3])],
)
def test_only_the_waypoints_asked_for_are_known(updates: str, times: list[int]) -> None:
    assert [k.time_ns for k in waypoints_of(given_waypoints(LABELS, updates), 1.0)] == times


def test_the_barometer_tells_the_height_over_the_first_step() -> None:
    stream = Stream("/baro", (Channel("p", "pressure", "Pa"),), 10.0)
    pressure = 101_325 * np.exp(-np.linspace(0, 20, 200) / 8434.5)
    pressure[50] = np.nan
    barometer = Barometer()
    assert math.isnan(barometer.height_m(0))
    barometer.update(SignalBlock(stream, 0, 0, pressure[:, None]))
    assert barometer.height_m(2 * NS_PER_S) == 0
    assert barometer.height_m(12 * NS_PER_S) == pytest.approx(10.05, abs=0.05)


def climbed(climb_mps: float, noise_pa: float, rate_hz: float = 6.0) -> Barometer:
    """Twenty seconds of going up or down at one speed."""
    stream = Stream("/baro", (Channel("pressure", "pressure", "Pa"),), rate_hz)
    seconds = np.arange(round(20 * rate_hz)) / rate_hz
    noise = noise_pa * np.random.default_rng(1).standard_normal(len(seconds))
    pressure = 97_600.0 * np.exp(-climb_mps * seconds / 8434.5) + noise
    barometer = Barometer()
    barometer.update(SignalBlock(stream, 0, 0, pressure[:, None]))
    return barometer


@pytest.mark.parametrize("climb_mps", [-0.3, 0.0, 0.3])
def test_a_climb_is_the_slope_of_the_pressure(climb_mps: float) -> None:
    exact = climbed(climb_mps, 0.0).climb_mps(10 * NS_PER_S)
    assert exact == pytest.approx(climb_mps, abs=1e-6)
    noisy = climbed(climb_mps, 2.0).climb_mps(10 * NS_PER_S)
    assert noisy == pytest.approx(climb_mps, abs=0.06)


def test_too_few_pressures_tell_no_climb() -> None:
    assert Barometer().climb_mps(0) == 0
    assert climbed(0.3, 0.0, rate_hz=0.5).climb_mps(10 * NS_PER_S) == 0
    assert climbed(0.3, 0.0).climb_mps(22 * NS_PER_S) == 0  # after the end: two pressures


@pytest.mark.parametrize(
    ("riser_m", "tread_m"), [(0.17, 0.29), (-0.17, 0.29), (0.3, 0.21), (0.09, None), (-0.05, None)]
)
def test_a_step_on_a_stair_is_as_long_as_its_tread(riser_m: float, tread_m: float | None) -> None:
    assert stair_length(riser_m) == (None if tread_m is None else pytest.approx(tread_m))
