"""How well a vector stands still in space once the gyroscope's turning is taken out of it.

Gravity and, over a few seconds, the field of the earth stand still. What a worn sensor feels of
them turns with it; turned back by its gyroscope, integrated from the beginning of a window, it must
stand still again. The spread of the means of the window's blocks says how well it does. A gyroscope
with its axes exchanged, with a wrong sign or in a wrong unit makes it worse, and one of all the
signed permutations of its axes (the rivals) makes it good again. Only the gyroscope is integrated,
so noise and the shaking of steps average out, which a regression of the vector's derivative point
by point does not survive.

All rivals share two integrations. Of a rotation Q and angular velocity w, what Qw turns by is
Q R(w) Q', so that the spread of what it turns back is that of R(w) Q'v: nothing but other sums of
the nine means of R_ki v_j. A mirrored rival is -Qw, for which -w is integrated.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: The signed permutations that are rotations, shape (24, 3, 3), the identity first. Rival i of all
#: 48 is the i-th of these, or minus the (i - 24)-th.
ROTATIONS: Array = np.array(
    sorted(
        (
            np.eye(3)[list(order)] * np.array(signs)[:, None]
            for order in itertools.permutations(range(3))
            for signs in itertools.product((1.0, -1.0), repeat=3)
            if np.linalg.det(np.eye(3)[list(order)] * np.array(signs)[:, None]) > 0
        ),
        key=lambda m: -np.trace(m),
    )
)
RIVALS: Array = np.concatenate([ROTATIONS, -ROTATIONS])
#: What the stated angular velocity is multiplied by: taken as stated, and as if rad/s had been
#: called deg/s, or the other way round.
SCALES = (1.0, 180 / math.pi, math.pi / 180)
#: Samples are averaged down to no less than this [Hz]: in one, a foot turns by 0.3 rad at most.
RATE_HZ = 100.0
#: So many windows are kept before every second one is passed over, and so on: an hour costs little
#: more than ten minutes, and memory hardly grows.
KEPT = 32
#: The median over the windows so far of the means of a gyroscope is its offset and taken out, if it
#: is no more than this [rad/s]: 20 deg/s, the zero-rate tolerance of a cheap one (InvenSense
#: MPU-6050, product specification). More is turning. What is worn turns back, or not, in most
#: windows; and an offset is no reason to change axes.
OFFSET_RADPS = 0.35
#: The units are tried in every so-many-th window that is kept: they are told by far more.
UNITS_EVERY = 4
#: Spreads are kept this far above nothing, so that a signal without noise has a logarithm.
_FLOOR = 1e-9


def rival_of(matrix: Array) -> int:
    """Return which rival a signed permutation is."""
    return int(np.flatnonzero((np.abs(RIVALS - matrix) < 0.5).all(axis=(1, 2)))[0])


@dataclass(slots=True)
class Spreads:
    """Logarithms of spreads, window by window.

    Attributes
    ----------
    window_s, blocks
        Length of a window [s], and of how many blocks it is; windows overlap by half.
    scaled
        Whether the gyroscope is tried in other units, too.
    rivals
        Of each window, shape (48,).
    lengths
        Of each window the logarithm of the length of the mean of all that was turned back, shape
        (48,). Spun about, anything has means that hardly differ, because little is left of it; what
        stands still keeps its length.
    units
        Of some of the windows in every unit, shape (3, 48): of spreads over that length.
    units_still
        The same with no turning at all.
    still
        Of each window, with no turning at all.
    turning, shaking
        Of each window: root mean square of the angular velocity about its mean [rad/s], standard
        deviation of the vector's length.
    first_ns, last_ns
        From the beginning of the first window that was kept to the end of the last [ns].
    """

    window_s: float
    blocks: int
    scaled: bool
    rivals: list[Array] = field(default_factory=list)
    lengths: list[Array] = field(default_factory=list)
    units: list[Array] = field(default_factory=list)
    units_still: list[float] = field(default_factory=list)
    still: list[float] = field(default_factory=list)
    turning: list[float] = field(default_factory=list)
    shaking: list[float] = field(default_factory=list)
    first_ns: int = 0
    last_ns: int = 0
    _rows: Array = field(default_factory=lambda: np.empty((0, 6)))
    _means: list[Array] = field(default_factory=list)
    _place: int = 0
    _every: int = 1

    def __len__(self) -> int:
        return len(self.rivals)

    def gap(self) -> None:
        """Begin a new run."""
        self._rows = np.empty((0, 6))

    def hear(self, rows: Array, rate_hz: float, end_ns: int) -> None:
        """Take samples: angular velocity and vector, shape (n, 6), and the last one's time [ns]."""
        self._rows = np.concatenate([self._rows, rows])
        count = round(self.window_s * rate_hz)
        while len(self._rows) >= count:
            if self._place % self._every == 0:
                self._judge(self._rows[:count], rate_hz)
                self.last_ns = end_ns - round((len(self._rows) - count) / rate_hz * NS_PER_S)
                began_ns = self.last_ns - round((count - 1) / rate_hz * NS_PER_S)
                self.first_ns = self.first_ns or began_ns
            self._place += 1
            self._rows = self._rows[count // 2 :]

    def _judge(self, rows: Array, rate_hz: float) -> None:
        if not np.isfinite(rows).all():
            return
        rate, vector = rows[:, :3], rows[:, 3:]
        taper = np.hanning(len(rate))  # of a swing that is cut short nothing is left
        self._means.append(taper @ rate / taper.sum())
        offset = np.median(self._means, axis=0)
        if float(np.abs(offset).max()) < OFFSET_RADPS:
            rate = rate - offset
        step = np.zeros_like(rate)
        step[1:] = (rate[1:] + rate[:-1]) / (2 * rate_hz)
        scaled = self.scaled and len(self.rivals) % UNITS_EVERY == 0
        scales = SCALES if scaled else SCALES[:1]
        turned = rotations(np.stack([s * scale * step for scale in scales for s in (1, -1)]))
        edges = np.linspace(0, len(rows), self.blocks + 1).astype(int)
        spreads, lengths = (
            np.log(x.reshape(len(scales), 48) + _FLOOR) for x in _spreads(turned, vector, edges)
        )
        means = np.stack([vector[a:b].mean(axis=0) for a, b in itertools.pairwise(edges)])
        still = math.log(_spread(means) + _FLOOR)
        if scaled:
            length = float(np.linalg.norm(means.mean(axis=0)))
            self.units.append(spreads - lengths)
            self.units_still.append(still - math.log(length + _FLOOR))
        self.rivals.append(spreads[0])
        self.lengths.append(lengths[0])
        self.still.append(still)
        self.turning.append(math.sqrt(float(((rate - rate.mean(axis=0)) ** 2).sum(axis=1).mean())))
        self.shaking.append(float(np.linalg.norm(vector, axis=1).std()))
        if len(self.rivals) % KEPT == 0:
            self._every *= 2


def _spread(means: Array) -> float:
    """Return how far means of blocks, shape (n_blocks, 3), are from their mean."""
    return math.sqrt(float(((means - means.mean(axis=0)) ** 2).sum() / len(means)))


def _spreads(turned: Array, vector: Array, edges: NDArray[np.intp]) -> tuple[Array, Array]:
    """Return the spread by every rotation of each of the integrated, and the length of its mean.

    Both of shape (n, 24).

    Parameters
    ----------
    turned
        Rotations to the beginning of the window, shape (n, 3, 3, n_samples).
    vector
        Shape (n_samples, 3).
    edges
        Where blocks begin and end.
    """
    flat = turned.reshape(-1, turned.shape[-1])
    blocks = np.stack(
        [flat[:, a:b] @ vector[a:b] / (b - a) for a, b in itertools.pairwise(edges)], axis=0
    ).reshape(len(edges) - 1, len(turned), 3, 3, 3)  # block, integration, k, i, j
    # R (Q'v) of every rotation Q: component k is the sum over i, j of R_ki Q_ji v_j
    means = np.einsum("bhkij,qji->qhbk", blocks, ROTATIONS)
    middle = means.mean(axis=2, keepdims=True)
    spreads: Array = np.sqrt(((means - middle) ** 2).sum(axis=(2, 3)) / means.shape[2])
    lengths: Array = np.sqrt((middle**2).sum(axis=(2, 3)))
    return spreads.T, lengths.T


def rotations(steps: Array) -> Array:
    """Return the rotation of each sample's axes to those of the first, from the turns in between.

    Parameters
    ----------
    steps
        Rotation vectors from each sample to the one before, shape (..., n, 3) [rad].

    Returns
    -------
    numpy.ndarray
        Matrices, shape (..., 3, 3, n).
    """
    angle = np.sqrt((steps**2).sum(axis=-1))
    part = np.sinc(angle / (2 * np.pi)) / 2  # sin(angle / 2) / angle
    turn = [np.cos(angle / 2), *(steps[..., k] * part for k in range(3))]
    length, done = steps.shape[-2], 1
    while done < length:  # products of twice as many samples each time
        later = _product([q[..., :-done] for q in turn], [q[..., done:] for q in turn])
        turn = [
            np.concatenate([q[..., :done], x], axis=-1) for q, x in zip(turn, later, strict=True)
        ]
        done *= 2
    w, x, y, z = turn
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-2) for row in rows], axis=-3)


def _product(a: list[Array], b: list[Array]) -> list[Array]:
    """Return products of unit quaternions."""
    w, x, y, z = a
    p, q, r, s = b
    return [
        w * p - x * q - y * r - z * s,
        w * q + x * p + y * s - z * r,
        w * r - x * s + y * p + z * q,
        w * s + x * r - y * q + z * p,
    ]
