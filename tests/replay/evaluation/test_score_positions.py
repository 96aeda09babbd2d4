"""Scores of fixes, headings, disturbances and of what covariances promise."""

from __future__ import annotations

import math

import numpy as np
import pytest

from groundtrace.evaluation.headings import score_disturbances, score_headings
from groundtrace.evaluation.positions import match_places, score_positions, true_places
from groundtrace.evaluation.report import score_events
from groundtrace.evaluation.tracks import consistency, normalised_squares, score_consistency
from groundtrace.explain.compare import compare_places
from groundtrace_codecs.events import Disturbance, Fix, Heading, Label, StageSpec, TrackPoint

NAN3 = (math.nan,) * 3
SECOND = 10**9


def ns(seconds: float) -> int:
    return round(seconds * 1e9)


def place(seconds: float, x_m: float, y_m: float, kind: str = "step") -> Label:
    return Label(ns(seconds), kind, x_m=x_m, y_m=y_m)


def fix(seconds: float, x_m: float, y_m: float, picks: int = 9, stage: str = "locate") -> Fix:
    return Fix(ns(seconds), x_m, y_m, NAN3, 0.0, "so-tdoa", picks, stage)


def test_errors_of_fixes_are_summed_up_by_axis_and_radius() -> None:
    truth = [place(k, k, 0) for k in range(4)]
    fixes = [fix(0.05, 0.3, 0.4), fix(1, 1, 1), fix(2, 2, 0, 5), fix(3.1, 3, -2, 5), fix(3.5, 9, 9)]
    score = score_positions(truth, fixes)
    assert score is not None
    assert (score.truth, score.found, score.n, score.stage) == (4, 5, 4, "locate")
    assert score.rmse_m == pytest.approx(math.sqrt((0.25 + 1 + 0 + 4) / 4))
    assert score.cep50_m == pytest.approx(0.75)
    assert score.cep95_m == pytest.approx(np.percentile([0.5, 1, 0, 2], 95))
    assert (score.bias_x_m, score.bias_y_m) == pytest.approx((0.075, -0.15))
    assert [(e.group, e.n) for e in score.by_picks] == [("5", 2), ("9", 2)]
    assert score.by_picks[0].rmse_m == pytest.approx(math.sqrt(2))


def test_every_stage_is_scored_and_the_last_one_counts() -> None:
    fixes = [
        fix(0, 1, 0, stage="coarse"),
        fix(0, 0, 0.5, stage="fine"),
        fix(1, 2, 0, stage="coarse"),
    ]
    score = score_positions([place(0, 0, 0), place(1, 0, 0)], fixes)
    assert score is not None
    assert (score.stage, score.n, score.rmse_m) == ("fine", 1, pytest.approx(0.5))
    assert [(e.group, e.n) for e in score.by_stage] == [("coarse", 2), ("fine", 1)]


def test_the_last_one_is_that_of_the_pipeline_though_another_was_slower_to_find_a_place() -> None:
    stated = [StageSpec(name, name, "/s", (), (), (), (), "fix") for name in ("coarse", "fine")]
    fixes = [fix(0, 0, 0.5, stage="fine"), fix(1, 2, 0, stage="coarse"), fix(1, 1, 0, stage="fine")]
    events = [*stated, *fixes]
    score = score_events([place(0, 0, 0), place(1, 1, 0)], events, 0, ns(2)).positions
    assert score is not None
    assert (score.stage, score.n) == ("fine", 2)
    compared = compare_places(events, [*stated, fixes[1]], [], 0, 0.1)
    assert compared is not None
    assert (compared.a, compared.b) == (2, 1)


def test_a_far_fix_still_answers_and_a_late_one_does_not() -> None:
    score = score_positions([place(0, 0, 0)], [fix(0.1, 50, 0)])
    assert score is not None
    assert score.rmse_m == pytest.approx(50)
    late = score_positions([place(0, 0, 0)], [fix(0.2, 0, 0)])
    assert late is not None
    assert (late.n, late.rmse_m, late.bias_x_m) == (0, None, None)
    wide = score_positions([place(0, 0, 0)], [fix(0.2, 0, 0)], tolerance_s=0.3)
    assert wide is not None
    assert wide.n == 1


