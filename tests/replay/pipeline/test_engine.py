"""The replay loop: what sinks see, what is counted, how it waits."""

from __future__ import annotations

import time

import numpy as np
import pytest
from replay_blocks import START_NS, block_of, stream_of

from groundtrace.pipeline.chain import Pipeline
from groundtrace.pipeline.config import PipelineConfig
from groundtrace.pipeline.engine import Clock, ReplayCounts, replay
from groundtrace_codecs.events import CandidateBlock, Gap, Note, StageSpec, StepEvent, TraceBlock
from groundtrace_codecs.signals import NS_PER_S

STREAM = stream_of(2, 100.0)
SPEC = StageSpec("s", "p", "/s", ("G1", "G2"), (), (), ())
GAP = Gap("/s", START_NS + NS_PER_S, START_NS + 2 * NS_PER_S, "missing", 100)


def candidate_block(rows: int) -> CandidateBlock:
    empty = np.zeros((rows, 0), np.float32)
    times, channel = np.zeros(rows, np.int64), np.zeros(rows, np.int32)
    return CandidateBlock(SPEC, times, channel, empty, empty, empty, np.zeros(rows, np.bool_))


class Stage:
    """Answers every item with a step, and the end with a note."""

    name = "stage"

    def process(self, item):
        if not isinstance(item, Gap):
            yield candidate_block(3)
            yield TraceBlock(SPEC, np.zeros(4, np.int64), np.zeros((4, 2, 0), np.float32))
            yield StepEvent(item.last_ns, "step", "", item.topic, self.name, 1.0)

    def flush(self):
        yield Note(0, "end")


class Sink:
    def __init__(self, log: list, name: str) -> None:
        self.log, self.name = log, name

    def write(self, item) -> None:
        self.log.append((self.name, item))


def two_blocks():
    return [block_of(STREAM, 0, range(100)), GAP, block_of(STREAM, 200, range(50))]


def run(items, **options):
    log: list = []
    chain = Pipeline(PipelineConfig("test"), [Stage()], "")
    tally = replay(items, chain, [Sink(log, "a"), Sink(log, "b")], **options)
    return tally, log


def test_sinks_take_the_item_then_its_events_each_in_turn():
    _, log = run(two_blocks())
    kinds = ["SignalBlock", "CandidateBlock", "TraceBlock", "StepEvent"]
    expected = [*kinds, "Gap", *kinds, "Note"]
    assert [(name, type(item).__name__) for name, item in log] == [
        (name, kind) for kind in expected for name in ("a", "b")
    ]
    assert all(log[i][1] is log[i + 1][1] for i in range(0, len(log), 2))


def test_what_was_replayed_is_counted():
    tally, _ = run(two_blocks())
    assert tally.samples == 300
    assert tally.counts == {
        "CandidateBlock": 6,
        "TraceBlock": 8,
        "StepEvent": 2,
        "Gap": 1,
        "Note": 1,
    }
    assert tally.recorded_s == pytest.approx(2.5)
    assert tally.wall_s > 0


def test_nothing_is_counted_of_nothing():
    tally, log = run([])
    assert (tally.samples, tally.recorded_s) == (0, 0.0)
    assert [type(item).__name__ for _, item in log] == ["Note", "Note"]
    assert ReplayCounts() == ReplayCounts()


def test_the_span_reaches_over_all_streams_in_any_order():
    late = block_of(stream_of(1, 10.0, topic="/late"), 0, range(100))
    tally, _ = run([late, block_of(STREAM, 0, range(10), START_NS - NS_PER_S)])
    assert tally.recorded_s == pytest.approx(11.0)


def test_progress_tells_the_time_reached_and_never_goes_back():
    told: list[int] = []
    run([*two_blocks(), block_of(STREAM, 0, range(10))], progress=told.append)
    ends = [1.0, 1.0, 2.5, 2.5]
    assert told == [START_NS + round(s * NS_PER_S) for s in ends]


def test_the_loop_waits_as_long_as_the_clock_says(monkeypatch):
    now, slept = [100.0], []

    def sleep(seconds: float) -> None:
        slept.append(seconds)
        now[0] += seconds

    monkeypatch.setattr(time, "sleep", sleep)
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    run(two_blocks(), clock=Clock(2.0))
    assert sum(slept) == pytest.approx(0.75)  # 1.5 s between the ends of the blocks
    assert max(slept) <= 0.1


def test_without_a_clock_the_loop_never_sleeps(monkeypatch):
    slept = []
    monkeypatch.setattr(time, "sleep", slept.append)
    run(two_blocks())
    run(two_blocks(), clock=Clock(0.0))
    assert slept == []
