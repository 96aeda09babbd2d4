"""Events as protobuf messages, their topics, and the text mirror other viewers show."""

from __future__ import annotations

import json
from dataclasses import asdict
from functools import cache
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from .description import ROLE_KEY, SPEC_KEY
from .encoders import Output, Packet, protobuf_output
from .errors import SchemaError
from .events import CandidateBlock, Gap, Note, Pick, StageSpec, StepEvent, TraceBlock
from .schemas.protobuf import descriptor_set, get_time, message_class, parse, set_time

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from .events import Event
    from .mcap import McapFile

PICKS_TOPIC = "/groundtrace/picks"
STEPS_TOPIC = "/groundtrace/steps"
GAPS_TOPIC = "/groundtrace/gaps"
NOTES_TOPIC = "/groundtrace/notes"
LOG_TOPIC = "/groundtrace/log"

Encoded = tuple[Output, Packet | None]


def candidates_topic(spec: StageSpec) -> str:
    """Return the topic of a stage's candidates."""
    return f"/groundtrace/candidates/{spec.stage}{spec.topic}"


def trace_topic(spec: StageSpec) -> str:
    """Return the topic of a stage's trace."""
    return f"/groundtrace/trace/{spec.stage}{spec.topic}"


def spec_json(spec: StageSpec) -> str:
    """Return a stage's description as it is stored in channel metadata."""
    return json.dumps(asdict(spec), default=float)


def spec_from_json(text: str, place: str) -> StageSpec:
    """Read a stage's description.

    Raises
    ------
    SchemaError
        Where the text is none.
    """
    try:
        return msgspec.convert(json.loads(text), StageSpec)
    except (ValueError, msgspec.ValidationError) as error:
        raise SchemaError(f"{place}: expected a stage, found: {error}") from error


@cache
def _stage_output(spec: StageSpec, name: str) -> Output:
    topic = candidates_topic(spec) if name == "CandidateBlock" else trace_topic(spec)
    return protobuf_output(topic, name, ((SPEC_KEY, spec_json(spec)),))


def encode_event(event: Event) -> Iterator[Encoded]:
    """Yield the messages of an event and the channels they go to.

    A stage's description is a channel without a message yet. Blocks without rows yield nothing.
    """
    if isinstance(event, StageSpec):
        yield _stage_output(event, "CandidateBlock"), None
        yield _stage_output(event, "TraceBlock"), None
    elif isinstance(event, CandidateBlock):
        if len(event):
            yield _stage_output(event.spec, "CandidateBlock"), _candidates(event)
    elif isinstance(event, TraceBlock):
        if len(event):
            yield _stage_output(event.spec, "TraceBlock"), _trace(event)
    else:
        yield _single(event)
        yield _mirror(event)


def _packet(message: Any, first_ns: int, last_ns: int) -> Packet:
    set_time(message.timestamp, first_ns)
    return Packet(int(last_ns), int(first_ns), 0, message.SerializeToString())


def _candidates(block: CandidateBlock) -> Packet:
    message = message_class("CandidateBlock")(
        count=len(block),
        time_ns=block.time_ns.astype("<i8").tobytes(),
        channel=block.channel.astype("<i4").tobytes(),
        value=block.value.astype("<f4").tobytes(),
        gate_value=block.gate_value.astype("<f4").tobytes(),
        margin=block.margin.astype("<f4").tobytes(),
        accepted=block.accepted.astype("u1").tobytes(),
    )
    return _packet(message, block.time_ns[0], block.time_ns.max())


def _trace(block: TraceBlock) -> Packet:
    message = message_class("TraceBlock")(
        count=len(block),
        time_ns=block.time_ns.astype("<i8").tobytes(),
        value=block.value.astype("<f4").tobytes(),
    )
    return _packet(message, block.time_ns[0], block.time_ns.max())


def _single(event: Pick | StepEvent | Gap | Note) -> Encoded:
    """Encode an event of one time: the message's fields are the event's, but for its times."""
    name = type(event).__name__
    topics = {"Pick": PICKS_TOPIC, "StepEvent": STEPS_TOPIC, "Gap": GAPS_TOPIC}
    output = protobuf_output(topics.get(name, NOTES_TOPIC), name)
    fields = asdict(event)
    message = message_class(name)(**{k: v for k, v in fields.items() if not k.endswith("_ns")})
    if isinstance(event, Gap):
        set_time(message.end, event.end_ns)
        return output, _packet(message, event.start_ns, max(event.start_ns, event.end_ns))
    return output, _packet(message, event.time_ns, event.time_ns)


@cache
def _log_output() -> Output:
    from foxglove_schemas_protobuf.Log_pb2 import Log

    content = descriptor_set(Log)
    role = ((ROLE_KEY, "mirror"),)
    return Output(LOG_TOPIC, "foxglove.Log", "protobuf", content, "protobuf", role)


def _mirror(event: Pick | StepEvent | Gap | Note) -> Encoded:
    from foxglove_schemas_protobuf.Log_pb2 import Log

    level, source, text, time_ns = _line(event)
    message = Log(level=Log.Level.Value(level), message=text, name=source)
    return _log_output(), _packet(message, time_ns, time_ns)


