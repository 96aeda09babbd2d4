"""Ways of vehicles on the map: fitted courses dashed, true ways drawn through, places now."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from .timeline import Entity

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .timeline import Timeline

    Array = NDArray[np.float64]

#: Between two places of a vehicle that is shown to move [ns].
MOVE_NS = NS_PER_S // 10
#: Most dashes of a course.
MOST_DASHES = 300


@dataclass(frozen=True, slots=True, eq=False)
class Way:
    """Where a vehicle is when.

    Attributes
    ----------
    times_ns
        Shape (n,), increasing.
    places
        Shape (n, 2) [m].
    """

    times_ns: NDArray[np.int64]
    places: Array

    def steps_ns(self) -> NDArray[np.int64]:
        """Return moments from the first to the last, a tenth of a second apart."""
        return np.append(np.arange(self.times_ns[0], self.times_ns[-1], MOVE_NS), self.times_ns[-1])

    def between(self, values: Array) -> Array:
        """Return values of its times, shape (n, k), at :meth:`steps_ns`."""
        since, at = self.times_ns - self.times_ns[0], self.steps_ns() - self.times_ns[0]
        return np.column_stack([np.interp(at, since, column) for column in values.T])


def dashes(line: Array, length_m: float) -> list[NDArray[np.float32]]:
    """Cut a line of shape (n, 2) into dashes, each of shape (2, 2), with gaps as long [m]."""
    reached = np.append(0.0, np.cumsum(np.hypot(*np.diff(line, axis=0).T)))
    length_m = max(length_m, float(reached[-1]) / (2 * MOST_DASHES))
    starts = np.arange(0.0, float(reached[-1]), 2 * length_m)
    ends = np.minimum(starts + length_m, reached[-1])
    found = [
        np.column_stack([np.interp(at, reached, column) for column in line.T])
        for at in (starts, ends)
    ]
    return list(np.stack(found, axis=1).astype(np.float32))


def log_moving(
    timeline: Timeline, path: str, way: Way, colour: int, radius: float, name: str = ""
) -> None:
    """Log a point that moves along a way, and is gone at its end."""
    import rerun as rr

    times = way.steps_ns()
    rows = len(times)
    columns = rr.Points2D.columns(
        positions=way.between(way.places).astype(np.float32),
        colors=np.full(rows, colour, np.uint32),
        radii=np.full(rows, -radius),
        labels=[name] * rows if name else None,
    )
    timeline.declare(Entity(path, "map"))
    timeline.send(path, times, columns)
    none = rr.Points2D.columns(positions=np.zeros((1, 2))).partition([0])
    timeline.send(path, [int(times[-1]) + 1], none)
