"""Pipelines of worn sensors: what they say does not depend on how long joined blocks are."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sweeps import swept

from groundtrace.pipeline.buffers import StreamSynchronizer, in_order
from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import load_pipeline
from groundtrace.pipeline.source import Source
from groundtrace.simulate.gait import WalkOptions
from groundtrace.simulate.recording import write
from groundtrace.simulate.walk import simulate_walk
from groundtrace_codecs.events import CandidateBlock, Gap, Heading, StageSpec, TraceBlock
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S, Channel, SignalBlock, Stream

if TYPE_CHECKING:
    from collections.abc import Iterator

    from groundtrace_codecs.events import Event
    from groundtrace_codecs.recording import LoggedBlock

#: Nothing missing; and pieces of streams missing [s from the start].
WHOLE: tuple[Any, ...] = ()
HOLES = (("/imu", 14.0, 16.5), ("/mag", 5.0, 5.9), ("/mag", 18.0, 21.0), ("/gnss", 8.0, 11.0))
IMU = Stream("/imu", (Channel("gyr_x", "angular_velocity", "rad/s", "x"),), 100.0)
MAG = Stream("/mag", (Channel("mag_x", "magnetic_field", "T", "x"),), 50.0)


@dataclass(frozen=True)
class Recorded:
    """A recording in memory, parts of it missing."""

    streams: tuple[Stream, ...]
    stamped: tuple[LoggedBlock, ...]
    holes: tuple[tuple[str, float, float], ...]

    def blocks(self, *_: Any) -> Iterator[LoggedBlock]:
        start_ns = self.stamped[0][1].start_ns
        for log_ns, block in self.stamped:
            times_s = (block.sample_times() - start_ns) / NS_PER_S
            kept = np.ones(len(block), np.bool_)
            for topic, first_s, last_s in self.holes:
                if block.topic.startswith(topic):
                    kept &= (times_s < first_s) | (times_s >= last_s)
            places = np.flatnonzero(kept)
            for part in np.split(places, np.flatnonzero(np.diff(places) > 1) + 1):
                if len(part):
                    yield log_ns, block.slice(int(part[0]), int(part[-1]) + 1)


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Recorded]:
    folder, found = tmp_path_factory.mktemp("walks"), {}
    for placement in ("waist", "phone", "foot"):
        path = folder / f"{placement}.mcap"
        options = WalkOptions(duration_s=32.0, placement=placement, gnss=True, seed=5)
        write(simulate_walk(options), path)
        with Recording.open(path) as recording:
            found[placement] = Recorded(recording.streams, tuple(recording.blocks()), WHOLE)
    return found


def lines(events: list[Event]) -> dict[str, list[str]]:
    """What is said, kind by kind, row by row."""
    told: dict[str, list[str]] = {}
    for event in events:
        if isinstance(event, CandidateBlock | TraceBlock):
            rows = zip(event.time_ns.tolist(), event.value.tolist(), strict=True)
            told.setdefault(f"{type(event)} {event.spec.stage}", []).extend(map(str, rows))
        else:
            stage = "" if isinstance(event, StageSpec) else getattr(event, "stage", "")
            told.setdefault(f"{type(event)} {stage}", []).append(repr(event))
    # of two streams at one time either may be noted first
    return {kind: sorted(rows) if "Note" in kind else rows for kind, rows in told.items()}


def said(recorded: Recorded, pipeline: str, block_s: float, broken_at: int = -1) -> Any:
    """What a pipeline says; gone on with by a copy of it, from one item on."""
    chain = build_pipeline(load_pipeline(pipeline))
    events: list[Event] = []
    for place, item in enumerate(Source(recorded, block_s=block_s)):
        if place == broken_at:
            chain = copy.deepcopy(chain)
        events += chain.process(item)
    return lines([*events, *chain.flush()])


@cache
def unjoined(recorded: Recorded, pipeline: str) -> Any:
    return said(recorded, pipeline, 0.0)


CASES = [
    ("pedestrian", "waist", WHOLE),
    ("pedestrian", "waist", HOLES),
    ("pedestrian", "phone", HOLES),
    ("heading", "waist", HOLES),
    ("step-types", "waist", HOLES),
    ("foot-inertial", "foot", HOLES),
]


@pytest.mark.parametrize(
    ("pipeline", "placement", "holes"), swept(CASES, CASES[2], ("foot-inertial", "foot", HOLES))
)
def test_joined_blocks_of_any_length_say_what_single_messages_say(
    walked: dict[str, Recorded], pipeline: str, placement: str, holes: Any
) -> None:
    whole = walked[placement]
    recorded = Recorded(whole.streams, whole.stamped, holes)

    @settings(max_examples=4, deadline=None)
    @given(st.floats(0.25, 30.0), st.integers(-1, 20))
    def check(block_s: float, broken_at: int) -> None:
        assert said(recorded, pipeline, block_s, broken_at) == unjoined(recorded, pipeline)

    check()
    assert unjoined(recorded, pipeline)


def test_a_field_heard_after_the_whole_window_counts_up_to_the_gap(
    walked: dict[str, Recorded],
) -> None:
    whole = walked["waist"]
    told = said(Recorded(whole.streams, whole.stamped, HOLES), "heading", 60.0)
    # 1.8 s after a gap in the walk it is level
    assert len(told[f"{CandidateBlock} heading"]) == pytest.approx(
        10 * (32 - 2.5 - 0.5 - 2.6 - 1.8), abs=6
    )
    assert len(told[f"{Heading} heading"]) == pytest.approx(50 * (32 - 2.5), abs=3)


def block(stream: Stream, first: int, count: int) -> SignalBlock:
    return SignalBlock(stream, 0, first, np.zeros((count, 1)))


def test_a_round_ends_where_a_stream_goes_on_speaks_again_or_comes_after_all() -> None:
    rounds = StreamSynchronizer(("angular_velocity",))
    first, field = block(IMU, 0, 100), block(MAG, 0, 50)
    assert rounds.add(first) == []
    assert rounds.add(field) == []
    assert rounds.add(block(IMU, 100, 100)) == [field, first]  # what leads comes last
    assert len(rounds.add(block(IMU, 200, 100))) == 1  # goes on
    assert len(rounds.add(block(MAG, 160, 50))) == 1  # begins after all others ended
    assert len(rounds.flush()) == 1
    assert rounds.flush() == []


def test_blocks_are_cut_where_another_stream_s_gap_ends() -> None:
    gap = Gap("/imu", NS_PER_S, 2 * NS_PER_S, "missing", 100)
    items = [block(IMU, 0, 100), gap, block(IMU, 200, 100), block(MAG, 0, 150)]
    found = in_order(items, ("angular_velocity",))
    assert [type(x) for x in found] == [SignalBlock, SignalBlock, Gap, SignalBlock, SignalBlock]
    assert [(x.topic, x.start_ns // NS_PER_S, len(x)) for x in found if x is not gap] == [
        ("/mag", 0, 100),
        ("/imu", 0, 100),
        ("/mag", 2, 50),
        ("/imu", 2, 100),
    ]
