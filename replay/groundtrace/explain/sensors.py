"""Faulty sensors: late by their clock throughout a recording, or not at their stated position.

A late clock makes a channel late by the same time in every step; a sensor that stands elsewhere
makes it late or early as the source lies on one side of it or the other. Both are fitted to the
channel's deviations from the arrival curve of the others; the one that explains them is named.

Both are estimated from onsets. An array method looks for delays no longer than waves between two
sensors take, and fits all of them together, so that only a part of a clock's error is left in its
arrivals.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..dsp.robust import HUBER
from ..localizers import tdoa
from .relocate import LEAST_NOISE_S, Arrivals, blind_sources, fit_curve

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from .relocate import Curve, Reference, Relocator

    Array = NDArray[np.float64]

#: Fewer steps than this do not tell a constant fault from chance. Chosen by judgement: a place and
#: a clock are three unknowns.
LEAST_STEPS = 6
#: So many steps, spread over the recording, are enough to find a fault. Chosen by judgement: an
#: offset is then known to a twelfth of a pick's deviation.
SAMPLE = 150
#: Smaller displacements are how well people measure [m]; smaller offsets in deviations of a pick.
#: Chosen by judgement: three deviations.
LEAST_SHIFT_M, LEAST_OFFSET = 0.3, 3.0
#: A fault explains at least this part of a channel's misfit, and so many units of likelihood (BIC).
#: Source: definition, more than half; the other chosen by judgement: twice "very strong" by
#: Kass and Raftery (below), as all channels are tried.
LEAST_PART, LEAST_GAIN = 0.5, 20.0
#: A clock and a place are told apart from this difference on. Source: "strong" for twice a log
#: Bayes factor, R. E. Kass, A. E. Raftery, Bayes factors, J. Am. Stat. Assoc. 90 (1995), section
#: 3.2.
STRONG = 6.0
#: So many channels are looked at, the worst first; so many faults are named. Chosen by judgement:
#: with more faults than that nothing holds the rest.
SUSPECTS, MOST_FAULTS = 3, 3
#: Places tried along each side, refinements about the best, and how far outside the array they lie
#: where no room is known [m]. Chosen by judgement: 0.25 m on 10 m, and some centimetres after
#: refinement; a sensor is hardly farther off than 2 m.
NODES, REFINEMENTS, BEYOND_M = 41, 3, 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Fault:
    """A channel that is off in most steps.

    Attributes
    ----------
    channel
        Its row among the sensors.
    cause
        ``clock`` or ``position``.
    steps
        In how many steps it was heard.
    offset_s
        By how much it is late (< 0: early) all the time [s]; 0 for a displaced one.
    felt_s
        How much of that is left in the arrivals that places are made of [s]: less than all of it
        behind an array method.
    position
        Shape (2,): where it seems to stand [m].
    before_s, after_s
        Median distance from the curve with and without the fault [s].
    gain
        By how much it explains the channel's arrivals better than no fault (BIC).
    rival_gain
        By how much the other cause, a place for a clock and a clock for a place, does.
    """

    channel: int
    cause: str
    steps: int
    offset_s: float
    felt_s: float
    position: Array
    before_s: float
    after_s: float
    gain: float
    rival_gain: float

    @property
    def clear(self) -> bool:
        """Whether the cause explains the arrivals clearly better than the other one."""
        return self.gain - self.rival_gain >= STRONG

    @property
    def ambiguity(self) -> str:
        """That the two causes explain the arrivals alike, by how much."""
        gains = (self.gain, self.rival_gain)
        clock, position = gains if self.cause == "clock" else gains[::-1]
        return f"its clock explains them better by {clock:.0f}, its place by {position:.0f} (BIC)"

    def without_fault(self, arrivals: Arrivals, positions: Array) -> tuple[Arrivals, Array]:
        """Return the arrivals that places are made of, and sensors' places, without the fault.

        Behind an array method arrivals can be mended only as they are: a replay with the clock set
        right correlates anew, and does better.
        """
        places = positions.copy()
        places[self.channel] = self.position
        return arrivals.shifted(self.channel, -self.felt_s), places


def faults(relocator: Relocator, reference: Reference) -> tuple[Fault, ...]:
    """Return the sensors that are late or displaced, the worst first.

    Each is looked for with those found before it mended. Sources are taken from the reference
    where it is the truth, else from the arrivals of the other channels.
    """
    rows = np.unique(np.linspace(0, len(reference.xy) - 1, SAMPLE).round().astype(int))
    if len(reference.xy) < LEAST_STEPS:
        return ()
    true_xy = reference.xy[rows] if reference.kind == "truth" else None
    onsets, arrivals = (
        Arrivals(stored.step_ns[rows], stored.times_s[rows])
        for stored in (relocator.onsets, relocator.arrivals)
    )
    outline = np.array(relocator.geometry.outline, np.float64)
    judge = Judge(true_xy, outline if len(outline) else None)
    correlated = relocator.correlated
    return found_faults(judge, onsets, arrivals, relocator.positions, correlated=correlated)


def found_faults(
    judge: Judge, onsets: Arrivals, arrivals: Arrivals, positions: Array, *, correlated: bool
) -> tuple[Fault, ...]:
    """Return the faults that a judge finds in onsets, the worst first.

    Parameters
    ----------
    judge
        Knows where the steps were.
    onsets, arrivals
        What faults are found in, and what places are made of.
    positions
        Shape (n, 2): where the geometry has the sensors [m].
    correlated
        Whether the arrivals are an array method's.
    """
    first = sorted(judge.faults(onsets, positions), key=lambda item: -item[0])
    if judge.true_places is not None:
        first = first[:1]  # known places leave no choice: the worst is wrong
    sets = [
        _followed(judge, fault, onsets, arrivals, positions, correlated=correlated)
        for _, fault in first
    ]
    if judge.true_places is not None or not sets:
        return sets[0] if sets else ()
    return _least_left(judge, sets, onsets, positions)


def _followed(
    judge: Judge,
    fault: Fault,
    onsets: Arrivals,
    arrivals: Arrivals,
    positions: Array,
    *,
    correlated: bool,
) -> tuple[Fault, ...]:
    """Return a fault and those that are found when it is mended, the worst first."""
    fault_chain: list[Fault] = []
    while True:
        fault_chain.append(judge.with_residual(fault, arrivals, positions) if correlated else fault)
        onsets = onsets.shifted(fault.channel, -fault.offset_s)
        arrivals, positions = fault_chain[-1].without_fault(arrivals, positions)
        worst = max(judge.faults(onsets, positions), key=lambda item: item[0], default=None)
        if worst is None or len(fault_chain) == MOST_FAULTS:
            return tuple(fault_chain)
        fault = worst[1]


def _least_left(
    judge: Judge, sets: list[tuple[Fault, ...]], onsets: Arrivals, positions: Array
) -> tuple[Fault, ...]:
    """Return the faults that leave least, of rival sets; none where another leaves as little.

    Without known places a displaced sensor moves all places, which makes others look displaced.
    """
    left = []
    for faults_ in sets:
        mended, there = onsets, positions
        for fault in faults_:
            mended, there = mended.shifted(fault.channel, -fault.offset_s), there.copy()
            there[fault.channel] = fault.position
        left.append(judge.left(mended, there))
    best = int(np.argmin([cost for cost, _ in left]))
    cost, noise_s = left[best]
    blamed = {fault.channel for fault in sets[best]}
    # of as many wrong sensors as a step has arrivals to spare the others tell nothing
    if len(blamed) >= len(positions) - tdoa.POWER_LAW_UNKNOWNS:
        return ()
    for other, (other_cost, _) in zip(sets, left, strict=True):
        is_equal = 2 * (other_cost - cost) / noise_s < STRONG
        if is_equal and {fault.channel for fault in other} != blamed:
            return ()
    return sets[best]


@dataclass(frozen=True, slots=True, eq=False)
class Judge:
    """Judges channels by known places of the steps, or else by those of the other channels.

    Attributes
    ----------
    true_places
        Shape (m, 2): places of the steps [m]; None where they are unknown.
    outline
        Shape (k, 2): of the site [m], or None.
    """

    true_places: Array | None
    outline: Array | None

    def sources(self, arrivals: Arrivals, positions: Array) -> Array:
        """Return the places of the steps, shape (m, 2) [m]."""
        if self.true_places is not None:
            return self.true_places
        return blind_sources(positions, arrivals, self.outline)

    def faults(self, arrivals: Arrivals, positions: Array) -> Iterator[tuple[float, Fault]]:
        """Yield the gain and the fault of each channel that has one."""
        for channel in self._suspects(arrivals, positions):
            others = arrivals.without(channel)
            sources = self.sources(others, positions)
            curve = fit_curve(sources, positions, others.times_s)
            if curve is not None:
                item = _explained(
                    curve, sources, positions, arrivals, channel, self._bounds(positions)
                )
                if item is not None:
                    yield item

    def _bounds(self, positions: Array) -> Array:
        """Return where a sensor may stand, shape (2, 2) [m]: in the room, or about the others."""
        if self.outline is not None:
            margin_m, corners = LEAST_SHIFT_M, np.concatenate([self.outline, positions])
        else:
            margin_m, corners = BEYOND_M, positions
        return np.stack([corners.min(axis=0) - margin_m, corners.max(axis=0) + margin_m])

    def left(self, arrivals: Arrivals, positions: Array) -> tuple[float, float]:
        """Return the sizes of all misfits [s], summed, and the noise of the curve [s]."""
        sources = self.sources(arrivals, positions)
        curve = fit_curve(sources, positions, arrivals.times_s)
        if curve is None:
            return float("inf"), LEAST_NOISE_S
        off = [
            curve.misfit_s(sources, position, arrivals.times_s[:, c])
            for c, position in enumerate(positions)
        ]
        return float(np.nansum(np.abs(off))), curve.noise_s

    def with_residual(self, fault: Fault, arrivals: Arrivals, positions: Array) -> Fault:
        """Return a fault with how much of a clock's error is left in an array method's arrivals."""
        if fault.cause != "clock":
            return fault
        others = arrivals.without(fault.channel)
        sources = self.sources(others, positions)
        curve = fit_curve(sources, positions, others.times_s)
        if curve is None:
            return fault
        times_s = arrivals.times_s[:, fault.channel]
        late = curve.misfit_s(sources, positions[fault.channel], times_s)
        finite = late[np.isfinite(late)]
        return replace(fault, felt_s=float(np.median(finite))) if len(finite) else fault

    def _suspects(self, arrivals: Arrivals, positions: Array) -> list[int]:
        """Return the channels that are farthest off when all are taken for right.

        All of them where those fit no curve: two sensors swapped across a room can do that.
        """
        sources = self.sources(arrivals, positions)
        curve = fit_curve(sources, positions, arrivals.times_s)
        if curve is None:
            return np.flatnonzero(np.isfinite(arrivals.times_s).any(axis=0)).tolist()
        off = {
            c: scale(curve.misfit_s(sources, position, arrivals.times_s[:, c]))
            for c, position in enumerate(positions)
        }
        channels = [c for c in off if np.isfinite(off[c])]
        return sorted(channels, key=lambda c: -off[c])[:SUSPECTS]


def scale(misfit_s: Array) -> float:
    """Return the median size of misfits [s]; NaN where there is none."""
    finite = misfit_s[np.isfinite(misfit_s)]
    return float(np.median(np.abs(finite))) if len(finite) else float("nan")


def _explained(
    curve: Curve,
    sources: Array,
    positions: Array,
    arrivals: Arrivals,
    channel: int,
    bounds: Array,
) -> tuple[float, Fault] | None:
    """Return what a channel's fault gains and the fault; None where it has none."""
    times, position = arrivals.times_s[:, channel], positions[channel]
    off = curve.misfit_s(sources, position, times)
    valid = np.isfinite(off)
    count = int(valid.sum())
    if count < LEAST_STEPS:
        return None
    offset_s = float(np.median(off[valid]))
    there = _better_place(curve, sources, bounds, times)
    moved = curve.misfit_s(sources, there, times)
    costs = np.array([_cost(x[valid], curve.noise_s) for x in (off, off - offset_s, moved)])
    gains = 2 * (costs[0] - costs[1:]) - np.array([1, 2]) * np.log(count)
    which = int(np.argmax(gains))
    large = (
        abs(offset_s) > LEAST_OFFSET * curve.noise_s
        if which == 0
        else float(np.hypot(*(there - position))) > LEAST_SHIFT_M
    )
    if not large or gains[which] < LEAST_GAIN or costs[1 + which] > LEAST_PART * costs[0]:
        return None
    gain, rival = float(gains[which]), float(gains[1 - which])
    before_s, after_s = scale(off), scale((off - offset_s, moved)[which])
    fault = (
        Fault(channel, "clock", count, offset_s, offset_s, position, before_s, after_s, gain, rival)
        if which == 0
        else Fault(channel, "position", count, 0.0, 0.0, there, before_s, after_s, gain, rival)
    )
    return gain, fault


