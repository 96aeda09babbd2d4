"""Importer for delimited text: CSV, TSV and their relatives, with a map."""

from __future__ import annotations

import csv
import io
import re
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from typing import IO, TYPE_CHECKING, Any, Literal, Protocol

import numpy as np

from ..errors import FormatError, SchemaError, did_you_mean
from .mapped import TIME_UNITS_NS, import_tables
from .moments import moments

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from .api import Imported, ImportMap, TimeMap

_SUFFIXES = frozenset({".csv", ".tsv", ".txt"})
_MAX_NS = 2**62
#: A row of two numbers or more.
_ROW = re.compile(rb"\s*[-+\d.,eE]+(?:\s*[,;\t ]\s*[-+\d.,eE]+)+\s*")


class TextFile(Protocol):
    """A text table on the disk or in an archive: :class:`pathlib.Path`, ``zipfile.Path``."""

    @property
    def name(self) -> str:
        """Name without folder."""
        ...

    @property
    def suffix(self) -> str:
        """What the name ends in, with its dot."""
        ...

    def read_bytes(self) -> bytes:
        """Return the content."""
        ...

    def open(self, mode: Literal["rb"]) -> IO[bytes]:
        """Return the content as a stream."""
        ...


class DelimitedImporter:
    """Reads text tables whose columns a map names."""

    name = "csv"
    description = "delimited text (CSV, TSV, TXT) with a map"

    def sniff(self, path: Path) -> float:
        """Return 0.5 for the suffixes of text tables, 0.3 for rows of numbers in any other file."""
        if path.suffix.lower() in _SUFFIXES:
            return 0.5
        with path.open("rb") as file:
            lines = file.read(4096).splitlines()[:-1]
        return 0.3 if len(lines) > 1 and all(_ROW.fullmatch(x) for x in lines[-2:]) else 0.0

    def read(self, paths: Sequence[Path], map_: ImportMap | None) -> Imported:
        """Read tables; several are laid one after the other.

        Raises
        ------
        SchemaError
            Without a map, or where map and table do not match.
        FormatError
            Where a file is no text table.
        """
        if map_ is None:
            raise SchemaError(f"{paths[0].name}: expected --map for a text table, found none")
        return import_tables([TextTable.load(path, map_) for path in paths], map_)


