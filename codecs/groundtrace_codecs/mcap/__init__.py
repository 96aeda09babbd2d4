"""MCAP recordings: reading them whatever their state, with every damaged part accounted for."""

from __future__ import annotations

from groundtrace_codecs.mcap.bytesource import ByteSource, FileBytes
from groundtrace_codecs.mcap.reader import McapFile
from groundtrace_codecs.mcap.records import (
    AttachmentRef,
    ChannelRecord,
    Damage,
    Message,
    MetadataRecord,
    Schema,
)
from groundtrace_codecs.mcap.table import MessageTable

__all__ = [
    "AttachmentRef",
    "ByteSource",
    "ChannelRecord",
    "Damage",
    "FileBytes",
    "McapFile",
    "Message",
    "MessageTable",
    "MetadataRecord",
    "Schema",
]
