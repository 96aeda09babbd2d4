"""Coincidence: picks of several channels close in time are one impact."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from stage_contexts import context_of, rows_in

from groundtrace.detectors.coincidence import Coincidence, CoincidenceParameters
from groundtrace.pipeline.gates import Candidates, decide
from groundtrace.pipeline.parameters import StageConfig
from groundtrace.pipeline.stage import StageRunner
from groundtrace_codecs.events import (
    CandidateBlock,
    Gap,
    GateSpec,
    Pick,
    Quantity,
    StageSpec,
    StepEvent,
)

MS = 1_000_000
SPEC = StageSpec(
    "picks",
    "toa-cv",
    "/s",
    tuple(f"G{i}" for i in range(6)),
    (Quantity("ratio", "1"),),
    (GateSpec("ratio", "1", "ratio", 5.0),),
    (),
    "pick",
)


def pick(channel: int, time_ms: float, topic: str = "/s") -> Pick:
    return Pick(round(time_ms * MS), f"G{channel}", topic, "picks", 0.001, 9.0)


def groups(picks, **parameters) -> Candidates:
    worker = Coincidence(CoincidenceParameters(**parameters))
    assert worker.start(context_of(SPEC)) == ("all",)
    parts = [part for p in picks for part in worker.process(p)]
    return Candidates.concatenate([*parts, *worker.flush()])


def stage(**parameters) -> StageRunner:
    return StageRunner(
        StageConfig("coincidence", "steps"), Coincidence, CoincidenceParameters(**parameters)
    )


def test_picks_within_the_window_of_the_first_are_one_group():
    found = groups([pick(0, 0), pick(1, 20), pick(2, 49.9), pick(3, 60), pick(4, 61)])
    assert found.time_ns.tolist() == [0, 60 * MS]
    assert found.value[:, 0].tolist() == [3, 2]
    assert found.value[:, 1].tolist() == pytest.approx([0.0499, 0.001])


def test_the_window_includes_its_end():
    assert groups([pick(0, 0), pick(1, 50)]).value[:, 0].tolist() == [2]
    later = Pick(50 * MS + 1, "G1", "/s", "picks", 0.001, 9.0)
    assert groups([pick(0, 0), later]).value[:, 0].tolist() == [1, 1]


def test_a_channel_counts_once():
    found = groups([pick(0, 0), pick(0, 10), pick(1, 20)])
    assert found.value[:, 0].tolist() == [2]


def test_a_group_comes_out_as_soon_as_the_next_pick_is_outside_its_window():
    worker = Coincidence(CoincidenceParameters())
    worker.start(context_of(SPEC))
    picks = pick(0, 0), pick(1, 10), pick(0, 100)
    assert [rows_in(worker.process(p)) for p in picks] == [0, 0, 1]
    assert rows_in(worker.flush()) == 1
    assert rows_in(worker.flush()) == 0


@given(
    times=st.lists(st.integers(0, 400), min_size=1, max_size=40).map(sorted),
    channels=st.lists(st.integers(0, 5), min_size=40, max_size=40),
)
def test_groups_are_those_of_a_plain_loop(times, channels):
    expected: list[tuple[int, set[int], int]] = []
    for time, channel in zip(times, channels, strict=False):
        if expected and time - expected[-1][0] <= 50:
            first, seen, _ = expected[-1]
            expected[-1] = (first, seen | {channel}, time)
        else:
            expected.append((time, {channel}, time))
    found = groups([pick(c, t) for t, c in zip(times, channels, strict=False)])
    assert found.time_ns.tolist() == [g[0] * MS for g in expected]
    assert found.value[:, 0].tolist() == [len(g[1]) for g in expected]
    assert np.allclose(found.value[:, 1], [(g[2] - g[0]) / 1e3 for g in expected])


def impact(time_ms: float, channels: int = 4, topic: str = "/s") -> list[Pick]:
    return [pick(c, time_ms + c, topic) for c in range(channels)]


def run(chain: StageRunner, items) -> list:
    return [e for item in items for e in chain.process(item)] + list(chain.flush())


def steps_of(events) -> list[StepEvent]:
    return [e for e in events if isinstance(e, StepEvent)]


def test_a_step_needs_channels_and_time_since_the_last_one():
    items = [SPEC, *impact(0), *impact(100), *impact(300, 3), *impact(600)]
    events = run(stage(), items)
    assert [(e.time_ns, e.kind, e.channels, e.stage) for e in steps_of(events)] == [
        (0, "step", 4, "steps"),
        (600 * MS, "step", 4, "steps"),
    ]
    blocks = [e for e in events if isinstance(e, CandidateBlock)]
    assert np.concatenate([b.accepted for b in blocks]).tolist() == [True, False, False, True]
    margin = np.concatenate([b.margin for b in blocks])
    assert np.allclose(margin[1:3], [[0, -0.15], [-1, 0.05]], atol=1e-6)


def test_topics_are_associated_apart():
    other = StageSpec("picks", "toa-cv", "/t", SPEC.channels, SPEC.columns, SPEC.gates, (), "pick")
    mixed = sorted([*impact(0, 2), *impact(2, 4, "/t")], key=lambda p: p.time_ns)
    events = run(stage(), [SPEC, other, *mixed])
    assert [(e.topic, e.channels) for e in steps_of(events)] == [("/t", 4)]
    chosen = StageRunner(
        StageConfig("c", "s", ("/s*",)), Coincidence, CoincidenceParameters(min_channels=2)
    )
    assert [e.topic for e in steps_of(run(chosen, [SPEC, other, *mixed]))] == ["/s"]


def told(event) -> tuple:
    """Return an event as something that can be compared."""
    if not isinstance(event, CandidateBlock):
        return (event,)
    columns = (event.value, event.gate_value, event.margin, event.accepted)
    return (event.spec, event.time_ns.tolist(), *(c.tolist() for c in columns))


def test_many_items_at_once_bring_about_what_each_does_by_itself():
    other = StageSpec("picks", "toa-cv", "/t", SPEC.channels, SPEC.columns, SPEC.gates, (), "pick")
    picks = [*impact(0), *impact(2, 4, "/t"), *impact(400), *impact(900), *impact(901, 5, "/t")]
    picks = sorted(picks, key=lambda p: p.time_ns)
    items = [SPEC, other, *picks, Gap("/s", 0, 0, "clock step", 0), *impact(100), *impact(500)]
    one, at_once = stage(), stage()
    expected = [[told(e) for e in one.process(item)] for item in items]
    assert [[told(e) for e in events] for events in at_once.process_all(items)] == expected
    assert [told(e) for e in at_once.flush()] == [told(e) for e in one.flush()]


def test_picks_of_an_unknown_topic_are_left_alone():
    assert run(stage(), impact(0)) == []


def test_a_clock_that_is_set_back_ends_the_group_and_the_refractory_time():
    back = Gap("/s", 0, 0, "clock step", 0)
    items = [SPEC, *impact(900_000), back, *impact(100), *impact(500)]
    assert [e.time_ns // MS for e in steps_of(run(stage(), items))] == [900_000, 100, 500]
    lost = Gap("/s", 0, 0, "missing", 9)
    items = [SPEC, *impact(0, 2), lost, pick(2, 5), pick(3, 6)]
    assert [e.channels for e in steps_of(run(stage(), items))] == [4]


def test_a_copy_made_in_a_group_goes_on_for_itself():
    items = [SPEC, *impact(0), *impact(400)]
    one = stage()
    events = [e for item in items[:3] for e in one.process(item)]
    other = copy.deepcopy(one)
    run(one, items[3:])  # what the first one does later is not seen by the second
    events += run(other, items[3:])
    assert [e.time_ns for e in steps_of(events)] == [0, 400 * MS]


SHARP = {"sharp_s": 0.004}


def heel(time_ms: float) -> list[Pick]:
    """Picks of all sensors within 2 ms."""
    return [pick(c, time_ms + 0.4 * c) for c in range(6)]


def toe(time_ms: float) -> list[Pick]:
    """Picks that scatter over 15 ms."""
    return [pick(c, time_ms + 3.0 * c) for c in range(6)]


def test_the_heel_of_another_walker_is_spared_the_refractory_time_and_a_toe_is_not():
    items = [SPEC, *heel(0), *heel(80), *toe(110), *toe(190), *heel(550)]
    times = [e.time_ns // MS for e in steps_of(run(stage(**SHARP), items))]
    assert times == [0, 80, 550]
    assert [e.time_ns // MS for e in steps_of(run(stage(), items))] == [0, 550]


def test_the_refractory_gate_says_how_long_ago_a_toe_s_heel_was():
    events = run(stage(**SHARP), [SPEC, *heel(0), *heel(80), *toe(190)])
    blocks = [e for e in events if isinstance(e, CandidateBlock)]
    value = np.concatenate([b.gate_value[:, 1] for b in blocks])
    assert value.tolist() == pytest.approx([np.inf, np.inf, 0.11])
    assert np.concatenate([b.value[:, 2] for b in blocks]).tolist() == [1, 1, 0]


def test_a_sharp_front_stands_alone_in_the_window_of_others():
    found = groups([*toe(0), *heel(25), *toe(40)], **SHARP)
    assert found.time_ns.tolist() == [0, 25 * MS, 40 * MS]
    assert found.value[:, 0].tolist() == [6, 6, 6]
    assert found.value[:, 2].tolist() == [0, 1, 0]


def test_a_front_that_few_channels_saw_is_not_sharp():
    found = groups([*heel(0)[:4], pick(5, 20)], **SHARP)
    assert found.value[:, 0].tolist() == [5]
    assert found.value[:, 2].tolist() == [0]


def test_deciding_again_at_once_is_deciding_one_by_one():
    rng = np.random.default_rng(1)
    items = [
        p for t in np.cumsum(rng.uniform(60, 200, 40)) for p in (heel, toe)[rng.integers(2)](t)
    ]
    parts = run(stage(**SHARP), [SPEC, *items])
    blocks = [e for e in parts if isinstance(e, CandidateBlock)]
    decisions, _ = decide(
        groups(items, **SHARP), Coincidence.columns, Coincidence.gates, CoincidenceParameters()
    )
    assert decisions.accepted.tolist() == np.concatenate([b.accepted for b in blocks]).tolist()
    values = np.concatenate([b.gate_value for b in blocks])
    assert np.array_equal(decisions.gate_value, values)
