"""A replay of a span has the decisions of the whole recording, and nothing of beside it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from decided_spans import assert_same_span

from groundtrace.api.replay import PlannedReplay
from groundtrace.explain.suitability import prepared
from groundtrace.pipeline.config import load_pipeline
from groundtrace.pipeline.engine import EventList
from groundtrace_codecs.events import Note, StageSpec
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S
from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from groundtrace.pipeline.engine import ReplayCounts
    from groundtrace_codecs.events import Event

#: What is replayed, and which spans of it [s]: the first ones cut a step's tail and a rhythm.
SPANS = {
    ("room-walk.mcap", "room-footsteps"): [(3.0, 5.0), (6.31, 7.7), (0.5, None), (None, 4.2)],
    ("room-walk.mcap", "room-steps"): [(3.0, 5.0), (9.777, 11.0)],
    ("waist-walk.mcap", "waist-steps"): [(20.0, 25.0), (43.21, None), (None, 17.3)],
    ("waist-walk.mcap", "pedestrian"): [(10.4, 30.0)],
    ("waist-walk.mcap", "waist-swing"): [(50.5, 55.0)],
}


def replayed(
    name: str, pipeline: str, from_s: float | None = None, to_s: float | None = None
) -> tuple[list[Event], ReplayCounts, list[str]]:
    said: list[str] = []
    with Recording.open(path_of(name)) as recording:
        ready = prepared(load_pipeline(pipeline), recording)
        plan = PlannedReplay.of(
            recording, path_of(name), ready, from_s, to_s, lambda line: said.append(line)
        )
        kept = EventList()
        tally = plan.run([kept])
    return kept.events, tally, said


@pytest.mark.parametrize(("name", "pipeline"), SPANS)
def test_a_span_has_the_decisions_of_the_whole(name: str, pipeline: str) -> None:
    whole, all_of_it, _ = replayed(name, pipeline)
    assert all_of_it.first_ns is not None
    for from_s, to_s in SPANS[name, pipeline]:
        part, tally, _ = replayed(name, pipeline, from_s, to_s)
        start_ns, stop_ns = (
            None if s is None else all_of_it.first_ns + round(s * NS_PER_S) for s in (from_s, to_s)
        )
        assert assert_same_span(whole, part, start_ns, stop_ns)
        assert start_ns is None or tally.first_ns == start_ns
        dated = [event for event in part if not isinstance(event, StageSpec)]
        times = [t for event in dated for t in _times_of(event)]
        assert start_ns is None or min(times) >= start_ns
        assert stop_ns is None or max(times) < stop_ns


def _times_of(event: Event) -> list[int]:
    time_ns = event.time_ns  # type: ignore[union-attr]
    return [time_ns] if isinstance(time_ns, int) else time_ns.tolist()


def test_what_is_replayed_beside_a_span_is_said() -> None:
    _, _, said = replayed("room-walk.mcap", "room-footsteps", 3.0, 4.0)
    line = "the span is replayed with the 3.0 s before it, on all of which arrivals depends"
    assert line in said
    _, _, said = replayed("room-walk.mcap", "room-steps", 3.0, 4.0)
    assert not any("before it" in line for line in said)
    _, _, said = replayed("room-walk.mcap", "room-footsteps", None, 4.0)
    assert not any("the span" in line for line in said)


def test_a_span_says_no_more_than_the_whole() -> None:
    whole, _, _ = replayed("room-walk.mcap", "room-footsteps")
    part, _, _ = replayed("room-walk.mcap", "room-footsteps", 3.0, 5.0)
    notes = {e.text for e in whole if isinstance(e, Note)}
    assert {e.text for e in part if isinstance(e, Note)} <= notes
