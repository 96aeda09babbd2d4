"""The simulated line: travel times, truth, faults, and what a seed fixes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from groundtrace.errors import SimulationError
from groundtrace.simulate.line import Ground, LineOptions, simulate_line
from groundtrace_codecs.signals import NS_PER_S

SHORT = LineOptions(seed=2, shots=2, channels=8, rate_hz=1000.0, snr=1000.0)


def record(options: LineOptions, number: int = 0) -> np.ndarray:
    _, _, blocks = simulate_line(options).sources[0]
    return np.asarray(list(blocks)[number].samples, np.float64)


def labels(options: LineOptions, kind: str) -> list[int]:
    return [x.time_ns for x in simulate_line(options).labels if x.kind == kind]


def test_the_same_seed_gives_the_same_record_and_another_one_another() -> None:
    drawn = replace(SHORT, random=True)
    assert np.array_equal(record(drawn), record(drawn))
    assert not np.array_equal(record(SHORT), record(replace(SHORT, seed=4)))


def test_refracted_waves_overtake_the_direct_one_where_the_textbook_has_it() -> None:
    # crossover 2 h sqrt((v2 + v1) / (v2 - v1)), intercept 2 h sqrt(1 / v1^2 - 1 / v2^2)
    ground = Ground(np.array([5.0]), np.array([500.0, 1500.0]), 50.0, (200.0, 200.0), 1.0, 0.0)
    crossover = 10.0 * np.sqrt(2000 / 1000)
    (direct, _), (refracted, size) = ground.refracted(np.array([0.0, crossover, 1000.0]))
    assert direct[1] == pytest.approx(refracted[1])
    assert refracted[0] == pytest.approx(10.0 * np.sqrt(1 / 500**2 - 1 / 1500**2))
    assert size[0] == 0
    assert size[2] > 0


def test_a_picked_arrival_is_where_the_wave_leaves_the_noise() -> None:
    simulation = simulate_line(SHORT)
    stream, _, blocks = simulation.sources[0]
    block = next(iter(blocks))
    picks = [x for x in simulation.labels if x.kind == "pick" and x.time_ns < block.end_ns]
    truth = {x.channel: x.time_ns for x in picks}
    impact = min(x.time_ns for x in simulation.labels if x.kind == "impact")
    for column, channel in enumerate(stream.channels):
        at = round((truth[channel.name] - block.start_ns) * stream.rate_hz / NS_PER_S)
        sizes = np.abs(block.samples[:, column])
        assert sizes[at : at + 15].max() > 8 * sizes[max(0, at - 5) : at].max(initial=0)
        assert truth[channel.name] > impact


def test_a_late_trigger_is_late_and_the_record_with_it() -> None:
    late = replace(SHORT, late_s=0.01, lead_s=0.05)
    impacts, triggers = labels(late, "impact"), labels(late, "trigger")
    assert [t - i for t, i in zip(triggers, impacts, strict=True)] == [10_000_000] * 2
    assert labels(replace(late, late_s=0.0), "trigger") == triggers


def test_dead_geophones_are_silent_and_have_no_truth_and_flipped_ones_are_turned() -> None:
    plain, spoilt = record(SHORT), replace(SHORT, dead=("G02",), flipped=("G05",))
    found = record(spoilt)
    assert not found[:, 1].any()
    assert np.array_equal(found[:, 4], -plain[:, 4])
    assert "G02" not in {x.channel for x in simulate_line(spoilt).labels}


def test_blows_before_a_shot_come_before_it() -> None:
    options = replace(SHORT, lead_s=0.15, precursors=0.1)
    before = [np.abs(record(o)[:150]).max() for o in (options, replace(options, precursors=0.0))]
    assert before[0] > 3 * before[1]


def test_what_a_line_was_drawn_as_is_said() -> None:
    said = simulate_line(replace(SHORT, random=True)).metadata["line"]
    assert said["shots"] == "2"
    assert said["channels"] == "8"
    assert "rest of" in said["ground"]


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (LineOptions(channels=3), "channels: expected 4 to 96, found 3"),
        (LineOptions(late_s=0.2), "late_s: expected 0 to 0.05, found 0.2"),
        (LineOptions(layers=((3.0, 800.0), (np.inf, 500.0))), "layers: expected"),
        (LineOptions(dead=("G99",)), "expected a geophone G01 to G24, found G99"),
    ],
)
def test_options_out_of_range_are_refused(options: LineOptions, expected: str) -> None:
    with pytest.raises(SimulationError, match=expected):
        simulate_line(options)
