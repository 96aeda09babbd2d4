"""Recordings as typed blocks: streams out of an MCAP file, ours or another's."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Self

from .annotations import annotations_of
from .batches import batches
from .channels import ChannelReader, Stamped, reader_for
from .errors import CodecError
from .geometry import SITE_NAME, Geometry
from .label_codec import TRUTH_TOPIC, labels_of
from .lags import lags_of
from .mcap import Damage, McapFile
from .others import OtherTopic, is_ours, other_topic
from .readable import readable
from .signals import NS_PER_S, Stream

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator
    from types import TracebackType

    from .annotations import Annotation
    from .labels import Label
    from .lags import Lag
    from .mcap import ByteSource, Message

__all__ = ["OtherTopic", "Recording", "Stamped"]

#: Log time over which messages are decoded together; blocks come out in order of log time.
BATCH_NS = NS_PER_S // 4
#: How much later or earlier than seen at its start a channel may be logged after its samples.
SLACK_NS = 2 * NS_PER_S


class Recording:
    """An open recording.

    Made by :meth:`open`; a context manager.

    Attributes
    ----------
    name
        File name.
    file
        The MCAP file underneath.
    streams
        In the order of their channels' ids; channels with the positions the geometry gives.
    others
        Topics left alone.
    geometry
        Of the site, or None.
    metadata
        Values of every Metadata record by its name.
    """

    def __init__(self, file: McapFile, *, strict: bool = False) -> None:
        self.file = file
        self._strict = strict
        self._left_out: dict[tuple[int, int, int], Damage] = {}
        self.name = Path(file.name).name
        self.geometry = _geometry(file)
        self.metadata: dict[str, dict[str, str]] = {}
        for record in file.metadata:
            self.metadata.setdefault(record.name, {}).update(record.values)
        self._readers: dict[int, ChannelReader] = {}
        others: list[OtherTopic] = []
        for channel in sorted(file.channels.values(), key=lambda c: c.id):
            reader = reader_for(file, channel, self.geometry)
            if reader is not None:
                self._readers[channel.id] = reader
            elif not is_ours(file, channel):
                others.append(other_topic(file, channel))
        self.others = tuple(others)
        self.streams = _unify(self._readers)
        self._lags = lags_of(file, self._readers)
        self._clock = file.reading_clock(self._readers.keys())

    @classmethod
    def open(cls, source: str | Path | ByteSource, *, strict: bool = False) -> Self:
        """Open a recording.

        Parameters
        ----------
        source
            Path, or bytes from elsewhere.
        strict
            Raise at the first damage instead of listing it.

        Raises
        ------
        CodecError
            Where there is no such file, it is no MCAP file, or a channel is not what it says.
        """
        try:
            file = McapFile.open(source, strict=strict)
        except OSError as error:
            raise CodecError(f"{source}: expected a recording, found: {error.strerror}") from error
        try:
            return cls(file, strict=strict)
        except BaseException:
            file.close()
            raise

    def close(self) -> None:
        """Close the file."""
        self.file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    @property
    def damage(self) -> tuple[Damage, ...]:
        """What was left out so far; grows while blocks are read."""
        return (*self.file.damage, *self._left_out.values())

    @property
    def assumed(self) -> tuple[str, ...]:
        """One line for each stream that is only taken for what it seems to be."""
        return tuple(line for r in self._readers.values() for line in getattr(r, "assumed", ()))

    @property
    def readers(self) -> dict[int, tuple[ChannelReader, Lag]]:
        """What decodes each channel that has samples, by its id, and its lag."""
        return {i: (self._readers[i], lag) for i, lag in self._lags.items()}

    @property
    def topic_counts(self) -> dict[str, int]:
        """Messages by topic, in the order of the channels' ids."""
        counts: dict[str, int] = {}
        for channel in sorted(self.file.channels.values(), key=lambda c: c.id):
            found = self.file.message_counts.get(channel.id, 0)
            counts[channel.topic] = counts.get(channel.topic, 0) + found
        return counts

    @cached_property
    def labels(self) -> tuple[Label, ...]:
        """The recording's own truth, by time."""
        return labels_of(self.file, TRUTH_TOPIC)

    @cached_property
    def annotations(self) -> tuple[Annotation, ...]:
        """What people marked, kept inside the file, by time."""
        return annotations_of(self.file)

    @cached_property
    def start_ns(self) -> int:
        """Time of the first sample over all streams [ns]; 0 without samples."""
        firsts = [lag.first_ns for lag in self._lags.values()]
        for edge_ns in self._edges_ns:
            blocks = self._decoded(self._readers, edge_ns, edge_ns + SLACK_NS)
            firsts += [int(b.sample_times().min()) for _, b in blocks]
        return min(firsts, default=0)

    @property
    def set_back(self) -> bool:
        """Whether a clock was set back while it was recorded."""
        return self._clock is not None

    @property
    def _edges_ns(self) -> tuple[int, ...]:
        """Where a clock that was set back goes on, in times of reading [ns]."""
        return () if self._clock is None else self._clock.edges_ns

    @cached_property
    def end_ns(self) -> int:
        """Time of the last sample over all streams [ns]; 0 without samples."""
        if not self._lags:
            return 0
        end_ns = self.file.end_ns
        if self._clock is not None:
            end_ns = max(chunk.end_ns for chunk in self._clock.chunks)
        lasts = [self._last_ns(edge_ns, edge_ns) for edge_ns in self._edges_ns]
        return max(*lasts, self._last_ns(end_ns, None), self.start_ns)

    def _last_ns(self, end_ns: int, stop_ns: int | None) -> int:
        """Return the last sample that was read by a time [ns]; 0 where there is none."""
        span = NS_PER_S
        while True:
            low = end_ns - span
            blocks = self._decoded(self._readers, low, stop_ns)
            last = max((int(b.sample_times().max()) for _, b in blocks), default=None)
            if last is not None or low <= self.file.start_ns:
                return last or 0
            span *= 4

    def blocks(
        self,
        topics: Collection[str] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
        joined_ns: int = 0,
    ) -> Iterator[Stamped]:
        """Yield blocks of all streams in order of log time, then of channel id.

        One block per WaveformBlock; messages of one sample are put together over 0.25 s of log
        time. After a clock was set back, log times go on as if it had not been, see
        :mod:`groundtrace_codecs.mcap.set_backs`: a channel's blocks come as they were recorded.

        Parameters
        ----------
        topics
            Streams to read; None = all.
        start_ns, stop_ns
            Sample times ``[start_ns, stop_ns)``; None = no bound. Messages are looked for where
            their channel's first messages were logged after their samples, and 2 s around.
        joined_ns
            Log time over which messages of all kinds are put together, those that continue each
            other into one block; 0 = as said above.

        Raises
        ------
        CodecError
            Where a topic is none of the streams; strict, also where a message is not what its
            schema says (otherwise it is left out and listed as damage).
        """
        wanted = self._wanted(topics)
        readers = {
            i: r for i, r in self._readers.items() if any(s.topic in wanted for s in r.streams)
        }
        lags = [self._lags[i] for i in readers if i in self._lags]
        if not lags:
            return
        low = None if start_ns is None else start_ns + min(g.low_ns for g in lags) - SLACK_NS
        high = None if stop_ns is None else stop_ns + max(g.high_ns for g in lags) + SLACK_NS
        if high is not None and self._clock is not None:
            high += self._clock.latest_ns
        if start_ns is None and stop_ns is None and len(wanted) == len(self.streams):
            yield from self._decoded(readers, low, high, joined_ns)
            return
        for logged_ns, block in self._decoded(readers, low, high, joined_ns):
            if block.topic in wanted and len(part := block.between(start_ns, stop_ns)):
                yield Stamped(logged_ns, part)

    def _wanted(self, topics: Collection[str] | None) -> set[str]:
        known = {s.topic for s in self.streams}
        missing = sorted(set(topics or ()) - known)
        if missing:
            raise CodecError(f"{self.name}: expected a stream {missing[0]}, found none")
        return known if topics is None else set(topics)

    def _decoded(
        self,
        readers: dict[int, ChannelReader],
        low_ns: int | None,
        high_ns: int | None,
        joined_ns: int = 0,
    ) -> Iterator[Stamped]:
        """Yield decoded blocks by log time, one batch after the other."""
        tables = self.file.tables(readers.keys(), low_ns, high_ns, self._clock)
        for batch in batches(tables, joined_ns or BATCH_NS):
            blocks = [
                stamped
                for i, messages in batch
                for stamped in readable(readers[i], messages, self._leave_out, joined=joined_ns > 0)
            ]
            # The sort is stable: blocks of one log time stay in the order of their channels' ids.
            yield from sorted(blocks, key=attrgetter("log_ns"))

    def _leave_out(self, message: Message, error: CodecError) -> None:
        if self._strict:
            raise error
        at = message.log_time
        key = (message.channel_id, message.sequence, at)
        self._left_out[key] = Damage(0, len(message.data), at, at, 1, str(error))


def _geometry(file: McapFile) -> Geometry | None:
    sites = [ref for ref in file.attachments if ref.name == SITE_NAME]
    if not sites:
        return None
    return Geometry.from_json(file.attachment(sites[-1]), f"{file.name}: {SITE_NAME}")


def _unify(readers: dict[int, ChannelReader]) -> tuple[Stream, ...]:
    """Let channels of one topic share its stream; a topic's other kind of stream gets the id."""
    streams: dict[str, Stream] = {}
    for channel_id, reader in readers.items():
        own = []
        for stream in reader.streams:
            known = streams.setdefault(stream.topic, stream)
            same = replace(stream, rate_hz=known.rate_hz) == known
            if not same or (stream.rate_hz != known.rate_hz and not stream.irregular):
                stream = replace(stream, topic=f"{stream.topic}#{channel_id}")
                known = streams.setdefault(stream.topic, stream)
            own.append(known)
        reader.streams = tuple(own)
    return tuple(streams.values())
