"""The law of a ground, from the powers of a pass whose track is known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .medium import PowerLaw, clamped, loss_per_m
from .scoring import fit_powers, usable

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class GroundFit:
    """A law fitted to a pass.

    Attributes
    ----------
    law
        mu, n and the loss per metre.
    covariance
        Shape (3, 3): of ln mu, n and the loss per metre; 0 where the loss was not fitted.
    loss_spm, loss_spm_sigma
        rho of (1) and its standard deviation [s/m]; 0 where it was not fitted.
    correlation
        Of n and the loss: near -1 the distances are too alike to tell spreading from loss.
    scatter
        Standard deviation of a power over its mean; the paper's experiments have 1/3.
    samples
        How many powers.
    """

    law: PowerLaw
    covariance: Array
    loss_spm: float
    loss_spm_sigma: float
    correlation: float
    scatter: float
    samples: int

    @property
    def log_mu_sigma(self) -> float:
        """Standard deviation of ln mu."""
        return float(np.sqrt(self.covariance[0, 0]))

    @property
    def exponent_sigma(self) -> float:
        """Standard deviation of n."""
        return float(np.sqrt(self.covariance[1, 1]))


def fit_medium(
    distances_m: Array,
    powers: Array,
    floors: Array | float = 0.0,
    centre_hz: float | None = None,
) -> GroundFit | None:
    """Fit mu, n and rho to powers at known distances.

    Parameters
    ----------
    distances_m
        Shape (cycles, sensors), or (cycles, sensors, moments) with those at several moments evenly
        through a cycle, where the vehicle moves by more than a part of its distance: from the
        known track [m].
    powers
        Shape (cycles, sensors), noise included; NaN or 0 where there is none.
    floors
        Mean power of the noise, of a shape that numpy joins to that.
    centre_hz
        Centre of the band the powers are of [Hz]: the loss is fitted as well. None: there is none.

    Returns
    -------
    The law, or None with fewer than two powers beyond its unknowns, or at one distance only.
    """
    used = usable(powers) & np.isfinite(distances_m.reshape(*powers.shape, -1)).all(axis=-1)
    r = clamped(distances_m.reshape(*powers.shape, -1)[used])
    noise = np.broadcast_to(floors, powers.shape)[used]
    lossy = centre_hz is not None
    if len(r) < 4 + lossy or np.ptp(r) <= 0:
        return None
    columns = [np.ones_like(r), -np.log(r), *([-r] if lossy else [])]
    design = np.stack(columns, axis=-1)

    def mean(values: Array) -> tuple[Array, Array]:
        parts = np.exp(np.clip(design @ values, -600, 600)) / r.shape[1]
        total = parts.sum(axis=1) + noise
        return total, (design * parts[..., None]).sum(axis=1) / total[:, None]

    found = fit_powers(mean, powers[used], _start(design.mean(axis=1), powers[used], noise))
    covariance = np.zeros((3, 3))
    covariance[: 2 + lossy, : 2 + lossy] = found.covariance
    if not np.isfinite(covariance).all():
        return None
    mu, n, loss = (*found.values.tolist(), 0.0)[:3]
    law = PowerLaw(float(np.exp(mu)), n, loss)
    return _ground(law, covariance, found.relative_sigma, len(r), centre_hz)


def _start(design: Array, powers: Array, noise: Array) -> Array:
    """Return the law of the logarithms of powers, weighted by the vehicle's part of them."""
    share = np.clip(1 - noise / powers, 1e-3, 1.0)
    logs = np.log(powers * share)
    return np.asarray(np.linalg.lstsq(design * share[:, None], logs * share, rcond=None)[0])


def _ground(
    law: PowerLaw, covariance: Array, scatter: float, samples: int, centre_hz: float | None
) -> GroundFit:
    if centre_hz is None:
        return GroundFit(law, covariance, 0.0, 0.0, 0.0, scatter, samples)
    unit = loss_per_m(1.0, centre_hz)
    n_sigma, loss_sigma = np.sqrt(np.diag(covariance))[1:].tolist()
    correlation = float(covariance[1, 2] / (n_sigma * loss_sigma))
    rho, rho_sigma = law.loss_per_m / unit, loss_sigma / unit
    return GroundFit(law, covariance, rho, rho_sigma, correlation, scatter, samples)
