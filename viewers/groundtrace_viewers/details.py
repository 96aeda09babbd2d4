"""What the parts have in common that show one application in detail: they take every item."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from groundtrace_codecs.events import (
        Bearing,
        CandidateBlock,
        Disturbance,
        Gap,
        Heading,
        Pick,
        StageSpec,
        StepEvent,
        TraceBlock,
        TrackPoint,
    )
    from groundtrace_codecs.signals import SignalBlock
    from groundtrace_codecs.traffic import Traffic

    from .sensor_map import Bounds


class Details:
    """Shows nothing; an application's own part overrides what it has something to show of."""

    def stage(self, spec: StageSpec, colour: int) -> None:
        """Take a stage; ``colour`` is that of its places."""

    def draws(self, spec: StageSpec) -> bool:  # noqa: ARG002
        """Whether this part draws the plot of a stage's decision function."""
        return False

    def tells(self, spec: StageSpec) -> bool:  # noqa: ARG002
        """Whether this part fills the lane of a stage's decisions."""
        return False

    def signal(self, block: SignalBlock) -> None:
        """Take a block."""

    def gap(self, gap: Gap) -> None:
        """Take a gap."""

    def trace(self, block: TraceBlock) -> None:
        """Take a piece of a decision function."""

    def candidates(self, block: CandidateBlock) -> None:
        """Take decided candidates."""

    def pick(self, pick: Pick) -> None:
        """Take an arrival."""

    def expect(self, time_ns: int) -> None:
        """Take a moment that the signal has just come past, and that may be told of later."""

    def near(self, time_ns: int) -> None:
        """Show every sample around a moment; those of steps come after the steps."""

    def step(self, step: StepEvent) -> None:
        """Take a step of the stage that has the last word on steps."""

    @property
    def bounds(self) -> Bounds | None:
        """What a map of this part's own must show; None without one."""
        return None

    def track(self, point: TrackPoint) -> None:
        """Take a point of a track."""

    def estimate(self, event: Bearing | Heading | Disturbance) -> None:
        """Take a direction, or a span in which it is disturbed."""

    def traffic(self, event: Traffic) -> None:
        """Take what is said of a vehicle."""

    def flush(self, before_ns: int | None = None) -> None:
        """Log what is pending; lanes up to a time [ns], as channels lag behind each other."""

    def close(self) -> None:
        """Log what was held back."""
