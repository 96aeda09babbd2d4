"""Lines on a map that grow with time.

The viewer draws all rows of a line's past in every frame, so that a segment a row makes a long walk
slow. The last seconds have a row a segment; what is older has a row every twenty seconds.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from .timeline import Entity

if TYPE_CHECKING:
    from collections.abc import Sequence

    from .timeline import Timeline

    #: A time [ns], and a place [m].
    Passed = tuple[int, tuple[float, float]]

#: Segments are joined into a run of this length, or where nothing follows for so long [ns].
RUN_NS, PAUSE_NS = 20 * NS_PER_S, 20 * NS_PER_S
#: Single segments are shown for so long [s]: until their run is.
SEGMENTS_S = (RUN_NS + PAUSE_NS) / NS_PER_S
#: Where runs are, below the entity of the segments.
RUNS = "runs"


class GrowingLine:
    """Logs one line, from place to place.

    Parameters
    ----------
    timeline
        Where to.
    path
        Entity of its segments.
    colour
        Of the line.
    radius
        Half its width, in the viewer's measure.
    """

    def __init__(self, timeline: Timeline, path: str, colour: int, radius: float) -> None:
        self._timeline = timeline
        self._path = path
        self._colour = colour
        self._radius = radius
        self._run: list[Passed] = []

    def add(self, passed: Sequence[Passed]) -> None:
        """Take places in the order of their times."""
        known = [*self._run[-1:], *passed]
        if len(known) > 1:
            segments = [[a[1], b[1]] for a, b in pairwise(known)]
            self._log(self._path, [time_ns for time_ns, _ in known[1:]], segments)
        runs: list[list[Passed]] = []
        for time_ns, place in passed:
            run = self._run
            long = len(run) > 1 and run[-1][0] - run[0][0] >= RUN_NS
            if len(run) > 1 and (long or time_ns - run[-1][0] >= PAUSE_NS):
                runs.append(run)
                self._run = run[-1:]
            self._run.append((time_ns, place))
        self._log_runs(runs)

    def close(self) -> None:
        """End the line."""
        if len(self._run) > 1:
            self._log_runs([self._run])
        self._run = self._run[-1:]

    def _log_runs(self, runs: list[list[Passed]]) -> None:
        if runs:
            lines = [[place for _, place in run] for run in runs]
            self._log(f"{self._path}/{RUNS}", [run[-1][0] for run in runs], lines)

    def _log(self, path: str, times_ns: list[int], lines: list[list[tuple[float, float]]]) -> None:
        import rerun as rr

        columns = rr.LineStrips2D.columns(
            strips=[np.array(line, np.float32) for line in lines],
            colors=np.full(len(lines), self._colour, np.uint32),
            radii=np.full(len(lines), self._radius),
        )
        self._timeline.declare(Entity(path, "map"))
        self._timeline.send(path, times_ns, columns)
