"""Events written as protobuf messages, each on the channel it goes to."""

from __future__ import annotations

from functools import cache
from operator import attrgetter
from typing import TYPE_CHECKING, Any

from .container import Output, Packet
from .description import SPEC_KEY
from .encoders import protobuf_output
from .event_codec import TIMES, candidates_topic, layout_of, spec_json, trace_topic
from .event_mirror import mirror
from .events import EVENTS, CandidateBlock, StageSpec, TraceBlock
from .schemas.protobuf import message_class, set_time

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from .events import Event

Encoded = tuple[Output, Packet | None]


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
        yield _encoder_of(type(event))(event)
        yield from mirror(event)


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


_ENCODERS: dict[type[Any], Callable[[Any], Encoded]] = {}


def _encoder_of(cls: type[Any]) -> Callable[[Any], Encoded]:
    """Return what encodes the events of a kind; made once."""
    if cls not in _ENCODERS:
        _ENCODERS[cls] = _made_encoder(cls)
    return _ENCODERS[cls]


def _made_encoder(cls: type[Any]) -> Callable[[Any], Encoded]:
    """Return what encodes the events of a kind: the message's fields are the event's own."""
    layout = layout_of(cls)
    output = protobuf_output(EVENTS[cls].topic, cls.__name__)
    own = tuple(n for n in layout.names if n not in TIMES)
    message_of, values_of = layout.message, attrgetter(*own, "time_ns")
    span = "end_ns" in layout.names

    def encode(event: Any) -> Encoded:
        values = values_of(event)
        message = message_of(**dict(zip(own, values, strict=False)))  # the time comes after them
        start_ns = last_ns = values[-1]
        if span:
            set_time(message.end, event.end_ns)
            last_ns = max(start_ns, event.end_ns)
        return output, _packet(message, start_ns, last_ns)

    return encode
