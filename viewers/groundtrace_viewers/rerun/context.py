"""What every view is given: where to draw, what is replayed, and what views share."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

from groundtrace_codecs.events import Pick, StageSpec
from groundtrace_codecs.signals import SignalBlock

from .samples import Traces
from .timeline import FIX_COLOURS, Entity, SensorColours, StageLanes, Timeline

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    import rerun as rr

    from groundtrace.pipeline.engine import ReplaySession
    from groundtrace_codecs.events import Event, StepEvent

    from .samples import Plan
    from .timeline import Bounds


def step_like(spec: StageSpec) -> bool:
    """Whether accepted candidates become steps, which have marks of their own on the lane."""
    return spec.emits in ("step", "impact")


class LogLines:
    """Lines of text at times."""

    def __init__(self, timeline: Timeline) -> None:
        self._timeline = timeline
        self._pending: dict[str, list[tuple[int, str, str]]] = {}

    def add(self, kind: str, time_ns: int, text: str, level: str) -> None:
        """Take a line; ``kind`` names its entity."""
        self._pending.setdefault(kind, []).append((time_ns, text, level))

    def flush(self) -> None:
        """Log what is pending."""
        import rerun as rr

        for kind, lines in self._pending.items():
            path = f"/log/{kind}"
            self._timeline.declare(Entity(path, "log"))
            times, texts, levels = zip(*lines, strict=True)
            columns = rr.TextLog.columns(text=list(texts), level=list(levels))
            self._timeline.send(path, times, columns)
        self._pending.clear()


class Stages:
    """The stages that were announced: the last one of a kind is the one reported for its topic."""

    def __init__(self) -> None:
        self._last: dict[tuple[str, str], StageSpec] = {}
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def add(self, spec: StageSpec) -> None:
        """Take a stage."""
        kind = "step" if step_like(spec) else spec.emits
        self._last[kind, spec.topic] = self._last[kind, ""] = spec
        self._count += 1

    def last(self, kind: str, topic: str = "") -> StageSpec | None:
        """Return the last stage that gives a kind of event, ``step`` for impacts too."""
        return self._last.get((kind, topic))

    def decides(self, kind: str, event: Pick | StepEvent) -> bool:
        """Whether an event is of the stage that is reported for its kind and topic."""
        last = self.last(kind, event.topic)
        return last is None or last.stage == event.stage


class ViewContext:
    """What views are made with, and share.

    Parameters
    ----------
    recording
        Where to.
    session
        What is replayed.
    plan
        What is shown at full rate.
    chunk_s
        Duration of a chunk of signal [s]; None chooses by the rate.
    map_tiles
        Show a street map.
    channels
        Whose spectrograms are shown; empty takes the first seismic channel's.
    watched
        Somebody looks on while it is replayed: what is drawn in the end is drawn as it comes, too.

    Attributes
    ----------
    timeline, colours, lanes, lines, traces, stages
        Where everything is drawn, the sensors' colours, the lanes of stages, the log, the last
        samples, and the stages so far.
    span_ns
        What is shown of the recording: start and end [ns].
    replayed_ns
        First and last sample so far [ns]; None before the first.
    opens_ns
        Where a viewer opens: the first event, in the end the first wrong step [ns]; None before.
    answers_ns
        Detected steps, or picks where no stage finds steps, that no close-up knows yet [ns].
    drawn, drawn_lanes
        Stages and topics whose decision function, and whose lane, a view of their own draws.
    summed
        Kinds of event that a view tells in lines of its own, one for many.
    """

    def __init__(
        self,
        recording: rr.RecordingStream,
        session: ReplaySession,
        plan: Plan,
        *,
        chunk_s: float | None = None,
        map_tiles: bool = False,
        channels: Sequence[str] = (),
        watched: bool = False,
    ) -> None:
        self.timeline = Timeline(recording, session.start_ns)
        self.session, self.plan = session, plan
        self.chunk_s, self.map_tiles, self.channels = chunk_s, map_tiles, channels
        self.watched = watched
        self.colours = SensorColours(session)
        self.lanes = StageLanes(self.timeline, ordered=True)
        self.lines = LogLines(self.timeline)
        self.traces = Traces(session.streams)
        self.stages = Stages()
        self.span_ns = session.shown_ns or (session.start_ns, session.end_ns)
        self.replayed_ns: tuple[int, int] | None = None
        self.opens_ns: int | None = None
        self.answers_ns: list[int] = []
        self.drawn: set[tuple[str, str]] = set()
        self.drawn_lanes: set[tuple[str, str]] = set()
        self.summed: set[str] = set()
        self._places: list[str] = []

    def take(self, item: SignalBlock | Event) -> None:
        """Take an item before the views do: the last samples and the stages are known to all."""
        if isinstance(item, SignalBlock):
            first_ns, _ = self.replayed_ns or (item.start_ns, 0)
            self.replayed_ns = first_ns, item.last_ns
            self.traces.push(item)
        elif isinstance(item, Pick):
            self.traces.arrival(item.topic, item.time_ns)
        elif isinstance(item, StageSpec):
            self.stages.add(item)

    def opens(self, time_ns: int) -> None:
        """Remember an event: a viewer opens at the first one."""
        if self.opens_ns is None or time_ns < self.opens_ns:
            self.opens_ns = time_ns

    def place_colour(self, stage: str) -> int:
        """Return the colour of the places of a stage: those that ask first have the first ones."""
        if stage not in self._places:
            self._places.append(stage)
        return FIX_COLOURS[self._places.index(stage) % len(FIX_COLOURS)]


class View:
    """Draws some kinds of item; knows what views share, never other views.

    Attributes
    ----------
    kinds
        By the kind of event, or ``SignalBlock``: the method that takes one.
    """

    kinds: ClassVar[Mapping[type[Any], Callable[[Any, Any], None]]] = {}

    def __init__(self, context: ViewContext) -> None:
        """Log what is known from the beginning."""

    @staticmethod
    def fits(context: ViewContext) -> bool:  # noqa: ARG004
        """Whether a session has this view."""
        return True

    def add(self, item: SignalBlock | Event) -> None:
        """Take an item of one of its kinds."""
        self.kinds[type(item)](self, item)

    def close_up(self, start_ns: int, end_ns: int) -> None:
        """Show every sample of a half-open span."""

    def near(self, time_ns: int) -> None:
        """Show what belongs to every sample around a moment; steps come before their moments."""

    def flush(self, before_ns: int | None = None) -> None:
        """Log what is pending; lanes up to a time [ns], as channels lag behind each other."""

    def close(self) -> None:
        """End: take what was held back; a last :meth:`flush` follows."""

    @property
    def bounds(self) -> Bounds | None:
        """What a map must show for this view; None where it says nothing of it."""
        return None
