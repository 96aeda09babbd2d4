"""Models of masses: corrected formulas, vectorised, exact where the numbers are."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from belief_cases import PEAK, assert_masses, exact

from groundtrace.detectors.dempster_shafer import HypothesisSet, graded, specialised, trapezoid
from groundtrace.errors import BeliefError

THREE = HypothesisSet(("a", "b", "c"))
F = Fraction


def test_masses_for_and_against_are_where_they_belong() -> None:
    assert specialised(THREE, 5, F(1, 2), F(1, 5)).tolist() == (
        exact(0, 0, "0.2", 0, 0, "0.5", 0, "0.3").tolist()  # (II.9)
    )


def test_certainty_and_truth_become_the_masses_of_a_peak() -> None:
    found = graded(PEAK, 1, F(9, 10), F(8, 10))  # (III.4)
    assert found.tolist() == exact(0, "0.72", "0.18", "0.10").tolist()
    rows = graded(PEAK, 1, np.array([0.9, 0.6]), np.array([0.8, 0.3]))
    assert np.allclose(rows, [[0, 0.72, 0.18, 0.1], [0, 0.18, 0.42, 0.4]])


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
        specialised(THREE, 2, np.linspace(0, 0.5, 9), np.linspace(0.5, 0, 9)),
    ],
)
def test_every_model_gives_a_row_for_each_number(rows: np.ndarray) -> None:
    assert rows.shape[0] == 9
    assert_masses(rows)
