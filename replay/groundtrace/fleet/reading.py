"""A fleet's tables, read back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import RecordingError
from .table import steps_path

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

#: Without these a table is none of a fleet.
_NEEDED = ("location", "recording", "sha256", "pipeline", "steps_f1", "error")
_OF_MATCHING = frozenset(
    f"steps_{name}" for name in ("f1", "precision", "recall", "f1_debiased", "matched", "detected")
)


@dataclass(frozen=True, slots=True)
class FleetTable:
    """Rows of a fleet's table.

    Attributes
    ----------
    name
        File name.
    columns
        Cells by the column's name, row by row; None is an empty cell.
    """

    name: str
    columns: dict[str, list[Any]]

    def __len__(self) -> int:
        return len(self.columns["recording"])

    def of(self, column: str) -> list[Any]:
        """Return the cells of a column; None in each row where an older table has no such one."""
        return self.columns.get(column, [None] * len(self))

    def numbers(self, column: str) -> NDArray[np.float64]:
        """Return the cells of a column as numbers, NaN where empty, shape (rows,).

        Where truth is a count without times there are no true steps to match: figures of matching,
        which are 0 then, are NaN.
        """
        values = np.array([np.nan if v is None else v for v in self.of(column)], np.float64)
        if column in _OF_MATCHING:
            values[self.numbers("steps_truth") == 0] = np.nan
        return values

    def pipelines(self) -> list[str]:
        """Return the names of the pipelines that ran, sorted."""
        return sorted(
            {p for p, e in zip(self.of("pipeline"), self.of("error"), strict=True) if not e}
        )

    def rows_of(self, pipeline: str) -> NDArray[np.bool_]:
        """Return which rows are of a pipeline and have no error, shape (rows,)."""
        pairs = zip(self.of("pipeline"), self.of("error"), strict=True)
        return np.array([p == pipeline and not e for p, e in pairs], np.bool_)


@dataclass(frozen=True, slots=True)
class MissedStep:
    """A missed step of a fleet.

    Attributes
    ----------
    miss
        Its number among the missed ones of its recording, from 1.
    time_s
        Since the first sample [s].
    cause, text
        Why.
    """

    miss: int
    time_s: float
    cause: str
    text: str


def read_table(path: Path) -> FleetTable:
    """Read a fleet's table.

    Raises
    ------
    RecordingError
        Where it is none.
    """
    from pyarrow import ArrowInvalid
    from pyarrow.parquet import read_table as read

    if not path.is_file():
        raise RecordingError(f"{path}: expected a fleet's table, found no such file")
    try:
        table = read(path)
    except ArrowInvalid as error:
        said = str(error).splitlines()[0]
        raise RecordingError(f"{path}: expected a fleet's table, found: {said}") from None
    missing = [name for name in _NEEDED if name not in table.column_names]
    if missing:
        raise RecordingError(f"{path}: expected a fleet's table, found no column {missing[0]}")
    utc = [name for name in table.column_names if name.endswith("_utc")]
    return FleetTable(path.name, table.drop_columns(utc).to_pydict())


def missed_steps(table: Path) -> dict[tuple[str, str], list[MissedStep]]:
    """Return the missed steps by location and pipeline; none without a table of steps."""
    from pyarrow.parquet import read_table as read

    path = steps_path(table)
    if not path.is_file():
        return {}
    names = ("location", "pipeline", "miss", "time_s", "cause", "text")
    found: dict[tuple[str, str], list[MissedStep]] = {}
    missed = read(path, columns=list(names), filters=[("verdict", "==", "missed")]).to_pydict()
    for location, pipeline, *rest in zip(*(missed[name] for name in names), strict=True):
        found.setdefault((location, pipeline), []).append(MissedStep(*rest))
    return found
