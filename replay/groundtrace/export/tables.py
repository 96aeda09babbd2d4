"""Exports as tables: CSV, Parquet, and labels for Audacity."""

from __future__ import annotations

import csv
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.signals import FIRST_DATE_NS, NS_PER_S
from groundtrace_codecs.truth import guarded_cell

from .base import LABELS, Miss, Written, all_kinds, events_of_kind, iso_utc, misses, write_tables

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Label, StepEvent

    from .base import Cells, Column, Material, Table


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
        writer.writerow([guarded_cell(column.name) for column in table.columns])
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
        case "text":
            return ["" if v is None else guarded_cell(str(v)) for v in cells]
    return ["" if v is None else str(v) for v in cells]


def seconds_text(time_ns: int) -> str:
    """Return nanoseconds as seconds, exactly."""
    sign = "-" if time_ns < 0 else ""
    seconds, part = divmod(abs(time_ns), NS_PER_S)
    return f"{sign}{seconds}.{part:09d}"


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
    units = [{"unit": column.unit} if column.unit else None for column in table.columns]
    named = zip(table.columns, units, strict=True)
    columns = [pa.field(c.name, types[c.type], metadata=unit) for c, unit in named]
    schema = pa.schema(columns, metadata=dict(table.notes) or None)
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


#: Start and end [ns], and what is said.
Line = tuple[int, int, str]


def _step_words(step: StepEvent) -> str:
    return " ".join(filter(None, (step.kind, step.type, step.foot)))


#: What is said of the events that have a label.
WORDS: dict[str, Callable[[Any], str]] = {
    "steps": _step_words,
    "picks": lambda pick: f"pick {pick.channel}",
    "presence": lambda span: f"vehicle {span.channel}",
    "disturbances": lambda span: f"disturbed {span.stage}",
}


class AudacityExporter:
    """Writes label tracks; Sonic Visualiser and Praat's importers read them too."""

    name = "audacity"
    description = "labels of Audacity: moments and spans with a text"
    suffixes = (".txt",)
    kinds = (*WORDS, *LABELS, "misses")
    one_kind = False

    def write(self, material: Material, kinds: Sequence[str], path: Path) -> Written:
        """Write a line for each moment or span, in order of time."""
        by_kind = {kind: list(_lines(material, kind)) for kind in kinds}
        lines = sorted(line for several in by_kind.values() for line in several)
        start_ns = material.start_ns
        text = "".join(
            f"{seconds_text(a - start_ns)}\t{seconds_text(b - start_ns)}\t{_one_line(label)}\n"
            for a, b, label in lines
        )
        path.write_text(text, "utf-8")
        return Written({kind: len(several) for kind, several in by_kind.items()})


def _lines(material: Material, kind: str) -> Iterator[Line]:
    if kind in WORDS:
        yield from (_event_line(event, WORDS[kind]) for event in events_of_kind(material, kind))
    elif kind == "misses":
        yield from map(_miss_line, misses(material))
    elif kind == "truth":
        yield from (_label_line(label, "true ") for label in material.labels)
    else:
        yield from (_label_line(a.label, "") for a in material.annotations)


def _event_line(event: Any, words: Callable[[Any], str]) -> Line:
    return event.time_ns, getattr(event, "end_ns", event.time_ns), words(event)


def _miss_line(miss: Miss) -> Line:
    words = (miss.verdict, f"({miss.cause})" if miss.cause else "")
    return miss.time_ns, miss.time_ns, " ".join(filter(None, words))


def _label_line(label: Label, before: str) -> Line:
    end_ns = label.time_ns if label.end_ns is None else label.end_ns
    words = (label.kind, label.channel, label.label, label.target, label.note)
    return label.time_ns, end_ns, before + " ".join(filter(None, words))


def _one_line(text: str) -> str:
    """Return a text without what ends a cell or a line."""
    return " ".join(text.split())
