"""Events and labels as protobuf messages, and their topics."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields
from functools import partial
from math import prod
from operator import attrgetter
from sys import intern
from typing import TYPE_CHECKING, Any, Protocol, get_args, get_origin, get_type_hints

import msgspec
import numpy as np
from google.protobuf.message import DecodeError

from ..errors import SchemaError
from ..events import CandidateBlock, Label, StageSpec, TraceBlock, kind_of_message
from ..signals import SPEC_KEY
from .protobuf import get_time, message_class, parse, set_time, unreadable

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from numpy.typing import NDArray

    from ..events import Event
    from ..mcap.chunks import ChannelRecord, MessageTable, Schema
    from ..mcap.reader import McapFile


def candidates_topic(spec: StageSpec) -> str:
    """Return the topic of a stage's candidates."""
    return f"/groundtrace/candidates/{spec.stage}{spec.topic}"


def trace_topic(spec: StageSpec) -> str:
    """Return the topic of a stage's trace."""
    return f"/groundtrace/trace/{spec.stage}{spec.topic}"


def spec_json(spec: StageSpec) -> str:
    """Return a stage's description as it is stored in channel metadata."""
    return json.dumps(asdict(spec), default=float)


def spec_from_json(text: str, where: str) -> StageSpec:
    """Read a stage's description.

    Raises
    ------
    SchemaError
        Where the text is none.
    """
    try:
        return msgspec.convert(json.loads(text), StageSpec)
    except (ValueError, msgspec.ValidationError) as error:
        raise SchemaError(f"{where}: expected a stage, found: {error}") from error


def _column(data: bytes, dtype: str, shape: tuple[int, ...], where: str) -> NDArray[Any]:
    expected = prod(shape) * np.dtype(dtype).itemsize
    if len(data) != expected:
        raise SchemaError(f"{where}: expected {expected} bytes, found {len(data)}")
    return np.frombuffer(data, dtype).reshape(shape)


def decode_candidates(
    data: bytes | memoryview, spec: StageSpec, where: str = "CandidateBlock"
) -> CandidateBlock:
    """Decode a CandidateBlock of a stage.

    Raises
    ------
    SchemaError
        Where the bytes are not one with the stage's columns, gates and channels.
    """
    message = parse(message_class("CandidateBlock"), data, where)
    count = message.count
    channel = _column(message.channel, "<i4", (count,), f"{where}: channel")
    if count and not (channel.min() >= 0 and channel.max() < len(spec.channels)):
        raise SchemaError(
            f"{where}: channel: expected 0 to {len(spec.channels) - 1}, "
            f"found {channel.min()} to {channel.max()}"
        )
    gates = (count, len(spec.gates))
    return CandidateBlock(
        spec,
        _column(message.time_ns, "<i8", (count,), f"{where}: time_ns"),
        channel,
        _column(message.value, "<f4", (count, len(spec.columns)), f"{where}: value"),
        _column(message.gate_value, "<f4", gates, f"{where}: gate_value"),
        _column(message.margin, "<f4", gates, f"{where}: margin"),
        _column(message.accepted, "u1", (count,), f"{where}: accepted") != 0,
    )


def decode_trace(
    data: bytes | memoryview, spec: StageSpec, where: str = "TraceBlock"
) -> TraceBlock:
    """Decode a TraceBlock of a stage.

    Raises
    ------
    SchemaError
        Where the bytes are not one with the stage's channels and quantities.
    """
    message = parse(message_class("TraceBlock"), data, where)
    shape = (message.count, len(spec.channels), len(spec.trace))
    time_ns = _column(message.time_ns, "<i8", shape[:1], f"{where}: time_ns")
    return TraceBlock(spec, time_ns, _column(message.value, "<f4", shape, f"{where}: value"))


@dataclass(frozen=True, slots=True)
class Layout:
    """How the fields of a kind of event stand in its message; made once of its dataclass.

    Attributes
    ----------
    message
        The message's class.
    names
        Of the event's fields, in order.
    sources
        The message's field of each.
    times
        Which of them are times.
    texts
        Which are texts.
    lengths
        Which are tuples, and how many numbers each has.
    """

    message: Any
    names: tuple[str, ...]
    sources: tuple[str, ...]
    times: tuple[int, ...]
    texts: tuple[int, ...]
    lengths: tuple[tuple[int, int], ...]


#: What decodes the messages of a kind: it takes the place, named in errors, and the bytes.
Decoder = Callable[[str, "bytes | memoryview"], Any]
_DECODERS: dict[type[Any], Decoder] = {}

#: Fields that are times, by what the message calls them.
TIMES = {"time_ns": "timestamp", "start_ns": "timestamp", "end_ns": "end"}


def layout_of(cls: type[Any]) -> Layout:
    """Return how a kind of event is stored.

    Raises
    ------
    TypeError
        Where its message has other fields than the event.
    """
    message = message_class(cls.__name__)
    names = tuple(f.name for f in fields(cls))
    sources = tuple(TIMES.get(name, name) for name in names)
    stored = {f.name for f in message.DESCRIPTOR.fields}
    if stored != set(sources):
        raise TypeError(
            f"{message.DESCRIPTOR.full_name}: expected the fields {', '.join(sources)} of the "
            f"event, found {', '.join(stored)}"
        )
    hints = get_type_hints(cls)
    types = [hints[name] for name in names]
    return Layout(
        message,
        names,
        sources,
        tuple(i for i, name in enumerate(names) if name in TIMES),
        tuple(i for i, t in enumerate(types) if t is str),
        tuple((i, len(get_args(t))) for i, t in enumerate(types) if get_origin(t) is tuple),
    )


