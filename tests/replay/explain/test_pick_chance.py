"""How often chance brings a candidate as near and strong as one beside an arrival."""

from __future__ import annotations

import numpy as np
import pytest

from groundtrace.explain.why_picks import CHANCE, chance

RATE_HZ = 5.0


def counts(draws: int) -> np.ndarray:
    """Return how many as strong lie as near as the nearest of candidates at random, each draw.

    Candidates come on either side at any time, with strengths that are of one law.
    """
    rng = np.random.default_rng(1)
    nearest_s = rng.exponential(1 / (2 * RATE_HZ), draws)
    as_strong = rng.uniform(0, 1, draws)
    return 2 * RATE_HZ * nearest_s * as_strong


@pytest.mark.parametrize("count", [1e-4, 1e-3, 0.01, 0.05, 0.3, 2.0])
def test_chance_is_how_often_random_candidates_are_as_remarkable(count: float) -> None:
    found = counts(1_000_000)
    assert chance(count) == pytest.approx(float((found <= count).mean()), rel=0.1, abs=2e-5)


def test_of_random_candidates_one_in_twenty_is_taken_for_the_arrival() -> None:
    """By the count itself it was one in six."""
    found = counts(20_000)
    assert (found <= CHANCE).mean() > 3 * CHANCE
    taken = np.mean([chance(c) <= CHANCE for c in found.tolist()])
    assert taken == pytest.approx(CHANCE, abs=0.01)


def test_an_unknown_count_is_no_chance_and_none_is_none() -> None:
    assert np.isnan(chance(float("nan")))
    assert chance(0.0) == 0.0
