"""Sweeps: grids said and refused, the middle of plateaus, the front, the bootstrap."""

from __future__ import annotations

import numpy as np
import pytest

from groundtrace.errors import PipelineError
from groundtrace.explain.reasons import Verdicts, bootstrap
from groundtrace.explain.redecide import Axis, Grid, make_grid, parse_axis
from groundtrace.explain.sweep import middle, pareto_front, resolved
from groundtrace.pipeline.config import PipelineConfig, load_pipeline
from groundtrace_codecs.signals import NS_PER_S


@pytest.fixture(scope="module")
def waist() -> PipelineConfig:
    return resolved(load_pipeline("waist-peaks"))


@pytest.fixture(scope="module")
def room() -> PipelineConfig:
    return resolved(load_pipeline("room-footsteps"))


def axes_of(config: PipelineConfig, texts: tuple[str, ...]) -> tuple[Axis, ...]:
    return tuple(parse_axis(text, config) for text in texts)


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("steps.height=0.2:1:5", (0.2, 0.4, 0.6, 0.8, 1.0)),
        ("steps.height=0.2,1,0.7", (0.2, 1.0, 0.7)),
        ("steps.height=1", (1.0,)),
    ],
)
def test_a_range_has_both_ends_and_a_list_its_order(waist: PipelineConfig, text, values) -> None:
    axis = parse_axis(text, waist)
    assert axis.values == values
    assert all(isinstance(v, float) for v in axis.values)


def test_a_whole_parameter_keeps_whole_values_each_once(room: PipelineConfig) -> None:
    axis = parse_axis("steps.min_channels=1:4:7", room)
    assert axis.values == (1, 2, 3, 4)
    assert {type(v) for v in make_grid([axis], random=50).rows[0]} == {int}
    assert not parse_axis("steps.window_s=0.01:0.1:3", room).remeasure


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("height=1:2:3", "expected stage.param=FROM:TO:COUNT or"),
        ("steps.height", "expected stage.param=FROM:TO:COUNT or"),
        ("steps.height=", "expected stage.param=FROM:TO:COUNT or"),
        ("stairs.height=1:2:3", "expected a stage of steps, found 'stairs'"),
        ("steps.hight=1:2:3", "steps.hight: expected one of"),
        ("steps.height=1:2", "expected FROM:TO:COUNT with FROM < TO"),
        ("steps.height=2:1:3", "expected FROM:TO:COUNT with FROM < TO"),
        ("steps.height=1:2:1", "a COUNT of 2 or more"),
        ("steps.height=1:2:2.5", "a COUNT of 2 or more"),
        ("steps.height=1:inf:3", "expected FROM:TO:COUNT"),
        ("steps.height=1:2:1e9", "expected at most 1000000 values"),
        ("steps.height=-5:2:3", "steps.height: expected float >= 0, found -5.0"),
        ("steps.height=tall", "steps.height: expected float"),
    ],
)
def test_a_wrong_grid_is_said_in_one_line(waist: PipelineConfig, text: str, says: str) -> None:
    with pytest.raises(PipelineError) as caught:
        parse_axis(text, waist)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_localizer_decides_no_step(room: PipelineConfig) -> None:
    with pytest.raises(
        PipelineError, match="expected a stage that decides about steps, found 'hyperb"
    ):
        parse_axis("hyperbolic.any=1:2:3", room)


def test_a_grid_names_each_parameter_once_and_is_not_too_large(waist: PipelineConfig) -> None:
    axis = parse_axis("steps.height=1:2:2000", waist)
    with pytest.raises(PipelineError, match=r"expected each parameter once, found steps\.height"):
        make_grid([axis, axis])
    with pytest.raises(PipelineError, match="expected at least one parameter"):
        make_grid([])
    other = parse_axis("steps.swing=1:2:2000", waist)
    with pytest.raises(PipelineError, match="at most 1000000 settings, found 4000000: --random"):
        make_grid([axis, other])


def test_random_settings_are_inside_and_the_same_for_the_same_seed(waist: PipelineConfig) -> None:
    axes = axes_of(waist, ("steps.height=0.2:1:2", "steps.swing=0.5,0.9"))
    grid, again, other = (make_grid(axes, random=99, seed=s) for s in (3, 3, 4))
    assert grid.rows == again.rows != other.rows
    assert all(0.2 <= height <= 1 and swing in (0.5, 0.9) for height, swing in grid.rows)


def plain_grid(*counts: int) -> Grid:
    axes = [
        Axis("s", f"p{i}", "", tuple(map(float, range(n))), span=True, remeasure=False)
        for i, n in enumerate(counts)
    ]
    return make_grid(axes)


def test_of_equal_settings_the_middle_of_the_largest_plateau_is_taken() -> None:
    grid = plain_grid(9, 9)
    equal = np.zeros((9, 9), np.bool_)
    equal[2:7, 3:8] = True
    equal[0, 0] = True
    assert grid.rows[middle(grid, equal.ravel())] == (4.0, 5.0)
    line = plain_grid(7)
    assert middle(line, np.array([1, 1, 1, 1, 1, 0, 1], np.bool_)) == 2


def test_a_parameter_of_one_value_does_not_hide_the_plateau() -> None:
    grid = plain_grid(1, 5, 1)
    assert grid.rows[middle(grid, np.ones(5, np.bool_))] == (0.0, 2.0, 0.0)


def test_of_equal_random_settings_the_one_furthest_from_others_is_taken() -> None:
    axes = (Axis("s", "p", "", (0.0, 1.0), span=True, remeasure=False),)
    grid = Grid(axes, ((0.1,), (0.2,), (0.45,), (0.7,), (0.9,)), None)
    assert middle(grid, np.array([0, 1, 1, 1, 0], np.bool_)) == 2
    assert middle(grid, np.ones(5, np.bool_)) == 2


def test_the_front_is_what_nothing_beats() -> None:
    missed, false = np.array([5, 3, 3, 1, 0, 6, 0]), np.array([0, 2, 1, 9, 9, 0, 12])
    assert pareto_front(missed, false) == [(0, 9), (3, 1), (5, 0)]


def verdict(hits: str, *false_s: float) -> Verdicts:
    times = np.array([round(s * NS_PER_S) for s in false_s], np.int64)
    return Verdicts(np.array([c == "x" for c in hits]), times)


def test_the_bootstrap_is_deterministic_and_holds_the_score() -> None:
    settings = [[verdict("xxxxxxx.xx" * 6, 1, 2)], [verdict("xx..x.x.xx" * 6, 3)]]
    first, again = bootstrap(settings), bootstrap(settings)
    assert first.f1 == again.f1
    assert first.behind == again.behind
    for (verdicts,), interval in zip(settings, first.f1, strict=True):
        right, n = int(verdicts.hit.sum()), len(verdicts.hit)
        assert interval.low < 2 * right / (n + right + len(verdicts.false_ns)) < interval.high
    assert first.worse(1)
    assert not first.worse(0)


def test_equal_verdicts_are_not_told_apart_nor_are_small_differences() -> None:
    one = verdict("xxxxx.xxxx", 1)
    sure = bootstrap([[one, one], [one, one], [one, verdict("xxxxx.xxx.", 1)]])
    assert (sure.behind[1].low, sure.behind[1].high) == (0, 0)
    assert not sure.worse(1)
    assert not sure.worse(2)
