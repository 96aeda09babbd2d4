"""Where marks lie on the curves they belong to, in the units shown."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .full_rate import FULL_RATE_HZ
from .recent import KEEP_S, Recent
from .signal_curves import curves_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy as np
    from numpy.typing import NDArray

    from groundtrace_codecs.events import Pick, StepEvent
    from groundtrace_codecs.signals import SignalBlock, Stream

#: Of slow streams so much is kept [s]: what a step of a walk is may be said when the walk ends.
SLOW_KEEP_S = 300.0


class Traces:
    """The last samples of all streams."""

    def __init__(self) -> None:
        self._recent: dict[str, Recent] = {}
        self._streams: dict[str, Stream] = {}

    def begin(self, stream: Stream) -> Recent:
        """Prepare for a stream and return what will hold its samples."""
        self._streams[stream.topic] = stream
        keep_s = KEEP_S if stream.rate_hz > FULL_RATE_HZ else SLOW_KEEP_S
        self._recent[stream.topic] = recent = Recent(stream, keep_s)
        return recent

    def push(self, block: SignalBlock) -> None:
        """Take a block of a stream that has begun."""
        self._recent[block.topic].push(block)

    def between(
        self, topic: str, start_ns: int, end_ns: int
    ) -> Iterator[tuple[NDArray[np.int64], NDArray[np.float64]]]:
        """Yield times [ns] and values, shape (n, n_channels), of a half-open span."""
        return self._recent[topic].between(start_ns, end_ns)

    def of_pick(self, pick: Pick) -> float:
        """Return the signal at a pick; 0 where it is not known."""
        stream = self._streams.get(pick.topic)
        names = [c.name for c in stream.channels] if stream is not None else []
        if pick.channel not in names:
            return 0.0
        return self._shown(pick.topic, pick.time_ns, [names.index(pick.channel)])

    def of_step(self, step: StepEvent) -> float:
        """Return the magnitude of the acceleration at a step; 0 where there is none."""
        stream = self._streams.get(step.topic)
        if stream is None:
            return 0.0
        columns = stream.columns_of({"acceleration"}) or stream.columns_of(
            {"acceleration_magnitude"}
        )
        return self._shown(step.topic, step.time_ns, columns) if columns else 0.0

    def _shown(self, topic: str, time_ns: int, columns: list[int]) -> float:
        factor = next(c.factor for c in curves_of(self._streams[topic]) if columns[0] in c.columns)
        return factor * self._recent[topic].value(time_ns, columns)
