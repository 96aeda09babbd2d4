"""Recordings as typed blocks and events: MCAP, message schemas, importers.

Knows nothing of replay. The types of signals, events, labels and geometry are here at once; what
reads and writes files loads at first use, so that importing the package stays cheap.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

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
from .signals import NS_PER_S, SEISMIC_QUANTITIES, Channel, SignalBlock, Stream

if TYPE_CHECKING:
    from .mcap.reader import McapFile
    from .recording import LoggedBlock, OtherTopic, Recording
    from .schemas.event_messages import events_of, labels_of
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

_LAZY = {
    "McapFile": "mcap.reader",
    "OtherTopic": "recording",
    "Recording": "recording",
    "RecordingWriter": "writer",
    "LoggedBlock": "recording",
    "events_of": "schemas.event_messages",
    "labels_of": "schemas.event_messages",
    "write_recording": "writer",
}


def __getattr__(name: str) -> Any:
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_LAZY[name]}", __name__), name)
