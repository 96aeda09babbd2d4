"""Assignment, OSPA, GOSPA and SIAP: golden values, and Stone Soup as an oracle."""

from __future__ import annotations

import itertools
from datetime import datetime, timedelta
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sweeps import examples

from groundtrace.dsp.assignment import assign
from groundtrace.evaluation.matching import match
from groundtrace.evaluation.tracks import gospa, ospa, score_tracks
from groundtrace_codecs.events import Label, TrackPoint

if TYPE_CHECKING:
    from numpy.typing import NDArray

NAN3 = (float("nan"),) * 3
X = np.array([(1, 3), (4, 4)], float)
Y = np.array([(1.3, 3.4)])
Z = np.array([(1.3, 3.4), (4, 5), (9, 9)])


@pytest.mark.parametrize(
    ("p", "other", "expected"), [(1, Y, 1.25), (1, Z, 1.166667), (2, Y, 1.457738), (2, Z, 1.322876)]
)
def test_ospa_has_its_golden_values(p: float, other: NDArray[np.float64], expected: float) -> None:
    assert ospa(X, other, 2, p) == pytest.approx(expected, abs=1e-6)
    assert ospa(other, X, 2, p) == pytest.approx(expected, abs=1e-6)


def test_gospa_has_its_golden_values_and_parts() -> None:
    found = gospa(X, Y, 2, 2)
    assert found.distance == pytest.approx(1.5)
    assert (found.localisation, found.missed, found.false) == pytest.approx((0.25, 2, 0))
    found = gospa(X, Z, 2, 2)
    assert found.distance == pytest.approx(1.802776, abs=1e-6)
    assert (found.localisation, found.missed, found.false) == pytest.approx((1.25, 0, 2))
    assert found.pairs == 2


def test_a_pair_beyond_the_cut_off_is_missed_and_false() -> None:
    found = gospa(X[:1], np.array([(50.0, 50.0)]), 2, 2)
    assert (found.localisation, found.missed, found.false, found.pairs) == (0, 2, 2, 0)
    assert gospa(X[:1], np.array([(50.0, 50.0)]), 2, 2, alpha=1).distance == pytest.approx(2)


def test_nothing_is_as_far_from_something_as_the_cut_off() -> None:
    nothing = np.empty((0, 2))
    assert ospa(nothing, nothing, 2, 2) == 0
    assert gospa(nothing, nothing, 2, 2).distance == 0
    assert ospa(X, nothing, 2, 1) == 2
    assert gospa(nothing, Y, 2, 2).false == 2


places = st.lists(st.tuples(st.floats(-5, 5), st.floats(-5, 5)), max_size=5).map(
    lambda rows: np.array(rows, float).reshape(-1, 2)
)


@settings(max_examples=examples(60), deadline=None)
@given(x=places, y=places, c=st.floats(0.5, 5), p=st.sampled_from([1.0, 2.0]))
def test_ospa_and_gospa_are_those_of_stone_soup(
    x: NDArray[np.float64], y: NDArray[np.float64], c: float, p: float
) -> None:
    metrics = pytest.importorskip("stonesoup.metricgenerator.ospametric")
    measures = pytest.importorskip("stonesoup.measures")
    states = pytest.importorskip("stonesoup.types.state")
    now = datetime(2026, 1, 1)
    a, b = ([states.State(row.reshape(2, 1), timestamp=now) for row in z] for z in (x, y))
    measure = measures.Euclidean((0, 1))
    if len(x) or len(y):
        oracle = metrics.OSPAMetric(c=c, p=p, measure=measure)
        value = oracle.compute_OSPA_distance(b, a).value
        # Stone Soup assigns by d, the definition by d^p: for p > 1 it may miss the minimum.
        assert ospa(x, y, c, p) <= value + 1e-9
        assert p > 1 or ospa(x, y, c, p) == pytest.approx(value, abs=1e-9)
    if len(x) and len(y):
        oracle = metrics.GOSPAMetric(c=c, p=p, measure=measure)
        value = oracle.compute_gospa_metric(b, a)[0].value
        ours = gospa(x, y, c, p)
        assert ours.distance == pytest.approx(value["distance"], abs=1e-9)
        parts = (ours.localisation, ours.missed, ours.false)
        theirs = (value["localisation"], value["missed"], value["false"])
        assert sum(parts) == pytest.approx(sum(theirs), abs=1e-9)


def test_ospa_takes_the_least_sum_of_powers() -> None:
    x, y = np.array([(0, 0), (0, -0.5)]), np.array([(0, -0.5), (0, -1)])
    assert ospa(x, y, 1, 2) == pytest.approx(0.5)


def best_by_trying(cost: NDArray[np.float64], gate: float) -> tuple[int, float]:
    """Return the size and cost of the best assignment of at most 4 x 4, by trying all."""
    best = (0, 0.0)
    n, m = cost.shape
    for k in range(1, min(n, m) + 1):
        for rows in itertools.combinations(range(n), k):
            for columns in itertools.permutations(range(m), k):
                chosen = cost[list(rows), list(columns)]
                if (chosen <= gate).all():
                    best = min(best, (-k, float(chosen.sum())))
    return -best[0], best[1]


@settings(max_examples=examples(150), deadline=None)
@given(
    n=st.integers(1, 4), m=st.integers(1, 4), gate=st.floats(0.1, 9.9), seed=st.integers(0, 10**6)
)
def test_no_larger_and_no_cheaper_assignment_is_allowed(
    n: int, m: int, gate: float, seed: int
) -> None:
    cost = np.random.default_rng(seed).uniform(0, 10, (n, m))
    pairs = assign(cost, gate)
    chosen = cost[pairs[:, 0], pairs[:, 1]]
    assert (chosen <= gate).all()
    assert len(set(pairs[:, 0].tolist())) == len(set(pairs[:, 1].tolist())) == len(pairs)
    size, total = best_by_trying(cost, gate)
    assert len(pairs) == size
    assert chosen.sum() == pytest.approx(total)


