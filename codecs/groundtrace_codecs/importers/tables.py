"""Importers of tables: delimited text, MATLAB, HDF5 and NumPy archives, with a map.

The bytes of MATLAB files up to version 7.2 are read here (MAT-File Format, The MathWorks, R2024b:
level 4 and level 5). Every length is checked against the rest of the file before it is believed, so
that a damaged file is an error of one line. Tables, strings of the string class, function handles
and sparse arrays are kept as the name of their class only, as they hold no column that a path could
lead to.
"""

from __future__ import annotations

import csv
import io
import math
import re
import zipfile
import zlib
from collections import deque
from collections.abc import Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from decimal import Decimal, InvalidOperation
from functools import partial
from itertools import chain, islice
from typing import IO, TYPE_CHECKING, Any, Literal, Protocol

import numpy as np

from ..errors import CodecError, FormatError, SchemaError, did_you_mean
from ..truth import plain_cell
from ..unpacking import DEFLATE_RATIO, most_unpacked, too_much
from . import map as expressions
from .base import StartMap
from .map import TIME_UNITS_NS, import_tables
from .stored import Computed, Spool, StoredArray, pieces, rows_in

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from .base import Imported, ImportMap, TimeMap
    from .stored import Column

_SUFFIXES = frozenset({".csv", ".tsv", ".txt"})
_MAX_NS = 2**62
#: A line of a table has fewer characters: 30 000 columns of 30 digits.
_LONGEST_LINE = 1 << 20
#: Rows of a text table read at once.
_ROWS = 4096
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
            raise SchemaError(
                f"{paths[0].name}: expected --map for a text table, found none; groundtrace import "
                f"{paths[0].name} --guess writes one to start from"
            )
        return import_tables([TextTable.load(path, map_) for path in paths], map_)


@dataclass(frozen=True, slots=True, eq=False)
class TextTable:
    """The columns of a text table that a map names: read in one go, kept in temporary files.

    Attributes
    ----------
    name
        Of the file, for messages.
    header
        Names of the columns, empty where the table has none.
    lines
        The line in the file of each row of numbers.
    numeric
        Columns of numbers, by place and by what they are: ``number``, or the unit of a time.
    worded
        Columns of texts, by place.
    """

    name: str
    header: tuple[str, ...]
    lines: Column
    numeric: dict[tuple[int, str], _Numbers]
    worded: dict[int, _Texts]

    @classmethod
    def load(cls, path: TextFile, map_: ImportMap) -> TextTable:
        """Read a table as a map says.

        Raises
        ------
        FormatError
            Where the file is no text of the map's encoding, or holds no rows.
        """
        header, body = _head(path, map_)
        used = {(i, kind) for c, kind in _used(map_) if (i := _index(c, header)) is not None}
        numbers = sorted((i, kind) for i, kind in used if kind != "text")
        spool = Spool(np.int64, (1 + len(numbers),))  # the line of each row, then its numbers
        numeric = {
            (i, kind): _Numbers(i, kind, map_.decimal, spool, at)
            for at, (i, kind) in enumerate(numbers, 1)
        }
        worded = {i: _Texts(i) for i, kind in used if kind == "text"}
        while batch := list(islice(body, _ROWS)):
            lines, rows = zip(*batch, strict=True)
            block = np.zeros((len(rows), 1 + len(numbers)), np.int64)
            block[:, 0] = lines
            for column in numeric.values():
                column.take(lines, rows, block)
            for texts in worded.values():
                texts.take(lines, rows)
            spool.write(block)
        if not len(spool):
            raise FormatError(f"{path.name}: expected rows of numbers, found none")
        at_lines = Computed(len(spool), lambda rows: spool[rows][:, 0])
        return cls(path.name, header, at_lines, numeric, worded)

    def numbers(self, column: str | int) -> Column:
        """Return one column of numbers; empty cells are NaN."""
        cells = self.numeric[self._find(column), "number"]
        self._check(column, cells, "a number")
        return cells.rows()

    def times_ns(self, time: TimeMap) -> Column:
        """Return the sample times [ns], exact to the digit."""
        cells = self.numeric[self._find(time.column), time.unit]
        self._check(time.column, cells, f"a time in {time.unit}")
        return cells.rows()

    def texts(self, column: str | int) -> Iterable[str]:
        """Return the cells of a column of times in words."""
        cells = self.worded[self._find(column)]
        self._check(column, cells, "a text")
        return cells

    def groups(self, path: str) -> list[Any]:
        """Return the non-empty cells of a column: a text table has one bout."""
        return [np.array([c for c in self.texts(path) if c])]

    def _find(self, column: str | int) -> int:
        index = _index(column, self.header)
        if index is None:
            names = ", ".join(self.header) or "no header (name columns by 0-based index)"
            near = did_you_mean(column, self.header)
            message = f"{column}: expected one column of {names}, found none{near}"
            raise SchemaError(f"{self.name}: {' '.join(message.split())}")  # cells may have lines
        return index

    def _check(self, column: str | int, cells: _Cells, expected: str) -> None:
        """Refuse a column with a cell that is not there, or not what it should be."""
        if cells.short is not None:
            line, count = cells.short
            raise SchemaError(
                f"{self.name}: line {line}: expected a cell for column {column}, "
                f"found {count} cells"
            )
        if cells.wrong is not None:
            line, cell = cells.wrong
            raise SchemaError(
                f"{self.name}: line {line}: {column}: expected {expected}, found {cell[:40]!r}"
            )


def _index(column: str | int, header: Sequence[str]) -> int | None:
    """Return the place of a column, None where the header has not one of that name."""
    if isinstance(column, int):
        return column
    return header.index(column) if header.count(column) == 1 else None


