"""Tables: columns with their units in their names, rows in batches."""

from __future__ import annotations

from dataclasses import dataclass, fields
from itertools import chain
from typing import TYPE_CHECKING, Any, Literal, get_type_hints

from groundtrace_codecs.events import CandidateBlock
from groundtrace_codecs.truth import COLUMNS

from .kinds import LABELS, Miss, events_of_kind, misses, tables_of_events, time_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import StageSpec
    from groundtrace_codecs.labels import Label
    from groundtrace_codecs.signals import SignalBlock, Stream

    from .api import Material

    #: Cells of a column in some rows.
    Cells = Sequence[Any] | NDArray[Any]

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
    """Name and type of a column."""

    name: str
    type: ColumnType


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
    """

    name: str
    columns: tuple[Column, ...]
    batches: Iterable[Sequence[Cells]]


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
    kept = (c if c.isalnum() or c in "-_." else "-" for c in text.strip("/"))
    return "".join(kept) or "-"


def unit_part(unit: str) -> str:
    """Return a unit as the end of a column's name: ``m/s2`` becomes ``_m_per_s2``."""
    return f"_{unit.replace('/', '_per_')}" if unit not in ("", "1") else ""


def _candidate_tables(material: Material) -> Iterator[Table]:
    """Yield per stage and topic: values, gates with threshold and margin, verdict."""
    blocks: dict[StageSpec, list[CandidateBlock]] = {}
    for event in material.events:
        if isinstance(event, CandidateBlock):
            blocks.setdefault(event.spec, []).append(event)
    for spec, found in blocks.items():
        pairs: list[tuple[str, ColumnType]] = [*_TIMES, ("channel", "text"), ("accepted", "bool")]
        pairs += [(q.name + unit_part(q.unit), "float") for q in spec.columns]
        for gate in spec.gates:
            end = unit_part(gate.unit)
            pairs += [(f"gate_{gate.name}{end}", "float"), (f"margin_{gate.name}{end}", "float")]
        name = f"candidates-{file_part(spec.stage)}-{file_part(spec.topic)}"
        batches = (_candidate_batch(block, material.start_ns) for block in found)
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
