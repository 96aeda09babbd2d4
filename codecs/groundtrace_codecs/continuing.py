"""Going on with a file of events whose writing was broken off: how far it was whole, and the rest.

What a container holds can be told while it grows, and taken over into another one later: messages
with their bytes, times and channels, up to that place and nothing after it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from .errors import CodecError, FormatError
from .mcap import FileBytes, McapFile
from .site import TRANSFORM_TOPIC

if TYPE_CHECKING:
    from pathlib import Path

    from .container import Output
    from .writer import RecordingWriter


@dataclass(frozen=True, slots=True)
class Settled:
    """How much of a growing file is whole.

    Attributes
    ----------
    name
        Of the file while it grew.
    length
        Its first bytes that are whole.
    messages
        How many messages are in them.
    outputs
        Channels registered so far, in the order of their ids.
    """

    name: str
    length: int
    messages: int
    outputs: tuple[Output, ...]


def settle(writer: RecordingWriter) -> Settled:
    """End the chunks in progress and say what of the file is whole from now on.

    Raises
    ------
    CodecError
        Where there is no room.
    """
    container = writer.container
    length = container.settle()
    return Settled(container.growing.name, length, container.messages, container.outputs)


def take_over(writer: RecordingWriter, settled: Settled, path: Path) -> None:
    """Write what a settled file holds, beyond what ``writer`` wrote already: its first channels.

    Parameters
    ----------
    writer
        Has written the same labels and annotations as the file that was settled, and nothing else.
    settled
        What was told of that file.
    path
        Where it is now.

    Raises
    ------
    CodecError
        Where the file does not hold what was told.
    """
    container = writer.container
    before = set(container.outputs)
    ids = {i: container.channel(output) for i, output in enumerate(settled.outputs, 1)}
    wanted = [i for i, output in enumerate(settled.outputs, 1) if output not in before]
    with _beginning(path, settled.length) as file:
        known = {i: file.channels[i].topic for i in wanted if i in file.channels}
        if any(topic != settled.outputs[i - 1].topic for i, topic in known.items()):
            raise CodecError(f"{path}: expected the channels that were written, found others")
        for message in file.messages(known):
            if known[message.channel_id] == TRANSFORM_TOPIC:
                writer.begin(message.log_time)  # the site goes with it
            else:
                container.copy(ids[message.channel_id], message)
    if container.messages != settled.messages:
        raise CodecError(
            f"{path}: expected {settled.messages} messages in the first {settled.length} bytes, "
            f"found {container.messages}"
        )


def _beginning(path: Path, length: int) -> McapFile:
    """Open the first bytes of a file as a file that ends there."""
    try:
        source = FileBytes(path)
    except OSError as error:
        raise CodecError(f"{path}: expected what was written, found: {error.strerror}") from error
    if source.size < length:
        source.close()
        raise FormatError(f"{path}: expected {length} bytes or more, found {source.size}")
    source.size = length
    return McapFile.open(source)