@dataclass(slots=True)
class _Cells:
    """One column while it is read.

    Attributes
    ----------
    index
        Its place in a row.
    short, wrong
        The first line that has no such cell, and how many it has; the first line whose cell is not
        what it should be, and the cell.
    """

    index: int
    short: tuple[int, int] | None = field(default=None, init=False)
    wrong: tuple[int, str] | None = field(default=None, init=False)

    def of(self, lines: Sequence[int], rows: Sequence[list[str]]) -> list[str]:
        """Return the cells of some rows."""
        try:
            return [row[self.index] for row in rows]
        except IndexError:
            within = [-len(row) <= self.index < len(row) for row in rows]
            at = within.index(False)
            self.short = self.short or (lines[at], len(rows[at]))
            return [row[self.index] if has else "" for row, has in zip(rows, within, strict=True)]


@dataclass(slots=True)
class _Numbers(_Cells):
    """A column of numbers, or of times of a unit.

    Attributes
    ----------
    kind
        ``number``, or the unit of a time.
    decimal
        ``.`` or ``,``.
    spool, column
        Where the numbers are kept, and in which column; fractions by their bits.
    """

    kind: str
    decimal: str
    spool: Spool
    column: int

    def take(
        self, lines: Sequence[int], rows: Sequence[list[str]], block: NDArray[np.int64]
    ) -> None:
        """Put the numbers of some rows into their column of a block."""
        cells = self.of(lines, rows)
        if self.decimal == ",":
            cells = [c.replace(",", ".") for c in cells]
        number = float if self.kind == "number" else _MOMENTS[self.kind]
        try:
            numbers = list(map(number, cells))
        except (ValueError, InvalidOperation):
            numbers = [self._one(number, line, c) for line, c in zip(lines, cells, strict=True)]
        kind = np.float64 if self.kind == "number" else np.int64
        block[:, self.column] = np.array(numbers, kind).view(np.int64)

    def _one(self, number: Callable[[str], float], line: int, cell: str) -> float:
        """Return the number of a cell; NaN of an empty one, which is no time."""
        stripped = cell.strip()
        if self.kind == "number" and not stripped:
            return np.nan
        try:
            return number(stripped)
        except (ValueError, InvalidOperation):
            self.wrong = self.wrong or (line, stripped)
            return 0

    def rows(self) -> Column:
        """Return the numbers, or times [ns]."""
        kind = np.float64 if self.kind == "number" else np.int64
        spool, column = self.spool, self.column
        return Computed(
            len(spool), lambda rows: np.ascontiguousarray(spool[rows][:, column]).view(kind)
        )


@dataclass(slots=True)
class _Texts(_Cells):
    """A column of texts, which is gone through as often as wanted."""

    spool: Spool = field(default_factory=lambda: Spool(np.uint8))

    def take(self, lines: Sequence[int], rows: Sequence[list[str]]) -> None:
        """Keep the cells of some rows."""
        cells = (cell.strip().replace("\0", "") for cell in self.of(lines, rows))
        self.spool.write("".join(f"{cell}\0" for cell in cells).encode("utf-8", "surrogatepass"))

    def __iter__(self) -> Iterator[str]:
        rest = b""
        for rows in pieces(len(self.spool)):
            *cells, rest = (rest + self.spool[rows].tobytes()).split(b"\0")
            yield from (cell.decode("utf-8", "surrogatepass") for cell in cells)


def _moment(digits: int) -> Callable[[str], int]:
    """Return what reads a time as nanoseconds, exact to the digit.

    Parameters
    ----------
    digits
        Of a nanosecond behind the point.
    """
    factor = int(10**digits)

    def moment(cell: str) -> int:
        integer, _, part = cell.partition(".")
        plain = integer.isdecimal() and (not part or part.isdecimal()) and cell.isascii()
        if plain and len(integer) <= 18 - digits and len(part) <= digits:
            return int(integer) * factor + int(part.ljust(digits, "0") or "0")
        value = Decimal(cell)
        if not value.is_finite() or value.adjusted() > 18 or abs(value) * factor > _MAX_NS:
            raise InvalidOperation
        moment_ns: int = round(value * factor)
        return moment_ns

    return moment


#: What reads the times of each unit.
_MOMENTS = {"s": _moment(9), "ms": _moment(6), "us": _moment(3), "ns": _moment(0)}


def _used(map_: ImportMap) -> Iterator[tuple[str | int, str]]:
    """Yield the columns that a map uses, and what it takes them for."""
    for time in (map_.time, *(s.time for s in map_.stream)):
        if time is not None:
            yield time.column, "text" if time.unit == "iso" else time.unit
    for counter in (map_.counter, *(s.counter for s in map_.stream)):
        if counter is not None:
            yield counter.column, "number"
    yield from ((c.column, "number") for s in map_.stream for c in s.columns)
    for truth in map_.truth:
        counts = (truth.increments_of, truth.total_of)
        yield from ((c, "number") for c in counts if c is not None)
        paths = (truth.time, truth.end, truth.label, truth.value, truth.x, truth.y)
        yield from ((path, "text") for path in paths if path is not None)
    if isinstance(map_.start, StartMap):
        yield map_.start.column, "text"
    if map_.orientation is not None:
        yield map_.orientation.quaternion, "text"
        if map_.orientation.field is not None:
            yield map_.orientation.field, "text"


def names_of_columns(path: TextFile, map_: ImportMap) -> tuple[str, ...]:
    """Return the names in the first row of a text table, none where a number is among them.

    Raises
    ------
    FormatError
        Where the file is no text of the map's encoding.
    """
    return _head(path, map_)[0]


def _head(
    path: TextFile, map_: ImportMap
) -> tuple[tuple[str, ...], Iterator[tuple[int, list[str]]]]:
    """Return the names of the columns, and the lines and cells of the rows of numbers."""
    named = {c for c, _ in _used(map_) if isinstance(c, str)}
    lines = _lines(path, map_)
    before = deque(islice(lines, map_.skip_rows), 1)  # the last skipped row
    first = next(lines, None)
    header: tuple[str, ...] = ()
    if before and named & set(cells := _stripped(before[0][1])):
        header = cells
    if first is not None:
        cells = _stripped(first[1])
        if named & set(cells) or _is_header(cells):
            header = cells
        if header != cells:
            lines = chain([first], lines)
    return header, (pair for pair in lines if any(c.strip() for c in pair[1]))


