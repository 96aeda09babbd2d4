"""Smoothing a finished walk: every moment in the light of all stances after it as well.

Source: H. E. Rauch, F. Tung, C. T. Striebel: Maximum likelihood estimates of linear dynamic
systems, AIAA Journal 3 (1965), for the error state: what is smoothed is the difference from the
pose that was predicted.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import Self

    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


class Point(Protocol):
    """A point of a filter's state space, which errors can be added to and told between."""

    def moved(self, error: Array) -> Self:
        """Return the point with an error added, shape (n,)."""

    def error_from(self, other: Self) -> Array:
        """Return the error that leads here from another point, shape (n,)."""


P = TypeVar("P", bound=Point)


@dataclass(frozen=True, slots=True, eq=False)
class Knot(Generic[P]):
    """What the filter said at one moment.

    Attributes
    ----------
    time_ns
        When.
    shown
        Whether a point of the track lies here.
    predicted, predicted_spread
        Before the measurements there, and the covariance of the error, shape (n, n).
    pose, spread
        After them.
    transition
        From the knot before, shape (n, n).
    """

    time_ns: int
    shown: bool
    predicted: P
    predicted_spread: Array
    pose: P
    spread: Array
    transition: Array

    def __deepcopy__(self, memo: object) -> Knot[P]:
        return self  # nothing in it changes


def smoothed(knots: Sequence[Knot[P]]) -> list[tuple[P, Array]]:
    """Return pose and covariance at each knot as all knots tell them; the last is the filter's."""
    # compiled functions are not imported where pipelines are only listed
    from .smoothing_kernels import gain_of

    if not knots:
        return []
    pose, spread = knots[-1].pose, knots[-1].spread
    found = [(pose, spread)]
    for knot, after in zip(knots[-2::-1], knots[:0:-1], strict=True):
        gain = gain_of(knot.spread, after.transition, after.predicted_spread)
        pose = knot.pose.moved(gain @ pose.error_from(after.predicted))
        spread = knot.spread + gain @ (spread - after.predicted_spread) @ gain.T
        found.append((pose, spread))
    return found[::-1]
