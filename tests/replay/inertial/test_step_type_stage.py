"""The stage: four types told on simulated people, in time, whatever the blocks."""

from __future__ import annotations

import copy
from collections import Counter

import numpy as np
import pytest
from typed_walks import (
    TOPIC,
    Walk,
    accelerations,
    begun,
    mounted,
    simulated,
    stage,
    step_at,
    told,
    types_of,
)

from groundtrace.errors import PipelineError
from groundtrace.evaluation.report import score_events
from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import load_pipeline, parse_pipeline
from groundtrace.pipeline.parameters import describe
from groundtrace_codecs.events import CandidateBlock, Event, Gap, Note, StageSpec, StepEvent


@pytest.fixture(scope="module")
def walk() -> Walk:
    return simulated(301)


def key(events: list[Event]) -> list[tuple[int, str, float]]:
    return [(e.time_ns, e.type, e.value) for e in events if isinstance(e, StepEvent)]


@pytest.fixture(scope="module")
def events(walk: Walk) -> list[tuple[int, Event]]:
    return list(told(begun(stage()), walk))


def test_types_of_true_contacts_are_told(walk: Walk, events: list[tuple[int, Event]]) -> None:
    said = {e.time_ns: e.type for _, e in events if isinstance(e, StepEvent)}
    pairs = Counter((label, said.get(time_ns, "none")) for time_ns, label in walk.steps)
    right = sum(count for (label, found), count in pairs.items() if label == found)
    assert {label for label, _ in pairs} == {"forward", "backward", "left", "right"}
    assert right >= 0.97 * len(walk.steps), pairs
    closing = [x.time_ns for x in walk.labels if x.kind == "trailing"]
    assert sum(time_ns in said for time_ns in closing) <= 0.1 * len(closing)


@pytest.mark.parametrize("turned_deg", [90.0, 180.0, -130.0])
def test_types_are_told_however_the_sensor_is_turned_about_the_vertical(
    walk: Walk, turned_deg: float
) -> None:
    events = told(begun(stage()), mounted(walk, turned_deg))
    said = {e.time_ns: e.type for _, e in events if isinstance(e, StepEvent)}
    wrong = [n for n, (time_ns, kind) in enumerate(walk.steps) if said.get(time_ns) != kind]
    # only while nothing has told yet how it is turned
    assert len([n for n in wrong if n >= 5]) <= 0.03 * len(walk.steps), wrong
    named = told(begun(stage(forward="x")), mounted(walk, turned_deg))
    by_name = {e.time_ns: e.type for _, e in named if isinstance(e, StepEvent)}
    assert sum(by_name.get(t) == kind for t, kind in walk.steps) < 0.5 * len(walk.steps)


def test_a_type_is_told_within_four_steps(walk: Walk, events: list[tuple[int, Event]]) -> None:
    contacts = np.array(walk.contacts_ns)
    late = 0
    for now_ns, event in events:
        if isinstance(event, StepEvent):
            after = contacts[contacts > event.time_ns][:5]
            walking = len(after) == 5 and np.diff(after, prepend=event.time_ns).max() < 1.6e9
            # blocks are half a second long: one may end that much after what it needed
            late += walking and now_ns > after[3] + 0.15e9 + 0.5e9
    assert late == 0


