"""Bending waves of a thin plate: what a sensor on a concrete floor sees of a force on it.

The floor is an infinite Kirchhoff plate, equation (4.2) of the thesis on locating people by seismic
waves: dispersive (high frequencies run ahead), without reflections. The displacement of the plate
at a distance r from a harmonic point force is the classical Green's function

    W(r, w) = F(w) i / (8 D k^2) [H0(k r) - H0(i k r)],   k = sqrt(w / a) (1 + i theta w / 4)

with H0 the Hankel function of the first kind for exp(-i w t), a = sqrt(D / (rho h)) and the small
loss of equation (4.5). Since D k^2 = w sqrt(D rho h), the velocity is the force times the
drive-point mobility 1 / (8 sqrt(D rho h)) times a function of k r alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

_STEP = 0.01  # of the table over k r: the phase turns 0.01 rad between two entries
_TOP = 1600.0  # end of that table: 3 kHz at 157 m on the default plate


@dataclass(frozen=True, slots=True)
class Plate:
    """A homogeneous slab; the defaults are the thesis's concrete (section 4.2).

    Attributes
    ----------
    thickness_m
        h [m].
    young_pa
        Young's modulus E [Pa].
    density_kgm3
        rho [kg/m3].
    poisson
        Poisson's ratio.
    loss_s
        theta of the Kelvin-Voigt loss, loss factor = theta w [s].
    """

    thickness_m: float = 0.2
    young_pa: float = 24e9
    density_kgm3: float = 2500.0
    poisson: float = 0.2
    loss_s: float = 1e-5

    @property
    def rigidity_nm(self) -> float:
        """Bending rigidity D = E h^3 / (12 (1 - poisson^2)) [N m], under (4.1)."""
        return self.young_pa * self.thickness_m**3 / (12 * (1 - self.poisson**2))

    @property
    def dispersion_m2s(self) -> float:
        """Dispersion constant a = sqrt(D / (rho h)) [m2/s], under (4.3); 183 for the defaults."""
        return float(np.sqrt(self.rigidity_nm / (self.density_kgm3 * self.thickness_m)))

    @property
    def mobility_mns(self) -> float:
        """Velocity at the force over the force, 1 / (8 sqrt(D rho h)) [m/(N s)]."""
        return float(1 / (8 * np.sqrt(self.rigidity_nm * self.density_kgm3 * self.thickness_m)))

    def response(
        self, distance_m: NDArray[np.float64], frequency_hz: NDArray[np.float64]
    ) -> NDArray[np.complex128]:
        """Return velocity over force [m/(N s)] for numpy's sign of time, exp(+i w t).

        Parameters
        ----------
        distance_m
            Shape (n_places,), from 0.
        frequency_hz
            Shape (n_frequencies,), from 0.

        Returns
        -------
        NDArray
            Shape (n_places, n_frequencies).
        """
        omega = 2 * np.pi * frequency_hz
        wavenumber = np.sqrt(omega / self.dispersion_m2s)
        phase = np.multiply.outer(distance_m, wavenumber)
        loss = np.exp(-phase * (self.loss_s * omega / 4))
        shape = _at(phase, _spreading())
        shape *= self.mobility_mns * loss
        return shape

    def radial(
        self, distance_m: NDArray[np.float64], frequency_hz: NDArray[np.float64], lever_m: float
    ) -> NDArray[np.complex128]:
        """Return the horizontal velocity away from the force over the force [m/(N s)].

        A bent plate tilts: a point ``lever_m`` above its middle moves by -lever dw/dr. Far from the
        force this is k lever of the vertical movement and a quarter of a period ahead of it:
        retrograde, as in a Rayleigh wave. Shapes as for :meth:`response`.
        """
        omega = 2 * np.pi * frequency_hz
        wavenumber = np.sqrt(omega / self.dispersion_m2s)
        phase = np.multiply.outer(distance_m, wavenumber)
        loss = np.exp(-phase * (self.loss_s * omega / 4))
        shape = _at(phase, _slope())
        shape *= -self.mobility_mns * lever_m * wavenumber * loss
        return shape


def _at(
    phase: NDArray[np.float64], table: tuple[NDArray[np.float64], NDArray[np.float64]]
) -> NDArray[np.complex128]:
    """Return a table over k r, real and imaginary, between its entries."""
    real, imag = table
    position = np.minimum(phase / _STEP, real.size - 2.0)
    index = position.astype(np.intp)
    part = position - index
    shape = np.empty(phase.shape, np.complex128)
    shape.real = real[index] + part * (real[index + 1] - real[index])
    shape.imag = imag[index] + part * (imag[index + 1] - imag[index])
    return shape


@cache
def _spreading() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return conj(H0(x) - H0(i x)), real and imaginary, at x = 0, _STEP, ..., _TOP."""
    from scipy.special import j0, k0, y0

    x = np.arange(_STEP, _TOP, _STEP)
    # H0(i x) = -2 i K0(x) / pi; the logarithms of Y0 and K0 cancel at 0, which leaves 1.
    real = np.concatenate(([1.0], j0(x)))
    imag = np.concatenate(([0.0], -(y0(x) + 2 / np.pi * k0(x))))
    return real, imag


