"""First breaks: the picks of a shot that a travel-time curve goes through."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from stage_contexts import context_of, rows_in

from groundtrace.detectors.first_breaks import FirstBreakParameters, FirstBreaks
from groundtrace.pipeline.gates import Candidates
from groundtrace.pipeline.stage import StageConfig, StageRunner
from groundtrace_codecs.events import GateSpec, Pick, Quantity, StageSpec

MS = 1_000_000
COLUMNS = ("ratio", "deficit", "channels", "uncertainty")


def spec(channels: int, threshold: float = 5.0) -> StageSpec:
    names = tuple(f"G{i}" for i in range(channels))
    gate = GateSpec("ratio", "1", "ratio", threshold)
    return StageSpec("picks", "p", "/s", names, (Quantity("ratio", "1"),), (gate,), (), "pick")


def pick(channel: int, time_ms: float, ratio: float = 20.0) -> Pick:
    return Pick(round(time_ms * MS), f"G{channel}", "/s", "picks", 0.0005, ratio)


def in_order(found: Pick) -> tuple[int, int]:
    return found.time_ns, int(found.channel[1:])


def associated(picks, channels: int = 24, **parameters) -> Candidates:
    stage = FirstBreaks(FirstBreakParameters(**parameters))
    assert stage.start(context_of(spec(channels))) == spec(channels).channels
    ordered = sorted(picks, key=in_order)
    parts = [part for p in ordered for part in stage.process(p)]
    return Candidates.concatenate([Candidates.empty(len(COLUMNS)), *parts, *stage.flush()])


def chosen(picks, channels: int = 24) -> dict[int, list[float]]:
    """Times [ms] of the picks that a stage passes on, by channel."""
    stage = StageRunner(StageConfig("first-breaks", "fb"), FirstBreaks, FirstBreakParameters())
    ordered = sorted(picks, key=in_order)
    events = [e for item in [spec(channels), *ordered] for e in stage.process(item)]
    events += stage.flush()
    found: dict[int, list[float]] = {}
    for event in events:
        if isinstance(event, Pick):
            found.setdefault(int(event.channel[1:]), []).append(event.time_ns / MS)
    return found


def moveout(channel: int, at_ms: float = 1000.0) -> float:
    return at_ms + 0.8 * abs(channel - 10)


@pytest.mark.parametrize("seed", range(8))
def test_a_moveout_line_is_found_among_random_false_picks(seed):
    rng = np.random.default_rng(seed)
    line = {c: round(moveout(c) + rng.normal(0, 0.2), 3) for c in range(24)}
    picks = [pick(c, t, rng.uniform(8, 40)) for c, t in line.items()]
    for channel in rng.integers(24, size=40).tolist():
        picks += [pick(channel, rng.uniform(1022, 1122), rng.uniform(6, 60))]
    found = chosen(picks)
    right = sum(line[c] in found.get(c, []) for c in line)
    assert right >= 23
    assert sum(len(times) for times in found.values()) <= 25


def test_a_weak_first_break_is_preferred_to_a_strong_later_phase():
    picks = [pick(c, moveout(c), 10.0) for c in range(24)]
    picks += [pick(c, moveout(c) + 45.0, 300.0) for c in (0, 12)]
    assert chosen(picks) == {c: [moveout(c)] for c in range(24)}


def test_a_channel_without_a_pick_on_the_line_may_be_left_out():
    picks = [pick(c, moveout(c)) for c in range(24) if c != 7]
    found = chosen([*picks, pick(7, moveout(7) + 110.0)])
    assert sorted(found) == [c for c in range(24) if c != 7]


def test_shots_are_told_apart():
    picks = [pick(c, moveout(c, at)) for at in (1000.0, 2000.0, 3500.0) for c in range(24)]
    assert all(len(times) == 3 for times in chosen(picks).values())


def test_without_a_quorum_there_is_no_shot():
    found = associated([pick(c, 10.0 + c) for c in range(7)])
    assert np.isposinf(found.value[:, COLUMNS.index("deficit")]).all()
    assert chosen([pick(c, 10.0 + c) for c in range(7)]) == {}
    assert len(chosen([pick(c, 10.0 + c) for c in range(8)])) == 8


def test_few_channels_need_no_more_than_all_of_them():
    assert len(chosen([pick(c, 10.0 + c) for c in range(3)], channels=3)) == 3


def test_a_lone_early_pick_does_not_swallow_the_shot():
    found = chosen([pick(3, 900.0, 50.0), *(pick(c, moveout(c)) for c in range(24))])
    assert found == {c: [moveout(c)] for c in range(24)}


def test_every_pick_is_a_candidate_with_its_ratio_and_uncertainty():
    picks = [pick(c, moveout(c), 10.0 + c) for c in range(24)] + [pick(2, 5000.0)]
    found = associated(picks)
    assert len(found) == 25
    order = np.lexsort((found.channel, found.time_ns))
    assert np.array_equal(order, np.arange(25))
    assert np.allclose(found.value[:, COLUMNS.index("uncertainty")], 0.0005)
    assert found.value[-1].tolist() == pytest.approx([20.0, np.inf, 1.0, 0.0005])
    assert (found.value[:-1, COLUMNS.index("channels")] == 24).all()


def test_the_best_path_lacks_nothing():
    found = associated([pick(c, moveout(c)) for c in range(24)])
    assert np.abs(found.value[:, COLUMNS.index("deficit")]).max() < 1e-6


def best_score(picks: list[Pick], through: int, channels: int, p: FirstBreakParameters) -> float:
    """Try every choice of at most one pick per channel that holds the pick ``through``."""
    first = min(x.time_ns for x in picks)
    options: list[list[Pick | None]] = [
        [None, *(x for x in picks if x.channel == f"G{c}")] for c in range(channels)
    ]
    best = -np.inf
    for path in product(*options):
        line = [x for x in path if x is not None]
        if not any(x is picks[through] for x in line):
            continue
        score = sum(
            min(np.log(x.value / 5.0), p.evidence) - p.lateness * (x.time_ns - first) / 1e9
            for x in line
        )
        jumps = np.abs(np.diff([x.time_ns / 1e9 for x in line]))
        best = max(best, score - p.jump * np.minimum(jumps, p.jump_s).sum())
    return best


@settings(max_examples=40)
@given(
    rows=st.lists(
        st.tuples(st.integers(0, 3), st.integers(0, 100), st.sampled_from([5.5, 8.0, 30.0])),
        min_size=4,
        max_size=8,
        unique_by=lambda r: r[:2],
    )
)
def test_deficits_are_those_of_all_paths_tried(rows):
    p = FirstBreakParameters(quorum=1, window_s=0.2)
    picks = sorted((pick(*r) for r in rows), key=in_order)
    scores = np.array([best_score(picks, i, 4, p) for i in range(len(picks))])
    found = associated(picks, 4, quorum=1, window_s=0.2)
    deficit = found.value[:, COLUMNS.index("deficit")]
    assert np.allclose(deficit, scores.max() - scores, atol=1e-4)


def test_picks_are_resolved_as_soon_as_their_shot_is_over():
    stage = FirstBreaks(FirstBreakParameters(quorum=2))
    stage.start(context_of(spec(4)))
    picks = pick(0, 0), pick(1, 5), pick(2, 150), pick(3, 400)
    counts = [rows_in(stage.process(p)) for p in picks]
    assert counts == [0, 0, 0, 3]
    assert rows_in(stage.flush()) == 1
    assert rows_in(stage.flush()) == 0