def test_every_step_has_a_candidate_of_each_type_and_at_most_one_passes(
    events: list[tuple[int, Event]],
) -> None:
    blocks = [e for _, e in events if isinstance(e, CandidateBlock)]
    assert all(b.channel.tolist() == [0, 1, 2, 3] * (len(b) // 4) for b in blocks)
    assert all(b.accepted.reshape(-1, 4).sum(axis=1).max() <= 1 for b in blocks)
    assert all(np.array_equal((b.margin >= 0).all(axis=1), b.accepted) for b in blocks)
    assert all(np.isfinite(b.value).all() for b in blocks)
    accepted = [int(time_ns) for b in blocks for time_ns in b.time_ns[b.accepted]]
    assert accepted == [e.time_ns for _, e in events if isinstance(e, StepEvent)]


@pytest.mark.parametrize(("samples", "late_s"), [(31, 0.0), (1000, 3.0), (100_000, 0.0)])
def test_blocks_and_delays_change_nothing(
    walk: Walk, events: list[tuple[int, Event]], samples: int, late_s: float
) -> None:
    other = told(begun(stage()), walk, samples, round(late_s * 1e9))
    assert key([e for _, e in other]) == key([e for _, e in events])


def test_a_copy_made_in_the_middle_goes_on_as_the_stage_does(
    walk: Walk, events: list[tuple[int, Event]]
) -> None:
    made = begun(stage())
    middle = len(walk.blocks) // 2
    cut_ns = walk.blocks[middle].start_ns
    found: list[Event] = []
    for blocks in (walk.blocks[:middle], walk.blocks[middle:]):
        made = copy.deepcopy(made)
        for block in blocks:
            found += made.process(block)
            inside = [t for t in walk.contacts_ns if block.start_ns <= t < block.end_ns]
            for time_ns in inside:
                found += made.process(step_at(time_ns))
    found += made.flush()
    assert cut_ns > walk.span_ns[0]
    assert key(found) == key([e for _, e in events])


def test_a_gap_ends_the_walk_and_tells_what_waited(walk: Walk) -> None:
    made = begun(stage())
    first = [b for b in walk.blocks if b.start_ns < walk.contacts_ns[8]]
    for block in first:
        list(made.process(block))
    for time_ns in walk.contacts_ns[:8]:
        list(made.process(step_at(time_ns)))
    gap = Gap(TOPIC, first[-1].end_ns, first[-1].end_ns + 10**9, "missing", 100)
    waited = [e for e in made.process(gap) if isinstance(e, StepEvent)]
    assert [e.time_ns for e in waited] == walk.contacts_ns[8 - len(waited) : 8]
    assert len(waited) >= 2
    assert not list(made.flush())


def test_a_sensor_without_three_axes_is_told_once_and_types_nothing() -> None:
    made = begun(stage())
    blocks = accelerations(np.ones((300, 2)))
    found = [
        e for b in (blocks[0].slice(0, 100), blocks[0].slice(100, 300)) for e in made.process(b)
    ]
    found += [*made.process(step_at(blocks[0].start_ns)), *made.flush()]
    (note,) = found
    assert isinstance(note, Note)
    assert "expected accelerations along x, y and z" in note.text


def test_silence_and_samples_that_are_not_finite_give_defined_candidates() -> None:
    samples = np.zeros((1000, 6))
    samples[300:500] = np.nan
    (block,) = accelerations(samples)
    made = begun(stage())
    found = list(made.process(block))
    for second in (2, 3, 4, 8):
        found += made.process(step_at(block.start_ns + second * 10**9))
    found += made.flush()
    blocks = [e for e in found if isinstance(e, CandidateBlock)]
    assert sum(map(len, blocks)) == 4 * 4
    assert all(np.isfinite(b.value).all() for b in blocks)


def test_only_the_steps_of_its_topics_are_taken(walk: Walk) -> None:
    made = stage()
    other = types_of(made.kind, made.parameters, ("/other*",))
    assert not list(told(begun(other), walk))


def test_the_shipped_pipeline_finds_and_types_steps_of_a_person_never_seen(walk: Walk) -> None:
    pipeline = build_pipeline(load_pipeline("step-types"))
    found = [e for block in walk.blocks for e in pipeline.process(block)] + list(pipeline.flush())
    assert [e.emits for e in found if isinstance(e, StageSpec)] == ["step", "step"]
    score = score_events(walk.labels, found, *walk.span_ns).steps
    assert score is not None
    assert score.f1 > 0.9
    assert score.kinds is not None
    assert score.kinds.words == ["backward", "forward", "left", "right"]
    assert score.kinds.accuracy >= 0.97
    assert score.feet is None


def test_types_need_steps() -> None:
    config = parse_pipeline(b'name = "t"\n[[stage]]\nuse = "step-types"\n', "t.toml")
    with pytest.raises(PipelineError, match="expected a stage that gives steps before it"):
        build_pipeline(config)


def test_every_gate_has_a_documented_parameter() -> None:
    kind = stage().kind
    parts = {info.name: info.part for info in describe(kind.Parameters)}
    assert all(parts[gate.parameter] == "decide" for gate in kind.gates)