def _line(event: Pick | StepEvent | Gap | Note) -> tuple[str, str, str, int]:
    """Return level, source, text and time of an event's line in the log."""
    if isinstance(event, Pick):
        return "INFO", event.stage, f"pick {event.channel} value={event.value:.4g}", event.time_ns
    if isinstance(event, StepEvent):
        kind = f"{event.kind} {event.foot}".strip()
        text = f"{kind} value={event.value:.4g} channels={event.channels}"
        return "INFO", event.stage, text, event.time_ns
    if isinstance(event, Gap):
        time_ns = max(event.start_ns, event.end_ns)
        seconds = (event.end_ns - event.start_ns) / 1e9
        text = f"gap {event.topic} {event.reason}: {event.lost} lost in {seconds:.6g} s"
        return "WARNING", "source", text, time_ns
    level = event.level if event.level in {"DEBUG", "INFO", "WARNING", "ERROR", "FATAL"} else "INFO"
    return level, event.source, event.text, event.time_ns


def _column(data: bytes, dtype: str, shape: tuple[int, ...], place: str) -> NDArray[Any]:
    expected = int(np.prod(shape, dtype=object)) * np.dtype(dtype).itemsize
    if len(data) != expected:
        raise SchemaError(f"{place}: expected {expected} bytes, found {len(data)}")
    return np.frombuffer(data, dtype).reshape(shape)


def decode_candidates(
    data: bytes | memoryview, spec: StageSpec, place: str = "CandidateBlock"
) -> CandidateBlock:
    """Decode a CandidateBlock of a stage.

    Raises
    ------
    SchemaError
        Where the bytes are not one with the stage's columns, gates and channels.
    """
    message = parse(message_class("CandidateBlock"), data, place)
    count = message.count
    channel = _column(message.channel, "<i4", (count,), f"{place}: channel")
    if count and not (channel.min() >= 0 and channel.max() < len(spec.channels)):
        raise SchemaError(
            f"{place}: channel: expected 0 to {len(spec.channels) - 1}, "
            f"found {channel.min()} to {channel.max()}"
        )
    gates = (count, len(spec.gates))
    return CandidateBlock(
        spec,
        _column(message.time_ns, "<i8", (count,), f"{place}: time_ns"),
        channel,
        _column(message.value, "<f4", (count, len(spec.columns)), f"{place}: value"),
        _column(message.gate_value, "<f4", gates, f"{place}: gate_value"),
        _column(message.margin, "<f4", gates, f"{place}: margin"),
        _column(message.accepted, "u1", (count,), f"{place}: accepted") != 0,
    )


def decode_trace(
    data: bytes | memoryview, spec: StageSpec, place: str = "TraceBlock"
) -> TraceBlock:
    """Decode a TraceBlock of a stage.

    Raises
    ------
    SchemaError
        Where the bytes are not one with the stage's channels and quantities.
    """
    message = parse(message_class("TraceBlock"), data, place)
    shape = (message.count, len(spec.channels), len(spec.trace))
    time_ns = _column(message.time_ns, "<i8", shape[:1], f"{place}: time_ns")
    return TraceBlock(spec, time_ns, _column(message.value, "<f4", shape, f"{place}: value"))


def decode_event(name: str, data: bytes | memoryview, place: str) -> Pick | StepEvent | Gap | Note:
    """Decode an event of one time; ``name`` is its message's.

    Raises
    ------
    SchemaError
        Where the bytes are not one.
    """
    m = parse(message_class(name), data, place)
    time_ns = get_time(m.timestamp, place)
    if name == "Pick":
        return Pick(time_ns, m.channel, m.topic, m.stage, m.uncertainty_s, m.value)
    if name == "StepEvent":
        return StepEvent(time_ns, m.kind, m.foot, m.topic, m.stage, m.value, m.channels)
    if name == "Gap":
        return Gap(m.topic, time_ns, get_time(m.end, place), m.reason, m.lost, m.bridged)
    return Note(time_ns, m.text, m.level, m.source)


def events_of(file: McapFile) -> Iterator[Event]:
    """Yield the stages of a results file, then its events in order of log time.

    Raises
    ------
    SchemaError
        Where a message is not what its channel says.
    """
    decoders = {
        i: decoder for i in sorted(file.channels) if (decoder := _decoder(file, i)) is not None
    }
    specs = (spec for spec, _ in decoders.values() if spec is not None)
    yield from dict.fromkeys(specs)
    for message in file.messages(decoders.keys()):
        yield decoders[message.channel_id][1](message.data)


def _decoder(
    file: McapFile, channel_id: int
) -> tuple[StageSpec | None, Callable[[bytes | memoryview], Event]] | None:
    channel = file.channels[channel_id]
    schema = file.schemas.get(channel.schema_id)
    package, _, name = schema.name.partition(".") if schema is not None else ("", "", "")
    place = f"{file.name}: {channel.topic}"
    if package != "groundtrace":
        return None
    if name in {"CandidateBlock", "TraceBlock"}:
        spec = spec_from_json(channel.metadata.get(SPEC_KEY, ""), place)
        decode = decode_candidates if name == "CandidateBlock" else decode_trace
        return spec, lambda data: decode(data, spec, place)
    if name in {"Pick", "StepEvent", "Gap", "Note"}:
        return None, lambda data: decode_event(name, data, place)
    return None
