from __future__ import annotations

import numpy as np

from groundtrace_viewers.rerun.timeline import MARK_NS, Lane, coincident


class Recorder:
    """Stands for a timeline: keeps what a lane sends."""

    def __init__(self) -> None:
        self.changes: list[tuple[int, str]] = []

    def declare(self, *_: object) -> None:
        pass

    def static(self, *_: object) -> None:
        pass

    def send(self, _: str, times: tuple[int, ...], columns: object) -> None:
        (column,) = columns
        states = [s for [s] in column.as_arrow_array().to_pylist()]
        self.changes += zip(times, states, strict=True)


def lane() -> tuple[Lane, Recorder]:
    recorder = Recorder()
    return Lane(recorder, "/state/x", {"a": 0xFF, "b": 0xFF}), recorder  # type: ignore[arg-type]


def test_a_moment_is_a_short_mark_that_ends() -> None:
    x, recorder = lane()
    x.add(0, "a")
    x.flush()
    assert recorder.changes == [(0, "a"), (MARK_NS, "")]


def test_the_next_mark_ends_the_one_before() -> None:
    x, recorder = lane()
    x.add(MARK_NS // 2, "b")
    x.add(0, "a")
    x.flush()
    assert recorder.changes == [(0, "a"), (MARK_NS // 2, "b"), (MARK_NS // 2 + MARK_NS, "")]


def test_marks_flushed_in_parts_are_those_flushed_at_once() -> None:
    starts = [0, 50, 500, 520, 900]
    whole, at_once = lane()
    parts, in_parts = lane()
    for start in starts:
        whole.add(start * 1_000_000, "a" if start % 20 else "b")
        parts.add(start * 1_000_000, "a" if start % 20 else "b")
        parts.flush(start * 1_000_000)
    whole.flush()
    parts.flush()
    assert in_parts.changes == at_once.changes


def test_a_group_is_decided_by_its_first_accepted_member() -> None:
    times = np.array([0, 10, 20, 100, 110, 300])
    accepted = np.array([False, True, True, False, False, True])
    assert coincident(times, accepted, 50) == [1, 3, 5]


def test_no_candidates_make_no_groups() -> None:
    assert coincident(np.empty(0, np.int64), np.empty(0, np.bool_), 50) == []
