"""Gates: values and margins for every candidate, and the same verdicts however they are split."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundtrace.pipeline.gates import Candidates, GateState, Level, Refractory, decide, gate_specs
from groundtrace_codecs.events import GateSpec, Quantity
from groundtrace_codecs.signals import NS_PER_S

COLUMNS = (Quantity("height", "m"), Quantity("loss", "1"))
GATES = (
    Level("height", "m", "height"),
    Level("loss", "1", "loss", at_least=False),
    Refractory(),
)
MS = NS_PER_S // 1000


def candidates(rows: list[tuple[int, int, float, float]]) -> Candidates:
    """Rows of (time [ms], channel, height, loss)."""
    return Candidates(
        np.array([r[0] * MS for r in rows], np.int64),
        np.array([r[1] for r in rows], np.int32),
        np.array([r[2:] for r in rows], np.float32).reshape(len(rows), 2),
    )


def thresholds(height: float = 1.0, loss: float = 0.5, refractory_s: float = 0.0):
    return SimpleNamespace(height=height, loss=loss, refractory_s=refractory_s)


def oracle(found: Candidates, p: SimpleNamespace) -> tuple[np.ndarray, np.ndarray]:
    """Walk through the candidates one by one: refractory value and verdict of each."""
    last: dict[int, int] = {}
    values, verdicts = [], []
    for time_ns, channel, (height, loss) in zip(
        found.time_ns.tolist(), found.channel.tolist(), found.value.tolist(), strict=True
    ):
        since = (time_ns - last[channel]) / NS_PER_S if channel in last else np.inf
        passed = height >= p.height and loss <= p.loss and since >= p.refractory_s
        values.append(since)
        verdicts.append(passed)
        if passed:
            last[channel] = time_ns
    return np.array(values), np.array(verdicts, np.bool_)


ROWS = st.lists(
    st.tuples(
        st.integers(0, 60),
        st.integers(0, 2),
        st.sampled_from([0.5, 0.999, 1.0, 2.0, float("nan")]),
        st.sampled_from([0.0, 0.5, 0.75]),
    ),
    max_size=40,
).map(lambda rows: sorted(rows, key=lambda r: r[:2]))
SPACINGS = st.sampled_from([0.0, 0.001, 0.007, 0.01, 0.3, 1e20])


@given(rows=ROWS, refractory_s=SPACINGS)
def test_the_verdicts_are_those_of_a_walk_through_the_candidates(rows, refractory_s):
    found, p = candidates(rows), thresholds(refractory_s=refractory_s)
    decisions, _ = decide(found, COLUMNS, GATES, p)
    values, verdicts = oracle(found, p)
    assert np.array_equal(decisions.accepted, verdicts)
    assert np.array_equal(decisions.gate_value[:, 2], values.astype(np.float32))


@given(rows=ROWS, cuts=st.lists(st.integers(0, 40), max_size=5), refractory_s=SPACINGS)
def test_deciding_in_parts_equals_deciding_at_once(rows, cuts, refractory_s):
    found, p = candidates(rows), thresholds(refractory_s=refractory_s)
    whole, last = decide(found, COLUMNS, GATES, p)
    edges = [0, *sorted(min(c, len(found)) for c in cuts), len(found)]
    carry, parts = None, []
    for a, b in pairwise(edges):
        decisions, carry = decide(found.rows(slice(a, b)), COLUMNS, GATES, p, carry)
        parts.append(decisions)
    for name in ("gate_value", "margin", "accepted"):
        joined = np.concatenate([getattr(part, name) for part in parts])
        assert np.array_equal(joined, getattr(whole, name), equal_nan=name != "accepted")
    assert carry == last


def test_of_two_candidates_at_one_time_the_first_is_accepted():
    found = candidates([(0, 0, 2, 0), (500, 0, 2, 0), (500, 0, 3, 0)])
    decisions, _ = decide(found, COLUMNS, GATES, thresholds(refractory_s=0.3))
    assert decisions.accepted.tolist() == [True, True, False]
    assert decisions.gate_value[:, 2].tolist() == [np.inf, 0.5, 0.0]


def test_a_threshold_that_is_exactly_met_is_passed():
    found = candidates([(0, 0, 1.0, 0.5), (300, 0, 1.0, 0.5)])
    decisions, _ = decide(found, COLUMNS, GATES, thresholds(refractory_s=0.3))
    assert decisions.accepted.all()
    assert decisions.margin[1].tolist() == [0.0, 0.0, 0.0]


def test_a_nanosecond_less_than_the_refractory_time_is_not_passed():
    found = Candidates(
        np.array([0, 300 * MS - 1, 300 * MS], np.int64),
        np.zeros(3, np.int32),
        np.tile(np.float32([2, 0]), (3, 1)),
    )
    decisions, _ = decide(found, COLUMNS, GATES, thresholds(refractory_s=0.3))
    assert decisions.accepted.tolist() == [True, False, True]
    assert decisions.margin[1, 2] == pytest.approx(-1e-9, rel=1e-3, abs=0)


@pytest.mark.parametrize("column", [0, 1])
def test_a_value_that_is_not_a_number_fails_its_gate(column):
    value = [2.0, 0.0]
    value[column] = float("nan")
    decisions, carry = decide(candidates([(0, 0, *value)]), COLUMNS, GATES, thresholds())
    assert not decisions.accepted[0]
    assert np.isnan(decisions.margin[0, column])
    assert carry == GateState({"refractory": {}})


def test_every_gate_has_value_and_margin_also_behind_a_failure():
    found = candidates([(0, 0, 2, 0), (100, 0, 0.25, 0.75)])
    decisions, _ = decide(found, COLUMNS, GATES, thresholds(refractory_s=0.25))
    assert decisions.gate_value[1].tolist() == pytest.approx([0.25, 0.75, 0.1])
    assert decisions.margin[1].tolist() == pytest.approx([-0.75, -0.25, -0.15])


def test_a_candidate_that_failed_before_does_not_start_the_refractory_time():
    found = candidates([(0, 0, 0, 0), (100, 0, 2, 0), (200, 0, 2, 0)])
    decisions, _ = decide(found, COLUMNS, GATES, thresholds(refractory_s=0.25))
    assert decisions.accepted.tolist() == [False, True, False]


def test_channels_have_their_own_refractory_times():
    found = candidates([(0, 0, 2, 0), (1, 1, 2, 0), (2, 0, 2, 0), (2, 1, 2, 0)])
    decisions, carry = decide(found, COLUMNS, GATES, thresholds(refractory_s=0.25))
    assert decisions.accepted.tolist() == [True, True, False, False]
    assert carry.last_ns == {"refractory": {0: 0, 1: MS}}


def test_deciding_leaves_the_carry_it_was_given_as_it_was():
    given_carry = GateState({"refractory": {0: 0}})
    _, after = decide(candidates([(900, 0, 2, 0)]), COLUMNS, GATES, thresholds(), given_carry)
    assert given_carry.last_ns == {"refractory": {0: 0}}
    assert after.last_ns == {"refractory": {0: 900 * MS}}


def test_no_candidates_and_no_gates_are_decided_too():
    decisions, _ = decide(Candidates.empty(2), COLUMNS, GATES, thresholds())
    assert decisions.margin.shape == (0, 3)
    decisions, _ = decide(candidates([(0, 0, 0, 9)]), COLUMNS, (), thresholds())
    assert decisions.accepted.tolist() == [True]
    assert decisions.margin.shape == (1, 0)


def test_a_gate_states_its_threshold_as_it_stands_in_the_run():
    assert gate_specs(GATES, thresholds(refractory_s=0.25)) == (
        GateSpec("height", "m", "height", 1.0),
        GateSpec("loss", "1", "loss", 0.5, at_least=False),
        GateSpec("refractory", "s", "refractory_s", 0.25),
    )


def test_parts_are_joined_and_rows_are_chosen():
    found = candidates([(0, 0, 1, 0), (5, 1, 2, 0)])
    joined = Candidates.concatenate([found, Candidates.empty(2), found])
    assert len(joined) == 4
    assert joined.rows(joined.channel == 1).time_ns.tolist() == [5 * MS, 5 * MS]
