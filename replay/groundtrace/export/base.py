"""The exporter protocol, what an exporter is given, and the run of an export."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from datetime import UTC, datetime
from itertools import chain
from typing import TYPE_CHECKING, Any, Literal, Protocol, cast, get_type_hints

import numpy as np

from groundtrace_codecs.events import EVENTS, CandidateBlock
from groundtrace_codecs.signals import FIRST_DATE_NS, NS_PER_S
from groundtrace_codecs.truth import COLUMNS

from ..errors import PluginError, RecordingError
from ..evaluation.matching import STEP_TOLERANCE_S
from ..pipeline.plugins import load, plugins
from ..pipeline.results import atomic_write

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from groundtrace_codecs.annotations import Annotation
    from groundtrace_codecs.events import Event, Label, StageSpec
    from groundtrace_codecs.geometry import Geometry
    from groundtrace_codecs.recording import Recording
    from groundtrace_codecs.signals import SignalBlock, Stream

    from ..pipeline.results import Evidence

    #: Cells of a column in some rows.
    Cells = Sequence[Any] | NDArray[Any]


@dataclass(frozen=True, slots=True)
class Origin:
    """Where the site's zero lies on earth.

    Attributes
    ----------
    latitude_rad, longitude_rad
        WGS 84.
    azimuth_rad
        Direction of the site's y axis, clockwise from north.
    """

    latitude_rad: float
    longitude_rad: float
    azimuth_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class Material:
    """What may be exported of a result, or of a recording.

    Attributes
    ----------
    name
        File name of the results, or of the recording.
    start_ns
        First sample of the recording [ns]: times count from it.
    events
        In the order of the file.
    labels, annotations
        The recording's own truth, and what people marked.
    geometry
        Of the site, or None.
    from_ns
        Where the replay began [ns], or None.
    origin
        Where the site lies, as far as somebody said so.
    recording
        Opens the recording itself, or returns None where it is not there.
    evidence
        Reads what the decisions rest on, with truth; None for a recording.
    """

    name: str
    start_ns: int
    events: tuple[Event, ...] = ()
    labels: tuple[Label, ...] = ()
    annotations: tuple[Annotation, ...] = ()
    geometry: Geometry | None = None
    from_ns: int | None = None
    origin: Origin | None = None
    recording: Callable[[], Recording | None] = lambda: None
    evidence: Callable[[], Evidence] | None = None

    def signals(self) -> Recording:
        """Return the recording, open.

        Raises
        ------
        RecordingError
            Where it is not there.
        """
        recording = self.recording()
        if recording is None:
            raise RecordingError(
                f"{self.name}: expected its recording beside it, or --recording FILE, found none"
            )
        return recording


@dataclass(frozen=True, slots=True)
class Written:
    """What an exporter wrote.

    Attributes
    ----------
    counts
        How many of each kind.
    remarks
        One line each: what the format cannot hold, or was left out.
    """

    counts: dict[str, int]
    remarks: tuple[str, ...] = ()


class Exporter(Protocol):
    """Writes one format; registered in the entry-point group ``groundtrace.exporters``.

    Attributes
    ----------
    name
        Given to ``export --format``.
    description
        One line for people.
    suffixes
        Ends of file names that mean this format, lower case, with the dot.
    kinds
        What it can write, by the names of :func:`all_kinds`.
    one_kind
        True where a file holds a single kind; a folder then takes a file of each.
    """

    name: str
    description: str
    suffixes: tuple[str, ...]
    kinds: tuple[str, ...]
    one_kind: bool

    def write(self, material: Material, kinds: Sequence[str], path: Path) -> Written:
        """Write some kinds.

        Parameters
        ----------
        material
            What there is.
        kinds
            Some of its kinds, one where a file holds no more.
        path
            A new file; or, with ``one_kind``, an empty folder.

        Raises
        ------
        RecordingError
            Where the material lacks what the format needs.
        CodecError
            Where a package that the format needs is not installed.
        """
        ...


#: Types of fields that are cells of a table; a field ``covariance`` is three of them.
CELLS = frozenset({int, float, str, bool})
#: What comes from people: the recording's own truth, and annotations.
LABELS = ("truth", "annotations")


@dataclass(frozen=True, slots=True)
class Miss:
    """A wrong decision about a step.

    Attributes
    ----------
    time_ns
        Of the true step that no detection answers, or of the false detection.
    verdict
        ``missed`` or ``false``.
    cause, text
        Why a step was missed, as ``groundtrace why`` says it; empty for false ones.
    """

    time_ns: int
    verdict: str
    cause: str
    text: str


def tables_of_events() -> dict[str, type[Any]]:
    """Return the events that are rows of tables, by what several of a kind are called."""
    return {kind.plural: cls for cls, kind in EVENTS.items() if _has_cells(cls)}


def _has_cells(cls: type[Any]) -> bool:
    hints = get_type_hints(cls)
    return all(f.name == "covariance" or hints[f.name] in CELLS for f in fields(cls))


def all_kinds() -> tuple[str, ...]:
    """Return every kind; signals are written only where they are asked for by name."""
    return (*tables_of_events(), *LABELS, "misses", "candidates", "signals")


def events_of_kind(material: Material, kind: str) -> list[Any]:
    """Return the events of a kind, in order of time."""
    of = tables_of_events()[kind]
    return sorted((e for e in material.events if isinstance(e, of)), key=time_of)


def time_of(event: Any) -> int:
    """Return when an event is, or begins [ns]."""
    time_ns: int = event.time_ns
    return time_ns


def stage_of(event: object) -> str:
    """Return the stage an event comes from, or nothing."""
    return str(getattr(getattr(event, "spec", event), "stage", ""))


def has_step_truth(material: Material) -> bool:
    """Whether these are results, and it is known which steps are true."""
    if material.evidence is None:
        return False
    return any(label.kind == "step" for label in material.evidence().labels)


def misses(material: Material) -> list[Miss]:
    """Return missed and false steps by time; none where there is no truth of steps."""
    if material.evidence is None or not has_step_truth(material):
        return []
    from ..explain.reasons import StepReasons

    reasons = StepReasons(material.evidence(), STEP_TOLERANCE_S)
    matching = reasons.matching
    wrong_steps = []
    for time_ns in matching.found_ns[matching.false].tolist():
        pair = reasons.wrong_time(time_ns)
        wrong_steps.append(Miss(time_ns, "false", "", "" if pair is None else pair.text))
    for time_ns in matching.truth_ns[matching.missed].tolist():
        reason = reasons.at(time_ns)
        wrong_steps.append(Miss(time_ns, "missed", reason.cause, reason.text))
    return sorted(wrong_steps, key=time_of)


def there(material: Material) -> set[str]:
    """Return the kinds that a result has something of, but for signals."""
    types = {type(event) for event in material.events}
    kinds = {kind for kind, of in tables_of_events().items() if of in types}
    if CandidateBlock in types:
        kinds.add("candidates")
    if material.labels:
        kinds.add("truth")
    if material.annotations:
        kinds.add("annotations")
    if misses(material):
        kinds.add("misses")
    return kinds


GROUP = "exporters"


def exporters() -> tuple[dict[str, Exporter], tuple[str, ...]]:
    """Return the installed exporters by name, and why others do not load."""
    installed: dict[str, Exporter] = {}
    troubles = []
    for plugin in plugins(GROUP):
        try:
            installed[plugin.name] = cast("Exporter", load(GROUP, plugin.name)())
        except PluginError as error:
            troubles.append(str(error))
    return installed, tuple(troubles)


def exporter_of(installed: dict[str, Exporter], path: Path, name: str | None) -> Exporter:
    """Return the exporter that is named, or else the one that a file's name means.

    A name without a suffix is a folder of CSV tables.

    Raises
    ------
    RecordingError
        Where there is none.
    """
    if name is not None:
        if name not in installed:
            raise RecordingError(
                f"--format: expected one of {', '.join(installed)}, found {name!r}"
            )
        return installed[name]
    suffix = path.suffix.lower() if not path.is_dir() else ""
    wanted = [
        e for e in installed.values() if (suffix in e.suffixes if suffix else e.name == "csv")
    ]
    if not wanted:
        ends = ", ".join(end for e in installed.values() for end in e.suffixes)
        raise RecordingError(
            f"{path}: expected a name that ends in one of {ends}, a folder, or --format, "
            f"found {suffix or 'none'}"
        )
    return wanted[0]


def is_folder(exporter: Exporter, path: Path) -> bool:
    """Whether a path is to be a folder with a file of each kind."""
    return exporter.one_kind and path.suffix.lower() not in exporter.suffixes


def chosen_kinds(
    exporter: Exporter, material: Material, asked: Sequence[str], *, folder: bool
) -> list[str]:
    """Return the kinds to write: those asked for, or all that there is something of.

    Raises
    ------
    RecordingError
        Where one is none of the exporter's, there is nothing, or one file cannot hold several.
    """
    for kind in asked:
        if kind not in exporter.kinds:
            raise RecordingError(
                f"--kind: {exporter.name}: expected one of {', '.join(exporter.kinds)}, "
                f"found {kind!r}"
            )
    if "misses" in asked and not has_step_truth(material):
        raise RecordingError(
            f"{material.name}: misses: expected results with true steps, found none"
        )
    kinds = list(dict.fromkeys(asked))
    if not kinds and exporter.kinds == ("signals",):
        kinds = ["signals"]
    if not kinds:
        have = there(material)
        kinds = [kind for kind in exporter.kinds if kind in have]
        if not kinds:
            others = ", ".join(kind for kind in all_kinds() if kind in have) or "none"
            raise RecordingError(
                f"{material.name}: {exporter.name}: expected something of "
                f"{', '.join(exporter.kinds)}, found {others}"
            )
    if exporter.one_kind and not folder and len(kinds) > 1:
        raise RecordingError(
            f"{material.name}: --kind: expected one of {', '.join(kinds)} for one file, found "
            f"{len(kinds)} kinds; -o FOLDER takes them all"
        )
    return kinds


def export(
    exporter: Exporter,
    material: Material,
    kinds: Sequence[str],
    path: Path,
    *,
    folder: bool = False,
) -> Written:
    """Write some kinds; the output appears under its name when it is whole.

    A folder that exists is replaced only where it holds nothing but such tables.

    Raises
    ------
    GroundtraceError, CodecError
        Where the material lacks something, a package is missing, or the folder holds other files.
    """
    if folder and path.is_dir():
        others = [p.name for p in path.iterdir() if p.suffix not in exporter.suffixes]
        if others:
            raise RecordingError(
                f"{path}: expected a folder of {exporter.name} tables to replace, "
                f"found {sorted(others)[0]} in it: it stays"
            )
    with atomic_write(path) as fresh:
        if folder:
            fresh.mkdir()
        return exporter.write(material, kinds, fresh)


def pieces_of(recording: Recording, stream: Stream, longest_s: float) -> Iterator[SignalBlock]:
    """Yield the samples of a uniform stream as stored, joined as far as none is missing.

    Parameters
    ----------
    recording, stream
        What to read.
    longest_s
        About the longest piece [s].
    """
    waiting: list[SignalBlock] = []
    samples = 0
    for _, block in recording.blocks([stream.topic]):
        full = samples >= longest_s * stream.rate_hz
        if waiting and (full or not _continues(waiting[-1], block)):
            yield _joined(waiting)
            waiting, samples = [], 0
        waiting.append(block)
        samples += len(block)
    if waiting:
        yield _joined(waiting)


def _continues(before: SignalBlock, block: SignalBlock) -> bool:
    """Whether a block starts where one ended, to half a sample, with samples of its type."""
    off_ns = abs(block.start_ns - before.last_ns - before.stream.period_ns)
    same = block.samples.dtype == before.samples.dtype
    return same and off_ns < before.stream.period_ns / 2


def _joined(blocks: list[SignalBlock]) -> SignalBlock:
    return replace(blocks[0], samples=np.concatenate([b.samples for b in blocks]))


def write_tables(
    material: Material,
    kinds: Sequence[str],
    path: Path,
    suffix: str,
    write: Callable[[Table, Path], int],
) -> Written:
    """Write the tables of some kinds.

    Parameters
    ----------
    material, kinds
        What to write.
    path
        A new file for the one table there is, or a folder.
    suffix
        Of the files in a folder.
    write
        Writes a table and returns how many rows it has.

    Raises
    ------
    RecordingError
        Where a file would have to hold several tables.
    """
    counts: dict[str, int] = {}
    if path.is_dir():
        for kind in kinds:
            for table in tables_of(material, kind):
                file = path / f"{table.name}{suffix}"
                counts[kind] = counts.get(kind, 0) + write(table, file)
        return Written(counts)
    (kind,) = kinds
    tables = list(tables_of(material, kind))
    if len(tables) != 1:
        names = ", ".join(table.name for table in tables) or "none"
        raise RecordingError(
            f"{material.name}: {kind}: expected one table for one file, found {names}; "
            f"-o FOLDER takes them all"
        )
    return Written({kind: write(tables[0], path)})


def iso_utc(time_ns: int) -> str | None:
    """Return a time [ns since 1970] as ISO 8601 in UTC; None where no clock of the calendar."""
    if time_ns < FIRST_DATE_NS:
        return None
    seconds, part = divmod(time_ns, NS_PER_S)
    text = datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%dT%H:%M:%S")
    return f"{text}.{part:09d}Z"


#: ``seconds`` and ``utc`` hold ns: since the recording's first sample, and since 1970.
ColumnType = Literal["seconds", "utc", "int", "float", "text", "bool"]
_OF_TYPE: dict[type, ColumnType] = {int: "int", float: "float", str: "text", bool: "bool"}
_TIMES: tuple[tuple[str, ColumnType], ...] = (
    ("time_s", "seconds"),
    ("time_utc", "utc"),
    ("time_ns", "int"),
)
_COVARIANCE = ("covariance_xx_m2", "covariance_xy_m2", "covariance_yy_m2")
_NUMBERS = frozenset({"x_m", "y_m", "value"})


@dataclass(frozen=True, slots=True)
class Column:
    """Name and type of a column, and its unit where the format has a place for that."""

    name: str
    type: ColumnType
    unit: str = ""


@dataclass(frozen=True, slots=True)
class Table:
    """A table, read once.

    Attributes
    ----------
    name
        Of its file, without suffix.
    columns
        What the cells are; None is an empty cell.
    batches
        Each the cells of some rows, a sequence for each column.
    notes
        What is said of the table as a whole, where its format has a place for that.
    """

    name: str
    columns: tuple[Column, ...]
    batches: Iterable[Sequence[Cells]]
    notes: Mapping[str, str] = field(default_factory=dict)


def tables_of(material: Material, kind: str) -> Iterator[Table]:
    """Yield the tables of a kind: one, but for candidates and signals, which have several."""
    of = tables_of_events().get(kind)
    if of is not None:
        yield _event_table(kind, of, events_of_kind(material, kind), material.start_ns)
    elif kind == "misses":
        yield _event_table(kind, Miss, misses(material), material.start_ns)
    elif kind in LABELS:
        yield _label_table(material, kind)
    elif kind == "candidates":
        yield from _candidate_tables(material)
    else:
        yield from _signal_tables(material)


def _columns(pairs: Iterable[tuple[str, ColumnType]]) -> tuple[Column, ...]:
    return tuple(Column(*pair) for pair in pairs)


def _batch(columns: Sequence[Column], rows: Iterable[Sequence[Any]]) -> Iterator[Sequence[Any]]:
    """Yield the one batch of some rows, if there are any."""
    if cells := list(zip(*rows, strict=True)):
        assert len(cells) == len(columns)
        yield cells


def _times(time_ns: int, start_ns: int) -> tuple[int, int, int]:
    return time_ns - start_ns, time_ns, time_ns


def _event_table(kind: str, of: type, events: Sequence[object], start_ns: int) -> Table:
    """Return the table of single events: the times, then the other fields."""
    hints = get_type_hints(of)
    names = [f.name for f in fields(of) if f.name not in ("time_ns", "start_ns")]
    columns = _columns(chain(_TIMES, *(_columns_of(name, hints[name]) for name in names)))
    rows = (
        [
            *_times(time_of(event), start_ns),
            *chain.from_iterable(_cells(event, name, start_ns) for name in names),
        ]
        for event in events
    )
    return Table(kind, columns, _batch(columns, rows))


def _columns_of(name: str, of: type) -> tuple[tuple[str, ColumnType], ...]:
    if name == "end_ns":
        return ("end_s", "seconds"), ("end_ns", "int")
    if name == "covariance":
        return tuple((n, "float") for n in _COVARIANCE)
    return ((name, _OF_TYPE[of]),)


def _cells(event: object, name: str, start_ns: int) -> Sequence[Any]:
    value = getattr(event, name)
    if name == "end_ns":
        return value - start_ns, value
    return value if name == "covariance" else (value,)


def _label_table(material: Material, kind: str) -> Table:
    """Return labels in the columns of a truth table, which ``--truth`` reads."""
    if kind == "truth":
        labels = material.labels
    else:
        labels = tuple(annotation.label for annotation in material.annotations)
    names = [name for name in COLUMNS if name not in ("time_ns", "end_ns")]
    columns = _columns((name, _label_type(name)) for name in names)
    rows = ([_label_cell(label, name, material.start_ns) for name in names] for label in labels)
    return Table(kind, columns, _batch(columns, rows))


def _label_type(name: str) -> ColumnType:
    if name in ("time_s", "end_s"):
        return "seconds"
    return "float" if name in _NUMBERS else "text"


def _label_cell(label: Label, name: str, start_ns: int) -> Any:
    if name in ("time_s", "end_s"):
        at_ns = label.time_ns if name == "time_s" else label.end_ns
        return None if at_ns is None else at_ns - start_ns
    return getattr(label, name)


def file_part(text: str) -> str:
    """Return a topic or the name of a stage as part of a file name."""
    characters = (c if c.isalnum() or c in "-_." else "-" for c in text.strip("/"))
    return "".join(characters) or "-"


def unit_part(unit: str) -> str:
    """Return a unit as the end of a column's name: ``m/s2`` becomes ``_m_per_s2``."""
    return f"_{unit.replace('/', '_per_')}" if unit not in ("", "1") else ""


