"""Wave physics of floors and ground: velocities, arrivals and waveforms of waves.

Source: the thesis on locating people by seismic waves. ``bench/floor_tables.py`` prints the
velocities of common floors; docs/waves.md says what to make of them.

Solids (sections 1.1 and 1.2): P and S inside an isotropic elastic solid, Rayleigh's wave on its
surface. The example of the thesis (lambda = 7000 MPa, mu = 10000 MPa, 2500 kg/m3) says c_p = 4400
m/s; equation (1.2) gives 3286 m/s.

Plates (section 1.3): the velocity of A0 is a root of a Rayleigh-Lamb equation, with which (1.7)
shares only the limit of low frequency. With s = (c / c_s)^2, p = (c / c_p)^2, k = omega / c, alpha
= k sqrt(1 - p), beta = k sqrt(1 - s) and half the thickness b::

    A0:  (2 - s)^2 tanh(alpha b) = 4 sqrt(1 - p) sqrt(1 - s) tanh(beta b)

Response of a thin, lossy plate to a force, along one line (sections 4.1 to 4.3): the model is a
plane wave with a white spectrum. The waves of a point force that :class:`Plate` makes spread over a
circle too, and far from the force they are this response times sqrt(2 / (pi k d)) exp(-i pi / 4).

Apparent velocity and arrival (sections 4.2 and 4.3): the envelope (4.21) has a maximum over
distance at a fixed time, (4.22): where the wave is highest now. That gives (4.24), t = (theta d^4 /
(8 a^2))^(1/3), and (4.25). A sensor stays where it is and sees the maximum over time at a fixed
distance; setting the derivative by t to 0 puts 16 a^2 for 8 a^2, so that the sensor sees the
maximum 2^(1/3) = 1.26 times faster than (4.25) says. The velocity falls with d^(-1/3); chapter 4
concludes with 1/d^3, a slip.

A picker sees neither, but what first rises over the noise: :func:`onset_s`, faster still. So theta
is a parameter to fit, not a constant of the material. Nor does that onset strictly keep the order
of distances, as (4.13) says: the swings run at half the speed of the envelope, so that the first
one over the level changes, and at some distances the onset jumps back by up to 0.4 ms. Of two
places from 3 to 20 m off that differ by up to 0.45 m, the farther may come first.

Bending waves at a sensor on a concrete floor: the floor is an infinite Kirchhoff plate, equation
(4.2): dispersive (high frequencies run ahead), without reflections. The displacement of the plate
at a distance r from a harmonic point force is the classical Green's function

    W(r, w) = F(w) i / (8 D k^2) [H0(k r) - H0(i k r)],   k = sqrt(w / a) (1 + i theta w / 4)

with H0 the Hankel function of the first kind for exp(-i w t), a = sqrt(D / (rho h)) and the small
loss of equation (4.5). Since D k^2 = w sqrt(D rho h), the velocity is the force times the
drive-point mobility 1 / (8 sqrt(D rho h)) times a function of k r alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Literal, Protocol, Self

import numpy as np

from ..errors import PipelineError

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Array = NDArray[np.float64]


def thin_a0_mps(plate: Plate, frequency_hz: Array) -> Array:
    """Return the phase velocity of bending waves of a thin plate [m/s], (1.7): sqrt(a omega).

    It grows without bound, where A0 ends at the Rayleigh velocity: see :func:`thin_limit_hz`. The
    group velocity is twice that, (4.6).
    """
    velocity: Array = np.sqrt(plate.dispersion_m2s * 2 * np.pi * frequency_hz)
    return velocity


def thin_limit_hz(plate: Plate) -> float:
    """Return where six thicknesses are one wavelength of (1.7), under (4.1) [Hz].

    Section 4.1 says 2000 Hz for 0.2 m of concrete, with 2400 m/s for the velocity. By (1.7) itself
    it is 797 Hz: there the wave runs at 956 m/s, 8.7 % faster than A0.
    """
    return float(plate.dispersion_m2s * 2 * np.pi / (6 * plate.thickness_m) ** 2)


def a0_mps(plate: Plate, frequency_hz: Array) -> Array:
    """Return the phase velocity of A0 [m/s], from the bending wave's to the Rayleigh velocity.

    Parameters
    ----------
    plate
        Its loss does not count.
    frequency_hz
        Shape (n,), above 0.

    Returns
    -------
    NDArray
        Shape (n,).
    """
    solid = Solid.of_plate(plate)

    def bent(c: Array) -> Array:
        s, p, half_turn = _terms(plate, solid, frequency_hz, c)
        alpha, beta = np.sqrt(1 - p), np.sqrt(1 - s)
        balance: Array = (2 - s) ** 2 * np.tanh(half_turn * alpha)
        balance -= 4 * alpha * beta * np.tanh(half_turn * beta)
        return balance

    highest = np.full(np.shape(frequency_hz), solid.s_mps)
    # A0 stays above half of its two limits, and below that bound only c = 0 is a root
    lowest = 0.5 * np.minimum(thin_a0_mps(plate, frequency_hz), solid.rayleigh_mps)
    return bisect(bent, lowest, highest)


def _terms(plate: Plate, solid: Solid, frequency_hz: Array, c: Array) -> tuple[Array, Array, Array]:
    """Return (c / c_s)^2, (c / c_p)^2 and k b, each shape (n,)."""
    half_turn: Array = np.pi * frequency_hz * plate.thickness_m / c
    return (c / solid.s_mps) ** 2, (c / solid.p_mps) ** 2, half_turn


@dataclass(frozen=True, slots=True)
class Cutoff:
    """Where a Lamb mode begins.

    Attributes
    ----------
    mode
        "A1", "S1", "S2", ...: numbered upwards in each family.
    frequency_hz
        Below it the mode carries no energy [Hz].
    wave
        What crosses the thickness there: "P" or "S".
    """

    mode: str
    frequency_hz: float
    wave: Literal["P", "S"]


def cutoffs(plate: Plate, top_hz: float) -> list[Cutoff]:
    """Return the cut-offs of the higher Lamb modes up to a frequency, lowest first.

    At each the thickness is p half wavelengths, (1.5): of the shear wave for odd p of antisymmetric
    and even p of symmetric modes, of the compression wave the other way about.
    """
    solid = Solid.of_plate(plate)
    by_family: dict[str, list[tuple[float, Literal["P", "S"]]]] = {"A": [], "S": []}
    waves: tuple[tuple[Literal["P", "S"], float, str], ...] = (
        ("S", solid.s_mps, "SA"),
        ("P", solid.p_mps, "AS"),
    )
    for wave, velocity, family in waves:
        lowest_hz = velocity / (2 * plate.thickness_m)
        for p in range(1, int(top_hz / lowest_hz) + 1):
            by_family[family[p % 2]].append((p * lowest_hz, wave))
    numbered = [
        Cutoff(f"{family}{number}", frequency_hz, wave)
        for family, begins in by_family.items()
        for number, (frequency_hz, wave) in enumerate(sorted(begins), 1)
    ]
    return sorted(numbered, key=lambda cutoff: cutoff.frequency_hz)


def wavenumber(plate: Plate, omega: Array) -> NDArray[np.complex128]:
    """Return k(omega) of bending waves with Kelvin-Voigt loss [rad/m], (4.4).

    The response takes (4.5), its limit of small loss, as the thesis does.
    """
    lossless = np.sqrt(omega / plate.dispersion_m2s)
    k: NDArray[np.complex128] = lossless * (1 - 1j * plate.loss_s * omega) ** -0.25
    return k


@dataclass(frozen=True, slots=True)
class Response:
    """The sum (4.9) for the integral (4.8).

    It runs over positive frequencies only, so that its complex terms add up to the analytic signal:
    the displacement is the real part, the envelope the modulus, and (4.21) its limit far away.

    The sum is periodic, by ``terms / top_hz``: slow waves of low frequency come round again. With
    the thesis's 2048 terms, that is 0.2 s, the envelope differs from (4.21) by up to 4.5 % of its
    maximum at 20 m; with 65536 by 0.5 %, after 3.2 % at 5 m and 1.3 % at 10 m.

    Attributes
    ----------
    plate
        The floor.
    top_hz
        Highest frequency f_max: closer than 3 m a white source has more than 10 kHz.
    terms
        Number n of frequencies.
    """

    plate: Plate
    top_hz: float = 10_000.0
    terms: int = 2048

    @property
    def omega(self) -> Array:
        """Angular frequencies of the terms [rad/s], shape (terms,)."""
        return np.arange(self.terms, dtype=np.float64) * (2 * np.pi * self.top_hz / self.terms)

    def analytic(
        self, distance_m: Array, rate_hz: float, source: NDArray[np.complex128] | None = None
    ) -> NDArray[np.complex128]:
        """Return the analytic signal of the displacement, from time 0.

        Parameters
        ----------
        distance_m
            Shape (n_places,), above 0.
        rate_hz
            Sampling rate, from ``top_hz``; taken to the nearest that divides the period, see
            :meth:`time_s`.
        source
            Shape (terms,): spectrum U(0, omega), 1 (white) by default.

        Returns
        -------
        NDArray
            Shape (n_places, n_samples), in the source's unit times rad/s.
        """
        omega = self.omega
        k = np.sqrt(omega / self.plate.dispersion_m2s) * (1 + 0.25j * self.plate.loss_s * omega)
        spectrum = np.exp(1j * np.multiply.outer(distance_m, k))
        if source is not None:
            spectrum *= source
        spectrum *= 2 * np.pi * self.top_hz / self.terms / np.sqrt(2 * np.pi)
        signal: NDArray[np.complex128] = np.fft.fft(spectrum, self._samples(rate_hz), axis=1)
        return signal

    def time_s(self, rate_hz: float) -> Array:
        """Return the times of :meth:`analytic` [s], shape (n_samples,)."""
        samples = self._samples(rate_hz)
        return np.arange(samples, dtype=np.float64) * (self.terms / self.top_hz / samples)

    def _samples(self, rate_hz: float) -> int:
        return round(rate_hz * self.terms / self.top_hz)


def envelope(plate: Plate, distance_m: Array, time_s: Array) -> Array:
    """Return the envelope of a white source's wave by stationary phase, (4.21).

    It is d / (sqrt(2 a) t^(3/2)) exp(-theta d^4 / (32 a^2 t^3)).

    Parameters
    ----------
    plate
        The floor.
    distance_m, time_s
        Any shapes that numpy joins; times above 0.

    Returns
    -------
    NDArray
        In the unit of :meth:`Response.analytic`.
    """
    a = plate.dispersion_m2s
    loss = plate.loss_s * distance_m**4 / (32 * a**2 * time_s**3)
    amplitude: Array = distance_m / (np.sqrt(2 * a) * time_s**1.5) * np.exp(-loss)
    return amplitude


@dataclass(frozen=True, slots=True)
class Solid:
    """An isotropic elastic solid.

    Attributes
    ----------
    young_pa
        Young's modulus E [Pa].
    density_kgm3
        rho [kg/m3].
    poisson
        Poisson's ratio, from 0 to below 1/2.

    Raises
    ------
    PipelineError
        Where a constant lies outside its range.
    """

    young_pa: float
    density_kgm3: float
    poisson: float

    def __post_init__(self) -> None:
        for name in ("young_pa", "density_kgm3"):
            if not getattr(self, name) > 0:
                raise PipelineError(f"solid: {name}: expected > 0, found {getattr(self, name)}")
        # of_velocities may round to just below 0
        if not -1e-9 <= self.poisson < 0.5:
            raise PipelineError(f"solid: poisson: expected 0 <= ratio < 0.5, found {self.poisson}")

    @classmethod
    def of_plate(cls, plate: Plate) -> Self:
        """Return what a plate is made of."""
        return cls(plate.young_pa, plate.density_kgm3, plate.poisson)

    @classmethod
    def of_lame(cls, lame_pa: float, shear_pa: float, density_kgm3: float) -> Self:
        """Return the solid of Lame's constants lambda and mu [Pa], under (1.3)."""
        poisson = lame_pa / (2 * (lame_pa + shear_pa))
        return cls(2 * shear_pa * (1 + poisson), density_kgm3, poisson)

    @classmethod
    def of_velocities(cls, p_mps: float, s_mps: float, density_kgm3: float) -> Self:
        """Return the solid of measured velocities [m/s]: how soils are usually described."""
        shear_pa = density_kgm3 * s_mps**2
        return cls.of_lame(density_kgm3 * p_mps**2 - 2 * shear_pa, shear_pa, density_kgm3)

    @property
    def shear_pa(self) -> float:
        """Lame's mu, the shear modulus [Pa]."""
        return self.young_pa / (2 * (1 + self.poisson))

    @property
    def lame_pa(self) -> float:
        """Lame's lambda [Pa]."""
        return 2 * self.shear_pa * self.poisson / (1 - 2 * self.poisson)

    @property
    def p_mps(self) -> float:
        """Velocity of compression waves, sqrt((lambda + 2 mu) / rho), (1.2)."""
        return float(np.sqrt((self.lame_pa + 2 * self.shear_pa) / self.density_kgm3))

    @property
    def s_mps(self) -> float:
        """Velocity of shear waves, sqrt(mu / rho), (1.2)."""
        return float(np.sqrt(self.shear_pa / self.density_kgm3))

    @property
    def rayleigh_mps(self) -> float:
        """Velocity of the Rayleigh wave: root of the equation of a free surface.

        With s = (c / c_s)^2 and p = (c / c_p)^2 that is (2 - s)^2 = 4 sqrt(1 - p) sqrt(1 - s).
        """
        squared = (self.s_mps / self.p_mps) ** 2
        ratio = bisect(
            lambda c: (2 - c**2) ** 2 - 4 * np.sqrt((1 - squared * c**2) * (1 - c**2)),
            np.array([0.5]),  # c = 0 is a root too, but no wave
            np.array([1.0]),
        )
        return float(ratio[0]) * self.s_mps

    @property
    def plate_mps(self) -> float:
        """Velocity of S0 at low frequency, 2 c_s sqrt(1 - (c_s / c_p)^2), (1.6)."""
        return 2 * self.s_mps * float(np.sqrt(1 - (self.s_mps / self.p_mps) ** 2))


