"""Labels within a span."""

from __future__ import annotations

from dataclasses import replace

import pytest

from groundtrace_codecs.events import Label

WALK = Label(10, "walking", end_ns=20)


@pytest.mark.parametrize(
    ("span", "kept"),
    [
        ((0, 30), (10, 20)),
        ((10, 20), (10, 20)),
        ((12, 30), (12, 20)),
        ((0, 15), (10, 15)),
        ((12, 15), (12, 15)),
        ((20, 30), None),
        ((0, 10), None),
    ],
)
def test_a_labelled_span_is_cut(span: tuple[int, int], kept: tuple[int, int] | None) -> None:
    expected = None if kept is None else replace(WALK, time_ns=kept[0], end_ns=kept[1])
    assert WALK.within(*span) == expected


def test_a_moment_is_in_the_half_open_span_or_not() -> None:
    step = Label(10, "step")
    assert step.within(10, 11) == step
    assert step.within(9, 10) is None


def test_a_count_is_told_of_the_whole_of_its_span_alone() -> None:
    count = Label(10, "count", end_ns=20, value=7.0)
    assert count.within(10, 20) == count
    assert count.within(11, 20) is None
