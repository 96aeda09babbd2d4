"""Pipelines as values: the shipped ones by name, with other parameters, as TOML."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import msgspec

from groundtrace_codecs.signals import SEISMIC_QUANTITIES

from ..errors import RecordingError
from ..explain.suitability import SIGNALS, fitting_pipelines
from ..pipeline.chain import build_pipeline
from ..pipeline.config import PipelineConfig, load_pipeline, named_pipelines, with_settings
from ..pipeline.parameters import build, describe
from ..pipeline.plugins import stage_named
from .tables import html_table

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from groundtrace_codecs.geometry import Geometry
    from groundtrace_codecs.recording import Recording


def fitting_pipeline(recording: Recording) -> str | None:
    """Return the pipeline for what a recording states and holds; None where it does not tell."""
    moves = all(_has(recording, each) for each in ("acceleration", "angular_velocity"))
    if _seismic_channels(recording):
        # of a floor with walls the truth, which lies amid the signal, need not be read
        indoors = recording.geometry is not None and bool(recording.geometry.outline)
        if not indoors and "trigger" in _truth(recording):
            return "hammer-shots"
    elif moves and not _on_foot(recording) and "step" not in (truth := _truth(recording)):
        if truth & {"heading", "disturbed"}:
            return "heading"
        if "waypoint" in truth:
            return "pedestrian"
    suggested = steps_pipeline(recording)
    if suggested is None and _seismic_channels(recording) and "step" in _truth(recording):
        return "floor-steps"
    return suggested


def steps_pipeline(recording: Recording) -> str | None:
    """Return the pipeline for the steps or vehicles that signals are of, whatever the truth."""
    seismic = _seismic_channels(recording)
    if recording.geometry is not None and recording.geometry.road and seismic:
        return _beside_a_road(recording.geometry)
    if recording.geometry is not None and recording.geometry.sensors and seismic >= 3:
        return "room-footsteps"
    if seismic and any("floor" in (s.placement or "") for s in recording.streams):
        return "floor-steps"
    if _on_foot(recording):
        return "foot-inertial"
    if _has(recording, "acceleration") or _has(recording, "acceleration_magnitude"):
        return "waist-steps"
    return None


def _truth(recording: Recording) -> set[str]:
    return {label.kind for label in recording.labels}


def _seismic_channels(recording: Recording) -> int:
    return sum(len(s.columns_of(SEISMIC_QUANTITIES)) for s in recording.streams)


def _has(recording: Recording, quantity: str) -> bool:
    return any(s.columns_of({quantity}) for s in recording.streams)


def _on_foot(recording: Recording) -> bool:
    """Whether a sensor of both motions is stated to be on a foot."""
    feet = [s for s in recording.streams if "foot" in (s.placement or "")]
    both = ("acceleration", "angular_velocity")
    return all(any(s.columns_of({quantity}) for s in feet) for quantity in both)


def suggested_pipelines(recording: Recording) -> list[str]:
    """Return the shipped pipelines that fit a recording; the one taken by default comes first."""
    fitting = fitting_pipelines(recording.streams, recording.geometry)
    first = fitting_pipeline(recording)
    return sorted(fitting, key=lambda name: name != first)


def _beside_a_road(geometry: Geometry) -> str:
    """Return the pipeline for vehicles: passes at stations in a line beside it, else tracks."""
    stations = geometry.stations()
    few = len(stations.names) < 3
    return "vehicle-passes" if few or stations.in_line() else "vehicle-tracks"


def default_pipeline(recording: Recording) -> str:
    """Return the pipeline for what a recording holds.

    Raises
    ------
    RecordingError
        Where it does not tell.
    """
    fitting = fitting_pipeline(recording)
    if fitting is not None:
        return fitting
    topics = ", ".join(s.topic for s in recording.streams) or "no signals"
    raise RecordingError(
        f"{recording.name}: expected --pipeline NAME (groundtrace pipelines lists them; "
        f"{SIGNALS} shows the signals alone), since a recording with {topics} tells no pipeline "
        "by itself"
    )


@dataclass(frozen=True, repr=False)
class Pipeline:
    """Stages that find events in a recording, with their parameters.

    Made by ``pipelines``, and changed by :meth:`with_`, which returns another one.

    Attributes
    ----------
    config
        The pipeline as written.

    Examples
    --------
    >>> from groundtrace import pipelines
    >>> changed = pipelines["waist-steps"].with_(steps__share=0.1)
    >>> changed.parameters["steps.share"]
    0.1
    >>> pipelines["waist-steps"].parameters["steps.share"]
    0.15
    """

    config: PipelineConfig

    @property
    def name(self) -> str:
        """Its name."""
        return self.config.name

    @property
    def description(self) -> str:
        """What it is for, in a line."""
        return self.config.description

    @property
    def stages(self) -> tuple[str, ...]:
        """Names of the stages, in their order."""
        return tuple(stage.key for stage in self.config.stage)

    @property
    def parameters(self) -> dict[str, Any]:
        """Every parameter with its value, by ``stage.parameter``; units are in :meth:`to_toml`."""
        return {name: value for name, value, _, _ in self._rows()}

    def with_(self, settings: Mapping[str, Any] | None = None, /, **named: Any) -> Pipeline:
        """Return the pipeline with other values of some parameters.

        Parameters
        ----------
        settings
            Values by ``stage.parameter``, as a remedy or the best of a sweep gives them.
        **named
            The same by ``stage__parameter``.

        Raises
        ------
        Error
            Where there is no such stage or parameter, or the value is of another type or out of
            range.
        """
        stages = {stage.key.replace("-", "_"): stage.key for stage in self.config.stage}
        changed = dict(settings or {})
        for name, value in named.items():
            stage, _, parameter = name.rpartition("__")
            changed[f"{stages.get(stage, stage)}.{parameter}"] = value
        return Pipeline(with_parameters(self.config, changed))

    def to_toml(self) -> str:
        """Return the pipeline as TOML, every parameter with its value and unit."""
        return build_pipeline(self.config).recipe()

    def _rows(self) -> Iterator[tuple[str, Any, str, str]]:
        """Yield name, value, unit and meaning of every parameter."""
        for stage in self.config.stage:
            kind = stage_named(stage.use)
            values = build(kind.Parameters, stage.parameters, stage.key)
            for info in describe(kind.Parameters):
                yield f"{stage.key}.{info.name}", getattr(values, info.name), info.unit, info.doc

    def __repr__(self) -> str:
        return f"Pipeline({self.name}, {' > '.join(self.stages) or 'signals alone'})"

    def _repr_html_(self) -> str:
        header = ("parameter", "value", "unit", "")
        return html_table(f"{self.name}: {self.description}", header, list(self._rows()))


def with_parameters(config: PipelineConfig, settings: Mapping[str, Any]) -> PipelineConfig:
    """Return a pipeline with other values, checked, by ``stage.parameter``.

    Raises
    ------
    PipelineError, PluginError
        As :func:`~.pipeline.config.checked_pipeline` does, in the same words.
    """
    return with_settings(config, (f"{name}={setting_text(v)}" for name, v in settings.items()))


def setting_text(value: Any) -> str:
    """Return a value so that a setting reads the same."""
    value = value.item() if hasattr(value, "item") else value
    return repr(value) if isinstance(value, float) else msgspec.json.encode(value).decode()


class Pipelines(Mapping[str, Pipeline]):
    """The shipped pipelines by their names; a file of another one is found by its path.

    Examples
    --------
    >>> from groundtrace import pipelines
    >>> "waist-steps" in pipelines
    True
    >>> pipelines["waist-steps"]
    Pipeline(waist-steps, steps)
    """

    def __getitem__(self, name: str | Path) -> Pipeline:
        return Pipeline(load_pipeline(str(name)))

    def __contains__(self, name: object) -> bool:
        return name in named_pipelines()

    def __iter__(self) -> Iterator[str]:
        return iter(named_pipelines())

    def __len__(self) -> int:
        return len(named_pipelines())

    def __repr__(self) -> str:
        return f"Pipelines({', '.join(self)})"

    def _repr_html_(self) -> str:
        rows = ((p.name, " > ".join(p.stages), p.description) for p in self.values())
        return html_table("pipelines", ("pipeline", "stages", "for"), rows, len(self))


pipelines = Pipelines()