def test_two_walkers_in_step_are_told_apart_by_place() -> None:
    truth = [place(k, x, 0) for k in range(5) for x in (0.0, 6.0)]
    fixes = [fix(k + 0.01 * (x > 3), 6.1 - x, 0) for k in range(5) for x in (0.0, 6.0)]
    score = score_positions(truth, fixes)
    assert score is not None
    assert (score.n, score.rmse_m) == (10, pytest.approx(0.1))


def test_a_dense_truth_is_answered_at_its_nearest_time() -> None:
    truth = [place(0.01 * k, 0.01 * k, 0, "waypoint") for k in range(1000)]
    found = [fix(0.5 * k + 0.001, 0.5 * k, 0) for k in range(1, 19)]
    score = score_positions(truth, found)
    assert score is not None
    assert score.n == 18
    assert score.rmse_m == pytest.approx(0, abs=1e-9)


def test_nothing_is_scored_where_truth_says_ignore_and_steps_come_before_waypoints() -> None:
    truth = [
        place(0, 0, 0),
        place(1, 0, 0),
        place(1, 5, 5, "waypoint"),
        Label(ns(1), "ignore", ns(2)),
    ]
    places = true_places(truth)
    assert places.time_ns.tolist() == [0]
    assert score_positions(truth, []) is None
    none = score_positions(truth, [], told_by="place")
    assert none is not None
    assert (none.stage, none.found, none.n) == ("place", 0, 0)
    assert score_positions([Label(0, "step")], [fix(0, 0, 0)]) is None
    assert match_places(places, true_places([]), 1.0).shape == (0, 2)


def heading(seconds: float, degrees: float) -> Heading:
    return Heading(ns(seconds), math.radians(degrees), 0.1, "compass")


def true_heading(seconds: float, degrees: float) -> Label:
    return Label(ns(seconds), "heading", value=math.radians(degrees))


def test_headings_are_compared_the_shorter_way_round() -> None:
    truth = [true_heading(0, 179), true_heading(1, -179), true_heading(2, 0)]
    said = [heading(0, -179), heading(1, 179), heading(2, 358)]
    score = score_headings(truth, said)
    assert score is not None
    assert score.rmse_deg == pytest.approx(2)
    assert score.bias_deg == pytest.approx(-2 / 3, abs=1e-3)
    assert (score.n, score.truth) == (3, 3)


def test_between_close_headings_the_direction_turns_evenly() -> None:
    truth = [true_heading(t, d) for t, d in ((0.25, 177.5), (0.75, -177.5), (3.0, 0), (3.4, 0))]
    said = [heading(0, 175), heading(1, -175), heading(3.1, 1)]
    score = score_headings(truth, said)
    assert score is not None
    # 3.0 has a heading within the tolerance, 3.4 has none
    assert (score.truth, score.n) == (4, 3)
    assert score.rmse_deg == pytest.approx(math.sqrt(1 / 3))


def test_headings_that_answer_nothing_have_no_error() -> None:
    score = score_headings([true_heading(0, 0)], [heading(50, 0)])
    assert score is not None
    assert (score.n, score.rmse_deg, score.bias_deg, score.p95_deg) == (0, None, None, None)
    assert score_headings([], [heading(0, 0)]) is None
    assert score_headings([true_heading(0, 0)], []) is None


def disturbance(begin: float, end: float) -> Disturbance:
    return Disturbance(ns(begin), ns(end), 1.0, "compass")


def disturbed(begin: float, end: float, kind: str = "disturbed") -> Label:
    return Label(ns(begin), kind, ns(end))


def test_disturbances_are_scored_by_overlap_in_time() -> None:
    said = [disturbance(3, 6), disturbance(5, 6), disturbance(8, 9)]
    score = score_disturbances([disturbed(2, 5)], said, 0, 10 * SECOND)
    assert score is not None
    assert (score.truth_s, score.found_s, score.both_s) == pytest.approx((3, 4, 2))
    assert (score.precision, score.recall) == pytest.approx((0.5, 2 / 3))
    assert score.f1 == pytest.approx(4 / 7)


