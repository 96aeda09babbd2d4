"""A copy of an MCAP file, every message byte by byte, with annotations inside."""

from __future__ import annotations

import heapq
from typing import TYPE_CHECKING

from .annotations import ANNOTATIONS_TOPIC, encode_annotation, in_order
from .container import Container
from .encoders import Packet, protobuf_output
from .errors import CodecError
from .label_codec import label_channels
from .mcap import McapFile

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    from .annotations import Annotation
    from .mcap import Message


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
    kept = [c for c in sorted(file.channels.values(), key=lambda c: c.id) if c.id not in replaced]
    ids = {c.id: container.copy_channel(c, file.schemas.get(c.schema_id)) for c in kept}
    output = protobuf_output(ANNOTATIONS_TOPIC, "Label")
    container.channel(output)
    for ref in file.attachments:
        container.add_attachment(ref.log_time, ref.name, ref.media_type, file.attachment(ref))
    for record in file.metadata:
        container.add_metadata(record.name, record.values)
    for item in _together(file.messages(ids), annotations):
        if isinstance(item, Packet):
            container.send(output, item)
        else:
            container.copy(ids[item.channel_id], item)


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
