from __future__ import annotations

from groundtrace_viewers.rerun.site import MOST_NAMES, RADIUS, labelled, marker_radius


def test_few_sensors_are_all_named() -> None:
    assert labelled(MOST_NAMES) == list(range(MOST_NAMES))


def test_of_many_sensors_every_fourth_and_the_last_are_named() -> None:
    assert labelled(24) == [0, 4, 8, 12, 16, 20, 23]
    assert labelled(25)[-2:] == [20, 24]


def test_neighbours_on_a_line_do_not_cover_each_other() -> None:
    line = [(float(x), 0.0) for x in range(100)]
    assert marker_radius(line, 99.0) < RADIUS
    assert marker_radius(line[:2], 1.0) == RADIUS
    assert marker_radius(line[:1], 10.0) == RADIUS
