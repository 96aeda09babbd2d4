"""What each sensor contributes, and where one more, or one moved, would help most."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import shapely

from ..localizers.location import LEAST_PICKS
from .error_maps import METHODS, error_map
from .layout import grid_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from .layout import Layout

    Array = NDArray[np.float64]

#: Candidates along the longer side of the room, walls included.
CANDIDATES = 7
#: Candidates nearer to a sensor than this part of their spacing are left out.
APART = 0.5
#: So many of the best candidates are tried again.
FINALISTS = 3


@dataclass(frozen=True, slots=True)
class Trial:
    """How thoroughly layouts are compared.

    Attributes
    ----------
    lattice
        Cells along the longer side of the room.
    draws
        Random errors at each.
    seed
        Of them.
    """

    lattice: int
    draws: int
    seed: int

    def mean_m(self, layout: Layout, method: str) -> float:
        """Return the mean error of a localizer over the room [m]."""
        nodes = grid_of(layout.room, self.lattice).nodes
        return error_map(layout, method, nodes, self.draws, self.seed).mean_m

    def means_m(self, layout: Layout) -> dict[str, float]:
        """Return the mean error of each localizer [m]."""
        return {method: self.mean_m(layout, method) for method in METHODS}


@dataclass(frozen=True, slots=True)
class Advice:
    """A change of the layout.

    Attributes
    ----------
    moved
        Index of the sensor that is moved; None where one is added.
    place
        Where to [m].
    method
        The localizer that the place was chosen for.
    before_m, after_m
        Mean error of each localizer without and with the change [m].
    tried
        How many changes were tried.
    """

    moved: int | None
    place: tuple[float, float]
    method: str
    before_m: dict[str, float]
    after_m: dict[str, float]
    tried: int

    @property
    def gain_m(self) -> float:
        """By how much the mean error falls [m]; negative where the best of all tried is worse."""
        return self.before_m[self.method] - self.after_m[self.method]


def contributions(
    layout: Layout, trial: Trial, before_m: dict[str, float], done: Callable[[], None]
) -> tuple[dict[str, float], ...]:
    """Return by how much the mean error rises without each sensor, by localizer [m].

    Nothing where there are but three sensors: without one of them none locates.
    """
    if len(layout.sensors) <= LEAST_PICKS:
        return ()
    found = []
    for index in range(len(layout.sensors)):
        after = trial.means_m(layout.without(index))
        found.append({method: after[method] - before_m[method] for method in METHODS})
        done()
    return tuple(found)


def candidates(layout: Layout) -> Array:
    """Return where a sensor may go: a lattice over the room and its walls, shape (c, 2) [m]."""
    room = layout.room
    low, high = np.array(room.bounds).reshape(2, 2)
    spacing = float((high - low).max()) / (CANDIDATES - 1)
    counts = np.maximum(2, np.rint((high - low) / spacing).astype(int) + 1)
    x, y = (np.linspace(a, b, n) for a, b, n in zip(low, high, counts, strict=True))
    places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    places = places[shapely.intersects_xy(room, *places.T)]
    apart = np.linalg.norm(places[:, None] - layout.positions, axis=2).min(axis=1)
    free: Array = places[apart >= APART * spacing]
    return free


def best_change(
    layout: Layout,
    moved: int | None,
    method: str,
    screen: Trial,
    trial: Trial,
    before_m: dict[str, float],
    done: Callable[[], None],
) -> Advice | None:
    """Return the best place for one more sensor, or for one that is moved.

    Parameters
    ----------
    layout
        As it is.
    moved
        Index of the sensor to move; None to add one.
    method
        The localizer to choose the place for.
    screen, trial
        How all places are compared, and then the best of them.
    before_m
        Mean errors of the layout as it is, of ``trial`` [m].
    done
        Called after each place.

    Returns
    -------
    The best; None where there is no free place.
    """
    rest = layout if moved is None else layout.without(moved)
    screened = []
    places = candidates(layout)
    for place in places:
        screened.append(screen.mean_m(rest.plus(place), method))
        done()
    finalists = [rest.plus(places[i]) for i in np.argsort(screened, kind="stable")[:FINALISTS]]
    if not finalists:
        return None
    means = [trial.mean_m(changed, method) for changed in finalists]
    best = finalists[int(np.argmin(means))]
    x, y = (float(v) for v in best.positions[-1])
    return Advice(moved, (x, y), method, before_m, trial.means_m(best), len(places))
