"""The chain of stages of a pipeline: built as written, wired by what they take and give, run."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

from groundtrace_codecs.events import (
    EVENTS,
    Fix,
    Gap,
    Label,
    Presence,
    StageSpec,
    StepEvent,
    TrackPoint,
)
from groundtrace_codecs.geometry import UNKNOWN_UNIT
from groundtrace_codecs.signals import SignalBlock
from groundtrace_codecs.toml import toml_value

from ..errors import PipelineError
from .parameters import build, describe
from .plugins import stage_named
from .source import BRIDGE_S
from .stage import Memory, StageRunner
from .track_check import TrackCheck, Tracking

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from groundtrace_codecs.events import Event
    from groundtrace_codecs.geometry import Geometry

    from .config import PipelineConfig
    from .parameters import StageConfig
    from .stage import Input, Stage

RECIPE_KEYS = ("name", "description", "application")
#: Written in a recipe where it is not empty.
PLACEMENTS = "placements"


class Pipeline:
    """A chain of stages: each sees the item and what the stages before it made of it.

    At the end of the recording the tracks are checked.
    """

    def __init__(
        self,
        config: PipelineConfig,
        stages: Sequence[Taking],
        resolved: str,
        check: TrackCheck | None = None,
        memories: Mapping[str, Memory] | None = None,
        measured: Mapping[str, Memory] | None = None,
    ) -> None:
        self.config = config
        #: By name of a stage, of how much signal its results depend on; and what it measures of
        #: steps before it learns, where it does.
        self.memories, self.measured = dict(memories or {}), dict(measured or {})
        self.stages = tuple(stages)
        self._resolved = resolved
        self._check = check or TrackCheck(config.application, (), metric=False)

    @property
    def runs_ahead(self) -> bool:
        """Whether the first stage needs nothing of what the others do: another core may run it."""
        if any(getattr(stage, "in_step", False) for stage in self.stages):
            return False
        return all(getattr(stage, "runs_ahead", True) for stage in self.stages[:1])

    @property
    def bridge_s(self) -> float:
        """How long a gap may be that is filled for all of its stages [s]."""
        return bridge_of(self._kinds)

    @property
    def compiles(self) -> set[str]:
        """Files of compiled functions that its stages say they run."""
        return {name for kind in self._kinds for name in getattr(kind, "compiles", ())}

    @property
    def _kinds(self) -> list[type[Stage]]:
        """The classes of its stages, of those that have some."""
        kinds = (getattr(stage, "kind", None) for stage in self.stages)
        return [kind for kind in kinds if kind is not None]

    def with_stages(self, stages: Sequence[Taking]) -> Pipeline:
        """Return the same pipeline with others in the place of its stages."""
        of = self.memories, self.measured
        return Pipeline(self.config, stages, self._resolved, self._check, *of)

    @property
    def memory(self) -> Memory:
        """How much signal the results of a time depend on, whatever stage they are of."""
        return Memory.longest([self.memories.get(s.name, Memory()) for s in self.stages])

    def recipe(self) -> str:
        """Return the pipeline as TOML, every parameter with its value and unit."""
        return self._resolved

    def process(self, item: SignalBlock | Event) -> list[Event]:
        """Feed an item; return the events of all stages, each before what is made of it."""
        return self.go_on(item, self.begin(item))

    def begin(self, item: SignalBlock | Event) -> list[Event]:
        """Feed an item to the first stage alone, which needs nothing of what the others do."""
        return list(self.stages[0].process(item)) if self.stages else []

    def go_on(self, item: SignalBlock | Event, begun: list[Event]) -> list[Event]:
        """Feed an item, and what the first stage made of it, to the others; return all events."""
        events = begun if len(self.stages) < 2 else self._passed_on(item, begun)
        self._check.update(events, item.start_ns if isinstance(item, SignalBlock) else 0)
        return events

    def _passed_on(self, item: SignalBlock | Event, begun: list[Event]) -> list[Event]:
        if isinstance(item, SignalBlock):
            for stage in self.stages:
                if getattr(stage, "buffers", False):
                    stage.buffer(item)  # type: ignore[attr-defined]
        born = [StageOutput(event) for event in begun]
        output = StageOutput(item, list(born))
        propagate([*born, output], self.stages[1:])
        return self._stated_first(output.events())

    def _stated_first(self, events: list[Event]) -> list[Event]:
        """Return events with what stages state before all others, in the order of the stages."""
        stated = [event for event in events if isinstance(event, StageSpec)]
        if not stated:
            return events
        order = [stage.name for stage in self.stages]
        stated.sort(key=lambda spec: order.index(spec.stage))
        return [*stated, *(event for event in events if not isinstance(event, StageSpec))]

    def flush(self) -> list[Event]:
        """End of the recording: return what the stages held back."""
        events: list[Event] = []
        for index, stage in enumerate(self.stages):
            outputs = [StageOutput(event) for event in stage.flush()]
            propagate(outputs, self.stages[index + 1 :])
            for made in outputs:
                events += [made.item, *made.events()]
        self._check.update(events)
        return [*events, *self._check.flush()]


def build_pipeline(
    config: PipelineConfig, geometry: Geometry | None = None, labels: Sequence[Label] = ()
) -> Pipeline:
    """Load the plugins of a pipeline and give them their parameters.

    Parameters
    ----------
    config
        The pipeline as written.
    geometry
        Where the sensors are; without it localizers find no places.
    labels
        Of the recording: its waypoints go to a stage that asks for them, and to no other.

    Raises
    ------
    PipelineError, PluginError
        An unknown plugin, key, type or value out of range, or a localizer or tracker without what
        it needs before it, in one line.
    """
    kinds = [stage_named(stage.use) for stage in config.stage]
    given = [
        build(kind.Parameters, stage.parameters, stage.key)
        for stage, kind in zip(config.stage, kinds, strict=True)
    ]
    wired = wire(config.stage, kinds)
    windows = {s.key: getattr(p, "window_s", 0.0) for s, p in zip(config.stage, given, strict=True)}
    stages, tracked = [], []
    memories: dict[str, Memory] = {}
    measured: dict[str, Memory] = {}
    for stage, kind, parameters, sources in zip(config.stage, kinds, given, wired, strict=True):
        window_s = waits_s(stage.key, parameters, sources, windows)
        stages.append(
            StageRunner(
                stage,
                kind,
                parameters,
                sources,
                geometry,
                labels,
                placements=config.placements,
                window_s=window_s,
            )
        )
        before = dict.fromkeys(name for names in sources.values() for name in names)
        taken = [memories[name] for name in before]
        memories[stage.key] = stages[-1].memory.behind(taken)
        if (measured_memory := stages[-1].measured) is not None:
            measured[stage.key] = measured_memory.behind(taken)
        if TrackPoint in kind.gives:
            tracked.append(tracking(stage.key, kind, sources))
    lines = [f"{key} = {toml_value(getattr(config, key))}" for key in RECIPE_KEYS]
    lines += [f"{PLACEMENTS} = {toml_value(config.placements)}"] if config.placements else []
    needs = {key: value for key, value in asdict(config.needs).items() if value}
    lines += [f"needs = {toml_value(needs)}"] if needs else []
    lines += [] if config.stage else ["stage = []"]
    for stage, kind, parameters in zip(config.stage, kinds, given, strict=True):
        lines += _stage_recipe(stage, kind.Parameters, asdict(parameters))
    metric = geometry is None or geometry.unit != UNKNOWN_UNIT
    check = TrackCheck(config.application, tracked, metric=metric)
    return Pipeline(config, stages, "\n".join(lines) + "\n", check, memories, measured)


def _stage_recipe(stage: StageConfig, kind: type[Any], values: dict[str, Any]) -> list[str]:
    lines = ["", "[[stage]]", f"name = {toml_value(stage.key)}", f"use = {toml_value(stage.use)}"]
    names = {"topics": stage.topics, "source": stage.source}
    lines += [f"{key} = {toml_value(list(given))}" for key, given in names.items() if given]
    lines.append("[stage.parameters]")
    lines += [
        f"{info.name} = {toml_value(values[info.name])}  # {info.unit}; {info.part}"
        for info in describe(kind)
    ]
    return lines


#: What is said of a stage that gives a kind of event.
GIVING = {kind: f"gives {row.name}s" for kind, row in EVENTS.items()}
GIVING[Presence] = "hears vehicles"


def wire(
    stages: Sequence[StageConfig], kinds: Sequence[type[Stage]]
) -> tuple[Mapping[Input, tuple[str, ...]], ...]:
    """Return whom each input of each stage takes from.

    In the order of the pipeline each takes from the last earlier stage that gives what it takes, or
    as the input says, or from those that the stage names as its ``source``.

    Raises
    ------
    PipelineError
        Where what a stage takes is not given before it, or a source is named that does not give it.
    """
    return tuple(
        _wired(stage, kind, list(zip(stages, kinds, strict=True))[:index])
        for index, (stage, kind) in enumerate(zip(stages, kinds, strict=True))
    )


def _wired(
    stage: StageConfig, kind: type[Stage], before: Sequence[tuple[StageConfig, Any]]
) -> dict[Input, tuple[str, ...]]:
    """Return whom the inputs of a stage take from, of the stages before it."""
    wired: dict[Input, tuple[str, ...]] = {}
    missing, unknown = [], set(stage.source)
    for need in kind.takes:
        if need.kind in (SignalBlock, Gap, Label):
            continue
        wanted = need.of or need.kind
        giving = [one.key for one, other in before if wanted in other.gives]
        named = _named(stage, kind, giving)
        if need.every and len(giving) < 2:
            there = ", ".join(giving) or "none"
            raise PipelineError(f"{stage.key}: expected two localizers before it, found {there}")
        if need.required and not giving:
            missing.append(GIVING[wanted])
        wired[need] = named or _of(giving, need)
        unknown -= set(giving)
    if missing:
        raise PipelineError(
            f"{stage.key}: expected a stage that {' and one that '.join(missing)} before it, found "
            f"none"
        )
    if unknown:
        raise PipelineError(
            f"{stage.key}.source: expected stages before it that give what it takes, found "
            f"{', '.join(sorted(unknown))}"
        )
    return wired


def waits_s(
    key: str,
    parameters: Any,
    sources: Mapping[Input, tuple[str, ...]],
    windows_s: Mapping[str, float],
) -> float:
    """Return how long the stage waits whose steps a stage looks back at the signal of [s].

    Parameters
    ----------
    key, parameters, sources
        The stage, and whom it takes from.
    windows_s
        How long after a step's first pick each stage waits for others [s].

    Raises
    ------
    PipelineError
        Where it looks at signal later than a step is sure to be announced.
    """
    if not any(need.kind is StepEvent for need in sources) or not hasattr(parameters, "after_s"):
        return 0.0
    (stepping,) = next(names for need, names in sources.items() if need.kind is StepEvent)
    window_s, after_s = windows_s[stepping], parameters.after_s
    if after_s > window_s:
        raise PipelineError(
            f"{key}.after_s: expected at most the {window_s:g} s that {stepping} waits, found "
            f"{after_s:g}"
        )
    return window_s


def _of(giving: Sequence[str], need: Input) -> tuple[str, ...]:
    """Return those of the stages that give something from which an input takes it."""
    if need.every:
        return tuple(giving)
    return tuple(giving[:1] if need.first else giving[-1:])


def _named(stage: StageConfig, kind: type[Stage], giving: Sequence[str]) -> tuple[str, ...]:
    """Return the sources that a stage names of those that give what it takes."""
    if "source" not in kind.Parameters.__dataclass_fields__:
        return tuple(name for name in stage.source if name in giving)
    wanted = stage.parameters.get("source", "")
    if not giving or wanted not in ("", *giving):
        expected = f"one of {', '.join(giving)}" if giving else "a localizer"
        raise PipelineError(
            f"{stage.key}.source: expected {expected} before a tracker, found {wanted or 'none'}"
        )
    return (wanted,) if wanted else tuple(name for name in stage.source if name in giving)


def tracking(key: str, kind: Any, sources: Mapping[Input, tuple[str, ...]]) -> Tracking:
    """Return what a stage that tracks takes, and from whom."""
    for need, names in sources.items():
        if need.kind in (Fix, StepEvent):
            return Tracking(key, EVENTS[need.kind].plural, names[0])
    return Tracking(key, getattr(kind, "needs", "signals"))


class Taking(Protocol):
    """What takes items along the line; many at once where it has a method ``process_all``."""

    name: str

    def process(self, item: SignalBlock | Event) -> Iterable[Event]:
        """Take one item; return the events it brings about."""

    def flush(self) -> Iterable[Event]:
        """End of the recording: return what was held back."""


@dataclass(slots=True)
class StageOutput:
    """An item, what stages made of it, one after the other, and what the last one did of it."""

    item: Any
    born: list[StageOutput] = field(default_factory=list)
    last: Sequence[Event] = ()

    def events(self) -> list[Event]:
        """Return what was made of the item, each event before what was made of that."""
        ordered: list[Event] = []
        for made in self.born:
            ordered.append(made.item)
            if made.born or made.last:
                ordered += made.events()
        ordered += self.last
        return ordered


def bridge_of(kinds: Iterable[type[Stage]]) -> float:
    """Return how long a gap may be that is filled for stages of these kinds [s]."""
    signal = (k for k in kinds if any(need.kind is SignalBlock for need in k.takes))
    return min((k.bridges_s for k in signal), default=BRIDGE_S)


def propagate(line: list[StageOutput], stages: Sequence[Taking]) -> None:
    """Let every stage take what comes along the line; what it makes of an item goes before it.

    So later stages see items in the order in which they would if each went through all stages
    before the next one came, while a stage that can takes many of them at once.
    """
    for stage in stages[:-1]:
        items = [made.item for made in line]
        longer: list[StageOutput] = []
        for made, events in zip(line, _made_by(stage, items), strict=True):
            if events:
                born = [StageOutput(event) for event in events]
                made.born += born
                longer += born
            longer.append(made)
        line = longer
    for stage in stages[-1:]:
        made_by = _made_by(stage, [made.item for made in line])
        for made, events in zip(line, made_by, strict=True):
            made.last = events


def _made_by(stage: Taking, items: Sequence[SignalBlock | Event]) -> list[list[Event]]:
    """Return what a stage makes of each of items that come one after the other."""
    at_once: Callable[..., list[list[Event]]] | None = getattr(stage, "process_all", None)
    if at_once is not None:
        return at_once(items)
    return [list(stage.process(item)) for item in items]
