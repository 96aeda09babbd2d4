"""Hodograms: the ground's motion at each station of three axes just after a wave arrives.

A station has two squares, from above (x to the right, y up) and from the side (radial, away from
the source, to the right, z up), both to one scale.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .strips import Strips
from .timeline import Entity

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from .timeline import Timeline

    Array = NDArray[np.float64]

ROOT = "/hodogram"
PLOTS = f"{ROOT}/plots"
MOTION, RAYS = f"{PLOTS}/motion", f"{PLOTS}/bearing"
#: How long after its arrival a station's motion is drawn [s], and by how many points at most.
LENGTH_S, POINTS = 0.02, 120
#: Distances between the middles of two squares, whose sides are 2, and of a title above one: the
#: viewer writes below the place of a title.
PITCH, LINE, TITLE = 2.4, 3.0, 1.75
FRAME, WORDS, WHITE = 0x39404AFF, 0xA8B0BAFF, 0xFFFFFFFF
#: Stations side by side.
ACROSS = 4


def middles(count: int) -> Array:
    """Return the middles of the squares, shape (count, 2, 2): from above, and below it the side."""
    row, column = np.divmod(np.arange(count), ACROSS)
    above = np.stack([PITCH * column, -2 * LINE * row], axis=1)
    return np.stack([above, above - np.array([0.0, LINE])], axis=1)


def extent(count: int) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return what all squares cover, titles included: from and to of x, and of y."""
    low, high = (edge(middles(count), axis=(0, 1)) for edge in (np.min, np.max))
    return (low[0] - 1.2, high[0] + 1.2), (low[1] - 1.2, high[1] + 1.2 * TITLE)


def motion(values: NDArray[np.floating], azimuth_rad: float) -> Array:
    """Return the motion to be drawn.

    Parameters
    ----------
    values
        Shape (n, 3): x, y and z (up).
    azimuth_rad
        Towards the source, counter-clockwise from x [rad].

    Returns
    -------
    numpy.ndarray
        Shape (2, n, 2), within [-1, 1]: x and y, then away from the source and up.
    """
    x, y, z = (values - values.mean(axis=0)).T.astype(np.float64)
    away = -(np.cos(azimuth_rad) * x + np.sin(azimuth_rad) * y)
    largest = max(float(np.abs([x, y, z, away]).max()), np.finfo(np.float64).tiny)
    return np.stack([np.stack([x, y], axis=1), np.stack([away, z], axis=1)]) / largest


class HodogramLog:
    """Logs the hodograms of each step, which stay until the next.

    Parameters
    ----------
    timeline
        Where to.
    names
        Of the stations.
    colours
        Of the stations.
    """

    def __init__(self, timeline: Timeline, names: Sequence[str], colours: Sequence[int]) -> None:
        import rerun as rr

        self._timeline = timeline
        self._colours = tuple(colours)
        self._motion = Strips(timeline, MOTION, 0.0, "part")
        self._rays = Strips(timeline, RAYS, 10.0, "part")
        self._middles = middles(len(names))
        upwards = rr.Transform3D(mat3x3=[[1, 0, 0], [0, -1, 0], [0, 0, 1]])
        title = f"Hodograms, {LENGTH_S * 1e3:g} ms"
        self._timeline.declare(Entity(PLOTS, "hodogram", title, len(names)), upwards)
        self._frames(names)

    def _frames(self, names: Sequence[str]) -> None:
        import rerun as rr

        square = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)], np.float64)
        cross = [np.array([(-1, 0), (1, 0)]), np.array([(0, -1), (0, 1)])]
        flat = self._middles.reshape(-1, 2)
        frames = [middle + part for middle in flat for part in (square, *cross)]
        strips = rr.LineStrips2D(
            [f.astype(np.float32) for f in frames],
            colors=np.full(len(frames), FRAME, np.uint32),
            radii=-0.5,
            draw_order=-10.0,
        )
        self._timeline.static(f"{PLOTS}/frames", strips)
        texts = [text for name in names for text in (f"{name} x–y", f"{name} r–z")]
        titles = rr.Points2D(
            flat + np.array([0.0, TITLE]),
            labels=texts,
            show_labels=True,
            colors=np.full(len(flat), WORDS, np.uint32),
            radii=-0.1,
        )
        self._timeline.static(f"{PLOTS}/titles", titles)

    def step(self, time_ns: int, moved: Mapping[int, tuple[Array, float]]) -> None:
        """Show a step.

        Parameters
        ----------
        time_ns
            When [ns].
        moved
            By the index of a station: its motion, shape (n, 3), and the azimuth of the source
            [rad].
        """
        lines, shades, rays = [], [], []
        for index, (values, azimuth) in moved.items():
            every = max(1, -(-len(values) // POINTS))
            lines += list(motion(values, azimuth)[:, ::every] + self._middles[index][:, None])
            shades += [self._colours[index]] * 2
            middle = self._middles[index, 0]
            ahead = middle + np.array([np.cos(azimuth), np.sin(azimuth)])
            rays.append(np.stack([middle, ahead]))
        self._motion.add(time_ns, lines, shades, [-0.9] * len(lines))
        self._rays.add(time_ns, rays, [WHITE] * len(rays), [-0.7] * len(rays))

    def flush(self) -> None:
        """Log what is pending."""
        self._motion.flush()
        self._rays.flush()
