"""The two tables of a fleet, joined from its parts."""

from __future__ import annotations

import hashlib
import os
import secrets
from dataclasses import asdict, dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
import zstandard

from ..errors import RecordingError
from ..evaluation.matching import STEP_TOLERANCE_S
from ..explain.reasons import CAUSES
from ..export.base import Column, Table
from ..export.tables import write_parquet
from ..pipeline.results import atomic_write, room_for
from ..runtime import installed_version

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from ..evaluation.report import Score
    from ..export.base import ColumnType

#: What may differ between two runs that decide the same.
OF_THE_RUN = ("wall_s", "host")
#: Raised when a part means something else: older ones are then made again.
FORMAT = 3
#: Largest part that is unpacked [bytes]. Chosen by judgement: damaged ones cannot claim all memory.
_MOST_BYTES = 1 << 31


@dataclass(frozen=True, slots=True)
class Row:
    """One recording through one pipeline.

    Attributes
    ----------
    recording
        File name.
    pipeline, pipeline_sha256
        Name, and hash of parameters and versions; both of what fitted, where none was asked for.
    sha256, bytes
        Of the file; empty and 0 where it could not be read.
    start_ns, duration_s
        First sample [ns], and from there to the last [s].
    topics
        Names of the streams, with commas between.
    channels, samples
        Channels of all streams, and their samples together.
    parameters
        The pipeline as TOML, every parameter with its value.
    versions
        Of Python and the packages that decide.
    tolerance_s
        Largest distance between a step and its detection [s].
    truth
        Where it is from: ``recording``, ``annotations``, the name of a file, or nothing.
    labels
        How many labels that is.
    subject, site
        Who walks and where, as far as the recording's metadata say.
    damaged_places, lost_messages
        Damage of the file that was left out, and the messages known to be lost by it.
    gaps, lost_samples
        Interruptions that ended a run, and samples missing in all, bridged ones too.
    found_steps, found_picks, found_fixes, found_passes
        What the pipeline says, truth or not.
    warnings
        What the replay warned of, each once, with `` | `` between.
    figures
        By the names of :data:`FIGURES`; None where undefined.
    causes
        How many misses have each cause.
    score_json
        The whole score, as ``groundtrace score --json`` gives it.
    error
        Why there is no more than this; empty where all went well.
    wall_s, host
        Time taken [s], and where.
    """

    recording: str
    pipeline: str
    pipeline_sha256: str
    sha256: str = ""
    bytes: int = 0
    start_ns: int | None = None
    duration_s: float | None = None
    topics: str = ""
    channels: int = 0
    samples: int = 0
    parameters: str = ""
    versions: str = ""
    tolerance_s: float = STEP_TOLERANCE_S
    truth: str = ""
    labels: int = 0
    subject: str = ""
    site: str = ""
    damaged_places: int = 0
    lost_messages: int = 0
    gaps: int = 0
    lost_samples: int = 0
    found_steps: int = 0
    found_picks: int = 0
    found_fixes: int = 0
    found_passes: int = 0
    warnings: str = ""
    figures: dict[str, Any] = field(default_factory=dict)
    causes: dict[str, int] = field(default_factory=dict)
    score_json: str = ""
    error: str = ""
    wall_s: float = 0.0
    host: str = ""


@dataclass(frozen=True, slots=True)
class StepRow:
    """One true step, or one detection that answers none.

    Attributes
    ----------
    verdict
        ``matched``, ``missed`` or ``false``.
    step
        Number of the true step among the scored ones, from 1, as ``why --step`` takes it.
    miss
        Number of the missed step, from 1, as ``replay --at-miss`` takes it.
    truth_ns, found_ns
        Time of the true step and of its detection [ns]; of a missed one, of the false step that
        it was found as, at the wrong time.
    cause, gate, text
        Why it was missed: in one word, the first gate that failed, and for people. Of a false
        step, which missed one it is at the wrong time, if any.
    """

    verdict: str
    step: int | None = None
    miss: int | None = None
    truth_ns: int | None = None
    found_ns: int | None = None
    cause: str = ""
    gate: str = ""
    text: str = ""

    @property
    def time_ns(self) -> int:
        """When the step was, or was found [ns]."""
        return (self.truth_ns if self.truth_ns is not None else self.found_ns) or 0


