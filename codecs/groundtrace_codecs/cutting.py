"""A copy of a span of a recording: cut to the sample, everything else as it is."""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from typing import TYPE_CHECKING

from .channels import WaveformReader
from .container import Container
from .copying import copy_frame
from .errors import CodecError
from .label_codec import decode_label
from .mcap import MessageTable
from .others import is_ours
from .recording import SLACK_NS
from .rewriting import Copied, appearing, send_all
from .schemas.protobuf import message_class, parse, set_time
from .schemas.waveform import stored
from .site import TRANSFORM_TOPIC

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from .channels import ChannelReader
    from .lags import Lag
    from .mcap import Message
    from .recording import Recording
    from .signals import SignalBlock

#: Name of the metadata record that says what was cut out of what.
CUT = "groundtrace.cut"


@dataclass(frozen=True, slots=True)
class Span:
    """A half-open span of time [ns]."""

    start_ns: int
    stop_ns: int

    def holds(self, time_ns: int) -> bool:
        """Whether a time is inside."""
        return self.start_ns <= time_ns < self.stop_ns


def cut(
    recording: Recording,
    path: Path,
    start_ns: int,
    stop_ns: int,
    *,
    origin: Mapping[str, str],
    force: bool = False,
) -> Copied:
    """Copy the samples of a span, with its labels, and all geometry, attachments and metadata.

    Messages inside keep their bytes. WaveformBlocks at the edges are cut to the sample, and keep
    their indices. Labelled spans are cut; a count of steps over a span that would be cut is left
    out, for it is no more true. Topics without samples are cut by their log time.

    Parameters
    ----------
    recording
        What is cut.
    path
        The copy.
    start_ns, stop_ns
        Half-open span of sample times [ns].
    origin
        Written as the metadata record :data:`CUT`.
    force
        Replace an existing file.

    Raises
    ------
    CodecError
        Where the recording has no sample in the span, or the copy cannot be written.
    """
    if not (start_ns < stop_ns and start_ns <= recording.end_ns and recording.start_ns < stop_ns):
        raise CodecError(
            f"{recording.name}: expected a span with samples of {recording.start_ns} to "
            f"{recording.end_ns} ns, found {start_ns} to {stop_ns} ns"
        )
    file = recording.file
    scissors = _Scissors(recording, Span(start_ns, stop_ns))
    faults: list[str] = []
    with appearing(Container(path, "zstd", force, profile=file.profile)) as container:
        ids = copy_frame(file, container, file.channels.keys(), faults)
        container.add_metadata(CUT, origin)
        messages = send_all(file, container, ids, scissors.messages())
    left = {topic: n - messages[topic] for topic, n in recording.topic_counts.items()}
    left = {topic: n for topic, n in left.items() if n > 0}
    return Copied(messages, left, recording.damage, tuple(faults))


class _Scissors:
    """Cuts the messages of a recording to a span."""

    def __init__(self, recording: Recording, span: Span) -> None:
        file = recording.file
        schemas = {i: file.schemas.get(c.schema_id) for i, c in file.channels.items()}
        self._file = file
        self._span = span
        self._readers = recording.readers
        self._labels = {i for i, s in schemas.items() if s and s.name == "groundtrace.Label"}
        self._still = {i for i, c in file.channels.items() if c.topic == TRANSFORM_TOPIC}
        self._ours = {i for i, c in file.channels.items() if is_ours(file, c)}

    def messages(self) -> Iterator[Message]:
        """Yield what is inside, as recorded: by log time but for cut blocks, clocks set back."""
        apart = self._labels | self._still
        start, stop = self._span.start_ns, self._span.stop_ns
        low = start + min((g.low_ns for _, g in self._readers.values()), default=0) - SLACK_NS
        high = stop + max((g.high_ns for _, g in self._readers.values()), default=0) + SLACK_NS
        rest = self._file.as_recorded(self._file.channels.keys() - apart, low, high)
        known = (self._label, self._labels), (self._placed, self._still)
        queues = [filter(None, map(of, self._file.messages(ids))) for of, ids in known if ids]
        yield from heapq.merge(
            *(sorted(queue, key=_log_time) for queue in queues),
            filter(None, map(self._part, rest)),
            key=_log_time,
        )

    def _part(self, message: Message) -> Message | None:
        """Return what of a message is inside."""
        if message.channel_id in self._readers:
            return self._samples(message, *self._readers[message.channel_id])
        first_ns = message.log_time
        if message.channel_id in self._ours:
            first_ns = min(first_ns, message.publish_time)
        inside = self._span.holds(message.log_time) and first_ns >= self._span.start_ns
        return message if inside else None

    def _samples(self, message: Message, reader: ChannelReader, lag: Lag) -> Message | None:
        earliest = message.log_time - lag.high_ns - SLACK_NS
        latest = message.log_time - lag.low_ns + SLACK_NS
        if self._span.holds(earliest) and self._span.holds(latest):
            return message
        try:
            blocks = [block for _, block in reader.blocks(MessageTable.of([message]))]
        except CodecError:  # reading the copy says it, as reading the whole does
            return message if self._span.holds(message.log_time) else None
        parts = [block.between(self._span.start_ns, self._span.stop_ns) for block in blocks]
        kept, there = sum(map(len, parts)), sum(map(len, blocks))
        if kept in (0, there):
            return message if kept else None
        if isinstance(reader, WaveformReader):
            return cut_waveform(message, blocks[0], parts[0])
        return message

    def _label(self, message: Message) -> Message | None:
        # all labels are kept until they are in order, and a view would keep the whole chunk
        message = message._replace(data=bytes(message.data))
        label = decode_label(message.data, self._file.name)
        kept = label.within(self._span.start_ns, self._span.stop_ns)
        if kept is None:
            return None
        if kept == label or kept.end_ns is None:
            return message
        content = parse(message_class("Label"), message.data, self._file.name)
        set_time(content.timestamp, kept.time_ns)
        set_time(content.end, kept.end_ns)
        data = content.SerializeToString()
        return message._replace(log_time=kept.time_ns, publish_time=kept.time_ns, data=data)

    def _placed(self, message: Message) -> Message | None:
        """Return where sensors stand; said before the span, it holds from its start."""
        if message.log_time >= self._span.stop_ns:
            return None
        at_ns = max(message.log_time, self._span.start_ns)
        return message._replace(log_time=at_ns, publish_time=at_ns, data=bytes(message.data))


def _log_time(message: Message) -> int:
    return message.log_time


def cut_waveform(message: Message, block: SignalBlock, part: SignalBlock) -> Message:
    """Return the message of a WaveformBlock with some of its samples.

    Parameters
    ----------
    message, block
        The message, and what it holds.
    part
        What of the block is kept: at least one sample.
    """
    content = parse(message_class("WaveformBlock"), message.data, block.topic)
    content.format, content.data = stored(part.samples)
    content.samples = len(part)
    content.first_sample = part.first
    if part.times_ns is not None:
        content.sample_times_ns = part.times_ns.astype("<i8").tobytes()
    set_time(content.timestamp, part.start_ns)
    shorter_ns = int(block.sample_times().max()) - int(part.sample_times().max())
    return message._replace(
        log_time=message.log_time - shorter_ns,
        publish_time=message.publish_time + part.start_ns - block.start_ns,
        data=content.SerializeToString(),
    )
