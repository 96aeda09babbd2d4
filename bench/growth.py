"""How the cost grows: with channels, rate, length, candidates, sensors. Ends with the exponents.

Each quantity is doubled again and again while the others stay; the exponent is the slope of the
logarithm of the CPU time over that of the quantity, from its middle value on, where what a call
costs anyhow matters least. 1 is proportional. The values are timed in turn, again and again, and
the least time of each counts: the rest is what else the machine does. Beside the exponent stand the
least and the greatest of single turns; where they are far apart it says nothing. Signals are made
block by block and never kept, so that the peak of memory is that of the pipeline.

Run: python bench/growth.py
"""

from __future__ import annotations

import argparse
import tracemalloc
from typing import TYPE_CHECKING

import numpy as np
from timing import alone, on_one_core, taken_s

from groundtrace.localizers import arrival_order
from groundtrace.localizers.arrival_order import find_regions
from groundtrace.localizers.base import outline_of
from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import parse_pipeline
from groundtrace.pipeline.engine import replay
from groundtrace.pipeline.gates import Candidates, Level, Refractory, decide
from groundtrace_codecs.events import Quantity
from groundtrace_codecs.signals import Channel, SignalBlock, Stream

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

PICKS = b'name = "picks"\n[[stage]]\nuse = "toa-cv"\n[[stage]]\nuse = "coincidence"\n'
STEPS = b'name = "steps"\napplication = "walker"\n[[stage]]\nuse = "adaptive"\n'
ROOM = np.array([(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)])
BLOCK_S = 0.5
#: Candidates that are decided, in so many calls as it takes.
CANDIDATES = 1_000_000


class Gates:
    """Thresholds of the gates that candidates are counted through."""

    height = 1.0
    refractory_s = 0.1


def impacts(channels: int, rate_hz: float, seconds: float) -> Iterator[SignalBlock]:
    """Noise, and two impacts a second that all channels hear."""
    names = tuple(Channel(f"G{i}", "ground_velocity", "m/s") for i in range(channels))
    stream = Stream("/seismic", names, rate_hz)
    rng, size = np.random.default_rng(1), round(BLOCK_S * rate_hz)
    ring = np.exp(-np.arange(size) / (0.01 * rate_hz)) * np.sin(np.arange(size) * 0.3)
    for index in range(round(seconds / BLOCK_S)):
        samples = rng.normal(0, 10, (channels, size)) + 2000 * ring
        yield SignalBlock(stream, 0, index * size, samples.astype(np.int16).T)


def walking(rate_hz: float, seconds: float) -> Iterator[SignalBlock]:
    """A body that goes up and down twice a second."""
    axes = tuple(Channel(f"acc_{a}", "acceleration", "m/s2", a) for a in "xyz")
    stream = Stream("/imu", axes, rate_hz, "waist")
    size = max(1, round(10 * rate_hz))
    for index in range(max(1, round(seconds / 10))):
        at_s = (index * size + np.arange(size)) / rate_hz
        up = 9.8 + 2 * np.sin(2 * np.pi * 2 * at_s)
        samples = np.stack([0.1 * up, 0.2 * np.cos(at_s), up], axis=1)
        yield SignalBlock(stream, 0, index * size, samples)


def run(text: bytes, blocks: Iterator[SignalBlock]) -> None:
    """Replay blocks through a pipeline."""
    replay(blocks, build_pipeline(parse_pipeline(text, "growth")), [])


def decided(count: int) -> Callable[[], None]:
    """Return the decision of all candidates, of 16 channels, so many in each call.

    Always others, since the processor learns the verdicts of ten thousand by heart.
    """
    times = np.arange(CANDIDATES, dtype=np.int64) * 1_000_000
    channel = (np.arange(CANDIDATES) % 16).astype(np.int32)
    value = np.random.default_rng(0).uniform(0.5, 2, (CANDIDATES, 1)).astype(np.float32)
    every, gates = Candidates(times, channel, value), (Level("height", "1", "height"), Refractory())
    parts = [every.rows(slice(i, i + count)) for i in range(0, CANDIDATES, count)]

    def decide_all() -> None:
        for part in parts:
            decide(part, (Quantity("height", "1"),), gates, Gates())

    return decide_all


def layout(sensors: int) -> np.ndarray:
    """Sensors at random: no two of the lines between them coincide, the hardest case."""
    return np.random.default_rng(sensors).uniform(0, 10, (sensors, 2))


