"""Parts of a result: which stage located, which found the steps, which picked, and how."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.events import Pick

from ..errors import RecordingError
from ..localizers.api import LocalizerParameters
from ..plugins import stage_named

if TYPE_CHECKING:
    from .evidence import Evidence, StageEvidence


def locating(evidence: Evidence, stage: str = "") -> StageEvidence:
    """Return the evidence of the stage that locates by arrivals: the named one, else the last.

    Raises
    ------
    RecordingError
        Where there is none.
    """
    uses = {config.key: config.use for config in evidence.config.stage}
    parts = [
        p for p in evidence.stages if p.spec.emits == "fix" and by_arrivals(uses[p.spec.stage])
    ]
    names = list(dict.fromkeys(p.spec.stage for p in parts))
    wanted = stage or (names[-1] if names else "")
    found = [p for p in parts if p.spec.stage == wanted]
    if not found:
        expected = f"one of {', '.join(names)}" if names else "a stage that located steps"
        lacking = "none (without the sensors' places nothing is located)"
        raise RecordingError(f"{evidence.name}: expected {expected}, found {stage or lacking}")
    return max(found, key=lambda part: len(part.candidates))


def by_arrivals(plugin: str) -> bool:
    """Whether a plugin locates by arrivals: others give places by directions."""
    kind: Any = stage_named(plugin)
    return issubclass(kind.Parameters, LocalizerParameters)


def before(evidence: Evidence, part: StageEvidence, emits: tuple[str, ...]) -> StageEvidence:
    """Return the evidence of the last stage before one, on its topic, that emits a kind of event.

    Raises
    ------
    RecordingError
        Where there is none.
    """
    order = [stage.key for stage in evidence.config.stage]
    earlier = order[: order.index(part.spec.stage)]
    found = [
        p
        for p in evidence.stages
        if p.spec.stage in earlier and p.spec.emits in emits and p.spec.topic == part.spec.topic
    ]
    if not found:
        raise RecordingError(
            f"{evidence.name}: {part.spec.stage}: expected a stage that gives "
            f"{' or '.join(emits)} before it, found none"
        )
    return max(found, key=lambda p: earlier.index(p.spec.stage))


def accepted_picks(part: StageEvidence) -> list[Pick]:
    """Return the picks of a stage on one topic, as decided."""
    c, spec = part.candidates, part.spec
    return [
        Pick(
            int(c.time_ns[row]),
            spec.channels[int(c.channel[row])],
            spec.topic,
            spec.stage,
            float("nan"),
            float(c.value[row, 0]),
        )
        for row in np.flatnonzero(part.accepted)
    ]


def onsets_of(evidence: Evidence, picking: StageEvidence) -> StageEvidence:
    """Return the stage whose onsets a picking stage has: itself, or of an array method its source.

    An array method mends the arrivals of a step by each other, which hides in part what is wrong
    with one channel; onsets are picked channel by channel.
    """
    uses = {config.key: config.use for config in evidence.config.stage}
    while any(n.buffered for n in stage_named(uses[picking.spec.stage]).takes):
        picking = before(evidence, picking, ("pick",))
    return picking
