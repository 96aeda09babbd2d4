"""The two tables of a fleet, out of its parts."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

from ..appearing import appearing
from ..explain.reasons import CAUSES
from ..exports.parquet import write_parquet
from ..exports.tables import Column, Table
from .figures import FIGURES
from .rows import OF_THE_RUN, Part, Row

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from ..exports.tables import ColumnType
    from .parts import Parts

_TYPES: dict[str, ColumnType] = {"str": "text", "int": "int", "float": "float"}
#: Fields of a row that become several columns, or are put elsewhere.
_SPREAD = ("figures", "causes", "score_json", "error", *OF_THE_RUN)
_STEP_COLUMNS = (
    Column("location", "text"),
    Column("recording", "text"),
    Column("sha256", "text"),
    Column("pipeline", "text"),
    Column("pipeline_sha256", "text"),
    Column("verdict", "text"),
    Column("step", "int"),
    Column("miss", "int"),
    Column("time_s", "float"),
    Column("time_ns", "int"),
    Column("found_s", "float"),
    Column("error_ms", "float"),
    Column("cause", "text"),
    Column("gate", "text"),
    Column("text", "text"),
)


@dataclass(frozen=True, slots=True)
class Listed:
    """A row of a table: where its recording was found, and the key of its part."""

    location: str
    key: str


@dataclass(frozen=True, slots=True)
class Joined:
    """What two tables hold.

    Attributes
    ----------
    rows, steps
        Of the tables.
    errors, warnings
        Rows with an error, and with a warning.
    digest
        SHA-256 of all that was decided, wherever the recordings lie: the same for the same
        recordings, pipelines and versions, whatever computed it, and however fast.
    """

    rows: int
    steps: int
    errors: int
    warnings: int
    digest: str


def steps_path(table: Path) -> Path:
    """Return the path of the table of steps that goes with a table."""
    return table.with_name(f"{table.stem}.steps{table.suffix}")


def join(parts: Parts, listed: Sequence[Listed], table: Path) -> Joined:
    """Write the tables, in the order of ``listed``; each appears whole or not at all.

    Raises
    ------
    RecordingError
        Where a part is missing.
    """
    digest = hashlib.sha256()
    rows: list[tuple[str, Row]] = []

    def steps() -> Iterator[Sequence[Any]]:
        for item in listed:
            part = parts.read(item.key)
            digest.update(part.decided())
            rows.append((item.location, part.row))
            if part.steps:
                yield _step_cells(item.location, part)

    count = _written(Table("steps", _STEP_COLUMNS, steps()), steps_path(table))
    _written(_rows_table(rows), table)
    errors = sum(bool(row.error) for _, row in rows)
    warnings = sum(bool(row.warnings) for _, row in rows)
    return Joined(len(rows), count, errors, warnings, digest.hexdigest())


def _written(table: Table, path: Path) -> int:
    with appearing(path) as fresh:
        return write_parquet(table, fresh)


def _columns() -> list[tuple[Column, Callable[[str, Row], Any]]]:
    """Return the columns of the first table, and what their cells are."""
    named = {f.name: _TYPES.get(str(f.type).split(" ")[0], "text") for f in fields(Row)}
    plain = [name for name in named if name not in _SPREAD]
    where = plain.index("start_ns")
    last = ("score_json", "error", *OF_THE_RUN)
    return [
        (Column("location", "text"), lambda location, _: location),
        *((Column(name, named[name]), _field(name)) for name in plain[:where]),
        (Column("start_utc", "utc"), lambda _, row: row.start_ns or 0),
        *((Column(name, named[name]), _field(name)) for name in plain[where:]),
        *((Column(f.name, f.type), _figure(f.name)) for f in FIGURES),
        *((Column(f"missed_{cause}", "int"), _cause(cause)) for cause in CAUSES),
        *((Column(name, named[name]), _field(name)) for name in last),
    ]


def _field(name: str) -> Callable[[str, Row], Any]:
    return lambda _, row: getattr(row, name)


def _figure(name: str) -> Callable[[str, Row], Any]:
    return lambda _, row: row.figures.get(name)


def _cause(name: str) -> Callable[[str, Row], Any]:
    """Return how many misses have a cause; None where there are no true steps to miss."""

    def cell(_: str, row: Row) -> int | None:
        return row.causes.get(name, 0) if row.figures.get("steps_truth") is not None else None

    return cell


def _rows_table(rows: Sequence[tuple[str, Row]]) -> Table:
    pairs = _columns()
    batch = [[cell(*row) for row in rows] for _, cell in pairs]
    return Table("fleet", tuple(column for column, _ in pairs), [batch] if rows else [])


def _step_cells(location: str, part: Part) -> list[Sequence[Any]]:
    row, steps, start_ns = part.row, part.steps, part.row.start_ns or 0
    same = (location, row.recording, row.sha256, row.pipeline, row.pipeline_sha256)
    cells: list[Sequence[Any]] = [[value] * len(steps) for value in same]
    cells += [[getattr(s, name) for s in steps] for name in ("verdict", "step", "miss")]
    cells += [[(s.time_ns - start_ns) / 1e9 for s in steps], [s.time_ns for s in steps]]
    cells.append([None if s.found_ns is None else (s.found_ns - start_ns) / 1e9 for s in steps])
    cells.append(
        [
            None if s.truth_ns is None or s.found_ns is None else (s.found_ns - s.truth_ns) / 1e6
            for s in steps
        ]
    )
    cells += [[getattr(s, name) for s in steps] for name in ("cause", "gate", "text")]
    return cells
