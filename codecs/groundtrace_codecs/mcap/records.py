"""Records of the MCAP format: the values they carry and how their bytes are read.

A record is ``u8 opcode, u64 length, content``, little-endian (MCAP specification, "Records"). A
known record may carry bytes after the fields known here; they are left unread.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, NamedTuple

if TYPE_CHECKING:
    from groundtrace_codecs.mcap.bytesource import ByteSource

MAGIC: Final = b"\x89MCAP0\r\n"

HEADER: Final = 0x01
FOOTER: Final = 0x02
SCHEMA: Final = 0x03
CHANNEL: Final = 0x04
MESSAGE: Final = 0x05
CHUNK: Final = 0x06
MESSAGE_INDEX: Final = 0x07
CHUNK_INDEX: Final = 0x08
ATTACHMENT: Final = 0x09
ATTACHMENT_INDEX: Final = 0x0A
STATISTICS: Final = 0x0B
METADATA: Final = 0x0C
METADATA_INDEX: Final = 0x0D
DATA_END: Final = 0x0F

#: Opcode and content length that open every record.
RECORD_HEAD: Final = struct.Struct("<BQ")
#: Shortest content of a Message record: its fields, without data.
MESSAGE_FIELDS: Final = 22
#: Larger records are never read whole: their length is taken for damage.
MAX_RECORD_BYTES: Final = 1 << 30

U16: Final = struct.Struct("<H")
U32: Final = struct.Struct("<I")
U64: Final = struct.Struct("<Q")
_U16_U16: Final = struct.Struct("<HH")
U64_U64: Final = struct.Struct("<QQ")


class MalformedError(Exception):
    """Bytes that are not the record they should be: "expected X, found Y".

    Inside this package only; callers see a `Damage` or a `FormatError`.
    """


@dataclass(frozen=True, slots=True)
class Schema:
    """How the messages of a channel are described.

    Attributes
    ----------
    id
        1 to 65535.
    name
        Name of the message type.
    encoding
        Of ``data``: ``protobuf``, ``ros2msg``, ``jsonschema``, ...
    data
        The description itself.
    """

    id: int
    name: str
    encoding: str
    data: bytes


@dataclass(frozen=True, slots=True)
class ChannelRecord:
    """A topic and the encoding of its messages.

    Attributes
    ----------
    id
        0 to 65535.
    topic
        Name of the stream.
    schema_id
        Of its `Schema`; 0 = none.
    message_encoding
        ``protobuf``, ``cdr``, ``json``, ...
    metadata
        Free text by key.
    """

    id: int
    topic: str
    schema_id: int
    message_encoding: str
    metadata: dict[str, str]


class Message(NamedTuple):
    """One message as recorded.

    Attributes
    ----------
    channel_id
        Of its `ChannelRecord`.
    sequence
        Counter of the writer, 0 where it keeps none.
    log_time
        When it was recorded, ns.
    publish_time
        When it was made, ns.
    data
        Payload; a view keeps the whole chunk it came from in memory.
    """

    channel_id: int
    sequence: int
    log_time: int
    publish_time: int
    data: bytes | memoryview


@dataclass(frozen=True, slots=True)
class AttachmentRef:
    """Where an attachment is and what it is called.

    Attributes
    ----------
    offset, length
        Of its record in the file, bytes, opcode and length field included.
    log_time, create_time
        When it was recorded and made, ns.
    size
        Of its content, bytes.
    name, media_type
        File name and MIME type.
    """

    offset: int
    length: int
    log_time: int
    create_time: int
    size: int
    name: str
    media_type: str


@dataclass(frozen=True, slots=True)
class MetadataRecord:
    """Named free text by key."""

    name: str
    values: dict[str, str]


@dataclass(frozen=True, slots=True)
class Damage:
    """A part of a file that was not read, or not as the file says it should be.

    Attributes
    ----------
    offset, length
        The bytes concerned.
    start_ns, end_ns
        First and last log time of the messages lost, where the file still tells; else None.
    messages
        Number of messages lost, where the file still tells; else None.
    reason
        "PLACE: expected X, found Y".
    """

    offset: int
    length: int
    start_ns: int | None
    end_ns: int | None
    messages: int | None
    reason: str


class Fields:
    """Reads the fields of one record's content in order, never past its end.

    Parameters
    ----------
    content
        The record without opcode and length.

    Raises
    ------
    MalformedError
        By every method, if the content is too short or its text is not UTF-8.
    """

    __slots__ = ("_content", "position")

    def __init__(self, content: memoryview) -> None:
        self._content = content
        self.position = 0

    def blob(self, length: int) -> memoryview:
        """Give the next ``length`` bytes."""
        start, self.position = self.position, self.position + length
        if self.position > len(self._content):
            raise MalformedError(
                f"expected {self.position} bytes of fields, found {len(self._content)}"
            )
        return self._content[start : self.position]

    def unpack(self, layout: struct.Struct) -> tuple[Any, ...]:
        """Give the numbers of ``layout``."""
        return layout.unpack(self.blob(layout.size))

    def text(self) -> str:
        """Give a string prefixed with its u32 length."""
        raw = self.blob(self.unpack(U32)[0])
        try:
            return str(raw, "utf-8")
        except UnicodeDecodeError as error:
            raise MalformedError(
                f"expected UTF-8 text, found byte 0x{raw[error.start]:02x}"
            ) from error

    def mapping(self) -> dict[str, str]:
        """Give a map of strings prefixed with its u32 length in bytes."""
        inner = Fields(self.blob(self.unpack(U32)[0]))
        values: dict[str, str] = {}
        while inner.position < len(inner._content):
            key = inner.text()
            values[key] = inner.text()
        return values


def parse_schema(content: memoryview) -> Schema:
    """Read a Schema record's content."""
    fields = Fields(content)
    (schema_id,) = fields.unpack(U16)
    name, encoding = fields.text(), fields.text()
    if schema_id == 0:
        raise MalformedError("expected a schema id from 1 to 65535, found 0")
    return Schema(schema_id, name, encoding, bytes(fields.blob(fields.unpack(U32)[0])))