@cache
def _slope() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the derivative of :func:`_spreading` over x at the same places; 0 at the force."""
    from scipy.special import j1, k1, y1

    x = np.arange(_STEP, _TOP, _STEP)
    real = np.concatenate(([0.0], -j1(x)))
    imag = np.concatenate(([0.0], y1(x) + 2 / np.pi * k1(x)))
    return real, imag


@dataclass(frozen=True, slots=True)
class Impact:
    """A force like p t exp(-t / decay) sin(2 pi f t): a foot's mass on the spring of its heel.

    It starts smoothly (as t^2), swings a few times and dies out.

    Attributes
    ----------
    peak_n
        Height of the first swing, about [N].
    frequency_hz
        Of the contact's oscillation [Hz].
    decay_s
        Time constant [s].
    delay_s
        When it starts [s].
    """

    peak_n: float
    frequency_hz: float
    decay_s: float
    delay_s: float = 0.0

    def spectrum(self, frequency_hz: NDArray[np.float64]) -> NDArray[np.complex128]:
        """Return the force's Fourier integral [N s], shape (n_frequencies,), in closed form."""
        omega_0 = 2 * np.pi * self.frequency_hz
        s = 2j * np.pi * frequency_hz + 1 / self.decay_s
        first = 1 / (4 * self.frequency_hz)  # about where the first swing is highest
        scale = self.peak_n / (first * np.exp(-first / self.decay_s))
        pulse: NDArray[np.complex128] = scale * 2 * omega_0 * s / (s**2 + omega_0**2) ** 2
        pulse *= np.exp(-2j * np.pi * frequency_hz * self.delay_s)
        return pulse


def geophone(
    frequency_hz: NDArray[np.float64], corner_hz: float = 10.0, damping: float = 0.7
) -> NDArray[np.complex128]:
    """Return the response of a geophone: a high-pass of second order, shape (n_frequencies,)."""
    ratio = 1j * frequency_hz / corner_hz
    response: NDArray[np.complex128] = ratio**2 / (ratio**2 + 2 * damping * ratio + 1)
    return response


@dataclass(frozen=True, slots=True)
class Synthesis:
    """Waveforms of a force on a plate at places around it, by inverse Fourier transform.

    Attributes
    ----------
    plate
        The floor.
    rate_hz
        Sampling rate of the waveforms.
    samples
        Length of the waveforms; what has not died out by then wraps around.
    """

    plate: Plate
    rate_hz: float
    samples: int

    @classmethod
    def lasting(cls, plate: Plate, rate_hz: float, duration_s: float) -> Synthesis:
        """Return the synthesis of waveforms of at least ``duration_s``: a power of two samples."""
        return cls(plate, rate_hz, 1 << int(np.ceil(np.log2(duration_s * rate_hz))))

    @property
    def frequency_hz(self) -> NDArray[np.float64]:
        """Frequencies synthesised, up to 4 kHz or 0.45 of the rate, shape (n_frequencies,)."""
        top = int(min(4000.0, 0.45 * self.rate_hz) * self.samples / self.rate_hz)
        return np.arange(top + 1, dtype=np.float64) * (self.rate_hz / self.samples)

    def sensor(self) -> NDArray[np.complex128]:
        """Return the geophone with a taper over the uppermost fifth of the band, shape (n_f,)."""
        frequency = self.frequency_hz
        part = np.clip((frequency / frequency[-1] - 0.8) / 0.2, 0.0, 1.0)
        taper: NDArray[np.float64] = 0.5 + 0.5 * np.cos(np.pi * part)
        return geophone(frequency) * taper

    def waveforms(
        self, distance_m: NDArray[np.float64], force_ns: NDArray[np.complex128]
    ) -> NDArray[np.float64]:
        """Return the velocity [m/s] after a force with spectrum ``force_ns`` [N s].

        Parameters
        ----------
        distance_m
            Shape (n_places,).
        force_ns
            Shape (n_frequencies,), sensor included.

        Returns
        -------
        NDArray
            Shape (n_places, samples).
        """
        return self.inverse(self.plate.response(distance_m, self.frequency_hz), force_ns)

    def inverse(
        self, transfer: NDArray[np.complex128], force_ns: NDArray[np.complex128]
    ) -> NDArray[np.float64]:
        """Return the velocity [m/s] of a force through ``transfer``, which it overwrites.

        Parameters
        ----------
        transfer
            Velocity over force [m/(N s)], shape (n_places, n_frequencies).
        force_ns
            Shape (n_frequencies,) or that of ``transfer``, sensor included [N s].

        Returns
        -------
        NDArray
            Shape (n_places, samples).
        """
        transfer *= force_ns * self.rate_hz
        return np.fft.irfft(transfer, self.samples, axis=1)
