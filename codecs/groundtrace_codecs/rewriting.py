"""Copies of MCAP files with other messages: some topics, or other chunks and blocks."""

from __future__ import annotations

from collections import Counter
from contextlib import contextmanager
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING

from .channels import WaveformReader, reader_for
from .container import CHUNK_BYTES, Container
from .copying import copy_frame, passing
from .encoders import Buckets, pieces
from .errors import CodecError
from .mcap import McapFile, MessageTable
from .mcap.records import Message
from .schemas.protobuf import message_class, parse
from .schemas.waveform import encode_waveform
from .signals import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Sequence
    from pathlib import Path

    from .copying import Progress
    from .mcap import Damage
    from .signals import SignalBlock, Stream

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
def appearing(container: Container) -> Iterator[Container]:
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
        with appearing(Container(path, "zstd", force, profile=file.profile)) as container:
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
        with appearing(container):
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
    found: Counter[str] = Counter()
    for channel_id in sorted(counts):
        found[file.channels[channel_id].topic] += counts[channel_id]
    return dict(found)


def _chosen(file: McapFile, keep: Sequence[str], drop: Sequence[str]) -> set[int]:
    """Return the channels that the patterns leave."""
    topics = sorted({c.topic for c in file.channels.values()})
    for pattern in (*keep, *drop):
        if not any(fnmatchcase(topic, pattern) for topic in topics):
            raise CodecError(
                f"{file.name}: expected a topic like {pattern!r}, found {', '.join(topics)}"
            )

    def wanted(topic: str) -> bool:
        kept = not keep or any(fnmatchcase(topic, p) for p in keep)
        return kept and not any(fnmatchcase(topic, p) for p in drop)

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
            own = run.first + len(run) > block.first and run.anchor_ns == block.anchor_ns
            yield from self._messages(run, lag_ns if own else self._lag_ns)
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