def decoder_of(cls: type[Any]) -> Decoder:
    """Return what decodes the messages of a kind of event; made once, it is given the place."""
    if cls not in _DECODERS:
        _DECODERS[cls] = _decoder_by(layout_of(cls), cls)
    return _DECODERS[cls]


def _decoder_by(layout: Layout, cls: type[Any]) -> Decoder:
    message_of, values_of = layout.message.FromString, attrgetter(*layout.sources)
    times, texts, lengths = layout.times, layout.texts, layout.lengths

    def decode(where: str, data: bytes | memoryview) -> Any:
        try:
            values = list(values_of(message_of(data)))
        except DecodeError as error:
            raise unreadable(layout.message, where, error) from error
        for i in times:
            values[i] = get_time(values[i], where)
        for i in texts:
            # one text for all events that say the same: an hour has a hundred thousand picks
            values[i] = intern(values[i])
        for i, length in lengths:
            if len(values[i]) != length:
                name = layout.names[i]
                raise SchemaError(
                    f"{where}: {name}: expected {length} numbers, found {len(values[i])}"
                )
            values[i] = tuple(values[i])
        try:
            return cls(*values)
        except ValueError as error:
            raise SchemaError(f"{where}: {error}") from error

    return decode


def events_of(
    file: McapFile, *, blocks: bool = True, only: Collection[str] | None = None
) -> Iterator[Event]:
    """Yield the stages of a results file, then its events in order of log time.

    Without ``blocks`` candidates and decision functions, which are most of a file, are left out;
    with ``only`` all messages of other names.

    Raises
    ------
    SchemaError
        Where a message is not what its channel says.
    """
    decoders = {
        i: decoder
        for i in sorted(file.channels)
        if (decoder := _decoder(file, i, only)) is not None
    }
    specs = (spec for spec, _ in decoders.values() if spec is not None)
    yield from dict.fromkeys(specs)
    wanted = {i for i, (spec, _) in decoders.items() if blocks or spec is None}
    for message in file.messages(wanted):
        yield decoders[message.channel_id][1](message.data)


def _decoder(
    file: McapFile, channel_id: int, only: Collection[str] | None
) -> tuple[StageSpec | None, Callable[[bytes | memoryview], Event]] | None:
    channel = file.channels[channel_id]
    schema = file.schemas.get(channel.schema_id)
    package, _, name = schema.name.partition(".") if schema is not None else ("", "", "")
    where = f"{file.name}: {channel.topic}"
    if package != "groundtrace" or (only is not None and name not in only):
        return None
    if name in {"CandidateBlock", "TraceBlock"}:
        spec = spec_from_json(channel.metadata.get(SPEC_KEY, ""), where)
        decode = decode_candidates if name == "CandidateBlock" else decode_trace
        return spec, lambda data: decode(data, spec, where)
    kind = kind_of_message(name)
    if kind is None:
        return None
    return None, partial(decoder_of(kind.cls), where)


#: Topic of a recording's own truth.
TRUTH_TOPIC = "/truth"
_TEXTS = ("channel", "label", "author", "note", "target")
_NUMBERS = ("x_m", "y_m", "value")


def label_message(label: Label) -> Any:
    """Return the protobuf message of a label."""
    message = message_class("Label")(kind=label.kind)
    set_time(message.timestamp, label.time_ns)
    if label.end_ns is not None:
        set_time(message.end, label.end_ns)
    for name in (*_TEXTS, *_NUMBERS):
        value = getattr(label, name)
        if value is not None:
            setattr(message, name, value)
    return message


def encode_label(label: Label) -> bytes:
    """Encode one label."""
    encoded: bytes = label_message(label).SerializeToString()
    return encoded


def decode_label(data: bytes | memoryview, where: str = "Label") -> Label:
    """Decode one label.

    Raises
    ------
    SchemaError
        Where the bytes are not a label; names ``where``.
    """
    message = parse(message_class("Label"), data, where)
    # one text for all labels that say the same: an hour of picks has thousands
    fields: dict[str, Any] = {name: intern(getattr(message, name)) for name in _TEXTS}
    fields |= {name: getattr(message, name) for name in _NUMBERS if message.HasField(name)}
    if message.HasField("end"):
        fields["end_ns"] = get_time(message.end, where)
    return Label(get_time(message.timestamp, where), intern(message.kind), **fields)


class Described(Protocol):
    """What describes the messages of a file, whether it is whole or grows."""

    @property
    def name(self) -> str:
        """What errors call the file."""

    @property
    def channels(self) -> dict[int, ChannelRecord]:
        """By id."""

    @property
    def schemas(self) -> dict[int, Schema]:
        """By id."""


def label_channels(file: Described, topic: str) -> set[int]:
    """Return the ids of the channels of a topic that hold labels."""
    return {
        channel.id
        for channel in file.channels.values()
        if channel.topic == topic
        and channel.schema_id in file.schemas
        and file.schemas[channel.schema_id].name == "groundtrace.Label"
    }


def labels_of(file: McapFile, topic: str) -> tuple[Label, ...]:
    """Return the labels on a topic, by time.

    Raises
    ------
    SchemaError
        Where a message there is not a label.
    """
    wanted = label_channels(file, topic)
    if not wanted:
        return ()
    where = f"{file.name}: {topic}"
    return tuple(decode_label(m.data, where) for m in file.messages(wanted))


def labels_in(messages: MessageTable, file: Described, topic: str) -> list[Label]:
    """Return the labels on a topic among messages of a file, in their order.

    Raises
    ------
    SchemaError
        Where a message there is not a label.
    """
    wanted = label_channels(file, topic) & messages.counts().keys()
    where = f"{file.name}: {topic}"
    return [decode_label(m.data, where) for m in messages.of_channels(sorted(wanted))]
