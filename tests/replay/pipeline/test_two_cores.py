"""What a second core does ahead changes nothing of a replay, and not where it stands."""

from __future__ import annotations

import threading
from multiprocessing import get_context
from typing import TYPE_CHECKING

import pytest
from replay_blocks import block_of, stream_of

from groundtrace.pipeline import engine
from groundtrace.pipeline import engine as cores
from groundtrace.pipeline.chain import Pipeline, build_pipeline
from groundtrace.pipeline.config import PipelineConfig, load_pipeline
from groundtrace.pipeline.engine import AHEAD, Clock, ReplayLoop, replay
from groundtrace.pipeline.source import Source
from groundtrace_codecs.events import Note
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import SignalBlock
from groundtrace_codecs.writer import encode_event
from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from groundtrace_codecs.events import Event

BLOCKS = [block_of(stream_of(1, 10.0), 10 * k, range(10)) for k in range(9)]


class Kept:
    """A sink that keeps everything, as it would be written."""

    def __init__(self) -> None:
        self.items: list[object] = []

    def write(self, item: SignalBlock | Event) -> None:
        if isinstance(item, SignalBlock):
            self.items.append((item.topic, item.start_ns, item.samples.tobytes()))
        else:
            self.items.append(list(encode_event(item)))

    @property
    def blocks(self) -> int:
        """How many of them are blocks."""
        return sum(isinstance(item, tuple) for item in self.items)


class First:
    """Notes every block, in whatever thread, and fails where it is told to."""

    name = "first"

    def __init__(self, failing: int | None = None) -> None:
        self.seen: list[int] = []
        self.threads: set[int] = set()
        self._failing = failing

    def process(self, item: SignalBlock) -> Iterator[Event]:
        self.threads.add(threading.get_ident())
        self.seen.append(item.first)
        if item.first == self._failing:
            raise ZeroDivisionError
        yield Note(item.start_ns, f"first {item.first}")

    def flush(self) -> Iterator[Event]:
        yield Note(0, "end")


class Second(First):
    """Notes what it is given after the first stage."""

    name = "second"

    def process(self, item: SignalBlock | Event) -> Iterator[Event]:
        if isinstance(item, SignalBlock):
            yield from super().process(item)


@pytest.fixture
def some_cores(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> int:
    """Let there be so many cores, and each block a task."""
    monkeypatch.setattr(engine, "cores", lambda: request.param)
    monkeypatch.setattr(engine, "TOGETHER", 1)
    return request.param


both = pytest.mark.parametrize("some_cores", [1, 2], indirect=True, ids=["one core", "two"])


def chain_of(*stages: First) -> Pipeline:
    return Pipeline(PipelineConfig("test"), stages, "")


@pytest.mark.parametrize(
    ("recording", "pipeline"),
    [
        ("room-walk.mcap", "room-footsteps"),
        ("waist-walk.mcap", "pedestrian"),
        ("waist-walk.mcap", "waist-steps"),
    ],
)
@pytest.mark.parametrize("together", [1, 2000])
def test_sinks_are_given_the_same_on_one_core_and_on_two(
    recording: str, pipeline: str, together: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = {}
    for count in (1, 2):
        monkeypatch.setattr(engine, "cores", lambda count=count: count)
        monkeypatch.setattr(engine, "TOGETHER", together)
        with Recording.open(path_of(recording)) as opened:
            chain = build_pipeline(load_pipeline(pipeline), opened.geometry)
            sink = Kept()
            tally = replay(Source(opened, block_s=0.5), chain, [sink])
        found[count] = (sink.items, tally.counts, tally.samples, tally.recorded_s)
    assert len(found[1][0]) > 100
    assert found[1] == found[2]


@both
def test_the_other_core_is_used_where_there_is_one(some_cores: int) -> None:
    first, second = First(), Second()
    replay(BLOCKS, chain_of(first, second), [])
    own = {threading.get_ident()}
    assert second.threads == own
    assert (first.threads == own) == (some_cores == 1)
    assert first.seen == second.seen == [b.first for b in BLOCKS]


def test_small_blocks_are_handed_over_together(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine, "cores", lambda: 2)
    monkeypatch.setattr(engine, "TOGETHER", 4 * len(BLOCKS[0]))
    tasks: list[int] = []
    begin = engine._begin

    def told(pipeline: Pipeline, items: list[SignalBlock]) -> list[engine.Begun]:
        tasks.append(len(items))
        return begin(pipeline, items)

    monkeypatch.setattr(engine, "_begin", told)
    sink = Kept()
    replay(BLOCKS, chain_of(First()), [sink])
    assert tasks == [4, 4]  # the ninth is begun by who finishes it
    assert sink.blocks == 9


@both
def test_a_paced_replay_takes_nothing_ahead(some_cores: int) -> None:
    first = First()
    replay(BLOCKS, chain_of(first), [], clock=Clock(0.0))
    assert some_cores
    assert first.threads == {threading.get_ident()}


@both
def test_no_more_is_on_its_way_than_is_taken_ahead(some_cores: int) -> None:
    sink, longest = Kept(), 0

    def source() -> Iterator[SignalBlock]:
        nonlocal longest
        for given, block in enumerate(BLOCKS):
            longest = max(longest, given - sink.blocks)
            yield block

    replay(source(), chain_of(First()), [sink])
    assert longest == (0 if some_cores == 1 else AHEAD)


@both
def test_what_is_settled_is_in_the_sinks(some_cores: int) -> None:
    sink = Kept()
    run = ReplayLoop(chain_of(First(), Second()), [sink])

    def source() -> Iterator[SignalBlock]:
        for given, block in enumerate(BLOCKS):
            run.flush()
            assert len(sink.items) == 3 * given
            yield block

    assert run.through(source()).counts["Note"] == 2 * len(BLOCKS) + 2
    assert some_cores


@both
def test_an_error_of_the_source_comes_after_all_that_came_before_it(some_cores: int) -> None:
    def source() -> Iterator[SignalBlock]:
        yield from BLOCKS[:4]
        raise OSError("gone")

    sink = Kept()
    with pytest.raises(OSError, match="gone"):
        replay(source(), chain_of(First()), [sink])
    assert len(sink.items) == 2 * 4
    assert some_cores


@both
def test_an_error_of_the_first_stage_comes_where_its_item_is_due(some_cores: int) -> None:
    sink = Kept()
    with pytest.raises(ZeroDivisionError):
        replay(BLOCKS, chain_of(First(failing=BLOCKS[3].first)), [sink])
    assert len(sink.items) == 2 * 3 + 1  # three blocks and their notes, and the block
    assert some_cores


@both
def test_nothing_follows_an_error_that_comes_while_the_source_settles(some_cores: int) -> None:
    sink = Kept()
    run = ReplayLoop(chain_of(First(failing=BLOCKS[2].first)), [sink])

    def source() -> Iterator[SignalBlock]:
        yield from BLOCKS[:4]
        run.flush()

    with pytest.raises(ZeroDivisionError):
        run.through(source())
    assert len(sink.items) == 2 * 2 + 1
    assert some_cores


def test_a_process_that_another_one_started_keeps_to_one_core() -> None:
    with get_context("spawn").Pool(1) as pool:
        assert pool.apply(cores.cores) == 1
    assert cores.cores() >= 1
