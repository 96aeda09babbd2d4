"""The pipeline of a session read back: what a stage runs, and how to replay it once more."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from groundtrace.errors import PipelineError, PluginError
from groundtrace.parameters import build
from groundtrace.pipeline import parse_pipeline
from groundtrace.plugins import stage_named
from groundtrace_codecs.signals import NS_PER_S

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
        kind = stage_named(stage.use)
        return Used(kind, build(kind.Parameters, stage.parameters, stage.key), stage.topics)
    except (PipelineError, PluginError, StopIteration):
        return None


@dataclass(frozen=True, slots=True)
class Recipe:
    """What a replay is made with: the names of ``groundtrace replay``'s options.

    Attributes
    ----------
    pipeline
        The pipeline's file.
    geometry
        The geometry's file; None without one.
    from_, to
        The span, in seconds after the first sample; None where it is the recording's end.
    """

    pipeline: Path
    geometry: Path | None
    from_: float | None
    to: float | None


def written_recipe(results: Results, folder: Path) -> Recipe:
    """Write what results were made with, for another replay.

    Parameters
    ----------
    results
        Of an earlier replay.
    folder
        Where to.
    """
    origin = results.provenance
    pipeline, geometry = folder / "pipeline.toml", folder / "geometry.toml"
    pipeline.write_text(origin.pipeline, "utf-8")
    if results.geometry is not None:
        geometry.write_text(results.geometry.to_toml(), "utf-8")
    return Recipe(
        pipeline,
        None if results.geometry is None else geometry,
        _since(origin.from_ns, origin.start_ns),
        _since(origin.to_ns, origin.start_ns),
    )


def _since(time_ns: int | None, start_ns: int) -> float | None:
    return None if time_ns is None else (time_ns - start_ns) / NS_PER_S