def _stripped(cells: Sequence[str]) -> tuple[str, ...]:
    return tuple(plain_cell(c.strip()) for c in cells)


def _lines(path: TextFile, map_: ImportMap) -> Iterator[tuple[int, list[str]]]:
    """Yield line number and cells, without empty lines and comments."""
    delimiter = map_.delimiter or ("\t" if path.suffix.lower() == ".tsv" else ",")
    reader = csv.reader(_whole_lines(path, map_.encoding), delimiter=delimiter)
    try:
        for cells in reader:
            if not cells or (map_.comment and cells[0].startswith(map_.comment)):
                continue
            yield reader.line_num, cells
    except csv.Error as error:
        raise FormatError(
            f"{path.name}: line {reader.line_num}: expected delimited text, found: {error}"
        ) from error


def _whole_lines(path: TextFile, encoding: str) -> Iterator[str]:
    """Yield the lines of a text; one that no table has is refused before it is in memory."""
    with path.open("rb") as file:
        try:
            text = io.TextIOWrapper(file, encoding, newline="")
            number = 0
            while line := text.readline(_LONGEST_LINE):
                number += 1
                if len(line) == _LONGEST_LINE:
                    raise FormatError(
                        f"{path.name}: line {number}: expected less than {_LONGEST_LINE} "
                        f"characters, found more"
                    )
                yield line
        except (UnicodeError, LookupError) as error:
            raise FormatError(f"{path.name}: expected {encoding} text, found: {error}") from error


def _is_header(cells: tuple[str, ...]) -> bool:
    """Return whether no cell of the row is a number."""
    return not any(c[:1].isdigit() or c[:1] in tuple("+-.") for c in cells if c)


#: Level 5: version and order of bytes at the end of the header; the text before is free.
_VERSIONS = {b"\x00\x01IM": "<", b"\x01\x00MI": ">"}
_VERSIONS_HDF5 = (b"\x00\x02IM", b"\x02\x00MI")

#: Level 5: data types of elements, without those of numbers.
_MATRIX, _COMPRESSED = 14, 15
_NUMBERS = {
    1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8",
}  # fmt: skip
_TEXTS = {16: "utf-8", 17: "utf-16", 18: "utf-32"}
#: Level 5: classes of arrays.
_CELL, _STRUCT, _OBJECT, _CHAR = 1, 2, 3, 4
_CLASSES = {
    6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8", 15: "u8",
}  # fmt: skip
_OTHERS = {5: "sparse array", 16: "function handle", 17: "object of a class"}
_COMPLEX = 0x08
_HEADER = 128
#: Bytes of a MATLAB file read at once, of those that are no large array.
_AHEAD_BYTES = 1 << 16
#: An element of a cell or struct takes about so much in memory [bytes].
_OBJECT_BYTES = 200
#: A letter of a text takes about so much in memory while it is read [bytes].
_LETTER_BYTES = 20
#: Structs and cells nest no deeper than this in a file anyone has written.
_DEEPEST = 100
#: Level 4: precisions (P) of its type MOPT.
_PRECISIONS = ("f8", "f4", "i4", "i2", "u2", "u1")
_LEVEL_4_HEADER = 20
#: Level 4: a name is no longer than this in a file that is one.
_LONGEST_NAME = 256


@dataclass(frozen=True, slots=True)
class Archive:
    """Nested arrays by name, looked up by path.

    Attributes
    ----------
    name
        Of the file, for messages.
    root
        Arrays and structs by name.
    """

    name: str
    root: Mapping[str, Any]

    def numbers(self, column: str | int) -> Column:
        """Return the vector a path leads to, n numbers."""
        return expressions.column(self.root, str(column), self.name)

    def times_ns(self, time: TimeMap) -> Column:
        """Return the n sample times [ns]."""
        column, factor = self.numbers(time.column), TIME_UNITS_NS[time.unit]

        def times(rows: slice) -> NDArray[np.int64]:
            values = column[rows]
            if not (np.abs(values) <= _MAX_NS / factor).all():  # NaN is not either
                raise SchemaError(f"{self.name}: {time.column}: expected times, found others")
            integers = np.floor(values)  # apart, so that unix times keep all their digits
            parts = np.rint((values - integers) * factor).astype(np.int64)
            times_ns: NDArray[np.int64] = integers.astype(np.int64) * factor + parts
            return times_ns

        return Computed(len(column), times)

    def texts(self, column: str | int) -> list[str]:
        """Refuse times in words: arrays hold numbers."""
        raise SchemaError(
            f"{self.name}: {column}: expected numbers (unit s, ms, us or ns), found others"
        )

    def groups(self, path: str) -> list[Any]:
        """Return what a path leads to, one entry for each element of its ``[*]``."""
        return expressions.evaluate(self.root, path, self.name)


class MatlabImporter:
    """Reads MATLAB files whose variables a map names by path."""

    name = "mat"
    description = "MATLAB files up to version 7.2 with a map"

    def sniff(self, path: Path) -> float:
        """Return 1 for MATLAB's own header, 0.7 for the header of a variable of level 4."""
        with path.open("rb") as file:
            head = file.read(_LEVEL_4_HEADER + _LONGEST_NAME)
        if head[124:_HEADER] in (*_VERSIONS, *_VERSIONS_HDF5) and head[:1].isalpha():
            return 1.0
        return 0.7 if _is_level_4(head, path.stat().st_size) else 0.0

    def read(self, paths: Sequence[Path], map_: ImportMap | None) -> Imported:
        """Read MATLAB files; several are laid one after the other.

        Raises
        ------
        SchemaError
            Without a map, or where map and file do not match.
        FormatError
            Where a file is no MATLAB file of version 4 to 7.2, or damaged.
        """
        if map_ is None:
            raise SchemaError(f"{paths[0].name}: expected --map for a MATLAB file, found none")
        return import_tables([Archive(p.name, _load_mat(p)) for p in paths], map_)


