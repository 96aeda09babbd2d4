"""Scores of steps: matching, spans, counts, chance, latency."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from groundtrace.evaluation.matching import f1_of, f1_score, match, metronome_f1, random_f1
from groundtrace.evaluation.steps import score_steps
from groundtrace_codecs.events import Label
from groundtrace_codecs.signals import NS_PER_S

START = 1_700_000_000 * NS_PER_S


def at(seconds: float) -> int:
    return START + round(seconds * NS_PER_S)


def steps(*times: float) -> list[Label]:
    return [Label(at(t), "step") for t in times]


def span(kind: str, start: float, end: float, value: float | None = None) -> Label:
    return Label(at(start), kind, end_ns=at(end), value=value)


def score(labels: list[Label], found, end: float = 60.0, tolerance_s: float = 0.12):
    detected = np.array([at(t) for t in found], np.int64)
    return score_steps(labels, detected, START, at(end), tolerance_s)


TIMES = st.lists(st.integers(0, 60).map(lambda i: i / 16), max_size=12).map(sorted)


@given(truth=TIMES, found=TIMES, tolerance=st.integers(0, 12).map(lambda i: i / 32))
def test_two_pointers_find_as_many_pairs_as_the_best_assignment(truth, found, tolerance):
    pairs = match(np.array(truth), np.array(found), tolerance)
    gated = np.abs(np.subtract.outer(truth, found)) <= tolerance
    gated = gated.reshape(len(truth), len(found))
    rows, columns = linear_sum_assignment(gated, maximize=True)
    assert len(pairs) == gated[rows, columns].sum()
    assert all(gated[i, j] for i, j in pairs)
    assert len(set(pairs[:, 0])) == len(set(pairs[:, 1])) == len(pairs)


def test_legal_matches_that_mutual_nearest_neighbours_lose_are_found():
    pairs = match(np.array([0, 0.1]), np.array([0.09, 0.19]), 0.1)
    assert pairs.tolist() == [[0, 0], [1, 1]]


@pytest.mark.parametrize(("counts", "f1"), [((0, 0, 0), 0.0), ((4, 0, 0), 0.0), ((4, 6, 3), 0.6)])
def test_f1_is_the_harmonic_mean_of_precision_and_recall(counts, f1):
    assert f1_score(*counts) == pytest.approx(f1)


def walk(pace_s: float = 0.55, count: int = 400) -> np.ndarray:
    jitter = np.random.default_rng(8).normal(0, 0.02, count)
    return 5 + pace_s * np.arange(count) + jitter


@pytest.mark.parametrize(
    ("tolerance_s", "metronome", "random"),
    [(0.5, 0.995, 0.77), (0.15, 0.56, 0.42), (0.1, 0.36, 0.31)],
)
def test_blind_detectors_reach_the_known_chance_levels(tolerance_s, metronome, random):
    truth = walk()
    spans = np.array([[truth[0] - tolerance_s, truth[-1] + tolerance_s]])
    assert metronome_f1(truth, spans, len(truth), tolerance_s) == pytest.approx(metronome, abs=0.03)
    assert random_f1(truth, spans, len(truth), tolerance_s) == pytest.approx(random, abs=0.03)


def test_the_chance_levels_stand_beside_the_score():
    truth = walk()
    result = score(steps(*truth), truth + 0.01, end=300.0, tolerance_s=0.15)
    assert result.f1 == 1.0
    # detections may fall anywhere in 300 s, of which people walk 220 s
    assert result.chance_f1 < 0.4
    within = score([*steps(*truth), span("walking", 5, 225)], truth, end=300.0, tolerance_s=0.15)
    assert within.chance_f1 == pytest.approx(0.42, abs=0.03)
    assert within.chance_f1_metronome == pytest.approx(0.56, abs=0.03)


def test_chance_is_the_same_every_time():
    truth, spans = np.array([1.0, 2.0]), np.array([[0.0, 4.0], [6.0, 9.0]])
    assert random_f1(truth, spans, 3, 0.3) == random_f1(truth, spans, 3, 0.3)
    assert random_f1(truth, spans, 0, 0.3) == metronome_f1(truth, spans, 0, 0.3) == 0.0


def test_blind_detections_fall_only_into_the_spans():
    spans = np.array([[0.0, 1.0], [10.0, 11.0]])
    everywhere = np.array([0.5, 10.5])
    assert metronome_f1(everywhere, spans, 2, 0.5) == 1.0
    assert random_f1(np.array([5.0]), spans, 5, 3.9) == 0.0


def test_hits_misses_and_false_steps_are_counted():
    result = score(steps(1, 2, 3, 4), [1.05, 2.1, 2.5, 4.2])
    assert (result.truth, result.detected, result.matched) == (4, 4, 2)
    assert (result.precision, result.recall, result.f1) == (0.5, 0.5, 0.5)
    assert (result.count_truth, result.count_error, result.count_error_signed) == (4, 0, 0)


def test_detections_may_come_in_any_order():
    assert score(steps(1, 2, 3), [3, 1, 2]) == score(steps(1, 2, 3), [1, 2, 3])


def test_steps_are_scored_only_where_people_walk_widened_by_the_tolerance():
    labels = [*steps(0.5, 2, 3, 9), span("walking", 2, 3), span("walking", 2.5, 4)]
    result = score(labels, [0.5, 1.9, 2.5, 4.11, 4.2, 8])
    assert (result.truth, result.detected, result.matched) == (2, 3, 1)


def test_nothing_is_scored_where_it_is_to_be_ignored():
    labels = [*steps(1, 2, 3), span("ignore", 1.5, 2.5)]
    result = score(labels, [1, 1.7, 2, 3])
    assert (result.truth, result.detected, result.f1) == (2, 2, 1.0)


def test_a_detection_in_an_ignored_part_may_answer_a_step_beside_it():
    labels = [*steps(1, 2), span("ignore", 1.05, 1.5)]
    assert score(labels, [1.08, 2]).f1 == 1.0


def test_a_detection_in_an_ignored_part_does_not_push_out_a_better_answer():
    labels = [*steps(1, 2), span("ignore", 0, 0.95)]
    result = score(labels, [0.93, 1.01, 2])
    assert (result.detected, result.matched) == (2, 2)
    assert result.latency_ms.median == pytest.approx(5.0)


def test_a_chain_of_answers_may_begin_in_an_ignored_part():
    labels = [*steps(1.0, 1.1), span("ignore", 0, 0.97)]
    assert score(labels, [0.95, 1.05]).matched == 2


def test_all_ignored_leaves_nothing_to_score():
    result = score([*steps(1, 2), span("ignore", -1, 70)], [1, 2])
    assert (result.truth, result.detected, result.f1, result.chance_f1) == (0, 0, 0.0, 0.0)
    assert result.latency_ms is None


def test_counts_are_half_open_and_their_errors_do_not_cancel():
    labels = [span("count", 0, 10, 3), span("count", 10, 20, 2)]
    result = score(labels, [1, 2, 10, 11, 12])
    assert (result.count_truth, result.count_error, result.count_error_signed) == (5, 2, 0)
    assert (result.truth, result.f1) == (0, 0.0)


def test_without_counts_steps_are_counted_span_by_span():
    labels = [*steps(1, 2, 11, 12), span("walking", 0, 5), span("walking", 10, 15)]
    result = score(labels, [1, 1.5, 2, 11])
    assert (result.count_truth, result.count_error, result.count_error_signed) == (4, 2, 0)


def test_truth_without_steps_or_counts_gives_no_score():
    assert score([Label(START, "impact"), span("walking", 0, 3)], [1.0]) is None


def test_no_detections_is_a_score_of_zero():
    result = score(steps(1, 2), [])
    assert (result.detected, result.precision, result.recall, result.f1) == (0, 0.0, 0.0, 0.0)
    assert (result.f1_debiased, result.chance_f1, result.chance_f1_metronome) == (0.0, 0.0, 0.0)
    assert result.latency_ms is None
    assert result.count_error_signed == -2


def test_a_constant_latency_looks_like_a_collapse_and_is_taken_out():
    truth = walk()
    late = truth + 0.12
    result = score(steps(*truth), late, end=300.0, tolerance_s=0.05)
    assert result.f1 < 0.02
    assert result.f1_debiased == 1.0
    assert dict(result.curve)[0.25] == 1.0


def test_latency_is_of_matched_steps_in_milliseconds():
    result = score(steps(1, 2, 3, 4), [1.02, 2.04, 3.06, 4.5])
    assert result.latency_ms.median == pytest.approx(40.0, abs=1e-3)
    assert result.latency_ms.iqr == pytest.approx(20.0, abs=1e-3)


def test_the_curve_is_f1_over_tolerance_and_rises():
    truth = walk(count=60)
    found = truth + np.random.default_rng(2).normal(0, 0.1, 60)
    curve = score(steps(*truth), found).curve
    tolerances, values = zip(*curve, strict=True)
    assert list(tolerances) == sorted(tolerances)
    assert (np.diff(values) >= 0).all()
    assert values[5] == pytest.approx(f1_of(truth, np.sort(found), 0.12), abs=0.02)
