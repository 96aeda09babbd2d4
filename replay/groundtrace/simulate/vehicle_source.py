"""What a vehicle does to the ground: noise of engine and tyres whose band moves, and engine orders.

Everything here is an analytic signal: its real part moves the ground up, its imaginary part is the
same a quarter of a period later, which a Rayleigh wave's horizontal motion and fading need.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Complex = NDArray[np.complex128]

#: By how much of itself the noise's band moves up and down.
WANDER = 0.15
#: Parts of the band that are damped each for itself, where the ground has loss: the mean power is
#: within 3 % of an integral's, as long as the loss takes less than 20 dB.
PARTS = 16
#: Frames before time 0 that may be asked for: a seed is never negative.
BEFORE = 1 << 20
_EDGE = 0.2  # of the band's width, over which it begins and ends
_ORDERS = np.array([0.5, 0.25, 0.15, 0.1])  # parts of the engine's power at multiples of its rate
_SWING_S, _SWING = 7.0, 0.02  # by what part the engine's rate swings, and how slowly
_SIDE, _ROWS = 16, 1024  # samples on either side of a place between two; places between two
_TAPS = np.arange(1 - _SIDE, _SIDE + 1)


@dataclass(slots=True, eq=False)
class Frames:
    """Noise of any length out of frames of two seconds that overlap by half.

    Frames are independent and fade in and out by a sine, so that powers add up to a constant, and
    each is drawn by its number: any piece can be had in any order.

    Attributes
    ----------
    hop
        Samples from frame to frame; a frame has twice as many.
    draw
        Returns frame ``number`` of the noise, shape (2 hop, n_columns).
    """

    hop: int
    draw: Callable[[int], NDArray[np.complex128]]
    _kept: dict[int, Complex] = field(default_factory=dict, init=False)

    def samples(self, first: int, count: int) -> Complex:
        """Return ``count`` samples from sample ``first``, which may be negative."""
        low, high = first // self.hop - 1, (first + count - 1) // self.hop
        frames = {
            k: self._kept[k] if k in self._kept else self._faded(k) for k in range(low, high + 1)
        }
        self._kept = frames
        columns = frames[low].shape[1]
        total = np.zeros(((high - low + 2) * self.hop, columns), np.complex128)
        for k, frame in frames.items():
            total[(k - low) * self.hop : (k - low + 2) * self.hop] += frame
        start = first - low * self.hop
        return total[start : start + count]

    def _faded(self, number: int) -> Complex:
        fade = np.sin(np.pi * (np.arange(2 * self.hop) + 0.5) / (2 * self.hop))
        return self.draw(number) * fade[:, None]


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """A vehicle's noise of unit power, in parts by frequency.

    Attributes
    ----------
    rate_hz
        Of its samples.
    band_hz
        Lower and upper edge, at half its power.
    parts
        Parts of the band.
    engine_hz
        Rate of the engine's firing, or None for a vehicle without tones.
    engine_share
        Part of the power that is the engine's tones.
    seed
        Of this vehicle.
    """

    rate_hz: float
    band_hz: tuple[float, float]
    parts: int
    engine_hz: float | None
    engine_share: float
    seed: tuple[int, ...]

    def frequencies_hz(self) -> Array:
        """Return the frequency that stands for each part, tones last, shape (n,)."""
        edges = self._edges()
        parts: Array = np.append((edges[1:] + edges[:-1]) / 2, self._tones_hz())
        return parts

    def frames(self) -> Frames:
        """Return the noise of the band, one column a part; tones are not in it."""
        return Frames(round(self.rate_hz), self._frame)

    def tones(self, time_s: Array) -> Complex:
        """Return the engine's tones at times, shape (len(time_s), n_tones)."""
        tones_hz = self._tones_hz()
        if not len(tones_hz):
            return np.empty((len(time_s), 0), np.complex128)
        phase = np.random.default_rng([*self.seed, 1]).uniform(0, 2 * np.pi, len(tones_hz) + 1)
        swing = _SWING * _SWING_S * np.sin(2 * np.pi * time_s / _SWING_S + phase[-1]) / (2 * np.pi)
        turns = np.multiply.outer(time_s + swing, tones_hz)
        share = _ORDERS[: len(tones_hz)] / _ORDERS[: len(tones_hz)].sum()
        amplitude = np.sqrt(2 * self.engine_share * share)
        tones: Complex = amplitude * np.exp(2j * np.pi * turns + 1j * phase[:-1])
        return tones

    def _tones_hz(self) -> Array:
        if self.engine_hz is None:
            return np.empty(0)
        tones: Array = self.engine_hz * np.arange(1, len(_ORDERS) + 1, dtype=np.float64)
        return tones[tones <= 0.35 * self.rate_hz]

    def _edges(self) -> Array:
        low, high = self.band_hz
        edge = _EDGE * (high - low) / 2
        lowest, highest = (low - edge) * (1 - WANDER), (high + edge) * (1 + WANDER)
        edges: Array = np.linspace(lowest, highest, self.parts + 1)
        return edges

    def _frame(self, number: int) -> Complex:
        rng = np.random.default_rng([*self.seed, 0, number + BEFORE])
        count = 2 * round(self.rate_hz)
        f = np.arange(count // 2) * self.rate_hz / count
        density = band(f / rng.uniform(1 - WANDER, 1 + WANDER), *self.band_hz)
        noise = 1.0 - (self.engine_share if len(self._tones_hz()) else 0.0)
        density *= noise / density.sum()
        drawn = rng.standard_normal((2, len(f)))
        line = np.sqrt(density) * (drawn[0] + 1j * drawn[1])
        part = np.clip(np.searchsorted(self._edges(), f, side="right") - 1, 0, self.parts - 1)
        spectrum = np.zeros((count, self.parts), np.complex128)
        spectrum[np.arange(len(f)), part] = line
        frame: Complex = np.fft.ifft(spectrum, axis=0) * count
        return frame


def band(frequency_hz: Array, low_hz: float, high_hz: float) -> Array:
    """Return a density of power: 1 in a band, falling by a cosine over a fifth of its width."""
    edge = _EDGE * (high_hz - low_hz)
    rise = np.clip((frequency_hz - low_hz) / edge + 0.5, 0, 1)
    fall = np.clip((high_hz - frequency_hz) / edge + 0.5, 0, 1)
    density: Array = np.sin(np.pi / 2 * rise) ** 2 * np.sin(np.pi / 2 * fall) ** 2
    return density


def between(samples: Complex, position: Array) -> Complex:
    """Return band-limited samples at positions between them.

    A sinc under a Blackman window of 32 samples: 1e-3 of the amplitude off at most, up to 0.4 of
    the sampling rate.

    Parameters
    ----------
    samples
        Shape (n, n_columns).
    position
        In samples, each :func:`margin` at least from either end; any shape.

    Returns
    -------
    Shape (..., n_columns).
    """
    whole = np.floor(position).astype(np.intp)
    row = (position - whole) * _ROWS
    before = row.astype(np.intp)
    part = (row - before)[..., None]
    weight = (1 - part) * _weights()[before] + part * _weights()[before + 1]
    near = samples[whole[..., None] + _TAPS]
    found: Complex = np.einsum("...k,...kp->...p", weight, near)
    return found


@lru_cache
def _weights() -> Array:
    """Return the weights of samples, a row for each place between two, shape (rows + 1, 32)."""
    off = np.arange(_ROWS + 1)[:, None] / _ROWS - _TAPS
    turn = np.pi * off / _SIDE
    weights: Array = np.sinc(off) * (0.42 + 0.5 * np.cos(turn) + 0.08 * np.cos(2 * turn))
    return weights


def margin() -> int:
    """Return how many samples :func:`between` needs on either side."""
    return _SIDE + 1