def _load_mat(path: Path) -> dict[str, Any]:
    """Return the variables of a file by name: vectors, numbers and text without axes of one.

    Large arrays stay in the file; what is compressed is unpacked into a temporary file.
    """
    size = path.stat().st_size
    data = _Part(_Window(_exactly(partial(_read, path), path.name), size), 0, size)
    head = data.bytes(0, min(size, _HEADER))
    if head[124:] in _VERSIONS_HDF5:
        raise FormatError(
            f"{path.name}: header: expected MATLAB 4 to 7.2, found 7.3, which is HDF5: put "
            f'format = "hdf5" into the map, or save it with: save -v7'
        )
    if _is_level_4(data.bytes(0, min(size, _LEVEL_4_HEADER + _LONGEST_NAME)), size):
        return dict(_Level4(path.name, data).variables())
    order = _VERSIONS.get(head[124:])
    if order is None:
        raise FormatError(f"{path.name}: header: expected a MATLAB file, found another file")
    room = _Room(path.name, size, most_unpacked(size))
    return dict(_Level5(path.name, data, order, room, _HEADER).variables())


class _Window:
    """Reads bytes of a source; those that follow what was asked for last are at hand.

    Parameters
    ----------
    read
        Returns bytes from a place on, as many as wanted.
    size
        How many there are.
    """

    def __init__(self, read: Callable[[int, int], bytes], size: int) -> None:
        self._read, self._size = read, size
        self._begin, self._buffered = 0, b""

    def __call__(self, at: int, count: int) -> bytes:
        """Return bytes from a place on."""
        inside = at - self._begin
        if not 0 <= inside <= len(self._buffered) - count:
            if count > _AHEAD_BYTES:
                return self._read(at, count)
            self._buffered = self._read(at, min(_AHEAD_BYTES, self._size - at))
            self._begin, inside = at, 0
        return self._buffered[inside : inside + count]


@dataclass(frozen=True, slots=True)
class _Part:
    """Bytes of a source from a place on.

    Attributes
    ----------
    source
        A file, or what was unpacked of one.
    begin, size
        Where they begin in it, and how many they are.
    """

    source: _Window
    begin: int
    size: int

    def __len__(self) -> int:
        return self.size

    def bytes(self, at: int, count: int) -> bytes:
        """Return some of the bytes, which are there."""
        return self.source(self.begin + at, count)

    def part(self, at: int, count: int) -> _Part:
        """Return some of the bytes, which are there, unread."""
        return _Part(self.source, self.begin + at, count)

    def stored(self, where: str, shape: tuple[int, ...], type_: str) -> StoredArray:
        """Return the bytes as an array whose first index goes on fastest, without axes of one."""
        lengths = tuple(length for length in shape if length != 1)
        return rows_in(where, self.bytes, lengths, np.dtype(type_), fortran=True)


@dataclass(slots=True)
class _Room:
    """How much the variables of a file may take in memory.

    Attributes
    ----------
    name, packed
        Of the file, and its size [bytes].
    most, taken
        All that its parts may take, and what they took so far [bytes].
    spool
        What is compressed in the file, unpacked.
    """

    name: str
    packed: int
    most: int
    taken: int = 0
    spool: Spool = field(default_factory=lambda: Spool(np.uint8))

    def take(self, size: int) -> None:
        """Count what comes next; more than there is room for is a FormatError."""
        self.taken += size
        if self.taken > self.most:
            raise FormatError(f"{self.name}: {too_much(self.most, self.packed, self.taken)}")

    def unpacked(self, begin: int) -> _Part:
        """Return what was unpacked from a place on."""
        size = len(self.spool)
        source = _Window(_exactly(self.spool.read, self.name), size)
        return _Part(source, begin, size - begin)


