"""Delays between all pairs of channels, and the arrivals that agree best with them.

Source: generalised cross-correlation with phase transform (Knapp and Carter 1976): spectra of unit
modulus, so that neither what the source sends nor what a wall adds at some frequencies outweighs
the rest. Two things are changed. A frequency counts as much as it stands out of the noise before
the step (Wiener's weight); and since bending waves disperse (k proportional to sqrt(w) in a slab:
thesis on locating people by seismic waves, equation (4.3)), the phase of a delay is not w tau but

    u(w) tau,   u(w) = (w_0 / q) (w / w_0)^q,

with q = 1/2 for a slab and q = 1 without dispersion: tau is the difference of group delays at the
reference frequency w_0, and grows in proportion to the difference of distances.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Spectra = NDArray[np.complex128]

#: Frequency at which delays are given [Hz].
REFERENCE_HZ = 100.0
#: Noise spectra are averaged over so much [Hz] and, since spectra scatter, taken so many times; the
#: samples of a window's ends fade over [s].
SMOOTH_HZ, NOISE_FACTOR, FADE_S = 150.0, 2.0, 0.003
#: Points of the search per shortest period, passes of reweighting, and the misfit that halves a
#: pair's weight [s].
POINTS, PASSES, MISFIT_S = 8.0, 12, 6e-4


@dataclass(frozen=True, slots=True, eq=False)
class Delays:
    """What all pairs of channels say.

    Attributes
    ----------
    first, second
        The channels of each pair, shape (n_pairs,).
    delay_s
        How much later the first hears it, shape (n_pairs,) [s].
    height
        Of the correlation there, shape (n_pairs,): 1 is perfect, noise gives about 0.2.
    weight
        What the pair counts, shape (n_pairs,).
    """

    first: NDArray[np.intp]
    second: NDArray[np.intp]
    delay_s: Array
    height: Array
    weight: Array


@dataclass(frozen=True, slots=True, eq=False)
class Band:
    """The frequencies that are compared, and how fast their phases turn.

    Attributes
    ----------
    samples
        Length of the transform.
    rows
        Which of its frequencies, shape (n_frequencies,).
    turn
        u of each, shape (n_frequencies,) [rad/s].
    share
        What each counts, shape (n_frequencies,): evenly over u.
    spread
        Over how many frequencies noise spectra are averaged.
    """

    samples: int
    rows: NDArray[np.intp]
    turn: Array
    share: Array
    spread: int

    @classmethod
    def of(cls, length: int, rate_hz: float, low_hz: float, high_hz: float, power: float) -> Band:
        """Return the band of windows of ``length`` samples; ``power`` is q."""
        samples = 1 << int(np.ceil(np.log2(2 * length)))
        frequency = np.arange(samples // 2 + 1, dtype=np.float64) * (rate_hz / samples)
        rows = np.flatnonzero((frequency >= max(low_hz, 1e-9)) & (frequency <= high_hz))
        reference = 2 * np.pi * REFERENCE_HZ
        turn = reference / power * (frequency[rows] / REFERENCE_HZ) ** power
        share = (frequency[rows] / REFERENCE_HZ) ** (power - 1)
        return cls(samples, rows, turn, share, max(1, round(SMOOTH_HZ * samples / rate_hz)))

    def spectra(self, values: Array, rate_hz: float) -> Spectra:
        """Return the spectra of signals of shape (n, n_channels), shape (n_channels, n_f)."""
        planar = np.ascontiguousarray(values.T)
        faded = (planar - planar.mean(axis=1, keepdims=True)) * _fade(len(values), rate_hz)
        low, high = int(self.rows[0]), int(self.rows[-1]) + 1
        return np.ascontiguousarray(np.fft.rfft(faded, self.samples, axis=1)[:, low:high])

    def advance(self, late_s: Array, rate_hz: float) -> Spectra:
        """Return what spectra of channels times this are earlier by times, shape (n, n_f)."""
        omega = 2 * np.pi * rate_hz / self.samples * self.rows
        return np.asarray(np.exp(1j * np.multiply.outer(late_s, omega)))

    def whitened(self, values: Array, noise: Array, rate_hz: float) -> Spectra:
        """Return spectra whose squared moduli are what each frequency counts.

        Parameters
        ----------
        values, noise
            Signal with a step, and without, shapes (n, n_channels) and (m, n_channels).
        rate_hz
            Sampling rate.
        """
        signal = self.spectra(values, rate_hz)
        power = np.abs(signal) ** 2
        still = np.abs(self.spectra(noise, rate_hz)) ** 2 * len(values) / max(len(noise), 1)
        level = NOISE_FACTOR * _averaged(still, self.spread)
        with np.errstate(divide="ignore", invalid="ignore"):
            wiener = np.nan_to_num(np.maximum(1 - level / power, 0), nan=0.0)
            unit = np.nan_to_num(signal / np.sqrt(power), nan=0.0, posinf=0.0, neginf=0.0)
        return np.asarray(unit * np.sqrt(wiener * self.share))


def _fade(length: int, rate_hz: float) -> Array:
    """Return weights that rise and fall at the ends, shape (length,)."""
    edge = min(round(FADE_S * rate_hz), length // 2)
    rise = 0.5 - 0.5 * np.cos(np.pi * (np.arange(edge) + 0.5) / max(edge, 1))
    return np.concatenate([rise, np.ones(length - 2 * edge), rise[::-1]])


def _averaged(power: Array, spread: int) -> Array:
    """Return running means over ``spread`` frequencies, shorter at the ends."""
    width = min(spread, power.shape[1])
    total = np.cumsum(np.pad(power, ((0, 0), (1, 0))), axis=1)
    index = np.arange(power.shape[1])
    low = np.clip(index - width // 2, 0, None)
    high = np.clip(index + width // 2 + 1, None, power.shape[1])
    return np.asarray((total[:, high] - total[:, low]) / (high - low))


def correlated(white: Spectra, band: Band, farthest_s: Array) -> Delays:
    """Return the delay of every pair of channels.

    Parameters
    ----------
    white
        As :meth:`Band.whitened` gives them, shape (n_channels, n_frequencies).
    band
        Theirs.
    farthest_s
        Longest delay of each pair, shape (n_channels, n_channels) [s].
    """
    first, second = np.triu_indices(len(white), 1)
    limit = farthest_s[first, second]
    step = 2 * np.pi / (POINTS * band.turn[-1])
    reach = int(np.ceil(limit.max() / step)) + 1
    grid = np.arange(-reach, reach + 1) * step
    mass = (np.abs(white) ** 2).sum(axis=1)
    scale = np.sqrt(mass[first] * mass[second])
    rows = _steered(white[first] * np.conj(white[second]), band.turn, step, reach)
    allowed = np.abs(grid) <= limit[:, None] + step
    best = np.where(allowed, rows, -np.inf).argmax(axis=1)
    place, top = _refined(rows, best)
    height = np.divide(top, scale, out=np.zeros_like(top), where=scale > 0)
    return Delays(first, second, (place - reach) * step, height, np.maximum(top, 0) * height)


def _steered(cross: Spectra, turn: Array, step_s: float, reach: int) -> Array:
    """Return the correlations at ``2 reach + 1`` delays, ``step_s`` apart, shape (n_pairs, n)."""
    # of delays d and -d the cosines are the same and the sines opposite: half the products do
    cosine, sine = _waves(turn.tobytes(), step_s, 1 << reach.bit_length())
    even = np.ascontiguousarray(cross.real) @ cosine[:, : reach + 1]
    odd = np.ascontiguousarray(cross.imag) @ sine[:, : reach + 1]
    return np.concatenate([(even + odd)[:, :0:-1], even - odd], axis=1)


@lru_cache(maxsize=8)
def _waves(turn: bytes, step_s: float, reach: int) -> tuple[Array, Array]:
    """Return cosine and sine of every frequency's phase at delays from 0 on: those used last."""
    phase = np.multiply.outer(np.frombuffer(turn), np.arange(reach + 1) * step_s)
    return np.cos(phase), np.sin(phase)


