"""The cells of a text table whose layout is not known: separator, decimal sign, header."""

from __future__ import annotations

import csv
import io
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from ..errors import FormatError

if TYPE_CHECKING:
    from pathlib import Path

#: How much of a table is looked at [bytes].
_HEAD = 1 << 20
_DELIMITERS = (",", ";", "\t", "|", " ")
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?|[+-]?(nan|inf)", re.IGNORECASE)
_MIN_ROWS = 3


@dataclass(frozen=True, slots=True)
class RawTable:
    """The start of a table.

    Attributes
    ----------
    delimiter, decimal, encoding
        As a map names them.
    header
        Names of the columns, stripped; empty where there is none.
    skip_rows
        Rows before the first of numbers.
    rows
        Cells of the rows of numbers, all of one width.
    """

    delimiter: str
    decimal: Literal[".", ","]
    encoding: str
    header: tuple[str, ...]
    skip_rows: int
    rows: tuple[list[str], ...]

    @property
    def width(self) -> int:
        """Number of columns."""
        return len(self.rows[0])

    def label(self, index: int) -> str:
        """Return what to call a column."""
        name = " ".join(self.header[index].splitlines()) if self.header else ""
        return name or f"column {index}"

    def key(self, index: int) -> str | int:
        """Return what a map calls a column: its name where that is one of a kind."""
        name = self.header[index] if self.header else ""
        return name if name and self.header.count(name) == 1 else index


def read_raw(path: Path) -> RawTable:
    """Read the start of a table.

    Raises
    ------
    FormatError
        Where no separator gives rows of numbers.
    """
    with path.open("rb") as file:
        data = file.read(_HEAD + 1)
    text, encoding = _text(data)
    if len(data) > _HEAD:  # the last line is not whole
        text = text.rpartition("\n")[0]
    found = [t for d in _DELIMITERS if (t := _split(text, d, encoding)) is not None]
    if not found:
        raise FormatError(f"{path.name}: expected rows of numbers, found none")
    return max(found, key=lambda t: (len(t.rows) * t.width, -_DELIMITERS.index(t.delimiter)))


def _text(data: bytes) -> tuple[str, str]:
    try:
        # the read may end inside a character
        return data.decode("utf-8-sig"), "utf-8-sig"
    except UnicodeDecodeError as error:
        if error.start >= len(data) - 3 and len(data) > _HEAD:
            return data[: error.start].decode("utf-8-sig"), "utf-8-sig"
    return data.decode("latin-1"), "latin-1"


def _split(text: str, delimiter: str, encoding: str) -> RawTable | None:
    """Return the table one separator gives, None where it gives none of two columns or more."""
    try:
        cells = [r for r in csv.reader(io.StringIO(text, newline=""), delimiter=delimiter) if r]
    except csv.Error:
        return None
    numeric = [_is_row(row) for row in cells]
    widths = [len(row) for row, good in zip(cells, numeric, strict=True) if good]
    if len(widths) < _MIN_ROWS:
        return None
    width = max(set(widths), key=widths.count)
    start = next(i for i, row in enumerate(cells) if numeric[i] and len(row) == width)
    rows = [row for row in cells[start:] if len(row) == width]
    if len(rows) < _MIN_ROWS:
        return None
    header = tuple(c.strip() for c in cells[start - 1]) if start else ()
    if len(header) == width - 1 and not any(row[-1].strip() for row in rows):
        header = (*header, "")  # only the rows end in a separator
    decimal: Literal[".", ","] = "." if delimiter == "," or not _commas(rows) else ","
    named = len(header) == width and any(header)
    return RawTable(delimiter, decimal, encoding, header if named else (), start, tuple(rows))


def _is_row(cells: list[str]) -> bool:
    """Return whether at least half of the filled cells are numbers."""
    filled = [c.strip() for c in cells if c.strip()]
    numbers = sum(_NUMBER.fullmatch(c) is not None for c in filled)
    return numbers >= 1 and 2 * numbers >= len(filled)


def _commas(rows: list[list[str]]) -> bool:
    cells = [c for row in rows[:100] for c in row if _NUMBER.fullmatch(c.strip())]
    return any("," in c for c in cells) and not any("." in c for c in cells)
