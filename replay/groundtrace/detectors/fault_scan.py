"""The scan for signal faults: passes the blocks of one stream to a watcher of each kind."""

from __future__ import annotations

from typing import TYPE_CHECKING

from groundtrace_codecs.events import Gap
from groundtrace_codecs.signals import NS_PER_S, SEISMIC_QUANTITIES

from ..pipeline.source import BRIDGE_PERIODS, BRIDGE_S
from .clipping import Limits, Repeats
from .held_values import StuckValues
from .interference import MainsHum, Offsets, Spikes
from .signal_faults import FaultDetectors, NonFinite, Rate

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from groundtrace_codecs.recording import LoggedBlock
    from groundtrace_codecs.signals import SignalBlock, Stream

    from ..pipeline.source import Readable
    from .signal_faults import Finding

#: Quantities that move all the time: what stands still or jumps in them is a fault.
MOVING = SEISMIC_QUANTITIES | {"acceleration", "acceleration_magnitude", "angular_velocity"}
#: These stand still for no longer than a moment, but are stale for that long now and then.
SLOW = frozenset({"magnetic_field"})


class FaultScan:
    """Looks for faults in one stream, block by block, in constant memory.

    A stream of a constant rate is judged as the source gives it, one whose samples carry their own
    times as it was recorded: interpolated, no two samples would be equal any more.

    Parameters
    ----------
    stream
        A stream of a recording.
    """

    def __init__(self, stream: Stream) -> None:
        self.stream = stream
        moving = stream.columns_of(MOVING)
        seismic = stream.columns_of(SEISMIC_QUANTITIES)
        self._rate = None if stream.irregular else Rate(stream)
        self._last_ns: int | None = None
        self._longest_ns = max(BRIDGE_S * NS_PER_S, BRIDGE_PERIODS * stream.period_ns)
        self._detectors = FaultDetectors(
            stream,
            NonFinite(stream),
            StuckValues(stream, [*moving, *stream.columns_of(SLOW)], moving),
            Limits(stream, MOVING),
            Repeats(stream),
            Spikes(stream, moving),
            Offsets(stream, seismic),
            MainsHum(stream, seismic),
        )

    def recorded(self, block: SignalBlock) -> None:
        """Take the next block as it was recorded."""
        if self._rate is not None:
            self._rate.update(block)
        elif len(block):
            step_ns = 0 if self._last_ns is None else block.start_ns - self._last_ns
            if not 0 <= step_ns <= self._longest_ns:
                self._detectors.gap()
            self._last_ns = block.last_ns
            self._detectors.update(block)

    def update(self, item: SignalBlock | Gap) -> None:
        """Take what the source gives next."""
        if self._rate is None:
            return
        if isinstance(item, Gap):
            if not item.bridged:
                self._detectors.gap()
        elif len(item):
            self._detectors.update(item)

    def findings(self) -> Iterator[Finding]:
        """End the last run and yield all that was found."""
        self._detectors.gap()
        yield from self._detectors.findings()
        if self._rate is not None:
            yield from self._rate.findings()


class MonitoredRecording:
    """A recording that tells watches what it gives a source.

    Parameters
    ----------
    recording
        What is read.
    watches
        By topic.
    """

    def __init__(self, recording: Readable, watches: dict[str, FaultScan]) -> None:
        self.recording = recording
        self.watches = watches

    @property
    def streams(self) -> tuple[Stream, ...]:
        """The sampled streams."""
        return self.recording.streams

    def blocks(
        self,
        topics: Collection[str] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
        joined_ns: int = 0,
    ) -> Iterator[LoggedBlock]:
        """Yield recorded blocks in the order of the file."""
        for stamped in self.recording.blocks(topics, start_ns, stop_ns, joined_ns):
            self.watches[stamped[1].topic].recorded(stamped[1])
            yield stamped
