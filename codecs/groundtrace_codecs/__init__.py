"""Recordings as typed blocks and events: MCAP, message schemas, importers.

Knows nothing of replay. The types of signals, events, labels and geometry are here at once; what
reads and writes files loads at first use, so that importing the package stays cheap.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from .errors import CodecError, FormatError, MissingReaderError, SchemaError
from .events import (
    Bearing,
    CandidateBlock,
    Disagreement,
    Disturbance,
    Event,
    Fix,
    Gap,
    GateSpec,
    Heading,
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
from .labels import TRUTH_KINDS, Label
from .signals import NS_PER_S, SEISMIC_QUANTITIES, Channel, SignalBlock, Stream

if TYPE_CHECKING:
    from .channels import Stamped
    from .event_codec import events_of
    from .label_codec import labels_of
    from .mcap import McapFile
    from .others import OtherTopic
    from .recording import Recording
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
    "Stamped",
    "StepEvent",
    "Stream",
    "TraceBlock",
    "TrackPoint",
    "events_of",
    "labels_of",
    "write_recording",
]

_LAZY = {
    "McapFile": "mcap",
    "OtherTopic": "others",
    "Recording": "recording",
    "RecordingWriter": "writer",
    "Stamped": "channels",
    "events_of": "event_codec",
    "labels_of": "label_codec",
    "write_recording": "writer",
}


def __getattr__(name: str) -> Any:
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_LAZY[name]}", __name__), name)
