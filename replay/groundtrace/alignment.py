"""How far the clocks of two recordings differ, by the moments of what both have recorded.

Steps are nearly periodic: shifted by one step two walks still fit. What tells the right shift is
what is not periodic: intervals that vary, starts, stops. Every shift that could be right is judged
by how much likelier its coincidences are than chance; where the second best is nearly as good, the
alignment is ambiguous and says so.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.clocks import DeviceClock, robust_line
from groundtrace_codecs.signals import NS_PER_S

from .alignment_search import DRIFT_MAX_PPM, coinciding
from .alignment_shift import Judged, Shift, needed

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: Fewest moments that agree.
LEAST_MATCHED = 5
#: The drift is estimated where its deviation is at most this [1e-6]: crystals differ by more.
DRIFT_SIGMA_PPM = 15.0
#: Two shifts nearer than this are one [s].
_APART_S = 0.12
#: Moments further apart on the whole are taken to be so far apart [s].
_LONGEST_S = 2.0
#: A shift without a second one must be this much likelier than chance.
_CHANCE = 8.0
#: Scatter of moments that is taken for known before any are compared [s], and its weight.
_USUAL_S, _USUAL_WEIGHT = 0.015, 4
_MAD_SIGMA = 1.4826


@dataclass(frozen=True, slots=True, eq=False)
class Moments:
    """What happened in a recording, and when it recorded.

    Attributes
    ----------
    times_ns
        Shape (n,), ascending [ns].
    start_ns, end_ns
        Of the recording [ns].
    """

    times_ns: NDArray[np.int64]
    start_ns: int
    end_ns: int

    @property
    def times_s(self) -> Array:
        """The moments since the recording's start, shape (n,) [s]."""
        since: Array = (self.times_ns - self.start_ns) / NS_PER_S
        return since

    @property
    def length_s(self) -> float:
        """Length of the recording [s]."""
        return (self.end_ns - self.start_ns) / NS_PER_S


@dataclass(frozen=True, slots=True)
class Alignment:
    """The clock of a recording against that of another.

    Attributes
    ----------
    clock
        The clock.
    best, second
        The shift taken and the best other one; None where there is none.
    """

    clock: DeviceClock
    best: Shift
    second: Shift | None

    @property
    def margin(self) -> float:
        """Logarithm of how much likelier the best shift is than the second best, or than chance."""
        return self.best.score - (self.second.score if self.second is not None else 0.0)

    @property
    def needed(self) -> float:
        """What the margin must be, where as many moments agree with the second best."""
        return needed(self.best)

    @property
    def ambiguous(self) -> bool:
        """True where another shift, or chance, is nearly as good."""
        if self.second is None:
            return self.best.score < _CHANCE
        return not self.best.beats(self.second)


def align(reference: Moments, other: Moments, least: int = LEAST_MATCHED) -> Alignment | None:
    """Find the clock of ``other`` against that of ``reference``.

    Parameters
    ----------
    reference, other
        Moments of the same events, some of which either may lack or have alone.
    least
        Fewest moments that must agree.

    Returns
    -------
    Alignment or None
        None where no shift makes ``least`` moments agree.
    """
    a, b = reference.times_s, other.times_s
    if min(len(a), len(b)) < least:
        return None
    steps = np.concatenate([np.diff(a), np.diff(b)])
    interval_s = min(float(np.median(steps)), _LONGEST_S)
    pair = _Pair(a, b, reference.length_s, other.length_s, interval_s)
    judged = [j for lag, drift in coinciding(a, b) if (j := pair.judged(lag, drift)) is not None]
    judged = [j for j in judged if j.shift.matched >= least]
    if not judged:
        return None
    most = max(judged, key=lambda j: j.shift.matched)
    found = sorted((j.with_alone(most.lacking) for j in judged), key=lambda s: -s.score)
    best = found[0]
    apart = [s for s in found[1:] if abs(s.ahead_s - best.ahead_s) > _APART_S]
    rivals = [s for s in apart if not best.beats(s)]
    ahead_ns = other.start_ns - reference.start_ns + round(best.ahead_s * NS_PER_S)
    clock = DeviceClock(ahead_ns, best.drift_ppm, other.start_ns)
    return Alignment(clock, best, next(iter(rivals or apart), None))


