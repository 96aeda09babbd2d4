"""The conformance test of stages, ours and those of other distributions.

In a test of your own: ``check_stage(MyPicker, blocks)`` with a few seconds of signal it is meant
for, or with what stages before it state and give. It raises AssertionError with a sentence that
says which rule is broken.
"""

from __future__ import annotations

import copy
import dataclasses
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from groundtrace_codecs.events import CandidateBlock, Fix, Gap, Pick, StepEvent, TraceBlock
from groundtrace_codecs.signals import SignalBlock

from .parameters import StageConfig, describe
from .stage import CLOCK_STEP, Curve, Stage, StageRunner, detects, topic_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Event

    from .stage import Item

T = TypeVar("T")
#: Block sizes whose decisions must equal those of the whole. Chosen by judgement: smaller than any
#: window, and as blocks of recordings are.
BLOCK_SIZES = (7, 200, 2000)
#: Values of a candidate may differ by rounding of sums, as a part of them. Chosen by judgement:
#: 10^4 roundings of a double.
TOLERANCE = 1e-12


@dataclasses.dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """Everything a stage said, as columns."""

    times: NDArray[np.int64]
    channels: NDArray[np.int32]
    values: NDArray[np.float32]
    margins: NDArray[np.float32]
    accepted: NDArray[np.bool_]
    trace_times: NDArray[np.int64]
    trace: NDArray[np.float32]
    events: tuple[Pick | StepEvent | Fix, ...]


def rechunked(items: Iterable[T], samples: int) -> Iterator[T | SignalBlock]:
    """Yield the same signal in blocks of ``samples`` samples."""
    for item in items:
        if not isinstance(item, SignalBlock):
            yield item
            continue
        for start in range(0, len(item), samples):
            yield item.slice(start, min(start + samples, len(item)))


def outcome(events: Iterable[Event]) -> Outcome:
    """Collect a stage's events into columns."""
    collected = list(events)
    blocks = [e for e in collected if isinstance(e, CandidateBlock)]
    traces = [e for e in collected if isinstance(e, TraceBlock)]

    def column(parts: list[NDArray[Any]], empty: type[Any]) -> NDArray[Any]:
        return np.concatenate(parts) if parts else np.empty(0, empty)

    return Outcome(
        column([b.time_ns for b in blocks], np.int64),
        column([b.channel for b in blocks], np.int32),
        column([b.value for b in blocks], np.float32),
        column([b.margin for b in blocks], np.float32),
        column([b.accepted for b in blocks], np.bool_),
        column([t.time_ns for t in traces], np.int64),
        column([t.value for t in traces], np.float32),
        tuple(e for e in collected if isinstance(e, Pick | StepEvent | Fix)),
    )


class ToldCurves:
    """The decision functions that a stage tells while it runs, where its detector tells one."""

    def __init__(self) -> None:
        self._pieces: dict[str, list[Curve]] = {}

    @property
    def topics(self) -> set[str]:
        """The topics of which something was told."""
        return set(self._pieces)

    def take(self, stage: StageRunner, topic: str) -> None:
        """Keep what is new: a detector that holds nothing back tells its last piece again."""
        curve, pieces = stage.curve(topic), self._pieces.get(topic, [])
        if curve is None or not len(curve.time_ns):
            return
        if not pieces or curve.time_ns[-1] > pieces[-1].time_ns[-1]:
            self._pieces[topic] = [*pieces, curve]

    def curve(self, topic: str) -> Curve:
        """Return what was told of a topic, in one piece."""
        pieces = self._pieces[topic]
        return Curve(
            np.concatenate([c.time_ns for c in pieces]), np.concatenate([c.value for c in pieces])
        )


def run(stage: StageRunner, items: Iterable[Item], curves: ToldCurves | None = None) -> Outcome:
    """Feed items to a stage and flush it; keep in ``curves`` the decision functions it tells."""
    decision_curves = ToldCurves() if curves is None else curves
    events: list[Event] = []
    topics: dict[str, None] = {}
    for item in items:
        topic = topic_of(item)
        topics[topic] = None
        events += stage.process(item)
        decision_curves.take(stage, topic)
    events += stage.flush()
    for topic in topics:
        decision_curves.take(stage, topic)
    return outcome(events)


