"""Truth tables: what happened, as CSV any tool can write, or read from picks and recordings."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from typing import TYPE_CHECKING

from .errors import SchemaError
from .labels import ANNOTATION_KINDS, TRUTH_KINDS, Label, as_truth
from .signals import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from .geometry import Geometry

#: Columns of a truth CSV; the time is one of the first two.
COLUMNS = (
    "time_s",
    "time_ns",
    "kind",
    "end_s",
    "end_ns",
    "x_m",
    "y_m",
    "value",
    "channel",
    "label",
    "author",
    "note",
    "target",
)

#: What a kind cannot do without, beside its time.
_NEEDS = {
    "count": ("end_ns", "value"),
    "walking": ("end_ns",),
    "ignore": ("end_ns",),
    "span": ("end_ns",),
    "idle": ("end_ns",),
    "waypoint": ("x_m", "y_m"),
    "pick": ("channel",),
    "heading": ("value",),
}

_KINDS = TRUTH_KINDS | ANNOTATION_KINDS

#: Latest moment a label may have [ns]: the end of int64.
_MAX_NS = 2**63 - 1


def read_truth_csv(path: Path, start_ns: int) -> tuple[Label, ...]:
    """Read a truth CSV.

    Columns: ``time_s`` (from the recording's first sample) or ``time_ns`` (on the recording's
    clock), ``kind`` (one of :data:`~groundtrace_codecs.labels.TRUTH_KINDS` or
    :data:`~groundtrace_codecs.labels.ANNOTATION_KINDS`), and optionally
    ``end_s`` or ``end_ns``, ``x_m``, ``y_m``, ``value``, ``channel``, ``label``, ``author``,
    ``note``, ``target``. Lines that start with ``#`` and empty lines are skipped.

    Parameters
    ----------
    path
        The CSV, UTF-8.
    start_ns
        Time of the recording's first sample [ns].

    Returns
    -------
    tuple of Label
        In the order of the file.

    Raises
    ------
    SchemaError
        Naming file, line and column of the first cell that is not as expected.
    """
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise SchemaError(f"{path.name}: expected UTF-8 text, found {error.reason}") from error
    return _labels_of(text, path.name, start_ns)


def _labels_of(text: str, name: str, start_ns: int) -> tuple[Label, ...]:
    """Return the labels of a table's text; ``name`` is the file's."""
    reader = csv.reader(io.StringIO(text, newline=""))
    header: list[str] | None = None
    labels: list[Label] = []
    try:
        for cells in reader:
            if not any(c.strip() for c in cells) or cells[0].startswith("#"):
                continue
            place = f"{name}: line {reader.line_num}"
            if header is None:
                header = _header(cells, place)
            else:
                labels.append(_Row.of(header, cells, place).label(start_ns))
    except csv.Error as error:
        raise SchemaError(
            f"{name}: line {reader.line_num}: expected CSV, found: {error}"
        ) from error
    if header is None:
        raise SchemaError(f"{name}: expected a header with time_s and kind, found no line")
    return tuple(labels)


def write_truth_csv(path: Path, labels: Sequence[Label], start_ns: int) -> None:
    """Write labels as a truth CSV that :func:`read_truth_csv` reads back exactly.

    Parameters
    ----------
    path
        The file to write.
    labels
        In the order to be written.
    start_ns
        Time of the recording's first sample [ns]; times are written relative to it.

    Raises
    ------
    SchemaError
        Naming line and column of the first label that would not be read back as it is: a kind
        that is none, a span without its end, text with blanks at its ends. Nothing is written.
    """
    names = [n for n in COLUMNS if n not in ("time_ns", "end_ns")]
    table = io.StringIO(newline="")
    writer = csv.writer(table)
    writer.writerow(names)
    for label in labels:
        writer.writerow([_cell(label, name, start_ns) for name in names])
    for label, again in zip(labels, _labels_of(table.getvalue(), path.name, start_ns), strict=True):
        changed = [n for n in Label.__slots__ if getattr(again, n) != getattr(label, n)]
        if changed:
            raise SchemaError(
                f"{path.name}: {label.kind} at {_cell(label, 'time_s', start_ns)} s: {changed[0]}: "
                f"expected what a table can hold, found {getattr(label, changed[0])!r}"
            )
    try:
        path.write_bytes(table.getvalue().encode())
    except UnicodeEncodeError as error:
        raise SchemaError(f"{path.name}: expected UTF-8 text, found {error.reason}") from error


def read_truth(
    path: Path, *, start_ns: int, geometry: Geometry | None, labels: Sequence[Label]
) -> tuple[Label, ...]:
    """Read truth from any file that holds it, told by its suffix; ``missed`` is a step.

    Parameters
    ----------
    path
        ``.csv`` (a truth table), ``.sgt`` (hand picks of a refraction line) or ``.mcap`` (the
        labels of a recording or of an annotation sidecar).
    start_ns
        Time of the recording's first sample [ns].
    geometry, labels
        Of the recording; picks need the sensors' places and the ``impact`` labels.

    Raises
    ------
    SchemaError
        Where the suffix is another, or the file is not what its suffix says.
    """
    suffix = path.suffix.lower()
    if suffix == ".csv":
        return tuple(as_truth(label) for label in read_truth_csv(path, start_ns))
    if suffix == ".sgt":
        from .importers.sgt import picks_of, read_sgt

        impacts = [label for label in labels if label.kind == "impact"]
        return picks_of(read_sgt(path), geometry, impacts, path.name)
    if suffix == ".mcap":
        from .recording import Recording

        with Recording.open(path) as recording:
            return recording.labels or tuple(as_truth(a.label) for a in recording.annotations)
    raise SchemaError(f"{path.name}: expected .csv, .sgt or .mcap, found {suffix or 'no suffix'}")


def _header(cells: list[str], place: str) -> list[str]:
    """Return the names of the columns."""
    names = [c.strip() for c in cells]
    for name in names:
        if name not in COLUMNS:
            raise SchemaError(
                f"{place}: header: expected one of {', '.join(COLUMNS)}, found {name!r}"
            )
        if names.count(name) > 1:
            raise SchemaError(f"{place}: header: expected {name} once, found it twice")
    for pair in (("time_s", "time_ns"), ("kind",)):
        if sum(n in names for n in pair) != 1:
            raise SchemaError(
                f"{place}: header: expected one column {' or '.join(pair)}, found {names}"
            )
    return names


@dataclass(frozen=True, slots=True)
class _Row:
    """The non-empty cells of one line and where the line is."""

    cells: dict[str, str]
    place: str

    @classmethod
    def of(cls, header: list[str], cells: list[str], place: str) -> _Row:
        if len(cells) != len(header):
            raise SchemaError(f"{place}: row: expected {len(header)} cells, found {len(cells)}")
        pairs = zip(header, (c.strip() for c in cells), strict=True)
        return cls({name: cell for name, cell in pairs if cell}, place)

    def label(self, start_ns: int) -> Label:
        kind = self.cells.get("kind", "")
        if kind not in _KINDS:
            raise self.wrong("kind", f"one of {', '.join(sorted(_KINDS))}")
        time_ns = self.time("time", start_ns)
        end_ns = self.time("end", start_ns)
        if time_ns is None:
            raise self.wrong("time_s", "a time")
        if end_ns is not None and end_ns < time_ns:
            raise self.wrong("end_s", "an end at or after the time")
        label = Label(
            time_ns,
            kind,
            end_ns,
            self.number("x_m"),
            self.number("y_m"),
            self.number("value"),
            self.cells.get("channel", ""),
            self.cells.get("label", ""),
            self.cells.get("author", ""),
            self.cells.get("note", ""),
            self.cells.get("target", ""),
        )
        for need in _NEEDS.get(kind, ()):
            if getattr(label, need) in (None, ""):
                raise self.wrong(need.replace("_ns", "_s"), f"a value, as kind {kind} needs one")
        return label

    def time(self, name: str, start_ns: int) -> int | None:
        """Return ``name_ns``, or ``name_s`` counted from ``start_ns``, exactly [ns]."""
        for column, factor, origin in ((f"{name}_s", NS_PER_S, start_ns), (f"{name}_ns", 1, 0)):
            if column not in self.cells:
                continue
            value = self.decimal(column)
            if abs(value) > Decimal(_MAX_NS) / factor:
                raise self.wrong(column, "a time within 292 years")
            time_ns = origin + round(value * factor)
            if not 0 <= time_ns <= _MAX_NS:
                raise self.wrong(column, "a time at or after the clock's zero")
            return time_ns
        return None

    def number(self, column: str) -> float | None:
        return float(self.decimal(column)) if column in self.cells else None

    def decimal(self, column: str) -> Decimal:
        try:
            value = Decimal(self.cells[column])
        except InvalidOperation as error:
            raise self.wrong(column, "a number") from error
        if not value.is_finite() or value.adjusted() > 300:
            raise self.wrong(column, "a finite number")
        return value

    def wrong(self, column: str, expected: str) -> SchemaError:
        found = repr(self.cells[column][:40]) if column in self.cells else "nothing"
        return SchemaError(f"{self.place}: {column}: expected {expected}, found {found}")


def _cell(label: Label, name: str, start_ns: int) -> str:
    """Return the text of one cell."""
    if name in ("time_s", "end_s"):
        time_ns = label.time_ns if name == "time_s" else label.end_ns
        return "" if time_ns is None else f"{Decimal(time_ns - start_ns) / NS_PER_S:f}"
    value = getattr(label, name)
    return "" if value is None else str(value)
