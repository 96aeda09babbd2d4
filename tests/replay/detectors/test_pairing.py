"""Pairing of peaks with valleys: one step a valley, however the candidates are split."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from groundtrace.detectors.body_signals import Pairing
from groundtrace.pipeline.gates import Candidates, Level, decide
from groundtrace_codecs.events import Quantity

COLUMNS = (Quantity("height", "m"), Quantity("fall", "s"))
GATES = (Level("height", "m", "height"), Pairing())
MS = 1_000_000


def pairs(rows: list[tuple[int, int, float]]) -> Candidates:
    """Rows of (time [ms], time to the valley [ms], height)."""
    return Candidates(
        np.array([r[0] * MS for r in rows], np.int64),
        np.zeros(len(rows), np.int32),
        np.array([(r[2], r[1] / 1e3) for r in rows], np.float32).reshape(-1, 2),
    )


def thresholds(pause_s: float = 0.0) -> SimpleNamespace:
    return SimpleNamespace(height=1.0, pause_s=pause_s)


def test_two_peaks_of_one_valley_are_one_step() -> None:
    found = pairs([(0, 250, 2.0), (125, 125, 2.0), (500, 250, 2.0)])
    decisions, carry = decide(found, COLUMNS, GATES, thresholds())
    assert decisions.accepted.tolist() == [True, False, True]
    assert decisions.gate_value[:, 1].tolist() == [np.inf, -0.125, 0.25]
    assert carry.last_ns == {"pairing": {0: 750 * MS}}


def test_a_peak_that_failed_before_keeps_no_valley() -> None:
    found = pairs([(0, 250, 0.5), (125, 125, 2.0)])
    decisions, _ = decide(found, COLUMNS, GATES, thresholds())
    assert decisions.accepted.tolist() == [False, True]


ROWS = st.lists(
    st.tuples(st.integers(0, 60), st.integers(0, 20), st.sampled_from([0.5, 2.0])), max_size=30
).map(sorted)


@given(
    rows=ROWS, cuts=st.lists(st.integers(0, 30), max_size=4), pause_s=st.sampled_from([0, 0.005])
)
def test_pairing_in_parts_equals_pairing_at_once(rows, cuts, pause_s) -> None:
    found = pairs(rows)
    whole, last = decide(found, COLUMNS, GATES, thresholds(pause_s))
    edges = [0, *sorted(min(c, len(rows)) for c in cuts), len(rows)]
    carry, accepted = None, []
    for a, b in pairwise(edges):
        decisions, carry = decide(
            found.rows(slice(a, b)), COLUMNS, GATES, thresholds(pause_s), carry
        )
        accepted += decisions.accepted.tolist()
    assert accepted == whole.accepted.tolist()
    assert carry == last
