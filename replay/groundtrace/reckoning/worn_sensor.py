"""The streams of one worn sensor, brought together: any topics, any order, any portions."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from ..heading.aligned import PATIENCE_NS, Aligner
from ..nonfinite import Holder
from .level_motion import LevelMotion

if TYPE_CHECKING:
    from groundtrace_codecs.signals import SignalBlock, Stream

    from .parameters import Axis

TURNING = "angular_velocity"
QUANTITIES = (TURNING, "acceleration", "magnetic_field")


@dataclass(slots=True)
class WornSensor:
    """Follows the motion of one sensor.

    Attributes
    ----------
    axis
        Of the sensor, that looks ahead.
    motion
        What it felt; None before the gyroscope is heard of.
    topic
        Of the gyroscope.
    """

    axis: Axis
    motion: LevelMotion | None = None
    topic: str = ""
    _aligner: Aligner = field(default_factory=Aligner)
    _holders: dict[str, Holder] = field(default_factory=dict)
    _early: list[SignalBlock] = field(default_factory=list)

    @property
    def end_ns(self) -> int:
        """Time until which the motion is known; long ago where nothing is [ns]."""
        return -(2**62) if self.motion is None else self.motion.end_ns

    @property
    def held(self) -> int:
        """How many samples were not finite."""
        return sum(holder.count for holder in self._holders.values())

    def hear(self, block: SignalBlock) -> None:
        """Take a block of one of the sensor's streams."""
        if self.motion is None and not columns_of_axes(block.stream, TURNING):
            self._early.append(block)
            while self._early[0].last_ns < block.start_ns - PATIENCE_NS:
                self._early.pop(0)
            return
        if self.motion is None:
            self.topic = block.topic
            self.motion = LevelMotion(self.axis, block.stream.rate_hz)
            for early in self._early:
                self._feed(early)
            self._early = []
        self._feed(block)
        self.motion.add(self._aligner.take())

    def finish(self) -> None:
        """Take in what waited for more."""
        if self.motion is not None:
            self.motion.add(self._aligner.finish())
            self.motion.finish()

    def _feed(self, block: SignalBlock) -> None:
        held = self._holders.setdefault(block.topic, Holder()).held(block)
        values, times = held.values, held.sample_times()
        for quantity in QUANTITIES:
            if columns := columns_of_axes(block.stream, quantity):
                self._aligner.add(quantity, times, values[:, columns])


def columns_of_axes(stream: Stream, quantity: str) -> list[int]:
    """Return the columns of a quantity's axes x, y, z; none where one of them lacks."""
    columns = {stream.channels[c].axis: c for c in stream.columns_of({quantity})}
    return [columns[axis] for axis in "xyz"] if columns.keys() >= set("xyz") else []
