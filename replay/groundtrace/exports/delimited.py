"""CSV: a table a kind, UTF-8, comma, point."""

from __future__ import annotations

import csv
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from .kinds import all_kinds
from .many import write_tables
from .times import iso_utc

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from .api import Material, Written
    from .tables import Cells, Column, Table


class CsvExporter:
    """Writes tables that any program reads; numbers as short as they are exact."""

    name = "csv"
    description = "a table of each kind, with units in the names of its columns"
    suffixes = (".csv",)
    one_kind = True

    def __init__(self) -> None:
        self.kinds = all_kinds()

    def write(self, material: Material, kinds: Sequence[str], path: Path) -> Written:
        """Write a kind to a file, or each kind to a file in a folder."""
        return write_tables(material, kinds, path, ".csv", write_csv)


def write_csv(table: Table, path: Path) -> int:
    """Write a table; return how many rows it has."""
    rows = 0
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([column.name for column in table.columns])
        for batch in table.batches:
            cells = [_texts(c, v) for c, v in zip(table.columns, batch, strict=True)]
            writer.writerows(zip(*cells, strict=True))
            rows += len(cells[0])
    return rows


def _texts(column: Column, values: Cells) -> list[str]:
    """Return the cells of a column as text."""
    cells: Sequence[Any] | NDArray[Any] = values
    # a float32 is written as such: as a float64 it would have digits that nobody measured
    if isinstance(values, np.ndarray) and values.dtype != np.float32:
        cells = values.tolist()
    match column.type:
        case "seconds":
            return ["" if v is None else seconds_text(int(v)) for v in cells]
        case "utc":
            return ["" if v is None else iso_utc(int(v)) or "" for v in cells]
        case "float":
            return ["" if v is None or math.isnan(v) else str(v) for v in cells]
        case "bool":
            return [str(bool(v)).lower() for v in cells]
    return ["" if v is None else str(v) for v in cells]


def seconds_text(time_ns: int) -> str:
    """Return nanoseconds as seconds, exactly."""
    sign = "-" if time_ns < 0 else ""
    whole, part = divmod(abs(time_ns), NS_PER_S)
    return f"{sign}{whole}.{part:09d}"