@dataclass(slots=True)
class _Level5:
    """Elements of a file of level 5, or of one inside another, one after the other.

    Attributes
    ----------
    name
        Of the file, for messages.
    data
        The elements.
    order
        ``<`` or ``>``.
    room
        What is left for what it holds.
    at
        Where the next one begins.
    depth
        How many arrays it is inside of.
    where
        What is added to messages: a compressed part counts its bytes anew.
    """

    name: str
    data: _Part
    order: str
    room: _Room
    at: int = 0
    depth: int = 0
    where: str = ""

    def variables(self) -> Iterator[tuple[str, Any]]:
        while self.at < len(self.data):
            kind, content = self.element(padded=False)
            if kind == _COMPRESSED:
                where = f" of what is packed before byte {self.at}"
                packed = self._inflated(content)
                inside = _Level5(self.name, packed, self.order, self.room, where=where)
                kind, content = inside.element()
                part = inside._within(content)
            else:
                part = self._within(content)
            if kind != _MATRIX:
                raise self._wrong("an array", f"data of type {kind}")
            name, value = part.array()
            # a variable without a name holds what classes of the file keep to themselves
            if name:
                yield name, value

    def element(self, *, padded: bool = True) -> tuple[int, _Part]:
        """Return the type and the bytes of the next element."""
        offset = self._taken(8, "the tag of an element")
        first, size = np.frombuffer(self.data.bytes(offset, 8), f"{self.order}u4").tolist()
        if first >> 16:  # few bytes, in the tag itself
            kind, size = first & 0xFFFF, first >> 16
            if size > 4:
                raise self._wrong("at most 4 bytes in a tag", f"{size}")
            return kind, self.data.part(offset + 4, size)
        content = self.data.part(self._taken(size, f"{size} bytes"), size)
        if padded or first == _MATRIX:
            self.at = min(self.at + -size % 8, len(self.data))
        return first, content

    def array(self) -> tuple[str, Any]:
        """Return name and value of the array that these elements are of."""
        if not len(self.data):
            return "", np.empty(0)
        flags = self.numbers()
        if not len(flags):
            raise self._wrong("flags of an array", "none")
        class_, complex_ = int(flags[0]) & 0xFF, bool(int(flags[0]) >> 8 & _COMPLEX)
        if class_ == 17:  # it has no shape
            return str(self.text()), Opaque(_OTHERS[class_])
        shape = tuple(int(n) for n in self.numbers())
        if len(shape) < 2 or min(shape) < 0:
            raise self._wrong("a shape", f"{shape}")
        name = self.text()
        if class_ in _OTHERS:
            return name, Opaque(_OTHERS[class_])
        if class_ == _OBJECT:
            self.text()
        if class_ == _CELL:
            return name, self._cells(shape)
        if class_ in (_STRUCT, _OBJECT):
            return name, self._structs(shape)
        if class_ == _CHAR:
            return name, self._characters(shape)
        if class_ not in _CLASSES:
            raise self._wrong("a class of arrays", f"{class_}")
        return name, self._numeric(shape, _CLASSES[class_], complex_=complex_)

    def _numeric(self, shape: tuple[int, ...], class_: str, *, complex_: bool) -> Any:
        """Return the numbers of an array, large ones where they lie."""
        where = f"{self.name}: byte {self.at}{self.where}"
        parts = [self._stored(shape, where) for _ in range(2 if complex_ else 1)]
        stored = _converted(parts, class_)
        size = math.prod(shape) * stored.dtype.itemsize
        if size > _SMALL_BYTES:
            return stored
        self.room.take(size)
        return _squeezed(np.asarray(stored))

    def _stored(self, shape: tuple[int, ...], where: str) -> StoredArray:
        """Return the next element's numbers as an array of a shape."""
        type_, content = self._numbers()
        count = len(content) // int(type_[1])
        if count != math.prod(shape):
            raise self._wrong(f"{math.prod(shape)} values", f"{count}")
        return content.stored(where, shape, self.order + type_)

    def _numbers(self) -> tuple[str, _Part]:
        """Return what the next element's numbers are, and their bytes."""
        kind, content = self.element()
        if kind not in _NUMBERS:
            raise self._wrong("numbers", f"data of type {kind}")
        type_ = _NUMBERS[kind]
        if len(content) % int(type_[1]):
            raise self._wrong(f"numbers of {type_[1]} bytes", f"{len(content)} bytes")
        return type_, content

    def numbers(self) -> NDArray[Any]:
        """Return the next element's numbers, shape (n,)."""
        type_, content = self._numbers()
        return np.frombuffer(self._bytes(content), self.order + type_)

    def text(self) -> str:
        """Return the next element as a name."""
        return _until_zero(self._letters())

    def _letters(self) -> bytes:
        kind, content = self.element()
        if kind not in (1, 2, 16):
            raise self._wrong("a name", f"data of type {kind}")
        return self._bytes(content)

    def _bytes(self, content: _Part, each: int = 1) -> bytes:
        """Return the bytes of an element, each of which takes so many in memory."""
        self.room.take(len(content) * each)
        return content.bytes(0, len(content))

    def _cells(self, shape: tuple[int, ...]) -> Any:
        count = self._believed(shape, 1)
        cells = np.empty(count, object)
        for i in range(count):
            cells[i] = self._next()
        return _squeezed(cells.reshape(shape, order="F"))

    def _structs(self, shape: tuple[int, ...]) -> Any:
        lengths = self.numbers()
        length = int(lengths[0]) if len(lengths) else 0
        raw = self._letters()
        if len(raw) and (length <= 0 or len(raw) % length):
            raise self._wrong("names of fields", f"{len(raw)} bytes of {length} each")
        names = [_until_zero(raw[i : i + length]) for i in range(0, len(raw), length or 1)]
        if not names:
            return {}
        count = self._believed(shape, len(names))
        structs = np.empty(count, object)
        for i in range(count):
            structs[i] = {name: self._next() for name in names}
        return _squeezed(structs.reshape(shape, order="F"))

    def _characters(self, shape: tuple[int, ...]) -> Any:
        """Return the rows of a text, a single one as str."""
        kind, part = self.element()
        content = self._bytes(part, _LETTER_BYTES)
        if kind in _TEXTS:
            order = "" if kind == 16 else "-le" if self.order == "<" else "-be"
            text = str(content, _TEXTS[kind] + order, "replace")
        elif kind in _NUMBERS and _NUMBERS[kind][0] != "f":
            type_ = _NUMBERS[kind]
            if len(content) % int(type_[1]):
                raise self._wrong(f"numbers of {type_[1]} bytes", f"{len(content)} bytes")
            codes = np.frombuffer(content, self.order + type_).astype(np.int64)
            text = "".join(chr(c) if 0 <= c < 0x110000 else "\ufffd" for c in codes.tolist())
        else:
            raise self._wrong("text", f"data of type {kind}")
        if not text or len(shape) != 2 or len(text) != math.prod(shape):
            return text  # of more bytes than letters: only its rows are lost
        rows = ["".join(text[i :: shape[0]]) for i in range(shape[0])]
        return rows[0] if len(rows) == 1 else np.array(rows)

    def _next(self) -> Any:
        """Return the array that comes next, inside this one."""
        if self.depth >= _DEEPEST:
            raise self._wrong(f"at most {_DEEPEST} arrays in each other", "more")
        kind, content = self.element()
        if kind != _MATRIX:
            raise self._wrong("an array", f"data of type {kind}")
        return self._within(content).array()[1]

    def _within(self, content: _Part) -> _Level5:
        where = self.where or f" of the array that ends at byte {self.at}"
        return _Level5(self.name, content, self.order, self.room, 0, self.depth + 1, where)

    def _believed(self, shape: tuple[int, ...], fields: int) -> int:
        """Return how many arrays a shape means; each takes 8 bytes at least."""
        count, left = math.prod(shape), len(self.data) - self.at
        if count * fields * 8 > left:
            raise self._wrong(f"{count * fields} arrays", f"{left} bytes")
        self.room.take(count * fields * _OBJECT_BYTES)
        return count

    def _taken(self, size: int, what: str) -> int:
        """Return where bytes begin, and go on behind them."""
        if size > len(self.data) - self.at:
            raise self._wrong(what, f"{len(self.data) - self.at} bytes")
        self.at += size
        return self.at - size

    def _inflated(self, packed: _Part) -> _Part:
        """Return what a compressed element holds, no more of it than its own tag says."""
        inflate, spool = zlib.decompressobj(), self.room.spool
        begin, at, size, most = len(spool), 0, 0, 8  # the tag first
        try:
            while not inflate.eof and len(spool) - begin < most:
                data = inflate.unconsumed_tail
                if not data:
                    data = packed.bytes(at, min(_AHEAD_BYTES, len(packed) - at))
                    at += len(data)
                if not data:
                    break
                spool.write(inflate.decompress(data, min(_PACKED_BYTES, most - len(spool) + begin)))
                if not size and len(spool) - begin == 8:
                    size = int(np.frombuffer(spool.read(begin, 8), f"{self.order}u4")[1])
                    if size > (limit := most_unpacked(len(packed), DEFLATE_RATIO)):
                        raise FormatError(f"{self.name}: {too_much(limit, len(packed), size)}")
                    most += size + 8
        except zlib.error as error:
            raise self._wrong("compressed data", f"{error}") from error
        if not inflate.eof:
            raise self._wrong(f"{size} bytes in compressed data", "other data")
        return self.room.unpacked(begin)

    def _wrong(self, expected: str, actual: str) -> FormatError:
        return FormatError(
            f"{self.name}: byte {self.at}{self.where}: expected {expected}, found {actual}"
        )