#: 8 a^2 of (4.24), with the thesis's a = 183 m^2/s. Source: thesis, equation (4.24).
PLATE = 8 * 183.0**2


def arrivals(distance_m: Array, theta_s: float) -> Array:
    """Return when a wave arrives [s], equation (4.24): t^3 = theta d^4 / (8 a^2)."""
    times: Array = np.cbrt(theta_s / PLATE * distance_m**4)
    return times


def front_arrival_s(plate: Plate, distance_m: Array) -> Array:
    """Return when the wave is highest of all places at a place [s], (4.24) as printed: 8 a^2.

    The shape is that of ``distance_m``, as everywhere here.
    """
    return _arrival_s(plate, distance_m, 8.0)


def sensor_arrival_s(plate: Plate, distance_m: Array) -> Array:
    """Return when a place is highest of all times [s], (4.24) corrected: 16 a^2."""
    return _arrival_s(plate, distance_m, 16.0)


def front_mps(plate: Plate, distance_m: Array) -> Array:
    """Return the perceived velocity (4.25) as printed [m/s]: (8 a^2 / (theta d))^(1/3)."""
    velocity: Array = distance_m / front_arrival_s(plate, distance_m)
    return velocity


def sensor_mps(plate: Plate, distance_m: Array) -> Array:
    """Return the perceived velocity at a sensor [m/s]: (16 a^2 / (theta d))^(1/3)."""
    velocity: Array = distance_m / sensor_arrival_s(plate, distance_m)
    return velocity


