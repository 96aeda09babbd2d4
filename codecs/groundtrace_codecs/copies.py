"""Copies of a recording: with annotations inside, repaired, cut, filtered or converted.

What is not changed is copied byte by byte, message by message.
"""

from __future__ import annotations

import heapq
from collections import Counter
from contextlib import contextmanager
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING

from .annotations import ANNOTATIONS_TOPIC, encode_annotation, in_order
from .errors import CodecError, FormatError
from .mcap.chunks import Message, MessageTable
from .mcap.reader import McapFile
from .mcap.writer import CHUNK_BYTES, Container, Packet
from .recording import SLACK_NS, WaveformReader, is_ours, reader_for
from .schemas.event_messages import decode_label, label_channels
from .schemas.protobuf import message_class, parse, set_time
from .schemas.waveform import encode_waveform, stored
from .signals import NS_PER_S
from .writer import TRANSFORM_TOPIC, Buckets, pieces, protobuf_output

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from .annotations import Annotation
    from .mcap.chunks import Damage
    from .recording import ChannelReader, Lag, Recording
    from .signals import SignalBlock, Stream

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
    for item in _together(file.as_recorded(ids), annotations):
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
    for number, message in enumerate(file.as_recorded()):
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
    with atomic_write(Container(path, "zstd", force, profile=file.profile)) as container:
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
        handlers = (self._label, self._labels), (self._placed, self._still)
        queues = [filter(None, map(of, self._file.messages(ids))) for of, ids in handlers if ids]
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
        inside, there = sum(map(len, parts)), sum(map(len, blocks))
        if inside in (0, there):
            return message if inside else None
        if isinstance(reader, WaveformReader):
            return cut_waveform(message, blocks[0], parts[0])
        return message

    def _label(self, message: Message) -> Message | None:
        # all labels are kept until they are in order, and a view would keep the whole chunk
        message = message._replace(data=bytes(message.data))
        label = decode_label(message.data, self._file.name)
        clipped = label.within(self._span.start_ns, self._span.stop_ns)
        if clipped is None:
            return None
        if clipped == label or clipped.end_ns is None:
            return message
        content = parse(message_class("Label"), message.data, self._file.name)
        set_time(content.timestamp, clipped.time_ns)
        set_time(content.end, clipped.end_ns)
        data = content.SerializeToString()
        return message._replace(log_time=clipped.time_ns, publish_time=clipped.time_ns, data=data)

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


_U32 = (1 << 32) - 1


@dataclass(frozen=True, slots=True)
class Copied:
    """What a copy holds.

    Attributes
    ----------
    messages
        How many of each topic that is in the copy.
    left
        How many of each topic that was left out on purpose.
    damage
        What of the source could not be read, and is not in the copy.
    faults
        What is wrong with attachments that are not in the copy.
    """

    messages: dict[str, int]
    left: dict[str, int]
    damage: tuple[Damage, ...]
    faults: tuple[str, ...] = ()


@contextmanager
def atomic_write(container: Container) -> Iterator[Container]:
    """Close a container, which gets its name only where nothing went wrong."""
    complete = False
    try:
        yield container
        complete = True
    finally:
        container.close(complete=complete)


def send_all(
    file: McapFile, container: Container, ids: dict[int, int], messages: Iterable[Message]
) -> dict[str, int]:
    """Write messages of a file on the channels of its copy; return how many of each topic."""
    counts: Counter[int] = Counter(dict.fromkeys(ids, 0))
    for message in messages:
        container.copy(ids[message.channel_id], message)
        counts[message.channel_id] += 1
    return _by_topic(file, counts)


def filter_topics(
    source: Path,
    path: Path,
    keep: Sequence[str] = (),
    drop: Sequence[str] = (),
    *,
    force: bool = False,
) -> Copied:
    """Copy the messages of some topics byte by byte, and all attachments and metadata.

    Parameters
    ----------
    source, path
        The file, and its copy.
    keep
        Patterns as of a shell, of topics to copy; none stands for all.
    drop
        Patterns of topics to leave out of these.
    force
        Replace an existing file.

    Raises
    ------
    CodecError
        Where a pattern fits no topic, nothing would be left, or a file cannot be used.
    """
    with opened(source) as file:
        chosen, faults = _chosen(file, keep, drop), list[str]()
        with atomic_write(Container(path, "zstd", force, profile=file.profile)) as container:
            ids = copy_frame(file, container, chosen, faults)
            messages = send_all(file, container, ids, file.as_recorded(chosen))
        others = {i: file.message_counts.get(i, 0) for i in file.channels.keys() - chosen}
        return Copied(messages, _by_topic(file, others), file.damage, tuple(faults))


