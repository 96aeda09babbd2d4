"""A printed change, given to a fresh replay, recovers the step and gives the printed figures."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from replayed_results import Walk, waist_walk, walk_of

from groundtrace.errors import PipelineError
from groundtrace.explain.reasons import matched
from groundtrace.explain.redecide import Counts, OfflineDecider
from groundtrace.explain.remedies import Remedy, RemedySearch
from groundtrace.explain.sweep import measure_evidence
from groundtrace.explain.why import Mended, StepExplanation, explain_steps
from groundtrace.pipeline.config import load_pipeline, with_settings
from groundtrace.simulate.gait import WalkOptions
from groundtrace.simulate.recording import write
from groundtrace.simulate.room import simulate_room
from groundtrace.simulate.room_plan import RoomOptions
from groundtrace.simulate.walk import simulate_walk
from groundtrace_codecs.events import Label

if TYPE_CHECKING:
    from pathlib import Path

ONE_GATE = ("steps.height=2.0", "steps.swing=4.0", "steps.refractory_s=0.6")
TWO_GATES = (
    ("steps.height=2.0", "steps.swing=4.0"),
    ("steps.height=2.0", "steps.refractory_s=0.7"),
)
ALL_OPEN = ("steps.height=0.05", "steps.swing=0", "steps.activity=0", "steps.refractory_s=0")
#: So many remedies of a setting are tried at most, from the first step to the last.
MOST = 8
PARAMETERS = ("height", "swing", "activity", "refractory_s")


@cache
def explained(settings: tuple[str, ...]) -> StepExplanation:
    return explain_steps(waist_walk().evidence(*settings))


def seconds(times_ns: np.ndarray) -> np.ndarray:
    return (times_ns - waist_walk().start_ns) / 1e9


def several(items: list[Any]) -> list[Any]:
    """Return at most :data:`MOST` of them, from the first to the last."""
    return items[:: -(-len(items) // MOST)]


def wrong(counts: Counts) -> int:
    return counts.fp + counts.fn


def size(remedy: Remedy) -> float:
    return sum(change.size for change in remedy.changes)


@pytest.mark.parametrize("settings", [*((s,) for s in ONE_GATE), *TWO_GATES], ids=" ".join)
def test_a_fresh_replay_with_the_remedy_recovers_the_step_with_the_printed_figures(
    settings: tuple[str, ...],
) -> None:
    walk, found = waist_walk(), explained(settings)
    assert len(found.missed) >= 5
    assert found.counts == walk.counts(*settings)
    remedies = [(m, m.remedy) for m in found.missed if m.remedy is not None]
    assert remedies
    for missed, remedy in several(remedies):
        again = walk.matching(*settings, *remedy.settings)
        hits = seconds(again.truth_ns[again.pairs[:, 0]])
        assert np.isclose(hits, missed.time_s, atol=1e-6).any(), (missed.step, remedy.settings)
        assert remedy.before == found.counts
        assert remedy.after == walk.counts(*settings, *remedy.settings), remedy.settings
        assert wrong(remedy.after) <= wrong(remedy.before)


@pytest.mark.parametrize("settings", [(s,) for s in ONE_GATE], ids=" ".join)
def test_what_one_gate_took_one_change_brings_back(settings: tuple[str, ...]) -> None:
    found = explained(settings)
    assert found.mended_missed == Mended(one=len(found.missed), two=0, none=0)


def test_what_two_gates_took_a_pair_of_changes_brings_back() -> None:
    found = explained(TWO_GATES[0])
    pairs = [m.remedy for m in found.missed if m.remedy is not None and len(m.remedy.changes) == 2]
    assert len(pairs) == found.mended_missed.two >= 5
    assert found.mended_missed.none == 0
    assert all(remedy.after.tp > remedy.before.tp for remedy in pairs)


@pytest.mark.parametrize("settings", TWO_GATES, ids=" ".join)
def test_no_value_of_a_gate_does_it_where_a_pair_is_printed_or_with_less_change(
    settings: tuple[str, ...],
) -> None:
    """A value of a fine grid that recovers a step, and does no harm, is a larger change.

    But for that of a refractory time: what a chain of them does may need a value between the tried.
    """
    found = explained(settings)
    least: dict[int, float] = {}
    recovered: set[int] = set()
    for parameter, old, value, matching in one_by_one(settings):
        if wrong(Counts.of(matching)) <= wrong(found.counts):
            for step in (matching.pairs[:, 0] + 1).tolist():
                recovered.add(step)
                if parameter != "refractory_s":
                    least[step] = min(abs(value - old) / old, least.get(step, np.inf))
    assert found.missed
    for missed in found.missed:
        if missed.remedy is None or len(missed.remedy.changes) == 2:
            assert missed.step not in recovered
        else:
            assert size(missed.remedy) <= least.get(missed.step, np.inf)


def one_by_one(settings):
    """Yield each gate's parameter, its old value, a new one, and what is found with that."""
    evidence = waist_walk().evidence(*settings)
    redecider = OfflineDecider(evidence)
    gates = {gate.parameter: gate.threshold for gate in evidence.stages[0].spec.gates}
    for name in PARAMETERS:
        for value in np.concatenate([np.linspace(0.05, 1, 60), np.linspace(1, 6, 40)]).tolist():
            try:
                yield name, gates[name], value, redecider.matching({("steps", name): value})
            except PipelineError:  # under the floor, where nothing was stored
                continue


