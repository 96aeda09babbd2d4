"""Filled gaps as the reason of a miss: where they took half of the signal around it."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from groundtrace.explain.reasons import _gap_at
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
