"""Simulated walks in arrays, for the tests of the walk simulator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace.simulate.gait import WalkOptions, sensor_motion
from groundtrace.simulate.walk import _walker, simulate_walk

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from groundtrace_codecs.events import Label

    Array = NDArray[np.float64]


@dataclass(frozen=True)
class Walk:
    """Samples by quantity, their times [s] and the truth."""

    values: dict[str, Array]
    time_s: dict[str, Array]
    rates_hz: dict[str, float]
    labels: tuple[Label, ...]
    start_ns: int
    end_ns: int

    def of_kind(self, kind: str, label: str | None = None) -> list[Label]:
        found = [x for x in self.labels if x.kind == kind]
        return found if label is None else [x for x in found if x.label == label]

    def seconds(self, labels: list[Label]) -> Array:
        return np.array([(x.time_ns - self.start_ns) / 1e9 for x in labels])


def walked(**options: object) -> Walk:
    """Simulate a walk and read all its streams."""
    simulation = simulate_walk(WalkOptions(**options))
    values, times, rates, ends = {}, {}, {}, []
    for stream, _, blocks in simulation.sources:
        samples = np.concatenate([block.values for block in blocks])
        name = stream.topic.split("/")[1]
        values[name], rates[name] = samples, stream.rate_hz
        times[name] = np.arange(len(samples)) / stream.rate_hz
        ends.append(list(blocks)[-1].end_ns)
    start_ns = next(iter(simulation.sources[0][2])).start_ns
    return Walk(values, times, rates, simulation.labels, start_ns, max(ends))


@dataclass(frozen=True)
class Moved:
    """The exact motion: acceleration ahead, left, up and along x, y, up (n, 3); place (n, 2)."""

    walker: object
    time_s: Array
    body: Array
    world: Array
    track: Array


def moved(rate_hz: float = 100.0, **options: object) -> Moved:
    """Return how the body moves at the sensor, without sensor."""
    walker = _walker(WalkOptions(**options).resolved())
    time_s = np.arange(round(walker.duration_s * rate_hz)) / rate_hz
    world = sensor_motion(walker.options, walker.plan, walker.who, time_s, rate_hz).acceleration
    heading = walker.plan.heading(time_s)
    cos, sin = np.cos(heading), np.sin(heading)
    ahead = world[:, 0] * cos + world[:, 1] * sin
    body = np.stack([ahead, world[:, 1] * cos - world[:, 0] * sin, world[:, 2]], axis=1)
    return Moved(walker, time_s, body, world, walker.plan.track(time_s))
