"""How far each localizer is off, place by place: the root mean square over random errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..localizers import hyperbolic, power_law, so_tdoa

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from .layout import Layout

    Array = NDArray[np.float64]

#: Errors below this count as small [m].
SMALL_M = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class ErrorMap:
    """Errors of one localizer.

    Attributes
    ----------
    method
        Name of the localizer.
    rmse_m
        Shape (m,): root mean square error at each node [m].
    """

    method: str
    rmse_m: Array

    @property
    def mean_m(self) -> float:
        """Mean over the room [m]."""
        return float(self.rmse_m.mean())


def times_of(layout: Layout, nodes: Array, draws: int, seed: int) -> Array:
    """Return arrivals with errors, shape (m, draws, n) [s].

    A sensor's errors are the same in every layout that has it, so that layouts are compared
    without the chance of other errors.
    """
    shape = (len(nodes), draws)
    noise = [np.random.default_rng([seed, k]).standard_normal(shape) for k in layout.streams]
    return layout.arrivals(nodes)[:, None] + layout.sigma_s * np.stack(noise, axis=-1)


def _so_tdoa(layout: Layout, nodes: Array, times_s: Array) -> Array:  # noqa: ARG001
    return so_tdoa.places(so_tdoa.known_regions(layout.positions, layout.outline), times_s)


def _hyperbolic(layout: Layout, nodes: Array, times_s: Array) -> Array:
    clean = layout.arrivals(nodes)
    velocity = hyperbolic.calibrated_velocity(nodes, layout.positions, clean)
    return hyperbolic.places(layout.positions, times_s, velocity, layout.outline)


def _power_law(layout: Layout, nodes: Array, times_s: Array) -> Array:  # noqa: ARG001
    return power_law.places(layout.positions, times_s, layout.outline, sigma_s=layout.sigma_s)


#: Localizers by name: layout, nodes of controlled impacts, and arrivals (m, n) to places (m, 2).
METHODS: dict[str, Callable[[Layout, Array, Array], Array]] = {
    "so-tdoa": _so_tdoa,
    "hyperbolic": _hyperbolic,
    "power-law": _power_law,
}


def error_map(layout: Layout, method: str, nodes: Array, draws: int, seed: int) -> ErrorMap:
    """Return the root mean square error of a localizer at places.

    Parameters
    ----------
    layout
        Sensors, room, and the errors of arrivals.
    method
        One of :data:`METHODS`. The velocity of ``hyperbolic`` is calibrated by noise-free impacts
        at all nodes; ``power-law`` fits by least squares, as there are no late arrivals.
    nodes
        Shape (m, 2): where impacts are [m].
    draws
        Random errors at each.
    seed
        Of the errors.
    """
    times = times_of(layout, nodes, draws, seed)
    places = METHODS[method](layout, nodes, times.reshape(-1, times.shape[-1]))
    off = places.reshape(len(nodes), draws, 2) - nodes[:, None]
    return ErrorMap(method, np.sqrt(np.mean(np.sum(off**2, axis=-1), axis=1)))
