"""Parameters of plugins: documented dataclass fields with unit, bounds and part.

A parameter belongs to ``measure`` (it changes the signal path, and so needs a new replay) or to
``decide`` (a gate's threshold: stored candidates can be decided again without the signal).
"""

from __future__ import annotations

import dataclasses
import math
import tomllib
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, Any, Literal, TypeVar, get_args, get_type_hints

import msgspec

from groundtrace_codecs.errors import did_you_mean

from ..errors import PipelineError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from groundtrace_codecs.events import Label

T = TypeVar("T")
Part = Literal["measure", "decide"]
#: Known places that a stage takes in, by its parameter ``updates``: satellite fixes, or of the
#: truth's waypoints the first two or all. No other parameter has a stage given truth.
Updates = Literal["none", "gnss", "first-two", "waypoints"]


def measured(unit: str, doc: str, **bounds: float) -> msgspec.Meta:
    """Describe a parameter of the signal path; ``bounds`` are ``gt``, ``ge``, ``lt``, ``le``."""
    return _meta("measure", unit, doc, **bounds)


def gate(unit: str, doc: str, **bounds: float) -> msgspec.Meta:
    """Describe a gate's threshold; ``bounds`` are ``gt``, ``ge``, ``lt``, ``le``."""
    return _meta("decide", unit, doc, **bounds)


def _meta(part: Part, unit: str, doc: str, **bounds: Any) -> msgspec.Meta:
    return msgspec.Meta(description=doc, extra={"unit": unit, "part": part}, **bounds)


@dataclass(frozen=True, slots=True)
class StageConfig:
    """One ``[[stage]]`` of a pipeline.

    Attributes
    ----------
    use
        Name of the registered plugin.
    name
        Name in this pipeline; the plugin's where empty.
    topics
        Patterns of topics it may run on; empty means all that fit.
    parameters
        Values that differ from the plugin's defaults.
    source
        Names of the stages that it takes from, of those before it that give what it takes; the
        last, or as the stage says, where empty.
    """

    use: str
    name: str = ""
    topics: tuple[str, ...] = ()
    parameters: dict[str, Any] = field(default_factory=dict)
    source: tuple[str, ...] = ()

    @property
    def key(self) -> str:
        """The name that settings use."""
        return self.name or self.use


@dataclass(frozen=True, slots=True)
class ParameterInfo:
    """One parameter of a plugin, as shown to people.

    Attributes
    ----------
    name, unit, doc
        What it is.
    part
        ``measure`` or ``decide``.
    allowed
        Type and bounds in words, e.g. ``float > 0``.
    default
        Its default value.
    """

    name: str
    unit: str
    doc: str
    part: Part
    allowed: str
    default: Any


def describe(parameters: type[Any]) -> tuple[ParameterInfo, ...]:
    """Return the documented parameters of a plugin's parameter dataclass.

    Raises
    ------
    PipelineError
        Where a field carries no description: every parameter is documented.
    """
    kind: Any = parameters
    return _described(kind)


@cache
def _described(parameters: Any) -> tuple[ParameterInfo, ...]:
    hints = _hints(parameters)
    return tuple(
        _info(parameters, field, hints[field.name]) for field in dataclasses.fields(parameters)
    )


@cache
def _hints(parameters: Any) -> dict[str, Any]:
    return get_type_hints(parameters, include_extras=True)


def _info(owner: type[Any], field: dataclasses.Field[Any], hint: Any) -> ParameterInfo:
    meta = next((a for a in get_args(hint) if isinstance(a, msgspec.Meta)), None)
    if meta is None or not meta.description or not meta.extra:
        raise PipelineError(f"{owner.__name__}.{field.name}: expected a description, found none")
    signs = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
    bounds = [
        f"{sign} {getattr(meta, key):g}"
        for key, sign in signs.items()
        if getattr(meta, key) is not None
    ]
    kind = get_args(hint)[0]
    name = kind.__name__ if isinstance(kind, type) else str(kind).removeprefix("typing.")
    return ParameterInfo(
        name=field.name,
        unit=meta.extra["unit"],
        doc=meta.description,
        part=meta.extra["part"],
        allowed=" ".join([name, " and ".join(bounds)]).strip(),
        default=field.default,
    )


def build(parameters: type[T], values: Mapping[str, Any], where: str) -> T:
    """Make a parameter object out of a table.

    Raises
    ------
    PipelineError
        One line naming the key, what is allowed and what was found.
    """
    converted = {key: checked_value(parameters, key, v, where) for key, v in values.items()}
    try:
        return parameters(**converted)
    except ValueError as error:  # of values that do not go together, in ``__post_init__``
        raise PipelineError(f"{where}.{error}") from None


def checked_value(parameters: Any, key: str, value: Any, where: str) -> Any:
    """Return a value as a parameter has it.

    Raises
    ------
    PipelineError
        As :func:`build` does.
    """
    infos = {info.name: info for info in describe(parameters)}
    if key not in infos:
        raise PipelineError(
            f"{where}.{key}: expected one of {', '.join(infos) or 'no parameter'}, "
            f"found an unknown key{did_you_mean(key, infos)}"
        )
    try:
        converted = msgspec.convert(value, _hints(parameters)[key])
    except msgspec.ValidationError:
        raise PipelineError(
            f"{where}.{key}: expected {infos[key].allowed}, found {value!r}"
        ) from None
    if isinstance(value, float) and not math.isfinite(value):
        raise PipelineError(f"{where}.{key}: expected a finite number, found {value!r}")
    return converted


def given_waypoints(labels: Sequence[Label], updates: str) -> list[Label]:
    """Return the waypoints that a stage is given by its parameter ``updates``, in order of time."""
    count = {"first-two": 2, "waypoints": None}.get(updates, 0)
    waypoints = [
        x
        for x in sorted(labels, key=lambda x: x.time_ns)
        if x.kind == "waypoint" and x.x_m is not None and x.y_m is not None
    ]
    return waypoints[:count]


def parse_value(text: str) -> Any:
    """Read a setting's value as TOML would; what TOML cannot read is a string."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
