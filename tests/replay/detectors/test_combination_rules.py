"""Combination rules and discounting: golden fractions and what must hold for any masses."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from belief_cases import GOLDEN, OTHER_RULES, Golden, assert_masses, exact, masses_of
from hypothesis import assume, given
from hypothesis import strategies as st

from groundtrace.detectors.dempster_shafer import (
    RULES,
    conflict,
    dempster,
    discount,
    disjunctive,
    dubois_prade,
    florea,
    smets,
    yager,
)
from groundtrace.errors import BeliefError, GroundtraceError, TotalConflictError

golden = pytest.mark.parametrize("case", GOLDEN.values(), ids=list(GOLDEN))
PAIRS = st.integers(2, 3).flatmap(lambda k: st.tuples(masses_of(k), masses_of(k)))
TRIPLES = st.integers(2, 3).flatmap(lambda k: st.tuples(*[masses_of(k)] * 3))
ROUNDED = Fraction(1, 10**9)


@golden
@pytest.mark.parametrize("rule", OTHER_RULES)
def test_every_rule_gives_its_golden_masses(case: Golden, rule: str) -> None:
    expected = getattr(case, rule.replace("-", "_"))
    assert np.abs(RULES[rule](case.first, case.second) - expected).max() <= ROUNDED
    assert RULES[rule](case.second, case.first).tolist() == (
        RULES[rule](case.first, case.second).tolist()
    )


@golden
def test_dempsters_rule_gives_its_golden_masses_and_refuses_total_conflict(case: Golden) -> None:
    if case.dempster is None:
        with pytest.raises(TotalConflictError, match="total conflict in 1 of 1 rows"):
            dempster(case.first, case.second)
    else:
        assert np.abs(dempster(case.first, case.second) - case.dempster).max() <= ROUNDED


@golden
def test_the_conflict_is_the_golden_one(case: Golden) -> None:
    assert conflict(case.first, case.second) == case.conflict


def test_the_exact_golden_fractions_are_met_exactly() -> None:
    case = GOLDEN["sources of two minds"]
    assert florea(case.first, case.second).tolist() == case.florea.tolist()
    assert dempster(case.first, case.second).tolist() == case.dempster.tolist()
    assert smets(case.first, case.second).tolist() == case.smets.tolist()
    half = GOLDEN["half in common"]
    assert florea(half.first, half.second).tolist() == half.florea.tolist()


def test_discounting_gives_the_golden_masses_that_add_up_to_one() -> None:
    first = GOLDEN["sources of two minds"].first
    found = discount(first, Fraction(3, 4))  # (II.24), corrected
    assert found.tolist() == exact(0, "27/50", "27/200", "13/40").tolist()
    assert discount(first, 0).tolist() == [0, 0, 0, 1]
    assert discount(first, 1).tolist() == first.tolist()


@given(pair=PAIRS)
def test_masses_add_up_to_one_whatever_the_rule(pair) -> None:
    for name, rule in RULES.items():
        if name == "dempster" and conflict(*pair) == 1:
            continue
        assert rule(*pair).sum() == 1, name
        assert min(rule(*pair)) >= 0


@given(pair=st.tuples(masses_of(2), masses_of(2)))
def test_on_two_hypotheses_dubois_and_prade_say_what_yager_says(pair) -> None:
    assert dubois_prade(*pair).tolist() == yager(*pair).tolist()


def test_on_three_hypotheses_dubois_and_prade_keep_what_two_sources_say_together() -> None:
    a, b = exact(0, 1, 0, 0, 0, 0, 0, 0), exact(0, 0, 1, 0, 0, 0, 0, 0)
    assert dubois_prade(a, b).tolist() == [0, 0, 0, 1, 0, 0, 0, 0]
    assert yager(a, b).tolist() == [0, 0, 0, 0, 0, 0, 0, 1]


@given(triple=TRIPLES)
def test_dempster_smets_and_disjunctive_are_associative(triple) -> None:
    a, b, c = triple
    for rule in (smets, disjunctive):
        assert (
            rule(rule(a, b), c).tolist() == rule(a, rule(b, c)).tolist() == rule(a, b, c).tolist()
        )
    assume(conflict(a, b) < 1 and conflict(b, c) < 1 and conflict(a, b, c) < 1)
    left, right = dempster(dempster(a, b), c), dempster(a, dempster(b, c))
    assert left.tolist() == right.tolist() == dempster(a, b, c).tolist()


@pytest.mark.parametrize("rule", [yager, florea, dubois_prade])
def test_the_others_are_not_so_all_sources_are_combined_at_once(rule) -> None:
    a, b, c = (
        exact(0, "1/2", "1/4", "1/4"),
        exact(0, "1/5", "3/5", "1/5"),
        exact(0, "3/4", 0, "1/4"),
    )
    assert rule(rule(a, b), c).tolist() != rule(a, rule(b, c)).tolist()
    assert rule(a, b, c).tolist() == rule(c, a, b).tolist()
    assert rule(a, b, c).sum() == 1


@pytest.mark.parametrize("name", sorted(RULES))
def test_a_single_source_is_left_as_it_is_and_never_written_to(name: str) -> None:
    first = exact(0, "0.72", "0.18", "0.10")
    before = first.tolist()
    assert RULES[name](first).tolist() == before
    RULES[name](first, exact(0, "0.18", "0.42", "0.40"))
    assert first.tolist() == before


@pytest.mark.parametrize("name", sorted(RULES))
def test_many_rows_at_once_are_the_rows_one_by_one(name: str) -> None:
    rng = np.random.default_rng(3)
    first, second = rng.dirichlet(np.ones(7), (2, 50))
    first, second = (np.insert(m, 0, 0.0, axis=1) for m in (first, second))
    rule = RULES[name]
    rows = [rule(a, b) for a, b in zip(first, second, strict=True)]
    assert np.allclose(rule(first, second), rows, rtol=0, atol=1e-15)
    assert np.allclose(rule(first, second[0]), [rule(a, second[0]) for a in first], atol=1e-15)
    assert_masses(rule(first, second))


def test_rows_are_discounted_by_a_number_each() -> None:
    rows = np.tile([0.0, 0.72, 0.18, 0.1], (3, 1))
    found = discount(rows, np.array([0.0, 0.75, 1.0]))
    assert np.allclose(found, [[0, 0, 0, 1], [0, 0.54, 0.135, 0.325], rows[0]])


def test_one_row_of_total_conflict_among_many_is_refused_and_counted() -> None:
    first = np.array([[0, 1.0, 0, 0], [0, 0.5, 0.5, 0]])
    with pytest.raises(TotalConflictError, match="in 1 of 2 rows"):
        dempster(first, np.array([0, 0, 1.0, 0]))
    assert issubclass(TotalConflictError, GroundtraceError)


def test_what_are_no_masses_on_one_frame_is_refused() -> None:
    with pytest.raises(BeliefError, match=r"expected masses on one frame"):
        smets(np.array([0.0, 1.0]), np.array([0.0, 0.5, 0.5, 0.0]))
    with pytest.raises(BeliefError, match=r"expected a last axis of 2\^k subsets"):
        smets(np.array([0.0, 0.5, 0.5]))
    with pytest.raises(BeliefError, match="expected a reliability from 0 to 1"):
        discount(np.array([0.0, 0.5, 0.5, 0.0]), 1.5)
