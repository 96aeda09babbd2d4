"""First breaks: the largest rise of a record, tracked over a line of geophones."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from first_breaks import Errors, simulated
from hypothesis import given, settings
from hypothesis import strategies as st
from stage_contexts import context_of
from sweeps import examples

from groundtrace.detectors.first_breaks import (
    FirstBreakParameters,
    FirstBreaks,
    rise_over_all_before,
)
from groundtrace.pipeline.conformance import assert_same, outcome, rechunked
from groundtrace.pipeline.gates import Candidates
from groundtrace.pipeline.parameters import StageConfig
from groundtrace.pipeline.stage import StageRunner
from groundtrace.simulate.line import LineOptions, simulate_line
from groundtrace.simulate.recording import Simulation
from groundtrace_codecs.events import Gap, Note, Pick
from groundtrace_codecs.signals import NS_PER_S, Channel, SignalBlock, Stream

if TYPE_CHECKING:
    from pathlib import Path

MS = 1_000_000
KNOWN = LineOptions(seed=3, shots=2, channels=12, rate_hz=2000.0, lead_s=0.05, snr=60.0)


def items_of(simulation: Simulation) -> list[SignalBlock | Gap]:
    """The records of a simulated line, with the gaps that a source finds between them."""
    stream, _, blocks = simulation.sources[0]
    found: list[SignalBlock | Gap] = []
    for block in blocks:
        if found:
            end_ns = found[-1].end_ns
            lost = round((block.start_ns - end_ns) / stream.period_ns)
            found.append(Gap(stream.topic, end_ns, block.start_ns, "missing", lost, bridged=False))
        found.append(block)
    return found


def events_of(simulation: Simulation, items=None, **parameters):
    given_parameters = FirstBreakParameters(**parameters)
    runner = StageRunner(
        StageConfig("first-breaks", "fb"),
        FirstBreaks,
        given_parameters,
        geometry=simulation.geometry,
        labels=simulation.labels,
    )
    items = items_of(simulation) if items is None else items
    return [e for item in items for e in runner.process(item)] + runner.flush()


def errors_ms(simulation: Simulation, events) -> np.ndarray:
    """Pick minus truth of every arrival, NaN where there is no pick within a second."""
    picks = [e for e in events if isinstance(e, Pick)]
    found = []
    for label in simulation.labels:
        if label.kind == "pick":
            near = [p for p in picks if p.channel == label.channel]
            near = [p for p in near if abs(p.time_ns - label.time_ns) < NS_PER_S]
            found.append((near[0].time_ns - label.time_ns) / MS if near else np.nan)
    return np.array(found)


def test_every_arrival_of_a_clear_line_is_picked_to_a_millisecond() -> None:
    simulation = simulate_line(KNOWN)
    error = errors_ms(simulation, events_of(simulation))
    assert len(error) == 24
    assert np.median(np.abs(error)) < 0.6
    assert np.abs(error).max() < 4


def test_blows_before_the_shot_are_not_taken_for_it() -> None:
    simulation = simulate_line(replace(KNOWN, lead_s=0.1, precursors=0.05, snr=100.0))
    error = errors_ms(simulation, events_of(simulation))
    assert np.nanmin(error) > -20
    assert np.nanmedian(np.abs(error)) < 1


def test_reversed_and_dead_geophones_do_not_matter_to_the_others() -> None:
    simulation = simulate_line(replace(KNOWN, dead=("G04",), flipped=("G07", "G08")))
    events = events_of(simulation)
    assert not any(e.channel == "G04" for e in events if isinstance(e, Pick))
    assert np.abs(errors_ms(simulation, events)).max() < 4


def test_a_late_trigger_is_told_with_no_more_than_its_delay() -> None:
    texts = {}
    for late_s in (0.0, 0.012):
        simulation = simulate_line(replace(KNOWN, late_s=late_s, spacing_m=3.0))
        texts[late_s] = [e.text for e in events_of(simulation) if isinstance(e, Note)]
        assert np.abs(errors_ms(simulation, events_of(simulation))).max() < 4
    assert texts[0.0] == []
    assert texts[0.012]
    told = [float(text.split("at least ")[1].split(" ms")[0]) for text in texts[0.012]]
    assert all(1 < ms < 12 for ms in told)


def test_a_trigger_that_cannot_be_right_is_told_and_not_used() -> None:
    simulation = simulate_line(KNOWN)
    wrong = [
        replace(x, time_ns=x.time_ns + 250 * MS) if x.kind == "trigger" else x
        for x in simulation.labels
    ]
    events = events_of(replace_labels(simulation, wrong))
    assert np.abs(errors_ms(simulation, events)).max() < 4
    assert any("is not used" in e.text for e in events if isinstance(e, Note))


def replace_labels(simulation: Simulation, labels) -> Simulation:
    return Simulation(simulation.sources, simulation.geometry, tuple(labels))


def test_without_trigger_and_source_the_line_is_found_by_itself() -> None:
    simulation = simulate_line(KNOWN)
    events = events_of(simulation, trigger=False)
    assert np.nanmedian(np.abs(errors_ms(simulation, events))) < 1


@pytest.mark.parametrize("size", [7, 200, 999])
def test_results_do_not_depend_on_the_blocks(size: int) -> None:
    simulation = simulate_line(replace(KNOWN, random=True))
    whole = outcome(events_of(simulation))
    parts = outcome(events_of(simulation, list(rechunked(items_of(simulation), size))))
    assert_same(whole, parts, f"blocks of {size}")
    assert whole.accepted.any()


def test_shots_of_a_long_run_are_told_apart() -> None:
    simulation = simulate_line(replace(KNOWN, shots=4, lead_s=0.5, length_s=1.5))
    stream, _, blocks = simulation.sources[0]
    samples = np.concatenate([b.samples for b in blocks])
    whole = SignalBlock(stream, 0, 0, samples)
    alone = Simulation(simulation.sources, simulation.geometry, ())
    events = events_of(alone, [whole])
    by_channel: dict[str, list[float]] = {}
    for e in events:
        if isinstance(e, Pick):
            by_channel.setdefault(e.channel, []).append(e.time_ns / NS_PER_S)
    assert set(map(len, by_channel.values())) == {4}
    assert_same(
        outcome(events), outcome(events_of(alone, list(rechunked([whole], 333)))), "blocks of 333"
    )


def test_a_copy_in_the_middle_of_a_record_goes_on() -> None:
    simulation = simulate_line(KNOWN)
    first = items_of(simulation)[0]
    assert isinstance(first, SignalBlock)
    labels = tuple(x for x in simulation.labels if x.kind == "trigger")
    stage = FirstBreaks(FirstBreakParameters())
    stage.start(context_of(first.stream, labels=labels, geometry=simulation.geometry))
    list(stage.process(first.slice(0, 400)))
    other = copy.deepcopy(stage)
    found = []
    for one in (stage, other):
        outputs = [*one.process(first.slice(400, len(first))), *one.flush()]
        found.append(next(x for x in outputs if isinstance(x, Candidates)))
    assert len(found[0])
    assert np.array_equal(found[0].time_ns, found[1].time_ns)
    assert np.array_equal(found[0].value, found[1].value)


def test_noise_alone_is_no_shot() -> None:
    rng = np.random.default_rng(5)
    names = [f"G{i}" for i in range(12)]
    channels = tuple(
        Channel(n, "ground_velocity", "m/s", "z", position_m=(5.0 * i, 0.0, 0.0))
        for i, n in enumerate(names)
    )
    block = SignalBlock(Stream("/s", channels, 2000.0), 0, 0, rng.normal(size=(2000, 12)))
    empty = Simulation([], None, ())
    assert not [e for e in events_of(empty, [block]) if isinstance(e, Pick)]


def test_first_breaks_of_drawn_lines_are_no_worse_than_their_rivals(tmp_path: Path) -> None:
    parts = [simulated(seed, tmp_path) for seed in (1202, 1203, 1205, 1206)]
    found = Errors.joined([part for part in parts if part is not None])
    own = np.abs(found.error_s)
    for error_s in found.rivals.values():
        assert np.median(own) <= np.median(np.abs(error_s))
        assert np.percentile(own, 95) <= np.percentile(np.abs(error_s), 95)
    claimed = found.sigma_s < 0.005
    assert np.mean(own[claimed] < 2 * found.sigma_s[claimed]) > 0.85


def test_claimed_uncertainty_grows_where_another_moment_may_be_meant() -> None:
    clear = simulate_line(replace(KNOWN, snr=200.0))
    noisy = simulate_line(replace(KNOWN, snr=4.0))
    middle = [
        np.median([e.uncertainty_s for e in events_of(s) if isinstance(e, Pick)])
        for s in (clear, noisy)
    ]
    assert middle[1] > 2 * middle[0]


def plain_rise(x: np.ndarray, length: int, lead: int) -> np.ndarray:
    """The same, window by window."""
    rise = np.zeros(len(x))
    for t in range(lead, len(x) - length + 1):
        after = np.mean(x[t : t + length] ** 2)
        if t < length:
            before = np.mean(x[:t] ** 2)
        else:
            before = max(np.mean(x[s : s + length] ** 2) for s in range(t - length + 1))
        if before > 0 and after > 0:
            rise[t] = np.log(after / before)
    return rise if len(x) >= 2 * length else np.zeros(len(x))


@settings(max_examples=examples(60))
@given(
    x=st.lists(st.integers(-5, 5), min_size=1, max_size=40),
    length=st.integers(2, 6),
    lead=st.integers(1, 3),
)
def test_a_rise_is_over_the_highest_power_of_all_windows_before(x, length, lead) -> None:
    signal = np.array(x, np.float64)
    found = rise_over_all_before(signal, length, lead)
    assert np.allclose(found, plain_rise(signal, length, lead), atol=1e-9)


@settings(max_examples=examples(40))
@given(seed=st.integers(0, 2**32 - 1), later=st.integers(0, 5), earlier=st.integers(0, 5))
def test_the_best_step_is_that_of_all_steps_tried(seed: int, later: int, earlier: int) -> None:
    from groundtrace import kernels

    score = np.random.default_rng(seed).normal(size=20)
    found = np.empty(20)
    kernels.tracking.best_steps(score, later, earlier, 0.3, found)
    tried = [
        max(score[s] - 0.3 * abs(t - s) for s in range(20) if t - later <= s <= t + earlier)
        for t in range(20)
    ]
    assert np.allclose(found, tried)
