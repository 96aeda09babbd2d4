"""The same masses as other libraries: evtools-dst and pybelief."""

from __future__ import annotations

import evtools.combinations as ev
import numpy as np
import pytest
from evtools.conversions import betp, mtobel, mtopl
from evtools.corrections import discount as ev_discount
from evtools.dsvector import DSVector
from pybelief.mass import MassFunction

from groundtrace.detectors.dempster_shafer import (
    belief,
    dempster,
    discount,
    disjunctive,
    pignistic,
    plausibility,
    smets,
    yager,
)

CLOSE = 1e-12


def random_masses(hypotheses: int, count: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    masses = rng.dirichlet(np.full(2**hypotheses - 1, 0.4), count)
    return np.insert(masses, 0, 0.0, axis=1)


@pytest.mark.parametrize("hypotheses", [2, 3, 4])
def test_rules_measures_and_discount_are_those_of_evtools(hypotheses: int) -> None:
    frame = list("abcd"[:hypotheses])
    first, second = (random_masses(hypotheses, 20, seed) for seed in (1, 2))
    ours = dempster(first, second), smets(first, second), disjunctive(first, second)
    weak = discount(first, 0.75)
    for row, (a, b) in enumerate(zip(first, second, strict=True)):
        one, other = DSVector.from_dense(frame, a), DSVector.from_dense(frame, b)
        theirs = ev.dempster(one, other), ev.crc(one, other), ev.drc(one, other)
        for mine, their in zip(ours, theirs, strict=True):
            assert np.abs(mine[row] - their.dense).max() < CLOSE
        assert np.abs(weak[row] - ev_discount(one, 0.75).dense).max() < CLOSE
        assert np.abs(belief(a) - mtobel(a)).max() < CLOSE
        assert np.abs(plausibility(a) - mtopl(a)).max() < CLOSE
        assert np.abs(pignistic(ours[1][row]) - betp(ours[1][row])).max() < CLOSE


@pytest.mark.parametrize("hypotheses", [2, 3, 4])
def test_rules_measures_and_discount_are_those_of_pybelief(hypotheses: int) -> None:
    frame = "abcd"[:hypotheses]
    first, second = (random_masses(hypotheses, 20, seed) for seed in (3, 4))
    for a, b in zip(first, second, strict=True):
        one, other = (MassFunction(frame, dict(enumerate(m.tolist()))) for m in (a, b))
        pairs = (
            (dempster(a, b), one.combine_dempster(other)),
            (smets(a, b), one.combine_conjunctive(other)),
            (yager(a, b), one.combine_yager(other)),
            (discount(a, 0.75), one.discount(0.25)),
        )
        for mine, theirs in pairs:
            dense = [theirs.focal_elements().get(i, 0.0) for i in range(len(a))]
            assert np.abs(mine - dense).max() < CLOSE
        assert np.abs(pignistic(a) - list(one.pignistic().values())).max() < CLOSE
        assert abs(belief(a)[3] - one.belief(3)) < CLOSE
        assert abs(plausibility(a)[3] - one.plausibility(3)) < CLOSE