def _candidate_tables(material: Material) -> Iterator[Table]:
    """Yield per stage and topic: values, gates with threshold and margin, verdict."""
    blocks: dict[StageSpec, list[CandidateBlock]] = {}
    for event in material.events:
        if isinstance(event, CandidateBlock):
            blocks.setdefault(event.spec, []).append(event)
    for spec, spec_blocks in blocks.items():
        pairs: list[tuple[str, ColumnType]] = [*_TIMES, ("channel", "text"), ("accepted", "bool")]
        pairs += [(q.name + unit_part(q.unit), "float") for q in spec.columns]
        for gate in spec.gates:
            end = unit_part(gate.unit)
            pairs += [(f"gate_{gate.name}{end}", "float"), (f"margin_{gate.name}{end}", "float")]
        name = f"candidates-{file_part(spec.stage)}-{file_part(spec.topic)}"
        batches = (_candidate_batch(block, material.start_ns) for block in spec_blocks)
        yield Table(name, _columns(pairs), batches)


def _candidate_batch(block: CandidateBlock, start_ns: int) -> list[Cells]:
    names = [block.spec.channels[i] for i in block.channel.tolist()]
    cells: list[Cells] = [block.time_ns - start_ns, block.time_ns, block.time_ns]
    cells += [names, block.accepted, *block.value.T]
    for gate in range(len(block.spec.gates)):
        cells += [block.gate_value[:, gate], block.margin[:, gate]]
    return cells


def _signal_tables(material: Material) -> Iterator[Table]:
    """Yield per stream the samples in their units."""
    recording = material.signals()
    for stream in recording.streams:
        pairs: list[tuple[str, ColumnType]] = list(_TIMES)
        pairs += [(c.name + unit_part(c.unit), "float") for c in stream.channels]
        blocks = (stamped.block for stamped in recording.blocks([stream.topic]))
        batches = (_signal_batch(block, material.start_ns) for block in blocks)
        yield Table(_signal_name(stream), _columns(pairs), batches)


def _signal_name(stream: Stream) -> str:
    return f"signals-{file_part(stream.topic)}"


def _signal_batch(block: SignalBlock, start_ns: int) -> list[Cells]:
    times_ns = block.sample_times()
    return [times_ns - start_ns, times_ns, times_ns, *block.values.T]
