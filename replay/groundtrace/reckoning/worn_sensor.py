"""The streams of one worn sensor, brought together: any topics, any order, any portions."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from ..heading.aligned import PATIENCE_NS, Aligner, columns_of_axes
from .level_motion import LevelMotion

if TYPE_CHECKING:
    from groundtrace_codecs.signals import SignalBlock

TURNING = "angular_velocity"


@dataclass(slots=True)
class WornSensor:
    """Follows the motion of one sensor.

    Attributes
    ----------
    motion
        What it felt; None before the gyroscope is heard of.
    topic
        Of the gyroscope.
    """

    motion: LevelMotion | None = None
    topic: str = ""
    _aligner: Aligner = field(default_factory=Aligner)
    _early: list[SignalBlock] = field(default_factory=list)

    @property
    def end_ns(self) -> int:
        """Time until which the motion is known; long ago where nothing is [ns]."""
        return -(2**62) if self.motion is None else self.motion.end_ns

    @property
    def held(self) -> int:
        """How many samples were not finite."""
        return self._aligner.held

    @property
    def remark(self) -> str:
        """What was assumed of the field's unit; empty where it is known."""
        return self._aligner.remark

    def hear(self, block: SignalBlock) -> None:
        """Take a block of one of the sensor's streams."""
        if self.motion is None and not columns_of_axes(block.stream, TURNING):
            self._early.append(block)
            return
        if self.motion is None:
            self.topic = block.topic
            self.motion = LevelMotion(block.stream.rate_hz)
            for early in self._early:
                self._aligner.hear(early)
            self._early = []
        self._aligner.hear(block)
        self.motion.add(self._aligner.take())

    def forget(self) -> None:
        """Forget what lies too long before a gyroscope that is yet to be heard of."""
        if self._early:
            oldest_ns = self._early[-1].start_ns - PATIENCE_NS
            self._early = [block for block in self._early if block.last_ns >= oldest_ns]

    def finish(self) -> None:
        """Take in what waited for more."""
        if self.motion is not None:
            self.motion.add(self._aligner.finish())
            self.motion.finish()
