"""Events as protobuf messages, and their topics."""

from __future__ import annotations

import json
from dataclasses import asdict
from math import prod
from sys import intern
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from .description import SPEC_KEY
from .errors import SchemaError
from .events import (
    Bearing,
    CandidateBlock,
    Disagreement,
    Disturbance,
    Fix,
    Gap,
    Heading,
    Note,
    Pick,
    StageSpec,
    StepEvent,
    TraceBlock,
    TrackPoint,
)
from .schemas.protobuf import get_time, message_class, parse
from .traffic import traffic_event

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator

    from numpy.typing import NDArray

    from .events import Event, SingleEvent
    from .mcap import McapFile

#: Topic of each message of a single event.
TOPICS = {
    "Pick": "/groundtrace/picks",
    "StepEvent": "/groundtrace/steps",
    "Fix": "/groundtrace/fixes",
    "TrackPoint": "/groundtrace/tracks",
    "Heading": "/groundtrace/headings",
    "Disturbance": "/groundtrace/disturbances",
    "Bearing": "/groundtrace/bearings",
    "Disagreement": "/groundtrace/disagreements",
    "Presence": "/groundtrace/presence",
    "Pass": "/groundtrace/passes",
    "LineCrossing": "/groundtrace/crossings",
    "LikelihoodSurface": "/groundtrace/surfaces",
    "Gap": "/groundtrace/gaps",
    "Note": "/groundtrace/notes",
}


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


def _column(data: bytes, dtype: str, shape: tuple[int, ...], place: str) -> NDArray[Any]:
    expected = prod(shape) * np.dtype(dtype).itemsize
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


def decode_event(name: str, data: bytes | memoryview, place: str) -> SingleEvent:
    """Decode a single event; ``name`` is its message's.

    Raises
    ------
    SchemaError
        Where the bytes are not one.
    """
    m = parse(message_class(name), data, place)
    time_ns = get_time(m.timestamp, place)
    match name:
        case "Pick":
            # one text for all picks of a channel: an hour has a hundred thousand
            channel, topic, stage = map(intern, (m.channel, m.topic, m.stage))
            return Pick(time_ns, channel, topic, stage, m.uncertainty_s, m.value)
        case "StepEvent":
            return StepEvent(time_ns, m.kind, m.foot, m.topic, m.stage, m.value, m.channels, m.type)
        case "Fix":
            known = _covariance(m, place)
            said = (m.residual, intern(m.method), m.picks, intern(m.stage))
            return Fix(time_ns, m.x_m, m.y_m, known, *said)
        case "TrackPoint":
            state = (m.x_m, m.y_m, m.vx_mps, m.vy_mps)
            return TrackPoint(time_ns, m.track, *state, _covariance(m, place), m.stage, m.nis)
        case "Heading":
            return Heading(time_ns, m.heading_rad, m.sigma_rad, m.stage)
        case "Disturbance":
            return Disturbance(time_ns, get_time(m.end, place), m.value, m.stage)
        case "Bearing":
            direction = (m.azimuth_rad, m.sigma_rad, m.value, m.ambiguous)
            return Bearing(time_ns, m.station, *direction, m.stage)
        case "Disagreement":
            return Disagreement(time_ns, m.distance_m, m.value, m.methods, m.stage)
        case "Gap":
            return Gap(m.topic, time_ns, get_time(m.end, place), m.reason, m.lost, m.bridged)
        case "Presence" | "Pass" | "LineCrossing" | "LikelihoodSurface":
            end_ns = get_time(m.end, place) if name == "Presence" else time_ns
            return traffic_event(name, m, time_ns, end_ns, place)
    return Note(time_ns, m.text, m.level, m.source)


def _covariance(message: Any, place: str) -> tuple[float, float, float]:
    found = tuple(message.covariance)
    if len(found) != 3:
        raise SchemaError(f"{place}: covariance: expected 3 numbers, found {len(found)}")
    return found


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
    place = f"{file.name}: {channel.topic}"
    if package != "groundtrace" or (only is not None and name not in only):
        return None
    if name in {"CandidateBlock", "TraceBlock"}:
        spec = spec_from_json(channel.metadata.get(SPEC_KEY, ""), place)
        decode = decode_candidates if name == "CandidateBlock" else decode_trace
        return spec, lambda data: decode(data, spec, place)
    if name in TOPICS:
        return None, lambda data: decode_event(name, data, place)
    return None
