"""Contiguous runs: every rule of the module, and the same runs however the blocks are cut."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from replay_blocks import (
    START_NS,
    block_of,
    blocks_in,
    cuts_of,
    gaps_in,
    irregular_of,
    samples_in,
    split,
    stream_of,
    times_in,
)

from groundtrace.pipeline.source import IrregularRuns, UniformRuns, run_tracker
from groundtrace_codecs.events import Gap

STREAM = stream_of()
MS = 1_000_000
BRIDGE_S = 0.1


def runs_of(blocks, bridge_s=BRIDGE_S):
    tracker = run_tracker(blocks[0].stream, bridge_s)
    return [item for block in blocks for item in tracker.add(block)]


def ramp(first: int, count: int, shift_ms: float = 0.0):
    """Samples that say their own index, recorded ``shift_ms`` late."""
    anchor = START_NS + round(shift_ms * MS)
    return block_of(STREAM, first, range(first, first + count), anchor)


def test_samples_that_follow_each_other_are_one_run():
    items = runs_of([ramp(7, 5), ramp(12, 1), ramp(13, 4)])
    assert not gaps_in(items)
    assert [b.first for b in items] == [0, 5, 6]
    assert {b.anchor_ns for b in items} == {START_NS + 7 * MS}
    assert times_in(items).tolist() == [START_NS + i * MS for i in range(7, 17)]


def test_a_short_gap_is_filled_by_straight_lines_and_said_to_be_bridged():
    items = runs_of([ramp(0, 10), ramp(60, 10)])
    gap = Gap("/s", START_NS + 10 * MS, START_NS + 60 * MS, "missing", 50, bridged=True)
    assert gaps_in(items) == [gap]
    assert np.allclose(samples_in(items)[:, 0], np.arange(70), rtol=0, atol=1e-9)
    assert np.array_equal(times_in(items), START_NS + np.arange(70) * MS)
    assert len({b.anchor_ns for b in blocks_in(items)}) == 1


@pytest.mark.parametrize(("end", "line"), [(30, [10, 20, 30]), (-2, [0, 0, -1, -2])])
def test_the_filling_of_integers_is_rounded(end, line):
    stream = stream_of()
    first = replace(block_of(stream, 0, [line[0]]), samples=np.array([[line[0]]], np.int16))
    last = replace(first, first=len(line) - 1, samples=np.array([[end]], np.int16))
    samples = samples_in(runs_of([first, last]))
    assert samples.dtype == np.int16
    expected = np.rint(np.linspace(line[0], end, len(line)))
    assert np.array_equal(samples[:, 0], expected)


@pytest.mark.parametrize(("lost", "bridged"), [(100, True), (101, False)])
def test_the_longest_bridged_gap_is_the_one_asked_for(lost, bridged):
    items = runs_of([ramp(0, 10), ramp(10 + lost, 10)])
    (gap,) = gaps_in(items)
    assert (gap.lost, gap.bridged, gap.reason) == (lost, bridged, "missing")
    after = blocks_in(items)[-1]
    assert after.start_ns == START_NS + (10 + lost) * MS
    assert (after.first == 0) is not bridged
    assert len(samples_in(items)) == (20 + lost if bridged else 20)


def test_repeated_samples_are_dropped_and_counted():
    items = runs_of([ramp(0, 10), ramp(0, 10), ramp(6, 10)])
    assert [(g.reason, g.lost, g.bridged) for g in gaps_in(items)] == [
        ("duplicate", 10, True),
        ("duplicate", 4, True),
    ]
    assert samples_in(items)[:, 0].tolist() == list(range(16))
    assert np.array_equal(times_in(items), START_NS + np.arange(16) * MS)


def test_a_little_jitter_of_the_recorded_times_is_no_step():
    items = runs_of([ramp(0, 10), ramp(10, 10, 4.9), ramp(20, 10, -4.9)])
    assert not gaps_in(items)
    assert np.array_equal(times_in(items), START_NS + np.arange(30) * MS)


@pytest.mark.parametrize("shift_ms", [6.0, 99.0, -6.0, -99.0])
def test_a_small_clock_step_moves_the_times_of_the_run(shift_ms):
    items = runs_of([ramp(0, 200), ramp(200, 10, shift_ms), ramp(210, 10, shift_ms)])
    at = START_NS + round((200 + shift_ms) * MS)
    assert gaps_in(items) == [Gap("/s", at, at, "clock step", 0, bridged=True)]
    assert [b.first for b in blocks_in(items)] == [0, 200, 210]
    assert np.array_equal(times_in(items)[200:], at + np.arange(20) * MS)
    assert samples_in(items)[:, 0].tolist() == list(range(220))


def test_a_clock_set_back_far_ends_the_run():
    items = runs_of([ramp(0, 500), ramp(500, 10, -3600e3)])
    at = START_NS + 500 * MS - 3600 * 1000 * MS
    assert gaps_in(items) == [Gap("/s", at, at, "clock step", 0)]
    last = blocks_in(items)[-1]
    assert (last.anchor_ns, last.first) == (at, 0)


def test_a_clock_set_forward_far_ends_the_run_as_missing_samples():
    items = runs_of([ramp(0, 10), ramp(10, 10, 2000.0)])
    (gap,) = gaps_in(items)
    assert gap == Gap("/s", START_NS + 10 * MS, START_NS + 2010 * MS, "missing", 2000)


def test_a_counter_that_restarts_begins_a_new_run():
    restarted = ramp(0, 10, 700.0)
    items = runs_of([ramp(0, 500), restarted, ramp(10, 5, 700.0)])
    (gap,) = gaps_in(items)
    assert (gap.reason, gap.lost, gap.bridged) == ("missing", 200, False)
    assert (gap.start_ns, gap.end_ns) == (START_NS + 500 * MS, START_NS + 700 * MS)
    assert [(b.anchor_ns, b.first) for b in blocks_in(items)[1:]] == [
        (START_NS + 700 * MS, 0),
        (START_NS + 700 * MS, 10),
    ]


def test_empty_blocks_change_nothing():
    assert runs_of([ramp(3, 0), ramp(0, 2), ramp(2, 0), ramp(2, 1)])[0].start_ns == START_NS
    assert samples_in(runs_of([ramp(0, 2), ramp(9, 0), ramp(2, 1)]))[:, 0].tolist() == [0, 1, 2]


RECORDED = st.lists(
    st.tuples(
        st.integers(1, 12),  # samples
        st.sampled_from([0, 0, 0, 1, 5, 40, 100, 101, 300, -1, -4]),  # lost (or repeated)
        st.sampled_from([0.0, 0.0, 0.0, 2.0, 20.0, -20.0, 500.0, -5000.0]),  # step of the clock
    ),
    min_size=1,
    max_size=6,
)


def recorded(plan):
    index, shift, blocks = 50, 0.0, []
    for count, lost, step in plan:
        index = max(index + lost, 0)
        shift += step
        blocks.append(ramp(index, count, shift))
        index += count
    return blocks


def tally(items):
    """Gaps by reason and bridging: a repeated block cut in two is dropped in two parts."""
    found: dict = {}
    for gap in gaps_in(items):
        key = gap.reason if gap.reason == "duplicate" else gap
        found[key] = found.get(key, 0) + gap.lost
    return found


@given(plan=RECORDED, cuts=st.lists(cuts_of(12), min_size=6, max_size=6))
def test_uniform_runs_are_the_same_however_the_blocks_are_cut(plan, cuts):
    blocks = recorded(plan)
    whole = runs_of(blocks)
    parts = runs_of([p for b, c in zip(blocks, cuts, strict=False) for p in split(b, c)])
    assert np.array_equal(times_in(parts), times_in(whole))
    assert np.array_equal(samples_in(parts), samples_in(whole))
    assert tally(parts) == tally(whole)


@given(plan=RECORDED)
def test_the_times_of_a_run_rise_but_for_clock_steps(plan):
    before = None
    for item in runs_of(recorded(plan)):
        if isinstance(item, Gap):
            before = None if item.reason == "clock step" else before
            continue
        times = item.sample_times()
        assert (np.diff(times) > 0).all()
        assert before is None or times[0] > before
        before = times[-1]


IRREGULAR = stream_of(rate_hz=100.0, irregular=True)


def irregular_runs(times_ms, samples=None, sizes=None):
    samples = np.asarray(times_ms if samples is None else samples, np.float64)
    times = START_NS + np.rint(np.asarray(times_ms, np.float64) * MS).astype(np.int64)
    block = irregular_of(IRREGULAR, times, samples)
    return runs_of(split(block, sizes or ()))


def test_a_stream_gets_the_tracker_of_its_sampling():
    assert isinstance(run_tracker(STREAM, 0.1), UniformRuns)
    tracker = run_tracker(IRREGULAR, 0.1)
    assert isinstance(tracker, IrregularRuns)
    assert not tracker.stream.irregular


def test_irregular_samples_come_on_a_grid_by_straight_lines():
    rng = np.random.default_rng(3)
    times = np.cumsum(rng.uniform(6, 14, 300))
    samples = rng.normal(size=300)
    items = irregular_runs(times, samples)
    kept = (np.rint(times * MS) - round(times[0] * MS)) / MS
    grid = np.arange(0, kept[-1], 10.0)
    assert not gaps_in(items)
    assert np.allclose(samples_in(items)[:, 0], np.interp(grid, kept, samples), atol=1e-9)
    assert np.array_equal(times_in(items) - times_in(items)[0], np.rint(grid * MS))


@pytest.mark.parametrize("rate_hz", [100.0, 60.0, 6.0, 1024.0])
def test_samples_on_the_grid_pass_unchanged(rate_hz):
    stream = stream_of(rate_hz=rate_hz, irregular=True)
    index = np.arange(400)
    samples = np.random.default_rng(5).normal(size=400)
    for rounding in (np.rint, np.floor, np.ceil):
        times = START_NS + rounding(index * stream.period_ns).astype(np.int64)
        items = runs_of([irregular_of(stream, times, samples)])
        assert np.array_equal(samples_in(items)[:, 0], samples)
        assert np.array_equal(times_in(items), START_NS + np.rint(index * stream.period_ns))


def test_an_irregular_packet_sent_again_is_dropped_whole():
    items = irregular_runs([0, 10, 20, 30, 10, 20, 30, 40, 50])
    assert [(g.reason, g.lost, g.bridged) for g in gaps_in(items)] == [("duplicate", 3, True)]
    assert samples_in(items)[:, 0].tolist() == [0, 10, 20, 30, 40, 50]


def test_an_irregular_gap_is_bridged_or_ends_the_run():
    items = irregular_runs([0, 10, 60, 70, 400, 410])
    assert [(g.reason, g.lost, g.bridged) for g in gaps_in(items)] == [
        ("missing", 4, True),
        ("missing", 32, False),
    ]
    assert samples_in(items)[:, 0].tolist() == [0, 10, 20, 30, 40, 50, 60, 70, 400, 410]
    assert blocks_in(items)[-1].first == 0


def test_an_irregular_clock_set_back_starts_a_new_run():
    items = irregular_runs([1000, 1010, 5, 15], [1, 2, 3, 4])
    assert [(g.reason, g.bridged) for g in gaps_in(items)] == [("clock step", False)]
    assert samples_in(items)[:, 0].tolist() == [1, 2, 3, 4]
    assert blocks_in(items)[-1].anchor_ns == START_NS + 5 * MS


@given(
    steps=st.lists(
        st.one_of(
            st.floats(1.0, 20.0), st.sampled_from([10.0, 0.0, -10.0, -30.0, 50.0, 300.0, -400.0])
        ),
        min_size=1,
        max_size=40,
    ),
    cuts=cuts_of(40),
    third=st.booleans(),
)
def test_irregular_runs_are_the_same_however_the_blocks_are_cut(steps, cuts, third):
    times = np.cumsum(steps) / (3 if third else 1)
    samples = np.sin(np.arange(len(times)) * 1.7)
    whole, parts = irregular_runs(times, samples), irregular_runs(times, samples, cuts)
    assert np.array_equal(times_in(parts), times_in(whole))
    assert np.array_equal(samples_in(parts), samples_in(whole))
    assert tally(parts) == tally(whole)
    assert np.abs(samples_in(whole)).max(initial=0) <= 1
