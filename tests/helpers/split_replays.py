"""Recordings that are long for their warm-up, and replays of them in one go and in spans."""

from __future__ import annotations

from functools import cache
from hashlib import sha256
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from fleet_runs import Here

from groundtrace.api.replay import PlannedReplay
from groundtrace.explain.suitability import prepared
from groundtrace.fleet.split import SplitReplay
from groundtrace.pipeline.config import load_pipeline
from groundtrace.pipeline.engine import EventList
from groundtrace_codecs.events import CandidateBlock, StageSpec, TraceBlock
from groundtrace_codecs.geometry import Geometry, Medium, Sensor
from groundtrace_codecs.location import Location
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import Channel, SignalBlock, Stream
from groundtrace_codecs.writer import write_recording

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from groundtrace.pipeline.config import PipelineConfig
    from groundtrace.pipeline.engine import ReplayCounts
    from groundtrace_codecs.events import Event

START_NS = 1_700_000_000_000_000_000
#: Three stations of three axes.
PLACES = [(x, y, axis) for x, y in ((0.0, 0.0), (5.0, 0.0), (0.0, 5.0)) for axis in "xyz"]
SITE = Geometry(
    tuple(Sensor(f"G{i}", f"G{i}", x, y, 0.0, a) for i, (x, y, a) in enumerate(PLACES)),
    medium=Medium(velocity_mps=800.0),
)
GROUND = Stream(
    "/seismic",
    tuple(Channel(s.name, "ground_velocity", "m/s", axis=s.axis) for s in SITE.sensors),
    1000.0,
)
WAIST = Stream(
    "/imu/waist",
    tuple(Channel(f"acc_{a}", "acceleration", "m/s2", axis=a) for a in "xyz"),
    50.0,
    placement="waist",
)


@cache
def impacts(seed: int, seconds: float = 100.0, quiet: tuple[float, float] = (0, 0)) -> NDArray[Any]:
    """Bursts at any time on a noise that swells, none in a quiet span [s]."""
    rng = np.random.default_rng(seed)
    count = round(1000 * seconds)
    swell = np.exp(np.cumsum(rng.normal(0, 0.003, count)))[:, None]
    noise = rng.normal(size=(count, len(PLACES))) * swell
    tail = np.exp(-np.arange(80) / 12) * np.sin(np.arange(80) * 0.9)
    for at in np.cumsum(rng.exponential(0.2, 2 * count) * 1000).astype(int):
        if at > count - 200:
            break
        if quiet[0] * 1000 <= at <= quiet[1] * 1000:
            continue
        for column in range(len(PLACES)):
            begin = at + int(rng.integers(0, 12))
            noise[begin : begin + 80, column] += rng.lognormal(2.5, 1) * tail
    if quiet[1]:
        noise[round(1000 * quiet[0]) : round(1000 * quiet[1])] *= 1e-3
    return (noise * 100 + 4000).astype(np.int32)


@cache
def shaken(seed: int, seconds: float = 240.0) -> NDArray[Any]:
    """Steps of any length and height, and rests: the accelerometer of a waist."""
    rng = np.random.default_rng(seed)
    rate, count = 50.0, round(50 * seconds)
    step = np.repeat(rng.uniform(0.35, 1.2, count), 50)[:count]
    swing = np.repeat(rng.choice([0.0, 0.5, 3.0], count), 250)[:count]
    up = 9.8 + swing * np.sin(2 * np.pi * np.cumsum(1 / step) / rate)
    return np.column_stack([rng.normal(0, 0.3, (count, 2)), up + rng.normal(0, 0.1, count)])


def written(
    path: Path,
    stream: Stream,
    samples: NDArray[Any],
    missing: Sequence[tuple[float, float]] = (),
) -> Path:
    """Write samples without those of some spans [s]."""
    edges = [0, *(round(t * stream.rate_hz) for span in missing for t in span), len(samples)]
    parts = [(a, b) for i, (a, b) in enumerate(pairwise(edges)) if i % 2 == 0]
    blocks = [SignalBlock(stream, START_NS, a, samples[a:b]) for a, b in parts]
    kind = "i32le" if samples.dtype.kind == "i" else "f64le"
    write_recording(path, [(stream, kind, blocks)], geometry=SITE if stream is GROUND else None)
    return path


#: What replays in one go gave, by the bytes of the recording and the pipeline.
_WHOLE: dict[tuple[str, str], tuple[list[Event], ReplayCounts]] = {}


def in_one_go(path: Path, pipeline: str | PipelineConfig) -> tuple[list[Event], ReplayCounts]:
    """Replay a recording; one of the same bytes through the same pipeline only once."""
    key = (sha256(path.read_bytes()).hexdigest(), repr(pipeline))
    if key not in _WHOLE:
        _WHOLE[key] = _replayed(path, pipeline)
    return _WHOLE[key]


def _replayed(path: Path, pipeline: str | PipelineConfig) -> tuple[list[Event], ReplayCounts]:
    with Recording.open(path) as recording:
        kept = EventList()
        return kept.events, planned(recording, path, pipeline).run([kept])


def in_spans(
    path: Path, pipeline: str | PipelineConfig, count: int, engine: Any = None, **options: Any
) -> tuple[list[Event], ReplayCounts, SplitReplay, list[str]]:
    """Replay a recording in so many spans, in this process where no engine is given."""
    said: list[str] = []
    report: Callable[[str], None] = said.append
    with Recording.open(path) as recording:
        kept = EventList()
        plan = planned(recording, path, pipeline)
        place = Location(options.get("place", path))
        split = SplitReplay(plan, place, engine or Here(), options.get("workers", 2), report, count)
        tally = split.run([kept], signal=options.get("signal", False), progress=lambda _: None)
    return kept.events, tally, split, said


def planned(recording: Recording, path: Path, pipeline: str | PipelineConfig) -> PlannedReplay:
    """Return a replay that can begin."""
    config = load_pipeline(pipeline) if isinstance(pipeline, str) else pipeline
    return PlannedReplay.of(recording, path, prepared(config, recording))


def assert_same_events(one: Sequence[Event], other: Sequence[Event]) -> None:
    """Raise where events differ, or their order; values may by the rounding of float32."""
    assert [type(e) for e in one] == [type(e) for e in other]
    for a, b in zip(one, other, strict=True):
        if not isinstance(a, CandidateBlock | TraceBlock):
            assert repr(a) == repr(b)  # as nan is nan
            continue
        assert a.spec == b.spec  # type: ignore[union-attr]
        for name in type(a).__dataclass_fields__:
            first, second = getattr(a, name), getattr(b, name)
            if isinstance(first, StageSpec):
                continue
            if first.dtype.kind == "f":
                assert np.allclose(first, second, 1e-6, 0, equal_nan=True), (a.spec.stage, name)
            else:
                assert np.array_equal(first, second), (a.spec.stage, name)
