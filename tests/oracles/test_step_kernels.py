"""Kernels of step detectors against plain numpy, on random and on hostile signals."""

from __future__ import annotations

import math

import numpy as np
import pytest
from plain_python import inputs
from scipy.signal import lfilter

from groundtrace.inertial.step_type import CONTACT, PHASE, POINTS, frontal, lateral
from groundtrace.kernels import axes, steps

RNG = np.random.default_rng(23)


def signals(n: int) -> dict[str, np.ndarray]:
    """Return signals in which steps are looked for, each (n,)."""
    noise = RNG.normal(size=n)
    walk = 2 * np.sin(np.arange(n) * RNG.uniform(0.15, 0.4)) + 0.3 * noise
    return {
        "noise": noise,
        "walk": walk,
        "a blow": np.where(np.arange(n) == n // 3, 100.0, walk),
        "rounded": np.round(walk),
        "zeros": np.zeros(n),
        "constant": np.full(n, 0.7),
        "a half is constant": np.where(np.arange(n) < n // 2, 9.81, walk),
    }


@pytest.mark.parametrize("n", [1, 2, 3, 8, 9, 110, 321])
def test_the_median_size_is_numpys(n):
    for x in signals(n).values():
        assert steps.median_size(x, np.empty(n)) == np.median(np.abs(x))


@pytest.mark.parametrize(
    ("n", "lags"), inputs([(1, 1), (7, 3), (110, 66), (320, 157), (321, 160)], [(7, 3), (110, 66)])
)
def test_a_window_is_correlated_with_itself_as_by_products_of_its_parts(n, lags):
    for row in signals(n).values():
        limit = 1.5 * np.median(np.abs(row))
        window, found = np.zeros(n + lags - 1), np.empty(lags)
        steps.clip_window(row, limit, window)
        steps.autocorrelation(window, np.empty(n + 1), found)
        x = np.clip(row, -limit, limit)
        x = x - x.mean()
        np.testing.assert_allclose(window[:n], x, atol=1e-12)
        products = np.array([x[: n - k] @ x[k:] for k in range(lags)])
        energy = np.array([(x[: n - k] ** 2).sum() * (x[k:] ** 2).sum() for k in range(lags)])
        np.testing.assert_allclose(found, products / np.sqrt(energy + 1e-9), atol=1e-12)


def rhythm_of(row: np.ndarray, repeats: int, periods: tuple[int, int], fastest: float) -> tuple:
    """Return strength, step time in points and median amplitude of one window."""
    n, (shortest, longest), size = len(row), periods, np.median(np.abs(row))
    x = np.clip(row, -1.5 * size, 1.5 * size)
    x = x - x.mean()
    at = np.arange(repeats * longest + 1)
    products = np.array([x[: n - k] @ x[k:] for k in at])
    energy = np.array([(x[: n - k] ** 2).sum() * (x[k:] ** 2).sum() for k in at])
    alike = products / np.sqrt(energy + 1e-9)
    tried = np.arange(shortest, longest + 1)
    comb = np.mean([alike[k * tried] for k in range(1, repeats + 1)], axis=0)
    inner = 1 + np.flatnonzero((comb[1:-1] > comb[:-2]) & (comb[1:-1] >= comb[2:]))
    if not len(inner):
        return -1.0, 0.0, size
    best = inner[comb[inner].argmax()]
    period, strength = int(tried[best]), comb[best]
    parts = 1
    if period >= 3 * fastest and np.interp(period / 3, at, alike) > 0.5 * strength:
        parts = 3
    elif period >= 2 * fastest and np.interp(period / 2, at, alike) > -0.5 * strength:
        parts = 2
    return strength, period / parts, size


@pytest.mark.parametrize("repeats", inputs([1, 2, 3], [2]))
@pytest.mark.parametrize("length", inputs([110, 320], [110]))
def test_rhythms_are_those_of_each_window_by_itself(repeats, length):
    fastest = 14.4
    periods = (14, int(min(52, 0.6 * length / repeats)))
    for name, x in signals(900).items():
        found = steps.rhythms(x, 10, length, repeats, periods, fastest, 1.5, 0.5)
        windows = np.lib.stride_tricks.sliding_window_view(x, length)[::10]
        expected = np.transpose([rhythm_of(w, repeats, periods, fastest) for w in windows])
        if name in ("zeros", "constant"):  # their rhythm is of rounding
            found, expected = found[2], expected[2]
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


def test_windows_that_are_not_finite_or_too_short_have_no_rhythm():
    x = signals(900)["walk"]
    x[450] = np.nan
    found = steps.rhythms(x, 10, 320, 2, (14, 52), 14.4, 1.5, 0.5)
    clean = np.arange(59) * 10 + 320 <= 450
    assert (found[0, clean] > 0.5).all()
    assert (found[:2, ~clean & (np.arange(59) * 10 <= 450)].T == [-1.0, 0.0]).all()
    assert (steps.rhythms(x, 10, 320, 2, (14, 15), 14.4, 1.5, 0.5)[:2].T == [-1.0, 0.0]).all()
    assert steps.rhythms(x[:99], 10, 99, 2, (14, 29), 14.4, 1.5, 0.5).shape == (3, 1)


@pytest.mark.parametrize("count", [0, 1, 5, 40])
@pytest.mark.parametrize(("ahead", "width"), [(0, 8), (4, 8), (24, 16)])
def test_the_strongest_window_is_the_best_of_those_a_hop_lies_in(count, ahead, width):
    found, first, hops = RNG.normal(size=(3, count)), 7, (3, 60)
    strongest = steps.strongest(found, first, hops, ahead, width).T
    for hop, row in zip(range(*hops), strongest, strict=True):
        last = min(hop, max(0, hop + ahead - width), first + count - 1)
        near = [w for w in range(count) if min(hop - 1 - width, last) <= first + w <= last]
        expected = found[:, max(near, key=lambda w: found[0, w])] if near else [-np.inf] * 3
        np.testing.assert_array_equal(row, expected)


@pytest.mark.parametrize(("n", "start"), [(1, 0), (31, 7), (32, 400), (33, 11), (200, 5)])
def test_points_are_filtered_by_the_bands_on_either_side_of_their_step_time(n, start):
    nodes, taps, hop = np.geomspace(0.36, 1.3, 8), 61, 10
    kernels = RNG.normal(size=(9, taps))
    spans = np.sort(RNG.integers(0, taps + 1, (9, 2)))
    at = np.arange(start, start + n) / hop - start // hop
    hops = RNG.uniform(0.2, 1.5, (3, int(at[-1]) + 2))
    known = np.array([np.interp(at, np.arange(hops.shape[1]), row) for row in hops])
    place = np.interp(known[1], nodes, np.arange(8))
    for up in signals(n + taps - 1).values():
        found = steps.step_bands(up, kernels, spans, nodes, hops, start, hop)
        np.testing.assert_allclose(found[2:], known, rtol=1e-12)
        windows = np.lib.stride_tricks.sliding_window_view(up, taps)
        counts = (spans[:, :1] <= np.arange(taps)) & (np.arange(taps) < spans[:, 1:])
        bands = windows @ np.where(counts, kernels, 0.0).T
        expected = [
            np.interp(p, np.arange(8), row) for p, row in zip(place, bands[:, :8], strict=True)
        ]
        np.testing.assert_allclose(found[0], expected, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(found[1], bands[:, 8], rtol=1e-9, atol=1e-9)


def rise_of(timed: np.ndarray, i: int, near: int, back: int, part: float) -> float:
    """Return where a signal reaches a part of its rise to the peak near a place."""
    first = max(0, i - near)
    top = first + int(timed[first : i + near + 1].argmax())
    first = max(0, top - back)
    low = first + int(timed[first : top + 1].argmin())
    level = timed[low] + part * (timed[top] - timed[low])
    if not level > timed[low]:
        return top
    before = low + int(np.flatnonzero(timed[low:top] <= level)[-1])
    return before + (level - timed[before]) / (timed[before + 1] - timed[before])


@pytest.mark.parametrize("rise", [0.0, 0.5])
def test_peaks_are_measured_as_one_by_one(rise):
    n, first, hz, near, reaches = 400, 1000, 40.0, 4, (1.2, 0.6, 1.0)
    for band in signals(n).values():
        timed, rhythm, usual = RNG.normal(size=n).cumsum(), RNG.random(n), RNG.random(n) - 0.1
        step_s = RNG.uniform(0.36, 1.3, n)
        points, last, expected = np.array([band, timed, rhythm, step_s, usual]), first + 60.0, []
        for i in range(53, n - 52):
            if not band[i - 1] < band[i] >= band[i + 1] or band[i] <= 0.1:
                continue
            span = [int(r * step_s[i] * hz) for r in reaches]
            a, b, c = band[i - 1 : i + 2]
            place = i + 0.5 * (a - c) / (a - 2 * b + c)
            if rise:
                place = rise_of(timed, i, near, round(reaches[1] * step_s[i] * hz), rise)
            last = max(last, first + place)
            swing = b - band[max(0, i - span[0]) : i + 1].min()
            higher = [i - k for k in range(i) if band[k] >= b]
            higher += [k - i for k in range(i + 1, n) if band[k] > b]
            away = min(higher, default=n)
            apart = min(1.0, away / hz / step_s[i]) if away <= span[2] else 1.0
            share = swing / usual[i] if usual[i] > 0 else 0.0
            expected.append((last, b, swing, share, apart, rhythm[i], step_s[i]))
        found = steps.peaks(
            points, first, (first + 53, first + n - 52), first + 60.0, 0.1, rise, hz, near, reaches
        )
        assert found.shape == (len(expected), 7)
        np.testing.assert_allclose(found, np.reshape(expected, (-1, 7)), rtol=1e-9)


@pytest.mark.parametrize("turning", [True, False])
@pytest.mark.parametrize("block", [1, 7, 300])
def test_gravity_is_what_filters_make_of_force_and_turns(turning, block):
    n, keep, keep_offset, gravity_s = 300, math.exp(-1 / 200), math.exp(-1 / 2000), 2.0
    force = RNG.normal(size=(3, n)) + np.array([[0.0], [0.0], [9.81]])
    rate = RNG.normal(size=(3, n))[: 3 * turning]

    def mean(x, kept):
        return lfilter([1 - kept], [1, -kept], x) / (1 - kept ** np.arange(1, x.shape[1] + 1))

    expected = mean(force, keep)
    if turning:
        turns = np.cross(expected, rate - mean(rate, keep_offset), axis=0)
        expected = expected + lfilter([1 - keep], [1, -keep], gravity_s * turns)
    state, parts = np.zeros((4, 3)), []
    for at in range(0, n, block):
        part = (np.ascontiguousarray(x[:, at : at + block]) for x in (force, rate))
        parts.append(axes.directions(*part, state, (keep, keep_offset, gravity_s)))
    np.testing.assert_allclose(np.concatenate(parts, axis=1), expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0)])
def test_accelerations_are_projected_on_the_axes_of_the_body(axis):
    force, gravity, nominal = RNG.normal(size=(3, 200)), RNG.normal(size=(3, 200)), np.array(axis)
    found = axes.resolved(force, gravity, nominal, 0.8)
    for f, g, row in zip(force.T, gravity.T, found.T, strict=True):
        size = np.linalg.norm(g)
        up = g / size
        ahead = np.roll(nominal, 1) if abs(nominal @ up) > 0.8 else nominal
        ahead = ahead - (ahead @ up) * up
        ahead /= np.linalg.norm(ahead)
        right = np.cross(ahead, up)
        np.testing.assert_allclose(row, [ahead @ f, right @ f, up @ f - size], atol=1e-9)


def test_a_sensor_that_falls_or_tells_nothing_has_axes_too():
    nothing, nominal = np.zeros((3, 4)), np.array([1.0, 0.0, 0.0])
    assert (axes.resolved(nothing, nothing, nominal, 0.8) == 0.0).all()
    assert np.isnan(axes.resolved(nothing + np.nan, nothing, nominal, 0.8)).all()


def top_of(x: np.ndarray, low: float, high: float) -> int | None:
    """Return the highest local maximum between two phases."""
    tops = [
        i for i in range(1, len(x) - 1) if low <= PHASE[i] <= high and x[i - 1] < x[i] >= x[i + 1]
    ]
    return max(tops, key=lambda i: x[i], default=None)


def stay(x: np.ndarray, level: float, i: int) -> tuple[int, int]:
    """Return first and last place of a signal's stay above a level around a place."""
    first = last = i
    while x[i] > level and first > 0 and x[first - 1] > level:
        first -= 1
    while x[i] > level and last < len(x) - 1 and x[last + 1] > level:
        last += 1
    return first, last


def slopes_of(x: np.ndarray, first: int, peak: int, last: int) -> float:
    """Return the logarithm of the fall's slope over the rise's."""
    rise = (x[peak] - x[first]) / max(peak - first, 1)
    fall = (x[peak] - x[last]) / max(last - peak, 1)
    return math.log(fall / rise) if rise > 0 and fall > 0 else 0.0


STRIPS = [
    np.array([scale * kind[k : k + len(PHASE)] for k, scale in ((0, 1.0), (40, 0.7), (9, 1.3))])
    for _ in range(8)
    for name, kind in signals(len(PHASE) + 40).items()
    if name not in ("zeros", "constant", "rounded")
]
NEAR = slice(CONTACT - 48, CONTACT + 49)


def test_frontal_patterns_are_those_found_place_by_place():
    for ahead, right, up in STRIPS:
        found = frontal(np.array([ahead, right, up]), None)
        level, top = up[CONTACT - POINTS : CONTACT + POINTS + 1].mean(), top_of(up, -0.35, 0.65)
        top = CONTACT if top is None else top
        own = stay(up, level, top)
        assert found.window == (own[1] - own[0]) / POINTS
        peak = top_of(ahead, PHASE[top] - 0.5, PHASE[top] + 0.5)
        if peak is None:
            assert (found.lead, found.density, found.slopes) == (0.0, 0.0, 0.0)
            continue
        assert found.lead == (top - peak) / POINTS
        earlier = next((i for i in range(own[0] - 1, -1, -1) if up[i] > level), None)
        later = next((i for i in range(own[1] + 1, len(up)) if up[i] > level), None)
        before = (0, own[0]) if earlier is None else stay(up, level, earlier)
        after = (own[1], len(up) - 1) if later is None else stay(up, level, later)
        rising, falling = (before, own) if peak <= top else (own, after)
        rising, falling = np.minimum(rising, peak), np.maximum(falling, peak)
        first = rising[0] + int(ahead[rising[0] : rising[1] + 1].argmin())
        last = falling[0] + int(ahead[falling[0] : falling[1] + 1].argmin())
        area = 0.5 * (ahead[peak] - 0.5 * (ahead[first] + ahead[last]))
        assert found.density == pytest.approx(area / np.ptp(up[NEAR]), rel=1e-9)
        assert found.slopes == pytest.approx(slopes_of(ahead, first, peak, last), abs=1e-9)


def test_lateral_patterns_are_those_found_place_by_place():
    for ahead, right, up in STRIPS:
        found = lateral(np.array([ahead, right, up]))
        n = len(right)
        turn = [right[max(0, i - POINTS) : i + POINTS + 1].mean() for i in range(n)]
        share = np.ptp((right - turn)[NEAR]) / math.sqrt(np.ptp(ahead[NEAR]) * np.ptp(up[NEAR]))
        assert found.share == pytest.approx(share, rel=1e-9)
        most = right.min() + 0.3 * np.ptp(right)
        minima = [i for i in range(1, n - 1) if right[i - 1] > right[i] <= min(right[i + 1], most)]
        first = max((i for i in minima if i <= CONTACT), default=0)
        last = min((i for i in minima if i > CONTACT), default=n - 1)
        peak = first + int(right[first : last + 1].argmax())
        if not any(i <= CONTACT for i in minima):
            first += int(right[first : peak + 1].argmin())
        if not any(i > CONTACT for i in minima):
            last = peak + int(right[peak : last + 1].argmin())
        slopes, length = slopes_of(right, first, peak, last), max(last - first, 1)
        assert found.slopes == pytest.approx(slopes, abs=1e-9)
        assert found.lobe == pytest.approx(abs((peak - first) / length - 0.5))
        assert found.inside == pytest.approx((1 if slopes > 0 else -1) * (CONTACT - peak) / length)


@pytest.mark.parametrize("value", [0.0, 1.3, np.nan])
def test_a_strip_without_movement_has_no_pattern(value):
    strip = np.full((3, len(PHASE)), value)
    found = frontal(strip, None)
    assert (found.lead, found.density, found.slopes) == (0.0, 0.0, 0.0)
    assert lateral(strip).slopes == 0.0


def test_windows_are_read_where_their_scale_puts_the_taps():
    rng = np.random.default_rng(4)
    nodes, taps = np.log([0.5, 1.0, 2.0]), np.array([-7.0, -1.0, 0.0, 2.0, 9.0])
    points, hops = rng.normal(size=(6, 60)), rng.uniform(-0.9, 0.9, 7)
    seen, scale = steps.scaled_windows(points, 20, (25, 75), hops, 2, 10, nodes, taps)
    for row, at in zip(seen, range(25, 75), strict=True):
        own = np.interp((at - 4.5) / 10 - 2, np.arange(7), hops)
        assert scale[at - 25] == pytest.approx(own)
        where = at + taps * np.exp(own) - 20
        for c in range(2):
            each = [np.interp(where, np.arange(60), points[2 * node + c]) for node in range(3)]
            mixed = [np.interp(own, nodes, column) for column in np.transpose(each)]
            np.testing.assert_allclose(row[5 * c : 5 * c + 5], mixed, atol=1e-12)


def test_scores_are_those_of_the_network():
    rng = np.random.default_rng(5)
    seen, hidden, usual = rng.normal(size=(40, 8)), rng.normal(size=(8, 5)), rng.normal(size=8)
    bias, out = rng.normal(size=5), rng.normal(size=5)
    found = steps.scores(seen, hidden, bias, out, usual, 0.3)
    np.testing.assert_allclose(found[0], np.tanh(seen @ hidden + bias) @ out + 0.3, atol=1e-3)
    for c in range(2):
        half = slice(4 * c, 4 * c + 4)
        share = seen[:, half] @ usual[half] / (usual[half] @ usual[half])
        np.testing.assert_allclose(found[1 + c], share)


def test_peaks_of_a_score_are_measured_as_one_by_one():
    rng = np.random.default_rng(6)
    odds = np.convolve(rng.normal(0, 4, 300), np.hanning(7) / 3, "same")
    step_s = rng.uniform(0.3, 1.0, 300)
    points = np.stack([odds, rng.normal(size=300), rng.normal(size=300), step_s])
    found = steps.score_peaks(points, 50, (60, 340), 0.1, 0.5, 40.0, (0.05, 0.02))
    score = 1 / (1 + np.exp(-odds))
    expected = []
    for i in range(10, 290):
        if not (odds[i] > odds[i - 1] and odds[i] >= odds[i + 1] and score[i] > 0.1):
            continue
        offset = np.argmax(np.polyval(np.polyfit([-1, 0, 1], odds[i - 1 : i + 2], 2),
                                      np.linspace(-0.5, 0.5, 2001)))  # fmt: skip
        reach = int(0.5 * step_s[i] * 40)
        far = [d for d in range(1, reach + 1) if odds[i - d] >= odds[i] or odds[i + d] > odds[i]]
        near = min(far) - 1 if far else reach
        own = np.arange(i - near, i + near + 1)
        late = (own - i - (offset / 2000 - 0.5)) / 40
        spread = np.average(late**2, weights=score[own])
        apart = min(0.5, min(far) / 40 / step_s[i]) if far else 0.5
        uncertain = np.sqrt(max(spread - 0.05**2, 0) + 0.02**2)
        expected.append((50 + i + offset / 2000 - 0.5, score[i], apart, *points[1:3, i],
                         uncertain, step_s[i]))  # fmt: skip
    assert len(found) == len(expected) > 20
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-3)
