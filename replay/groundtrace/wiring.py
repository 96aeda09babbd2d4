"""Which stage of a pipeline takes from which."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from groundtrace_codecs.events import EVENTS, Fix, Gap, Presence, StepEvent
from groundtrace_codecs.labels import Label
from groundtrace_codecs.signals import SignalBlock

from .errors import PipelineError
from .track_check import Tracking

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from .stage import Input, Stage, StageConfig


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
    found: dict[Input, tuple[str, ...]] = {}
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
        found[need] = named or _of(giving, need)
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
    return found


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
