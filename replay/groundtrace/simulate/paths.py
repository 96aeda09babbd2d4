"""Paths of people through a room: shapes fitted into the widest clear rectangle of the outline."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .options import refused

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from shapely import Polygon

    from .options import PathName

    Array = NDArray[np.float64]

#: People keep this far from walls [m], less in rooms narrower than five times as much.
_CLEAR_M = 0.7
#: From the middle of the path to a foot [m].
_ASIDE_M = 0.07
_TICKS = 14  # of the corners a rectangle is looked for with, per axis
_FLAT = 0.65  # shorter axis of an ellipse over the longer one, at most
_LANE_M = 0.8  # between going there and coming back

#: Open lines over the unit square, walked to and fro with a turn on the spot at the ends. No leg
#: lies on a line of symmetry, where feet would be equally far from rows of sensors.
_LINES = {
    "straight": ((0.0, 0.3), (1.0, 0.6)),
    "l": ((0.0, 0.025), (1.0, 0.025), (1.0, 1.0)),
    "v": ((0.0, 1.0), (0.45, 0.0), (1.0, 1.0)),
    "u": ((0.0, 0.025), (1.0, 0.025), (1.0, 1.0), (0.0, 1.0)),
}


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """A line to walk along.

    Attributes
    ----------
    points
        Shape (n, 2) [m].
    closed
        True: round and round; False: to and fro.
    """

    points: Array
    closed: bool = False

    @property
    def length_m(self) -> float:
        """From the first point to the last [m]."""
        return float(np.hypot(*np.diff(self.points, axis=0).T).sum())

    def feet(self, run_m: Array) -> Array:
        """Return the feet's places after ``run_m`` metres of path, left foot first, (n, 2)."""
        path = self.points
        legs = np.diff(path, axis=0)
        length = np.hypot(*legs.T)
        along = np.concatenate(([0.0], np.cumsum(length)))
        phase = run_m % (along[-1] if self.closed else 2 * along[-1])
        back = phase > along[-1]
        arc = np.where(back, 2 * along[-1] - phase, phase)
        leg = np.clip(np.searchsorted(along, arc, side="right") - 1, 0, len(legs) - 1)
        heading = legs[leg] / length[leg, None] * np.where(back, -1.0, 1.0)[:, None]
        middle = np.stack([np.interp(arc, along, path[:, axis]) for axis in (0, 1)], axis=1)
        left = np.stack([-heading[:, 1], heading[:, 0]], axis=1)
        aside = np.where(np.arange(len(run_m)) % 2 == 0, _ASIDE_M, -_ASIDE_M)
        feet: Array = np.round(middle + aside[:, None] * left, 4)
        return feet


def paths_in(outline: tuple[tuple[float, float], ...], name: PathName) -> tuple[Path, ...]:
    """Return the path of each walker: two for ``crossing``, else one.

    Raises
    ------
    SimulationError
        Where the outline encloses no area, crosses itself, or is too narrow to walk in.
    """
    low, high = clear_rectangle(outline)
    size = high - low
    if name == "crossing":
        ends = np.array([[(0, 0), (1, 1)], [(0, 1), (1, 0)]], np.float64)
        return tuple(Path(low + line * size) for line in ends)
    if name in _LINES:
        line = low + np.array(_LINES[name]) * size
        return (Path(_rounded(line)),)
    middle, half = (low + high) / 2, size / 2
    if name == "circle":
        half = np.full(2, half.min())
    if name == "ellipse":  # in a square too
        half[int(half[1] <= half[0])] = min(half.min(), _FLAT * half.max())
    if name == "there-and-back":
        return (Path(_hairpin(middle, half), closed=True),)
    angle = np.linspace(0, 2 * np.pi, 73)[:, None]
    round_ = np.concatenate([np.cos(angle), np.sin(angle)], axis=1)
    return (Path(middle + half * round_, closed=True),)


def _rounded(path: Array) -> Array:
    for _ in range(4):  # Chaikin's corner cutting
        inner = np.stack([0.75 * path[:-1] + 0.25 * path[1:], 0.25 * path[:-1] + 0.75 * path[1:]])
        path = np.concatenate([path[:1], inner.transpose(1, 0, 2).reshape(-1, 2), path[-1:]])
    return path


def _hairpin(middle: Array, half: Array) -> Array:
    """Return a way along the longer side, a half circle, and back beside it."""
    longer = int(half[1] > half[0])
    radius = min(_LANE_M / 2, float(half.min()))
    reach = float(half[longer]) - radius
    angle = np.linspace(-np.pi / 2, np.pi / 2, 19)
    turn = np.stack([reach + radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    ring = np.concatenate([[(-reach, -radius)], turn, -turn, [(-reach, -radius)]])
    # the turns' ends meet the lanes' ends, and a leg without length has no heading
    ring = ring[np.concatenate(([True], np.hypot(*np.diff(ring, axis=0).T) > 1e-9))]
    there: Array = middle + (ring[:, ::-1] * (1, -1) if longer else ring)
    return there


def clear_rectangle(outline: tuple[tuple[float, float], ...]) -> tuple[Array, Array]:
    """Return lower and upper corner of the largest upright rectangle people walk in, (2,) [m].

    Raises
    ------
    SimulationError
        As :func:`paths_in`.
    """
    import shapely

    room = polygon(outline)
    low, high = np.array(room.bounds).reshape(2, 2)
    clear = room.buffer(-min(_CLEAR_M, float((high - low).min()) / 5), join_style="mitre")
    if clear.is_empty:
        raise refused("outline", "room to walk in", "none")
    corners = shapely.get_coordinates(clear)
    low, high = np.array(clear.bounds).reshape(2, 2)
    x, y = (
        np.unique(
            np.round(np.concatenate([corners[:, i], np.linspace(low[i], high[i], _TICKS)]), 6)
        )
        for i in (0, 1)
    )
    (x_low, x_high), (y_low, y_high) = (_intervals(ticks) for ticks in (x, y))
    i, j = (k.ravel() for k in np.indices((len(x_low), len(y_low))))
    order = np.argsort(-(x_high - x_low)[i] * (y_high - y_low)[j], kind="stable")
    box = np.stack([x_low[i], y_low[j], x_high[i], y_high[j]], axis=1)[order]
    return _first_inside(box, clear)


def _first_inside(box: Array, clear: Polygon) -> tuple[Array, Array]:
    """Return the first of the boxes (n, 4) that lies in ``clear``."""
    import shapely

    grown = clear.buffer(1e-5, join_style="mitre")
    shapely.prepare(grown)
    for part in np.array_split(box, max(len(box) // 500, 1)):
        inside = shapely.contains(grown, shapely.box(*part.T))
        if inside.any():
            found = part[int(np.argmax(inside))]
            if float((found[2:] - found[:2]).min()) >= 0.5:
                return found[:2], found[2:]
    raise refused("outline", "0.5 m or more to walk in", "less")


def _intervals(ticks: Array) -> tuple[Array, Array]:
    low, high = np.triu_indices(len(ticks), 1)
    return ticks[low], ticks[high]


def polygon(outline: tuple[tuple[float, float], ...]) -> Polygon:
    """Return the outline as an area.

    Raises
    ------
    SimulationError
        Where it encloses none or crosses itself.
    """
    import shapely

    room = shapely.Polygon(outline)
    if not room.is_valid or room.area <= 0:
        why = shapely.is_valid_reason(room) if room.area > 0 else "none"
        raise refused("outline", "corners around an area", why)
    return room
