"""Clocks found by shared moments: how near, when ambiguous, and that no wrong one is taken."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from groundtrace.api.align import AlignmentEvents, align
from groundtrace_codecs.signals import NS_PER_S

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

START_NS = 1_700_000_000 * NS_PER_S
AHEAD_S = 12.345


def walk(
    rng: np.random.Generator, bouts: int, steps: int, unsteady: float, stop_s: tuple[float, float]
) -> Array:
    """Return contacts of several walks with stops between them [s]."""
    now_s, found = 5.0, []
    for _ in range(bouts):
        gaps = 0.54 * (1 + unsteady * rng.standard_normal(steps))
        found.append(now_s + np.cumsum(gaps))
        now_s = float(found[-1][-1]) + rng.uniform(*stop_s)
    return np.concatenate(found)


def recorded(
    rng: np.random.Generator,
    contact_s: Array,
    *,
    ahead_s: float = 0.0,
    drift_ppm: float = 0.0,
    scatter_s: float = 0.01,
    missed: float = 0.0,
) -> AlignmentEvents:
    """Return what a device with a wrong clock makes of contacts: some missed, as many invented."""
    end_s = float(contact_s[-1]) + 5.0
    kept = contact_s[rng.random(len(contact_s)) >= missed]
    invented = rng.uniform(0, end_s, rng.poisson(missed * len(contact_s)))
    seen = np.sort(np.concatenate([kept, invented]))
    seen = np.sort(seen + scatter_s * rng.standard_normal(len(seen)))

    def at(time_s: Array) -> NDArray[np.int64]:
        shown = time_s * (1 + drift_ppm * 1e-6) + ahead_s
        return START_NS + np.rint(shown * NS_PER_S).astype(np.int64)

    return AlignmentEvents(at(seen), int(at(np.zeros(1))[0]), int(at(np.array([end_s]))[0]))


def test_offset_and_drift_of_ten_minutes_are_found() -> None:
    for seed in (1, 2):
        rng = np.random.default_rng(seed)
        contact_s = walk(rng, 12, 90, 0.04, (1.0, 5.0))
        other = recorded(rng, contact_s, ahead_s=AHEAD_S, drift_ppm=35.0, missed=0.03)
        found = align(recorded(rng, contact_s, scatter_s=0.003, missed=0.03), other)
        assert found is not None
        assert not found.ambiguous
        assert found.best.drift_fitted
        assert found.clock.ahead_ns / NS_PER_S == pytest.approx(AHEAD_S, abs=0.005)
        assert found.clock.drift_ppm == pytest.approx(35.0, abs=8.0)
        off_s = (found.clock.ahead_ns / NS_PER_S - AHEAD_S) / found.best.ahead_sigma_s
        assert abs(off_s) < 4


def test_half_a_minute_tells_the_offset_and_says_that_it_does_not_tell_the_drift() -> None:
    rng = np.random.default_rng(3)
    contact_s = walk(rng, 1, 60, 0.045, (1.0, 5.0))
    found = align(recorded(rng, contact_s), recorded(rng, contact_s, ahead_s=AHEAD_S))
    assert found is not None
    assert not found.ambiguous
    assert not found.best.drift_fitted
    assert found.clock.drift_ppm == 0.0
    assert found.clock.ahead_ns / NS_PER_S == pytest.approx(AHEAD_S, abs=0.01)
    assert found.second is not None
    assert abs(found.second.ahead_s - found.best.ahead_s) == pytest.approx(0.54, abs=0.05)


@pytest.mark.parametrize("steps", [40, 200])
def test_a_metronome_is_ambiguous(steps: int) -> None:
    for seed in range(2):
        rng = np.random.default_rng(seed)
        contact_s = walk(rng, 1, steps, 0.0, (1.0, 5.0))
        found = align(
            recorded(rng, contact_s, missed=0.03), recorded(rng, contact_s, ahead_s=AHEAD_S)
        )
        assert found is not None
        assert found.ambiguous


def test_starts_and_stops_tell_where_a_metronome_does_not() -> None:
    rng = np.random.default_rng(4)
    contact_s = walk(rng, 6, 20, 0.0, (1.0, 5.0))
    found = align(recorded(rng, contact_s), recorded(rng, contact_s, ahead_s=AHEAD_S))
    assert found is not None
    assert not found.ambiguous
    assert found.clock.ahead_ns / NS_PER_S == pytest.approx(AHEAD_S, abs=0.01)


def test_no_wrong_shift_passes_for_a_sure_one() -> None:
    wrong = sure = 0
    for seed in range(12):
        rng = np.random.default_rng(100 + seed)
        unsteady = (0.0, 0.015, 0.025, 0.045)[seed % 4]
        contact_s = walk(rng, 1 + seed % 3, 30, unsteady, (1.0, 4.0))
        one = recorded(rng, contact_s, missed=0.05)
        found = align(one, recorded(rng, contact_s, ahead_s=AHEAD_S, missed=0.05))
        if found is not None and not found.ambiguous:
            sure += 1
            wrong += abs(found.clock.ahead_ns / NS_PER_S - AHEAD_S) > 0.1
    assert wrong == 0
    assert sure >= 3


def test_two_walks_that_have_nothing_in_common_are_ambiguous() -> None:
    rng = np.random.default_rng(5)
    one, other = (recorded(rng, walk(rng, 2, 40, 0.04, (1.0, 5.0))) for _ in range(2))
    found = align(one, other)
    assert found is None or found.ambiguous


def test_few_irregular_impacts_are_enough() -> None:
    rng = np.random.default_rng(6)
    struck_s = np.array([3.1, 4.0, 5.7, 61.2, 62.9, 63.6])
    found = align(
        recorded(rng, struck_s, scatter_s=0.003),
        recorded(rng, struck_s, ahead_s=-1e6, drift_ppm=-60.0, scatter_s=0.003),
        least=3,
    )
    assert found is not None
    assert not found.ambiguous
    assert found.best.matched == 6
    assert found.clock.ahead_ns / NS_PER_S == pytest.approx(-1e6, abs=0.01)


def test_too_few_moments_give_nothing() -> None:
    moments = AlignmentEvents(np.array([START_NS + 5], np.int64), START_NS, START_NS + NS_PER_S)
    assert align(moments, moments) is None
