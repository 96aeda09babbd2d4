"""Comparison: every decision in its class, what set them apart, and the significance of that."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from replayed_results import waist_walk

from groundtrace.errors import RecordingError
from groundtrace.explain.compare import Comparison, Decision, ParameterChange, compare, exact_p
from groundtrace.pipeline.results import Provenance, Results
from groundtrace_codecs.events import CandidateBlock, Fix, GateSpec, Label, Quantity, StageSpec

START_NS = 1_700_000_000_000_000_000
RECIPE = 'name = "waist"\n[[stage]]\nname = "steps"\nuse = "dp"\n[stage.parameters]\nheight = {}\n'


def at(seconds: float) -> int:
    return START_NS + round(seconds * 1e9)


def steps(*times: float) -> tuple[Label, ...]:
    return tuple(Label(at(t), "step") for t in times)


def result(heights: dict[float, float], threshold: float, name: str = "a.mcap") -> Results:
    """A result whose stage has candidates of the given heights at the given times."""
    gate = GateSpec("height", "m/s2", "height", threshold)
    columns = (Quantity("height", "m/s2"),)
    spec = StageSpec("steps", "dp", "/imu", ("norm",), columns, (gate,), (), "step")
    value = np.array([*heights.values()], np.float32)[:, np.newaxis]
    margin = value - np.float32(threshold)
    block = CandidateBlock(
        spec,
        np.array([at(t) for t in heights], np.int64),
        np.zeros(len(heights), np.int32),
        value,
        value,
        margin,
        margin[:, 0] >= 0,
    )
    origin = Provenance("walk.mcap", "ab" * 32, START_NS, at(60), RECIPE.format(threshold))
    return Results(name, origin, (), None, (spec, block))


def fix(seconds: float, x_m: float, y_m: float, stage: str = "places") -> Fix:
    return Fix(at(seconds), x_m, y_m, (1.0, 0.0, 1.0), 0.0, "tdoa", 4, stage)


def verdict_at(found: Comparison, seconds: float) -> Decision:
    return next(d for d in found.decisions if d.time_s == pytest.approx(seconds))


def test_every_decision_falls_into_its_class() -> None:
    truth = steps(1, 2, 3, 4)
    a = result({1.02: 9, 2.01: 9, 3.0: 1, 4.0: 1, 7: 9, 8: 9, 9: 1}, 5)
    b = result({1.05: 9, 2.0: 1, 2.99: 9, 4.0: 1, 7.05: 9, 8: 1, 9: 9}, 5, "b.mcap")
    found = compare(a, b, truth)
    assert {round(d.time_s, 6): d.verdict for d in found.decisions} == {
        1: "both right",
        2: "only A right",
        3: "only B right",
        4: "both missed",
        7: "both false",
        8: "only A false",
        9: "only B false",
    }
    assert [d.step for d in found.decisions] == [1, 2, 3, 4, None, None, None]
    assert sum(found.verdicts.values()) == 7
    assert found.a.counts == found.b.counts


def test_each_difference_names_the_gate_of_the_side_without_the_step() -> None:
    found = compare(result({1.0: 9, 2: 9}, 5), result({1.02: 4, 2: 9}, 5), steps(1, 2))
    lacks = verdict_at(found, 1.0).obstacle
    assert lacks is not None
    assert (lacks.side, lacks.stage, lacks.gate, lacks.parameter) == ("B", "steps", *["height"] * 2)
    assert (lacks.value, lacks.threshold, lacks.margin) == (4, 5, -1)
    assert verdict_at(found, 2.0).obstacle is None


def test_a_difference_without_a_candidate_has_no_gate() -> None:
    lacks = compare(result({1.0: 9}, 5), result({30.0: 9}, 5), steps(1)).decisions[0].obstacle
    assert lacks is not None
    assert (lacks.side, lacks.gate, lacks.value, lacks.margin) == ("B", "", None, None)
    assert lacks.text


def test_without_truth_the_two_are_compared_with_each_other() -> None:
    found = compare(result({1: 9, 2: 9}, 5), result({1.1: 9, 2: 1, 3: 9}, 5), ())
    assert found.verdicts == {"both": 1, "only A": 1, "only B": 1}
    assert found.p_value is None
    assert (found.a.counts, found.a.steps, found.b.steps) == (None, 2, 2)
    assert [d.time_s for d in found.decisions] == pytest.approx([1, 2, 3])
    assert verdict_at(found, 3.0).obstacle is not None


def test_results_of_two_recordings_are_refused_with_both_names() -> None:
    a, b = result({1: 9}, 5), result({1: 9}, 5, "b.mcap")
    other = replace(b, provenance=replace(b.provenance, recording="run.mcap", sha256="cd" * 32))
    with pytest.raises(
        RecordingError,
        match=r"^a\.mcap and b\.mcap: expected results of one recording, found "
        r"walk\.mcap \(abababababab\) and run\.mcap \(cdcdcdcdcdcd\)$",
    ):
        compare(a, other, ())
    part = replace(b, provenance=replace(b.provenance, from_ns=at(3)))
    with pytest.raises(RecordingError, match=r"same part of walk\.mcap, found different --from"):
        compare(a, part, ())


def test_parameters_that_differ_are_listed_and_no_others() -> None:
    found = compare(result({1: 9}, 5), result({1: 9}, 4), ())
    assert found.parameters == (ParameterChange("steps", "height", 5, 4),)
    assert compare(result({1: 9}, 5), result({1: 9}, 5), ()).parameters == ()


def test_of_a_stage_with_another_plugin_only_the_plugin_differs() -> None:
    a = result({1: 9}, 5)
    recipe = 'name = "waist"\n[[stage]]\nname = "steps"\nuse = "zc"\n[[stage]]\nuse = "places"\n'
    b = replace(a, provenance=replace(a.provenance, pipeline=recipe))
    assert compare(a, b, ()).parameters == (
        ParameterChange("steps", "use", "dp", "zc"),
        ParameterChange("places", "use", None, "places"),
    )


@pytest.mark.parametrize(
    ("for_a", "for_b", "p"),
    [(0, 1, 1.0), (0, 5, 0.0625), (0, 6, 0.03125), (3, 3, 1.0), (1, 9, 22 / 1024)],
)
def test_the_exact_test_has_its_textbook_values(for_a: int, for_b: int, p: float) -> None:
    verdicts = Counter({"only A right": for_a, "only B right": for_b - 1, "only A false": 1})
    assert exact_p(verdicts) == pytest.approx(p)


def test_without_a_difference_there_is_no_test() -> None:
    assert exact_p(Counter({"both right": 50, "both false": 3})) is None


times = st.lists(st.integers(1, 200), max_size=12, unique=True)


@given(times, times, times)
def test_the_classes_add_up_to_the_figures_of_both(
    truth: list[int], found_a: list[int], found_b: list[int]
) -> None:
    a, b = (result({t / 4: 9.0 for t in sorted(f)}, 5) for f in (found_a, found_b))
    found = compare(a, b, steps(*(t / 4 + 0.01 for t in sorted(truth))))
    v = Counter(found.verdicts)
    if not truth:
        assert v["both"] + v["only A"] == len(found_a)
        return
    for side, own in ((found.a, "A"), (found.b, "B")):
        assert side.counts is not None
        assert side.counts.tp == v["both right"] + v[f"only {own} right"]
        assert side.counts.fp == v["both false"] + v[f"only {own} false"]
    assert sum(v[x] for x in ("both right", "only A right", "only B right", "both missed")) == len(
        truth
    )
    swapped = Counter(compare(b, a, steps(*(t / 4 + 0.01 for t in sorted(truth)))).verdicts)
    assert swapped["only A right"] == v["only B right"]
    assert swapped["only A false"] == v["only B false"]


def test_places_of_one_moment_are_compared_with_each_other_and_with_truth() -> None:
    truth = tuple(replace(x, x_m=1.0, y_m=1.0) for x in steps(1, 2, 3))
    a, b = result({1: 9, 2: 9, 3: 9}, 5), result({1: 9, 2: 9, 3: 9}, 5)
    a = replace(a, events=(*a.events, fix(3, 9, 9, "coarse"), fix(1, 1, 1), fix(2, 1, 2)))
    b = replace(b, events=(*b.events, fix(1.01, 1, 4), fix(2, 1, 2), fix(3, 1, 1)))
    found = compare(a, b, truth).places
    assert found is not None
    assert (found.a, found.b, len(found.pairs)) == (2, 3, 2)
    assert [p.apart_m for p in found.pairs] == pytest.approx([3, 0])
    assert (found.median_apart_m, found.largest_apart_m) == pytest.approx((1.5, 3))
    assert [p.error_b_m for p in found.pairs] == pytest.approx([3, 1])
    assert found.rmse_a_m == pytest.approx(np.sqrt(0.5))
    assert found.rmse_b_m == pytest.approx(np.sqrt(5))
    alone = compare(a, b, ()).places
    assert alone is not None
    assert (alone.pairs[0].error_a_m, alone.rmse_a_m) == (None, None)


def test_without_fixes_there_are_no_places() -> None:
    a = result({1: 9}, 5)
    assert compare(a, a, ()).places is None


def test_a_higher_threshold_loses_steps_of_a_walk_and_each_says_by_how_much() -> None:
    walk = waist_walk()
    found = compare(walk.results("steps.height=2.0"), walk.results(), walk.labels)
    assert found.verdicts == {"both right": 53, "only B right": 21}
    assert found.parameters == (ParameterChange("steps", "height", 2.0, 0.4),)
    assert found.p_value == pytest.approx(2 * 0.5**21)
    for decision in found.decisions:
        if decision.verdict == "only B right":
            lacks = decision.obstacle
            assert lacks is not None
            assert (lacks.side, lacks.gate, lacks.threshold) == ("A", "height", 2.0)
            assert lacks.value is not None
            assert 0.4 <= lacks.value < 2.0
