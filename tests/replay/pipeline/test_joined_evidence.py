"""Evidence of results read many blocks at once is that of block after block."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

from groundtrace.pipeline.results import JOINED, joined, stage_evidence
from groundtrace_codecs.events import CandidateBlock, Gap, GateSpec, Quantity, StageSpec, TraceBlock

RNG = np.random.default_rng(5)
HEIGHT = Quantity("height", "1")
GATE = GateSpec("height", "1", "height", 1.0, True)
SPECS = [
    StageSpec("picks", "p", topic, ("A", "B"), (HEIGHT,), (GATE,), (HEIGHT,), "pick")
    for topic in ("/one", "/other")
]


def blocks() -> list[Any]:
    """Candidates and frames of two topics in turn, more than are joined at once."""
    made: list[Any] = [*SPECS]
    for i in range(JOINED + 70):
        spec, n = SPECS[i % 3 % 2], int(RNG.integers(0, 4))
        times = np.sort(RNG.integers(0, 100, n)) + 100 * i
        value = RNG.normal(size=(n, 1)).astype(np.float32)
        channel = RNG.integers(0, 2, n).astype(np.int32)
        made.append(CandidateBlock(spec, times, channel, value, value, value - 1, value[:, 0] >= 1))
        made.append(TraceBlock(spec, times, RNG.normal(size=(n, 2, 1)).astype(np.float32)))
    return made


def columns(value: Any) -> list[Any]:
    """Everything that a piece of evidence holds, arrays as bytes."""
    if isinstance(value, np.ndarray):
        return [value.dtype, value.shape, value.tobytes()]
    if hasattr(value, "__dataclass_fields__"):
        return [columns(getattr(value, field.name)) for field in fields(value)]
    return [value]


def test_joined_blocks_are_the_same_evidence():
    events = blocks()
    few = list(joined(events))
    assert len(few) < len(events) / 50
    assert sum(len(e) for e in few if isinstance(e, CandidateBlock)) == sum(
        len(e) for e in events if isinstance(e, CandidateBlock)
    )
    one, other = (stage_evidence(e, ["picks"]) for e in (events, few))
    assert columns(one[0]) == columns(other[0])
    assert columns(one[1]) == columns(other[1])


def test_other_events_stay_as_they_are():
    gap = Gap("/one", 1, 2, "dropout", 3, False)
    assert list(joined([gap])) == [gap]