def test_two_pointers_find_as_many_pairs_as_the_assignment() -> None:
    rng = np.random.default_rng(1)
    for _ in range(300):
        truth, found = (np.sort(rng.uniform(0, 5, rng.integers(0, 12))) for _ in range(2))
        late = np.abs(truth[:, None] - found[None, :])
        assert len(match(truth, found, 0.3)) == len(assign(late, 0.3))


def test_impossible_pairs_are_never_made() -> None:
    cost = np.array([[np.inf, 1.0], [np.nan, np.inf]])
    assert assign(cost, np.inf).tolist() == [[0, 1]]
    assert assign(np.empty((0, 3)), 1.0).shape == (0, 2)


def truth_at(seconds: float, x_m: float, y_m: float, kind: str = "waypoint") -> Label:
    return Label(round(seconds * 1e9), kind, x_m=x_m, y_m=y_m)


def point(seconds: float, track: int, x_m: float, y_m: float) -> TrackPoint:
    return TrackPoint(round(seconds * 1e9), track, x_m, y_m, 0.0, 0.0, NAN3, "track")


def two_walkers() -> tuple[list[Label], list[TrackPoint]]:
    """Two walkers for 10 s: one tracked, then twice, one lost half way; a ghost at the end."""
    labels, points = [], []
    for k in range(11):
        labels += [truth_at(k, 0.3 * k, 0.0), truth_at(k, 0.3 * k, 8.0)]
        points.append(point(k, 1, 0.3 * k + 0.1, 0.0))
        points += [point(k, 2, 0.3 * k, 8.2)] if k < 5 else []
        points += [point(k, 3, 0.3 * k, -0.4)] if k > 6 else []
        points += [point(k, 4, 30.0, 30.0)] if k > 8 else []
    return labels, points


def test_siap_counts_what_is_covered_twice_and_for_nothing() -> None:
    score = score_tracks(*two_walkers())
    assert score is not None
    assert score.completeness == pytest.approx((11 + 5) / 22)
    assert score.ambiguity == pytest.approx((11 + 5 + 4) / 16)
    assert score.spuriousness == pytest.approx(2 / 22)
    assert score.accuracy_m == pytest.approx((11 * 0.1 + 5 * 0.2 + 4 * 0.4) / 20)
    assert (score.times, score.tracks, score.missed, score.false) == (11, 4, 6, 6)


def soup_siap(labels: list[Label], points: list[TrackPoint]) -> dict[str, float]:
    """Return the SIAP of Stone Soup."""
    from stonesoup.dataassociator.tracktotrack import TrackToTruth
    from stonesoup.measures import Euclidean
    from stonesoup.metricgenerator.manager import MultiManager
    from stonesoup.metricgenerator.tracktotruthmetrics import SIAPMetrics
    from stonesoup.types.groundtruth import GroundTruthPath, GroundTruthState
    from stonesoup.types.state import State
    from stonesoup.types.track import Track

    epoch = datetime(2026, 1, 1)

    def state(kind: Any, event: Any) -> Any:
        vector = np.array([[event.x_m], [event.y_m]])
        return kind(vector, timestamp=epoch + timedelta(seconds=event.time_ns / 1e9))

    paths = {
        GroundTruthPath([state(GroundTruthState, x) for x in labels if x.y_m == y])
        for y in {x.y_m for x in labels}
    }
    tracks = {
        Track([state(State, p) for p in points if p.track == i]) for i in {p.track for p in points}
    }
    measure = Euclidean((0, 1))
    siap = SIAPMetrics(measure, measure, tracks_key="tracks", truths_key="truths")
    associator = TrackToTruth(association_threshold=2.0, measure=measure)
    manager = MultiManager([siap], associator=associator)
    manager.add_data({"truths": paths, "tracks": tracks})
    metrics = manager.generate_metrics()
    return {m.title: m.value for found in metrics.values() for m in found.values()}


def test_siap_is_that_of_stone_soup() -> None:
    pytest.importorskip("stonesoup")
    labels, points = two_walkers()
    score = score_tracks(labels, points)
    oracle = soup_siap(labels, points)
    assert score is not None
    assert score.completeness == pytest.approx(oracle["SIAP Completeness"])
    assert score.ambiguity == pytest.approx(oracle["SIAP Ambiguity"])
    assert score.spuriousness == pytest.approx(oracle["SIAP Spuriousness"])
    assert score.accuracy_m == pytest.approx(oracle["SIAP Position Accuracy"])


def test_a_track_is_there_between_its_points_and_not_in_its_long_gaps() -> None:
    labels = [truth_at(s, s, 0.0, "step") for s in (0.5, 1.0, 3.0, 6.05, 7.0)]
    points = [point(s, 1, s, 0.0) for s in (0.0, 1.5, 5.0, 6.0)]
    score = score_tracks(labels, points)
    assert score is not None
    # 3.0 lies in a gap of 3.5 s, 7.0 after the end; 6.05 is within the tolerance of the end
    assert (score.times, score.missed, score.false) == (5, 2, 0)
    assert score.accuracy_m == pytest.approx(0.05 / 3)


def test_without_truth_or_tracks_there_is_no_score() -> None:
    assert score_tracks([], [point(0, 1, 0.0, 0.0)]) is None
    assert score_tracks([truth_at(0, 0.0, 0.0)], []) is None
