"""Topics that carry no known signal: listed, and left alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from .errors import SchemaError
from .schemas.protobuf import field_names
from .schemas.ros2msg import parse_ros2msg

if TYPE_CHECKING:
    from .mcap import ChannelRecord, McapFile


@dataclass(frozen=True, slots=True)
class OtherTopic:
    """A topic that carries no known signal and is left alone.

    Attributes
    ----------
    topic, schema, encoding
        Of the channel; ``encoding`` is that of its messages.
    messages
        How many there are.
    fields
        Names of the message's own fields, where its schema can be read.
    """

    topic: str
    schema: str
    encoding: str
    messages: int
    fields: tuple[str, ...] = ()


def is_ours(file: McapFile, channel: ChannelRecord) -> bool:
    """Tell whether groundtrace wrote a channel: an event, a preview, a mirror."""
    schema = file.schemas.get(channel.schema_id)
    if schema is not None and schema.name.startswith("groundtrace."):
        return True
    return any(key.startswith("groundtrace.") for key in channel.metadata)


def other_topic(file: McapFile, channel: ChannelRecord) -> OtherTopic:
    """Describe a channel that is left alone."""
    schema = file.schemas.get(channel.schema_id)
    count = file.message_counts.get(channel.id, 0)
    if schema is None:
        return OtherTopic(channel.topic, "", channel.message_encoding, count)
    fields: tuple[str, ...] = ()
    if schema.encoding == "protobuf":
        fields = field_names(schema.data, schema.name)
    elif schema.encoding == "ros2msg":
        try:
            text = schema.data.decode("utf-8", "replace")
            fields = tuple(f.name for f in parse_ros2msg(schema.name, text).fields)
        except SchemaError:
            fields = ()
    return OtherTopic(channel.topic, schema.name, channel.message_encoding, count, fields)
