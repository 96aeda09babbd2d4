"""How amplitude falls with distance: A = A0 d^-n exp(-alpha d), over many impacts at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S, SEISMIC_QUANTITIES, SignalBlock

from ..dsp.robust import HUBER, MAD_SIGMA
from ..pipeline.source import Source

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Label
    from groundtrace_codecs.geometry import Geometry
    from groundtrace_codecs.recording import Recording

    Array = NDArray[np.float64]

#: Reweightings. Chosen by judgement: they settle in fewer.
PASSES = 20


@dataclass(frozen=True, slots=True)
class Attenuation:
    """A law of attenuation.

    Attributes
    ----------
    exponent, exponent_sigma
        n and its standard deviation; 1/3 for the maximum of a floor's bending wave ((4.25) of the
        thesis), 1/2 for a surface wave of one frequency, 1 for a body wave.
    loss_per_m, loss_sigma
        alpha and its standard deviation [1/m].
    scatter
        Robust standard deviation of ln A about the law: coupling and radiation pattern.
    correlation
        Of n and alpha: near -1 the distances are too alike to tell spreading from loss.
    samples
        How many amplitudes.
    """

    exponent: float
    exponent_sigma: float
    loss_per_m: float
    loss_sigma: float
    scatter: float
    correlation: float
    samples: int


def fit_attenuation(distances_m: Array, amplitudes: Array) -> Attenuation | None:
    """Fit one law to the amplitudes of many impacts, each with a strength of its own.

    Parameters
    ----------
    distances_m
        Shape (impacts, sensors) [m].
    amplitudes
        Shape (impacts, sensors), in any one unit; NaN or 0 where a sensor saw nothing.

    Returns
    -------
    The law, or None where fewer than two amplitudes of an impact, or fewer than four beyond the
    strengths, leave it open.
    """
    seen = np.isfinite(amplitudes) & (amplitudes > 0) & (distances_m > 0)
    seen &= seen.sum(axis=1, keepdims=True) >= 2
    impact, _ = np.nonzero(seen)
    free = len(impact) - len(np.unique(impact)) - 2
    if free < 2:
        return None
    logs = np.log(amplitudes[seen])
    terms = np.stack([-np.log(distances_m[seen]), -distances_m[seen]], axis=1)
    weights = np.ones(len(logs))
    for _ in range(PASSES):
        y, x = (_within(v, impact, weights) for v in (logs, terms))
        information = x.T @ (x * weights[:, None])
        if np.linalg.cond(information) > 1e12:
            return None
        law = np.linalg.solve(information, x.T @ (weights * y))
        off = y - x @ law
        scatter = max(MAD_SIGMA * float(np.median(np.abs(off))), 1e-9)
        scatter *= float(np.sqrt(len(logs) / (free + 2)))
        weights = np.minimum(1.0, HUBER * scatter / np.maximum(np.abs(off), 1e-12))
    covariance = np.linalg.inv(information) * scatter**2
    n_sigma, loss_sigma = np.sqrt(np.diag(covariance)).tolist()
    correlation = float(covariance[0, 1] / (n_sigma * loss_sigma))
    n, loss = law.tolist()
    return Attenuation(n, n_sigma, loss, loss_sigma, scatter, correlation, len(logs))


def _within(values: Array, group: NDArray[np.intp], weights: Array) -> Array:
    """Return values less the weighted mean of their group: each impact has its own strength."""
    shape = (group.max() + 1, *values.shape[1:])
    sums, totals = np.zeros(shape), np.zeros(shape[0])
    spread = weights if values.ndim == 1 else weights[:, None]
    np.add.at(sums, group, values * spread)
    np.add.at(totals, group, weights)
    with np.errstate(invalid="ignore", divide="ignore"):
        means = (sums.T / totals).T
    centred: Array = values - means[group]
    return centred


#: The wave of an impact lies within so long after it; the noise is measured so long before it [ns].
#: Chosen by judgement: most of the 200 ms that a step's signal lasts at most (thesis, section 3.2),
#: and quiet between two steps.
AFTER_NS, BEFORE_NS = NS_PER_S // 10, NS_PER_S // 20
#: Peaks lower than so many times the noise's root mean square tell nothing. Chosen by judgement:
#: the largest of some thousand samples of noise is four deviations.
LEAST_SNR = 5.0


def impacts_of(labels: Sequence[Label]) -> list[Label]:
    """Return the steps and impacts whose place is known, in order of time."""
    located = [x for x in labels if x.kind in ("step", "impact") and x.x_m is not None]
    return sorted((x for x in located if x.y_m is not None), key=lambda x: x.time_ns)


def amplitudes(
    recording: Recording, geometry: Geometry, impacts: Sequence[Label]
) -> tuple[Array, Array]:
    """Return how far each impact was from each sensor, and how high its wave was there.

    Returns
    -------
    distances, peaks
        Shape (impacts, sensors): [m], and in the channels' unit; NaN under the noise.
    """
    names = [c.name for s in recording.streams for c in s.channels]
    rows, positions = geometry.placed(names)
    places = np.array([(x.x_m, x.y_m) for x in impacts], np.float64).reshape(-1, 2)
    distances = np.hypot(*(positions[None] - places[:, None]).transpose(2, 0, 1))
    times = np.array([x.time_ns for x in impacts], np.int64)
    peaks, squares, counts = (np.zeros(distances.shape) for _ in range(3))
    for block in Source(recording):
        if isinstance(block, SignalBlock):
            _add(block, rows, times, (peaks, squares, counts))
    noise = np.sqrt(squares / np.maximum(counts, 1))
    return distances, np.where(peaks > LEAST_SNR * noise, peaks, np.nan)


def _add(
    block: SignalBlock,
    rows: dict[str, int],
    times: NDArray[np.int64],
    into: tuple[Array, Array, Array],
) -> None:
    """Take in the peaks and the noise of the impacts that a block reaches."""
    peaks, squares, counts = into
    columns = [
        i
        for i, c in enumerate(block.stream.channels)
        if c.name in rows and c.quantity in SEISMIC_QUANTITIES
    ]
    index = [rows[block.stream.channels[i].name] for i in columns]
    near = (times > block.start_ns - AFTER_NS) & (times < block.end_ns + BEFORE_NS)
    for impact in np.flatnonzero(near) if columns else ():
        at = int(times[impact])
        wave = block.between(at, at + AFTER_NS).values[:, columns]
        if len(wave):
            peaks[impact, index] = np.maximum(peaks[impact, index], np.abs(wave).max(axis=0))
        before = block.between(at - BEFORE_NS, at).values[:, columns]
        squares[impact, index] += (before**2).sum(axis=0)
        counts[impact, index] += len(before)
