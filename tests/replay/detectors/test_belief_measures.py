"""Belief, plausibility, pignistic probability and decisions: golden fractions and properties."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from belief_cases import GOLDEN, PEAK, exact, masses_of
from hypothesis import given
from hypothesis import strategies as st

from groundtrace.detectors.dempster_shafer import (
    RULES,
    HypothesisSet,
    belief,
    decision,
    discount,
    over_ignorance,
    pignistic,
    plausibility,
    scores,
    smets,
)
from groundtrace.errors import BeliefError, TotalConflictError

PAIR = GOLDEN["sources of two minds"]
ANY = st.integers(1, 4).flatmap(masses_of)
#: Belief, plausibility and pignistic probability of a peak after each rule (II.25) to (II.28).
SAID = {
    "dempster": ("0.654840649", "0.714972940", "0.684906795", True),
    "smets": ("0.4356", "0.4756", "0.684906795", True),
    "yager": ("0.4356", "0.8104", "0.623", True),
    "dubois-prade": ("0.4356", "0.8104", "0.623", True),
    "disjunctive": ("0.1296", "0.9244", "0.527", False),
    "florea": ("0.428605481", "0.805178765", "0.616892123", True),
}


@pytest.mark.parametrize("rule", sorted(SAID))
def test_every_rule_gives_its_golden_belief_plausibility_and_probability(rule: str) -> None:
    masses = RULES[rule](PAIR.first, PAIR.second)
    peak = PEAK.subset(["peak"])
    found = belief(masses)[peak], plausibility(masses)[peak], pignistic(masses)[0]
    for value, expected in zip(found, SAID[rule], strict=False):
        assert abs(value - Fraction(expected)) <= Fraction(1, 10**9)
    chosen = decision(masses, "belief") == 0 and over_ignorance(masses, peak) > 0
    assert chosen == SAID[rule][3]


def test_a_discounted_source_has_its_golden_measures() -> None:
    masses = discount(PAIR.first, Fraction(3, 4))
    assert belief(masses)[1] == Fraction("0.54")
    assert plausibility(masses)[1] == Fraction("0.865")
    assert pignistic(masses)[0] == Fraction("0.7025")


@given(masses=ANY)
def test_belief_probability_and_plausibility_stand_in_that_order(masses) -> None:
    k = len(masses).bit_length() - 1
    low, likely, high = (scores(masses, c) for c in ("belief", "pignistic", "plausibility"))
    assert all(a <= b <= c for a, b, c in zip(low, likely, high, strict=True))
    assert pignistic(masses).sum() == 1
    # Pl(A) = 1 - Bel(not A)
    assert plausibility(masses).tolist() == (1 - belief(masses)[::-1]).tolist()
    assert len(low) == k


@given(pair=st.tuples(masses_of(2), masses_of(2)))
def test_on_two_hypotheses_all_three_decisions_are_one(pair) -> None:
    masses = smets(*pair)
    if masses[0] < 1:
        lead = [scores(masses, c)[0] - scores(masses, c)[1] for c in CRITERIA]
        assert len({np.sign(float(each)) for each in lead}) == 1


CRITERIA = ("belief", "plausibility", "pignistic")


def test_on_three_hypotheses_the_decisions_differ() -> None:
    # a, b, c; the mass on {b, c} is no belief in either but makes both plausible
    masses = exact(0, "0.4", "0.1", 0, 0, 0, "0.5", 0)
    assert [int(decision(masses, c)) for c in CRITERIA] == [0, 1, 0]


def test_the_test_against_ignorance_is_one_of_its_own() -> None:
    masses = exact(0, "0.4", "0.1", "0.5")
    assert decision(masses, "belief") == 0
    assert over_ignorance(masses, 1) == Fraction(-1, 10)


def test_of_equal_hypotheses_the_first_is_decided_for() -> None:
    assert decision(np.array([[0, 0.3, 0.3, 0.4], [0, 0.2, 0.3, 0.5]]), "belief").tolist() == [0, 1]


def test_total_conflict_has_no_pignistic_probability() -> None:
    with pytest.raises(TotalConflictError, match="all on the empty set in 1 of 1"):
        pignistic(exact(1, 0, 0, 0))


def test_a_frame_names_its_subsets() -> None:
    frame = HypothesisSet(("a", "b", "c"))
    assert (frame.size, frame.full_set) == (8, 7)
    assert frame.subset(["a", "c"]) == 5
    assert frame.complement(5) == 2
    with pytest.raises(BeliefError, match="expected a hypothesis of a, b, c, found 'd'"):
        frame.subset(["d"])
    with pytest.raises(BeliefError, match="expected different names"):
        HypothesisSet(("a", "a"))
