"""The smoothing of a foot's knots, and the gain of any smoothing, compiled.

Every moment of a finished walk is seen in the light of all stances after it as well. Source: H. E.
Rauch, F. Tung, C. T. Striebel: Maximum likelihood estimates of linear dynamic systems, AIAA Journal
3 (1965), for the error state: what is smoothed is the difference from the pose that was predicted.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..compiled import compiled, in_place
from ..heading.rotation_kernels import carry, held, product, times
from ..lanes import LANES, every, put_row, row
from .strapdown_kernels import POSE
from .walk_kernels import SIZE, move

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: Least variance of a part of a state, where the others' are 1.
_KNOWN = 1e-12


@in_place
def error_between(pose: Array, other: Array, out: Array) -> None:
    """Put the error state that moves the ``other`` pose to a pose in ``out``, shape (15,)."""
    turned = times(held(pose), (other[0], -other[1], -other[2], -other[3]))
    # small turns: twice the vector part, of the quaternion whose scalar part is positive
    sign = math.copysign(2.0, turned[0])
    for i in range(3):
        out[i] = sign * turned[i + 1]
    for i in range(3, SIZE):
        out[i] = pose[i + 1] - other[i + 1]


@in_place
def factored(matrix: Array, least: float) -> None:
    """Put the upper factor U of a covariance U' U in its place; no pivot is below ``least``.

    Shape (n, m), m a multiple of LANES; what lies left of the factor's diagonal means nothing.
    """
    groups = matrix.shape[1] // LANES
    for i in range(len(matrix)):
        for g in range(i // LANES, groups):
            left = row(matrix, i * groups + g)
            for r in range(i):
                left = left - every(matrix[r, i]) * row(matrix, r * groups + g)
            put_row(matrix, i * groups + g, left)
        share = every(1.0 / math.sqrt(max(matrix[i, i], least)))
        for g in range(i // LANES, groups):
            put_row(matrix, i * groups + g, share * row(matrix, i * groups + g))


@in_place
def solve_factored(upper: Array, sides: Array) -> None:
    """Solve ``U' U x = sides`` in place, shapes (n, m) and (n, k), k a multiple of LANES."""
    n, groups = len(sides), sides.shape[1] // LANES
    for g in range(groups):
        for i in range(n):
            left = row(sides, i * groups + g)
            for r in range(i):
                left = left - every(upper[r, i]) * row(sides, r * groups + g)
            put_row(sides, i * groups + g, every(1.0 / upper[i, i]) * left)
        for i in range(n - 1, -1, -1):
            left = row(sides, i * groups + g)
            for r in range(i + 1, n):
                left = left - every(upper[i, r]) * row(sides, r * groups + g)
            put_row(sides, i * groups + g, every(1.0 / upper[i, i]) * left)


@compiled
def gain_room(n: int) -> Array:
    """Return what :func:`gain_of` writes over."""
    return np.zeros((2, n + 1, -(-n // LANES) * LANES))


@in_place
def gain_of(spread: Array, step: Array, predicted: Array, room: Array, gain: Array) -> None:
    """Put ``spread @ step.T`` times the inverse of ``predicted`` in ``gain``, shape (n, n).

    Rows of that matrix differ much.
    """
    n = len(spread)
    # the transpose of what is wanted
    sides, even, scale = room[0, :n], room[1, :n], room[0, n]
    product(step, spread, sides)
    for i in range(n):
        scale[i] = 1.0 / math.sqrt(max(predicted[i, i], 1e-30))
    for i in range(n):
        for k in range(n):
            even[i, k] = predicted[i, k] * scale[i] * scale[k]
            sides[i, k] *= scale[i]
        even[i, i] += _KNOWN  # the heading may be known exactly at the start
    factored(even, _KNOWN)
    solve_factored(even, sides)
    for i in range(n):
        for k in range(n):
            gain[k, i] = sides[i, k] * scale[i]


@compiled
def smooth(
    poses: Array,
    spreads: Array,
    guesses: Array,
    wide: Array,
    moves: Array,
    guess: Array,
    widest: Array,
    step: Array,
    pose: Array,
    spread: Array,
) -> tuple[Array, Array]:
    """Smooth knots backward; return their poses, shape (n, 16), and covariances' planar parts.

    Parameters
    ----------
    poses, spreads
        Of the knots, shapes (n, 16) and (n, 15, 15).
    guesses, wide, moves
        What was predicted of them, its covariance, and the transition to them.
    guess, widest, step
        The same of the knot after the last.
    pose, spread
        Of that knot, smoothed; both go on in place.
    """
    count = len(poses)
    found, planar = np.empty((count, POSE)), np.empty((count, 3))
    off, room, rooms = np.empty((SIZE, SIZE)), np.empty((2, SIZE, SIZE)), gain_room(SIZE)
    gain, error, change = np.empty((SIZE, SIZE)), np.empty(SIZE), np.empty(SIZE)
    for i in range(count - 1, -1, -1):
        gain_of(spreads[i], step, widest, rooms, gain)
        error_between(pose, guess, error)
        for r in range(SIZE):
            change[r] = 0.0
            for k in range(SIZE):
                change[r] += gain[r, k] * error[k]
                off[r, k] = spread[r, k] - widest[r, k]
        pose[:] = poses[i]
        move(pose, change)
        carry(gain, off, room)
        for r in range(SIZE):
            for k in range(SIZE):
                spread[r, k] = spreads[i, r, k] + off[r, k]
        found[i] = pose
        planar[i, 0], planar[i, 1], planar[i, 2] = spread[6, 6], spread[6, 7], spread[7, 7]
        guess, widest, step = guesses[i], wide[i], moves[i]
    return found, planar
