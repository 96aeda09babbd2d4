"""The mirror of events in words, as the ``foxglove.Log`` that every other viewer shows."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

from .container import Output, Packet
from .description import ROLE_KEY
from .events import EVENTS
from .schemas.protobuf import descriptor_set, set_time

if TYPE_CHECKING:
    from collections.abc import Iterator

    from .events import SingleEvent

LOG_TOPIC = "/groundtrace/log"
LEVELS = {"DEBUG": "DEBUG", "INFO": "INFO", "WARN": "WARNING", "ERROR": "ERROR"}


def mirror(event: SingleEvent) -> Iterator[tuple[Output, Packet]]:
    """Yield an event's line in the log, where its kind has one; spans are told when they end."""
    from foxglove_schemas_protobuf.Log_pb2 import Log

    text = EVENTS[type(event)].text(event)
    if not text:
        return
    level = LEVELS.get(getattr(event, "level", ""), "INFO")
    source = getattr(event, "stage", "") or getattr(event, "source", "")
    start_ns = event.time_ns
    time_ns = max(start_ns, getattr(event, "end_ns", start_ns))
    message = Log(level=Log.Level.Value(level), message=text, name=source)
    set_time(message.timestamp, time_ns)
    yield _log_output(), Packet(time_ns, time_ns, 0, message.SerializeToString())


@cache
def _log_output() -> Output:
    from foxglove_schemas_protobuf.Log_pb2 import Log

    content = descriptor_set(Log)
    role = ((ROLE_KEY, "mirror"),)
    return Output(LOG_TOPIC, "foxglove.Log", "protobuf", content, "protobuf", role)