def _cost(off_s: Array, noise_s: float) -> float:
    """Return Huber's loss of misfits in units of the noise."""
    size = np.abs(off_s) / noise_s
    return float(np.where(size < HUBER, size**2 / 2, HUBER * (size - HUBER / 2)).sum())


def _better_place(curve: Curve, sources: Array, bounds: Array, times_s: Array) -> Array:
    """Return the place of a sensor that fits its arrivals best, shape (2,) [m]."""
    valid = np.isfinite(times_s) & np.isfinite(sources).all(axis=1) & np.isfinite(curve.origin_s)
    t, here = (times_s - curve.origin_s)[valid], sources[valid]
    low, high = bounds
    centre, half = (low + high) / 2, (high - low) / 2
    for _ in range(1 + REFINEMENTS):
        x, y = (np.linspace(-h, h, NODES) for h in half)
        nodes = centre + np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        apart = np.hypot(*(here[:, None] - nodes).transpose(2, 0, 1))
        off = np.abs(t[:, None] - curve.slope * apart**curve.exponent) / curve.noise_s
        loss = np.where(off < HUBER, off**2 / 2, HUBER * (off - HUBER / 2)).sum(axis=0)
        centre = nodes[int(np.argmin(loss))]
        half = half * 2 / (NODES - 1)
    return np.asarray(centre, np.float64)