def _converted(parts: Sequence[StoredArray], type_: str) -> StoredArray:
    """Return an array as numbers of a type; the second of two parts is imaginary."""

    def fetch(lead: tuple[int, ...], start: int, stop: int) -> NDArray[Any]:
        real, *imaginary = [part.fetch(lead, start, stop) for part in parts]
        with np.errstate(invalid="ignore"):  # whole numbers that a damaged file calls fractions
            values: NDArray[Any] = real.astype(type_)
        return values + 1j * imaginary[0] if imaginary else values

    dtype = np.dtype(type_ if len(parts) == 1 else "c16")
    return replace(parts[0], dtype=dtype, fetch=fetch)


@dataclass(frozen=True, slots=True)
class Opaque:
    """A variable that holds no numbers by name.

    Attributes
    ----------
    what
        What MATLAB calls it.
    """

    what: str


def _until_zero(name: bytes) -> str:
    return name.split(b"\0")[0].decode("utf-8", "replace")


def _squeezed(values: NDArray[Any]) -> Any:
    """Return an array without its axes of one; of a single cell or number that itself."""
    if not values.size:
        return np.empty(0, values.dtype)
    values = np.squeeze(values)
    return values.item() if values.ndim == 0 else values


@dataclass(frozen=True, slots=True)
class _Level4:
    """A file of level 4: a header of five whole numbers, a name and a matrix, again and again."""

    name: str
    data: _Part

    def variables(self) -> Iterator[tuple[str, Any]]:
        at, end = 0, len(self.data)
        while at < end:
            head = _header_of_4(self.data.bytes(at, min(_LEVEL_4_HEADER, end - at)))
            if head is None:
                raise FormatError(f"{self.name}: byte {at}: expected a variable, found other bytes")
            order, type_, kind, rows, columns, complex_, length = head
            at += _LEVEL_4_HEADER
            size = rows * columns * int(type_[1])
            parts = 2 if complex_ else 1
            if length + parts * size > end - at:
                raise FormatError(
                    f"{self.name}: byte {at}: expected {length + parts * size} bytes, "
                    f"found {end - at}"
                )
            name = _until_zero(self.data.bytes(at, length))
            at += length
            contents = [self.data.part(at + i * size, size) for i in range(parts)]
            where = f"{self.name}: byte {at}"
            at += parts * size
            yield name, self._value(kind, contents, (rows, columns), order + type_, where)

    def _value(
        self, kind: int, parts: list[_Part], shape: tuple[int, int], type_: str, where: str
    ) -> Any:
        """Return a variable of some bytes; of complex numbers the real ones come first."""
        if kind == 2:
            return Opaque("sparse array")
        if kind == 0 and len(parts[0]) > _SMALL_BYTES:
            return _converted([part.stored(where, shape, type_) for part in parts], type_)
        if len(parts[0]) > (limit := most_unpacked(0)):
            raise FormatError(f"{where}: expected at most {limit} bytes of text, found more")
        matrix, *imaginary = [
            np.frombuffer(part.bytes(0, len(part)), type_).reshape(shape, order="F")
            for part in parts
        ]
        if kind == 1:
            if not matrix.size:
                return ""
            with np.errstate(invalid="ignore"):  # damaged letters
                codes = matrix.astype("u1")
            rows = [bytes(row).decode("latin-1") for row in codes]
            return rows[0] if len(rows) == 1 else np.array(rows)
        return _squeezed(matrix + 1j * imaginary[0] if imaginary else matrix)


def _header_of_4(head: bytes | memoryview) -> tuple[str, str, int, int, int, bool, int] | None:
    """Return order, number type, kind (0 numbers, 1 text, 2 sparse), shape, complex, name length.

    None where the bytes are no header of a variable of level 4.
    """
    if len(head) < _LEVEL_4_HEADER:
        return None
    for order in "<>":
        mopt, rows, columns, imaginary, length = np.frombuffer(
            head[:_LEVEL_4_HEADER], f"{order}i4"
        ).tolist()
        machine, rest = divmod(mopt, 1000)
        precision, kind = rest // 10 % 10, rest % 10
        if machine != (0 if order == "<" else 1) or rest >= 100 or precision >= len(_PRECISIONS):
            continue
        if kind > 2 or min(rows, columns) < 0 or imaginary not in (0, 1):
            continue
        if 1 < length <= _LONGEST_NAME:
            return order, _PRECISIONS[precision], kind, rows, columns, bool(imaginary), length
    return None


