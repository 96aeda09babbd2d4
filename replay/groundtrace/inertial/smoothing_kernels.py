"""The smoothing of a foot's knots, and the gain of any smoothing, compiled.

Every moment of a finished walk is seen in the light of all stances after it as well. Source: H. E.
Rauch, F. Tung, C. T. Striebel: Maximum likelihood estimates of linear dynamic systems, AIAA Journal
3 (1965), for the error state: what is smoothed is the difference from the pose that was predicted.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..compiled import compiled
from ..heading.rotation_kernels import carry, multiply, product
from .walk_kernels import POSE, SIZE, SPEED, move

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: Least variance of a part of a state, where the others' are 1.
_KNOWN = 1e-12


@compiled
def error_between(pose: Array, other: Array) -> Array:
    """Return the error state that moves the ``other`` pose to a pose, shape (15,)."""
    out, back, turned = np.empty(SIZE), np.empty(4), np.empty(4)
    back[0], back[1], back[2], back[3] = other[0], -other[1], -other[2], -other[3]
    multiply(pose[:SPEED], back, turned)
    # small turns: twice the vector part, of the quaternion whose scalar part is positive
    sign = math.copysign(2.0, turned[0])
    for i in range(3):
        out[i] = sign * turned[i + 1]
    for i in range(3, SIZE):
        out[i] = pose[i + 1] - other[i + 1]
    return out


@compiled
def factored(matrix: Array, least: float) -> None:
    """Put the upper factor U of a covariance U' U in its place; no pivot is below ``least``."""
    n = len(matrix)
    for i in range(n):
        share = 1.0 / math.sqrt(max(matrix[i, i], least))
        for k in range(i, n):
            matrix[i, k] *= share
        for r in range(i + 1, n):
            share = matrix[i, r]
            for k in range(r, n):
                matrix[r, k] -= share * matrix[i, k]


@compiled
def solve_factored(upper: Array, sides: Array) -> None:
    """Solve ``U' U x = sides`` in place, shapes (n, n) and (n, k)."""
    n, width = sides.shape
    for i in range(n):
        for r in range(i):
            share = upper[r, i]
            for k in range(width):
                sides[i, k] -= share * sides[r, k]
        share = 1.0 / upper[i, i]
        for k in range(width):
            sides[i, k] *= share
    for i in range(n - 1, -1, -1):
        for r in range(i + 1, n):
            share = upper[i, r]
            for k in range(width):
                sides[i, k] -= share * sides[r, k]
        share = 1.0 / upper[i, i]
        for k in range(width):
            sides[i, k] *= share


@compiled
def gain_of(spread: Array, step: Array, predicted: Array) -> Array:
    """Return ``spread @ step.T`` times the inverse of ``predicted``, rows of which differ much."""
    n = len(spread)
    # the transpose of what is wanted
    sides, even, scale = product(step, spread), np.empty((n, n)), np.empty(n)
    for i in range(n):
        scale[i] = 1.0 / math.sqrt(max(predicted[i, i], 1e-30))
    for i in range(n):
        for k in range(n):
            even[i, k] = predicted[i, k] * scale[i] * scale[k]
            sides[i, k] *= scale[i]
        even[i, i] += _KNOWN  # the heading may be known exactly at the start
    factored(even, _KNOWN)
    solve_factored(even, sides)
    gain = np.empty((n, n))
    for i in range(n):
        for k in range(n):
            gain[k, i] = sides[i, k] * scale[i]
    return gain


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
    off = np.empty((SIZE, SIZE))
    for i in range(count - 1, -1, -1):
        gain = gain_of(spreads[i], step, widest)
        error, change = error_between(pose, guess), np.zeros(SIZE)
        for r in range(SIZE):
            for k in range(SIZE):
                change[r] += gain[r, k] * error[k]
                off[r, k] = spread[r, k] - widest[r, k]
        pose[:] = poses[i]
        move(pose, change)
        carried = carry(gain, off)
        for r in range(SIZE):
            for k in range(SIZE):
                spread[r, k] = spreads[i, r, k] + carried[r, k]
        found[i] = pose
        planar[i, 0], planar[i, 1], planar[i, 2] = spread[6, 6], spread[6, 7], spread[7, 7]
        guess, widest, step = guesses[i], wide[i], moves[i]
    return found, planar
