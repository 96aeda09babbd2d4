"""A replay whose decisions are kept in memory, as the API gives it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..explain.suitability import prepared
from ..pipeline.config import PipelineConfig, load_pipeline
from ..pipeline.engine import EventList
from ..pipeline.results import Results as Decided
from ..pipeline.results import ResultsSink, given_to, replayed_labels
from .files import writable
from .pipelines import Pipeline, default_pipeline, with_parameters
from .recording import Recording, open_recording
from .replay import PlannedReplay
from .results import Results

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from groundtrace_codecs.events import Event

    from ..pipeline.results import Provenance


def replay(
    recording: Recording | str | Path,
    pipeline: Pipeline | str | Path = "",
    set: Mapping[str, Any] | None = None,  # noqa: A002  # as the option of the command
    out: str | Path | None = None,
    *,
    from_s: float | None = None,
    to_s: float | None = None,
    force: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Results:
    """Replay a recording through a pipeline; the decisions are kept in memory.

    They are those of ``groundtrace replay`` with the same pipeline and settings.

    Parameters
    ----------
    recording
        Of :func:`.recording.open_recording`, or what that takes.
    pipeline
        A pipeline, the name of a shipped one, or a TOML file; without it the one that fits the
        recording.
    set
        Values of parameters by ``stage.parameter``, e.g. those of a remedy.
    out
        Write the results to this file too.
    from_s, to_s
        Replay from <= time < to alone [s since the first sample].
    force
        Replace ``out`` where it exists.
    progress
        Called now and then with the part that is done, 0 to 1.

    Raises
    ------
    Error
        Where pipeline, settings or recording are not what they must be, do not suit each other, or
        ``out`` cannot be written.

    Examples
    --------
    >>> import groundtrace as gt
    >>> gt.replay("waist-walk", "waist-steps", to_s=20)
    Results(waist-walk.mcap, waist-steps, 27/27 steps, 0 false)
    """
    asked = configured(pipeline, set or {}) if pipeline else None
    if not isinstance(recording, Recording):
        recording = open_recording(recording)
    target = None if out is None else Path(out)
    with recording.opened() as file:
        config = asked or with_parameters(load_pipeline(default_pipeline(file)), set or {})
        ready = prepared(config, file)
        if target is not None:
            writable(target, force=force, sources=[recording.path])
        plan = PlannedReplay.of(file, recording.path, ready, from_s, to_s)
        origin, kept = plan.provenance(), EventList()
        written = [] if target is None else [ResultsSink(target, origin, force=force)]
        plan.run([kept, *written], progress=progress)
    name = f"{recording.path.stem}.results.mcap" if target is None else target.name
    return Results(_decided(name, plan, origin, tuple(kept.events)), recording.path, target)


def _decided(
    name: str, plan: PlannedReplay, origin: Provenance, events: tuple[Event, ...]
) -> Decided:
    """Return what a results file of the replay holds."""
    session = plan.session
    labels = replayed_labels(session.labels, *plan.span)
    given = given_to(origin.pipeline, session.labels)
    return Decided(name, origin, labels, session.geometry, events, session.annotations, given)


def configured(pipeline: Pipeline | str | Path, settings: Mapping[str, Any]) -> PipelineConfig:
    """Return a pipeline with settings, all names and values checked.

    Raises
    ------
    PipelineError, PluginError
        Where one is not what it must be.
    """
    config = pipeline.config if isinstance(pipeline, Pipeline) else load_pipeline(str(pipeline))
    return with_parameters(config, settings)