def parse_channel(content: memoryview) -> ChannelRecord:
    """Read a Channel record's content."""
    fields = Fields(content)
    channel_id, schema_id = fields.unpack(_U16_U16)
    topic, encoding = fields.text(), fields.text()
    return ChannelRecord(channel_id, topic, schema_id, encoding, fields.mapping())


def parse_metadata(content: memoryview) -> MetadataRecord:
    """Read a Metadata record's content."""
    fields = Fields(content)
    return MetadataRecord(fields.text(), fields.mapping())


def parse_attachment(offset: int, length: int, fields: Fields) -> AttachmentRef:
    """Read the fields before an Attachment's data; leaves ``fields`` at the data."""
    log_time, create_time = fields.unpack(U64_U64)
    name, media_type = fields.text(), fields.text()
    (size,) = fields.unpack(U64)
    return AttachmentRef(offset, length, log_time, create_time, size, name, media_type)


def read_record(source: ByteSource, offset: int, opcode: int) -> memoryview:
    """Read the content of the record at ``offset``, which must be of kind ``opcode``.

    Raises
    ------
    MalformedError
        If there is another kind of record, or one that reaches past the end of the source.
    """
    head = source.read_at(offset, RECORD_HEAD.size)
    if len(head) < RECORD_HEAD.size:
        raise MalformedError(f"expected a record, found the end of the file at {source.size}")
    found, length = RECORD_HEAD.unpack(head)
    if found != opcode:
        raise MalformedError(f"expected opcode 0x{opcode:02x}, found 0x{found:02x}")
    start = offset + RECORD_HEAD.size
    room = min(source.size - start, MAX_RECORD_BYTES)
    if length > room:
        raise MalformedError(f"expected a record of at most {room} bytes, found length {length}")
    content = source.read_at(start, length)
    if len(content) < length:
        raise MalformedError(f"expected a record of {length} bytes, found {len(content)}")
    return memoryview(content)
