"""The pipeline of a session read back: what a stage runs, and how to replay it once more."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from groundtrace.errors import PipelineError, PluginError
from groundtrace.parameters import build
from groundtrace.pipeline import STAGE_GROUPS, parse_pipeline
from groundtrace.plugins import find

if TYPE_CHECKING:
    from pathlib import Path

    from groundtrace.results import Results
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


def written_recipe(results: Results, folder: Path) -> tuple[Path, Path | None]:
    """Write what results were made with, for another replay.

    Parameters
    ----------
    results
        Of an earlier replay.
    folder
        Where to.

    Returns
    -------
    The pipeline's file, and that of the geometry or None without one.
    """
    pipeline, geometry = folder / "pipeline.toml", folder / "geometry.toml"
    pipeline.write_text(results.provenance.pipeline, "utf-8")
    if results.geometry is None:
        return pipeline, None
    geometry.write_text(results.geometry.to_toml(), "utf-8")
    return pipeline, geometry
