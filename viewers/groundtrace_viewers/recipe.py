"""The pipeline of a session read back: which plugin a stage runs, and with which parameters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from groundtrace.errors import PipelineError, PluginError
from groundtrace.parameters import build
from groundtrace.pipeline import STAGE_GROUPS, parse_pipeline
from groundtrace.plugins import find

if TYPE_CHECKING:
    from groundtrace.sinks import Session
    from groundtrace_codecs.events import StageSpec


@dataclass(frozen=True, slots=True)
class Used:
    """A plugin as a stage uses it: its class, its parameters and its topics."""

    kind: type[Any]
    parameters: Any
    topics: tuple[str, ...]


def used(session: Session, spec: StageSpec) -> Used | None:
    """Return what a stage runs; None where the session does not say, or it is not installed."""
    try:
        config = parse_pipeline(session.pipeline.encode(), session.name)
        stage = next(s for s in config.stage if (s.key, s.use) == (spec.stage, spec.plugin))
        _, kind = find(STAGE_GROUPS, stage.use)
        return Used(kind, build(kind.Parameters, stage.parameters, stage.key), stage.topics)
    except (PipelineError, PluginError, StopIteration):
        return None