def assert_same(one: Outcome, other: Outcome, what: str) -> None:
    """Raise where two outcomes differ: times and verdicts exactly, values to 1e-12."""
    for field in dataclasses.fields(Outcome):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if field.name == "events":
            same = _events_key(a) == _events_key(b)
        elif a.dtype.kind == "f":
            same = a.shape == b.shape and np.allclose(a, b, TOLERANCE, TOLERANCE, equal_nan=True)
        else:
            same = np.array_equal(a, b)
        assert same, f"{what}: expected the same {field.name}, found others"


def _events_key(events: tuple[Pick | StepEvent | Fix, ...]) -> list[tuple[Any, ...]]:
    return [
        (type(e).__name__, e.time_ns, e.stage, round(e.x_m, 9), round(e.y_m, 9), e.picks)
        if isinstance(e, Fix)
        else (type(e).__name__, e.time_ns, e.topic, e.stage, round(e.value, 9))
        for e in events
    ]


def check_stage(
    kind: type[Stage],
    items: Sequence[Item],
    parameters: Any = None,
    block_sizes: Sequence[int] = BLOCK_SIZES,
) -> Outcome:
    """Check all rules on items of the kind the stage is meant for.

    Blocks of any size give what the whole gives; a run after ``flush`` and ``start`` gives what a
    new stage gives; a ``copy.deepcopy`` in the middle goes on as the stage does; input that is
    empty, not finite, still, clipped or has gaps has a defined outcome.

    Parameters
    ----------
    kind
        Its class.
    items
        A few seconds of blocks (with gaps, if you like) of one or more streams; before its events
        the StageSpec of a stage that it takes from.
    parameters
        Its parameters; the defaults where None.
    block_sizes
        Block sizes whose outcome must equal that of the blocks as given.

    Returns
    -------
    What the stage says of them.
    """
    parameters = kind.Parameters() if parameters is None else parameters
    check_description(kind)
    curves = ToldCurves()
    reference = run(_stage(kind, parameters), items, curves)
    assert len(reference.times), "expected candidates in what the stage is meant for, found none"
    check_gates(kind, reference)
    for size in block_sizes:
        parts, what = ToldCurves(), f"blocks of {size} samples"
        assert_same(reference, run(_stage(kind, parameters), rechunked(items, size), parts), what)
        assert_same_curves(curves, parts, what)
    check_state(kind, parameters, items, reference)
    check_restart(kind, parameters, items, reference)
    if detects(kind):
        check_faults(kind, parameters, items)
    return reference


def _stage(kind: type[Stage], parameters: Any) -> StageRunner:
    return StageRunner(StageConfig("stage"), kind, parameters)


def check_description(kind: type[Stage]) -> None:
    """Check that parameters are documented, gates have one each, columns are named."""
    named = {info.name: info for info in describe(kind.Parameters)}
    for gate in kind.gates:
        assert gate.parameter in named, f"gate {gate.name}: no parameter {gate.parameter}"
        part = named[gate.parameter].part
        assert part == "decide", f"{gate.parameter}: expected a gate's parameter, found {part}"
    assert kind.columns, "columns: expected at least one"
    assert kind.__doc__, "expected a docstring"


def check_gates(kind: type[Stage], stage_outcome: Outcome) -> None:
    """Check that candidates have all margins and are accepted just where all are passed."""
    rows, gates = stage_outcome.margins.shape
    assert rows == len(stage_outcome.times), f"margins: expected {len(stage_outcome.times)} rows"
    assert gates <= len(kind.gates), f"margins: expected at most {len(kind.gates)} gates"
    passed = (stage_outcome.margins >= 0).all(axis=1)
    assert np.array_equal(passed, stage_outcome.accepted), (
        "accepted: expected where all margins are >= 0"
    )
    order = np.lexsort((stage_outcome.channels, stage_outcome.times))
    assert np.array_equal(order, np.arange(len(order))), "expected the order of (time, channel)"
    if kind.decided is Stage.decided:  # else it is told otherwise, as in spans
        assert len(stage_outcome.events) == int(stage_outcome.accepted.sum()), (
            "expected an event for each accepted"
        )


