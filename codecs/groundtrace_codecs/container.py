"""The MCAP file being written: channels, messages, and how it gets its name."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, NamedTuple

from .description import PREVIEW_KEY
from .errors import CodecError, NoRoomError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from .mcap import ChannelRecord, Message, Schema

TOOL = "groundtrace"
#: Length at which a chunk is ended, before compression [bytes].
CHUNK_BYTES = 1 << 20
_COMPRESSIONS = ("zstd", "lz4", "none")
# Kinds of content, which get chunks of their own, and their levels of zstd. Samples are noise for
# the most part: a higher level takes longer and finds nothing more in them.
_OTHERS, _WAVEFORMS, _PREVIEWS = range(3)
_LEVELS = (3, 1, 3)


def tool_version() -> str:
    """Return the installed version of groundtrace; ``0`` where it runs from a bare checkout."""
    with suppress(PackageNotFoundError):
        return version(TOOL)
    return "0"


@dataclass(frozen=True, slots=True)
class Output:
    """An MCAP channel to be written: topic, message type and metadata."""

    topic: str
    schema: str
    schema_encoding: str
    schema_data: bytes = field(repr=False)
    encoding: str
    metadata: tuple[tuple[str, str], ...] = ()


class Packet(NamedTuple):
    """One message to be written; times in ns."""

    log_ns: int
    publish_ns: int
    sequence: int
    data: bytes


class _Growing:
    """The partial file; a disk that is full, or a limit that is reached, is a CodecError.

    Attributes
    ----------
    failed
        True once a write failed: what follows would not fit to what is there.
    """

    def __init__(self, partial: Path, path: Path) -> None:
        self._partial, self._path = partial, path
        self.failed = False
        try:
            self._file = partial.open("wb")
        except OSError as error:
            raise CodecError(
                f"{path}: expected a place to write, found: {error.strerror}"
            ) from error

    def write(self, data: bytes) -> int:
        try:
            return self._file.write(data)
        except OSError as error:
            raise self._full(error) from error

    def tell(self) -> int:
        return self._file.tell()

    def flush(self) -> None:
        try:
            self._file.flush()
        except OSError as error:
            raise self._full(error) from error

    def close(self) -> None:
        try:
            self._file.close()
        except OSError as error:
            # said already, where an earlier write failed
            if not self.failed:
                raise self._full(error) from error

    def _full(self, error: OSError) -> CodecError:
        self.failed = True
        kept = f"; what was written stays: groundtrace doctor {self._partial} --repair {self._path}"
        return NoRoomError(self._path, error.strerror, kept)


class Container:
    """An MCAP file that grows as ``NAME.partial``, or with another ending.

    Parameters
    ----------
    path
        Its name in the end.
    compression
        ``zstd``, ``lz4`` or ``none``.
    force
        Replace an existing file.
    chunk_bytes
        Length at which a chunk is ended, before compression.
    profile
        Of the Header record.
    ending
        What the file's name ends in while it grows.

    Raises
    ------
    CodecError
        Where the file exists already and ``force`` is not given, or cannot be written.
    """

    def __init__(
        self,
        path: Path,
        compression: str,
        force: bool,
        chunk_bytes: int = CHUNK_BYTES,
        profile: str = "",
        ending: str = "partial",
    ) -> None:
        from .mcap.writing import McapWriter

        self.path = path
        self._partial = path.with_name(f"{path.name}.{ending}")
        if path.exists() and not force:
            raise CodecError(f"{path}: expected a new file, found an existing one")
        if compression not in _COMPRESSIONS:
            known = ", ".join(_COMPRESSIONS)
            raise CodecError(f"{path}: compression: expected one of {known}, found {compression!r}")
        self._file = _Growing(self._partial, path)
        library = f"{TOOL} {tool_version()}"
        self._mcap = McapWriter(self._file, compression, _LEVELS, chunk_bytes, profile, library)
        self._schemas: dict[tuple[str, str, bytes], int] = {}
        self._channels: dict[Output, int] = {}

    def channel(self, output: Output) -> int:
        """Return the id of a channel, registered at its first use."""
        channel_id = self._channels.get(output)
        if channel_id is None:
            schema_id = self._schema(output.schema, output.schema_encoding, output.schema_data)
            metadata = dict(output.metadata)
            kind = _kind(output.schema, metadata)
            channel_id = self._mcap.add_channel(
                output.topic, output.encoding, schema_id, metadata, kind
            )
            self._channels[output] = channel_id
        return channel_id

    def flush(self) -> None:
        """End the chunks in progress."""
        self._mcap.flush()

    def send(self, output: Output, packet: Packet) -> None:
        """Write one message.

        Raises
        ------
        CodecError
            Where one of its times is negative, which MCAP cannot hold.
        """
        earliest = min(packet.publish_ns, packet.log_ns)
        if earliest < 0:
            raise CodecError(
                f"{self.path}: {output.topic}: expected times >= 0, found {earliest} ns"
            )
        self._mcap.add_message(
            self.channel(output), packet.log_ns, packet.data, packet.publish_ns, packet.sequence
        )

    def copy_channel(self, channel: ChannelRecord, schema: Schema | None) -> int:
        """Register a channel of another file, and return its id in this one."""
        schema_id = 0 if schema is None else self.copy_schema(schema)
        kind = _kind("" if schema is None else schema.name, channel.metadata)
        return self._mcap.add_channel(
            channel.topic, channel.message_encoding, schema_id, channel.metadata, kind
        )

    def copy_schema(self, schema: Schema) -> int:
        """Register a schema of another file, and return its id in this one."""
        return self._schema(schema.name, schema.encoding, bytes(schema.data))

    def _schema(self, name: str, encoding: str, data: bytes) -> int:
        key = (name, encoding, data)
        if key not in self._schemas:
            self._schemas[key] = self._mcap.add_schema(name, encoding, data)
        return self._schemas[key]

    def copy(self, channel_id: int, message: Message) -> None:
        """Write a message of another file on a channel of this one, as it is."""
        self._mcap.add_message(
            channel_id,
            message.log_time,
            message.data,
            message.publish_time,
            message.sequence,
        )

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a Metadata record."""
        self._mcap.add_metadata(name, values)

    def add_attachment(
        self, time_ns: int, name: str, media_type: str, data: bytes, created_ns: int | None = None
    ) -> None:
        """Write an attachment; without a time of its own it was made when it was recorded."""
        made_ns = time_ns if created_ns is None else created_ns
        self._mcap.add_attachment(made_ns, time_ns, name, media_type, data)

    def close(self, *, complete: bool) -> None:
        """Write the summary; give the file its name only if it is complete."""
        try:
            if not self._file.failed:
                self._mcap.finish()
        finally:
            self._file.close()
        if complete:
            self._partial.replace(self.path)


def _kind(schema: str, metadata: Mapping[str, str]) -> int:
    """Return the kind of content of a channel, by its message type and metadata."""
    if schema == "groundtrace.WaveformBlock":
        return _WAVEFORMS
    return _PREVIEWS if PREVIEW_KEY in metadata else _OTHERS
