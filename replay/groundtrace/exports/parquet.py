"""Parquet: the tables of CSV with types."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.signals import FIRST_DATE_NS, NS_PER_S

from .kinds import all_kinds
from .many import write_tables

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from .api import Material, Written
    from .tables import Cells, Column, Table


#: Rows of a group: what readers read at once.
GROUP_ROWS = 1 << 16


class ParquetExporter:
    """Writes tables for pandas, polars, DuckDB and others."""

    name = "parquet"
    description = "the tables of csv, with types; times in UTC to the nanosecond"
    suffixes = (".parquet", ".pq")
    one_kind = True

    def __init__(self) -> None:
        self.kinds = all_kinds()

    def write(self, material: Material, kinds: Sequence[str], path: Path) -> Written:
        """Write a kind to a file, or each kind to a file in a folder."""
        return write_tables(material, kinds, path, ".parquet", write_parquet)


def write_parquet(table: Table, path: Path) -> int:
    """Write a table; return how many rows it has."""
    import pyarrow as pa
    from pyarrow.parquet import ParquetWriter

    types = {
        "seconds": pa.float64(),
        "utc": pa.timestamp("ns", "UTC"),
        "int": pa.int64(),
        "float": pa.float64(),
        "text": pa.string(),
        "bool": pa.bool_(),
    }
    schema = pa.schema([(c.name, types[c.type]) for c in table.columns])
    rows, waiting = 0, []
    with ParquetWriter(path, schema) as writer:
        for batch in table.batches:
            pairs = zip(table.columns, batch, strict=True)
            arrays = [pa.array(_cells(c, v), types[c.type]) for c, v in pairs]
            waiting.append(pa.Table.from_arrays(arrays, schema=schema))
            rows += len(arrays[0])
            if sum(map(len, waiting)) >= GROUP_ROWS:
                writer.write_table(pa.concat_tables(waiting).combine_chunks())
                waiting = []
        if waiting:
            writer.write_table(pa.concat_tables(waiting).combine_chunks())
    return rows


def _cells(column: Column, values: Cells) -> Any:
    """Return the cells of a column as Arrow takes them."""
    match column.type:
        case "seconds" if isinstance(values, np.ndarray):
            return values / NS_PER_S
        case "utc" if isinstance(values, np.ndarray) and values.min() >= FIRST_DATE_NS:
            return values
        case "seconds":
            return [None if v is None else int(v) / NS_PER_S for v in values]
        case "utc":
            # a clock that is not the calendar's has no date
            return [int(v) if v >= FIRST_DATE_NS else None for v in values]
        case "float" if isinstance(values, np.ndarray):
            return values.astype(np.float64)
    return values
