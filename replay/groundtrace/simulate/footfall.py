"""Footfalls: the force of a step on the floor, and the arrival of its wave at a sensor."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..localizers.wave_physics import Impact, Synthesis, WaveMedium

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Shoe:
    """What the foot strikes the floor with.

    Attributes
    ----------
    heel
        Forces at the heel's contact: the body's push, the shoe's spring, the click of the sole.
    toe
        Forces of the ball of the foot, about 100 ms later (thesis, section 3.2, after Ekimov and
        Sabatier).
    """

    heel: tuple[Impact, ...]
    toe: tuple[Impact, ...]


#: A shoe with a hard heel. Thesis, section 3.2: a step's signal lasts less than 200 ms, most of it
#: below 500 Hz, some above 1 kHz.
HEEL = Shoe(
    (Impact(120.0, 110.0, 0.005), Impact(120.0, 240.0, 0.003), Impact(90.0, 480.0, 0.0015)),
    (Impact(28.0, 80.0, 0.006), Impact(14.0, 160.0, 0.004)),
)
#: A bare foot or a sock: its skin is the spring, a third as hard; it neither clicks nor slaps.
BARE = Shoe(
    (Impact(50.0, 60.0, 0.008), Impact(45.0, 120.0, 0.005), Impact(12.0, 240.0, 0.003)),
    (Impact(22.0, 55.0, 0.008),),
)
#: Shoes by name; ``mixed`` is each step one or the other.
SHOES = {"heel": (HEEL,), "bare": (BARE,), "mixed": (HEEL, BARE)}


@dataclass(frozen=True, slots=True)
class Footfall:
    """How one step differs from the mean step.

    Attributes
    ----------
    strength
        Factor of all forces.
    hardness
        Factor of all frequencies.
    toe
        Factor of the forefoot's force.
    toe_delay_s
        From heel to forefoot [s].
    shoe
        What the foot wears.
    """

    strength: float = 1.0
    hardness: float = 1.0
    toe: float = 1.0
    toe_delay_s: float = 0.11
    shoe: Shoe = HEEL

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Footfall:
        """Draw a step."""
        return cls(
            strength=rng.uniform(0.85, 1.15),
            hardness=rng.uniform(0.92, 1.08),
            toe=rng.uniform(0.6, 1.3),
            toe_delay_s=rng.uniform(0.09, 0.13),
        )

    def spectrum(self, frequency_hz: NDArray[np.float64]) -> NDArray[np.complex128]:
        """Return the force's spectrum [N s], shape (n_frequencies,)."""
        total = np.zeros(frequency_hz.shape, np.complex128)
        toe = (self.shoe.toe, self.toe, self.toe_delay_s)
        for impacts, factor, delay_s in ((self.shoe.heel, 1.0, 0.0), toe):
            for impact in impacts:
                drawn = replace(
                    impact,
                    peak_n=impact.peak_n * self.strength * factor,
                    frequency_hz=impact.frequency_hz * self.hardness,
                    delay_s=delay_s,
                )
                total += drawn.spectrum(frequency_hz)
        return total


@dataclass(frozen=True, slots=True)
class ArrivalLaw:
    """When the wave of a mean step is seen, after the step: t0 + k d^p.

    A sensor is said to see it when the noise-free velocity first exceeds 5 % of its maximum: near
    the noise of a far sensor of the default recording, so about what a picker can find. The wave
    of a plate grows out of nothing by ever larger and slower swings, so that this instant jumps by
    half a swing at some distances (+-0.1 ms for a heel, +-0.3 ms for a bare foot). The law is its
    least-squares fit from 0.3 m to the site's diagonal, 8 m at least, and grows strictly with
    distance. A front that does not disperse has the exponent 1, equation (4.24) 4/3; it is looked
    for from 0.9 to 1.5. The law is that of floor and shoe alone: walls, mountings and a recorder
    that cuts the band do not move the truth.

    Attributes
    ----------
    offset_s, factor, exponent
        t0 [s], k [s / m^p], p.
    peak_mps
        Maximum of the mean step's velocity at 1 m [m/s].
    velocity_mps
        1/slope of the best straight line, the velocity a calibration on site would give.
    theta_s
        theta of (4.24) where the exponent is held at 4/3.
    """

    offset_s: float
    factor: float
    exponent: float
    peak_mps: float
    velocity_mps: float
    theta_s: float

    @classmethod
    def of(cls, plate: WaveMedium, shoe: Shoe = HEEL, reach_m: float = 8.0) -> ArrivalLaw:
        """Simulate the mean step at many distances up to ``reach_m`` and fit the law."""
        distance = np.arange(0.3, max(reach_m, 8.0), 0.05)
        synthesis = Synthesis.lasting(plate, 20_000.0, 0.08 * distance[-1] / 7.95)
        force = Footfall(toe=0.0, shoe=shoe).spectrum(synthesis.frequency_hz) * synthesis.sensor()
        velocity = np.abs(synthesis.waveforms(distance, force))
        peak = velocity.max(axis=1, keepdims=True)
        onset = np.argmax(velocity > 0.05 * peak, axis=1) / synthesis.rate_hz
        fits = [_fit(distance**p, onset) for p in np.arange(0.9, 1.5, 0.01)]
        best = int(np.argmin([residual for _, _, residual in fits]))
        _, straight, _ = _fit(distance, onset)
        _, slope, _ = _fit(distance ** (4 / 3), onset)
        return cls(
            offset_s=fits[best][0],
            factor=fits[best][1],
            exponent=0.9 + 0.01 * best,
            peak_mps=_rounded(float(np.interp(1.0, distance, peak[:, 0]))),
            velocity_mps=_rounded(1 / straight),
            theta_s=_rounded(8 * plate.dispersion_m2s**2 * slope**3),
        )

    def __call__(self, distance_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the arrival after the step [s], the shape of ``distance_m``."""
        return self.offset_s + self.factor * distance_m**self.exponent


def _rounded(value: float) -> float:
    """Return three significant digits: the same on every processor."""
    return float(f"{value:.3g}")


def _fit(
    abscissa: NDArray[np.float64], ordinate: NDArray[np.float64]
) -> tuple[float, float, float]:
    """Return offset, slope and the sum of squared residuals of the best straight line."""
    slope, offset = np.polyfit(abscissa, ordinate, 1)
    residual = ordinate - offset - slope * abscissa
    return float(offset), float(slope), float(residual @ residual)
