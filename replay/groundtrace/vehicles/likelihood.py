"""The position of a vehicle in one working cycle, from powers or from their ratios to a reference.

By powers. Source: the paper, equation (7): each power is Gaussian about mu / r^n with a third of
that as standard deviation. mu is known from a survey, or profiled: with a_n = U_n r_n^n the
likeliest q = 1 / mu solves q^2 sum a^2 - q sum a - N sigma^2 = 0.

By the ratios of powers at sensors to that at a reference, which is the first sensor throughout.
Source: the paper, equations (16) and (17). Corrected here:

- (16) has the ratio of powers to the power 1 / 1.5, but its left side is a ratio of *squared*
  distances: it is 2 / n.
- (17) compares theta to ratios of distances; theta is their n-th power, so theta^(1 / n) (2/3 for n
  = 1.5) stands in its place.
- (17) leaves out the reference, whose ratio is 1 on both sides. Without it the normalisation loses
  a common factor of all ratios, so with three sensors one of two measurements.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np

from groundtrace_codecs.events import Fix, Note, Quantity, quantised

from ..pipeline.gates import Level
from ..pipeline.parameters import gate, measured
from ..pipeline.stage import LocationEstimate
from .medium import EXPONENT, PowerLaw, ranges
from .presence import RELATIVE_SIGMA
from .stations import CycleStage, candidates_of, row_doubt

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Event
    from groundtrace_codecs.geometry import Stations

    from ..pipeline.gates import Candidates
    from .stations import StationPowers

    Array = NDArray[np.float64]

#: Refinements about the best node, each so many times as fine. Chosen by judgement: 256 times finer
#: than the table.
REFINEMENTS, FINER = 4, 4
#: Nodes that differ by this part of the best are as good but for rounding.
#: source: some thousand roundings of 64-bit numbers, 2.2e-16 each.
_ROUNDING = 1e-12


def best_node(goodness: Array) -> int:
    """Return where an array of any shape is largest, as a flat index; NaN does not count.

    Of values that are equal but for rounding it is the first: in a row of stations places that
    mirror each other are as good, and rounding, which differs from machine to machine, must not
    choose between them.
    """
    best = float(np.nanmax(goodness))
    equal = goodness >= best - _ROUNDING * max(abs(best), 1.0)
    return int(equal.argmax())


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """The log-likelihood over a lattice.

    Attributes
    ----------
    x, y
        Shapes (nx,) and (ny,): even [m].
    values
        Shape (ny, nx): the logarithm of (7), constants left out.
    """

    x: Array
    y: Array
    values: Array

    @property
    def best(self) -> Array:
        """The likeliest node, shape (2,) [m]."""
        row, column = divmod(best_node(self.values), len(self.x))
        return np.array([self.x[column], self.y[row]])


@dataclass(frozen=True, slots=True, eq=False)
class CyclePlace:
    """Powers of one cycle, and what of them is known.

    Attributes
    ----------
    powers
        Shape (n,): less the noise; those not above 0 do not count.
    sensors
        Shape (n, 2) [m].
    law
        How power falls; its mu counts only where it is known.
    mu_known
        Whether it is; else it is profiled.
    relative_sigma
        Standard deviation of a power over its mean: one, or of each, shape (n,).
    """

    powers: Array
    sensors: Array
    law: PowerLaw
    mu_known: bool = False
    relative_sigma: float | Array = RELATIVE_SIGMA

    def log_likelihood(self, places: Array) -> Array:
        """Return the logarithm of (7) at places, shape (...) from (..., 2) [m]."""
        detecting = self._detecting()
        unit = PowerLaw(1.0, self.law.exponent, self.law.loss_per_m)
        spread = unit.power(ranges(places, self.sensors[detecting]))
        a = self.powers[detecting] / spread
        sigma = self._sigma(detecting)
        mu = np.full(a.shape[:-1], self.law.mu) if self.mu_known else profiled_mu(a, sigma)
        off = (a / mu[..., None] - 1) / sigma
        scale = np.log(spread).sum(axis=-1) + a.shape[-1] * np.log(mu)
        return np.asarray(-scale - 0.5 * (off**2).sum(axis=-1))

    def surface(self, x: Array, y: Array) -> Surface:
        """Return the log-likelihood over even coordinates, shapes (nx,) and (ny,) [m]."""
        nodes = np.stack(np.meshgrid(x, y), axis=-1)
        return Surface(x, y, self.log_likelihood(nodes))

    def locate(self, surface: Surface) -> LocationEstimate:
        """Return the likeliest place, refined below the lattice of its surface.

        Its covariance is the inverse Hessian there, inf where the surface is not curved, as at the
        edge; its residual the relative root mean square of what the law leaves.
        """
        step = float(surface.x[1] - surface.x[0])
        position = surface.best
        reach = np.arange(-FINER, FINER + 1)
        for _ in range(REFINEMENTS):
            step /= FINER
            offsets = step * np.stack(np.meshgrid(reach, reach), axis=-1)
            near = position + offsets
            position = near.reshape(-1, 2)[best_node(self.log_likelihood(near))]
        sensor_count = int(self._detecting().sum())
        x, y = position.tolist()
        return LocationEstimate(
            x, y, self._covariance(position), self._residual(position), sensor_count
        )

    def _covariance(self, position: Array) -> Array:
        h = 0.05  # [m]: far below what one cycle tells apart, far above rounding
        axes = h * np.eye(2)
        corners = [position + i * axes[0] + j * axes[1] for i in (-1, 0, 1) for j in (-1, 0, 1)]
        f = self.log_likelihood(np.array(corners)).reshape(3, 3)
        xx, yy = f[2, 1] - 2 * f[1, 1] + f[0, 1], f[1, 2] - 2 * f[1, 1] + f[1, 0]
        xy = (f[2, 2] - f[2, 0] - f[0, 2] + f[0, 0]) / 4
        hessian = -np.array([[xx, xy], [xy, yy]]) / h**2
        if np.linalg.eigvalsh(hessian)[0] <= 1e-9:
            return np.full((2, 2), np.inf)
        return np.asarray(np.linalg.inv(hessian), np.float64)

    def _residual(self, position: Array) -> float:
        detecting = self._detecting()
        unit = PowerLaw(1.0, self.law.exponent, self.law.loss_per_m)
        a = self.powers[detecting] / unit.power(ranges(position, self.sensors[detecting]))
        mu = self.law.mu if self.mu_known else float(profiled_mu(a, self._sigma(detecting)))
        return float(np.sqrt(np.mean((a / mu - 1) ** 2)))

    def _detecting(self) -> NDArray[np.bool_]:
        return np.isfinite(self.powers) & (self.powers > 0)

    def _sigma(self, detecting: NDArray[np.bool_]) -> Array:
        return np.broadcast_to(self.relative_sigma, self.powers.shape)[detecting]


def noise_subtracted(
    powers: Array, floors: Array, floor_sigmas: Array | None, relative_sigma: float
) -> tuple[Array, Array]:
    """Return powers less the noise, and the standard deviation of each over itself.

    The variance is P^2 / K of the power, noise included, K = relative_sigma^-2, and that of the
    floor; so what hardly stands out of the noise weighs little in (7).

    Parameters
    ----------
    powers, floors
        Any shape: noise included, and of the noise.
    floor_sigmas
        The same shape: standard deviations of the floors; None: they are known.
    relative_sigma
        Standard deviation of a power over its mean.

    Returns
    -------
    The same shape twice; inf where there is no more than noise.
    """
    signal = powers - floors
    spread = np.hypot(relative_sigma * powers, 0.0 if floor_sigmas is None else floor_sigmas)
    sigma = np.divide(spread, signal, out=np.full(signal.shape, np.inf), where=signal > 0)
    return signal, sigma


def profiled_mu(a: Array, relative_sigma: float | Array) -> Array:
    """Return the mu at which (7) is greatest, shape (...).

    Parameters
    ----------
    a
        Shape (..., n): powers over what the law gives for mu = 1.
    relative_sigma
        Standard deviation of a power over its mean: one, or of each, shape (n,).
    """
    weights = np.broadcast_to(relative_sigma, a.shape[-1:]) ** -2.0
    first, second = a @ weights, a**2 @ weights
    return np.asarray(2 * second / (first + np.sqrt(first**2 + 4 * second * a.shape[-1])))


_PLUGIN = "vehicle-likelihood"


@dataclass(frozen=True, slots=True)
class PlaceParameters:
    """Parameters of :class:`LikelihoodPlaces`."""

    exponent: Annotated[float, measured("1", "n of the power mu / r^n.", gt=0)] = 1.5
    mu: Annotated[
        float, measured("unit^2 m^n", "Energy parameter; 0 where it is unknown.", ge=0)
    ] = 0.0
    relative_sigma: Annotated[
        float, measured("1", "Standard deviation of a power over its mean.", gt=0)
    ] = 1 / 3
    step_m: Annotated[float, measured("m", "Between the nodes of the lattice.", gt=0)] = 1.0
    margin_m: Annotated[float, measured("m", "Of the lattice about the stations.", ge=0)] = 20.0
    least_over_floor: Annotated[
        float, measured("1", "Power over the noise from which a station counts.", ge=1)
    ] = 1.5
    heard: Annotated[float, gate("1", "Fewest stations that count.", ge=3)] = 3.0
    sigma: Annotated[
        float, gate("m", "Largest standard deviation, along the longer axis.", gt=0)
    ] = 15.0


class LikelihoodPlaces(CycleStage):
    """The likeliest place of every cycle in which a vehicle is heard, and the surface about it."""

    Parameters = PlaceParameters
    gives = (Fix,)
    columns = (
        Quantity("heard", "1"),
        Quantity("residual", "1"),
        Quantity("x", "m"),
        Quantity("y", "m"),
        Quantity("sigma", "m"),
    )
    gates = (Level("heard", "1", "heard"), Level("sigma", "m", "sigma", at_least=False))
    least_stations = 3

    def __init__(self, parameters: PlaceParameters) -> None:
        super().__init__(parameters)
        self._latest_estimate: tuple[int, LocationEstimate, Surface] | None = None

    def begin(self, site: Stations, stage: str) -> tuple[str, ...]:
        """Begin with a lattice about the stations."""
        p = self.parameters
        self._site, self._stage = site, stage
        self._doubt = row_doubt(site.names, site.places)
        low, high = site.places.min(axis=0) - p.margin_m, site.places.max(axis=0) + p.margin_m
        self._x, self._y = (
            np.arange(a, b + p.step_m / 2, p.step_m) for a, b in zip(low, high, strict=True)
        )
        return ("all",)

    def take(self, cycle: StationPowers) -> Candidates:
        """Locate in a cycle in which any station hears a vehicle."""
        p = self.parameters
        self._latest_estimate = None
        if not cycle.present.any():
            return candidates_of([], len(self.columns))
        counted = cycle.powers > p.least_over_floor * cycle.floors
        station_count = int(counted.sum())
        if station_count < self.least_stations:
            return candidates_of(
                [(cycle.time_ns, 0, [station_count, *[np.nan] * 4])], len(self.columns)
            )
        law = PowerLaw(p.mu or 1.0, p.exponent)
        signal, sigmas = noise_subtracted(
            cycle.powers, cycle.floors, cycle.floor_sigmas, p.relative_sigma
        )
        powers = np.where(counted, signal, np.nan)
        cycle_place = CyclePlace(powers, self._site.places, law, p.mu > 0, sigmas)
        surface = cycle_place.surface(self._x, self._y)
        estimate = cycle_place.locate(surface)
        self._latest_estimate = cycle.time_ns, estimate, surface
        inside = self._x[0] < estimate.x < self._x[-1] and self._y[0] < estimate.y < self._y[-1]
        # at the edge of the lattice the maximum is not one: it lies beyond
        sigma = estimate.larger_sigma_m if inside else np.inf
        row = [station_count, estimate.residual, estimate.x, estimate.y, sigma]
        return candidates_of([(cycle.time_ns, 0, row)], len(self.columns))

    def finish(self) -> Candidates:
        """Return nothing: no cycle is held back."""
        self._latest_estimate = None
        return candidates_of([], len(self.columns))

    def follow(self, accepted: NDArray[np.bool_]) -> Iterator[Event]:
        """Yield the surface, and the place if it was accepted."""
        if self._latest_estimate is None:
            return
        time_ns, location, surface = self._latest_estimate
        yield quantised(time_ns, surface.x, surface.y, surface.values, self._stage)
        if accepted[0]:
            if self._doubt:
                yield Note(time_ns, self._doubt, "WARN", self._stage)
                self._doubt = ""
            yield location.fix(time_ns, _PLUGIN, self._stage)


#: Newton steps at most. Chosen by judgement: far more than it takes.
_STEPS = 30


def lattice(low: tuple[float, float], high: tuple[float, float], step_m: float) -> Array:
    """Return the nodes of a table, shape (n, 2) [m], x running fastest.

    Parameters
    ----------
    low, high
        Opposite corners [m].
    step_m
        Distance of neighbours; the paper takes 0.5 or 1 m.
    """
    x, y = (np.arange(a, b + step_m / 2, step_m) for a, b in zip(low, high, strict=True))
    return np.stack([c.ravel() for c in np.meshgrid(x, y)], axis=1)


def correlation(
    nodes: Array, sensors: Array, log_theta: Array, exponent: float = EXPONENT
) -> Array:
    """Return the metric (17) as corrected at every node.

    Parameters
    ----------
    nodes
        Shape (m, 2) [m].
    sensors
        Shape (n, 2), the reference first [m].
    log_theta
        Shape (..., n - 1): ln (r_i / r_0)^n of the others.
    exponent
        n.

    Returns
    -------
    Shape (..., m), at most 1.
    """
    r = ranges(nodes, sensors)
    table = r / np.linalg.norm(r, axis=1, keepdims=True)
    measured = np.exp(with_reference(log_theta) / exponent)
    measured /= np.linalg.norm(measured, axis=-1, keepdims=True)
    return np.asarray(measured @ table.T)


def squares(
    nodes: Array,
    sensors: Array,
    log_theta: Array,
    exponent: float = EXPONENT,
    sensor_sigma: float | Array = 1.0,
) -> Array:
    """Return the mean square misfit of the logarithms of distances, common part taken off.

    The logarithms of power err independently at the sensors, so those of the ratios do
    not, the reference being in all of them; with the common part free no sensor is special.

    Parameters
    ----------
    nodes, sensors, log_theta, exponent
        As of :func:`correlation`.
    sensor_sigma
        Standard deviation of ln of a sensor's power, one or of each, shape (n,): the misfits weigh
        by the inverse of its square.

    Returns
    -------
    Shape (..., m).
    """
    weights = _weights(sensor_sigma, len(sensors))
    table = _centred(np.log(ranges(nodes, sensors)), weights)
    measured = _centred(with_reference(log_theta) / exponent, weights)
    square = table**2 @ weights + (measured**2 @ weights)[..., None]
    return np.asarray(square - 2 * (weights * measured) @ table.T)


def locate(
    nodes: Array,
    sensors: Array,
    log_theta: Array,
    sensor_sigma: float | Array,
    exponent: float = EXPONENT,
) -> LocationEstimate:
    """Return the place whose logarithms of distance fit best, refined below the table.

    Parameters
    ----------
    nodes, sensors, exponent
        As of :func:`correlation`.
    log_theta
        Shape (n - 1,).
    sensor_sigma
        Standard deviation of ln of a sensor's power, one or of each, shape (n,); of a ratio of two
        alike it is sqrt(2) times that.

    Returns
    -------
    The place; its residual is the root of :func:`squares`. Ties counts the nodes that fit no worse
    than by one standard deviation.
    """
    n = len(sensors)
    misfit = squares(nodes, sensors, log_theta, exponent, sensor_sigma)
    weights = _weights(sensor_sigma, n)
    variance = 1 / np.sum(np.broadcast_to(sensor_sigma / exponent, n) ** -2.0)  # of all together
    measured = _centred(with_reference(log_theta) / exponent, weights)
    position, slopes, residual = _refined(nodes[best_node(-misfit)], sensors, measured, weights)
    information = slopes.T @ slopes
    covariance = np.full((2, 2), np.inf)
    if np.linalg.cond(information) < 1e12:
        covariance = np.linalg.inv(information) * variance
    ties = int((misfit - misfit.min() <= variance).sum())
    x, y = position.tolist()
    return LocationEstimate(x, y, covariance, residual, n, ties)


def _refined(
    position: Array, sensors: Array, measured: Array, weights: Array
) -> tuple[Array, Array, float]:
    """Go downhill from a node; return the place, the slopes there and the residual."""
    damping = 1e-3
    off, slopes = _misfit(position, sensors, measured, weights)
    for _ in range(_STEPS):
        information = slopes.T @ slopes
        ridge = damping * np.trace(information) * np.eye(2)
        step = np.linalg.solve(information + ridge + 1e-12 * np.eye(2), -slopes.T @ off)
        tried, tried_slopes = _misfit(position + step, sensors, measured, weights)
        if tried @ tried <= off @ off:
            position, off, slopes, damping = position + step, tried, tried_slopes, damping / 4
        else:
            damping *= 8
    return position, slopes, float(np.sqrt(off @ off))


def _misfit(
    position: Array, sensors: Array, measured: Array, weights: Array
) -> tuple[Array, Array]:
    """Return misfits and their slopes, each times the root of its weight."""
    r, root = ranges(position, sensors), np.sqrt(weights)
    off = _centred(np.log(r), weights) - measured
    slopes = _centred(((position - sensors) / r[:, None] ** 2).T, weights)
    return root * off, (root * slopes).T


def solve(sensors: Array, log_theta: Array, exponent: float = EXPONENT) -> Array:
    """Solve (16) as corrected for three sensors.

    Parameters
    ----------
    sensors
        Shape (3, 2), the reference first [m].
    log_theta
        Shape (2,): of the other two.
    exponent
        n.

    Returns
    -------
    Shape (k, 2): none, one or two places [m]; two that mirror each other if the sensors stand in
    a line.
    """
    sides = sensors[1:] - sensors[0]
    squared = np.exp(2 / exponent * log_theta)  # of the distances, (r_i / r_0)^2
    # with q = |z|^2: q (1 - a_i) - 2 p_i . z + |p_i|^2 = 0
    length = (sides**2).sum(axis=1)
    area = abs(float(sides[0, 0] * sides[1, 1] - sides[0, 1] * sides[1, 0]))
    if area > 1e-9 * float(length.max()):
        base = np.linalg.solve(2 * sides, length)
        turn = np.linalg.solve(2 * sides, 1 - squared)
        roots = _roots(float(turn @ turn), float(2 * base @ turn - 1), float(base @ base))
        return np.asarray(sensors[0] + base + np.outer(roots, turn))
    along = sides[length.argmax()] / np.sqrt(length.max())
    system = np.stack([1 - squared, -2 * sides @ along], axis=1)
    if abs(np.linalg.det(system)) < 1e-12:
        return np.empty((0, 2))
    q, x = np.linalg.solve(system, -length)
    if q < x * x:
        return np.empty((0, 2))
    y = np.sqrt(q - x * x) * np.array([1.0, -1.0])
    return np.asarray(sensors[0] + x * along + np.outer(y, [-along[1], along[0]]))


def _roots(a: float, b: float, c: float) -> Array:
    """Return the real roots of a q^2 + b q + c, also where a is 0."""
    if abs(a) < 1e-15 * max(abs(b), abs(c)):
        return np.array([-c / b])
    inside = b * b - 4 * a * c
    if inside < 0:
        return np.empty(0)
    # without a difference of nearly equal numbers
    t = -0.5 * (b + np.copysign(np.sqrt(inside), b))
    return np.array([t / a, c / t]) if t else np.array([0.0])


def with_reference(log_theta: Array) -> Array:
    """Return ln theta with that of the reference, 0, in front, shape (..., n)."""
    zero = np.zeros((*log_theta.shape[:-1], 1))
    return np.concatenate([zero, log_theta], axis=-1)


def _weights(sensor_sigma: float | Array, n: int) -> Array:
    """Return weights of n sensors, their sum 1."""
    inverse = np.broadcast_to(sensor_sigma, n) ** -2.0
    return np.asarray(inverse / inverse.sum())


def _centred(values: Array, weights: Array) -> Array:
    return np.asarray(values - (values @ weights)[..., None])
