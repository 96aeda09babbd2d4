"""Models of masses: corrected formulas, vectorised, exact where the numbers are."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from belief_cases import PEAK, exact

from groundtrace.belief import (
    Frame,
    appriou_1,
    appriou_2,
    bayesian,
    certain,
    check_masses,
    dubois_prade_model,
    graded,
    ignorance,
    neighbour,
    simple_support,
    specialised,
    trapezoid,
)
from groundtrace.errors import BeliefError

THREE = Frame(("a", "b", "c"))
F = Fraction


def test_simple_masses_are_where_they_belong() -> None:
    assert simple_support(PEAK, 1, F(3, 5)).tolist() == [0, F(3, 5), 0, F(2, 5)]  # (II.8)
    assert specialised(THREE, 5, F(1, 2), F(1, 5)).tolist() == (
        exact(0, 0, "0.2", 0, 0, "0.5", 0, "0.3").tolist()  # (II.9)
    )
    assert ignorance(PEAK).tolist() == [0, 0, 0, 1]  # (II.10)
    assert certain(PEAK, 2).tolist() == [0, 0, 1, 0]  # (II.11)
    found = bayesian(THREE, exact("0.2", "0.5", "0.3"))  # (II.7)
    assert found.tolist() == exact(0, "0.2", "0.5", 0, "0.3", 0, 0, 0).tolist()


def test_certainty_and_truth_become_the_masses_of_a_peak() -> None:
    found = graded(PEAK, 1, F(9, 10), F(8, 10))  # (III.4)
    assert found.tolist() == exact(0, "0.72", "0.18", "0.10").tolist()
    rows = graded(PEAK, 1, np.array([0.9, 0.6]), np.array([0.8, 0.3]))
    assert np.allclose(rows, [[0, 0.72, 0.18, 0.1], [0, 0.18, 0.42, 0.4]])


def test_the_first_model_of_appriou_adds_up_to_one() -> None:
    # (II.13), corrected: as printed the sum is .679
    found = appriou_1(PEAK, 1, F(6, 10), F(9, 10), F(1, 2))
    assert found.tolist() == [0, F(27, 130), F(9, 13), F(1, 10)]
    assert found.sum() == 1


def test_the_second_model_of_appriou_only_speaks_against() -> None:
    found = appriou_2(THREE, 1, F(6, 10), F(9, 10), F(1, 2))  # (II.15)
    assert found.tolist() == exact(0, 0, 0, 0, 0, 0, "0.63", "0.37").tolist()


def test_a_likelihood_scaled_above_one_is_refused() -> None:
    with pytest.raises(BeliefError, match=r"found R P up to 1\.2"):
        appriou_1(PEAK, 1, 0.6, 0.9, 2.0)


def test_probabilities_become_nested_masses_of_the_likeliest_together() -> None:
    found = dubois_prade_model(THREE, exact("0.2", "0.5", "0.3"))  # (II.12)
    # b: 1 (.5 - .3); b and c: 2 (.3 - .2); all: 3 (.2)
    assert found.tolist() == exact(0, 0, "0.2", 0, 0, 0, "0.2", "0.6").tolist()
    rows = dubois_prade_model(THREE, np.array([[0.2, 0.5, 0.3], [1 / 3, 1 / 3, 1 / 3]]))
    assert np.allclose(rows, [[0, 0, 0.2, 0, 0, 0, 0.2, 0.6], [0, 0, 0, 0, 0, 0, 0, 1]])
    with pytest.raises(BeliefError, match="expected 3 in a row"):
        dubois_prade_model(THREE, np.array([0.5, 0.5]))


def test_a_neighbour_supports_its_hypothesis_the_less_the_farther_it_is() -> None:
    found = neighbour(PEAK, 1, np.array([0.0, 2.0, 1e3]), 2.0)  # (II.16)
    assert np.allclose(found[:, 1], [0.95, 0.95 / np.e, 0])
    check_masses(found)


def test_a_trapezoid_rises_stays_and_falls() -> None:
    x = np.array([-1, 0, 0.5, 1, 2, 3, 3.5, 4, 9])
    assert trapezoid(x, 0, 1, 3, 4).tolist() == [0, 0, 0.5, 1, 1, 1, 0.5, 0, 0]
    assert trapezoid(x, 1, 1, 3, 3).tolist() == [0, 0, 0, 1, 1, 1, 0, 0, 0]
    assert trapezoid(x, 0, 1, np.inf, np.inf).tolist() == [0, 0, 0.5, 1, 1, 1, 1, 1, 1]
    with pytest.raises(BeliefError, match="expected rising corners, found 0, 2, 1, 3"):
        trapezoid(x, 0, 2, 1, 3)


@pytest.mark.parametrize(
    "rows",
    [
        graded(PEAK, 1, np.linspace(0, 1, 9), np.linspace(1, 0, 9)),
        appriou_1(THREE, 2, np.linspace(0, 1, 9), 0.9),
        appriou_2(THREE, 2, np.linspace(0, 1, 9), 1.0),
        ignorance(THREE, np.zeros(9)),
        dubois_prade_model(THREE, np.random.default_rng(0).dirichlet(np.ones(3), 9)),
        bayesian(THREE, np.random.default_rng(1).dirichlet(np.ones(3), 9)),
    ],
)
def test_every_model_gives_a_row_for_each_number(rows: np.ndarray) -> None:
    assert rows.shape[0] == 9
    check_masses(rows)
