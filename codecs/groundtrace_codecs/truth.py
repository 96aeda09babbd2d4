"""Truth tables: what happened, from CSV that any tool can write, or from picks and recordings.

Hand picks of a refraction line are read from the unified data format (.sgt) of GIMLi and its
relatives: a count, a comment ``#x y`` that names the columns, and that many shot and geophone
points; then a count, a comment ``#s g t``, and that many picks by 1-based index of the points. With
two coordinates the second is the elevation, so positions are compared along the line; with three,
the first two are the plan.
"""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from typing import TYPE_CHECKING

import numpy as np

from .errors import SchemaError, did_you_mean
from .events import LABEL_KINDS, Label, as_truth
from .signals import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from .geometry import Geometry
    from .signals import Stream

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

#: Truth begins this long before the first sample at most, where the clock begins there too [ns].
EARLY_NS = NS_PER_S
#: Latest moment a label may have [ns]: the end of int64.
_MAX_NS = 2**63 - 1


#: What makes a cell a formula where it begins with it (OWASP, "CSV Injection"), and what guards it.
_FORMULA, _GUARD = tuple("=+-@\t\r"), "'"


def guarded_cell(text: str) -> str:
    """Return a text as a cell of CSV that no spreadsheet takes for a formula.

    One that begins with ``= + - @``, tab or carriage return gets an apostrophe in front, which
    :func:`plain_cell` takes off again; so does one that looks as if it had one already.
    """
    return _GUARD + text if text.lstrip(_GUARD).startswith(_FORMULA) else text


def plain_cell(cell: str) -> str:
    """Return the text of a cell, without the apostrophe of :func:`guarded_cell`."""
    guarded = cell.startswith(_GUARD) and cell.lstrip(_GUARD).startswith(_FORMULA)
    return cell.removeprefix(_GUARD) if guarded else cell


def read_truth_csv(
    path: Path, start_ns: int, files: Mapping[str, int] | None = None
) -> tuple[Label, ...]:
    """Read a truth CSV.

    Columns: ``time_s`` (from the recording's first sample) or ``time_ns`` (on the recording's
    clock), ``kind`` (one of :data:`~.events.LABEL_KINDS`), and optionally
    ``end_s`` or ``end_ns``, ``x_m``, ``y_m``, ``value``, ``channel``, ``label``, ``author``,
    ``note``, ``target``; of a recording of several files also ``file``: ``time_s`` and ``end_s`` of
    such a line count from the first sample of that file. Lines that start with ``#`` and empty
    lines are skipped.

    Parameters
    ----------
    path
        The CSV, UTF-8.
    start_ns
        Time of the recording's first sample [ns].
    files
        Name and time of the first sample [ns] of each file that the recording was made of.

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
    return _labels_of(text, path.name, start_ns, files)


def _labels_of(
    text: str, name: str, start_ns: int, files: Mapping[str, int] | None = None
) -> tuple[Label, ...]:
    """Return the labels of a table's text; ``name`` is the file's."""
    reader = csv.reader(io.StringIO(text, newline=""))
    header: list[str] | None = None
    labels: list[Label] = []
    try:
        for written in reader:
            cells = [plain_cell(cell) for cell in written]
            if not any(c.strip() for c in cells) or cells[0].startswith("#"):
                continue
            where = f"{name}: line {reader.line_num}"
            if header is None:
                header = _header(cells, where, COLUMNS if not files else (*COLUMNS, "file"))
            else:
                row = _Row.of(header, cells, where)
                labels.append(row.label(row.origin_ns(start_ns, files or {})))
    except csv.Error as error:
        raise SchemaError(
            f"{name}: line {reader.line_num}: expected CSV, found: {error}"
        ) from error
    if header is None:
        raise SchemaError(f"{name}: expected a header with time_s and kind, found no line")
    return tuple(labels)


def read_truth(
    path: Path,
    *,
    start_ns: int,
    geometry: Geometry | None,
    labels: Sequence[Label],
    files: Mapping[str, int] | None = None,
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
    files
        As in :func:`read_truth_csv`.

    Raises
    ------
    SchemaError
        Where the suffix is another, or the file is not what its suffix says.
    """
    suffix = path.suffix.lower()
    if suffix == ".csv":
        return tuple(as_truth(label) for label in read_truth_csv(path, start_ns, files))
    if suffix == ".sgt":
        impacts = [label for label in labels if label.kind == "impact"]
        return picks_of(read_sgt(path), geometry, impacts, path.name)
    if suffix == ".mcap":
        from .recording import Recording

        with Recording.open(path) as recording:
            return recording.labels or tuple(as_truth(a.label) for a in recording.annotations)
    raise SchemaError(f"{path.name}: expected .csv, .sgt or .mcap, found {suffix or 'no suffix'}")


#: What the column ``channel`` names, by kind.
_NAMED = {"pick": "channels", "pass": "stations"}
#: So many names are listed.
_LISTED = 12