def _refined(rows: Array, best: NDArray[np.intp]) -> tuple[Array, Array]:
    """Return place and height of the parabola through each peak and its neighbours."""
    middle = np.clip(best, 1, rows.shape[1] - 2)
    each = np.arange(len(rows))
    before, at, after = (rows[each, middle + k] for k in (-1, 0, 1))
    bend = before - 2 * at + after
    offset = np.divide(before - after, 2 * bend, out=np.zeros_like(at), where=bend < 0)
    offset = np.clip(offset, -1, 1)
    return np.asarray(middle + offset, np.float64), at - (before - after) * offset / 4


def consistent(delays: Delays, channels: int) -> tuple[Array, Array]:
    """Return the arrivals that agree best with the delays, and what each pair is off.

    Least squares with weights that fall with the misfit (Cauchy's), so that pairs locked on to an
    echo count little.

    Returns
    -------
    Shape (n_channels,), of mean 0, and shape (n_pairs,) [s].
    """
    best = max(float(delays.weight.max(initial=0.0)), 1e-300)
    weight = _square(delays, (delays.weight + 1e-9 * best) / (best + 1e-9 * best), channels, 1)
    late = _square(delays, delays.delay_s, channels, -1)
    arrivals, trust = np.zeros(channels), np.ones_like(late)
    diagonal, pairs = np.arange(channels), 2 * len(delays.first)
    for _ in range(PASSES):
        share = weight * trust
        # the normal equations of all pairs; their one freedom is taken by a mean of 0
        normal = share.sum() / pairs - share
        normal[diagonal, diagonal] += share.sum(axis=1)
        arrivals = np.linalg.solve(normal, (share * late).sum(axis=1))
        trust = 1 / (1 + ((arrivals[:, None] - arrivals - late) / MISFIT_S) ** 2)
    return arrivals, arrivals[delays.first] - arrivals[delays.second] - delays.delay_s


def _square(delays: Delays, of_pair: Array, channels: int, sign: int) -> Array:
    """Return a value of each pair as a matrix of all channels: ``sign`` times it the other way."""
    out = np.zeros((channels, channels))
    out[delays.first, delays.second] = of_pair
    out[delays.second, delays.first] = sign * of_pair
    return out


def by_channel(delays: Delays, of_pair: Array, channels: int) -> Array:
    """Return the values of all pairs that each channel is in, shape (n_channels, n_channels - 1).

    They must not depend on which channel of a pair is the first.
    """
    others = ~np.eye(channels, dtype=np.bool_)
    return _square(delays, of_pair, channels, 1)[others].reshape(channels, channels - 1)
