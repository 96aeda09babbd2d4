"""What straight lines in place of lost samples may cost: the same, however samples come."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundtrace.inertial.lost_samples import FOOT_SIGMA, LINE_SIGMA, SIDE_S, StraightLines

seeds = st.integers(0, 2**32 - 1)


def on_lines(x: np.ndarray, lost: np.ndarray) -> np.ndarray:
    """Samples with straight lines over those that are lost."""
    here = np.flatnonzero(~lost)
    return np.column_stack([np.interp(np.arange(len(x)), here, column[here]) for column in x.T])


def mask(count: int, *spans: tuple[int, int]) -> np.ndarray:
    lost = np.zeros(count, np.bool_)
    for start, stop in spans:
        lost[start:stop] = True
    return lost


def test_a_parabola_under_a_line_is_told_from_the_lines_beside_it() -> None:
    """Of x = t^2 a line over T bends by 3/2 T against those over T / 2 on either side."""
    rate_hz, lost = 10.0, mask(14, (6, 9))
    x = on_lines(np.repeat(np.arange(14.0)[:, None] ** 2, 6, axis=1), lost)
    told = StraightLines(rate_hz, 0.0)(x, lost)
    side = round(SIDE_S * rate_hz)  # 2, half of the line from 5 to 9
    assert np.flatnonzero(told.any(axis=1)).tolist() == [9 + side]
    off = LINE_SIGMA / 12 * 4**2 * (4 + side) / rate_hz
    assert told[9 + side] == pytest.approx(np.full(6, off**2))


@pytest.mark.parametrize("neighbours", [0.0, FOOT_SIGMA, LINE_SIGMA])
def test_lines_between_neighbours_count_as_they_are_to(neighbours: float) -> None:
    """Of x = t^2 the line between neighbours bends by 2."""
    x, rate_hz = np.arange(9.0)[:, None] ** 2, 10.0
    told = StraightLines(rate_hz, neighbours)(x, mask(9))
    off = neighbours / 12 * 2.0 / rate_hz
    assert told[3:, 0] == pytest.approx(np.full(6, off**2))
    assert not told[:3].any()


def test_a_straight_motion_loses_nothing() -> None:
    lost = mask(40, (10, 15), (18, 30))
    x = 3.0 * np.arange(40.0)[:, None] - 7.0
    told = StraightLines(100.0)(on_lines(x, lost), lost)
    assert told == pytest.approx(0.0, abs=1e-20)


@pytest.mark.parametrize("hz", [1.0, 3.0, 6.0])
@pytest.mark.parametrize("span", [5, 9, 20])
def test_swings_of_other_periods_are_off_by_what_is_claimed(hz: float, span: int) -> None:
    """Over random phases the root mean square of errors is 0.2 to 1 of the claimed one."""
    rate_hz, rng, off, claimed = 100.0, np.random.default_rng(0), [], []
    for _ in range(200):
        x = np.sin(2 * np.pi * (hz * np.arange(120) / rate_hz + rng.random()))[:, None]
        lost = mask(120, (40, 40 + span))
        line = on_lines(x, lost)
        off.append(((x - line).sum() / rate_hz) ** 2)
        told = StraightLines(rate_hz, 0.0)(line, lost)
        claimed.append(told.sum())
    assert 0.2 < np.sqrt(np.mean(off) / np.mean(claimed)) < 1.0


@given(
    st.lists(st.integers(0, 9), min_size=1, max_size=12), st.floats(0, 0.9), seeds, st.booleans()
)
def test_lines_are_told_the_same_in_any_blocks(
    sizes: list[int], share: float, seed: int, between_neighbours: bool
) -> None:
    rng, count = np.random.default_rng(seed), sum(sizes)
    x, lost = rng.normal(size=(count, 6)), rng.random(count) < share
    lost[:1] = False
    whole, parts = (StraightLines(100.0) for _ in range(2))
    cuts = np.cumsum(sizes)[:-1]
    told = [parts(a, b) for a, b in zip(np.split(x, cuts), np.split(lost, cuts), strict=True)]
    np.testing.assert_array_equal(np.concatenate(told), whole(x, lost))
