"""Which axes and unit of a gyroscope fit the acceleration and the field that came with it.

A hypothesis is one sensor whose columns carry the wrong axes or signs. Acceleration and field each
judge the gyroscope (:mod:`.turning`), so that with a field it is told which of the three is the odd
one out. What cannot be told: a sign of all three axes of acceleration or of field (turned round,
they stand as still), and axes about which nothing turned; of what fits equally the least change to
the map is named.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .turning import RIVALS, SCALES, rival_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from .turning import Array, Spreads

    Mask = NDArray[np.bool_]

#: A rival fits better whose spread is smaller by this mean of logarithms, so many standard errors
#: from nothing, in so many windows at least. Named by issue with the windows' lengths; on 7 trials
#: of BROAD and 2 recordings of mobgap no rival at the stated scale comes near (0.12 at most), on
#: the recordings that bench/corrupted_inputs.py reports none is told.
RATIO, ERRORS, LEAST_WINDOWS = 0.2, 3.0, 5
#: What fits worse than the best by less than this, or by fewer standard errors, fits as well.
#: Chosen on BROAD and mobgap (bench/corrupted_inputs.py), where more names other axes.
EQUAL, EQUAL_ERRORS = 0.1, 2.0
#: Stated in deg/s and called rad/s, a gyroscope turns so much for 8 s [rad/s, root mean square
#: about its mean], or e times this farther than gravity turns. What is worn reaches 6 rad/s (the
#: foot and the swung board of BROAD and LLIO); what hardly moves reaches 57 times 0.2 rad/s.
TOO_FAST_RADPS, TOO_FAR = 10.0, 1.0
#: Stated in rad/s and called deg/s, it turns by less than this for each m/s2 that a walker shakes
#: it [rad/s per m/s2]: waist and board of mobgap and BROAD lie from 0.3 to 1.3, 57 times less is
#: 0.023 at most. Looked at where the length of acceleration has such a standard deviation [m/s2].
LEAST_TURN, SHAKEN_MPS2 = 0.06, 0.8


@dataclass(frozen=True, slots=True, eq=False)
class Judge:
    """What the windows of one vector say of the gyroscope.

    Attributes
    ----------
    quantity
        ``acceleration`` or ``magnetic_field``.
    gain
        Logarithm of the stated spread over a rival's, shape (n_windows, 48).
    kept
        The same of spreads over the length that is left, mean, shape (48,).
    still
        Logarithm of the spread without turning over a rival's, mean, shape (48,).
    spreads
        Where they come from.
    """

    quantity: str
    gain: Array
    kept: Array
    still: Array
    spreads: Spreads

    @classmethod
    def of(cls, quantity: str, spreads: Spreads) -> Judge | None:
        """Return the judge; None with too few windows to judge by."""
        if len(spreads) < LEAST_WINDOWS:
            return None
        rivals = np.array(spreads.rivals)
        still = (np.array(spreads.still)[:, None] - rivals).mean(axis=0)
        left = rivals - np.array(spreads.lengths)
        kept = (left[:, :1] - left).mean(axis=0)
        return cls(quantity, rivals[:, :1] - rivals, kept, still, spreads)

    @property
    def better(self) -> Mask:
        """Which rivals fit better than what is stated, shape (48,).

        Not those that leave less of the vector, and its spread with it.
        A field that moves with the sensor (iron in it) stands stillest with no turning at all, and
        judges no axes.
        """
        mean, errors = told(self.gain)
        fits: Mask = (mean > RATIO) & (errors > ERRORS) & (self.kept > 0)
        return fits if self.quantity == "acceleration" else fits & (self.still > 0)

    @property
    def worse(self) -> int:
        """How many of the 47 rivals fit worse than what is stated."""
        mean, errors = told(self.gain)
        return int(((mean < -RATIO) & (errors < -ERRORS)).sum())

    @property
    def silent(self) -> bool:
        """Whether neither what is stated nor any rival stands stiller than without turning."""
        return self.quantity == "magnetic_field" and bool((self.still <= 0).all())


def told(values: Array) -> tuple[Array, Array]:
    """Return means over windows, and how many standard errors they are from 0."""
    mean = values.mean(axis=0)
    error = values.std(axis=0, ddof=1) / math.sqrt(len(values))
    return mean, mean / np.maximum(error, 1e-9)


@dataclass(frozen=True, slots=True, eq=False)
class AxisMap:
    """Axes of one sensor that fit.

    Attributes
    ----------
    quantity
        Whose.
    matrix
        The axes are this signed permutation of the stated ones, shape (3, 3).
    """

    quantity: str
    matrix: Array

    @property
    def changes(self) -> int:
        """How many changes to the map it is: exchanges and signs; all three signs are one."""
        exchanged = 3 - int((np.abs(np.diag(self.matrix)) > 0.5).sum())
        signs = int((self.matrix.sum(axis=1) < 0).sum())
        return max(exchanged - 1, 0) + (1 if signs == 3 else signs)

    def seen_by(self, judge: str) -> int:
        """Return which rival gyroscope a judge sees where these axes are the true ones."""
        if self.quantity == "angular_velocity":
            return rival_of(self.matrix)
        if self.quantity != judge:
            return 0
        # turned back, Mv is spread as by the gyroscope M'w; a mirror image as the turned one
        sign = 1.0 if np.linalg.det(self.matrix) > 0 else -1.0
        return rival_of(sign * self.matrix.T)

    @property
    def columns(self) -> str:
        """The change as it is made to the columns of a map."""
        if (self.matrix == -np.eye(3)).all():
            return f"{self.quantity}: each axis gets scale = -1 (its frame is left-handed)"
        said = []
        for column in range(3):
            axis = int(np.argmax(np.abs(self.matrix[:, column])))
            minus = self.matrix[axis, column] < 0
            if axis != column:
                also = ", scale = -1" if minus else ""
                said.append(f'axis = "{"xyz"[column]}" becomes axis = "{"xyz"[axis]}"{also}')
            elif minus:
                said.append(f'axis = "{"xyz"[column]}" gets scale = -1')
        return f"{self.quantity}: {'; '.join(said)}"


@dataclass(frozen=True, slots=True, eq=False)
class Contradiction:
    """What is stated of the axes does not fit.

    Attributes
    ----------
    fits
        The axes that do.
    others
        Axes of another sensor that fit as well and are as simple.
    equal
        How many more signed permutations fit as well.
    judge
        The vector that says so most clearly.
    ratio
        How many times farther it wanders with the axes that are stated.
    errors
        How many standard errors that is from 1, as logarithms.
    """

    fits: AxisMap
    others: tuple[AxisMap, ...]
    equal: int
    judge: Judge
    ratio: float
    errors: float

    def seen_by(self, judge: str) -> bool:
        """Return whether a judge has something against the axes that are stated."""
        return any(each.seen_by(judge) != 0 for each in (self.fits, *self.others))


def contradiction(judges: Sequence[Judge]) -> Contradiction | None:
    """Return which axes fit better than the stated ones; None where none do."""
    quantities = ["angular_velocity", *(j.quantity for j in judges)]
    maps = [AxisMap(q, m) for q in quantities for m in RIVALS[1:]]
    # a full sign of a vector is not seen by anyone
    seen = [[m.seen_by(j.quantity) for j in judges] for m in maps]
    gains = np.array(
        [sum(float(j.gain[:, i].mean()) for j, i in zip(judges, row, strict=True)) for row in seen]
    )
    able = [
        gain > RATIO and any(j.better[i] for j, i in zip(judges, row, strict=True))
        for gain, row in zip(gains.tolist(), seen, strict=True)
    ]
    if not any(able):
        return None
    best = int(np.argmax(np.where(able, gains, -np.inf)))
    equal = [k for k in range(len(maps)) if able[k] and _as_good(judges, seen[k], seen[best])]
    equal.sort(key=lambda k: (maps[k].changes, -gains[k]))
    first = equal[0]
    said = {maps[first].quantity}
    others = []
    for k in equal[1:]:
        if maps[k].changes == maps[first].changes and maps[k].quantity not in said:
            said.add(maps[k].quantity)
            others.append(maps[k])
    clearest = max(range(len(judges)), key=lambda n: told(judges[n].gain)[1][seen[first][n]])
    # an acceleration or a field turned round altogether is the same to its judge
    distinct = {tuple(seen[k]) for k in equal}
    named = {tuple(seen[first]), *(tuple(o.seen_by(j.quantity) for j in judges) for o in others)}
    mean, errors = (x[seen[first][clearest]] for x in told(judges[clearest].gain))
    return Contradiction(
        maps[first],
        tuple(others),
        len(distinct - named),
        judges[clearest],
        math.exp(float(mean)),
        float(errors),
    )


def _as_good(judges: Sequence[Judge], one: Sequence[int], best: Sequence[int]) -> bool:
    """Return whether one row of rivals fits as well as the best row."""
    lost, variance = 0.0, 0.0
    for judge, i, k in zip(judges, one, best, strict=True):
        less = judge.gain[:, k] - judge.gain[:, i]
        lost += float(less.mean())
        variance += float(less.var(ddof=1)) / len(less)
    return lost < EQUAL or lost < EQUAL_ERRORS * math.sqrt(variance)


@dataclass(frozen=True, slots=True)
class WrongUnit:
    """The unit of the gyroscope does not fit.

    Attributes
    ----------
    stated, fits
        The unit it was taken for, and the one that fits.
    evidence
        By which numbers, for people.
    """

    stated: str
    fits: str
    evidence: str


def wrong_unit(spreads: Spreads) -> WrongUnit | None:
    """Return the gyroscope's unit where gravity says that it was mistaken; None where not.

    Parameters
    ----------
    spreads
        Of the acceleration.
    """
    if len(spreads.units) < LEAST_WINDOWS:
        return None
    units = np.array(spreads.units)
    stated, still = units[:, 0, 0], np.array(spreads.units_still)
    turning = float(np.median(spreads.turning))
    for place, (called, fits) in enumerate((("deg/s", "rad/s"), ("rad/s", "deg/s")), 1):
        rivals = units[:, place]
        gain, errors = told(stated[:, None] - rivals)
        over, over_errors = told(still[:, None] - rivals)
        better = (gain > RATIO) & (errors > ERRORS)
        seen = better & (over > RATIO) & (over_errors > ERRORS)
        impossible = better & (gain > TOO_FAR) & (SCALES[place] < 1 and turning > TOO_FAST_RADPS)
        if not (seen | impossible).any():
            continue
        best = int(np.argmax(np.where(seen | impossible, gain, -np.inf)))
        return WrongUnit(
            called,
            fits,
            f"turned back by it as stated, gravity wanders {math.exp(gain[best]):.2g} times as "
            f"far as with {fits} ({len(units)} windows of {spreads.window_s:g} s, "
            f"t {errors[best]:.1f}; turning {turning:.3g} rad/s)",
        )
    return None


def too_slow(spreads: Spreads) -> tuple[float, float, int] | None:
    """Return turning [rad/s] and shaking [m/s2] of shaken windows, and how many; None if plausible.

    Whether it is a walker who shakes the sensor, the caller must know: what is bolted to a machine
    is shaken without turning.
    """
    turning, shaking = np.array(spreads.turning), np.array(spreads.shaking)
    shaken = shaking > SHAKEN_MPS2
    if shaken.sum() < 2:
        return None
    turn, shake = float(np.median(turning[shaken])), float(np.median(shaking[shaken]))
    return (turn, shake, int(shaken.sum())) if turn < LEAST_TURN * shake else None
