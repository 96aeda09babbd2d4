"""Length, end and shape of tracks in a frame of their own."""

from __future__ import annotations

import numpy as np
import pytest

from groundtrace.evaluation.tracks import score_tracks
from groundtrace_codecs.events import Label, TrackPoint

NONE = (float("nan"),) * 3


def walk(places: np.ndarray, track: int = 1, every_ns: int = 10**9) -> list[TrackPoint]:
    return [
        TrackPoint(k * every_ns, track, float(x), float(y), 0.0, 0.0, NONE, "track")
        for k, (x, y) in enumerate(places)
    ]


def truth(places: np.ndarray, target: str = "") -> list[Label]:
    return [
        Label(k * 10**9, "waypoint", x_m=float(x), y_m=float(y), target=target)
        for k, (x, y) in enumerate(places)
    ]


SQUARE = np.array([(0, 0), (2, 0), (2, 2), (0, 2), (0, 0)], float)


def test_a_square_elsewhere_and_turned_is_a_square() -> None:
    turn = np.array([(0.6, -0.8), (0.8, 0.6)])
    score = score_tracks(truth(SQUARE), walk(SQUARE @ turn + [5, 7]))
    assert score is not None
    assert score.closure is not None
    assert score.closure.walked_m == pytest.approx(8)
    assert score.closure.percent == pytest.approx(0, abs=1e-9)
    assert score.closure.aligned_rmse_m == pytest.approx(0, abs=1e-9)


def test_a_mirrored_square_is_not() -> None:
    found = score_tracks(truth(SQUARE[:4]), walk(SQUARE[:4] * [1, -1]))
    assert found is not None
    assert found.closure is not None
    assert found.closure.aligned_rmse_m > 1


def test_what_lacks_at_the_end_is_a_part_of_the_way() -> None:
    open_ = np.array([(0, 0), (2, 0), (2, 2), (0, 2), (0, 0.6)], float)
    found = score_tracks(truth(SQUARE), walk(open_))
    assert found is not None
    assert found.closure is not None
    assert found.closure.apart_m == pytest.approx(0.6)
    assert found.closure.percent == pytest.approx(100 * 0.6 / 7.4)


def test_two_places_suffice_for_the_end_but_not_for_the_shape() -> None:
    only = [truth(SQUARE)[0], truth(SQUARE)[-1]]
    found = score_tracks(only, walk(SQUARE))
    assert found is not None
    assert found.closure is not None
    assert (found.closure.walked_m, found.closure.aligned_rmse_m) == (pytest.approx(8), None)


def test_several_tracks_or_targets_have_none() -> None:
    two_tracks = score_tracks(truth(SQUARE), walk(SQUARE) + walk(SQUARE, 2))
    two_targets = score_tracks(truth(SQUARE, "a") + truth(SQUARE + 1, "b"), walk(SQUARE))
    crowd = score_tracks(truth(SQUARE) + truth(SQUARE + 1), walk(SQUARE))
    still = score_tracks(truth(SQUARE), walk(0 * SQUARE))
    for found in (two_tracks, two_targets, crowd, still):
        assert found is not None
        assert found.closure is None
