"""The step-clocked filter against golden numbers and the published experiment."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from walked_paths import PATHS, located, rms, tracked

from groundtrace.trackers.kalman import (
    PACE_M,
    F,
    H,
    LinearFilter,
    Motion,
    StepFilter,
    WalkModel,
    first_spread,
    smoothed,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

PLACES = np.array([(0, 0), (0.4, 0.1), (0.6, 0.1), (1.1, 0), (1.3, 0.2)])


def test_the_model_goes_on_as_the_last_step_went() -> None:
    state = np.array([1.0, 2.0, 1.3, 2.1])
    assert (F @ state).tolist() == pytest.approx([1.3, 2.1, 1.6, 2.2])
    assert (H @ state).tolist() == pytest.approx([1.3, 2.1])
    assert np.diag(WalkModel(0.1, 0.5).q) == pytest.approx((0, 0, 0.01, 0.01))


def test_five_fixes_give_the_golden_places() -> None:
    model = WalkModel(0.1, 0.5)
    walker = StepFilter(model, PLACES[0], np.eye(4))
    found = []
    for place in PLACES[1:]:
        walker.step(place, model.r)
        found.append(walker.state[2:])
    expected = [(0.380989, 0.095247), (0.602306, 0.112239), (1.011827, 0.047791)]
    assert np.array(found) == pytest.approx(np.array([*expected, (1.306878, 0.136948)]), abs=1e-6)


@pytest.mark.parametrize(
    ("sigma_q", "sigma_r", "before", "present"),
    [
        (0.1, 0.5, 0.326039, 0.471443),
        (0.5, 0.5, 0.288553, 0.769087),
        (0.1, 1.0, 0.281880, 0.361769),
    ],
)
def test_the_gains_settle_at_the_golden_ones(
    sigma_q: float, sigma_r: float, before: float, present: float
) -> None:
    model = WalkModel(sigma_q, sigma_r)
    walker = StepFilter(model, np.zeros(2), first_spread(model.r))
    for _ in range(200):
        walker.step(np.zeros(2), model.r)
    expected = np.kron([[before], [present]], np.eye(2))
    assert walker.gain == pytest.approx(expected, abs=1e-6)


def test_at_first_both_places_err_alike_and_the_one_before_by_a_pace_more() -> None:
    noise = np.array([[0.2, 0.05], [0.05, 0.1]])
    spread = first_spread(noise)
    assert spread[2:, 2:] == pytest.approx(noise)
    assert spread[:2, 2:] == pytest.approx(noise)
    assert spread[:2, :2] == pytest.approx(noise + PACE_M**2 * np.eye(2))


def test_distance_is_that_of_the_update_and_changes_nothing() -> None:
    model = WalkModel()
    walker = StepFilter(model, np.zeros(2), first_spread(model.r))
    other = copy.deepcopy(walker)
    place, noise = np.array([0.9, -0.4]), np.array([[0.3, 0.1], [0.1, 0.2]])
    distance = walker.fit(place, noise)[0]
    assert walker.state.tolist() == other.state.tolist()
    assert walker.step(place, noise) == pytest.approx(distance**2)
    assert other.state.tolist() == [0, 0, 0, 0]


def test_innovations_of_the_model_itself_are_as_large_as_it_says() -> None:
    model = WalkModel(0.1, 0.5)
    rng = np.random.default_rng(5)
    squares = []
    for _ in range(60):
        truth = np.array([(0.0, 0.0), rng.normal(0, PACE_M, 2)])
        walker = StepFilter(model, truth[1] + rng.normal(0, 0.5, 2), first_spread(model.r))
        for _ in range(15):
            ahead = 2 * truth[1] - truth[0] + rng.normal(0, 0.1, 2)
            truth = np.array([truth[1], ahead])
            squares.append(walker.step(ahead + rng.normal(0, 0.5, 2), model.r))
    assert np.mean(squares) == pytest.approx(2.0, abs=0.2)


def test_missed_steps_are_ticks_without_a_fix() -> None:
    model = WalkModel(0.1, 0.5)
    one, other = (StepFilter(model, PLACES[1], first_spread(model.r)) for _ in range(2))
    once, thrice = Motion.ahead(model), Motion.ahead(model, 3)
    assert thrice.f == pytest.approx(F @ F @ F)
    spread = one.spread
    for _ in range(3):
        spread = once.f @ spread @ once.f.T + once.q
    assert thrice.f @ other.spread @ thrice.f.T + thrice.q == pytest.approx(spread)
    assert thrice.ticks == 3


def test_after_a_turn_a_step_may_lie_anywhere_about_the_present_place() -> None:
    model = WalkModel(0.2, 0.2)
    walker = StepFilter(model, np.zeros(2), first_spread(model.r))
    for k in range(1, 8):
        walker.step(np.array([0.5 * k, 0.0]), model.r)
    back, turned = np.array([3.0, 0.0]), Motion.turning()
    assert walker.fit(back, model.r, turned)[0] < 0.6 * walker.fit(back, model.r)[0]
    assert walker.fit(back, model.r, turned)[1] < walker.fit(back, model.r)[1]
    ahead = np.array([4.0, 0.0])
    assert walker.fit(ahead, model.r)[1] < walker.fit(ahead, model.r, turned)[1]
    walker.step(back, model.r, turned)
    assert walker.state == pytest.approx((3.5, 0, 3.0, 0), abs=0.2)


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("name", "static", "thesis", "loose", "slow"),
    [
        ("bent", 0.748, 0.516, 0.623, 0.527),
        ("v", 0.798, 0.570, 0.665, 0.603),
        ("wide v", 0.790, 0.560, 0.657, 0.594),
        ("circle", 0.824, 0.632, 0.691, 0.713),
    ],
)
def test_filtering_places_by_so_tdoa_gains_what_it_should(
    name: str, static: float, thesis: float, loose: float, slow: float
) -> None:
    path = PATHS[name]
    places = located(path, 150)
    assert rms(places - path) == pytest.approx(static, rel=0.08)
    for model, expected in (
        (WalkModel(0.1, 0.5), thesis),
        (WalkModel(0.5, 0.5), loose),
        (WalkModel(0.1, 1.0), slow),
    ):
        filtered: NDArray[np.float64] = tracked(places, model)[0]
        assert rms(filtered - path) == pytest.approx(expected, rel=0.08)


@pytest.mark.parametrize("size", [1, 4, 5])
@pytest.mark.parametrize("seen", [1, 2, 6])
def test_filter_and_smoother_give_what_filterpy_gives(size: int, seen: int) -> None:
    rng = np.random.default_rng([size, seen])

    def spread(n: int) -> NDArray[np.float64]:
        root = rng.normal(size=(n, n))
        return np.asarray(root @ root.T + 0.1 * np.eye(n))

    ours = LinearFilter(rng.normal(size=size), spread(size))
    peer = KalmanFilter(dim_x=size, dim_z=seen)
    peer.x, peer.P = ours.state.copy(), ours.spread.copy()
    motions = [Motion(rng.normal(size=(size, size)), spread(size)) for _ in range(12)]
    kept, peers = [], []
    for n, motion in enumerate(motions):
        ours.predict(motion.f, motion.q)
        peer.predict(F=motion.f, Q=motion.q)
        assert ours.nis == 0
        if n % 4 != 3:
            z, h, noise = rng.normal(size=seen), rng.normal(size=(seen, size)), spread(seen)
            ours.update(z, h, noise)
            peer.update(z, R=noise, H=h)
            assert ours.nis == pytest.approx(peer.mahalanobis**2, rel=1e-9)
            np.testing.assert_allclose(ours.gain, peer.K, rtol=1e-9, atol=1e-12)
        kept.append((ours.state, ours.spread))
        peers.append((peer.x.copy(), peer.P.copy()))
    for one, other in zip(kept, peers, strict=True):
        np.testing.assert_allclose(one[0], other[0], rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(one[1], other[1], rtol=1e-9, atol=1e-12)
    states, spreads = (np.array(rows) for rows in zip(*kept, strict=True))
    fs, qs = [m.f for m in motions], [m.q for m in motions]
    x, p, _, _ = peer.rts_smoother(states, spreads, fs, qs)
    found = smoothed(states, spreads, motions)
    np.testing.assert_allclose(found[0], x, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found[1], p, rtol=1e-9, atol=1e-12)
