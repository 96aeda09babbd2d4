"""The reference of places: where somebody was when a step was located, as far as known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.events import Fix
from groundtrace_codecs.signals import NS_PER_S

from ..score.picks import ANSWER_S
from ..score.places import found_places, match_places, true_places

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import TrackPoint

    from ..score.places import Places
    from .evidence import Evidence
    from .relocate import Located, Relocator

    Array = NDArray[np.float64]

#: A track tells nothing about steps further than this from its points [s].
REACH_S = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """Where somebody was.

    Attributes
    ----------
    kind
        ``truth``, ``track`` (where the tracker has them) or ``none``.
    xy
        Shape (m, 2) [m]; NaN where unknown.
    """

    kind: str
    xy: Array

    def errors_m(self, located: Located) -> Array:
        """Return how far each place is off, rejected or not, shape (m,) [m]; NaN if unknown."""
        off: Array = np.hypot(*(located.xy - self.xy).T)
        return off

    def rmse_m(self, located: Located) -> float:
        """Return the root mean square of the errors of accepted places [m]; NaN without any."""
        errors = self.errors_m(located)[located.block.accepted]
        known = errors[np.isfinite(errors)]
        return float(np.sqrt(np.mean(known**2))) if len(known) else float("nan")


def reference_of(evidence: Evidence, located: Located, tolerance_s: float = 0.12) -> Reference:
    """Return the truth about places, else what the track says, for each step located."""
    times = located.block.time_ns
    truth = true_places(evidence.labels)
    if len(truth):
        return Reference("truth", true_at(truth, times, located.xy, tolerance_s))
    if evidence.track:
        return Reference("track", tracked_at(evidence.track, times, located.xy))
    return Reference("none", np.full((len(times), 2), np.nan))


def true_at(truth: Places, time_ns: NDArray[np.int64], xy: Array, tolerance_s: float) -> Array:
    """Return the true place that each step answers, shape (m, 2) [m]; NaN where it answers none.

    Parameters
    ----------
    truth
        True places.
    time_ns
        Shape (m,): of the steps, in order.
    xy
        Shape (m, 2): where they were located [m]; NaN where nowhere.
    tolerance_s
        Largest distance in time [s].
    """
    somewhere = np.where(np.isfinite(xy), xy, truth.xy.mean(axis=0))
    unknown = (float("nan"),) * 3
    found_at = [
        Fix(int(t), float(x), float(y), unknown, float("nan"), "", 0, "")
        for t, (x, y) in zip(time_ns, somewhere, strict=True)
    ]
    pairs = match_places(truth, found_places(found_at), tolerance_s)
    found = np.full((len(time_ns), 2), np.nan)
    found[pairs[:, 1]] = truth.xy[pairs[:, 0]]
    return found


def tracked_at(track: Sequence[TrackPoint], time_ns: NDArray[np.int64], xy: Array) -> Array:
    """Return where the nearest track is at each step, shape (m, 2) [m]; NaN far from any."""
    found = np.full((len(time_ns), 2), np.nan)
    nearest = np.full(len(time_ns), np.inf)
    for number in sorted({point.track for point in track}):
        own = sorted((p.time_ns, p.x_m, p.y_m) for p in track if p.track == number)
        times = np.array([row[0] for row in own], np.int64)
        places = np.array([row[1:] for row in own], np.float64)
        there = np.column_stack([np.interp(time_ns, times, places[:, k]) for k in (0, 1)])
        away_s = np.abs(time_ns[:, None] - times).min(axis=1) / NS_PER_S
        apart = np.nan_to_num(np.hypot(*(xy - there).T), nan=0.0)
        better = (away_s <= REACH_S) & (apart < nearest)
        found[better], nearest[better] = there[better], apart[better]
    return found


def true_pick_errors(evidence: Evidence, relocator: Relocator) -> Array:
    """Return arrival minus true arrival, shape (m, n) [s]; NaN where none is within 50 ms.

    NaN everywhere where the arrivals are those of an array method: of one frequency of waves that
    disperse, which come after the first ones by more, the farther they went.
    """
    step_ns, times_s = relocator.arrivals.step_ns, relocator.arrivals.times_s
    found = np.full(times_s.shape, np.nan)
    if relocator.correlated:
        return found
    for channel, name in enumerate(relocator.names):
        truth = np.sort(
            [x.time_ns for x in evidence.labels if (x.kind, x.channel) == ("pick", name)]
        )
        if not len(truth):
            continue
        heard = np.flatnonzero(np.isfinite(times_s[:, channel]))
        picked = step_ns[heard] + np.rint(times_s[heard, channel] * NS_PER_S).astype(np.int64)
        after = np.clip(np.searchsorted(truth, picked), 1, max(len(truth) - 1, 1))
        near = [truth[np.minimum(k, len(truth) - 1)] for k in (after - 1, after)]
        off = np.stack([picked - t for t in near]) / NS_PER_S
        least = np.take_along_axis(off, np.abs(off).argmin(axis=0)[None], axis=0)[0]
        found[heard, channel] = np.where(np.abs(least) <= ANSWER_S, least, np.nan)
    return found
