"""Pipelines as written: TOML that names stages, typed and validated."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from groundtrace_codecs.errors import did_you_mean

from ..errors import PipelineError, SettingError, Usage
from .parameters import StageConfig, build, checked_value, parse_value
from .plugins import stage_named

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

APPLICATIONS = ("room", "walker", "vehicle", "shots")


@dataclass(frozen=True, slots=True)
class PipelineNeeds:
    """What a recording must have for a pipeline.

    Attributes
    ----------
    signals
        Sets of quantities of each of which a channel must be there, so that no stage is silent.
    seismic_channels
        So many at least.
    positions
        Whether those channels need positions in the geometry.
    placement
        Where the sensor must be worn, of which a recording may state no other place; a stated
        placement that has this word in it is right.
    """

    signals: tuple[tuple[str, ...], ...] = ()
    seismic_channels: int = 0
    positions: bool = False
    placement: str = ""


@dataclass(frozen=True, slots=True)
class PipelineConfig:
    """A pipeline as written.

    Attributes
    ----------
    name, description
        For people.
    application
        Kind of recording, one of :data:`APPLICATIONS`; chooses the viewer's layout.
    stage
        In order. None at all must be said, as ``stage = []``: it shows the signals alone.
    placements
        By topic, where a sensor is worn whose recording does not say so: asked for by detectors
        that take a placement. Empty text where it was looked for and is not known.
    needs
        What a recording must have.
    """

    name: str
    description: str = ""
    application: str = "room"
    stage: tuple[StageConfig, ...] = ()
    placements: dict[str, str] = field(default_factory=dict)
    needs: PipelineNeeds = PipelineNeeds()


def named_pipelines() -> dict[str, Path]:
    """Return the pipelines that ship with the package."""
    folder = Path(__file__).parents[1] / "pipelines"
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def load_pipeline(name_or_path: str) -> PipelineConfig:
    """Read a named pipeline or a TOML file.

    Raises
    ------
    PipelineError
        Unknown name, unreadable TOML, unknown key or wrong type, in one line.
    """
    shipped = named_pipelines()
    path = shipped.get(name_or_path, Path(name_or_path))
    if not path.is_file():
        raise SettingError(
            f"{name_or_path}: expected a file or one of {', '.join(shipped)}, found neither"
            f"{did_you_mean(name_or_path, shipped)}"
        )
    return parse_pipeline(path.read_bytes(), path.name)


def parse_pipeline(text: bytes, where: str) -> PipelineConfig:
    """Read a pipeline out of TOML; ``where`` names it in errors."""
    try:
        table = tomllib.loads(text.decode("utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise PipelineError(f"{where}: expected TOML, found: {error}") from None
    _known_keys(table, PipelineConfig, where)
    if isinstance(table.get("needs"), dict):
        _known_keys(table["needs"], PipelineNeeds, f"{where}: needs")
    for index, stage in enumerate(_tables(table.get("stage", []), where)):
        _known_keys(stage, StageConfig, f"{where}: stage {index + 1}")
    try:
        config = msgspec.convert(table, PipelineConfig)
    except msgspec.ValidationError as error:
        raise PipelineError(f"{where}: expected a pipeline, found: {error}") from None
    if config.application not in APPLICATIONS:
        raise PipelineError(
            f"{where}: application: expected one of {', '.join(APPLICATIONS)}, "
            f"found {config.application!r}"
        )
    keys = [stage.key for stage in config.stage]
    twice = next((key for key in keys if keys.count(key) > 1), None)
    if twice or "stage" not in table:
        expected = "stages of different names" if twice else "at least one [[stage]]"
        raise PipelineError(f"{where}: stage: expected {expected}, found {twice or 'none'}")
    return config


def _tables(value: Any, where: str) -> list[dict[str, Any]]:
    if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
        raise PipelineError(f"{where}: stage: expected [[stage]] tables, found {value!r}")
    return value


def _known_keys(table: dict[str, Any], kind: type[Any], where: str) -> None:
    names = list(kind.__dataclass_fields__)
    for key in table:
        if key not in names:
            raise PipelineError(
                f"{where}: {key}: expected one of {', '.join(names)}, found an unknown key"
                f"{did_you_mean(key, names)}"
            )


def with_settings(config: PipelineConfig, settings: Iterable[str]) -> PipelineConfig:
    """Apply ``stage.param=value`` settings.

    Raises
    ------
    SettingError
        Settings of another form, of a stage or parameter that the pipeline does not have, with a
        value of another type or out of range, or that do not go together: all of them.
    """
    stages = {stage.key: stage for stage in config.stage}
    usage = Usage(SettingError)
    changed = set()
    for setting in settings:
        with usage.collected():
            key, parameter, value = _parsed_setting(setting, stages)
            stages[key] = replace(
                stages[key], parameters=stages[key].parameters | {parameter: value}
            )
            changed.add(key)
    usage.check()
    for key in changed:
        with usage.collected():
            _checked_stage(stages[key])
    usage.check()
    return replace(config, stage=tuple(stages.values()))


def _parsed_setting(setting: str, stages: Mapping[str, StageConfig]) -> tuple[str, str, Any]:
    """Return the stage, the parameter and the value of a setting, checked."""
    left, equals, text = setting.partition("=")
    key, dot, parameter = left.rpartition(".")
    if not (equals and dot and parameter):
        raise SettingError(f"--set: expected stage.param=value, found {setting!r}")
    if key not in stages:
        raise SettingError(
            f"--set: expected a stage of {', '.join(stages)}, found {key!r} in {setting!r}"
            f"{did_you_mean(key, stages)}"
        )
    value = parse_value(text)
    try:
        checked_value(stage_named(stages[key].use).Parameters, parameter, value, key)
    except PipelineError as error:
        raise SettingError(str(error)) from None
    return key, parameter, value


def _checked_stage(stage: StageConfig) -> None:
    """Raise where values of a stage, each of them right, do not go together."""
    try:
        build(stage_named(stage.use).Parameters, stage.parameters, stage.key)
    except PipelineError as error:
        raise SettingError(str(error)) from None


def checked_pipeline(name_or_path: str, settings: Iterable[str] = ()) -> PipelineConfig:
    """Read a pipeline, apply settings, and check all names and values before any file is opened.

    Raises
    ------
    PipelineError, PluginError
        An unknown pipeline, plugin or parameter, or a value of another type or out of range.
    """
    config = load_pipeline(name_or_path)
    for stage in config.stage:
        build(stage_named(stage.use).Parameters, stage.parameters, stage.key)
    return with_settings(config, settings)