def convert(
    source: Path,
    path: Path,
    *,
    compression: str = "zstd",
    chunk_bytes: int = CHUNK_BYTES,
    block_ns: int | None = None,
    force: bool = False,
    progress: Progress | None = None,
) -> Copied:
    """Copy a file into other chunks, and where asked its waveforms into other blocks.

    Samples and their times stay what they are, to the last bit.

    Parameters
    ----------
    source, path
        The file, and its copy.
    compression
        ``zstd``, ``lz4`` or ``none``.
    chunk_bytes
        Length at which a chunk is ended, before compression.
    block_ns
        Length of a WaveformBlock [ns]; None leaves every message as it is, byte by byte.
    force
        Replace an existing file.
    progress
        Told now and then how much of the recording is copied, and of how much [s].

    Raises
    ------
    CodecError
        Where a file cannot be used.
    """
    with opened(source) as file:
        messages, faults = passing(file, progress), list[str]()
        if block_ns is not None:
            messages = _reblocked(file, messages, block_ns)
        container = Container(path, compression, force, chunk_bytes, profile=file.profile)
        with atomic_write(container):
            ids = copy_frame(file, container, file.channels.keys(), faults)
            counts = send_all(file, container, ids, messages)
        return Copied(counts, {}, file.damage, tuple(faults))


def opened(source: Path) -> McapFile:
    """Open a file to copy it.

    Raises
    ------
    CodecError
        Where it is no MCAP file, or there is none.
    """
    try:
        return McapFile.open(source)
    except OSError as error:
        raise CodecError(f"{source}: expected a recording, found: {error.strerror}") from error


def _by_topic(file: McapFile, counts: dict[int, int]) -> dict[str, int]:
    totals: Counter[str] = Counter()
    for channel_id in sorted(counts):
        totals[file.channels[channel_id].topic] += counts[channel_id]
    return dict(totals)


def _chosen(file: McapFile, keep: Sequence[str], drop: Sequence[str]) -> set[int]:
    """Return the channels that the patterns leave."""
    topics = sorted({c.topic for c in file.channels.values()})
    for pattern in (*keep, *drop):
        if not any(fnmatchcase(topic, pattern) for topic in topics):
            raise CodecError(
                f"{file.name}: expected a topic like {pattern!r}, found {', '.join(topics)}"
            )

    def wanted(topic: str) -> bool:
        matched = not keep or any(fnmatchcase(topic, p) for p in keep)
        return matched and not any(fnmatchcase(topic, p) for p in drop)

    chosen = {i for i, channel in file.channels.items() if wanted(channel.topic)}
    if not chosen:
        raise CodecError(f"{file.name}: expected a topic to be left, found all dropped")
    return chosen


class _Reblocker:
    """Joins and cuts the waveforms of one channel; the index of samples stays."""

    def __init__(self, reader: WaveformReader, channel_id: int, block_ns: int) -> None:
        stream = reader.streams[0]
        self._reader = reader
        self._channel_id = channel_id
        self._buckets = Buckets(max(1, round(block_ns * stream.rate_hz / NS_PER_S)))
        self._stream: Stream | None = None
        self._before: SignalBlock | None = None
        self._lag_ns = 0
        self._sequence = 0

    def add(self, message: Message) -> Iterator[Message]:
        """Yield the messages that one completes; one that cannot be decoded stays as it is."""
        try:
            ((_, block),) = self._reader.blocks(MessageTable.of([message]))
        except CodecError:
            yield from self.flush()
            yield message
            return
        block = replace(block, stream=self._named(message))
        if self._before is not None and self._before.samples.dtype != block.samples.dtype:
            yield from self.flush()
        runs = list(self._buckets.push(block))
        lag_ns = message.log_time - int(block.sample_times().max())
        # A run that the block does not continue was logged like the block before it.
        for run in runs:
            continued = run.first + len(run) > block.first and run.anchor_ns == block.anchor_ns
            yield from self._messages(run, lag_ns if continued else self._lag_ns)
        self._before, self._lag_ns = block, lag_ns

    def flush(self) -> Iterator[Message]:
        """Yield what is left."""
        for run in self._buckets.flush():
            yield from self._messages(run, self._lag_ns)

    def _named(self, message: Message) -> Stream:
        """Return the stream, with the frame of the first message: blocks carry it."""
        if self._stream is None:
            stream = self._reader.streams[0]
            wave = parse(message_class("WaveformBlock"), message.data, stream.topic)
            self._stream = replace(stream, placement=wave.frame_id)
        return self._stream

    def _messages(self, run: SignalBlock, lag_ns: int) -> Iterator[Message]:
        for piece in pieces(run, self._buckets.size):
            log_ns = int(piece.sample_times().max()) + lag_ns
            data = encode_waveform(piece)
            sequence = self._sequence & _U32
            yield Message(self._channel_id, sequence, log_ns, piece.start_ns, data)
            self._sequence += 1


def _reblocked(file: McapFile, messages: Iterable[Message], block_ns: int) -> Iterator[Message]:
    """Yield messages with the waveforms among them in blocks of another length."""
    makers = {
        i: _Reblocker(reader, i, block_ns) for i, reader in _waveforms(file, file.channels).items()
    }
    for message in messages:
        if message.channel_id in makers:
            yield from makers[message.channel_id].add(message)
        else:
            yield message
    for maker in makers.values():
        yield from maker.flush()


def _waveforms(file: McapFile, channel_ids: Collection[int]) -> dict[int, WaveformReader]:
    readers = {i: reader_for(file, file.channels[i], None) for i in channel_ids}
    return {i: r for i, r in readers.items() if isinstance(r, WaveformReader)}
