"""Butterworth filters as second-order sections, and their steady state.

scipy.signal has them too, and imports all of statistics, optimisation and interpolation: most of a
second before the first sample. The order of operations is that of scipy, and so are the bits.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray


def butterworth(
    order: int, edges_hz: Sequence[float], rate_hz: float, *, highpass: bool = False
) -> NDArray[np.float64]:
    """Design a digital Butterworth filter by the bilinear transform.

    Source: T. W. Parks, C. S. Burrus, Digital Filter Design, 1987, chapter 7: the poles of the
    analogue low-pass, moved to the corners, which are warped before.

    Parameters
    ----------
    order
        Of the analogue low-pass, at least 1; a band-pass has twice as many poles.
    edges_hz
        The corner, or both of a band-pass [Hz], rising, within 0 < f < rate / 2.
    rate_hz
        Sampling rate [Hz].
    highpass
        With one corner: let pass what lies above it.

    Returns
    -------
    Second-order sections, shape (n_sections, 6); the poles nearest to the unit circle come last.
    """
    return _designed(order, tuple(edges_hz), rate_hz, highpass=highpass).copy()


@cache
def _designed(
    order: int, edges_hz: tuple[float, ...], rate_hz: float, *, highpass: bool
) -> NDArray[np.float64]:
    warped = 4.0 * np.tan(np.pi * (np.asarray(edges_hz, np.float64) / (rate_hz / 2)) / 2.0)
    poles = -np.exp(1j * np.pi * np.arange(1.0 - order, order, 2) / (2 * order))
    zeros = np.zeros(0 if len(warped) == 1 and not highpass else order)
    if len(warped) == 2:
        width, middle = float(warped[1] - warped[0]), float(np.sqrt(warped[0] * warped[1]))
        poles = poles * width / 2
        apart = np.sqrt(poles**2 - middle**2)
        poles, gain = np.concatenate([poles + apart, poles - apart]), width**order
    elif highpass:
        poles, gain = float(warped[0]) / poles, float(np.real(1.0 / np.prod(-poles)))
    else:
        poles, gain = float(warped[0]) * poles, float(warped[0]) ** order
    gain = gain * float(np.real(np.prod(4.0 - zeros) / np.prod(4.0 - poles)))
    nyquist = np.full(len(poles) - len(zeros), -1.0)
    zeros = np.concatenate([(4.0 + zeros) / (4.0 - zeros), nyquist])
    sections = _sections(zeros, (4.0 + poles) / (4.0 - poles))
    sections[0, :3] *= gain
    return sections


def _sections(zeros: NDArray[np.float64], poles: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Pair poles, the nearest to the unit circle first, with the zeros nearest to them."""
    if len(poles) % 2:
        zeros, poles = np.append(zeros, 0.0), np.append(poles, 0.0)
    sections = np.zeros((len(poles) // 2, 6))
    upper, real = poles[poles.imag > 0], poles[poles.imag == 0]
    upper = upper[np.lexsort((upper.imag, upper.real))]
    left = [*upper.tolist(), *np.sort(real.real).tolist()]
    zeros = np.sort(zeros)
    for section in sections[::-1]:
        pair = [left.pop(_nearest_circle(left))]
        if isinstance(pair[0], complex):
            pair.append(pair[0].conjugate())
        else:
            reals = [i for i, pole in enumerate(left) if not isinstance(pole, complex)]
            pair.append(left.pop(reals[_nearest_circle([left[i] for i in reals])]))
        near = []
        for _ in range(2):
            index = int(np.argmin(np.abs(zeros - pair[0])))
            near.append(zeros[index])
            zeros = np.delete(zeros, index)
        section[:] = [*np.poly(near), *np.poly(pair)]
    return sections


def _nearest_circle(poles: Sequence[complex]) -> int:
    return int(np.argmin(np.abs(1 - np.abs(poles))))


def steady_state(sos: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return what second-order sections hold after a long row of ones, shape (n_sections, 2)."""
    held = np.empty((len(sos), 2))
    scale = 1.0
    for section, state in zip(sos, held, strict=True):
        b, a = section[:3], section[3:]
        state[:] = np.linalg.solve([[1 + a[1], -1.0], [a[2], 1.0]], b[1:] - a[1:] * b[0]) * scale
        scale *= b.sum() / a.sum()
    return held
