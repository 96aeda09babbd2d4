"""A replay that begins by a stage's memory earlier has the decisions of the whole recording.

Times and verdicts are the same. Values may differ by the rounding of what a recursive filter holds;
the time since the last accepted one is that since the replay's begin, where nothing was before.
"""

from __future__ import annotations

import pickle
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from decided_spans import assert_same_span
from sweeps import swept

from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import PipelineConfig
from groundtrace.pipeline.engine import EventList, ReplayLoop
from groundtrace.pipeline.gates import Refractory
from groundtrace.pipeline.parameters import StageConfig
from groundtrace.pipeline.plugins import plugins, stage_named
from groundtrace.pipeline.source import Source
from groundtrace.pipeline.stage import Memory, StepMeasure
from groundtrace_codecs.geometry import Geometry, Sensor
from groundtrace_codecs.recording import LoggedBlock, Recording
from groundtrace_codecs.signals import NS_PER_S, QUANTITIES, Channel, SignalBlock, Stream
from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Event

START_NS = 1_700_000_000_000_000_000
#: Stages, by what must be before each of them.
BEFORE = {
    "toa-cv": (),
    "toa-sb": (),
    "sta-lta": (),
    "footfall-power": (),
    "rest-swing": (),
    "coincidence": ("toa-cv",),
    "bearings": ("toa-cv", "coincidence"),
    "crossing": ("toa-cv", "coincidence", "bearings"),
    "disagreement": ("toa-cv", "coincidence", "bearings", "crossing", "crossing"),
    "covariance-intersection": ("toa-cv", "coincidence", "bearings", "crossing", "crossing"),
    "vehicle-presence": (),
}
#: Stages that depend on all before, and say how much after a time: by what must be before each.
ALL_BEFORE = {
    "adaptive": (),
    "dp": (),
    "first-breaks": (),
    "gcc-phat": ("toa-cv", "coincidence"),
    "hyperbolic": ("toa-cv", "coincidence"),
    "power-law": ("toa-cv", "coincidence"),
    "self-calibrating": ("toa-cv", "coincidence"),
    "so-tdoa": ("toa-cv", "coincidence"),
    "times-amplitudes": ("toa-cv", "coincidence"),
    "zc": (),
    "compass": (),
    "vqf": (),
}
#: Those whose tracks at the end of a replay are not those of the whole: see Memory.
TRACKERS = {"reckoning", "walkers"}


@dataclass
class Made:
    """Signals of one stream, as a recording of messages of 50 ms."""

    stream: Stream
    samples: NDArray[Any]

    @property
    def streams(self) -> tuple[Stream, ...]:
        return (self.stream,)

    def blocks(
        self,
        topics: Collection[str] | None = None,  # noqa: ARG002
        start_ns: int | None = None,
        stop_ns: int | None = None,
        joined_ns: int = 0,  # noqa: ARG002
    ) -> Iterator[LoggedBlock]:
        length = round(0.05 * self.stream.rate_hz)
        for first in range(0, len(self.samples), length):
            block = SignalBlock(self.stream, START_NS, first, self.samples[first : first + length])
            part = block.between(start_ns, stop_ns)
            if len(part):
                yield LoggedBlock(block.last_ns, part)

    def time_of(self, seconds: float) -> int:
        return START_NS + round(seconds * NS_PER_S)


#: Three stations of three axes.
PLACES = [(x, y, axis) for x, y in ((0.0, 0.0), (5.0, 0.0), (0.0, 5.0)) for axis in "xyz"]
SITE = Geometry(tuple(Sensor(f"G{i}", f"G{i}", x, y, 0.0, a) for i, (x, y, a) in enumerate(PLACES)))


@cache
def impacts(seed: int) -> Made:
    """Bursts at any time on a noise that swells, 100 s of them: what chains decisions most."""
    rng = np.random.default_rng(seed)
    rate, count = 1000.0, 100_000
    noise = (
        rng.normal(size=(count, len(PLACES)))
        * np.exp(np.cumsum(rng.normal(0, 0.003, count)))[:, None]
    )
    tail = np.exp(-np.arange(80) / 12) * np.sin(np.arange(80) * 0.9)
    for at in np.cumsum(rng.exponential(0.2, 450) * 1000).astype(int):
        for column in range(len(PLACES)):
            begin = at + int(rng.integers(0, 12))
            if begin + 80 < count:
                noise[begin : begin + 80, column] += rng.lognormal(2.5, 1) * tail
    channels = tuple(Channel(s.name, "ground_velocity", "m/s", axis=s.axis) for s in SITE.sensors)
    return Made(Stream("/seismic", channels, rate), (noise * 100 + 4000).astype(np.int32))


@cache
def room() -> Made:
    """The bundled room, thrice."""
    with Recording.open(path_of("room-walk.mcap")) as recording:
        blocks = [b for b in Source(recording) if isinstance(b, SignalBlock)]
        samples = np.concatenate([b.samples for b in blocks])
        return Made(recording.streams[0], np.concatenate([samples] * 3))


