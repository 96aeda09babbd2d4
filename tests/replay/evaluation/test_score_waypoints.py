"""Distances of a track from waypoints."""

from __future__ import annotations

import pytest

from groundtrace.evaluation.positions import score_waypoints
from groundtrace_codecs.events import Label, TrackPoint

NAN = float("nan")


def point(time_ns: int, x: float, y: float) -> TrackPoint:
    return TrackPoint(time_ns, 1, x, y, NAN, NAN, (NAN, NAN, NAN), "track")


def waypoint(time_ns: int, x: float, y: float, target: str = "") -> Label:
    return Label(time_ns, "waypoint", x_m=x, y_m=y, target=target)


TRUTH = [waypoint(0, 0, 0), waypoint(10, 10, 0), waypoint(20, 10, 10)]


def test_a_track_is_taken_straight_between_its_points_and_stands_beyond_them() -> None:
    found = score_waypoints(TRUTH, [point(5, 0, 0), point(15, 10, 2)])
    assert found is not None
    assert found.n == 3
    assert found.end_m == pytest.approx(8)
    assert found.median_m == pytest.approx((8 + 26**0.5) / 2)
    assert (found.way_m, found.end_percent) == (pytest.approx(20), pytest.approx(40))
    assert found.way_error_percent == pytest.approx(100 * (104**0.5 / 20 - 1))


def test_the_first_waypoint_where_a_reckoning_begins_does_not_count() -> None:
    found = score_waypoints(TRUTH, [point(0, 5, 5), point(10, 10, 0), point(20, 10, 10)])
    assert found is not None
    assert (found.median_m, found.p95_m) == (0, 0)


def test_there_is_no_score_without_a_way_of_one_walker() -> None:
    track = [point(0, 0, 0), point(10, 1, 1)]
    assert score_waypoints(TRUTH[:1], track) is None
    assert score_waypoints(TRUTH, []) is None
    assert score_waypoints([waypoint(0, 1, 1), waypoint(5, 1, 1)], track) is None
    assert score_waypoints([waypoint(0, 1, 1, "a"), waypoint(5, 2, 1, "b")], track) is None
