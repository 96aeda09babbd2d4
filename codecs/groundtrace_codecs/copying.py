"""Copies of an MCAP file, every message byte by byte: with annotations inside, or mended."""

from __future__ import annotations

import heapq
from typing import TYPE_CHECKING

from .annotations import ANNOTATIONS_TOPIC, encode_annotation, in_order
from .container import Container, Packet
from .encoders import protobuf_output
from .errors import CodecError, FormatError
from .label_codec import label_channels
from .mcap import McapFile
from .signals import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator
    from pathlib import Path

    from .annotations import Annotation
    from .mcap import Message

    #: Told how much is done, and of how much.
    Progress = Callable[[float, float], None]


def copy_with_annotations(source: Path, path: Path, annotations: Iterable[Annotation]) -> int:
    """Copy a recording and put annotations inside, instead of those it has.

    Messages keep their bytes, times, sequence numbers and channels; attachments and metadata are
    copied. An existing file is replaced.

    Parameters
    ----------
    source
        The recording.
    path
        The copy.
    annotations
        What goes inside.

    Returns
    -------
    int
        Number of damaged places of the recording, which are not in the copy.

    Raises
    ------
    CodecError
        Where the recording cannot be read or the copy not be written.
    """
    try:
        file = McapFile.open(source)
    except OSError as error:
        raise CodecError(f"{source}: expected a recording, found: {error.strerror}") from error
    try:
        container = Container(path, "zstd", force=True)
        complete = False
        try:
            _copy(file, container, in_order(annotations))
            complete = True
        finally:
            container.close(complete=complete)
        return len(file.damage)
    finally:
        file.close()


def _copy(file: McapFile, container: Container, annotations: tuple[Annotation, ...]) -> None:
    replaced = label_channels(file, ANNOTATIONS_TOPIC)
    ids = copy_frame(file, container, file.channels.keys() - replaced)
    output = protobuf_output(ANNOTATIONS_TOPIC, "Label")
    container.channel(output)
    for item in _together(file.messages(ids), annotations):
        if isinstance(item, Packet):
            container.send(output, item)
        else:
            container.copy(ids[item.channel_id], item)


def copy_frame(
    file: McapFile,
    container: Container,
    channel_ids: Collection[int],
    faults: list[str] | None = None,
) -> dict[int, int]:
    """Copy what is no message: some channels with their schemas, all attachments and metadata.

    Parameters
    ----------
    file, container
        From where and to where.
    channel_ids
        Channels to copy.
    faults
        Where given, a damaged attachment is left out, and what is wrong with it is added here.

    Returns
    -------
    dict
        The id of each channel in the container, by its id in the file.

    Raises
    ------
    FormatError
        Where an attachment is damaged and there are no ``faults`` to add it to.
    """
    chosen = [file.channels[i] for i in sorted(channel_ids)]
    ids = {c.id: container.copy_channel(c, file.schemas.get(c.schema_id)) for c in chosen}
    for ref in file.attachments:
        try:
            data = file.attachment(ref)
        except FormatError as error:
            if faults is None:
                raise
            faults.append(str(error))
            continue
        container.add_attachment(ref.log_time, ref.name, ref.media_type, data, ref.create_time)
    for record in file.metadata:
        container.add_metadata(record.name, record.values)
    return ids


def copy_readable(
    file: McapFile, path: Path, *, force: bool = False, progress: Progress | None = None
) -> tuple[int, list[str]]:
    """Copy everything of a file that can be read into a sound one.

    Messages keep their bytes, times and sequence numbers; schemas, channels, attachments, metadata
    and the profile are copied.

    Parameters
    ----------
    file
        Damaged or not.
    path
        The copy.
    force
        Replace an existing file.
    progress
        Told now and then how much of the file is copied, and of how much [s].

    Returns
    -------
    int
        Number of messages.
    list of str
        What is wrong with attachments that were left out.

    Raises
    ------
    CodecError
        Where the copy cannot be written.
    """
    # NAME.partial may be the very file that is mended
    container = Container(path, "zstd", force=force, profile=file.profile, ending="mending")
    count, complete, faults = 0, False, list[str]()
    try:
        for _, schema in sorted(file.schemas.items()):
            container.copy_schema(schema)
        ids = copy_frame(file, container, file.channels.keys(), faults)
        for message in passing(file, progress):
            container.copy(ids[message.channel_id], message)
            count += 1
        complete = True
    finally:
        container.close(complete=complete)
    return count, faults


def passing(file: McapFile, progress: Progress | None) -> Iterator[Message]:
    """Yield all messages of a file; tell now and then how much of it has passed [s]."""
    length_s = max(0, file.end_ns - file.start_ns) / NS_PER_S
    for number, message in enumerate(file.messages()):
        yield message
        if progress is not None and not number % 1000:
            progress((message.log_time - file.start_ns) / NS_PER_S, length_s)


def _together(
    messages: Iterator[Message], annotations: Iterable[Annotation]
) -> Iterator[Message | Packet]:
    """Yield messages and annotations by log time."""
    marks = (Packet(a.label.time_ns, a.label.time_ns, 0, encode_annotation(a)) for a in annotations)
    queues: tuple[Iterator[tuple[int, Message | Packet]], ...] = (
        ((m.log_time, m) for m in messages),
        ((p.log_ns, p) for p in marks),
    )
    for _, item in heapq.merge(*queues, key=lambda entry: entry[0]):
        yield item
