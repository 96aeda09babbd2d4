"""Iron that a worn sensor carries, told from the field of the place by how the sensor turns.

A magnetometer that nobody calibrated adds a field of its own, which turns with it (hard iron). In a
few seconds a walker meets hardly another field of the place, but turns: over the blocks of a short
window the field in axes that do not turn is F + R b, with F the window's, R the mean rotation from
the sensor's axes and b the iron. Least squares over all windows find b; each F drops out with the
means of its window. So neither what a building does over some metres nor the drift of a gyroscope
over minutes is taken for iron, and windows before and after a gap count together.

How sure b is, is told by how the windows contradict each other (White's heteroskedasticity
consistent covariance): in some the field of the place changes more than in others.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .rotations import mean_matrix

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from .rotations import Array

#: Length of a window [s], and its blocks; windows overlap by half. Chosen by judgement: the field
#: of a place stands still for some steps only.
WINDOW_S, BLOCKS = 3.0, 6
#: What iron of an uncalibrated sensor adds, per axis, before anything is known [T]. Chosen by
#: judgement: 20 to 40 uT in the recordings of uncalibrated sensors at hand (mobgap, step-detector).
IRON_T = 30e-6
#: Blocks err alike, as so many fewer. Chosen by trial on logs of IPIN 2023, whose iron is off by
#: twice of what residuals of independent blocks tell.
ALIKE = 4.0
#: Windows overlap by half, and tell as much as so many fewer. Source: definition.
OVERLAP = 1.5
#: A window tells something where its turns about their mean have more than this sum of squares,
#: five degrees a block, and iron is believed in where so many do. Chosen by judgement: two
#: overlapping ones see one corner, where the field may be another one round it.
TURNING, LEAST_TURNING = 0.1, 4
#: Iron is believed in that is more than the first [T], so many deviations from none, explains this
#: part of the squares, and was told by so many windows. Chosen by trial on logs of IPIN 2023 and
#: indoor-location-20: of 63 none is believed to carry any, ever; with 10 uT added 56 are, with 20
#: uT 59.
LEAST_T, SURE_SIGMAS, LEAST_EXPLAINED, LEAST_WINDOWS = 4e-6, 10.0, 0.15, 16
#: What is believed in is dropped where it is less sure, and explains less, than this part of that.
#: Chosen by judgement: half of what it takes, so that it does not come and go.
DROPPED = 0.5


class IronWindow(NamedTuple):
    """What a window tells: turns and fields of its blocks, each about their mean over the window.

    Attributes
    ----------
    products
        Of the turns with each other, summed over blocks, shape (3, 3).
    right
        Of the turns with the fields, shape (3,) [T].
    squares
        Sum of the squares of the fields [T2].
    """

    products: Array
    right: Array
    squares: float


def iron_window(turns: Array, fields: Array) -> IronWindow:
    """Return what a window tells.

    Parameters
    ----------
    turns
        Shape (n_blocks, 3, 3): mean rotation of each block from the sensor's axes.
    fields
        Shape (n_blocks, 3): mean of its fields so turned [T].
    """
    turns, fields = turns - turns.mean(axis=0), fields - fields.mean(axis=0)
    right = np.einsum("bki,bk->i", turns, fields)
    return IronWindow(np.einsum("bki,bkj->ij", turns, turns), right, float((fields**2).sum()))


class IronFit(NamedTuple):
    """The iron as windows tell it.

    Attributes
    ----------
    field
        Along the sensor's axes, shape (3,) [T].
    explained
        Part of the squares of the fields that it explains.
    believed
        Whether it is so sure that it is to be taken away.
    """

    field: Array
    explained: float
    believed: bool

    @property
    def words(self) -> str:
        """The iron in words."""
        return f"{', '.join(str(round(1e6 * part)) for part in self.field)} uT"


class CarriedIron:
    """Gathers windows, and tells the iron by them.

    Attributes
    ----------
    windows, turning
        How many there were, and of them with turns that tell something.
    """

    def __init__(self) -> None:
        self.windows = self.turning = 0
        self._believed = False
        self._products, self._right, self._squares = np.zeros((3, 3)), np.zeros(3), 0.0
        # sums over windows of products of the two above, for the scatter of what they ask for
        self._right_right = np.zeros((3, 3))
        self._right_products = np.zeros((3, 3, 3))
        self._products_products = np.zeros((3, 3, 3, 3))

    def add(self, window: IronWindow) -> None:
        """Take a window."""
        products, right, squares = window
        self.windows += 1
        self.turning += float(np.trace(products)) > TURNING
        self._products += products
        self._right += right
        self._squares += squares
        self._right_right += np.multiply.outer(right, right)
        self._right_products += np.multiply.outer(right, products)
        self._products_products += np.multiply.outer(products, products)

    def fit(self) -> IronFit | None:
        """Return the iron by now; None where there are no windows, or no field in them."""
        if not self.windows or not self._squares > 0:
            return None
        right, products = self._right, self._products
        alone: Array = np.asarray(np.linalg.lstsq(products, right, rcond=None)[0], np.float64)
        freedom = 3 * (BLOCKS - 1) * self.windows
        noise = max(self._left(alone), np.finfo(float).eps * self._squares) / freedom
        prior = ALIKE * noise / IRON_T**2 * np.eye(3)
        iron: Array = np.asarray(np.linalg.solve(products + prior, right), np.float64)
        explained = 1 - self._left(iron) / self._squares
        crossed = np.einsum("ijk,k->ij", self._right_products, iron)
        scatter = self._right_right - crossed - crossed.T
        scatter += np.einsum("ikjl,k,l->ij", self._products_products, iron, iron)
        sure = float(right @ np.linalg.pinv(OVERLAP * scatter, hermitian=True) @ right)
        part = DROPPED if self._believed else 1.0
        self._believed = (
            self.windows >= LEAST_WINDOWS
            and self.turning >= LEAST_TURNING
            and explained > part * LEAST_EXPLAINED
            and sure > (part * SURE_SIGMAS) ** 2
            and float(np.linalg.norm(iron)) > part * LEAST_T
        )
        return IronFit(iron, explained, self._believed)

    def _left(self, iron: Array) -> float:
        return self._squares - float(iron @ (2 * self._right - self._products @ iron))


class FieldWindows:
    """Cuts a sensor's motion into windows.

    Parameters
    ----------
    rate_hz
        Of the sensor [Hz].
    """

    def __init__(self, rate_hz: float) -> None:
        self._length = round(WINDOW_S * rate_hz)
        self._edges = np.linspace(0, self._length, BLOCKS + 1).astype(int).tolist()
        self._time_ns = np.empty(0, np.int64)
        self._orientation, self._field = np.empty((0, 4)), np.empty((0, 3))
        self._waiting: list[tuple[int, IronWindow]] = []

    def add(self, time_ns: NDArray[np.int64], orientation: Array, field: Array) -> None:
        """Take samples: quaternions, shape (n, 4), and fields in level axes, shape (n, 3) [T].

        A window without a field everywhere tells nothing.
        """
        if self._length < 2 * BLOCKS:
            return
        self._time_ns = np.concatenate([self._time_ns, time_ns])
        self._orientation = np.concatenate([self._orientation, orientation])
        self._field = np.concatenate([self._field, field])
        first, length = 0, self._length
        while len(self._field) - first >= length:
            rows = slice(first, first + length)
            if np.isfinite(self._field[rows]).all():
                window = self._window(self._orientation[rows], self._field[rows])
                self._waiting.append((int(self._time_ns[rows.stop - 1]), window))
            first += length // 2
        self._time_ns, self._orientation = self._time_ns[first:], self._orientation[first:]
        self._field = self._field[first:]

    def until(self, time_ns: int) -> Sequence[IronWindow]:
        """Return, once, the windows that end by a time [ns]."""
        count = sum(end_ns <= time_ns for end_ns, _ in self._waiting)
        windows, self._waiting = self._waiting[:count], self._waiting[count:]
        return [window for _, window in windows]

    def _window(self, orientation: Array, field: Array) -> IronWindow:
        blocks = [slice(a, b) for a, b in pairwise(self._edges)]
        turns = np.stack([mean_matrix(orientation[block]) for block in blocks])
        return iron_window(turns, np.stack([field[block].mean(axis=0) for block in blocks]))
