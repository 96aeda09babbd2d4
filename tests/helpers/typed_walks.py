"""Walks with types of steps for the tests: simulated ones, and patterns made by hand."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from groundtrace.pipeline.conformance import rechunked
from groundtrace.pipeline.parameters import StageConfig
from groundtrace.pipeline.plugins import load
from groundtrace.pipeline.stage import StageRunner
from groundtrace.simulate.gait import WalkOptions
from groundtrace.simulate.walk import simulate_walk
from groundtrace_codecs.events import StageSpec, StepEvent
from groundtrace_codecs.signals import Channel, SignalBlock, Stream

if TYPE_CHECKING:
    from collections.abc import Iterator

    from groundtrace_codecs.events import Event, Label

TOPIC = "/imu/waist"
NS = 10**9


@dataclass(frozen=True)
class Walk:
    """Signal of a sensor at the waist, and the truth."""

    blocks: list[SignalBlock]
    labels: tuple[Label, ...]

    @property
    def span_ns(self) -> tuple[int, int]:
        return self.blocks[0].start_ns, self.blocks[-1].last_ns

    @property
    def steps(self) -> list[tuple[int, str]]:
        return [(x.time_ns, x.label) for x in self.labels if x.kind == "step"]

    @property
    def contacts_ns(self) -> list[int]:
        return sorted(x.time_ns for x in self.labels if x.kind in ("step", "trailing"))


def simulated(seed: int) -> Walk:
    """Two minutes of a simulated person who makes steps of all four types."""
    simulation = simulate_walk(WalkOptions(seed=seed, types=True))
    blocks = [b for stream, _, parts in simulation.sources if stream.topic == TOPIC for b in parts]
    return Walk(blocks, simulation.labels)


def mounted(walk: Walk, turned_deg: float) -> Walk:
    """The same walk with the sensor turned about its upper axis, counter-clockwise from above."""
    mount = Rotation.from_euler("Z", turned_deg, degrees=True).inv()
    blocks = [
        replace(b, samples=np.hstack([mount.apply(b.values[:, k : k + 3]) for k in (0, 3)]))
        for b in walk.blocks
    ]
    return Walk(blocks, walk.labels)


def stage(**settings: object) -> StageRunner:
    kind = load("stages", "step-types")
    return types_of(kind, kind.Parameters(**settings))


def types_of(kind: type[Any], parameters: Any, topics: tuple[str, ...] = ()) -> StageRunner:
    """A stage that takes the steps of the stage ``steps``."""
    config = StageConfig("step-types", "types", topics)
    return StageRunner(config, kind, parameters, {kind.takes[1]: ("steps",)})


def begun(made: StageRunner, topic: str = TOPIC) -> StageRunner:
    """A stage that knows the stage before it."""
    list(made.process(StageSpec("steps", "any", topic, (), (), (), (), "step")))
    return made


def step_at(time_ns: int, topic: str = TOPIC) -> StepEvent:
    return StepEvent(time_ns, "step", "", topic, "steps", 1.0)


def told(
    made: StageRunner, walk: Walk, samples: int = 50, late_ns: int = 0
) -> Iterator[tuple[int, Event]]:
    """Feed signal, and each contact once the signal has come so far; yield the time with events."""
    contacts = walk.contacts_ns
    for block in rechunked(walk.blocks, samples):
        events = [*made.process(block)]
        while contacts and contacts[0] + late_ns <= block.last_ns:
            events += made.process(step_at(contacts.pop(0)))
        yield from ((block.last_ns, event) for event in events)
    rest = [event for time_ns in contacts for event in made.process(step_at(time_ns))]
    yield from ((walk.span_ns[1], event) for event in [*rest, *made.flush()])


def accelerations(values: np.ndarray, rate_hz: float = 100.0) -> list[SignalBlock]:
    """A block of accelerations along x, y and z, and angular velocity where there are six."""
    channels = [Channel(f"acc_{a}", "acceleration", "m/s2", a) for a in "xyz"]
    channels += [Channel(f"gyr_{a}", "angular_velocity", "rad/s", a) for a in "xyz"]
    stream = Stream(TOPIC, tuple(channels[: values.shape[1]]), rate_hz, "waist")
    return [SignalBlock(stream, 1_700_000_000 * NS, 0, values)]
