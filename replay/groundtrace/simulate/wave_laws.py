"""Waves of floors and grounds that are no concrete slab: the law is an option, not a presumption.

A surface wave whose phase velocity is c = c_100 (f / 100 Hz)^n: n = 1/2 as in a slab, 0.3 as in
boards on joists, 0 without dispersion, -0.3 on ground that is harder further down. In layered
ground a faster, weaker wave runs along the harder layer below and overtakes the surface wave beyond
a distance. What localizers presume of waves is not known here.

Far from the force a surface wave spreads over a circle and falls with the root of distance; it
loses a part 1 / Q of its energy in every radian, so that high frequencies die out first. Source:
the head wave's delay is that of refraction seismics, t = r / c_2 + 2 h sqrt(1 / c_1^2 - 1 / c_2^2)
(Telford, Geldart and Sheriff: Applied Geophysics, 1990, chapter 4); it falls with the square of
distance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Spectra = NDArray[np.complex128]

LawName = Literal["plate", "f0.5", "f0.3", "f0", "f-0.3", "layered"]
#: Exponent n of each law's surface wave. Chosen by judgement: those that floors and grounds have
#: between the slab's and that of ground that hardens with depth.
EXPONENTS = {"f0.5": 0.5, "f0.3": 0.3, "f0": 0.0, "f-0.3": -0.3, "layered": -0.3}
#: Frequency at which speeds are given [Hz]; and where the lowest and highest frequencies stop to
#: disperse [Hz]. Chosen by judgement: a footstep's band.
REFERENCE_HZ, BAND_HZ = 100.0, (20.0, 2000.0)
#: Velocity over force at 1 m and 100 Hz [m/(N s)]; it grows with the root of frequency. Chosen by
#: judgement: about what the slab of 0.2 m has.
MOBILITY_MNS = 1.5e-6
#: Head wave over surface wave at 1 m. Chosen by judgement: weak, yet over the noise.
HEAD = 0.5


@dataclass(frozen=True, slots=True)
class Ground:
    """A floor by its wave law; in the place of a slab.

    Attributes
    ----------
    speed_mps
        Phase velocity of the surface wave at 100 Hz [m/s].
    exponent
        n of its dispersion.
    quality
        Q of its loss.
    below_mps, depth_m
        Velocity of the layer below [m/s] and how deep it begins [m]; 0 where there is none.
    """

    speed_mps: float
    exponent: float
    quality: float = 30.0
    below_mps: float = 0.0
    depth_m: float = 0.0

    def velocity_mps(self, frequency_hz: Array) -> Array:
        """Return the phase velocity of the surface wave, shape (n_frequencies,) [m/s]."""
        ratio = np.clip(frequency_hz, *BAND_HZ) / REFERENCE_HZ
        velocity: Array = self.speed_mps * ratio**self.exponent
        return velocity

    @property
    def slowest_mps(self) -> float:
        """Group velocity of what is slowest [m/s]: c / (1 - n)."""
        ends = self.velocity_mps(np.array(BAND_HZ)) / (1 - self.exponent)
        return float(ends.min())

    def response(self, distance_m: Array, frequency_hz: Array) -> Spectra:
        """Return velocity over force [m/(N s)], as :meth:`.wave_physics.Plate.response`."""
        wavenumber = 2 * np.pi * frequency_hz / self.velocity_mps(frequency_hz)
        phase = np.multiply.outer(distance_m, wavenumber)
        spread = 1 / np.sqrt(1 + np.pi / 2 * phase)
        near = np.sqrt(1 + np.pi / 2 * 2 * np.pi * REFERENCE_HZ / self.speed_mps)  # at 1 m
        rise = np.sqrt(np.maximum(frequency_hz, 0.0) / REFERENCE_HZ)
        loss = np.exp(-phase / (2 * self.quality))
        wave: Spectra = MOBILITY_MNS * near * rise * spread * loss * np.exp(-1j * phase)
        return wave + self._head(distance_m, frequency_hz) if self.below_mps else wave

    def _head(self, distance_m: Array, frequency_hz: Array) -> Spectra:
        """Return what the layer below brings."""
        slow, fast = self.speed_mps, self.below_mps
        delay_s = 2 * self.depth_m * np.sqrt(max(1 / slow**2 - 1 / fast**2, 0.0))
        # nearer than this no ray comes back from below at the critical angle
        nearest_m = 2 * self.depth_m * slow / np.sqrt(max(fast**2 - slow**2, 1e-9))
        reaches = distance_m / np.maximum(distance_m, 1.0) ** 3
        reaches *= 1 / (1 + np.exp(-(distance_m - nearest_m) / 0.1))
        rise = np.sqrt(np.maximum(frequency_hz, 0.0) / REFERENCE_HZ)
        phasors = np.exp(-2j * np.pi * np.outer(distance_m / fast + delay_s, frequency_hz))
        wave: Spectra = MOBILITY_MNS * HEAD * reaches[:, None] * rise * phasors
        return wave

    def radial(self, distance_m: Array, frequency_hz: Array, lever_m: float) -> Spectra:
        """Return the horizontal velocity over force, a quarter of a period ahead: retrograde.

        As :meth:`.wave_physics.Plate.radial`; the lever is that of a slab, and a Rayleigh wave's
        horizontal part is about as large at any frequency.
        """
        reach = lever_m * 2 * np.pi * REFERENCE_HZ / self.speed_mps
        return 1j * reach * self.response(distance_m, frequency_hz)

    @property
    def dispersion_m2s(self) -> float:
        """Dispersion constant of the slab with the same velocity at 100 Hz [m2/s]."""
        return self.speed_mps**2 / (2 * np.pi * REFERENCE_HZ)


#: Speeds [m/s], Q, the velocity below over that above, and the depth [m] of a law that is drawn.
#: Chosen by judgement: floors of houses and dry ground, a wave no slower than crosses a room while
#: the picks of a step are collected.
SPEEDS_MPS, QUALITIES, BELOW, DEPTHS_M = (250.0, 700.0), (15.0, 60.0), (2.0, 4.0), (0.3, 1.5)


def ground_of(law: LawName, seed: int, speed_mps: float | None = None) -> Ground:
    """Return the ground of a law; what is open is drawn from the seed.

    Raises
    ------
    KeyError
        For ``plate``, which is none.
    """
    rng = np.random.default_rng([seed, 11])
    drawn_mps = float(np.exp(rng.uniform(*np.log(SPEEDS_MPS))))
    quality, ratio, depth_m = (float(rng.uniform(*x)) for x in (QUALITIES, BELOW, DEPTHS_M))
    speed = speed_mps or drawn_mps
    below = (ratio * speed, depth_m) if law == "layered" else (0.0, 0.0)
    return Ground(round(speed, 1), EXPONENTS[law], round(quality, 1), *below)


#: Length over which slowness differs [m]. Chosen by judgement: a joist's bay or a patch of screed
#: is as large.
UNEVEN_M = 2.0
#: Step of the lattice on which slowness is drawn [m], and points of a path that are looked up.
#: Chosen by judgement: an eighth of that length; a path of 10 m has four a metre.
_LATTICE_M, _POINTS = 0.25, 40
#: A smooth field reaches over so many of its lengths. Source: its Gaussian there is below 1e-3.
_REACH = 4


@dataclass(frozen=True, slots=True, eq=False)
class UnevenFloor:
    """A floor that is faster here than there: waves run straight, some ways as if they were longer.

    Attributes
    ----------
    low, high
        Corners of the rectangle that it is told of, shape (2,) each [m]; beyond, it is mirrored, as
        walls mirror what runs there.
    slowness
        Over that of an even floor, on a lattice from ``low`` on, shape (n, m).
    """

    low: Array
    high: Array
    slowness: Array

    @classmethod
    def drawn(
        cls, low: Array, high: Array, part: float, over_m: float, rng: np.random.Generator
    ) -> UnevenFloor:
        """Draw a smooth random field.

        Parameters
        ----------
        low, high
            Of the floor.
        part
            Standard deviation of the slowness's logarithm.
        over_m
            Length over which it differs [m].
        rng
            What to draw from.
        """
        if not part:
            return cls(low, high, np.ones((1, 1)))
        count = np.ceil((high - low) / _LATTICE_M).astype(int) + 1
        margin = round(_REACH * over_m / _LATTICE_M)
        white = rng.standard_normal(tuple(count + 2 * margin))
        frequency = [np.fft.fftfreq(n) for n in white.shape]
        reach = np.hypot.outer(*frequency) * over_m / _LATTICE_M
        smooth = np.fft.ifft2(np.fft.fft2(white) * np.exp(-2 * (np.pi * reach) ** 2)).real
        inside = smooth[margin:-margin, margin:-margin]
        return cls(low, high, np.exp(part * (inside - inside.mean()) / inside.std()))

    @property
    def most(self) -> float:
        """By what factor a path is longer at most."""
        return float(self.slowness.max())

    def lengths_m(self, source: Array, places: Array) -> Array:
        """Return how long the ways from a source to places are for waves, shape (n,) [m]."""
        length_m: Array = np.hypot(*(places - source).T)
        if self.slowness.size == 1:
            return length_m
        along = ((np.arange(_POINTS) + 0.5) / _POINTS)[:, None, None]
        inside = (source + (places - source) * along - self.low) % (2 * (self.high - self.low))
        inside = np.minimum(inside, 2 * (self.high - self.low) - inside)
        row, column = (inside / _LATTICE_M).astype(int).T
        mean: Array = self.slowness[row, column].mean(axis=1)
        return length_m * mean
