"""Zero-velocity-updated inertial navigation on simulated foot IMUs with known positions."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from foot_walks import FootWalk, Gait, Sensor, circle, foot_walk, times_s
from hypothesis import given, settings
from hypothesis import strategies as st

from groundtrace.detectors.zero_velocity import ZeroVelocityParameters
from groundtrace.evaluation.positions import aligned_distances
from groundtrace.inertial.ins import FootNavigator, inertial_columns
from groundtrace.inertial.magnetometer import FootCompass
from groundtrace.inertial.rotations import headings_of, levelled, rotated
from groundtrace.inertial.strapdown import (
    GYRO,
    PLACE,
    SPEED,
    TURN,
    FootNavigatorParameters,
    Pose,
    Segments,
    integrate,
)
from groundtrace.kernels.navigation import pose_error
from groundtrace_codecs.signals import NS_PER_S, Channel

if TYPE_CHECKING:
    from groundtrace_codecs.events import TrackPoint
    from groundtrace_codecs.signals import SignalBlock

#: Biases and noise as of a worn consumer sensor, put on askew.
TYPICAL = Sensor((0.3, -0.5, 1.0), (0.01, -0.02, 0.015), (0.1, -0.05, 0.08), 0.005, 0.05)


def segments_of(walk: FootWalk) -> list:
    block = walk.block.select(inertial_columns(walk.block.stream))
    cut = Segments(block.stream.rate_hz, ZeroVelocityParameters())
    values = block.values
    if values.shape[1] == 6:
        values = np.pad(values, ((0, 0), (0, 3)), constant_values=np.nan)
    runs = [cut.add(block.sample_times(), values), *cut.flush()]
    return [segment for run in runs for segment in run]


def navigated(walk: FootWalk, **changes: float) -> tuple[FootNavigator, list[TrackPoint]]:
    """Every candidate accepted that passes; the navigator before its end, and all points."""
    navigator = FootNavigator(FootNavigatorParameters(**changes))
    navigator.begin("track", 1)
    points = []
    for segment in segments_of(walk):
        found = navigator.measure(segment)
        accepted = bool(found.value[0, 1] <= 7 and found.value[0, 2] <= 0.4) if len(found) else None
        points += navigator.follow(segment, accepted)
    return navigator, points


def with_magnetometer(block: SignalBlock, field: tuple[float, float, float]) -> SignalBlock:
    """The field as a foot that stands straight sees it; in a swing it does not count."""
    channels = tuple(Channel(f"mag_{a}", "magnetic_field", "T", a) for a in "xyz")
    stream = replace(block.stream, channels=(*block.stream.channels, *channels))
    samples = np.concatenate([block.samples, np.tile(field, (len(block), 1))], axis=1)
    return replace(block, stream=stream, samples=samples)


def shape_error(walk: FootWalk, points: list[TrackPoint]) -> np.ndarray:
    at = np.array([p.time_ns - walk.block.anchor_ns for p in points]) / NS_PER_S
    truth = np.column_stack(
        [np.interp(at, times_s(walk), column) for column in walk.place[:, :2].T]
    )
    return aligned_distances(np.array([(p.x_m, p.y_m) for p in points]), truth)


def off_the_start(points: list[TrackPoint]) -> float:
    return float(np.hypot(points[-1].x_m, points[-1].y_m))


@pytest.mark.parametrize(("rate_hz", "most_m"), [(400.0, 0.001), (200.0, 0.003), (100.0, 0.01)])
def test_a_loop_without_noise_closes_to_millimetres(rate_hz: float, most_m: float) -> None:
    walk = foot_walk(circle(), rate_hz=rate_hz)
    _, points = navigated(walk)
    assert off_the_start(points) < most_m
    assert shape_error(walk, points).max() < 2 * most_m


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("rate_hz", [50.0, 100.0, 400.0])
def test_a_loop_of_a_typical_sensor_closes_within_one_percent(rate_hz: float, seed: int) -> None:
    walk = foot_walk(circle(8), replace(TYPICAL, seed=seed), rate_hz)
    _, points = navigated(walk, smooth=False)
    assert off_the_start(points) < 0.01 * walk.walked_m
    assert np.sqrt((shape_error(walk, points) ** 2).mean()) < 0.01 * walk.walked_m


SLOW = Gait((0.4,) * 12, 0.5, 0.8, 0.9, 1.0, 0.05, 0.5)
SHUFFLING = Gait((0.4,) * 12, 0.3, 0.8, 0.5, 1.0, 0.01, 0.15)
RUNNING = Gait((0.4,) * 12, 2.4, 0.5, 0.2, 1.0, 0.2, 1.4)


@pytest.mark.parametrize("gait", [SLOW, SHUFFLING, RUNNING], ids=["slow", "shuffling", "running"])
def test_one_setting_does_for_slow_and_fast_feet(gait: Gait) -> None:
    walk = foot_walk(gait, TYPICAL)
    _, points = navigated(walk, smooth=False)
    assert shape_error(walk, points).max() < 0.01 * walk.walked_m


def test_biases_are_found_as_far_as_motion_shows_them() -> None:
    navigator, _ = navigated(foot_walk(circle(), TYPICAL))
    pose = navigator.pose
    assert pose is not None
    assert pose.gyro_bias == pytest.approx(TYPICAL.gyro_bias, abs=5e-4)
    # along gravity; across it a standing foot's bias is its tilt
    up = rotated(pose.orientation * [1, -1, -1, -1], np.array([0.0, 0, 1]))
    assert pose.force_bias @ up == pytest.approx(np.array(TYPICAL.force_bias) @ up, abs=0.02)


@settings(max_examples=5, deadline=None)
@given(st.tuples(*[st.floats(-3, 3)] * 3))
def test_it_does_not_matter_how_the_sensor_is_worn(worn: tuple[float, float, float]) -> None:
    walk = foot_walk(Gait((0.9,) * 3, rest_s=0.5), Sensor(worn), 100.0)
    _, points = navigated(walk, smooth=False)
    assert shape_error(walk, points).max() < 0.02


def test_up_is_where_the_force_of_standing_points_and_left_turns_are_left() -> None:
    walk = foot_walk(Gait((np.pi / 2, 0.0)))
    navigator = FootNavigator(FootNavigatorParameters())
    navigator.begin("track", 1)
    heights, points = [], []
    for segment in segments_of(walk):
        found = navigator.measure(segment)
        points += navigator.follow(segment, True if len(found) else None)
        if navigator.pose is not None:
            heights.append(navigator.pose.position[2])
    assert max(heights) == pytest.approx(0.12, abs=0.01)
    assert min(heights) > -0.01
    assert points[-1].y_m == pytest.approx(walk.place[-1, 1], abs=0.01)
    assert points[-1].y_m > 1.0


def test_falling_freely_is_not_taken_for_rest() -> None:
    walk = foot_walk(Gait(()))
    still = replace(walk.block, samples=np.zeros_like(walk.block.samples))
    _, points = navigated(replace(walk, block=still))
    assert points == []


def test_the_transition_is_the_derivative_of_the_integration() -> None:
    segment = segments_of(foot_walk(circle(), rate_hz=200.0))[88]  # in a swing
    start = Pose(levelled(np.array([1.0, 2.0, 9.0])), np.array([1.0, 0.5, 0.2]))
    step = integrate(start, segment)
    for rows, size in ((TURN, 1e-4), (SPEED, 1e-3), (PLACE, 1e-3), (GYRO, 1e-3)):
        for row in range(rows.start, rows.stop):
            error = np.zeros(15)
            error[row] = size
            moved, other = np.empty(15), integrate(start.moved(error), segment).pose.row
            pose_error(other, step.pose.row, moved)
            assert moved == pytest.approx(step.transition @ error, abs=0.03 * size)


def test_the_spread_of_the_track_covers_its_errors() -> None:
    normalised = []
    for seed in range(4):
        walk = foot_walk(circle(6), replace(TYPICAL, seed=seed, worn=(0, 0, 0)), 50.0)
        _, points = navigated(walk, smooth=False)
        last = points[-1]
        error = np.array([last.x_m, last.y_m]) - walk.place[-1, :2]
        xx, xy, yy = last.covariance
        normalised.append(error @ np.linalg.solve([[xx, xy], [xy, yy]], error))
    assert np.mean(normalised) < 4.4  # 95 % of means of four chi squares of two degrees


def test_smoothing_takes_the_jumps_of_the_stances_out() -> None:
    walk = foot_walk(circle(12), replace(TYPICAL, force_noise=0.3, gyro_noise=0.03), 100.0)
    navigator, filtered = navigated(walk)
    said = filtered + navigator.finish()
    filtered, smoothed = (
        [p for p in said if p.stage == stage] for stage in ("track", "track.smoothed")
    )
    assert [p.time_ns for p in smoothed] == [p.time_ns for p in filtered]
    assert smoothed[-1].x_m == filtered[-1].x_m  # nothing comes after it
    rms = [float(np.sqrt((shape_error(walk, p) ** 2).mean())) for p in (smoothed, filtered)]
    assert rms[0] < rms[1]
    middle = len(smoothed) // 2
    assert smoothed[middle].covariance[0] < filtered[middle].covariance[0]


def test_a_long_track_is_smoothed_in_pieces_and_every_point_once() -> None:
    walk = foot_walk(circle(8), TYPICAL, 100.0)
    navigator, points = navigated(walk, smooth_s=3.0)
    points += navigator.finish()
    smoothed = [p.time_ns for p in points if p.stage == "track.smoothed"]
    assert sorted(smoothed) == [p.time_ns for p in points if p.stage == "track"]


def test_the_magnetic_field_holds_the_heading_where_it_is_that_of_the_start() -> None:
    # nothing but the field tells a bias about the vertical of a foot that is never at rest
    gait = Gait((0.0,) * 25, stance_s=0.3, rest_s=0.3)
    walk = foot_walk(gait, Sensor(gyro_bias=(0.0, 0.0, 0.02)), 100.0)
    off = []
    for magnetometer in (False, True):
        block = with_magnetometer(walk.block, (20e-6, 0.0, -40e-6))
        worn = replace(walk, block=block)
        navigator, _ = navigated(worn, magnetometer=magnetometer, smooth=False, rest_s=1e3)
        assert navigator.pose is not None
        heading = headings_of(navigator.pose.orientation, np.array([1.0, 0, 0]))
        off.append(abs(float(heading)))
    assert off[0] > 0.1
    assert off[1] < 0.1  # what a compass is taken to be good for


def test_a_field_of_another_strength_or_dip_is_no_compass() -> None:
    compass, level = FootCompass(), np.array([1.0, 0, 0, 0])
    assert compass.turned_by(level, np.full(3, np.nan)) is None
    assert compass.turned_by(level, np.array([20e-6, 0, -40e-6])) is None  # the first
    turned_left = compass.turned_by(level, np.array([20e-6, -2e-6, -40e-6]))
    assert turned_left == pytest.approx(0.1, abs=0.001)
    assert compass.turned_by(level, np.array([25e-6, 0, -50e-6])) is None
    assert compass.turned_by(level, np.array([40e-6, 0, -20e-6])) is None