@cache
def shaken(seed: int) -> Made:
    """Steps of any length and height, and rests: the accelerometer of a waist, 200 s."""
    rng = np.random.default_rng(seed)
    rate, count = 50.0, 10_000
    step = np.repeat(rng.uniform(0.35, 1.2, 400), 50)[:count]
    swing = np.repeat(rng.choice([0.0, 0.5, 3.0], 40), 250)[:count]
    up = 9.8 + swing * np.sin(2 * np.pi * np.cumsum(1 / step) / rate)
    values = np.column_stack([rng.normal(0, 0.3, (count, 2)), up + rng.normal(0, 0.1, count)])
    channels = tuple(Channel(f"acc_{a}", "acceleration", "m/s2", axis=a) for a in "xyz")
    return Made(Stream("/imu/waist", channels, rate, placement="waist"), values)


@cache
def waist() -> Made:
    """The bundled walk, four times."""
    with Recording.open(path_of("waist-walk.mcap")) as recording:
        blocks = [b for b in Source(recording, topics={"/imu/waist"}) if isinstance(b, SignalBlock)]
        samples = np.concatenate([b.samples for b in blocks])
        return Made(replace(blocks[0].stream), np.concatenate([samples] * 4))


@cache
def turned() -> Made:
    """The bundled walk with its field, four times: a sensor of the body that is turned."""
    with Recording.open(path_of("waist-walk.mcap")) as recording:
        parts: dict[str, list[SignalBlock]] = {}
        for block in Source(recording, topics={"/imu/waist", "/mag/waist"}):
            if isinstance(block, SignalBlock):
                parts.setdefault(block.topic, []).append(block)
    body, field = (np.concatenate([b.values for b in parts[t]]) for t in sorted(parts))
    twice = np.repeat(field, 2, axis=0)[: len(body)]
    streams = [parts[topic][0].stream for topic in sorted(parts)]
    channels = tuple(replace(c, unit=QUANTITIES[c.quantity]) for s in streams for c in s.channels)
    both = np.concatenate([body[: len(twice)], twice], axis=1)
    return Made(replace(streams[0], channels=channels), np.concatenate([both] * 4))


@cache
def driven(seed: int) -> Made:
    """Two geophones beside a road for 300 s: vehicles of any loudness, some of them long."""
    rng = np.random.default_rng(seed)
    rate, count = 200.0, 60_000
    noise = rng.normal(size=(count, 2)) * np.exp(np.cumsum(rng.normal(0, 0.002, count)))[:, None]
    for at in rng.uniform(0, count, 40).astype(int):
        length = int(rng.uniform(1, 12) * rate)
        swell = np.hanning(length)[: count - at, None] * rng.lognormal(1.5, 0.7)
        noise[at : at + length] += swell * rng.normal(size=(len(swell), 2))
    channels = tuple(Channel(name, "ground_velocity", "m/s") for name in ("A", "B"))
    return Made(Stream("/road", channels, rate), (noise * 100).astype(np.int32))


def pipeline_of(name: str) -> PipelineConfig:
    before = (BEFORE | ALL_BEFORE)[name]
    uses = (*before, name)
    # a second of its kind has a name of its own
    names = [use if use not in uses[:k] else f"{use} {k}" for k, use in enumerate(uses)]
    stages = (StageConfig(use, name=other) for use, other in zip(uses, names, strict=True))
    return PipelineConfig("p", stage=tuple(stages))


def memory_of(name: str) -> Memory:
    return build_pipeline(pipeline_of(name), SITE).memory


def decided(
    name: str, made: Made, start_ns: int | None = None, stop_ns: int | None = None
) -> list[Event]:
    kept = EventList()
    source = Source(made, start_ns=start_ns, stop_ns=stop_ns, in_whole=True)
    ReplayLoop(build_pipeline(pipeline_of(name), SITE), [kept]).through(source)
    return kept.events


def signals_of(name: str) -> list[Made]:
    if name in {"rest-swing", "adaptive", "dp", "zc"}:
        return [waist(), *map(shaken, range(3))]
    if name in {"compass", "vqf"}:
        return [turned()]
    if name == "vehicle-presence":
        return [driven(seed) for seed in range(2)]
    return [room(), *map(impacts, range(2))]


def test_every_shipped_stage_that_says_its_memory_is_held_to_it() -> None:
    said, ends = set(), set()
    for plugin in plugins("stages"):
        kind = stage_named(plugin.name)
        memory = kind(kind.Parameters()).memory
        if memory.warm_up_s is not None:
            assert memory.delay_s is not None
            said.add(plugin.name)
        elif memory.delay_s is not None:
            ends.add(plugin.name)
    assert said == set(BEFORE)
    assert ends == set(ALL_BEFORE) | TRACKERS


