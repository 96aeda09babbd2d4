"""Steps found at the wrong time: what is paired, how far apart, and the shift that mends most."""

from __future__ import annotations

import itertools
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundtrace.evaluation.matching import (
    REACH_S,
    StepMatch,
    TimingPair,
    answers_text,
    best_shift,
    found_text,
    match_steps,
    step_reach_s,
    timing_pairs,
)
from groundtrace_codecs.events import Label
from groundtrace_codecs.signals import NS_PER_S

START = 1_700_000_000 * NS_PER_S


def at(seconds: float) -> int:
    return START + round(seconds * NS_PER_S)


def matching(true_s, found_s, *more: Label, tolerance_s: float = 0.12) -> StepMatch:
    labels = [*(Label(at(t), "step") for t in true_s), *more]
    found_ns = np.array([at(t) for t in found_s], np.int64)
    return match_steps(labels, found_ns, START, at(60.0), tolerance_s)


def told(found: StepMatch) -> list[tuple[int, float]]:
    return [(pair.step, round(pair.late_ns / 1e6, 3)) for pair in timing_pairs(found)]


def test_a_miss_and_the_false_step_near_it_are_one() -> None:
    assert told(matching([1.0, 1.5, 2.0], [1.01, 1.626, 2.02])) == [(2, 126.0)]
    assert told(matching([1.0, 1.5, 2.0], [1.01, 1.3, 2.02])) == [(2, -200.0)]


def test_a_false_step_beyond_half_a_step_time_is_of_no_miss() -> None:
    assert told(matching([1.0, 1.5, 2.0], [1.01, 1.755, 2.02])) == []
    assert told(matching([1.0, 2.5, 4.0], [1.01, 3.01, 4.02])) == []  # half a second, not 0.75


def test_the_pause_after_a_walk_is_no_step_time() -> None:
    walk = np.array([1.0, 1.5, 2.0, 2.5, 9.0, 9.5, 10.0])
    assert step_reach_s(walk) == pytest.approx(np.full(7, 0.25))
    assert step_reach_s(np.array([3.0])) == pytest.approx([REACH_S])
    assert step_reach_s(walk, np.array([2.7])) == pytest.approx([0.25])


def test_pairs_are_one_to_one_and_as_many_as_can_be() -> None:
    # the nearest to 1.5 would leave 2.0 alone
    assert told(matching([1.5, 2.0, 2.5, 3.0], [1.29, 1.76, 2.5, 3.0])) == [
        (1, -210.0),
        (2, -240.0),
    ]


def test_a_detection_outside_what_is_scored_is_found_too() -> None:
    walking = Label(at(0.9), "walking", end_ns=at(2.0))
    found = matching([1.0, 1.5, 2.0], [1.0, 1.5, 2.15], walking)
    assert len(found.false) == 0
    assert told(found) == [(3, 150.0)]


def test_a_detection_that_answers_an_ignored_step_is_of_no_other() -> None:
    ignored = Label(at(1.85), "ignore", end_ns=at(5.0))
    assert told(matching([1.0, 1.5, 1.9], [1.0, 1.73, 1.91], ignored)) == [(2, 230.0)]
    assert told(matching([1.0, 1.75, 1.9], [1.0, 1.91], ignored)) == []


TIMES = st.lists(st.integers(0, 40).map(lambda i: i / 16), max_size=6, unique=True).map(sorted)


@given(true_s=TIMES, found_s=TIMES, tolerance=st.integers(0, 8).map(lambda i: i / 32))
def test_no_other_pairing_has_more_pairs_or_the_same_with_less_distance(
    true_s, found_s, tolerance
) -> None:
    found = matching(true_s, found_s, tolerance_s=tolerance)
    pairs = timing_pairs(found)
    reach = dict(zip(range(1, len(true_s) + 1), step_reach_s(np.array(true_s)), strict=True))
    missed = [(i + 1, true_s[i]) for i in found.missed]
    alone = [(t - START) / NS_PER_S for t in found.found_ns[found.false]]
    best = (0, 0.0)
    few, many = sorted((missed, alone), key=len)
    for order in itertools.permutations(many, len(few)):
        way = zip(few, order, strict=True)
        both = [(x, y) if few is missed else (y, x) for x, y in way]
        apart = [abs(t - f) for (step, t), f in both if abs(t - f) <= reach[step] + 1e-12]
        best = max(best, (len(apart), -sum(apart)))
    assert len(pairs) == best[0]
    assert sum(abs(p.late_ns) for p in pairs) / NS_PER_S == pytest.approx(-best[1], abs=1e-6)
    assert len({p.found_ns for p in pairs}) == len({p.step for p in pairs}) == len(pairs)
    for pair in pairs:
        assert tolerance < abs(pair.late_ns) / NS_PER_S <= REACH_S


@given(
    late_ns=st.integers(1, 500_000_000),
    early=st.booleans(),
    tolerance_s=st.floats(0.0005, 0.499).map(lambda x: round(x, 4)),
)
def test_what_is_printed_exceeds_the_tolerance_that_is_printed(late_ns, early, tolerance_s) -> None:
    late_ns += round(tolerance_s * NS_PER_S)
    pair = TimingPair(12, START, START + (-late_ns if early else late_ns))
    text = found_text(pair, tolerance_s)
    off, way, tolerance = re.fullmatch(
        r"found (\S+) ms (late|early), tolerance (\S+) ms", text
    ).groups()
    assert float(off) > float(tolerance) == pytest.approx(tolerance_s * 1e3)
    assert float(off) == pytest.approx(late_ns / 1e6, abs=0.51)
    assert way == ("early" if early else "late")
    assert answers_text(pair, tolerance_s) == f"answers step 12, {off} ms {way}"


def test_one_shift_mends_all_that_a_constant_lateness_lost() -> None:
    walk = 1 + 0.55 * np.arange(40)
    late = matching(walk, walk + 0.15)
    shift = best_shift(late, timing_pairs(late))
    assert (shift.late_ms, shift.right, shift.mends, shift.pairs) == (
        pytest.approx(150),
        40,
        40,
        40,
    )


def test_a_shift_need_not_be_the_usual_latency() -> None:
    walk = 1 + 0.55 * np.arange(40)
    late = matching(walk, walk + np.where(np.arange(40) % 5 < 2, 0.2, 0.0))
    shift = best_shift(late, timing_pairs(late))
    assert (shift.mends, shift.pairs, shift.right) == (16, 16, 40)
    assert 80 <= shift.late_ms <= 120


def test_where_no_shift_mends_most_of_them_none_is_told() -> None:
    walk = 1 + 0.55 * np.arange(40)
    off = np.zeros(40)
    off[5:30:2] = np.where(np.arange(13) % 2, 0.25, -0.25)
    found = matching(walk, walk + off)
    assert len(timing_pairs(found)) == 13
    assert best_shift(found, timing_pairs(found)) is None
    assert best_shift(matching(walk, walk), ()) is None
