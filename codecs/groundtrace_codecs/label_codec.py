"""Labels as ``groundtrace.Label`` messages."""

from __future__ import annotations

from sys import intern
from typing import TYPE_CHECKING, Any

from .labels import Label
from .schemas.protobuf import get_time, message_class, parse, set_time

if TYPE_CHECKING:
    from .mcap import McapFile

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


def decode_label(data: bytes | memoryview, place: str = "Label") -> Label:
    """Decode one label.

    Raises
    ------
    SchemaError
        Where the bytes are not a label; names ``place``.
    """
    message = parse(message_class("Label"), data, place)
    # one text for all labels that say the same: an hour of picks has thousands
    fields: dict[str, Any] = {name: intern(getattr(message, name)) for name in _TEXTS}
    fields |= {name: getattr(message, name) for name in _NUMBERS if message.HasField(name)}
    if message.HasField("end"):
        fields["end_ns"] = get_time(message.end, place)
    return Label(get_time(message.timestamp, place), intern(message.kind), **fields)


def label_channels(file: McapFile, topic: str) -> set[int]:
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
    place = f"{file.name}: {topic}"
    return tuple(decode_label(m.data, place) for m in file.messages(wanted))