#: Two sensors are swapped where each seems to stand within this part of their distance of where the
#: other is said to stand. Chosen by judgement: each is then nearer to the other's place than to its
#: own.
NEAR_PART = 0.25


def swapped(faults: Sequence[Fault], positions: Array) -> tuple[tuple[int, int], ...]:
    """Return pairs of displaced sensors that stand in each other's place, by their rows.

    Parameters
    ----------
    faults
        Of the sensors that were found wrong.
    positions
        Shape (n, 2): where the geometry has them [m].
    """
    moved = {fault.channel: fault.position for fault in faults if fault.cause == "position"}
    pairs = []
    for one in moved:
        for other in moved:
            apart = float(np.hypot(*(positions[one] - positions[other])))
            off = max(
                float(np.hypot(*(moved[one] - positions[other]))),
                float(np.hypot(*(moved[other] - positions[one]))),
            )
            if one < other and off <= NEAR_PART * apart:
                pairs.append((one, other))
    return tuple(pairs)


def swap_notes(
    names: Sequence[str], positions: Array, times_s: Array, sources: Array
) -> tuple[str, ...]:
    """Say which sensors seem to be swapped, one line a pair.

    Parameters
    ----------
    names
        Of the n channels.
    positions
        Shape (n, 2): of the sensors [m].
    times_s
        Shape (m, n): arrivals by clocks set right [s]; NaN where there is none.
    sources
        Shape (m, 2): places of the impacts [m].
    """
    arrivals = Arrivals(np.zeros(len(times_s), np.int64), times_s)
    faults = found_faults(Judge(sources, None), arrivals, arrivals, positions, correlated=False)
    return tuple(
        f"sensors: {names[one]} and {names[other]} seem to be swapped: each fits the arrivals of "
        f"the other; exchange their places in the geometry, or their cables"
        for one, other in swapped(faults, positions)
    )
