"""Confidence: the steps of a sweep, or the recordings of a fleet, drawn again and again."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

DRAWS = 200
#: Recordings are drawn more often, since that costs little; so many draws at once.
RECORDING_DRAWS, AT_ONCE = 2000, 50
SEED = 20_170_319
#: Ends of the interval that holds nine of ten draws [%].
ENDS = (5.0, 95.0)


@dataclass(frozen=True, slots=True, eq=False)
class Verdicts:
    """How one setting did on one recording, step by step.

    Attributes
    ----------
    hit
        Shape (n_truth,), bool: which true steps are found.
    false_ns
        Times of the detections that answer no true step [ns].
    """

    hit: NDArray[np.bool_]
    false_ns: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Interval:
    """An interval that holds nine of ten draws."""

    low: float
    high: float


@dataclass(frozen=True, slots=True, eq=False)
class Confidence:
    """How sure the F1 of settings is.

    Attributes
    ----------
    f1
        Of each setting.
    behind
        How far each setting is behind the first one.
    """

    f1: tuple[Interval, ...]
    behind: tuple[Interval, ...]

    def worse(self, row: int) -> bool:
        """Whether a setting is told apart from the first one, as the worse."""
        return self.behind[row].low > 0


@dataclass(frozen=True, slots=True, eq=False)
class Sums:
    """A figure of many recordings as the ratio of two sums: a pooled F1, or a mean.

    Attributes
    ----------
    top, bottom
        What each recording adds to either, shape (n,).
    """

    top: NDArray[np.float64]
    bottom: NDArray[np.float64]

    def value(self) -> float:
        """Return the figure; NaN where nothing is summed."""
        bottom = float(self.bottom.sum())
        return float(self.top.sum()) / bottom if bottom else float("nan")


def bootstrap_recordings(
    before: Sums, after: Sums, draws: int = RECORDING_DRAWS
) -> Interval | None:
    """Return the interval of a figure's change over recordings, those of both in the same order.

    Recordings are drawn with replacement, each with all its steps: steps of one recording are
    alike, and so are the two figures of one, which are always drawn together. The seed is fixed.

    Returns
    -------
    The interval of after minus before, or None where a draw may have no figure.
    """
    rng = np.random.default_rng(SEED)
    n = len(before.top)
    if not n:
        return None
    changes = []
    for size in [AT_ONCE] * (draws // AT_ONCE):
        times = rng.multinomial(n, np.full(n, 1 / n), size=size).astype(np.float64)
        bottoms = times @ before.bottom, times @ after.bottom
        if not (bottoms[0].all() and bottoms[1].all()):
            return None
        changes.append(times @ after.top / bottoms[1] - times @ before.top / bottoms[0])
    return _intervals(np.concatenate(changes)[:, None])[0]


def bootstrap(settings: Sequence[Sequence[Verdicts]], draws: int = DRAWS) -> Confidence:
    """Return the confidence of settings, each a sequence of verdicts, one for each recording.

    True steps are drawn with replacement; every false detection counts as often as a Poisson
    number of mean 1 says. All settings see the same draws, so that two which err at the same steps
    are compared at the same steps. The seed is fixed: the same verdicts give the same intervals.
    """
    rng = np.random.default_rng(SEED)
    hit = np.array([np.concatenate([v.hit for v in s]) for s in settings], np.float64)
    false = _occurrence(settings)
    n = hit.shape[1]
    steps = rng.multinomial(n, np.full(n, 1 / n), size=draws).astype(np.float64)
    found = steps @ hit.T
    wrong = rng.poisson(1.0, (draws, false.shape[1])).astype(np.float64) @ false.T
    f1 = 2 * found / (n + found + wrong)
    return Confidence(_intervals(f1), _intervals(f1[:, :1] - f1))


def _occurrence(settings: Sequence[Sequence[Verdicts]]) -> NDArray[np.float64]:
    """Return which false detections each setting has, of all that any has."""
    keys = [[(r, t) for r, v in enumerate(s) for t in v.false_ns.tolist()] for s in settings]
    column = {key: i for i, key in enumerate(sorted({key for found in keys for key in found}))}
    out = np.zeros((len(settings), len(column)))
    for row, found in enumerate(keys):
        for key in found:
            out[row, column[key]] += 1
    return out


def _intervals(values: NDArray[np.float64]) -> tuple[Interval, ...]:
    low, high = np.percentile(values, ENDS, axis=0)
    return tuple(Interval(float(a), float(b)) for a, b in zip(low, high, strict=True))