def names_of(
    streams: Sequence[Stream], geometry: Geometry | None
) -> dict[str, tuple[str, ...] | None]:
    """Return what truth may name of a recording, by kind of label; None where that is unknown."""
    channels = tuple(c.name for s in streams for c in s.channels)
    stations = None if geometry is None else tuple(s.name for s in geometry.sensors)
    return {"pick": channels, "pass": stations or None}


def unmatched_names(
    labels: Sequence[Label], names: Mapping[str, Sequence[str] | None], where: str
) -> list[str]:
    """Return a line for each kind of label of which some name what a recording does not have.

    Parameters
    ----------
    labels
        The truth.
    names
        As :func:`names_of` gives it.
    where
        Where the truth is from.

    Raises
    ------
    SchemaError
        Where none of the names is one of the recording's; lists both.
    """
    warnings = []
    for kind, what in _NAMED.items():
        named = list(dict.fromkeys(x.channel for x in labels if x.kind == kind and x.channel))
        there = names.get(kind)
        if there is None or not named:
            continue
        strange = [name for name in named if name not in there]
        if len(strange) == len(named):
            raise SchemaError(
                f"{where}: channel: expected {what} of the recording ({_listed(there)}), found "
                f"{_listed(named)}"
            )
        if strange:
            warnings.append(
                f"{where}: {len(strange)} of {len(named)} {what} of the truth are none of the "
                f"recording's: {_listed(strange)}"
            )
    return warnings


def _listed(names: Sequence[str]) -> str:
    more = len(names) - _LISTED
    text = ", ".join(names[:_LISTED]) or "none"
    return f"{text} and {more} more" if more > 0 else text


def _header(cells: list[str], where: str, columns: Sequence[str]) -> list[str]:
    """Return the names of the columns."""
    names = [c.strip() for c in cells]
    for name in names:
        if name not in columns:
            raise SchemaError(
                f"{where}: header: expected one of {', '.join(columns)}, found {name!r}"
                f"{did_you_mean(name, columns)}"
            )
        if names.count(name) > 1:
            raise SchemaError(f"{where}: header: expected {name} once, found it twice")
    for pair in (("time_s", "time_ns"), ("kind",)):
        if sum(n in names for n in pair) != 1:
            raise SchemaError(
                f"{where}: header: expected one column {' or '.join(pair)}, found {names}"
            )
    return names


@dataclass(frozen=True, slots=True)
class _Row:
    """The non-empty cells of one line and where the line is."""

    cells: dict[str, str]
    where: str

    @classmethod
    def of(cls, header: list[str], cells: list[str], where: str) -> _Row:
        if len(cells) != len(header):
            raise SchemaError(f"{where}: row: expected {len(header)} cells, found {len(cells)}")
        pairs = zip(header, (c.strip() for c in cells), strict=True)
        return cls({name: cell for name, cell in pairs if cell}, where)

    def origin_ns(self, start_ns: int, files: Mapping[str, int]) -> int:
        """Return what the row's seconds count from: its file, or else the recording [ns]."""
        name = self.cells.get("file")
        if name is None:
            return start_ns
        if name not in files:
            raise self.wrong("file", f"one of {_listed_files(files)}", files)
        return files[name]

    def label(self, start_ns: int) -> Label:
        kind = self.cells.get("kind", "")
        if kind not in LABEL_KINDS:
            raise self.wrong("kind", f"one of {', '.join(sorted(LABEL_KINDS))}", LABEL_KINDS)
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
            least_ns = min(0, origin - EARLY_NS) if column.endswith("_s") else 0
            if not least_ns <= time_ns <= _MAX_NS:
                when = "from the clock's zero on"
                if least_ns < 0:
                    when = f"no more than {EARLY_NS / NS_PER_S:g} s before the first sample"
                raise self.wrong(column, f"a time {when}")
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

    def wrong(self, column: str, expected: str, accepted: Iterable[str] = ()) -> SchemaError:
        cell = self.cells.get(column)
        actual = "nothing" if cell is None else f"{cell[:40]!r}{did_you_mean(cell[:40], accepted)}"
        return SchemaError(f"{self.where}: {column}: expected {expected}, found {actual}")


def _listed_files(files: Mapping[str, int]) -> str:
    names = list(files)
    return ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")


#: Two places are one where they are no further apart than this [m].
_SAME_PLACE_M = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Sgt:
    """Picks of a refraction line.

    Attributes
    ----------
    points
        Shape (n, 2): the first two coordinates of shots and geophones [m].
    shot, geophone
        Shape (m,), int64: 0-based rows of ``points``.
    time_s
        Shape (m,): first arrival after the shot [s].
    plan
        True where the points lie in a plan; False where they lie along a line and the second
        coordinate is the elevation.
    """

    points: NDArray[np.float64]
    shot: NDArray[np.int64]
    geophone: NDArray[np.int64]
    time_s: NDArray[np.float64]
    plan: bool = False


