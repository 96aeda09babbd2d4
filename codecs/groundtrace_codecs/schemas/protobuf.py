"""Protobuf messages of groundtrace, built from the committed descriptors.

All classes live in the default descriptor pool, so that one ``Timestamp`` serves them and the
generated Foxglove classes alike.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError

from ..errors import SchemaError
from ..signals import NS_PER_S

if TYPE_CHECKING:
    from google.protobuf.descriptor import FileDescriptor

PACKAGE = "groundtrace"
_INT64_LIMIT = 1 << 63


@cache
def _pool() -> Any:
    """Return the default pool, with the committed descriptors added."""
    pool = descriptor_pool.Default()
    content = Path(__file__).with_name("groundtrace.desc").read_bytes()
    for file in descriptor_pb2.FileDescriptorSet.FromString(content).file:
        if file.package == PACKAGE:
            pool.AddSerializedFile(file.SerializeToString())
    return pool


@cache
def message_class(name: str) -> Any:
    """Return the class of a groundtrace message, e.g. ``WaveformBlock``."""
    # Importing the generated module is what puts timestamp.proto into the default pool.
    from google.protobuf import timestamp_pb2  # noqa: F401

    return message_factory.GetMessageClass(_pool().FindMessageTypeByName(f"{PACKAGE}.{name}"))


def descriptor_set(message: Any) -> bytes:
    """Return the serialised FileDescriptorSet of a message class and all it depends on.

    This is the content of an MCAP schema with encoding ``protobuf``.
    """
    collected = descriptor_pb2.FileDescriptorSet()
    seen: set[str] = set()

    def add(file: FileDescriptor) -> None:
        if file.name in seen:
            return
        seen.add(file.name)
        for dependency in file.dependencies:
            add(dependency)
        file.CopyToProto(collected.file.add())

    add(message.DESCRIPTOR.file)
    return collected.SerializeToString(deterministic=True)


@cache
def schema_bytes(name: str = "WaveformBlock") -> bytes:
    """Return the MCAP schema content of a groundtrace message: all messages of its file."""
    return descriptor_set(message_class(name))


def parse(message: Any, data: bytes | memoryview, where: str) -> Any:
    """Decode one protobuf message.

    Raises
    ------
    SchemaError
        Where the bytes are not such a message; names ``where``.
    """
    try:
        return message.FromString(data)
    except DecodeError as error:
        raise unreadable(message, where, error) from error


def unreadable(message: Any, where: str, error: DecodeError) -> SchemaError:
    """Return the error of bytes that are no such message."""
    return SchemaError(f"{where}: expected a {message.DESCRIPTOR.full_name}, found: {error}")


def set_time(stamp: Any, time_ns: int) -> None:
    """Write a time [ns] into a ``google.protobuf.Timestamp``."""
    stamp.seconds, stamp.nanos = divmod(int(time_ns), NS_PER_S)


def get_time(stamp: Any, where: str) -> int:
    """Return the time [ns] of a ``google.protobuf.Timestamp``.

    Raises
    ------
    SchemaError
        Where it does not fit an int64 of nanoseconds.
    """
    time_ns: int = stamp.seconds * NS_PER_S + stamp.nanos
    if not -_INT64_LIMIT <= time_ns < _INT64_LIMIT:
        raise SchemaError(f"{where}: expected a time within int64 nanoseconds, found {time_ns}")
    return time_ns


def field_names(schema: bytes, message_name: str) -> tuple[str, ...]:
    """Return the top-level field names of a message in a FileDescriptorSet; empty if unreadable."""
    try:
        files_of_schema = descriptor_pb2.FileDescriptorSet.FromString(schema).file
    except DecodeError:
        return ()
    for file in files_of_schema:
        prefix = f"{file.package}." if file.package else ""
        for message in file.message_type:
            # Names that are not UTF-8 come out as bytes.
            if f"{prefix}{message.name}" == message_name:
                return tuple(str(field.name) for field in message.field)
    return ()
