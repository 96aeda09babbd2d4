"""The mirror of events in words, as the ``foxglove.Log`` that every other viewer shows."""

from __future__ import annotations

import math
from functools import cache
from typing import TYPE_CHECKING

from .container import Output, Packet
from .description import ROLE_KEY
from .events import (
    Bearing,
    Disagreement,
    Disturbance,
    Fix,
    Gap,
    Heading,
    LikelihoodSurface,
    LineCrossing,
    Note,
    Pass,
    Pick,
    Presence,
    StepEvent,
    TrackPoint,
)
from .schemas.protobuf import descriptor_set, set_time
from .signals import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator

    from .events import SingleEvent

LOG_TOPIC = "/groundtrace/log"
LEVELS = {"DEBUG": "DEBUG", "INFO": "INFO", "WARN": "WARNING", "ERROR": "ERROR"}


def mirror(event: SingleEvent) -> Iterator[tuple[Output, Packet]]:
    """Yield an event's line in the log.

    Track points, headings and surfaces have none: they are curves and images, and would bury what
    there is to read.
    """
    from foxglove_schemas_protobuf.Log_pb2 import Log

    if isinstance(event, TrackPoint | Heading | LikelihoodSurface):
        return
    level, source, text, time_ns = _line(event)
    message = Log(level=Log.Level.Value(level), message=text, name=source)
    set_time(message.timestamp, time_ns)
    yield _log_output(), Packet(time_ns, time_ns, 0, message.SerializeToString())


@cache
def _log_output() -> Output:
    from foxglove_schemas_protobuf.Log_pb2 import Log

    content = descriptor_set(Log)
    role = ((ROLE_KEY, "mirror"),)
    return Output(LOG_TOPIC, "foxglove.Log", "protobuf", content, "protobuf", role)


def _line(
    event: Pick
    | StepEvent
    | Fix
    | Disturbance
    | Bearing
    | Disagreement
    | Presence
    | Pass
    | LineCrossing
    | Gap
    | Note,
) -> tuple[str, str, str, int]:
    """Return level, source, text and time of an event's line in the log."""
    match event:
        case Pick():
            text = f"pick {event.channel} value={event.value:.4g}"
        case StepEvent():
            kind = " ".join(filter(None, (event.kind, event.type, event.foot)))
            text = f"{kind} value={event.value:.4g} channels={event.channels}"
        case Fix():
            text = f"fix x={event.x_m:.3f} m y={event.y_m:.3f} m {event.method} picks={event.picks}"
        case Bearing():
            text = f"bearing {event.station} {math.degrees(event.azimuth_rad):.1f} degrees"
        case Disagreement():
            text = f"{event.methods} are {event.distance_m:.3g} m apart, {event.value:.3g} sigma"
        case Pass():
            which = f"vehicle {event.vehicle} {event.direction} " if event.vehicle else ""
            text = f"{which}passes {event.station} speed={event.speed_mps:.3g} m/s"
        case LineCrossing():
            text = f"vehicle {event.track} crosses {event.line} at {event.x_m:.2f}, {event.y_m:.2f}"
        case Presence():
            seconds = (event.end_ns - event.time_ns) / NS_PER_S
            text = f"vehicle heard at {event.channel} for {seconds:.6g} s value={event.value:.4g}"
            return "INFO", event.stage, text, max(event.time_ns, event.end_ns)
        case Disturbance():
            seconds = (event.end_ns - event.time_ns) / NS_PER_S
            text = f"disturbed for {seconds:.6g} s value={event.value:.4g}"
            return "INFO", event.stage, text, max(event.time_ns, event.end_ns)
        case Gap():
            seconds = (event.end_ns - event.start_ns) / NS_PER_S
            text = f"gap {event.topic} {event.reason}: {event.lost} lost in {seconds:.6g} s"
            return "WARNING", "source", text, max(event.start_ns, event.end_ns)
        case Note():
            level = LEVELS.get(event.level, "INFO")
            return level, event.source, event.text, event.time_ns
    return "INFO", event.stage, text, event.time_ns