@dataclass(frozen=True, slots=True)
class Part:
    """A row with its steps, by time."""

    row: Row
    steps: tuple[StepRow, ...] = ()
    format: int = FORMAT

    def encoded(self) -> bytes:
        """Return the part as bytes."""
        return zstandard.compress(msgspec.msgpack.encode(self), 3)

    def decided(self) -> bytes:
        """Return what was decided as bytes: the same whoever computed it, and however fast."""
        row = {k: v for k, v in asdict(self.row).items() if k not in OF_THE_RUN}
        return msgspec.msgpack.encode((row, self.steps))


def decoded(data: bytes) -> Part | None:
    """Return a part; None where the bytes are not a whole part of this version."""
    try:
        plain = zstandard.decompress(data, max_output_size=_MOST_BYTES)
        part = msgspec.msgpack.decode(plain, type=Part)
    except (zstandard.ZstdError, msgspec.DecodeError):
        return None
    return part if part.format == FORMAT else None


def failed(row: Row, error: str) -> Part:
    """Return the part of a recording that could not be replayed."""
    return Part(replace(row, error=" ".join(error.split())))


#: Of what went well, and of what did not and is tried again when a fleet is resumed.
_DONE, _FAILED = ".part", ".failed"


class Parts:
    """The folder of a fleet's parts; several computers may write to it at once.

    Parameters
    ----------
    folder
        Made where it is not there.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def write(self, key: str, data: bytes, *, failed: bool = False) -> None:
        """Keep a part: written beside, then renamed, so that a kill leaves it whole or not there.

        Raises
        ------
        OutputError
            Where it cannot be written.
        """
        fresh = self.folder / f".{key}.{secrets.token_hex(4)}"
        with room_for(self.folder):
            self.folder.mkdir(parents=True, exist_ok=True)
            try:
                with fresh.open("wb") as stream:
                    stream.write(data)
                    stream.flush()
                    os.fsync(stream.fileno())
                fresh.replace(self.folder / f"{key}{_FAILED if failed else _DONE}")
            finally:
                fresh.unlink(missing_ok=True)
            (self.folder / f"{key}{_DONE if failed else _FAILED}").unlink(missing_ok=True)

    def done(self) -> Iterator[str]:
        """Yield the keys of parts that need not be made again: whole ones without an error."""
        for path in self.folder.glob(f"*{_DONE}"):
            if decoded(path.read_bytes()) is not None:
                yield path.name.removesuffix(_DONE)

    def has(self, key: str) -> bool:
        """Tell whether there is a part that is whole: one may have been copied from elsewhere."""
        path = self._path(key)
        return path is not None and decoded(path.read_bytes()) is not None

    def read(self, key: str) -> Part:
        """Return a part.

        Raises
        ------
        RecordingError
            Where it is not there, or not whole.
        """
        path = self._path(key)
        part = None if path is None else decoded(path.read_bytes())
        if part is None:
            state = "none" if path is None else "a broken one"
            raise RecordingError(f"{self.folder}: {key}: expected a part, found {state}")
        return part

    def _path(self, key: str) -> Path | None:
        paths = (self.folder / f"{key}{suffix}" for suffix in (_DONE, _FAILED))
        return next((path for path in paths if path.is_file()), None)


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


def join(parts: Parts, listed: Sequence[Listed], table: Path, command: str = "") -> Joined:
    """Write the tables, in the order of ``listed``; each appears whole or not at all.

    Parameters
    ----------
    parts, listed, table
        What is joined, in which order, and where to.
    command
        What the tables say they were made by.

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

    notes = {"groundtrace.version": installed_version(), "groundtrace.command": command}
    count = _written(Table("steps", _with_units(_STEP_COLUMNS), steps(), notes), steps_path(table))
    hashes = {row.pipeline: row.pipeline_sha256 for _, row in rows if not row.error}
    notes["groundtrace.pipelines"] = msgspec.json.encode(hashes, order="sorted").decode()
    notes["groundtrace.decided"] = digest.hexdigest()
    _written(_rows_table(rows, notes), table)
    errors = sum(bool(row.error) for _, row in rows)
    warnings = sum(bool(row.warnings) for _, row in rows)
    return Joined(len(rows), count, errors, warnings, digest.hexdigest())


def _written(table: Table, path: Path) -> int:
    with atomic_write(path) as fresh:
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


def _rows_table(rows: Sequence[tuple[str, Row]], notes: Mapping[str, str]) -> Table:
    pairs = _columns()
    batch = [[cell(*row) for row in rows] for _, cell in pairs]
    columns = _with_units([column for column, _ in pairs])
    return Table("fleet", columns, [batch] if rows else [], notes)