def read_sgt(path: Path) -> Sgt:
    """Read a .sgt file.

    Raises
    ------
    SchemaError
        Naming file, line and what was expected there.
    """
    try:
        lines = enumerate(path.read_text(encoding="utf-8").splitlines(), start=1)
    except UnicodeDecodeError as error:
        raise SchemaError(f"{path.name}: expected UTF-8 text, found {error.reason}") from error
    rows = _Rows(path.name, [(n, line) for n, line in lines if line.strip()])
    names, points = rows.table(("x", "y"), "x y")
    columns, picks = rows.table(("s", "g", "t"), "s g t")
    index = picks[:, [columns.index("s"), columns.index("g")]]
    wrong = (index != np.rint(index)) | (index < 1) | (index > len(points))
    if wrong.any():
        raise SchemaError(
            f"{path.name}: measurements: expected points 1 to {len(points)}, "
            f"found {index[wrong][0]:g}"
        )
    shot, geophone = (index.astype(np.int64) - 1).T
    return Sgt(points[:, :2], shot, geophone, picks[:, columns.index("t")], "z" in names)


def picks_of(
    sgt: Sgt, geometry: Geometry | None, impacts: Sequence[Label], name: str = "picks"
) -> tuple[Label, ...]:
    """Return the picks as labels on the recording's clock.

    Shot and geophone are found by their places: each pick lies ``time_s`` after the ``impact`` at
    its shot point, on the channel of the sensor at its geophone point.

    Parameters
    ----------
    sgt
        The picks.
    geometry
        Of the recording, with its sensors.
    impacts
        The recording's ``impact`` labels, with places.
    name
        Start of error messages.

    Raises
    ------
    SchemaError
        Where a point has no shot or sensor, or more than one.
    """
    sensors = () if geometry is None else geometry.sensors
    placed = [i for i in impacts if i.x_m is not None]
    shots = np.array([(i.x_m, i.y_m or 0.0) for i in placed]).reshape(-1, 2)
    places = np.array([(s.x, s.y) for s in sensors]).reshape(-1, 2)
    axes = 2 if sgt.plan else 1
    at = {
        int(p): _one_at(sgt.points[p, :axes], shots[:, :axes], f"{name}: shot {p + 1}")
        for p in np.unique(sgt.shot)
    }
    receivers = {
        int(p): _one_at(sgt.points[p, :axes], places[:, :axes], f"{name}: geophone {p + 1}")
        for p in np.unique(sgt.geophone)
    }
    return tuple(
        Label(
            placed[at[s]].time_ns + round(t * NS_PER_S),
            "pick",
            channel=sensors[receivers[g]].channel,
            label=placed[at[s]].label,
        )
        for s, g, t in zip(
            sgt.shot.tolist(), sgt.geophone.tolist(), sgt.time_s.tolist(), strict=True
        )
    )


def _one_at(point: NDArray[np.float64], candidates: NDArray[np.float64], where: str) -> int:
    """Return the row of the only candidate at ``point``."""
    rows = np.flatnonzero(np.linalg.norm(candidates - point, axis=1) <= _SAME_PLACE_M)
    if len(rows) != 1:
        coordinates = ", ".join(f"{c:g}" for c in point)
        raise SchemaError(
            f"{where}: expected one in the recording at {coordinates} m, found {len(rows)}"
        )
    return int(rows[0])


class _Rows:
    """Lines of a file, taken table by table."""

    def __init__(self, name: str, lines: list[tuple[int, str]]) -> None:
        self._name = name
        self._lines = lines

    def table(
        self, required: tuple[str, ...], default: str
    ) -> tuple[list[str], NDArray[np.float64]]:
        """Return the names of the columns and the rows, shape (n, n_columns)."""
        number, line = self._next("a count of rows")
        word = line.split("#")[0].strip()
        if not (word.isascii() and word.isdigit()):
            raise self._wrong(number, "a count of rows", line)
        names = default.split()
        while self._lines and self._lines[0][1].lstrip().startswith("#"):
            number, line = self._lines.pop(0)
            names = line.lstrip("# \t").lower().split()
        if any(n not in names for n in required):
            raise self._wrong(number, f"columns {' '.join(required)}", line)
        rows = [self._row(len(names)) for _ in range(min(int(word), len(self._lines) + 1))]
        return names, np.array(rows, np.float64).reshape(-1, len(names))

    def _row(self, width: int) -> list[float]:
        number, line = self._next("a row of numbers")
        try:
            row = [float(word) for word in line.split("#")[0].split()]
        except ValueError as error:
            raise self._wrong(number, f"{width} numbers", line) from error
        if len(row) != width or not np.isfinite(row).all():
            raise self._wrong(number, f"{width} numbers", line)
        return row

    def _next(self, expected: str) -> tuple[int, str]:
        if not self._lines:
            raise SchemaError(f"{self._name}: end: expected {expected}, found none")
        return self._lines.pop(0)

    def _wrong(self, number: int, expected: str, line: str) -> SchemaError:
        return SchemaError(
            f"{self._name}: line {number}: expected {expected}, found {line.strip()[:40]!r}"
        )