@dataclass(frozen=True, slots=True, eq=False)
class _Pair:
    """Moments of two recordings since their starts, shapes (n,), (m,) [s].

    ``a_length_s`` and ``b_length_s`` are the recordings' lengths, ``interval_s`` is the usual time
    from one moment to the next.
    """

    a: Array
    b: Array
    a_length_s: float
    b_length_s: float
    interval_s: float

    def judged(self, lag_s: float, drift_ppm: float) -> Judged | None:
        """Return what comes of a shift once it is refined; None where nothing agrees."""
        tolerance_s = min(0.35 * self.interval_s, 0.15)
        gained = drift_ppm * 1e-6
        i, j = self._pairs(lag_s, gained, tolerance_s)
        for _ in range(4):
            if len(i) < 2:
                break
            residual = self.b[j] * (1 - gained) - self.a[i]
            lag_s = float(np.median(residual))
            i, j = self._pairs(lag_s, gained, tolerance_s)
        return self._scored(lag_s, gained, i, j)

    def _pairs(
        self, lag_s: float, gained: float, tolerance_s: float
    ) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return which moments are each other's nearest within the tolerance."""
        moved = self.b * (1 - gained) - lag_s
        to_a = _nearest(self.a, moved)
        to_b = _nearest(moved, self.a)
        mutual = to_b[to_a] == np.arange(len(moved))
        near = np.abs(moved - self.a[to_a]) <= tolerance_s
        j = np.flatnonzero(mutual & near)
        return to_a[j], j

    def _scored(
        self, lag_s: float, gained: float, i: NDArray[np.intp], j: NDArray[np.intp]
    ) -> Judged | None:
        if len(i) < 2:
            return None
        ahead = self.b[j] - self.a[i]
        line = robust_line(self.b[j], ahead)
        fitted = line.slope_sigma * 1e6 <= DRIFT_SIGMA_PPM
        fitted &= abs(line.slope) * 1e6 <= 2 * DRIFT_MAX_PPM
        residual = ahead - lag_s - gained * self.b[j]
        if fitted:
            gained, lag_s = line.slope, line.at - line.slope * line.about
            residual = ahead - line.value(self.b[j])
        else:
            gained = 0.0
            lag_s = float(np.median(ahead))
        sigma_s = _scatter(residual)
        count = len(i)
        far = line.slope_sigma * line.about if fitted else 0.0
        inside_a, inside_b = self._inside(lag_s)
        shift = Shift(
            ahead_s=lag_s,
            drift_ppm=gained / (1 - gained) * 1e6,
            matched=count,
            possible=int(min(inside_a.sum(), inside_b.sum())),
            sigma_s=sigma_s,
            ahead_sigma_s=float(np.hypot(1.25 * sigma_s / np.sqrt(count), far)),
            drift_sigma_ppm=line.slope_sigma * 1e6,
            drift_fitted=fitted,
            alone=0.0,
            worth=float(np.log(self.interval_s / (sigma_s * np.sqrt(2 * np.pi * math.e)))),
        )
        runs = _runs_alone(inside_a, i), _runs_alone(inside_b, j)
        return Judged(shift, runs, (int(inside_a.sum()), int(inside_b.sum())))

    def _inside(self, lag_s: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return which moments of each, (n,) and (m,), lie where the other recorded too."""
        a = (self.a + lag_s >= 0) & (self.a + lag_s <= self.b_length_s)
        b = (self.b - lag_s >= 0) & (self.b - lag_s <= self.a_length_s)
        return a, b


def _runs_alone(inside: NDArray[np.bool_], partnered: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the lengths of runs of moments (n,) inside that lack a partner."""
    alone = inside.copy()
    alone[partnered] = False
    edges = np.flatnonzero(np.diff(np.concatenate([[0], alone[inside].astype(np.int8), [0]])))
    lengths: NDArray[np.intp] = edges[1::2] - edges[::2]
    return lengths


def _scatter(residual: Array) -> float:
    """Return the deviation of residuals (n,), few of them wrong, drawn to the usual one [s]."""
    residual = residual - np.median(residual)
    limit = 3 * _MAD_SIGMA * float(np.median(np.abs(residual)))
    square = float(np.mean(residual[np.abs(residual) <= limit] ** 2))
    count, prior = len(residual), _USUAL_WEIGHT
    return float(np.sqrt((count * square + prior * _USUAL_S**2) / (count + prior)))


def _nearest(sorted_: Array, values: Array) -> NDArray[np.intp]:
    """Return which of ``sorted_`` (n,) is nearest to each of ``values`` (m,)."""
    right = np.clip(np.searchsorted(sorted_, values), 1, max(len(sorted_) - 1, 1))
    right = np.minimum(right, len(sorted_) - 1)
    left = np.maximum(right - 1, 0)
    nearer = np.abs(values - sorted_[left]) <= np.abs(sorted_[right] - values)
    found: NDArray[np.intp] = np.where(nearer, left, right)
    return found