def _arrival_s(plate: Plate, distance_m: Array, squares: float) -> Array:
    """Return (theta d^4 / (squares a^2))^(1/3) [s]."""
    # only theta / a^2 counts, so another floor is that of PLATE with another theta
    scale = PLATE / (squares * plate.dispersion_m2s**2)
    return arrivals(distance_m, plate.loss_s * scale)


def onset_s(
    response: Response, distance_m: Array, level: float = 200.0, rate_hz: float = 50_000.0
) -> Array:
    """Return when the displacement (4.9) of a white source first exceeds a level [s].

    This is the threshold of section 4.2; 200 is that of figure 4.3.

    Parameters
    ----------
    response
        The floor and the sum's terms.
    distance_m
        Shape (n,), from 3 m.
    level
        In the unit of the response.
    rate_hz
        How finely time is sampled.

    Returns
    -------
    NDArray
        Shape (n,); NaN where the level is never exceeded.
    """
    time_s = response.time_s(rate_hz)
    onset = np.full(distance_m.shape, np.nan)
    for index, distance in enumerate(distance_m):  # one by one: a long sum is many megabytes
        above = np.abs(response.analytic(distance[None], rate_hz)[0].real) > level
        if above.any():
            onset[index] = time_s[np.argmax(above)]
    return onset


