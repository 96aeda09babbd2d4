"""Every registered detector passes the conformance test, on the recordings that ship with us."""

from __future__ import annotations

import copy
from itertools import product
from typing import TYPE_CHECKING, Any

import pytest
from sweeps import swept

from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import load_pipeline, named_pipelines
from groundtrace.pipeline.conformance import (
    BLOCK_SIZES,
    assert_same,
    check_stage,
    outcome,
    rechunked,
)
from groundtrace.pipeline.parameters import describe
from groundtrace.pipeline.plugins import load, plugins, stage_named
from groundtrace.pipeline.source import Source
from groundtrace.pipeline.stage import detects, emitted, wanted_quantities
from groundtrace_codecs.events import Gap, Note
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S
from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from groundtrace_codecs.geometry import Geometry
    from groundtrace_codecs.signals import SignalBlock

RECORDINGS = {
    "room": "room-walk.mcap",
    "shots": "room-walk.mcap",
    "walker": "waist-walk.mcap",
    "vehicle": "vehicle-pass.mcap",
}
#: How much of a recording is cut into blocks of 7 samples: three steps in 6000 blocks of a room.
SECONDS = {"room": 2.0, "shots": 2.0, "walker": 30.0}
STAGES = [plugin.name for plugin in plugins("stages")]
DETECTORS = [name for name in STAGES if detects(stage_named(name))]


def signal(name: str, seconds: float | None = None) -> list[SignalBlock | Gap]:
    with Recording.open(path_of(RECORDINGS[name])) as recording:
        stop = None if seconds is None else recording.start_ns + round(seconds * NS_PER_S)
        return list(Source(recording, stop_ns=stop))


def site(name: str) -> Geometry | None:
    with Recording.open(path_of(RECORDINGS[name])) as recording:
        return recording.geometry


def fitting(kind: Any) -> str:
    if emitted(kind) == "presence":
        return "vehicle"
    return "walker" if "acceleration" in wanted_quantities(kind) else "room"


@pytest.mark.parametrize("name", DETECTORS)
def test_every_detector_conforms_on_a_bundled_recording(name: str) -> None:
    kind = load("stages", name)
    found = check_stage(kind, signal(fitting(kind), SECONDS.get(fitting(kind))))
    assert found.accepted.any()


@pytest.mark.parametrize("name", DETECTORS)
def test_every_detector_takes_blocks_of_a_single_sample(name: str) -> None:
    kind = load("stages", name)
    items = signal(fitting(kind), 1.0 if fitting(kind) == "room" else 8.0)
    items = [b.slice(0, round(0.2 * b.stream.rate_hz)) for b in _one_run(items)]
    stage_of = _stages(kind)
    whole = outcome(_events(stage_of(), items))
    single = outcome(_events(stage_of(), list(rechunked(items, 1))))
    assert_same(whole, single, "blocks of one sample")


def _one_run(items: list[Any]) -> list[SignalBlock]:
    """The signal around the first event, as one block of 0.2 s and more."""
    from groundtrace.pipeline.source import joined

    topic = items[0].topic
    blocks = list(joined([i for i in items if i.topic == topic]))
    return [b.slice(len(b) * 3 // 4, len(b)) for b in blocks]


def _stages(kind: Any) -> Any:
    from groundtrace.pipeline.parameters import StageConfig
    from groundtrace.pipeline.stage import StageRunner

    return lambda: StageRunner(StageConfig("d", "d"), kind, kind.Parameters())


def _events(stage: Any, items: list[Any]) -> list[Any]:
    return [event for item in items for event in stage.process(item)] + list(stage.flush())


@pytest.mark.parametrize("name", STAGES)
def test_every_stage_documents_its_parameters_and_gates(name: str) -> None:
    kind = stage_named(name)
    assert kind.takes
    assert kind.gives
    assert kind.__doc__
    named = {info.name for info in describe(kind.Parameters)}
    assert {gate.parameter for gate in kind.gates} <= named


def by_stage(events: list[Any]) -> dict[str, Any]:
    said = [e for e in events if not isinstance(e, Note)]
    names = [getattr(e, "stage", None) or e.spec.stage for e in said]
    return {
        stage: outcome([e for e, name in zip(said, names, strict=True) if name == stage])
        for stage in dict.fromkeys(names)
    }


#: Every pipeline is cut into blocks of one length, two of many stages into short ones, too; each
#: stage that detects is cut into all of them above.
EVERYDAY = [(name, BLOCK_SIZES[1]) for name in sorted(named_pipelines())]
THOROUGH = [(name, BLOCK_SIZES[0]) for name in ("room-footsteps", "pedestrian")]


@pytest.mark.parametrize(
    ("pipeline", "size"),
    swept(product(sorted(named_pipelines()), BLOCK_SIZES), *EVERYDAY, *THOROUGH),
)
def test_every_pipeline_gives_the_same_events_whatever_the_blocks(pipeline: str, size: int) -> None:
    recording = load_pipeline(pipeline).application
    items = signal(recording, SECONDS.get(recording))

    def run(given: list[SignalBlock | Gap]) -> Any:
        chain = build_pipeline(load_pipeline(pipeline), site(recording))
        events = [event for item in given for event in chain.process(item)] + list(chain.flush())
        return by_stage(events)

    longest = max(len(item) for item in items if not isinstance(item, Gap))
    if size >= longest:  # it cuts nothing
        size = BLOCK_SIZES[0]
    whole = run(items)
    # as a source hands them over: streams in the order of time
    chunked = run(sorted(rechunked(items, size), key=lambda item: item.start_ns))
    assert whole.keys() == chunked.keys()
    for stage in whole:
        assert_same(whole[stage], chunked[stage], f"{pipeline} {stage}: blocks of {size}")


def test_a_copy_of_a_pipeline_goes_on() -> None:
    items = signal("room", 4.0)
    config, geometry = load_pipeline("room-footsteps"), site("room")
    one = build_pipeline(config, geometry)
    events = [e for item in items[:4] for e in one.process(item)]
    other = copy.deepcopy(one)
    events += [e for item in items[4:] for e in other.process(item)] + list(other.flush())
    third = build_pipeline(config, geometry)
    straight = [e for item in items for e in third.process(item)] + list(third.flush())
    whole, copied = by_stage(straight), by_stage(events)
    assert whole.keys() == copied.keys() >= {stage.key for stage in config.stage}
    for stage, found in whole.items():
        assert_same(found, copied[stage], f"copied pipeline: {stage}")