def test_a_change_that_loses_more_than_it_mends_is_not_offered() -> None:
    """The threshold that lets in the one soft true step lets in twenty that are none."""
    settings = ("steps.height=2.0",)
    matching = waist_walk().matching(*settings)
    soft = matching.missed
    heights = {m.step - 1: m.reason.readings[0].value for m in explained(settings).missed}
    softest = min(heights, key=lambda index: heights[index])
    dropped = set(matching.truth_ns[soft[soft != softest]].tolist())
    labels = tuple(x for x in waist_walk().labels if x.kind != "step" or x.time_ns not in dropped)
    walk = replace(waist_walk(), labels=labels)

    found = explain_steps(walk.evidence(*settings))

    (missed,) = found.missed
    lowered = walk.counts(*settings, f"steps.height={heights[softest] * 0.99:.4g}")
    assert lowered.fn == 0
    assert lowered.fp > 1
    if missed.remedy is not None:
        assert wrong(missed.remedy.after) <= wrong(found.counts) == 1
        assert missed.remedy.after == walk.counts(*settings, *missed.remedy.settings)
    else:
        assert found.mended_missed == Mended(0, 0, 1)


def test_a_fresh_replay_with_the_remedy_of_a_false_step_loses_it() -> None:
    walk, found = standing(), explain_steps(standing().evidence(*ALL_OPEN))
    remedies = [(f, f.remedy) for f in found.false if f.remedy is not None]
    assert found.mended_false == Mended(
        one=sum(len(r.changes) == 1 for _, r in remedies),
        two=sum(len(r.changes) == 2 for _, r in remedies),
        none=len(found.false) - len(remedies),
    )
    assert found.mended_false.one
    assert found.mended_false.two
    for number in (1, 2):
        for false, remedy in several([(f, r) for f, r in remedies if len(r.changes) == number]):
            again = walk.matching(*ALL_OPEN, *remedy.settings)
            false_s = seconds(again.found_ns[again.false])
            assert not np.isclose(false_s, false.time_s, atol=1e-6).any()
            assert remedy.after == walk.counts(*ALL_OPEN, *remedy.settings)
            assert wrong(remedy.after) <= wrong(remedy.before)


def standing() -> Walk:
    """The walk, every third of its true steps said to be none."""
    walk = waist_walk()
    steps = [x for x in walk.labels if x.kind == "step"]
    return replace(walk, labels=tuple(x for x in walk.labels if x not in steps[::3]))


def test_a_step_found_late_is_mended_only_where_its_detection_is_false_no_more() -> None:
    walk = waist_walk()
    steps = [x for x in walk.labels if x.kind == "step"]
    early = replace(steps[30], time_ns=steps[30].time_ns - 200_000_000)
    walk = replace(walk, labels=tuple(early if x is steps[30] else x for x in walk.labels))
    healer = RemedySearch(OfflineDecider(walk.evidence()), 0.12)
    matching = healer.matching
    (missed,) = matching.truth_ns[matching.missed].tolist()
    (late,) = matching.found_ns[matching.false].tolist()
    assert 120e6 < late - missed < 320e6
    remedy = healer.recover(missed, late)
    if remedy is not None:
        again = walk.matching(*remedy.settings)
        assert late not in again.found_ns[again.false]


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path: Path = tmp_path_factory.mktemp("remedies") / "room.mcap"
    write(simulate_room(RoomOptions(duration_s=12.0, rate_hz=5000.0, snr=12.0)), path)
    return path


@pytest.mark.parametrize(
    "settings",
    [
        ("picks.ratio=9", "steps.min_channels=8"),
        ("picks.ratio=20", "steps.min_channels=9"),
        (
            "picks.ratio=2.5",
            "steps.min_channels=1",
            "steps.refractory_s=0.05",
            "picks.refractory_s=0.02",
        ),
    ],
    ids=" ".join,
)
def test_fresh_replays_of_a_simulated_room_give_the_printed_figures(
    room: Path, settings: tuple[str, ...]
) -> None:
    def fresh(*more: str) -> Counts:
        config = with_settings(load_pipeline("room-steps"), [*settings, *more])
        return Counts.of(matched(measure_evidence(room, config), 0.12))

    config = with_settings(load_pipeline("room-steps"), list(settings))
    found = explain_steps(measure_evidence(room, config))
    remedies = {w.remedy for w in (*found.missed, *found.false) if w.remedy is not None}
    assert remedies
    assert found.counts == fresh()
    for remedy in several(sorted(remedies, key=lambda r: (-len(r.changes), r.settings))):
        assert remedy.after == fresh(*remedy.settings), remedy.settings
        assert wrong(remedy.after) <= wrong(remedy.before)


def test_fresh_replays_of_a_simulated_walk_with_turned_truth_give_the_printed_figures(
    tmp_path: Path,
) -> None:
    write(simulate_walk(WalkOptions(duration_s=40.0, seed=5)), tmp_path / "walk.mcap")
    walk = walk_of(tmp_path / "walk.mcap")
    start = walk.start_ns
    more = tuple(Label(start + round(t * 1e9), "step") for t in np.arange(1.0, 40.0, 3.7))
    walk = replace(walk, labels=(*walk.labels, *more))
    settings = ("steps.height=1.6", "steps.swing=3.5", "steps.refractory_s=0.5")
    found = explain_steps(walk.evidence(*settings))
    remedies = {w.remedy for w in (*found.missed, *found.false) if w.remedy is not None}
    assert any(len(remedy.changes) == 2 for remedy in remedies)
    for remedy in several(sorted(remedies, key=lambda r: (-len(r.changes), r.settings))):
        assert remedy.after == walk.counts(*settings, *remedy.settings), remedy.settings
