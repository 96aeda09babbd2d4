"""Random rooms: outline, sensors, floor, shoe, walls and path drawn from a seed."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.geometry import Geometry, Sensor

from .paths import polygon

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .options import PathName, RoomOptions, ShoeName

    Array = NDArray[np.float64]

_SIDE_M = (4.0, 10.0)
_SENSORS = (4, 16)
_THICKNESS_M = (0.12, 0.3)
_LOSS_S = (5e-6, 5e-5)
_REFLECTION = (0.3, 0.6)
_SHOES: tuple[ShoeName, ...] = ("heel", "bare", "mixed")
_PATHS: tuple[PathName, ...] = ("straight", "l", "v", "u", "circle", "ellipse", "there-and-back")


def drawn(options: RoomOptions) -> RoomOptions:
    """Return the options with what was open drawn; what was given stays as it is.

    Sides of 4 to 10 m, one room in four square, one L-shaped; 4 to 16 sensors near corners, along
    walls and inside; a slab of 12 to 30 cm with a loss of 5e-6 to 5e-5 s; any shoe, any path,
    walls that reflect 0.3 to 0.6, a resonance in every mounting. What is drawn does not depend on
    what is given, so that one option can be changed in an otherwise equal room.
    """
    rng = np.random.default_rng([options.seed, 3])
    side_m = np.round(rng.uniform(*_SIDE_M, 2), 1)
    kind = rng.choice(["square", "rectangle", "rectangle", "l"])
    count = int(rng.integers(_SENSORS[0], _SENSORS[1] + 1))
    notch = rng.uniform(0.3, 0.5, 2)
    thickness_m = round(rng.uniform(*_THICKNESS_M), 3)
    loss_s = float(f"{np.exp(rng.uniform(*np.log(_LOSS_S))):.2e}")
    walls = round(rng.uniform(*_REFLECTION), 2)
    shoe, path = _SHOES[rng.integers(len(_SHOES))], _PATHS[rng.integers(len(_PATHS))]
    site = options.geometry
    if site is None or not site.sensors:
        if site is None:
            site = Geometry(outline=_outline(options.side_m, side_m, str(kind), notch))
        site = replace(site, sensors=_sensors(rng, site, options.channels or count))
    if options.thickness_m is None and options.dispersion_m2s is None:
        known = site.medium.thickness_m
        options = replace(options, thickness_m=thickness_m if known is None else known)
    walking = not options.impacts and options.walkers != 2
    return replace(
        options,
        geometry=site,
        channels=None,
        side_m=None,
        loss_s=options.loss_s or loss_s,
        shoe=options.shoe or shoe,
        walls=walls if options.walls is None else options.walls,
        resonances=True,
        path=options.path or (path if walking else None),
    )


def _outline(
    given_m: tuple[float, float] | None, drawn_m: Array, kind: str, notch: Array
) -> tuple[tuple[float, float], ...]:
    """Return a rectangle, or an L without its upper right part of ``notch`` of the sides."""
    x, y = given_m or (float(drawn_m[0]), float(drawn_m[0 if kind == "square" else 1]))
    if kind != "l" or given_m is not None:
        return ((0.0, 0.0), (x, 0.0), (x, y), (0.0, y))
    a, b = np.round((1 - notch) * (x, y), 1).tolist()
    return ((0.0, 0.0), (x, 0.0), (x, b), (a, b), (a, y), (0.0, y))


def _sensors(rng: np.random.Generator, site: Geometry, count: int) -> tuple[Sensor, ...]:
    """Draw sensors one after the other, each of many places the one farthest from those before.

    The places are near the corners, along the walls (5 to 30 cm off) and anywhere inside.
    """
    import shapely

    room = polygon(site.outline)
    edges = [room.buffer(-rng.uniform(0.05, 0.3), join_style="mitre").exterior for _ in range(6)]
    corners = np.concatenate([shapely.get_coordinates(edge)[:-1] for edge in edges[:2]])
    along = np.array(
        [
            edge.interpolate(share, normalized=True).coords[0]
            for edge in edges
            for share in rng.random(8)
        ]
    )
    low, high = np.array(room.bounds).reshape(2, 2)
    inside = rng.uniform(low, high, (120, 2))
    inside = inside[shapely.contains_xy(room.buffer(-0.3), *inside.T)]
    # the farthest would nearly always be at the walls
    pool = np.concatenate([corners, along, inside])
    ease = np.concatenate([np.ones(len(corners) + len(along)), np.full(len(inside), 1.15)])
    chosen = [int(rng.integers(len(corners)))]
    while len(chosen) < count:
        apart = np.hypot(*(pool[:, None] - pool[chosen]).transpose(2, 0, 1)).min(axis=1)
        chosen.append(int(np.argmax(apart * ease)))
    return tuple(
        Sensor(f"G{i}", f"G{i}", x, y)
        for i, (x, y) in enumerate(np.round(pool[chosen], 3).tolist(), 1)
    )