def arranged(sensors: int) -> Callable[[], None]:
    """Return the arrangement of a layout's regions."""
    places, room = layout(sensors), outline_of(layout(sensors), ROOM)
    return lambda: find_regions(places, room) and None


def looked_up(sensors: int) -> Callable[[], None]:
    """Return 20 places of steps among a layout's regions."""
    places = layout(sensors)
    regions = arrival_order.known_regions(places, ROOM)
    apart = np.hypot(*(np.random.default_rng(1).uniform(0, 10, (20, 1, 2)) - places).T).T
    return lambda: [arrival_order.among(regions, row) for row in apart * 2e-3] and None


def peak_mb(case: Callable[[], None]) -> float:
    """Return the most memory that a case holds at once [MB]."""
    tracemalloc.start()
    case()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak / 1e6


def exponent(steps: Sequence[float], costs: Sequence[float]) -> float:
    """Return the slope of the logarithms over the upper half."""
    half = len(steps) // 2
    return float(np.polyfit(np.log(steps[half:]), np.log(costs[half:]), 1)[0])


def grown(
    name: str,
    steps: Sequence[float],
    case: Callable[[float], Callable[[], None]],
    runs: int,
    calls: Callable[[float], float] = lambda _: 1.0,
) -> None:
    """Print one quantity: cost and memory at each of its values, and the exponents.

    ``calls`` says how many calls a case makes; the time is that of one.
    """
    made = [case(step) for step in steps]
    for one in made:
        one()  # imports and compiles what it needs
    peaks_mb = [peak_mb(one) for one in made]
    turns = [
        [taken_s(one) / calls(step) for one, step in zip(made, steps, strict=True)]
        for _ in range(runs)
    ]
    taken = [min(times) for times in zip(*turns, strict=True)]
    single = sorted(exponent(steps, times) for times in turns)
    print(f"{name}: time ~ n^{exponent(steps, taken):.2f}", end="")
    print(f" ({single[0]:.2f} to {single[-1]:.2f}), memory ~ n^{exponent(steps, peaks_mb):.2f}")
    for step, second, megabyte in zip(steps, taken, peaks_mb, strict=True):
        print(f"{step:>12g}{second * 1e3:12.2f} ms{megabyte:10.1f} MB", flush=True)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=5)
    runs = parser.parse_args().runs
    alone()
    on_one_core()
    picked = "onsets and their association,"
    channels = [4, 8, 16, 32, 64]
    grown(
        f"{picked} 10 s at 10 kHz, by channels",
        channels,
        lambda n: lambda: run(PICKS, impacts(int(n), 1e4, 10)),
        runs,
    )
    rates = [781.25, 3125, 12500, 25000, 50000]
    grown(
        f"{picked} 4 channels, 20 s, by rate [Hz]",
        rates,
        lambda r: lambda: run(PICKS, impacts(4, r, 20)),
        runs,
    )
    lengths = [10, 40, 160, 640]
    grown(
        f"{picked} 4 channels at 10 kHz, by length [s]",
        lengths,
        lambda s: lambda: run(PICKS, impacts(4, 1e4, s)),
        runs,
    )
    slow = [6, 25, 100, 400]
    grown("steps at the waist, 100 s, by rate [Hz]", slow, by_rate, runs)
    long = [60, 240, 960, 3840]
    grown("steps at the waist, 100 Hz, by length [s]", long, by_length, runs)
    counts = [1e3, 1e4, 1e5, 1e6]
    each = "gates, by candidates"
    grown(each, counts, lambda n: decided(int(n)), runs, lambda n: CANDIDATES / n)
    sensors = [3, 4, 6, 8, 12, 16]
    grown("regions arranged once, by sensors", sensors, lambda n: arranged(int(n)), min(runs, 3))
    grown(
        "places of 20 steps among regions, by sensors", sensors, lambda n: looked_up(int(n)), runs
    )


def by_rate(rate_hz: float) -> Callable[[], None]:
    """Return steps at a rate."""
    return lambda: run(STEPS, walking(rate_hz, 100))


def by_length(seconds: float) -> Callable[[], None]:
    """Return steps over a length."""
    return lambda: run(STEPS, walking(100, seconds))


if __name__ == "__main__":
    main()
