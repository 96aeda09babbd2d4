"""What the parts have in common that show one application in detail: they take every item."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from groundtrace_codecs.events import (
        CandidateBlock,
        Event,
        Gap,
        Pick,
        StageSpec,
        StepEvent,
        TraceBlock,
    )
    from groundtrace_codecs.signals import SignalBlock

    from .sensor_map import Bounds

    #: What shows the events of a kind, by the kind: methods that take one event.
    Views = Mapping[type[Any], Callable[[Any, Any], None]]


class Details:
    """Shows nothing; an application's own part overrides what it has something to show of.

    Attributes
    ----------
    views
        What it shows of events, by their kind.
    """

    views: ClassVar[Views] = {}

    def event(self, event: Event) -> None:
        """Take an event; one of a kind without a view here is not shown by this part."""
        view = self.views.get(type(event))
        if view is not None:
            view(self, event)

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

    def flush(self, before_ns: int | None = None) -> None:
        """Log what is pending; lanes up to a time [ns], as channels lag behind each other."""

    def close(self) -> None:
        """Log what was held back."""
