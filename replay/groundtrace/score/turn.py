"""Places turned onto others: a track by dead reckoning begins anywhere and heads anywhere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class Turn:
    """A rotation, shape (2, 2), and then a shift, shape (2,) [m]."""

    rotation: NDArray[np.float64]
    shift: NDArray[np.float64]

    def __call__(self, places: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return where places lie then, shape (n, 2) [m]."""
        return np.asarray(places @ self.rotation.T + self.shift)


def turn_onto(places: NDArray[np.float64], onto: NDArray[np.float64]) -> Turn:
    """Return the turn with the least squares of what is left between places, shape (n, 2) each."""
    centre, target = places.mean(axis=0), onto.mean(axis=0)
    (a, b), (c, d) = (places - centre).T @ (onto - target)
    angle = np.arctan2(b - c, a + d)
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return Turn(rotation, target - rotation @ centre)