@dataclass(frozen=True, slots=True)
class TextTable:
    """The rows of a text table and the names of its columns.

    Attributes
    ----------
    name
        Of the file, for messages.
    header
        Names of the columns, empty where the table has none.
    rows, lines
        Cells of each row of numbers, and its line in the file.
    decimal
        ``.`` or ``,``.
    """

    name: str
    header: tuple[str, ...]
    rows: tuple[list[str], ...]
    lines: tuple[int, ...]
    decimal: str

    @classmethod
    def load(cls, path: TextFile, map_: ImportMap) -> TextTable:
        """Read a table as a map says.

        Raises
        ------
        FormatError
            Where the file is no text of the map's encoding, or holds no rows.
        """
        lines = list(_lines(path, map_))
        named = set(_names(map_))
        header: tuple[str, ...] = ()
        for skipped, (_, cells) in enumerate(lines):
            if skipped > map_.skip_rows:
                break
            stripped = tuple(c.strip() for c in cells)
            if skipped >= map_.skip_rows - 1 and (
                named & set(stripped) or (skipped == map_.skip_rows and _is_header(stripped))
            ):
                header = stripped
        start = map_.skip_rows
        if header and start < len(lines) and tuple(c.strip() for c in lines[start][1]) == header:
            start += 1
        body = [pair for pair in lines[start:] if any(c.strip() for c in pair[1])]
        if not body:
            raise FormatError(f"{path.name}: expected rows of numbers, found none")
        numbers, rows = zip(*body, strict=True)
        return cls(path.name, header, tuple(rows), tuple(numbers), map_.decimal)

    def numbers(self, column: str | int) -> NDArray[np.float64]:
        """Return one column, shape (n,); empty cells are NaN."""
        cells = self.cells(column)
        if self.decimal == ",":
            cells = [c.replace(",", ".") for c in cells]
        try:
            return np.array([float(c) if c else np.nan for c in cells])
        except ValueError as error:
            raise self.wrong(column, cells, float, "a number") from error

    def times_ns(self, time: TimeMap) -> NDArray[np.int64]:
        """Return the sample times [ns], shape (n,), exact to the digit."""
        cells = self.cells(time.column)
        if time.unit == "iso":
            return moments(cells, f"{self.name}: {time.column}")[0]
        factor = TIME_UNITS_NS[time.unit]

        def moment(cell: str) -> int:
            value = Decimal(cell.replace(",", ".") if self.decimal == "," else cell)
            if not value.is_finite() or value.adjusted() > 18 or abs(value) * factor > _MAX_NS:
                raise InvalidOperation
            return round(value * factor)

        try:
            return np.array([moment(c) for c in cells], np.int64)
        except InvalidOperation as error:
            raise self.wrong(time.column, cells, moment, f"a time in {time.unit}") from error

    def texts(self, column: str | int) -> list[str]:
        """Return the cells of a column of times in words."""
        return self.cells(column)

    def groups(self, path: str) -> list[Any]:
        """Return the non-empty cells of a column: a text table has one bout."""
        return [np.array([c for c in self.cells(path) if c])]

    def cells(self, column: str | int) -> list[str]:
        """Return the text of one column, stripped."""
        index = column if isinstance(column, int) else self._find(column)
        try:
            return [row[index].strip() for row in self.rows]
        except IndexError:
            line, row = next(
                (n, r)
                for n, r in zip(self.lines, self.rows, strict=True)
                if not -len(r) <= index < len(r)
            )
            raise SchemaError(
                f"{self.name}: line {line}: expected a cell for column {column}, "
                f"found {len(row)} cells"
            ) from None

    def _find(self, column: str) -> int:
        if self.header.count(column) != 1:
            names = ", ".join(self.header) or "no header (name columns by 0-based index)"
            near = did_you_mean(column, self.header)
            said = f"{column}: expected one column of {names}, found none{near}"
            raise SchemaError(f"{self.name}: {' '.join(said.split())}")  # cells may have lines
        return self.header.index(column)

    def wrong(self, column: str | int, cells: list[str], parse: Any, expected: str) -> SchemaError:
        """Return the error of the first cell that does not parse."""
        for line, cell in zip(self.lines, cells, strict=True):
            try:
                parse(cell or "nan" if parse is float else cell)
            except (ValueError, InvalidOperation):
                return SchemaError(
                    f"{self.name}: line {line}: {column}: expected {expected}, found {cell[:40]!r}"
                )
        return SchemaError(f"{self.name}: {column}: expected {expected}")


def _lines(path: TextFile, map_: ImportMap) -> Iterator[tuple[int, list[str]]]:
    """Yield line number and cells, without empty lines and comments."""
    try:
        text = path.read_bytes().decode(map_.encoding)
    except (UnicodeDecodeError, LookupError) as error:
        raise FormatError(f"{path.name}: expected {map_.encoding} text, found: {error}") from error
    delimiter = map_.delimiter or ("\t" if path.suffix.lower() == ".tsv" else ",")
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter)
    try:
        for cells in reader:
            if not cells or (map_.comment and cells[0].startswith(map_.comment)):
                continue
            yield reader.line_num, cells
    except csv.Error as error:
        raise FormatError(
            f"{path.name}: line {reader.line_num}: expected delimited text, found: {error}"
        ) from error


def _names(map_: ImportMap) -> Iterator[str]:
    """Yield the column names the map uses."""
    times = [t for t in (map_.time, *(s.time for s in map_.stream)) if t is not None]
    counters = [c for c in (map_.counter, *(s.counter for s in map_.stream)) if c is not None]
    columns = [t.column for t in times] + [c.column for c in counters]
    columns += [c.column for s in map_.stream for c in s.columns]
    yield from (c for c in columns if isinstance(c, str))


def _is_header(cells: tuple[str, ...]) -> bool:
    """Return whether no cell of the row is a number."""
    return not any(c[:1].isdigit() or c[:1] in tuple("+-.") for c in cells if c)
