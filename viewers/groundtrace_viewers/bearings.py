"""Bearings on the map: rays from the stations towards where a step's wave came from."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .palette import dimmed
from .sensor_map import SITE
from .strips import Strips

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Bearing

    from .timeline import Timeline

#: Brightness of a ray and of its sides as parts of the station's.
RAY, FAN = 0.75, 0.4
RAYS, FANS = f"{SITE}/bearings/rays", f"{SITE}/bearings/fans"


def ahead(
    place: NDArray[np.float64], angle_rad: NDArray[np.float64], box: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return where rays leave a box, shape (k, 2) [m].

    Parameters
    ----------
    place
        Shape (2,): where they begin [m].
    angle_rad
        Shape (k,): whereto.
    box
        Shape (2, 2): lowest and highest corner [m]; rays that leave it at once are a tenth long.
    """
    towards = np.stack([np.cos(angle_rad), np.sin(angle_rad)], axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        far = np.where(towards > 0, box[1] - place, box[0] - place) / towards
    length: NDArray[np.float64] = np.where(towards == 0, np.inf, far).min(axis=1, keepdims=True)
    least = 0.1 * float(np.max(box[1] - box[0]))
    end: NDArray[np.float64] = place + np.maximum(length, least) * towards
    return end


def rays(
    bearing: Bearing, place: tuple[float, float], box: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return lines of a bearing: the ray, and one standard deviation to either side.

    Parameters
    ----------
    bearing
        Of one station.
    place
        Where it stands [m].
    box
        Shape (2, 2): lowest and highest corner of the site [m].

    Returns
    -------
    numpy.ndarray
        Shape (k, 2, 2) [m]: the ray first, then its sides where the deviation is known; an
        ambiguous bearing is a line through the station.
    """
    sigma = bearing.sigma_rad if np.isfinite(bearing.sigma_rad) else 0.0
    angles = bearing.azimuth_rad + np.array([0.0, sigma, -sigma] if sigma else [0.0])
    at = np.array(place, np.float64)
    end = ahead(at, angles, box)
    start = ahead(at, angles + np.pi, box) if bearing.ambiguous else np.broadcast_to(at, end.shape)
    return np.stack([start, end], axis=1)


class BearingLog:
    """Logs the bearings of each step.

    Parameters
    ----------
    timeline
        Where to.
    places, colours
        Of the stations, by name [m].
    box
        Shape (2, 2): lowest and highest corner of the site [m], where rays end.
    """

    def __init__(
        self,
        timeline: Timeline,
        places: Mapping[str, tuple[float, float]],
        colours: Mapping[str, int],
        box: NDArray[np.float64],
    ) -> None:
        self._rays = Strips(timeline, RAYS, -10.0)
        self._fans = Strips(timeline, FANS, -12.0)
        self._places = places
        self._colours = colours
        self._box = box

    def step(self, time_ns: int, found: Mapping[str, Bearing]) -> None:
        """Show the bearings of a step, by station."""
        middles, sides = [], []
        shades, faint = [], []
        for name, bearing in found.items():
            if name in self._places:
                middle, *others = rays(bearing, self._places[name], self._box)
                middles.append(middle)
                sides += others
                shades.append(dimmed(self._colours[name], RAY))
                faint += [dimmed(self._colours[name], FAN)] * len(others)
        self._rays.add(time_ns, middles, shades, [-1.0] * len(middles))
        self._fans.add(time_ns, sides, faint, [-0.6] * len(sides))

    def clear(self, time_ns: int) -> None:
        """Show none any more."""
        self._rays.clear(time_ns)
        self._fans.clear(time_ns)

    def flush(self) -> None:
        """Log what is pending."""
        self._rays.flush()
        self._fans.flush()
