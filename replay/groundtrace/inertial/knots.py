"""What a filter of a foot said at the moments that its smoothing needs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Knots:
    """What the filter said at consecutive moments, in columns.

    Attributes
    ----------
    time_ns, shown
        When, and whether a point of the track lies there, shape (n,).
    predicted, predicted_spread
        Pose, as :attr:`.strapdown.Pose.row`, before the measurements there, shape (n, 16), and the
        covariance of its error, shape (n, 15, 15).
    pose, spread
        After them.
    transition
        From the knot before, shape (n, 15, 15).
    """

    time_ns: NDArray[np.int64]
    shown: NDArray[np.bool_]
    predicted: Array
    predicted_spread: Array
    pose: Array
    spread: Array
    transition: Array

    def __len__(self) -> int:
        return len(self.time_ns)

    def __deepcopy__(self, memo: object) -> Knots:
        return self  # nothing in it changes

    def rows(self, start: int, stop: int | None) -> Knots:
        """Return some of them."""
        part = slice(start, stop)
        return Knots(
            self.time_ns[part],
            self.shown[part],
            self.predicted[part],
            self.predicted_spread[part],
            self.pose[part],
            self.spread[part],
            self.transition[part],
        )