def _is_level_4(head: bytes, size: int) -> bool:
    """Tell whether bytes begin with a variable of level 4 that fits into a file of a size."""
    header = _header_of_4(head)
    if header is None:
        return False
    _, type_, _, rows, columns, complex_, length = header
    name = head[_LEVEL_4_HEADER : _LEVEL_4_HEADER + length]
    if (
        name[-1:] != b"\0"
        or not name[:1].isalpha()
        or not name[:-1].decode("latin-1").isidentifier()
    ):
        return False
    return length + rows * columns * int(type_[1]) * (1 + complex_) + _LEVEL_4_HEADER <= size


#: The signature may follow a user block; MATLAB 7.3 writes one of 512 bytes.
_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_OFFSETS = (0, 512, 1024, 2048, 4096)
#: Arrays of less are read into memory when they are asked for [bytes].
_SMALL_BYTES = 1 << 20
#: A chunk of HDF5 is decompressed as a whole. One of more than the first is kept decompressed in a
#: temporary file, one of more than the second is refused [bytes]; writers make chunks of some
#: hundred kB (HDF5 User's Guide, "Chunking"), and a chunk of MCAP may be 128 MiB as well.
_LARGE_CHUNK, _MOST_CHUNK = 1 << 22, 1 << 27


class _Named(Mapping[str, Any]):
    """Values of a file by name, each read when it is first asked for."""

    def __init__(self, names: Iterable[str], read: Callable[[str], Any]) -> None:
        self._names, self._read = tuple(names), read
        self._values: dict[str, Any] = {}

    def __getitem__(self, name: str) -> Any:
        if name not in self._values:
            self._values[name] = self._read(name)
        return self._values[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __contains__(self, name: object) -> bool:
        return name in self._names


class HdfImporter:
    """Reads an HDF5 file whose data sets a map names by path; groups nest as structs do."""

    name = "hdf5"
    description = "HDF5 files (.h5, .hdf5, MATLAB 7.3) with a map"

    def sniff(self, path: Path) -> float:
        """Return 1 for the signature of HDF5."""
        with path.open("rb") as file:
            head = file.read(_OFFSETS[-1] + len(_SIGNATURE))
        return 1.0 if any(head[at:].startswith(_SIGNATURE) for at in _OFFSETS) else 0.0

    def read(self, paths: Sequence[Path], map_: ImportMap | None) -> Imported:
        """Read HDF5 files; several are laid one after the other.

        Raises
        ------
        SchemaError
            Without a map, or where map and file do not match.
        FormatError
            Where a file is no HDF5 file, or what a path names lies outside it.
        """
        if map_ is None:
            raise SchemaError(f"{paths[0].name}: expected --map for an HDF5 file, found none")
        return import_tables([Archive(p.name, _open_hdf5(p)) for p in paths], map_)


def _open_hdf5(path: Path) -> Mapping[str, Any]:
    import h5py

    with _hdf5_errors(path.name):
        file = h5py.File(path, "r")
        attributes = _Named(map(_text, file.attrs), lambda name: file.attrs[name])
        group = _hdf5_group(file, path.name)
    names = dict.fromkeys([*attributes, *group])
    return _Named(names, lambda name: group[name] if name in group else attributes[name])


@contextmanager
def _hdf5_errors(name: str) -> Iterator[None]:
    """Raise whatever the damaged part leads h5py and its library to as a FormatError."""
    try:
        yield
    except CodecError:
        raise
    except Exception as error:
        text = str(error) or type(error).__name__
        raise FormatError(f"{name}: expected an HDF5 file, found: {text}") from error


def _hdf5_group(group: Any, where: str) -> Mapping[str, Any]:
    """Return a group's data sets and groups by name."""
    import h5py

    keys = {_text(name): name for name in group}

    def read(name: str) -> Any:
        with _hdf5_errors(where):
            if isinstance(group.get(keys[name], getlink=True), h5py.ExternalLink):
                raise FormatError(
                    f"{where}: {name}: expected data in the file itself, found a link to another"
                )
            item = group[keys[name]]
            if isinstance(item, h5py.Group):
                return _hdf5_group(item, where)
            if not isinstance(item, h5py.Dataset):
                return Opaque("type")
            return _hdf5_values(item, where)

    return _Named(keys, read)


def _text(name: str | bytes) -> str:
    """Return a name; h5py gives the bytes of one that is no UTF-8."""
    return name if isinstance(name, str) else name.decode("utf-8", "replace")


def _hdf5_values(item: Any, name: str) -> Any:
    """Return a data set's values, those of a large one in the file."""
    where = f"{name}: {_text(item.name)}"
    if item.external or item.is_virtual:
        raise FormatError(f"{where}: expected data in the file itself, found data of other files")
    if item.shape is None or item.dtype.hasobject:
        return _hdf5_objects(item, where)
    size, stored_size = int(item.size) * item.dtype.itemsize, int(item.id.get_storage_size())
    if size > (limit := most_unpacked(stored_size, DEFLATE_RATIO)):
        raise FormatError(f"{where}: {too_much(limit, stored_size, size)}")
    chunk = math.prod(item.chunks or ()) * item.dtype.itemsize if item.chunks else 0
    if chunk > _MOST_CHUNK:
        raise FormatError(f"{where}: expected chunks of at most {_MOST_CHUNK} bytes, found {chunk}")
    if size <= _SMALL_BYTES:
        return item[()]

    def fetch(lead: tuple[int, ...], start: int, stop: int) -> NDArray[Any]:
        with _hdf5_errors(name):
            return np.asarray(item[(*lead, slice(start, stop))])

    if chunk <= _LARGE_CHUNK:
        return StoredArray(where, item.shape, item.dtype, fetch)
    spool = Spool(item.dtype, item.shape[1:])
    for start in range(0, item.shape[0], item.chunks[0]):
        spool.write(fetch((), start, min(start + item.chunks[0], item.shape[0])))
    return rows_in(where, spool.read, item.shape, item.dtype)


def _hdf5_objects(item: Any, where: str) -> Any:
    """Return values that are no numbers of one size, such as texts, each read by itself.

    Any number of them can be the same bytes of the file.
    """
    if not item.shape:
        return item[()]
    if item.ndim != 1:
        return Opaque("values of any size")
    objects, size = [], 0
    for at in range(len(item)):
        objects.append(item[at])
        size += len(objects[-1]) if hasattr(objects[-1], "__len__") else 8
        if max(size, 8 * at) > (limit := most_unpacked(0)):
            raise FormatError(f"{where}: expected at most {limit} bytes of texts, found more")
    values = np.empty(len(objects), object)
    values[:] = objects
    return values


_NPY = b"\x93NUMPY"
_ZIP = b"PK\x03\x04"
#: Bytes of a packed array read at once.
_PACKED_BYTES = 1 << 20
#: NumPy reads no header of more characters than 10 000.
_NPY_HEAD = 1 << 14


class NumpyImporter:
    """Reads arrays a map names by path; the one array of a .npy file is called ``data``."""

    name = "npz"
    description = "NumPy archives (.npy, .npz) with a map"

    def sniff(self, path: Path) -> float:
        """Return 1 for NumPy's header, or a zip archive whose first member is an array."""
        with path.open("rb") as file:
            head = file.read(30 + 1024)
        name = head[30 : 30 + int.from_bytes(head[26:28], "little")]
        archive = head[:4] == _ZIP and (name.endswith(b".npy") or path.suffix == ".npz")
        return 1.0 if head.startswith(_NPY) or archive else 0.0

    def read(self, paths: Sequence[Path], map_: ImportMap | None) -> Imported:
        """Read archives; several are laid one after the other.

        Raises
        ------
        SchemaError
            Without a map, or where map and file do not match.
        FormatError
            Where a file is no NumPy archive, or what a path names holds pickled objects.
        """
        if map_ is None:
            raise SchemaError(f"{paths[0].name}: expected --map for a NumPy archive, found none")
        return import_tables([Archive(p.name, _open_npz(p)) for p in paths], map_)


def _open_npz(path: Path) -> Mapping[str, Any]:
    with path.open("rb") as file:
        head = file.read(len(_NPY))
    if head == _NPY:
        return _Named(["data"], lambda _: _npy(path, path.name, path.stat().st_size))
    with _npz_errors(path.name), zipfile.ZipFile(path) as archive:
        members = {m.filename.removesuffix(".npy"): m for m in archive.infolist()}
    return _Named(members, lambda name: _member(path, name, members[name]))


@contextmanager
def _npz_errors(where: str) -> Iterator[None]:
    """Raise whatever damaged bytes lead zipfile and NumPy to as a FormatError."""
    try:
        yield
    except CodecError:
        raise
    except Exception as error:
        text = str(error) or type(error).__name__
        raise FormatError(
            f"{where}: expected a NumPy archive without pickled objects, found: {text}"
        ) from error


def _member(path: Path, name: str, member: zipfile.ZipInfo) -> Any:
    """Return an array of an archive, unpacked into a temporary file."""
    where = f"{path.name}: {name}"
    check_member(member, where)
    spool = Spool(np.uint8)
    with _npz_errors(where), zipfile.ZipFile(path) as archive, archive.open(member) as content:
        while block := content.read(_PACKED_BYTES):
            spool.write(block)
    return _npy(spool, where, len(spool))


def check_member(member: zipfile.ZipInfo, where: str, ratio: int = DEFLATE_RATIO) -> None:
    """Refuse a member of an archive that is packed as none is, or more than ``ratio`` times.

    Raises
    ------
    FormatError
        Names ``where``.
    """
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise FormatError(
            f"{where}: expected data that are stored or deflated, found method "
            f"{member.compress_type}"
        )
    if member.file_size > (limit := most_unpacked(member.compress_size, ratio)):
        raise FormatError(f"{where}: {too_much(limit, member.compress_size, member.file_size)}")


def _npy(source: Path | Spool, where: str, size: int) -> Any:
    """Return the array of a .npy file, a large one in the file (NEP 1, versions 1 and 2)."""
    of = source.read if isinstance(source, Spool) else partial(_read, source)
    read = _exactly(of, where)
    with _npz_errors(where):
        head = io.BytesIO(read(0, min(size, _NPY_HEAD)))
        version = np.lib.format.read_magic(head)
        npy_format = np.lib.format
        headers = {
            (1, 0): npy_format.read_array_header_1_0,
            (2, 0): npy_format.read_array_header_2_0,
        }
        if version not in headers:
            raise FormatError(f"{where}: expected version 1 or 2 of the format, found {version}")
        shape, fortran, dtype = headers[version](head)
        begin, claimed = head.tell(), math.prod(shape) * dtype.itemsize
        if dtype.hasobject:
            raise FormatError(
                f"{where}: expected a NumPy archive without pickled objects, found some"
            )
        if claimed > size - begin:
            raise FormatError(
                f"{where}: expected {claimed} bytes of shape {shape}, found {size - begin}"
            )
        array = rows_in(where, lambda at, n: read(begin + at, n), shape, dtype, fortran=fortran)
        return array if claimed > _SMALL_BYTES else np.asarray(array)


def _read(path: Path, at: int, count: int) -> bytes:
    with path.open("rb") as file:
        file.seek(at)
        return file.read(count)


def _exactly(read: Callable[[int, int], bytes], where: str) -> Callable[[int, int], bytes]:
    """Return what reads bytes as ``read`` does, and raises a FormatError where there are fewer."""

    def exactly(at: int, count: int) -> bytes:
        content = read(at, count)
        if len(content) < count:
            raise FormatError(f"{where}: byte {at}: expected {count} bytes, found {len(content)}")
        return content

    return exactly
