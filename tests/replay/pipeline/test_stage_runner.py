"""The one runner of stages: who is started, what is given, when it is decided."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from replay_blocks import START_NS, block_of, stream_of

from groundtrace.pipeline.gates import Candidates, Level
from groundtrace.pipeline.parameters import StageConfig, gate
from groundtrace.pipeline.stage import CannotStart, Context, Frames, Input, Stage, StageRunner
from groundtrace_codecs.events import (
    CandidateBlock,
    Gap,
    Note,
    Pick,
    Quantity,
    StageSpec,
    StepEvent,
    TraceBlock,
)
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

if TYPE_CHECKING:
    from collections.abc import Iterator

    from groundtrace_codecs.events import Event

PICKED = StageSpec("picks", "any", "/s", ("G1",), (), (), (), "pick")
STEPPED = StageSpec("steps", "any", "/s", ("all",), (), (), (), "step")


@dataclass(frozen=True, slots=True)
class Levels:
    """Parameters of the stages here."""

    level: Annotated[float, gate("1", "Lowest value.")] = 2.0


def candidate(time_ns: int, value: float) -> Candidates:
    return Candidates(
        np.array([time_ns], np.int64), np.zeros(1, np.int32), np.array([[value]], np.float32)
    )


class Measuring(Stage):
    """What the stages here have in common."""

    Parameters = Levels
    gives = (StepEvent,)
    columns = (Quantity("value", "1"),)
    gates = (Level("value", "1", "level"),)

    def __init__(self, parameters: Levels) -> None:
        self.parameters = parameters

    def start(self, context: Context) -> tuple[str, ...]:
        self.context = context
        return ("all",)


class Counting(Measuring):
    """Counts by what was decided: as long as nothing is accepted, the next value is higher."""

    takes = (Input(Pick),)
    ends_at = "clock step"
    feedback = True

    def __init__(self, parameters: Levels) -> None:
        super().__init__(parameters)
        self.value = 0.0

    def process(self, pick: Pick) -> Iterator[Candidates]:
        for _ in range(3):
            yield candidate(pick.time_ns, self.value)

    def decided(self, block: CandidateBlock) -> list[Event]:
        self.value = 0.0 if block.accepted[0] else self.value + 1.0
        return []


class Early(Measuring):
    """Yields a frame and a candidate from before the run."""

    takes = (Input(SignalBlock, frozenset({"seismic"})),)
    trace = (Quantity("value", "1"),)

    def process(self, block: SignalBlock) -> Iterator[Candidates | Frames]:
        yield Frames(np.array([block.start_ns]), np.zeros((1, 1, 1), np.float32))
        yield candidate(block.start_ns - NS_PER_S, 3.0)


class Both(Measuring):
    """Takes signal of any topic, and steps."""

    takes = (Input(StepEvent), Input(SignalBlock, anywhere=True))
    rounds = ("seismic",)

    def process(self, item: Any) -> Iterator[Event]:
        kind = "step" if isinstance(item, StepEvent) else item.topic
        yield Note(0, f"{self.context.topic} {kind}")


class Unable(Measuring):
    """Lacks something."""

    takes = (Input(Pick), Input(StepEvent))

    def start(self, context: Context) -> tuple[str, ...]:  # noqa: ARG002
        raise CannotStart("no steps: expected something, found none")

    def process(self, item: Any) -> Iterator[Event]:
        raise AssertionError(item)


def runner(kind: type[Stage], **known: Any) -> StageRunner:
    return StageRunner(StageConfig("any", "own"), kind, Levels(), **known)


def pick(at_s: float, topic: str = "/s") -> Pick:
    return Pick(START_NS + round(at_s * NS_PER_S), "G1", topic, "picks", 1e-4, 9.0)


def step(at_s: float) -> StepEvent:
    return StepEvent(START_NS + round(at_s * NS_PER_S), "step", "", "/s", "steps", 9.0)


def said(made: StageRunner, items: list[Any]) -> list[Event]:
    return [e for item in items for e in made.process(item)] + made.flush()


def test_candidates_are_decided_before_more_is_asked_of_the_stage() -> None:
    blocks = [e for e in said(runner(Counting), [PICKED, pick(1)]) if isinstance(e, CandidateBlock)]
    assert [float(b.value[0, 0]) for b in blocks] == [0.0, 1.0, 2.0]
    assert [bool(b.accepted[0]) for b in blocks] == [False, False, True]


def test_no_candidate_is_earlier_than_its_run_and_frames_come_before_it() -> None:
    block = block_of(stream_of(), 0, [1.0, 2.0])
    spec, trace, found, event = said(runner(Early), [block])
    assert isinstance(spec, StageSpec)
    assert isinstance(trace, TraceBlock)
    assert isinstance(found, CandidateBlock)
    assert found.time_ns.tolist() == [block.start_ns]
    assert isinstance(event, StepEvent)


def test_a_stage_that_cannot_start_says_so_once_with_the_first_of_what_it_takes_last() -> None:
    (note,) = said(runner(Unable), [STEPPED, PICKED, pick(1), step(2), pick(3), step(4)])
    assert note == Note(step(2).time_ns, "/s: no steps: expected something, found none", "WARN",
                        "own")  # fmt: skip


def test_what_comes_before_a_stage_can_start_is_kept_and_signal_of_other_topics_too() -> None:
    other = block_of(stream_of(topic="/other"), 0, [1.0])
    own = block_of(stream_of(), 0, [1.0])
    texts = [e.text for e in said(runner(Both), [STEPPED, step(1), other, own, step(2)])
             if isinstance(e, Note)]  # fmt: skip
    assert sorted(texts) == ["/s /other", "/s /s", "/s step", "/s step"]
    assert texts[0] == "/s step"
    assert texts.index("/s /other") < texts.index("/s /s")


def test_stages_and_topics_that_are_not_taken_from_are_left_alone() -> None:
    sources = {Counting.takes[0]: ("others",)}
    assert said(runner(Counting, sources=sources), [PICKED, pick(1)]) == []
    (spec,) = said(runner(Counting), [PICKED, pick(1, "/t")])
    assert isinstance(spec, StageSpec)


def test_a_stage_of_stored_events_is_run_again_without_a_trace_in_the_stage_itself() -> None:
    made = runner(Counting)
    first = made.rerun([PICKED, pick(1), pick(2)])
    again = made.rerun([PICKED, pick(1), pick(2)])
    assert [type(e) for e in first] == [StageSpec, *[CandidateBlock] * 6]
    values = [[float(e.value[0, 0]) for e in found if isinstance(e, CandidateBlock)]
              for found in (first, again)]  # fmt: skip
    assert values[0] == values[1] == [0.0, 1.0, 2.0, 0.0, 1.0, 2.0]


def test_a_run_ends_only_at_the_gaps_that_end_it() -> None:
    made = runner(Counting)
    said_first = [e for item in [PICKED, pick(1)] for e in made.process(item)]
    assert len(said_first) == 4
    missing = Gap("/s", START_NS, START_NS + 1, "missing", 1)
    assert made.process(missing) == []
    assert made.process(Gap("/s", START_NS, START_NS, "clock step", 0)) == []
    assert [type(e) for e in made.process(pick(0.5))] == [CandidateBlock] * 3
