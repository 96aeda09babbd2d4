"""Settings of a sweep that a replay refuses, as a wait shorter than what is waited for."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from ..errors import PipelineError
from ..pipeline import build_pipeline
from .grid import Grid, make_grid
from .measuring import with_values

if TYPE_CHECKING:
    from collections.abc import Iterable

    from ..pipeline import PipelineConfig
    from .grid import Axis


class _Builder:
    """Builds the pipeline with one parameter changed; remembers why that was refused first."""

    def __init__(self, config: PipelineConfig) -> None:
        self._config = config
        self.reason = ""

    def accepts(self, axis: Axis, value: Any) -> bool:
        """Return whether a replay takes the value."""
        try:
            build_pipeline(with_values(self._config, [axis], [value]))
        except PipelineError as error:
            self.reason = self.reason or str(error)
            return False
        return True

    def accepted(self, axis: Axis, values: Iterable[Any]) -> set[Any]:
        """Return the values that a replay takes.

        What stages ask of each other bounds a parameter from one side, so that the two ends of a
        range tell of what lies between them, and the bound is found in a few trials.
        """
        known = sorted(set(values)) if axis.span else list(dict.fromkeys(values))
        if not axis.span:
            return {v for v in known if self.accepts(axis, v)}
        first, last = self.accepts(axis, known[0]), self.accepts(axis, known[-1])
        if first == last:
            return set(known) if first else set()
        bound = bisect_left(known, True, key=lambda v: self.accepts(axis, v) == last)
        return set(known[bound:] if last else known[:bound])


def without_refused(grid: Grid, config: PipelineConfig) -> tuple[Grid, str]:
    """Leave out the settings that a replay would refuse.

    Parameters
    ----------
    grid
        The settings.
    config
        The pipeline as it stands, which is no refused one.

    Returns
    -------
    The other settings, and what was left out and why, in one line; empty where nothing was.

    Raises
    ------
    PipelineError
        Where every setting is refused; it says why.
    """
    builder = _Builder(config)
    columns = list(zip(*grid.rows, strict=True))
    accepted = [builder.accepted(a, column) for a, column in zip(grid.axes, columns, strict=True)]
    rows = tuple(
        row for row in grid.rows if all(v in kept for v, kept in zip(row, accepted, strict=True))
    )
    count = len(grid) - len(rows)
    if not count:
        return grid, ""
    if not rows:
        raise PipelineError(builder.reason)
    note = f"{count} of {len(grid)} settings left out, which a replay refuses: {builder.reason}"
    if grid.shape is None:
        return Grid(grid.axes, rows, None), note
    axes = [
        replace(axis, values=tuple(v for v in axis.values if v in kept))
        for axis, kept in zip(grid.axes, accepted, strict=True)
    ]
    return make_grid(axes), note
