"""Gaps as the reason of a miss: filled ones around it, and too little signal between others."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from groundtrace.explain.reasons import _cut_short, _gap_at
from groundtrace_codecs.events import Gap

MS = 1_000_000


def gap(start_ms: int, lost_ms: int, *, bridged: bool = True) -> Gap:
    start_ns = start_ms * MS
    return Gap("/imu", start_ns, start_ns + lost_ms * MS, "missing", lost_ms // 10, bridged)


@pytest.mark.parametrize(
    ("gaps", "found"),
    [
        ([], None),
        ([gap(900, 110)], None),  # 10 of 240 ms
        ([gap(950, 100), gap(1200, 10)], None),
        ([gap(950, 170)], (950, 1120, 17)),
        ([gap(1000, 70), gap(1100, 70), gap(1300, 70)], (1000, 1170, 14)),
        ([gap(950, 170), gap(1180, 20, bridged=False)], (1180, 1200, 2)),
    ],
)
def test_what_took_the_signal_around_a_step(gaps: list[Gap], found: tuple | None) -> None:
    evidence = SimpleNamespace(gaps=(*gaps, gap(5000, 300)))
    told = _gap_at(evidence, "/imu", 1000 * MS, 1240 * MS)
    if found is None:
        assert told is None
    else:
        assert told is not None
        assert (told.start_ns // MS, told.end_ns // MS, told.lost) == found


@pytest.mark.parametrize(
    ("gaps", "gate", "told"),
    [
        ([gap(2000, 900, bridged=False), gap(4900, 1000, bridged=False)], "rhythm", "2.900 to 4.9"),
        ([gap(2000, 900, bridged=False), gap(4900, 1000, bridged=False)], "swing", ""),
        ([gap(2000, 900, bridged=False), gap(7000, 1000, bridged=False)], "rhythm", ""),
        ([gap(2000, 900), gap(4900, 1000)], "rhythm", ""),
        ([gap(3900, 1000, bridged=False)], "share", "0.000 to 3.9"),
        ([gap(2000, 900, bridged=False)], "rhythm", ""),
    ],
)
def test_a_rhythm_needs_more_signal_than_some_gaps_leave(
    gaps: list[Gap], gate: str, told: str
) -> None:
    stage = SimpleNamespace(key="steps", use="adaptive")
    config = SimpleNamespace(stage=(stage,))
    evidence = SimpleNamespace(gaps=tuple(gaps), config=config, start_ns=0)
    part = SimpleNamespace(spec=SimpleNamespace(stage="steps", topic="/imu"))
    text = _cut_short(evidence, part, SimpleNamespace(gate=gate), 3500 * MS)
    assert bool(text) == bool(told)
    assert told in text
