"""A recording that is still being written, or that comes through a pipe.

What flows is known from the beginning of the file: its streams, its geometry, its first sample.
So the first second is awaited, and of foreign messages as much as their rate is measured on, for
the streams are to be those of the finished file. A topic that begins later is left out, and said.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Self

from .errors import CodecError
from .mcap.chunks import MAGIC, Damage
from .mcap.follow import POLL_S, FollowedFile, Prefix
from .recording import PROBE_MESSAGES, PROBE_NS, SLACK_NS, LoggedBlock, Recording, is_ours
from .schemas.event_messages import TRUTH_TOPIC, labels_in
from .signals import NS_PER_S, STREAM_KEY

if TYPE_CHECKING:
    import threading
    from collections.abc import Callable, Collection, Iterator
    from types import TracebackType

    from .events import Label
    from .mcap.follow import Growing
    from .signals import Stream

#: So much log time is awaited, for the streams that begin in it [ns]. Chosen by judgement: streams
#: of one logger begin within some tenths.
SETTLE_NS = NS_PER_S
#: Of a file that is long already, so many bytes are looked at to know its streams, at first.
_HEAD_BYTES = 1 << 22


class LiveRecording:
    """A recording that grows.

    Made by :meth:`open`; a context manager. Its blocks can be read once.

    Attributes
    ----------
    head
        Its beginning, open: streams, geometry, labels and first sample of the whole are those.
    end_ns
        Time of the last sample that was read so far [ns].
    labels
        The recording's own truth that was read so far, in the order of the file.
    """

    def __init__(
        self, source: Growing, head: Recording, stop: threading.Event, tell: Callable[[str], None]
    ) -> None:
        self.head = head
        self.end_ns = head.start_ns
        self.labels: list[Label] = []
        self._source, self._stop, self._tell = source, stop, tell
        self._file = FollowedFile(source, stop, tell)

    @classmethod
    def open(cls, source: Growing, stop: threading.Event, tell: Callable[[str], None]) -> Self:
        """Wait until the streams of a growing recording are known.

        Parameters
        ----------
        source
            The file or pipe; closed with the recording.
        stop
            Set by whoever wants no more: waiting ends then, and reading with what is there.
        tell
            Told in one line what a person should know: that the writer stalls, or a topic is late.

        Raises
        ------
        CodecError
            Where it is no recording, a channel is not what it says, or the wait is ended before
            there is a stream.
        """
        try:
            return cls(source, _head(source, stop), stop, tell)
        except BaseException:
            source.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.head.close()
        self._source.close()

    @property
    def streams(self) -> tuple[Stream, ...]:
        """The sampled streams."""
        return self.head.streams

    @property
    def damage(self) -> tuple[Damage, ...]:
        """What was left out so far; grows while blocks are read."""
        undecoded = self.head.damage[len(self.head.file.damage) :]
        return (*self._file.damage, *undecoded)

    def sha256(self) -> str:
        """Return the SHA-256 of the bytes that are there."""
        return self._source.sha256()

    def blocks(
        self,
        topics: Collection[str] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
        joined_ns: int = 0,  # noqa: ARG002 - nothing is awaited to be joined
    ) -> Iterator[LoggedBlock]:
        """Yield blocks of all streams as they become whole, by log time.

        Parameters
        ----------
        topics
            Streams to read; None = all.
        start_ns, stop_ns
            Sample times ``[start_ns, stop_ns)``; None = no bound.
        joined_ns
            Not used: blocks come as they were recorded.
        """
        late_ns = max((lag.high_ns for _, lag in self.head.readers.values()), default=0)
        seen_ids = set(self.head.file.channels)
        for table in self._file.tables():
            if len(self._file.channels) > len(seen_ids):
                self._say_late(seen_ids)
            self.labels += labels_in(table, self._file, TRUTH_TOPIC)
            for logged_ns, block in self.head.decoded(table):
                times = block.sample_times()
                if len(times):
                    self.end_ns = max(self.end_ns, int(times[-1]))
                part = block.between(start_ns, stop_ns)
                if len(part) and (topics is None or block.topic in topics):
                    yield LoggedBlock(logged_ns, part)
            first_ns = int(table.rows["log_time"][0])
            if stop_ns is not None and first_ns > stop_ns + late_ns + SLACK_NS:
                return

    def _say_late(self, seen_ids: set[int]) -> None:
        """Tell of topics that began after the streams were known."""
        for channel_id, channel in self._file.channels.items():
            signal = STREAM_KEY in channel.metadata or not is_ours(self._file, channel)
            if channel_id not in seen_ids and signal:
                self._tell(
                    f"{self._source.name}: {channel.topic} begins after the replay and is left "
                    "out; a replay of the finished file has it"
                )
            seen_ids.add(channel_id)


def _head(source: Growing, stop: threading.Event) -> Recording:
    """Return the beginning of a growing recording when its streams are known, or as it ends."""
    limit, looked_at = _HEAD_BYTES, -1
    while True:
        source.grow()
        size = min(source.size, limit)
        over = source.ended or stop.is_set()
        if over or (size > looked_at and size >= len(MAGIC)):
            looked_at = size
            head = Recording.open(Prefix(source, size))
            if _settled(head) or (over and head.readers and size == source.size):
                return head
            head.close()
        if size < source.size:
            limit *= 2
        elif over:
            raise CodecError(f"{source.name}: expected signals, found none before its end")
        else:
            stop.wait(POLL_S)


def _settled(head: Recording) -> bool:
    """Return whether the streams of a beginning are those of the whole."""
    file = head.file
    measured = [i for i in head.readers if STREAM_KEY not in file.channels[i].metadata]
    few = any(file.message_counts.get(i, 0) < PROBE_MESSAGES for i in measured)
    wanted_ns = PROBE_NS if few else SETTLE_NS
    # by samples: labels and log lines may be of any time
    return bool(head.readers) and head.end_ns - head.start_ns >= wanted_ns