#: More than the bits of a double. Source: definition.
_HALVINGS = 60


def bisect(function: Callable[[Array], Array], low: Array, high: Array) -> Array:
    """Return where an increasing function changes its sign, for each pair of bounds.

    Parameters
    ----------
    function
        Takes and gives shape (n,), one equation per element: negative below its root.
    low, high
        Shape (n,): bounds of the roots.

    Returns
    -------
    NDArray
        Shape (n,). Where nothing changes its sign, the bound on whose side the root would lie.
    """
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        below = function(middle) < 0
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return 0.5 * (low + high)


#: Of the table over k r: the phase turns 0.01 rad between two entries. Chosen by judgement.
_PLATE_STEP = 0.01
#: End of that table: 3 kHz at 157 m on the default plate. Chosen by judgement: farther and faster
#: than any step is heard.
_TOP = 1600.0


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
    def slowest_mps(self) -> float:
        """Group velocity at 20 Hz, the lowest of a step's frequencies [m/s]."""
        return float(2 * np.sqrt(self.dispersion_m2s * 2 * np.pi * 20.0))

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
    position = np.minimum(phase / _PLATE_STEP, real.size - 2.0)
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

    x = np.arange(_PLATE_STEP, _TOP, _PLATE_STEP)
    # H0(i x) = -2 i K0(x) / pi; the logarithms of Y0 and K0 cancel at 0, which leaves 1.
    real = np.concatenate(([1.0], j0(x)))
    imag = np.concatenate(([0.0], -(y0(x) + 2 / np.pi * k0(x))))
    return real, imag