@pytest.mark.parametrize(
    "name", swept(BEFORE, "toa-cv", "rest-swing", "coincidence", "crossing", "vehicle-presence")
)
def test_a_replay_that_begins_by_the_memory_earlier_decides_as_the_whole(name: str) -> None:
    memory = memory_of(name)
    assert memory.warm_up_s is not None
    assert memory.delay_s is not None
    rng = np.random.default_rng(len(name))
    compared = 0
    for made in signals_of(name):
        length_s = len(made.samples) / made.stream.rate_hz
        whole = decided(name, made)
        for _ in range(1 if made is room() else 3):
            start_ns = made.time_of(rng.uniform(memory.warm_up_s, length_s - 4))
            stop_ns = start_ns + round(rng.uniform(1, 3) * NS_PER_S)
            begin_ns = start_ns - round(memory.warm_up_s * NS_PER_S)
            end_ns = stop_ns + round(memory.delay_s * NS_PER_S)
            part = decided(name, made, begin_ns, end_ns)
            compared += assert_same_span(whole, part, start_ns, stop_ns)
    assert compared > 10


@pytest.mark.parametrize(
    "name", swept(ALL_BEFORE, "adaptive", "dp", "hyperbolic", "power-law", "times-amplitudes", "zc")
)
def test_a_replay_that_ends_by_the_delay_later_decides_as_the_whole(name: str) -> None:
    delay_s = memory_of(name).delay_s
    assert delay_s is not None
    rng = np.random.default_rng(len(name))
    compared = 0
    made = signals_of(name)[-1]
    length_s = len(made.samples) / made.stream.rate_hz
    whole = decided(name, made)
    for _ in range(3):
        stop_ns = made.time_of(rng.uniform(length_s / 3, length_s - delay_s))
        part = decided(name, made, None, stop_ns + round(delay_s * NS_PER_S))
        compared += assert_same_span(whole, part, None, stop_ns)
    assert compared > 10


#: Stages that learn from all before, and say on how much what they measure of a step depends.
MEASURED = ("gcc-phat", "times-amplitudes")


def measured(
    name: str, made: Made, start_ns: int | None = None, stop_ns: int | None = None
) -> dict[int, bytes]:
    """What a stage measures of steps, by their times, in a span of signals."""
    whole = build_pipeline(pipeline_of(name), SITE)
    stages = [s.beforehand() if s.name == name else s for s in whole.stages]  # type: ignore[attr-defined]
    kept = EventList()
    source = Source(made, start_ns=start_ns, stop_ns=stop_ns, in_whole=True)
    ReplayLoop(whole.with_stages(stages), [kept]).through(source)
    found: list[Any] = [event for event in kept.events if isinstance(event, StepMeasure)]
    return {one.time_ns: pickle.dumps(one.value) for one in found}


@pytest.mark.parametrize("name", MEASURED)
def test_what_is_measured_of_a_step_needs_no_more_of_the_signal_than_is_said(name: str) -> None:
    memory = build_pipeline(pipeline_of(name), SITE).measured[name]
    assert memory.warm_up_s is not None
    assert memory.delay_s is not None
    made, rng = impacts(0), np.random.default_rng(len(name))
    whole = measured(name, made)
    compared = 0
    for _ in range(3):
        start_ns = made.time_of(rng.uniform(memory.warm_up_s, 90))
        stop_ns = start_ns + 5 * NS_PER_S
        begin_ns = start_ns - round(memory.warm_up_s * NS_PER_S)
        part = measured(name, made, begin_ns, stop_ns + round(memory.delay_s * NS_PER_S))
        own = {time_ns: value for time_ns, value in whole.items() if start_ns <= time_ns < stop_ns}
        assert {time_ns: part[time_ns] for time_ns in part if start_ns <= time_ns < stop_ns} == own
        compared += len(own)
    assert compared > 10


def test_every_stage_that_measures_beforehand_is_held_to_what_it_says() -> None:
    kinds = [(plugin.name, stage_named(plugin.name)) for plugin in plugins("stages")]
    assert tuple(n for n, k in kinds if k(k.Parameters()).measured is not None) == MEASURED


def test_memories_add_up_along_a_chain_and_the_longest_of_several_counts() -> None:
    chain = build_pipeline(pipeline_of("crossing"), SITE)
    alone = {stage.name: stage.memory for stage in chain.stages}  # type: ignore[attr-defined]
    picks, steps, bearings = (alone[n] for n in ("toa-cv", "coincidence", "bearings"))
    assert chain.memories["coincidence"].warm_up_s == picks.warm_up_s + steps.warm_up_s
    before = picks.warm_up_s + steps.warm_up_s + bearings.warm_up_s
    assert chain.memories["crossing"].warm_up_s == before
    assert Memory(1.0, None).behind([Memory(2.0, 1.0), Memory(3.0, 0.5)]) == Memory(4.0, None)
    assert Memory.longest([]) == Memory(0.0, 0.0)
    assert Memory.longest([Memory(1.0, 2.0), Memory(None, 3.0)]) == Memory(None, 3.0)
    assert isinstance(stage_named("toa-cv").gates[-1], Refractory)
