"""What the filter of dead reckoning said at the moments of a track."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..later import Later
from .filter import PLACE, SIZE

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from . import track_kernels

    Array = NDArray[np.float64]
    Columns = tuple[NDArray[np.int64], NDArray[np.bool_], Array, Array, Array, Array, Array]
else:
    track_kernels = Later("groundtrace.reckoning.track_kernels")

_MATRIX = (SIZE, SIZE)
#: Rows that there is room for at least, once there is for any.
_LEAST = 64


class Moment(NamedTuple):
    """Where a walker was: time [ns], place [m], and its covariance (xx, xy, yy) [m2]."""

    time_ns: int
    x_m: float
    y_m: float
    spread: tuple[float, float, float]


@dataclass(slots=True)
class Knots:
    """Knots of a track in columns that have room for more.

    Attributes
    ----------
    count
        How many there are.
    time_ns, shown
        When, and whether a point of the track lies there, shape (m,).
    predicted, predicted_spread
        State before the measurements there, shape (m, 6), and covariance of its error, (m, 6, 6).
    pose, spread
        After them.
    transition
        From the knot before, shape (m, 6, 6).
    """

    count: int = 0
    time_ns: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    shown: NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, np.bool_))
    predicted: Array = field(default_factory=lambda: np.empty((0, SIZE)))
    predicted_spread: Array = field(default_factory=lambda: np.empty((0, *_MATRIX)))
    pose: Array = field(default_factory=lambda: np.empty((0, SIZE)))
    spread: Array = field(default_factory=lambda: np.empty((0, *_MATRIX)))
    transition: Array = field(default_factory=lambda: np.empty((0, *_MATRIX)))

    @property
    def columns(self) -> Columns:
        """All columns, as compiled functions take them."""
        states = (self.predicted, self.predicted_spread, self.pose, self.spread)
        return self.time_ns, self.shown, *states, self.transition

    def begin(self, time_ns: int, state: Array, covariance: Array) -> None:
        """Forget all, and begin with the knot where a track does."""
        self.count = 0
        self.add(time_ns, state, covariance, np.eye(SIZE))

    def make_room(self, more: int) -> None:
        """Have room for some more."""
        count = self.count
        if count + more <= len(self.time_ns):
            return
        wider = []
        for column in self.columns:
            made = np.empty((max(2 * count + more, _LEAST), *column.shape[1:]), column.dtype)
            made[:count] = column[:count]
            wider.append(made)
        self.time_ns, self.shown, self.predicted, self.predicted_spread = wider[:4]
        self.pose, self.spread, self.transition = wider[4:]

    def keep_last(self) -> None:
        """Forget all but the last."""
        for column in self.columns:
            column[0] = column[self.count - 1]
        self.count = 1

    def add(self, time_ns: int, state: Array, covariance: Array, transition: Array) -> None:
        """Add a shown one that is as it was predicted."""
        self.make_room(1)
        at, self.count = self.count, self.count + 1
        self.time_ns[at], self.shown[at], self.transition[at] = time_ns, True, transition
        self.predicted[at], self.predicted_spread[at] = state, covariance
        self.pose[at], self.spread[at] = state, covariance

    def moment(self, index: int) -> Moment:
        """Return where the walker was at one, counted from behind where negative."""
        at = index if index >= 0 else self.count + index
        place, spread = self.pose.item, self.spread.item
        covariance = spread(at, 0, 0), spread(at, 0, 1), spread(at, 1, 1)
        return Moment(self.time_ns.item(at), place(at, 0), place(at, 1), covariance)

    def smoothed(self) -> list[Moment]:
        """Return the shown ones as all knots tell them; the last is the filter's."""
        shown = self.shown[: self.count]
        poses, spreads = track_kernels.smooth(
            *(column[: self.count] for column in self.columns[2:])
        )
        places, times = poses[shown, PLACE].tolist(), self.time_ns[: self.count][shown].tolist()
        found = spreads[shown][:, (0, 0, 1), (0, 1, 1)].tolist()
        return [
            Moment(time_ns, x, y, (xx, xy, yy))
            for time_ns, (x, y), (xx, xy, yy) in zip(times, places, found, strict=True)
        ]
