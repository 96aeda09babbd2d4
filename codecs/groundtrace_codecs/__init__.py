"""Recordings as typed blocks and events: MCAP, message schemas, importers.

Knows nothing of replay. Each name loads at first use, so that importing the package is cheap.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .errors import CodecError, FormatError, MissingReaderError, SchemaError
    from .events import (
        TRUTH_KINDS,
        Bearing,
        CandidateBlock,
        Disagreement,
        Disturbance,
        Event,
        Fix,
        Gap,
        GateSpec,
        Heading,
        Label,
        LikelihoodSurface,
        LineCrossing,
        Note,
        Pass,
        Pick,
        Presence,
        Quantity,
        StageSpec,
        StepEvent,
        TraceBlock,
        TrackPoint,
    )
    from .geometry import Geometry, Medium, Sensor
    from .mcap.reader import McapFile
    from .recording import LoggedBlock, OtherTopic, Recording
    from .schemas.event_messages import events_of, labels_of
    from .signals import NS_PER_S, SEISMIC_QUANTITIES, Channel, SignalBlock, Stream
    from .writer import RecordingWriter, write_recording

__all__ = [
    "NS_PER_S",
    "SEISMIC_QUANTITIES",
    "TRUTH_KINDS",
    "Bearing",
    "CandidateBlock",
    "Channel",
    "CodecError",
    "Disagreement",
    "Disturbance",
    "Event",
    "Fix",
    "FormatError",
    "Gap",
    "GateSpec",
    "Geometry",
    "Heading",
    "Label",
    "LikelihoodSurface",
    "LineCrossing",
    "LoggedBlock",
    "McapFile",
    "Medium",
    "MissingReaderError",
    "Note",
    "OtherTopic",
    "Pass",
    "Pick",
    "Presence",
    "Quantity",
    "Recording",
    "RecordingWriter",
    "SchemaError",
    "Sensor",
    "SignalBlock",
    "StageSpec",
    "StepEvent",
    "Stream",
    "TraceBlock",
    "TrackPoint",
    "events_of",
    "labels_of",
    "write_recording",
]

#: Module of each.
_LAZY = {
    "NS_PER_S": "signals",
    "SEISMIC_QUANTITIES": "signals",
    "TRUTH_KINDS": "events",
    "Bearing": "events",
    "CandidateBlock": "events",
    "Channel": "signals",
    "CodecError": "errors",
    "Disagreement": "events",
    "Disturbance": "events",
    "Event": "events",
    "Fix": "events",
    "FormatError": "errors",
    "Gap": "events",
    "GateSpec": "events",
    "Geometry": "geometry",
    "Heading": "events",
    "Label": "events",
    "LikelihoodSurface": "events",
    "LineCrossing": "events",
    "LoggedBlock": "recording",
    "McapFile": "mcap.reader",
    "Medium": "geometry",
    "MissingReaderError": "errors",
    "Note": "events",
    "OtherTopic": "recording",
    "Pass": "events",
    "Pick": "events",
    "Presence": "events",
    "Quantity": "events",
    "Recording": "recording",
    "RecordingWriter": "writer",
    "SchemaError": "errors",
    "Sensor": "geometry",
    "SignalBlock": "signals",
    "StageSpec": "events",
    "StepEvent": "events",
    "Stream": "signals",
    "TraceBlock": "events",
    "TrackPoint": "events",
    "events_of": "schemas.event_messages",
    "labels_of": "schemas.event_messages",
    "write_recording": "writer",
}


def __getattr__(name: str) -> Any:
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_LAZY[name]}", __name__), name)