def test_disturbances_outside_the_recording_and_in_ignored_time_do_not_count() -> None:
    truth = [disturbed(2, 5), disturbed(4, 20, "ignore")]
    score = score_disturbances(truth, [disturbance(-5, 3), disturbance(4, 40)], 0, 10 * SECOND)
    assert score is not None
    assert (score.truth_s, score.found_s, score.both_s) == pytest.approx((2, 3, 1))
    assert score_disturbances([], [disturbance(0, 1)], 0, SECOND) is None
    assert score_disturbances(truth, [], 0, SECOND) is None


def test_normalised_squares_are_those_of_the_inverse() -> None:
    rng = np.random.default_rng(0)
    roots = rng.normal(size=(50, 3, 3))
    covariances = roots @ roots.transpose(0, 2, 1) + 0.1 * np.eye(3)
    vectors = rng.normal(size=(50, 3))
    expected = [v @ np.linalg.inv(p) @ v for v, p in zip(vectors, covariances, strict=True)]
    np.testing.assert_allclose(normalised_squares(vectors, covariances), expected)


def test_squares_of_unknown_or_impossible_covariances_are_unknown() -> None:
    covariances = np.array([np.eye(2), np.full((2, 2), np.nan), [[1, 2], [2, 1]], np.zeros((2, 2))])
    found = normalised_squares(np.ones((4, 2)), covariances)
    np.testing.assert_array_equal(found, [2, np.nan, np.nan, np.nan])
    assert consistency(found[1:], 2) is None


def test_an_honest_estimate_keeps_its_bounds_and_a_boastful_one_does_not() -> None:
    errors = np.random.default_rng(3).normal(0, 0.5, (400, 2))
    honest = consistency(normalised_squares(errors, np.full((400, 2, 2), np.eye(2) * 0.25)), 2)
    boast = consistency(normalised_squares(errors, np.full((400, 2, 2), np.eye(2) * 0.04)), 2)
    assert honest is not None
    assert boast is not None
    assert honest.consistent
    assert honest.inside_fraction == pytest.approx(0.95, abs=0.03)
    # chi-square with 800 degrees of freedom, over 400
    assert (honest.lower, honest.upper) == pytest.approx((1.8088, 2.2007), abs=1e-3)
    assert not boast.consistent
    assert boast.mean > boast.upper


def test_consistency_is_told_of_fixes_tracks_and_innovations() -> None:
    truth = [place(k, 0, 0) for k in range(3)]
    fixes = [Fix(ns(k), 1, 0, (1.0, 0.0, 1.0), 0.0, "m", 4, "locate") for k in range(3)]
    points = [TrackPoint(ns(k), 1, 0, 2, 0, 0, (1.0, 0.0, 4.0), "track", 3.0) for k in range(2)]
    score = score_consistency(truth, fixes, points)
    assert score is not None
    assert score.nees_fixes is not None
    assert score.nees_tracks is not None
    assert score.nis is not None
    assert (score.nees_fixes.mean, score.nees_tracks.mean, score.nis.mean) == (1, 1, 3)
    assert (score.nees_fixes.n, score.nees_tracks.n, score.nis.n) == (3, 2, 2)
    assert score_consistency(truth, [fix(0, 0, 0)], []) is None


def test_a_result_is_scored_for_what_truth_and_answers_have_in_common() -> None:
    truth = [place(0, 0, 0), true_heading(0, 0), disturbed(0, 1)]
    events = [fix(0, 1, 0), heading(0, 3), disturbance(0, 1)]
    score = score_events(truth, events, 0, SECOND)
    assert score.positions is not None
    assert score.heading is not None
    assert score.disturbance is not None
    assert score.steps is not None
    assert score.track is score.picks is score.consistency is None
    nothing = score_events([], events, 0, SECOND)
    assert nothing.positions is nothing.heading is nothing.disturbance is nothing.steps is None
