"""Events written as protobuf messages, each on the channel it goes to."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

from .container import Output, Packet
from .description import SPEC_KEY
from .encoders import protobuf_output
from .event_codec import TOPICS, candidates_topic, spec_json, trace_topic
from .event_mirror import mirror
from .events import CandidateBlock, Disturbance, Gap, Presence, StageSpec, TraceBlock
from .schemas.protobuf import message_class, set_time

if TYPE_CHECKING:
    from collections.abc import Iterator

    from .events import Event, SingleEvent

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
        yield _single(event)
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


@cache
def _single_kind(name: str) -> tuple[Output, Any, tuple[str, ...]]:
    kind = message_class(name)
    own = tuple(f.name for f in kind.DESCRIPTOR.fields if f.name not in ("timestamp", "end"))
    return protobuf_output(TOPICS[name], name), kind, own


def _single(event: SingleEvent) -> Encoded:
    """Encode a single event: the message's fields are the event's, but for its times."""
    output, kind, names = _single_kind(type(event).__name__)
    message = kind(**{name: getattr(event, name) for name in names})
    start_ns = end_ns = event.start_ns if isinstance(event, Gap) else event.time_ns
    if isinstance(event, Gap | Disturbance | Presence):
        set_time(message.end, event.end_ns)
        end_ns = max(start_ns, event.end_ns)
    return output, _packet(message, start_ns, end_ns)
