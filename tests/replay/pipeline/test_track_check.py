"""Tracks: that there is one where one was asked for, and that it can be."""

from __future__ import annotations

import copy
import math

import pytest

from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import load_pipeline
from groundtrace.pipeline.track_check import TrackCheck, Tracking
from groundtrace_codecs.events import SMOOTHED, Fix, Note, StepEvent, TrackPoint
from groundtrace_codecs.geometry import Geometry

NS = 10**9
NAN = (math.nan, math.nan, math.nan)


def points(speed_mps: float, count: int = 20, every_s: float = 0.5, stage: str = "track"):
    return [
        TrackPoint(round(i * every_s * NS), 1, i * every_s * speed_mps, 0.0, 0.0, 0.0, NAN, stage)
        for i in range(count)
    ]


def checked(events, application: str = "walker", *, metric: bool = True) -> list[Note]:
    check = TrackCheck(application, [Tracking("track", "steps", "steps")], metric=metric)
    for event in events:
        check.update([event])
    return list(check.flush())


def test_sixty_metres_a_second_on_foot_cannot_be() -> None:
    (note,) = checked(points(60.0))
    assert note.level == "WARN"
    assert "60.0 m in 1.0 s is 60.0 m/s, faster than any person runs (12.5 m/s)" in note.text
    assert "so are 18 of 20 points" in note.text


@pytest.mark.parametrize(("speed", "application"), [(11.0, "walker"), (33.0, "vehicle")])
def test_a_sprint_and_a_fast_car_can_be(speed: float, application: str) -> None:
    assert not checked(points(speed), application)


def test_one_jump_is_told_with_its_time_and_an_error_of_a_place_over_milliseconds_is_not() -> None:
    track = points(1.2)
    jumped = [
        p
        if p.time_ns < 5 * NS
        else TrackPoint(p.time_ns, 1, p.x_m + 84.6, 0.0, 0.0, 0.0, NAN, "track")
        for p in track
    ]
    (note,) = checked(jumped)
    assert 5 * NS <= note.time_ns <= 6 * NS
    assert "85.8 m in 1.0 s" in note.text
    shaking = [
        TrackPoint(i * 10**7, 1, 0.2 * (i % 2), 0.0, 0.0, 0.0, NAN, "track") for i in range(300)
    ]
    assert not checked(shaking)


def test_another_track_and_another_stage_begin_anew() -> None:
    far = [TrackPoint(p.time_ns, 2, p.x_m + 500, 0.0, 0.0, 0.0, NAN, "track") for p in points(1.0)]
    both = sorted([*points(1.0), *far, *points(2.0, stage="smoothed")], key=lambda p: p.time_ns)
    assert not checked(both)


def test_a_track_that_leaps_as_it_goes_may_be_where_the_smoothed_one_does_not() -> None:
    leaps, smoothed = points(60.0), points(1.2, stage="track" + SMOOTHED)
    assert not checked([*leaps, *smoothed])
    (note,) = checked([*points(1.2), *points(60.0, stage="track" + SMOOTHED)])
    assert "track.smoothed: a track that cannot be" in note.text


def test_in_an_unknown_unit_no_speed_is_judged() -> None:
    assert not checked(points(60.0), metric=False)


def test_no_track_where_one_was_asked_for_is_told_with_what_it_takes() -> None:
    steps = [StepEvent(NS * i, "step", "", "/imu", "steps", 1.0) for i in range(3)]
    (note,) = checked(steps)
    assert note.text == (
        "no track, though one was asked for: track takes the steps of steps, which found 3"
    )
    check = TrackCheck("room", [Tracking("t", "fixes", "near")], metric=True)
    check.update(
        [Fix(0, 0.0, 0.0, NAN, 0.0, "m", 3, "near"), Fix(0, 0, 0, NAN, 0.0, "m", 3, "far")]
    )
    (note,) = check.flush()
    assert note.text.endswith("t takes the fixes of near, which found 1")


def test_where_nothing_was_found_the_end_of_the_signal_is_when_that_is_told() -> None:
    check = TrackCheck("room", [Tracking("t", "fixes", "near")], metric=True)
    for time_ns in (10 * NS, 12 * NS, 11 * NS):
        check.update([], time_ns)
    (note,) = check.flush()
    assert note.time_ns == 12 * NS


def test_where_no_track_was_asked_for_nothing_is_missed() -> None:
    check = TrackCheck("walker", [], metric=True)
    check.update(points(60.0))
    assert not list(check.flush())


def test_a_copy_of_a_check_goes_on_as_one_in_one_go() -> None:
    track = points(60.0)
    first = TrackCheck("walker", [Tracking("track", "steps", "steps")], metric=True)
    first.update(track[:7])
    second = copy.deepcopy(first)
    first.update(points(9.0))
    second.update(track[7:])
    assert list(second.flush()) == checked(track)


def test_a_pipeline_s_end_says_that_no_track_came_of_it() -> None:
    chain = build_pipeline(load_pipeline("pedestrian"), Geometry())
    (note,) = [event for event in chain.flush() if isinstance(event, Note)]
    assert "track takes the steps of steps, which found 0" in note.text
    assert not build_pipeline(load_pipeline("waist-steps")).flush()
