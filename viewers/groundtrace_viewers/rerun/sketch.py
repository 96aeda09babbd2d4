"""Drawings in 2-D views, which have neither axes nor crosses of their own."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .timeline import strips_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from .timeline import Line, Timeline

    Array = NDArray[np.float64]


def ticks(end: float, most: int = 8) -> list[float]:
    """Return round numbers from 0 up to the first one that is not below ``end``."""
    step = 10.0 ** np.floor(np.log10(end / most))
    step *= next(k for k in (1.0, 2.0, 5.0, 10.0) if end / (k * step) <= most)
    return [float(k * step) for k in range(int(np.ceil(round(end / step, 9))) + 1)]


def thinned(times: Array, values: Array, most: int) -> tuple[Array, Array]:
    """Return at most so many samples: of neighbours the largest of each trace."""
    size = -(-len(times) // most)
    if size < 2:
        return times, values
    count = len(times) // size
    parts = values[: count * size].reshape(count, size, -1)
    largest = np.abs(parts).argmax(axis=1)[:, np.newaxis, :]
    peaks: Array = np.take_along_axis(parts, largest, axis=1)[:, 0, :]
    return times[: count * size].reshape(count, size).mean(axis=1), peaks


def crosses(points: Sequence[tuple[float, float]], half: float, *, upright: bool) -> list[Line]:
    """Return two lines a point, as points of a view are discs: + where upright, else ×."""
    arms = ((half, 0.0), (0.0, half)) if upright else ((half, half), (half, -half))
    return [[(x - a, y - b), (x + a, y + b)] for x, y in points for a, b in arms]


class Sketch:
    """Draws lines and words in 2-D views, whose y points down.

    Parameters
    ----------
    timeline
        Where to.
    order
        Of each entity: what lies over what.
    """

    def __init__(self, timeline: Timeline, order: Mapping[str, float]) -> None:
        self.timeline, self._order = timeline, order

    def lines(
        self,
        path: str,
        times: Sequence[int],
        rows: Sequence[Sequence[Line]],
        colour: int,
        width: float,
    ) -> None:
        """Log lines, some at each time; where there are none, those before end."""
        import rerun as rr

        style = rr.LineStrips2D.from_fields(
            colors=colour, radii=width, draw_order=self._order[path]
        )
        self.timeline.static(path, style)
        flat = [one for row in rows for one in row]
        strips = strips_of(flat) if flat else []
        columns = rr.LineStrips2D.columns(strips=strips).partition([len(row) for row in rows])
        self.timeline.send(path, times, columns)

    def words(
        self,
        path: str,
        times: Sequence[int],
        rows: Sequence[Sequence[tuple[tuple[float, float], str]]],
        colour: int,
    ) -> None:
        """Log words about points, some at each time."""
        import rerun as rr

        style = rr.Points2D.from_fields(
            colors=colour, radii=0.0, show_labels=True, draw_order=self._order[path]
        )
        self.timeline.static(path, style)
        flat = [one for row in rows for one in row]
        places = np.array([position for position, _ in flat], np.float32).reshape(-1, 2)
        columns = rr.Points2D.columns(positions=places, labels=[text for _, text in flat])
        self.timeline.send(path, times, columns.partition([len(row) for row in rows]))

    def points(
        self,
        path: str,
        times: Sequence[int],
        rows: Sequence[Sequence[tuple[float, float]]],
        colour: int,
        radius: float,
    ) -> None:
        """Log points, some at each time."""
        import rerun as rr

        style = rr.Points2D.from_fields(colors=colour, radii=radius, draw_order=self._order[path])
        self.timeline.static(path, style)
        places = np.array([one for row in rows for one in row], np.float32).reshape(-1, 2)
        columns = rr.Points2D.columns(positions=places).partition([len(row) for row in rows])
        self.timeline.send(path, times, columns)
