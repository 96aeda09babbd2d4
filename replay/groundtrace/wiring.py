"""Which stage of a pipeline takes from which."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from groundtrace_codecs.events import EVENTS, Gap, Presence
from groundtrace_codecs.labels import Label
from groundtrace_codecs.signals import SignalBlock

from .errors import PipelineError
from .heading_stage import HeadingStage
from .inertial.stage import NavigatorStage
from .reckoning.stage import ReckoningStage
from .step_type_stage import StepTypeStage
from .track_check import Tracking
from .vehicle_ratio_stage import RatioStage
from .vehicle_stage import VehicleStage

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from groundtrace_codecs.geometry import Geometry

    from .passing import Taking
    from .stage import Input, Stage, StageConfig

    #: Name, plugin, class, parameters and topics of a stage.
    Given = tuple[str, str, type[Any], Any, tuple[str, ...]]


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
        wired(stage, kind, list(zip(stages, kinds, strict=True))[:index])
        for index, (stage, kind) in enumerate(zip(stages, kinds, strict=True))
    )


def wired(
    stage: StageConfig, kind: type[Stage], before: Sequence[tuple[StageConfig, Any]]
) -> dict[Input, tuple[str, ...]]:
    """Return whom the inputs of a stage take from, of the stages before it."""
    found: dict[Input, tuple[str, ...]] = {}
    missing = []
    for need in kind.takes:
        if need.kind is Label and set(kind.Parameters.__dataclass_fields__) >= {"updates"}:
            continue
        if need.kind in (SignalBlock, Gap):
            continue
        wanted = need.of or need.kind
        giving = [one.key for one, other in before if _gives(other, wanted)]
        named = _named(stage, kind, giving)
        if need.every and len(giving) < 2:
            there = ", ".join(giving) or "none"
            raise PipelineError(f"{stage.key}: expected two localizers before it, found {there}")
        if need.required and not giving:
            missing.append(GIVING[wanted])
        found[need] = named or _of(giving, need)
    if missing:
        raise PipelineError(
            f"{stage.key}: expected a stage that {' and one that '.join(missing)} before it, found "
            f"none"
        )
    return found


def check_window(key: str, after_s: float, window_s: float, stepping: str) -> None:
    """Refuse a stage that looks at signal later than a step is sure to be announced."""
    if after_s > window_s:
        raise PipelineError(
            f"{key}.after_s: expected at most the {window_s:g} s that {stepping} waits, found "
            f"{after_s:g}"
        )


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


def _gives(kind: Any, event: type[Any]) -> bool:
    """Return whether a stage gives a type of event."""
    if hasattr(kind, "gives"):
        return event in kind.gives
    return bool(EVENTS[event].name == kind.emits)


@dataclass(slots=True)
class Before:
    """The stages so far that others take from: the last that picks, the last that finds steps.

    And all that locate: of them a tracker takes one. And all that track.

    Attributes
    ----------
    placements
        Where sensors are worn that the recording does not say, by topic.
    picking, stepping, pointing, hearing, locating
        Names of the stages.
    tracking
        The stages that track, and what they take.
    window_s
        How long after a step's first arrival the stage that finds steps waits [s]; 0 for one that
        announces at once.
    """

    placements: Mapping[str, str] = field(default_factory=dict)
    picking: str = ""
    stepping: str = ""
    pointing: str = ""
    hearing: str = ""
    window_s: float = 0.0
    locating: list[str] = field(default_factory=list)
    tracking: list[Tracking] = field(default_factory=list)

    def stage(
        self, group: str, given: Given, geometry: Geometry | None, labels: Sequence[Label] = ()
    ) -> Taking:
        """Return the stage of a plugin, taking from the stages before it."""
        key = given[0]
        if group == "classifiers":
            return StepTypeStage(*given, stepping=self.stepped(key))
        if group == "headings":
            return HeadingStage(*given)
        if group in ("vehicles", "ratios"):
            kind = VehicleStage if group == "vehicles" else RatioStage
            return kind(*given, hearing=self.heard(key), geometry=geometry)
        if group == "navigators":
            return NavigatorStage(*given)
        if group == "reckoners":
            start = (geometry.start if geometry is not None else None) or (0.0, 0.0)
            stepping = self.stepped(key)
            return ReckoningStage(*given, stepping=stepping, start=start, labels=labels)
        raise AssertionError(group)

    def add(self, group: str, key: str, emits: str, parameters: Any) -> None:
        """Count a stage in by what it emits."""
        if emits == "pick":
            self.picking = key
        elif emits in ("step", "impact"):
            self.stepping = key
            self.window_s = getattr(parameters, "window_s", 0.0)
        elif emits == "bearing":
            self.pointing = key
        elif emits == "presence":
            self.hearing = key
        elif emits == "fix":
            self.locating.append(key)
        elif emits == "track":
            self.tracking.append(self._tracks(group, key, parameters))

    def _tracks(self, group: str, key: str, parameters: Any) -> Tracking:
        """Return what a stage that tracks takes, and from whom."""
        if group == "trackers":
            return Tracking(key, "fixes", self.tracked(key, parameters.source))
        if group == "reckoners":
            return Tracking(key, "steps", self.stepped(key))
        taken = "three axes of a foot" if group == "navigators" else "vehicles at stations"
        return Tracking(key, taken)

    def stepped(self, key: str) -> str:
        """Return whose steps a stage takes; refuse one with none to take."""
        if not self.stepping:
            raise PipelineError(f"{key}: expected a stage that gives steps before it, found none")
        return self.stepping

    def heard(self, key: str) -> str:
        """Return whose cycles a stage of vehicles takes; refuse one with none to take."""
        if not self.hearing:
            raise PipelineError(
                f"{key}: expected a stage that hears vehicles before it, found none"
            )
        return self.hearing

    def tracked(self, key: str, wanted: str) -> str:
        """Return whose fixes a tracker takes: of the stage it wants, else of the first."""
        if not self.locating or wanted not in ("", *self.locating):
            expected = f"one of {', '.join(self.locating)}" if self.locating else "a localizer"
            raise PipelineError(
                f"{key}.source: expected {expected} before a tracker, found {wanted or 'none'}"
            )
        return wanted or self.locating[0]
