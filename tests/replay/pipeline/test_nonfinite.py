"""Samples that are not finite are held at the last finite value, whatever the blocks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from replay_blocks import START_NS, block_of, cuts_of, split, stream_of

from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import load_pipeline
from groundtrace.pipeline.parameters import StageConfig
from groundtrace.pipeline.plugins import load
from groundtrace.pipeline.source import NonFiniteHold
from groundtrace.pipeline.stage import StageRunner
from groundtrace_codecs.events import Gap, Note
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

STREAM = stream_of(2, 1000.0)
NAN, INF = float("nan"), float("inf")


def block(*columns, dtype=np.float64) -> SignalBlock:
    return SignalBlock(STREAM, START_NS, 0, np.array(columns, dtype).T)


def held(columns: np.ndarray) -> np.ndarray:
    """Walk through the samples one by one."""
    out = np.array(columns)
    for channel in out:
        last = 0.0
        for i, value in enumerate(channel):
            last = value if np.isfinite(value) else last
            channel[i] = last
    return out


def test_each_channel_is_held_at_its_own_last_finite_value():
    holder = NonFiniteHold()
    found = holder.fill(block([1, NAN, INF, 4], [NAN, 2, -INF, NAN]))
    assert found.samples.T.tolist() == [[1, 1, 1, 4], [0, 2, 2, 2]]
    assert holder.count == 5
    assert holder.last_ns == START_NS + 3 * NS_PER_S // 1000


SAMPLES = st.lists(
    st.tuples(*[st.sampled_from([1.0, -2.0, 3.5, NAN, INF, -INF])] * 2), min_size=1, max_size=30
)


@given(rows=SAMPLES, cuts=cuts_of(30), dtype=st.sampled_from([np.float32, np.float64]))
def test_parts_are_held_exactly_like_the_whole(rows, cuts, dtype):
    columns = np.array(rows, dtype).T
    whole, parts = NonFiniteHold(), NonFiniteHold()
    at_once = whole.fill(block(*columns, dtype=dtype))
    pieces = [parts.fill(p) for p in split(block(*columns, dtype=dtype), cuts)]
    joined = np.concatenate([p.samples for p in pieces])
    assert np.array_equal(joined, at_once.samples)
    assert np.array_equal(joined.T, held(columns))
    assert joined.dtype == dtype
    assert (parts.count, parts.last_ns) == (whole.count, whole.last_ns)
    assert whole.count == (~np.isfinite(columns)).sum()


@pytest.mark.parametrize("dtype", [np.int16, np.int32, np.float32])
def test_a_finite_block_passes_as_the_same_object(dtype):
    one = block([1, 2], [3, 4], dtype=dtype)
    holder = NonFiniteHold()
    assert holder.fill(one) is one
    assert holder.count == 0


def test_the_block_given_is_not_changed():
    one = block([1, NAN], [1, 1])
    NonFiniteHold().fill(one)
    assert np.isnan(one.samples[1, 0])


def test_an_empty_block_changes_nothing():
    holder = NonFiniteHold()
    holder.fill(block([5], [6]))
    empty = block([], [])
    assert holder.fill(empty) is empty
    assert holder.fill(block([NAN], [NAN])).samples.tolist() == [[5, 6]]


def walk(bad=()) -> SignalBlock:
    """Twelve seconds of steps at 1.8 Hz, with some samples that are not finite."""
    time = np.arange(1200) / 100.0
    stream = stream_of(1, 100.0)
    channel = replace(stream.channels[0], quantity="acceleration", unit="m/s2")
    samples = 9.81 + 3 * np.sin(2 * np.pi * 1.8 * time)
    samples[list(bad)] = NAN
    return block_of(replace(stream, channels=(channel,)), 0, samples)


def notes_of(items) -> list[Note]:
    chain = build_pipeline(load_pipeline("waist-steps"))
    events = [e for item in items for e in chain.process(item)] + list(chain.flush())
    return [e for e in events if isinstance(e, Note)]


def test_a_stage_tells_once_a_run_how_many_samples_it_held():
    (note,) = notes_of(split(walk([100, 101, 700]), [300, 900]))
    assert note.text == "/s: 3 samples not finite, last value held"
    assert note.source == "steps"
    assert note.time_ns == START_NS + 7 * NS_PER_S
    assert notes_of([walk()]) == []


def test_after_a_gap_samples_are_held_and_counted_anew():
    before, after = split(walk([10, 700]), [600])
    gap = Gap("/s", before.end_ns, after.start_ns, "missing", 500)
    assert [n.text.split()[1] for n in notes_of([before, gap, after])] == ["1", "1"]


def test_a_new_run_does_not_begin_with_a_value_from_before_the_gap():
    before, after = split(walk([600, 601]), [600])
    gap = Gap("/s", before.end_ns, after.start_ns, "missing", 500)

    measured = []

    class Steps(load("stages", "adaptive")):
        def process(self, block):
            measured.append(block)
            return super().process(block)

    def first_value(items) -> float:
        stage = StageRunner(StageConfig("adaptive", "steps"), Steps, Steps.Parameters())
        for item in [*items, after.slice(0, 1)]:
            list(stage.process(item))
        return float(measured[-1].samples[0, 0])

    assert first_value([before, gap]) == 0.0
    assert first_value([before]) == before.samples[-1, 0]