#: Units by the word that a name of a column has for them.
_UNITS = {
    "s": "s", "ns": "ns", "ms": "ms", "m": "m", "deg": "deg", "mps": "m/s", "percent": "%",
    "bytes": "B",
}  # fmt: skip


def _with_units(columns: Sequence[Column]) -> tuple[Column, ...]:
    """Return columns of numbers with the units that their names have words for."""

    def unit(column: Column) -> str:
        words = column.name.split("_") if column.type in ("int", "float") else []
        return next((_UNITS[word] for word in reversed(words) if word in _UNITS), "")

    return tuple(replace(column, unit=unit(column)) for column in columns)


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
        message = str(error).splitlines()[0]
        raise RecordingError(f"{path}: expected a fleet's table, found: {message}") from None
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
    misses: dict[tuple[str, str], list[MissedStep]] = {}
    missed = read(path, columns=list(names), filters=[("verdict", "==", "missed")]).to_pydict()
    for location, pipeline, *rest in zip(*(missed[name] for name in names), strict=True):
        misses.setdefault((location, pipeline), []).append(MissedStep(*rest))
    return misses


_CONFUSION = "compared:int agreed:int accuracy:float"
_CONSISTENCY = (
    "n:int dof:int mean:float lower:float upper:float consistent:bool inside_fraction:float"
)
#: Parts of a score, and their figures; lists (curves, impacts, vehicles) stay in ``score_json``.
_PARTS = {
    "steps": "truth:int detected:int matched:int precision:float recall:float f1:float "
    "chance_f1:float chance_f1_metronome:float f1_debiased:float count_truth:int count_error:int "
    "count_error_signed:int",
    "steps.latency_ms": "median:float iqr:float",
    "steps.feet": _CONFUSION,
    "steps.kinds": _CONFUSION,
    "positions": "stage:text truth:int found:int n:int rmse_m:float cep50_m:float cep95_m:float "
    "bias_x_m:float bias_y_m:float",
    "picks": "stage:text",
    "picks.all": "truth:int right:int late:int early:int missed:int answered:int "
    "answered_fraction:float median_abs_ms:float median_ms:float iqr_ms:float earliest_ms:float "
    "latest_ms:float",
    "track": "stage:text times:int tracks:int ospa_m:float gospa_m:float localisation_rmse_m:float "
    "missed:int false:int completeness:float ambiguity:float spuriousness:float accuracy_m:float "
    "cutoff_m:float order:float",
    "track.identity": "switches:int idf1:float",
    "track.closure": "walked_m:float apart_m:float true_apart_m:float percent:float "
    "aligned_rmse_m:float aligned_end_m:float",
    "track.waypoints": "n:int median_m:float mean_m:float p95_m:float end_m:float way_m:float "
    "end_percent:float way_error_percent:float",
    "track.ways": "n:int across_median_m:float across_p90_m:float along_median_m:float "
    "speed_median_mps:float",
    "heading": "stage:text truth:int n:int rmse_deg:float bias_deg:float p95_deg:float",
    "disturbance": "stage:text precision:float recall:float f1:float truth_s:float found_s:float "
    "both_s:float false_alarm_s:float scored_s:float",
    "consistency.nees_fixes": _CONSISTENCY,
    "consistency.nees_tracks": _CONSISTENCY,
    "consistency.nis": _CONSISTENCY,
    "passes": "stage:text truth:int found:int matched:int tolerance_s:float median_abs_s:float "
    "bias_s:float order_right:bool vehicles_right:int speed_median_percent:float",
}


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure of a score.

    Attributes
    ----------
    name
        Of its column.
    type
        Of its cells.
    path
        Where a :class:`~.evaluation.report.Score` has it.
    """

    name: str
    type: ColumnType
    path: tuple[str, ...]

    def of(self, score: Score) -> Any:
        """Return the figure; None where there is no truth for it."""
        value: Any = score
        for step in self.path:
            value = None if value is None else getattr(value, step)
        return value


def _figures() -> tuple[Figure, ...]:
    figures = []
    for part, listed in _PARTS.items():
        prefix = part.removesuffix(".all").replace(".", "_")
        for item in listed.split():
            name, _, kind = item.partition(":")
            path = (*part.split("."), name)
            figures.append(Figure(f"{prefix}_{name}", kind, path))  # type: ignore[arg-type]
    return tuple(figures)


#: In the order of the columns.
FIGURES = _figures()