@cache
def _slope() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the derivative of :func:`_spreading` over x at the same places; 0 at the force."""
    from scipy.special import j1, k1, y1

    x = np.arange(_PLATE_STEP, _TOP, _PLATE_STEP)
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


class WaveMedium(Protocol):
    """What waves run through: a plate, or ground by its law."""

    @property
    def dispersion_m2s(self) -> float:
        """Dispersion constant, or that of the plate as fast at 100 Hz [m2/s]."""

    @property
    def slowest_mps(self) -> float:
        """Group velocity of the slowest wave of a step [m/s]."""

    def response(
        self, distance_m: NDArray[np.float64], frequency_hz: NDArray[np.float64]
    ) -> NDArray[np.complex128]:
        """Return velocity over force, as :meth:`Plate.response`."""

    def radial(
        self, distance_m: NDArray[np.float64], frequency_hz: NDArray[np.float64], lever_m: float
    ) -> NDArray[np.complex128]:
        """Return horizontal velocity over force, as :meth:`Plate.radial`."""


@dataclass(frozen=True, slots=True)
class Synthesis:
    """Waveforms of a force on a floor at places around it, by inverse Fourier transform.

    Attributes
    ----------
    plate
        The floor.
    rate_hz
        Sampling rate of the waveforms.
    samples
        Length of the waveforms; what has not died out by then wraps around.
    """

    plate: WaveMedium
    rate_hz: float
    samples: int

    @classmethod
    def lasting(cls, plate: WaveMedium, rate_hz: float, duration_s: float) -> Synthesis:
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
