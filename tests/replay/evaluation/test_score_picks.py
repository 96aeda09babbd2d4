"""Scores of picks: the first pick after an impact answers it, and only the last stage counts."""

from __future__ import annotations

import numpy as np
import pytest

from groundtrace.evaluation.picks import score_picks
from groundtrace.evaluation.report import score_events
from groundtrace_codecs.events import GateSpec, Label, Note, Pick, Quantity, StageSpec, StepEvent
from groundtrace_codecs.signals import NS_PER_S

START = 1_700_000_000 * NS_PER_S


def at(seconds: float) -> int:
    return START + round(seconds * NS_PER_S)


def impact(seconds: float, label: str = "", kind: str = "impact") -> Label:
    return Label(at(seconds), kind, label=label)


def truth(channel: str, seconds: float) -> Label:
    return Label(at(seconds), "pick", channel=channel)


def pick(channel: str, seconds: float, stage: str = "picks", topic: str = "/s") -> Pick:
    return Pick(at(seconds), channel, topic, stage, float("nan"), 9.0)


def spec(stage: str, emits: str = "pick", topic: str = "/s") -> StageSpec:
    gate = GateSpec("ratio", "1", "ratio", 5.0)
    return StageSpec(stage, "p", topic, ("G1",), (Quantity("ratio", "1"),), (gate,), (), emits)


def test_errors_are_picks_minus_arrivals():
    labels = [impact(1), truth("G1", 1.01), truth("G2", 1.02), truth("G3", 1.03)]
    result = score_picks(labels, [pick("G2", 1.023), pick("G1", 1.009), pick("G3", 1.031)]).all
    assert (result.truth, result.answered, result.answered_fraction) == (3, 3, 1.0)
    assert result.median_ms == pytest.approx(1.0)
    assert result.median_abs_ms == pytest.approx(1.0)
    assert result.iqr_ms == pytest.approx(2.0)
    assert (result.earliest_ms, result.latest_ms) == (pytest.approx(-1.0), pytest.approx(3.0))


def test_the_first_pick_after_the_impact_counts_not_the_best():
    labels = [impact(1), truth("G1", 1.2)]
    result = score_picks(labels, [pick("G1", 1.2), pick("G1", 1.05), pick("G1", 0.9)]).all
    assert (result.answered, result.median_ms) == (0, None)
    assert result.earliest_ms == result.latest_ms == pytest.approx(-150.0)


def test_a_false_early_pick_is_visible_beside_good_ones():
    labels = [impact(1), truth("G1", 1.2), truth("G2", 1.2)]
    result = score_picks(labels, [pick("G1", 1.05), pick("G1", 1.2), pick("G2", 1.201)]).all
    assert (result.answered, result.answered_fraction) == (1, 0.5)
    assert (result.earliest_ms, result.latest_ms) == (pytest.approx(-150), pytest.approx(1.0))
    assert result.median_abs_ms == pytest.approx(1.0)


def test_the_next_impact_ends_the_time_in_which_one_is_answered():
    labels = [impact(1, "a"), impact(2, "b"), truth("G1", 1.01), truth("G1", 2.01)]
    result = score_picks(labels, [pick("G1", 2.0)])
    first, second = result.impacts
    assert (first.label, first.answered, first.earliest_ms) == ("a", 0, None)
    assert (second.label, second.answered) == ("b", 1)
    assert second.median_ms == pytest.approx(-10.0)
    assert (result.all.truth, result.all.answered) == (2, 1)


def test_steps_part_arrivals_like_impacts_and_impacts_without_a_name_get_a_number():
    labels = [impact(t, kind="step") for t in (1, 2)] + [truth("G1", 1.01), truth("G1", 2.01)]
    result = score_picks(labels, [pick("G1", 1.01), pick("G1", 2.01)])
    assert [e.label for e in result.impacts] == ["impact 1", "impact 2"]
    assert result.all.answered == 2


def test_an_arrival_before_any_impact_is_answered_by_the_first_pick_of_all():
    result = score_picks([truth("G1", 0.5), impact(1)], [pick("G1", 0.51), pick("G1", 0.6)])
    assert result.impacts[0].label == "before"
    assert result.all.latest_ms == pytest.approx(10.0)


@pytest.mark.parametrize(("late_s", "answered"), [(0.05, 1), (0.0501, 0), (-0.05, 1)])
def test_a_pick_answers_within_fifty_milliseconds(late_s, answered):
    labels = [impact(1), truth("G1", 1.2)]
    assert score_picks(labels, [pick("G1", 1.2 + late_s)]).all.answered == answered


def test_a_channel_without_picks_is_not_answered():
    result = score_picks([impact(1), truth("G1", 1.2)], [pick("G2", 1.2)]).all
    assert (result.answered, result.earliest_ms, result.median_abs_ms) == (0, None, None)


def test_truth_without_picks_gives_no_score():
    assert score_picks([impact(1)], [pick("G1", 1.0)]) is None


LABELS = [impact(1), truth("G1", 1.01), Label(at(1.0), "step")]


def scored(events):
    return score_events(LABELS, events, START, at(10))


def test_only_the_last_stage_that_picks_is_scored():
    early, late = pick("G1", 1.005), pick("G1", 1.012, "first-breaks")
    events = [spec("picks"), spec("first-breaks"), spec("steps", "step"), early, late]
    assert scored(events).picks.all.median_ms == pytest.approx(2.0)
    assert scored([spec("picks"), early, late]).picks.all.median_ms == pytest.approx(-5.0)


def test_each_topic_has_its_own_last_stage():
    labels = [impact(1), truth("G1", 1.01), truth("H1", 1.01)]
    specs = [spec("picks"), spec("first-breaks"), spec("picks", topic="/t")]
    picks = [
        pick("G1", 1.003),
        pick("G1", 1.012, "first-breaks"),
        pick("H1", 1.013, topic="/t"),
    ]
    result = score_events(labels, [*specs, *picks], START, at(10)).picks.all
    assert (result.earliest_ms, result.latest_ms) == (pytest.approx(2.0), pytest.approx(3.0))


def test_steps_and_picks_are_scored_side_by_side():
    step = StepEvent(at(1.02), "step", "", "/s", "steps", 4.0, 4)
    result = scored([spec("picks"), step, Note(START, "x"), pick("G1", 1.01)])
    assert result.steps.matched == 1
    assert result.steps.latency_ms.median == pytest.approx(20.0, abs=1e-3)
    assert result.picks.all.answered == 1


def test_what_has_no_truth_is_not_scored():
    result = score_events([], [pick("G1", 1.0)], START, at(10))
    assert (result.steps, result.picks) == (None, None)


def test_the_errors_of_many_arrivals_are_those_of_a_plain_loop():
    rng = np.random.default_rng(4)
    labels, picks, expected = [], [], []
    for shot in range(20):
        labels.append(impact(shot + 1.0))
        for channel in range(6):
            arrival = shot + 1.05 + 0.01 * channel
            labels.append(truth(f"G{channel}", arrival))
            times = arrival + rng.normal(0, 0.01, 3)
            picks += [pick(f"G{channel}", t) for t in times]
            expected.append(times.min() - arrival)
    result = score_picks(labels, picks)
    assert result.all.answered == 120
    assert result.all.median_ms == pytest.approx(np.median(expected) * 1e3, abs=1e-3)
    assert sum(e.truth for e in result.impacts) == 120
