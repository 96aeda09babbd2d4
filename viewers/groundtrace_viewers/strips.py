"""Lines on a map that change over time: rows are collected, so that a chunk holds many."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .timeline import Entity

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from .timeline import Timeline


class Strips:
    """Lines of one entity: those of a time hold until the next time.

    Parameters
    ----------
    timeline
        Where to.
    path
        Entity path.
    order
        What is drawn over what: larger numbers over smaller ones, points are at 30.
    role
        Of the entity.
    """

    def __init__(
        self, timeline: Timeline, path: str, order: float = 20.0, role: str = "map"
    ) -> None:
        self._timeline = timeline
        self._path = path
        self._order = order
        self._role = role
        self._times: list[int] = []
        self._counts: list[int] = []
        self._lines: list[NDArray[np.float32]] = []
        self._colours: list[int] = []
        self._radii: list[float] = []

    def add(
        self,
        time_ns: int,
        lines: Sequence[NDArray[np.floating]],
        colours: Sequence[int],
        radii: Sequence[float],
    ) -> None:
        """Take the lines of a time: each of shape (k, 2), with its colour and radius."""
        self._times.append(time_ns)
        self._counts.append(len(lines))
        self._lines += [line.astype(np.float32) for line in lines]
        self._colours += colours
        self._radii += radii

    def clear(self, time_ns: int) -> None:
        """Show no lines from a time on."""
        self.add(time_ns, [], [], [])

    def flush(self) -> None:
        """Log what is pending."""
        import rerun as rr

        if not self._times:
            return
        style = rr.LineStrips2D.from_fields(draw_order=self._order)
        self._timeline.declare(Entity(self._path, self._role), style)
        # columns cannot be made of nothing: a line that no time shows stands for it
        lines = self._lines or [np.zeros((2, 2), np.float32)]
        columns = rr.LineStrips2D.columns(
            strips=lines,
            colors=np.array(self._colours or [0], np.uint32),
            radii=np.array(self._radii or [0.0], np.float32),
        )
        self._timeline.send(self._path, self._times, columns.partition(self._counts))
        self._times, self._counts = [], []
        self._lines, self._colours, self._radii = [], [], []
