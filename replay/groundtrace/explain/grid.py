"""Grids: which settings a sweep tries, in full or at random."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import PipelineError, did_you_mean
from ..parameters import build, describe, parse_value
from ..plugins import stage_named
from ..stage import associates, detects, emitted
from .counted import counted_kind, noun_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from ..parameters import ParameterInfo
    from ..pipeline import PipelineConfig, StageConfig

#: A sweep of more settings than this is refused.
MOST = 1_000_000
#: Significant digits of values between the ends of a range: what is printed is what was tried.
DIGITS = 8
RANDOM_DIGITS = 6


@dataclass(frozen=True, slots=True)
class Axis:
    """A parameter that is swept.

    Attributes
    ----------
    stage, parameter, unit
        Which.
    values
        In the order given; the type is the parameter's.
    span
        Whether they stand for the whole range between the first and the last.
    remeasure
        Whether it changes the signal path, so that each value needs the signal again.
    """

    stage: str
    parameter: str
    unit: str
    values: tuple[Any, ...]
    span: bool
    remeasure: bool

    @property
    def name(self) -> str:
        """The parameter as settings name it."""
        return f"{self.stage}.{self.parameter}"

    @property
    def numeric(self) -> bool:
        """Whether the values are numbers."""
        return all(isinstance(v, int | float) and not isinstance(v, bool) for v in self.values)

    def draw(self, rng: np.random.Generator, count: int) -> list[Any]:
        """Return random values: from the whole range, or out of the list."""
        if not self.span:
            return [self.values[i] for i in rng.integers(len(self.values), size=count)]
        low, high = min(self.values), max(self.values)
        if isinstance(low, int):
            return [int(v) for v in rng.integers(low, high, endpoint=True, size=count)]
        drawn = rng.uniform(low, high, count).tolist()
        return [min(max(_rounded(v, RANDOM_DIGITS), low), high) for v in drawn]

    def places(self, values: Sequence[Any]) -> NDArray[np.float64]:
        """Return where values lie between the axis' ends, 0 to 1; a list's are evenly apart."""
        if self.span:
            low, high = min(self.values), max(self.values)
            return np.array([(v - low) / ((high - low) or 1) for v in values], np.float64)
        steps = {value: index for index, value in enumerate(self.values)}
        return np.array([steps[v] for v in values], np.float64) / max(len(steps) - 1, 1)


def parse_axis(text: str, config: PipelineConfig) -> Axis:
    """Read ``stage.param=FROM:TO:COUNT`` or ``stage.param=VALUE,VALUE``.

    Raises
    ------
    PipelineError
        Another form, an unknown stage or parameter, or a value that it may not have.
    """
    left, equals, right = text.partition("=")
    key, dot, parameter = left.strip().rpartition(".")
    if not (equals and dot and parameter and right.strip()):
        raise PipelineError(
            f"--grid: expected stage.param=FROM:TO:COUNT or stage.param=VALUE,VALUE, found {text!r}"
        )
    stages = {stage.key: stage for stage in config.stage}
    if key not in stages:
        raise PipelineError(
            f"--grid: expected a stage of {', '.join(stages)}, found {key!r} in {text!r}"
            f"{did_you_mean(key, stages)}"
        )
    kind = stage_named(stages[key].use)
    counted = counted_kind(config)
    if not (detects(kind) or associates(kind)) and emitted(kind) != counted:
        raise PipelineError(
            f"--grid: expected a stage that decides about {noun_of(counted)}, found {key!r}"
        )
    info = next((i for i in describe(kind.Parameters) if i.name == parameter), None)
    span = ":" in right
    if span:
        given = _range(right, text, info)
        for end in (given[0], given[-1]):
            _checked(stages[key], kind, parameter, end)
    else:
        parsed = [parse_value(value.strip()) for value in right.split(",")]
        given = [_checked(stages[key], kind, parameter, value) for value in parsed]
    values = tuple(dict.fromkeys(given))
    # passes are found in the cycles of which a gate says that they hear a vehicle
    through = emitted(kind) == "presence" and counted == "pass"
    signal = not associates(kind) and info is not None and info.part == "measure"
    remeasure = signal or through
    return Axis(key, parameter, info.unit if info else "", values, span, remeasure)


def _range(text: str, whole: str, info: ParameterInfo | None) -> list[Any]:
    """Return evenly spaced numbers, both ends among them; whole ones for a whole parameter."""
    try:
        low, high, count = (float(part) for part in text.split(":"))
    except ValueError:
        low, high, count = math.nan, math.nan, 0
    if not (math.isfinite(low + high) and count >= 2 and count == int(count) and low < high):
        raise PipelineError(
            f"--grid: expected FROM:TO:COUNT with FROM < TO and a COUNT of 2 or more, "
            f"found {whole!r}"
        )
    if count > MOST:
        raise PipelineError(f"--grid: expected at most {MOST} values, found {whole!r}")
    values = np.linspace(low, high, int(count)).tolist()
    if info is not None and type(info.default) is int:
        return [round(v) for v in values]
    return [low, *(_rounded(v, DIGITS) for v in values[1:-1]), high]


def _checked(stage: StageConfig, kind: Any, parameter: str, value: Any) -> Any:
    """Return a value as the parameter has it."""
    built = build(kind.Parameters, {**stage.parameters, parameter: value}, stage.key)
    return getattr(built, parameter)


def _rounded(value: float, digits: int) -> float:
    return float(f"{value:.{digits}g}")


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """The settings of a sweep.

    Attributes
    ----------
    axes
        What is swept.
    rows
        One value for each axis, setting by setting.
    shape
        Number of values of each axis where every combination is there, in the order of the axes,
        the last one fastest; None for random settings.
    """

    axes: tuple[Axis, ...]
    rows: tuple[tuple[Any, ...], ...]
    shape: tuple[int, ...] | None

    def __len__(self) -> int:
        return len(self.rows)

    def places(self) -> NDArray[np.float64]:
        """Return where the settings lie, each axis from 0 to 1; shape (n, n_axes)."""
        columns = zip(*self.rows, strict=True)
        return np.column_stack([a.places(c) for a, c in zip(self.axes, columns, strict=True)])

    def setting(self, row: int) -> dict[str, Any]:
        """Return a setting by the names of its parameters."""
        return dict(zip((a.name for a in self.axes), self.rows[row], strict=True))


def make_grid(axes: Sequence[Axis], random: int | None = None, seed: int = 0) -> Grid:
    """Return all combinations of the axes' values, or ``random`` random settings.

    Raises
    ------
    PipelineError
        Where nothing is swept, a parameter is named twice, or there are more than :data:`MOST`.
    """
    names = [axis.name for axis in axes]
    twice = next((name for name in names if names.count(name) > 1), None)
    if not names or twice:
        expected = "each parameter once" if twice else "at least one parameter to sweep"
        raise PipelineError(f"--grid: expected {expected}, found {twice or 'none'}")
    shape = tuple(len(axis.values) for axis in axes)
    count = math.prod(shape) if random is None else random
    if count > MOST:
        raise PipelineError(
            f"--grid: expected at most {MOST} settings, found {count}: --random {MOST // 10} tries "
            f"some of them"
        )
    if random is None:
        return Grid(tuple(axes), tuple(product(*(a.values for a in axes))), shape)
    rng = np.random.default_rng(seed)
    drawn = [axis.draw(rng, random) for axis in axes]
    return Grid(tuple(axes), tuple(zip(*drawn, strict=True)), None)
