"""How strongly each sensor saw each impact of a recording."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S, SEISMIC_QUANTITIES, SignalBlock

from ..source import Source

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.geometry import Geometry
    from groundtrace_codecs.labels import Label
    from groundtrace_codecs.recording import Recording

    Array = NDArray[np.float64]

#: The wave of an impact lies within so long after it; the noise is measured so long before it [ns].
AFTER_NS, BEFORE_NS = NS_PER_S // 10, NS_PER_S // 20
#: Peaks lower than so many times the noise's root mean square tell nothing.
LEAST_SNR = 5.0


def impacts_of(labels: Sequence[Label]) -> list[Label]:
    """Return the steps and impacts whose place is known, in order of time."""
    known = [x for x in labels if x.kind in ("step", "impact") and x.x_m is not None]
    return sorted((x for x in known if x.y_m is not None), key=lambda x: x.time_ns)


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