def assert_same_curves(one: ToldCurves, other: ToldCurves, what: str) -> None:
    """Raise where decision functions differ, or are not in the order of time."""
    assert one.topics == other.topics, f"{what}: expected curves of {one.topics}"
    for topic in one.topics:
        a, b = one.curve(topic), other.curve(topic)
        assert (np.diff(a.time_ns) > 0).all(), f"{topic}: expected a curve in the order of time"
        same = np.array_equal(a.time_ns, b.time_ns) and np.allclose(
            a.value, b.value, TOLERANCE, TOLERANCE, equal_nan=True
        )
        assert same, f"{what}: expected the same curve of {topic}, found another"


def check_state(
    kind: type[Stage], parameters: Any, items: Sequence[Item], reference: Outcome
) -> None:
    """Check that a copy of a stage goes on as the stage does, and neither disturbs the other."""
    parts = list(rechunked(items, 200))
    middle = len(parts) // 2
    first = _stage(kind, parameters)
    before = [event for item in parts[:middle] for event in first.process(item)]
    second = copy.deepcopy(first)
    for stage, what in ((first, "a stage that was copied"), (second, "a copy of a stage")):
        after = [event for item in parts[middle:] for event in stage.process(item)]
        assert_same(reference, outcome([*before, *after, *stage.flush()]), what)


def check_restart(
    kind: type[Stage], parameters: Any, items: Sequence[Item], reference: Outcome
) -> None:
    """Check that after a run has ended, where the clock steps, the next gives what a new one would.

    What a stage learns, as the pace of a floor, may go on: times and verdicts must be the same.
    """
    topics = dict.fromkeys(topic_of(item) for item in items)
    last_ns = max(x.end_ns for x in items if isinstance(x, SignalBlock)) if detects(kind) else 0
    gaps = [Gap(topic, last_ns, last_ns, CLOCK_STEP, 0) for topic in topics]
    twice = run(_stage(kind, parameters), [*items, *gaps, *items])
    for name in ("times", "channels", "accepted", "trace_times"):
        once, both = getattr(reference, name), getattr(twice, name)
        same = np.array_equal(np.concatenate([once, once]), both)
        assert same, f"flushed and started again: expected the same {name} as of a new stage"


def check_faults(kind: type[Stage], parameters: Any, items: Sequence[Item]) -> None:
    """Check that empty, not finite, still, clipped and gapped input has a defined outcome."""
    blocks = [item for item in items if isinstance(item, SignalBlock)]
    nothing = run(_stage(kind, parameters), [b.slice(0, 0) for b in blocks])
    assert not len(nothing.times), "no samples: expected no candidates"
    for name, change in FAULTS.items():
        faulty = [_changed(block, change) for block in blocks]
        faulty_outcome = run(_stage(kind, parameters), faulty)
        assert np.isfinite(faulty_outcome.values[faulty_outcome.accepted]).all(), (
            f"{name}: expected finite values"
        )
    still = run(_stage(kind, parameters), [_changed(b, lambda x: np.zeros_like(x)) for b in blocks])
    assert not still.accepted.any(), "silence: expected nothing accepted"
    check_gap(kind, parameters, blocks)


def check_gap(kind: type[Stage], parameters: Any, blocks: Sequence[SignalBlock]) -> None:
    """Check that a detector starts anew after a gap that is not bridged."""
    block = max(blocks, key=len)
    half = len(block) // 2
    before, after = block.slice(0, half), block.slice(half, len(block))
    gap = Gap(block.topic, before.end_ns, after.start_ns, "missing", 1)
    both = run(_stage(kind, parameters), [before, gap, after])
    alone = run(_stage(kind, parameters), [after])
    count = len(alone.times)
    assert np.array_equal(both.times[len(both.times) - count :], alone.times), (
        "after a gap: expected the candidates of a fresh start"
    )


def _changed(block: SignalBlock, change: Any) -> SignalBlock:
    return dataclasses.replace(block, samples=change(np.array(block.samples, np.float64)))


def _with_nan(x: NDArray[np.float64]) -> NDArray[np.float64]:
    x[len(x) // 3 : len(x) // 2] = np.nan
    return x


def _with_infinity(x: NDArray[np.float64]) -> NDArray[np.float64]:
    x[len(x) // 2 :: 97] = np.inf
    return x


def _clipped(x: NDArray[np.float64]) -> NDArray[np.float64]:
    limit = float(np.percentile(np.abs(x), 90)) if x.size else 0.0
    return np.clip(x, -limit, limit)


FAULTS = {"not a number": _with_nan, "infinite": _with_infinity, "clipped": _clipped}
