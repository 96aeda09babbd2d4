"""DSTP: steps by belief functions on peaks and valleys of accelerometer and gyroscope.

Source: Dempster-Shafer thesis, chapter III. The magnitude of each sensor is low-passed; the height
of a peak, and the depth of the valley after it, become masses on peak, no peak and either (III.4).
The masses of both sensors are combined (III.6), and a validated peak that a validated valley
follows is a step.

The thesis gives no cut-off, no corners of the trapezoids, no threshold of the masses and no limits
of time: all are parameters here, with defaults of ours. It compares heights with their mean over
the recording; here they are compared with the level of the signal around them, which needs no
complete recording. It finds the peaks of both sensors; here the accelerometer's are the candidates,
and the highest value of the gyroscope near each is taken. Its decision by the largest belief and
its test of ``m(peak)`` against ``m(Theta)`` are two gates, since the second does not follow from
the first.

Belief functions, as used here: masses are arrays of shape (..., 2^k), floats or exact fractions,
one row for each candidate; ``HypothesisSet`` says what the columns are. Models make masses of
measured values (chapter II, section III.2; chapter III, section V.2), for peaks and valleys as in
chapter III, section V. Rules combine the masses of several sources and discount a source (chapter
II, section III.3). Every rule takes all sources at once, since Yager's, Dubois and Prade's and
Florea's are not associative: chained in pairs, their result would depend on the order. Belief,
plausibility, pignistic probability and decisions follow chapter II, section III.4. Where a printed
formula is wrong, the function says how it is corrected.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import reduce
from itertools import product
from operator import and_, mul, or_
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import numpy as np

from groundtrace_codecs.events import Quantity, StepEvent
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

from ..dsp.filters import CentredWindow, level
from ..errors import BeliefError, TotalConflictError
from ..pipeline.gates import Candidates, Level, Reach, Refractory
from ..pipeline.parameters import gate, measured
from ..pipeline.stage import Context, Curve, Input, Measured, Stage
from .body_signals import OPEN_CUTOFF_HZ, OPEN_GRAVITY_HZ, Pairing, WalkingSignal
from .trace import FrameTrace, trace_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class HypothesisSet:
    """Hypotheses of which exactly one is true.

    A subset is a number whose bit ``i`` says whether hypothesis ``i`` is in it: 0 is the empty
    set, ``2^k - 1`` the whole frame (total ignorance). Masses lie in that order along the last
    axis of an array; for ``HypothesisSet(("peak", "other"))`` it is empty, peak, other, both.

    Attributes
    ----------
    hypotheses
        Their names, all different, at least one.
    """

    hypotheses: tuple[str, ...]

    def __post_init__(self) -> None:
        if not self.hypotheses or len(set(self.hypotheses)) < len(self.hypotheses):
            raise BeliefError(
                f"Frame: hypotheses: expected different names, found {self.hypotheses!r}"
            )

    @property
    def size(self) -> int:
        """Number of subsets, 2^k."""
        return int(2 ** len(self.hypotheses))

    @property
    def full_set(self) -> int:
        """The subset that holds every hypothesis."""
        return self.size - 1

    def subset(self, names: Iterable[str]) -> int:
        """Return the subset of some hypotheses.

        Raises
        ------
        BeliefError
            Where one is not of this frame.
        """
        mask = 0
        for name in names:
            if name not in self.hypotheses:
                expected = ", ".join(self.hypotheses)
                raise BeliefError(f"Frame: expected a hypothesis of {expected}, found {name!r}")
            mask |= 1 << self.hypotheses.index(name)
        return mask

    def complement(self, subset: int) -> int:
        """Return what is not in a subset."""
        return self.full_set & ~subset


def hypotheses_of(masses: NDArray[Any]) -> int:
    """Return the number of hypotheses of an array of masses, shape (..., 2^k).

    Raises
    ------
    BeliefError
        Where the last axis is no power of two from 2 on.
    """
    size = masses.shape[-1] if masses.ndim else 0
    if size < 2 or size & (size - 1):
        raise BeliefError(f"masses: expected a last axis of 2^k subsets, found {masses.shape}")
    return size.bit_length() - 1


#: The sensors, in the order of the columns.
SOURCES = ("accelerometer", "gyroscope")
FRAME = HypothesisSet(("it", "none"))
IT, NONE = FRAME.subset(["it"]), FRAME.subset(["none"])
#: Corners of a trapezoid, and so many heights are looked at besides them. Chosen by judgement: the
#: sought maximum is then within a hundredth of the range.
CORNERS, GRID = ("rise", "full", "fade", "gone"), 100


@dataclass(frozen=True, slots=True)
class TrapezoidMembership:
    """A trapezoid over heights: 0 up to ``rise``, 1 from ``full`` to ``fade``, 0 from ``gone``."""

    rise: float
    full: float
    fade: float = np.inf
    gone: float = np.inf

    def __call__(self, heights: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the membership of heights, from 0 to 1."""
        return trapezoid(heights, self.rise, self.full, self.fade, self.gone)


@dataclass(frozen=True, slots=True)
class SensorMass:
    """Turns heights into masses and combines them.

    Attributes
    ----------
    certainty, truth
        The probabilities p and q of (III.4) over the height.
    reliability
        Of each source of :data:`SOURCES`; 0 makes it vacuous.
    rule
        That combines the sources.
    criterion
        What the decision takes the largest of.
    """

    certainty: TrapezoidMembership
    truth: TrapezoidMembership
    reliability: tuple[float, float]
    rule: Rule
    criterion: Criterion

    @staticmethod
    def columns(what: str) -> tuple[Quantity, ...]:
        """Return what :meth:`of` gives, for a peak or a valley.

        Scores and masses that gates look at, the rest of the combined masses, their conflict, and
        the masses of each source: that it is one, that it is none, and that it may be either.
        """
        names = [f"{what}_lead", f"{what}_mass", f"{what}_certainty"]
        names += [f"non{what}_mass", f"{what}_ignorance", f"{what}_conflict"]
        for source in SOURCES:
            names += [f"{source}_{what}", f"{source}_non{what}", f"{source}_{what}_ignorance"]
        return tuple(Quantity(name, "1") for name in names)

    def most(self) -> tuple[float, float, float]:
        """Return the most that lead, mass and certainty of :meth:`of` can be, over all heights.

        Looked for over all pairs of heights of a grid that holds every corner of the trapezoids;
        between corners the masses of a source are polynomials of its height, of degree 2.
        """
        corners = [getattr(h, name) for h in (self.certainty, self.truth) for name in CORNERS]
        finite_corners = np.array([c for c in corners if np.isfinite(c)])
        grid = np.linspace(0, 1.1 * finite_corners.max() + 1, GRID)
        grid = np.unique(np.concatenate([[-1.0], finite_corners, grid]))
        pairs = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
        lead, mass, certainty = np.nanmax(self.of(pairs)[:, :3], axis=0).tolist()
        return lead, mass, certainty

    def of(self, heights: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the columns of each height, shape (n, 12).

        Parameters
        ----------
        heights
            Shape (n, 2): of each source, over the level around.

        Returns
        -------
        Not a number in a row of total conflict where rule or criterion are not defined for it.
        """
        masses = [
            discount(graded(FRAME, IT, self.certainty(h), self.truth(h)), reliability)
            for h, reliability in zip(heights.T, self.reliability, strict=True)
        ]
        k = conflict(*masses)
        undefined = (k >= 1) & (self.rule == "dempster" or self.criterion == "pignistic")
        combined, lead = np.full_like(masses[0], np.nan), np.full(len(heights), np.nan)
        defined = ~undefined
        combined[defined] = RULES[self.rule](*(m[defined] for m in masses))
        score = scores(combined[defined], self.criterion)
        lead[defined] = score[:, 0] - score[:, 1]
        columns = [lead, combined[:, IT], over_ignorance(combined, IT), combined[:, NONE]]
        columns += [combined[:, FRAME.full_set], k]
        for m in masses:
            columns += [m[:, IT], m[:, NONE], m[:, FRAME.full_set]]
        return np.column_stack(columns)


#: What a decision takes the largest of.
Criterion = Literal["belief", "plausibility", "pignistic"]


def belief(masses: NDArray[Any]) -> NDArray[Any]:
    """Return the belief of every subset: the masses of what is in it, shape (..., 2^k)."""
    return _gathered(masses, lambda inner, outer: inner != 0 and inner & ~outer == 0)


def plausibility(masses: NDArray[Any]) -> NDArray[Any]:
    """Return the plausibility of every subset: the masses of what it meets, shape (..., 2^k)."""
    return _gathered(masses, lambda inner, outer: inner & outer != 0)


def pignistic(masses: NDArray[Any]) -> NDArray[Any]:
    """Return the pignistic probability of every hypothesis, shape (..., k).

    Raises
    ------
    TotalConflictError
        Where all mass lies on the empty set in some row.

    Notes
    -----
    Source: thesis, equation (II.27), which lacks the division by ``1 - m(empty)``; without it the
    probabilities do not add up to 1 after Smets's rule.
    """
    k = hypotheses_of(masses)
    somewhere = np.asarray(masses[..., 1:].sum(axis=-1))
    total = np.asarray(somewhere == 0)
    if total.any():
        raise TotalConflictError(
            f"pignistic: expected mass on some hypothesis, found all on the empty set in "
            f"{int(total.sum())} of {total.size} rows"
        )
    shares = masses[..., :k] * 0
    for subset in range(1, masses.shape[-1]):
        for hypothesis in range(k):
            if subset >> hypothesis & 1:
                share = masses[..., subset] / subset.bit_count()
                shares[..., hypothesis] = shares[..., hypothesis] + share
    return np.asarray(shares / somewhere[..., None])


def scores(masses: NDArray[Any], criterion: Criterion) -> NDArray[Any]:
    """Return belief, plausibility or pignistic probability of each hypothesis, shape (..., k)."""
    if criterion == "pignistic":
        return pignistic(masses)
    singles = [1 << hypothesis for hypothesis in range(hypotheses_of(masses))]
    of = belief if criterion == "belief" else plausibility
    return of(masses)[..., singles]


def decision(masses: NDArray[Any], criterion: Criterion) -> NDArray[np.intp]:
    """Return the hypothesis that scores most, shape (...); of equal ones the first.

    Source: thesis, equations (II.25), (II.26) and (II.28).
    """
    return np.asarray(np.argmax(scores(masses, criterion), axis=-1))


def over_ignorance(masses: NDArray[Any], subset: int) -> NDArray[Any]:
    """Return ``m(subset) - m(whole)``, shape (...): above 0 the sources know more than they doubt.

    Source: thesis, chapter III, section V.4. It stands there beside the decision by the largest
    belief as if it followed from it; it is a test of its own.
    """
    hypotheses_of(masses)
    return np.asarray(masses[..., subset] - masses[..., -1])


def _gathered(masses: NDArray[Any], counts: Callable[[int, int], bool]) -> NDArray[Any]:
    hypotheses_of(masses)
    sums = np.asarray(masses * 0)
    for outer in range(masses.shape[-1]):
        for inner in range(masses.shape[-1]):
            if counts(inner, outer):
                sums[..., outer] = sums[..., outer] + masses[..., inner]
    return sums


def specialised(frame: HypothesisSet, subset: int, support: Any, against: Any) -> NDArray[Any]:
    """Return masses on a subset, its complement, and the rest on the whole frame: (II.9)."""
    zero = (np.asarray(support) + np.asarray(against)) * 0
    masses = np.stack([zero] * frame.size, axis=-1)
    for part, mass in ((subset, support), (frame.complement(subset), against)):
        masses[..., part] = masses[..., part] + mass
    masses[..., -1] = masses[..., -1] + (1 - masses.sum(axis=-1))
    return masses


def graded(frame: HypothesisSet, hypothesis: int, certainty: Any, truth: Any) -> NDArray[Any]:
    """Return the masses of a source that can tell with ``certainty``, and then says ``truth``.

    ``m(A) = p q``, ``m(not A) = p (1 - q)``, ``m(whole) = 1 - p``: thesis, equations (III.4) and
    (III.5), p the certainty and q the probability that the hypothesis is true.
    """
    p, q = np.asarray(certainty), np.asarray(truth)
    return specialised(frame, hypothesis, p * q, p * (1 - q))


def trapezoid(x: Any, rise: float, full: float, fade: float, gone: float) -> NDArray[Any]:
    """Return the membership in a trapezoid, shape of ``x``, from 0 to 1.

    It is 0 up to ``rise``, 1 from ``full`` to ``fade`` and 0 again from ``gone`` on, linear in
    between; equal corners make an edge upright, and the upper side of an edge counts as inside.
    Thesis, chapter III, section V.2, which names the function but none of its corners.

    Raises
    ------
    BeliefError
        Where the corners are not in that order.
    """
    if not rise <= full <= fade <= gone:
        raise BeliefError(
            f"trapezoid: expected rising corners, found {rise:g}, {full:g}, {fade:g}, {gone:g}"
        )
    x = np.asarray(x)
    up = (x - rise) / (full - rise) if full > rise else (x >= full) * 1.0
    down = (gone - x) / (gone - fade) if gone > fade else (x <= fade) * 1.0
    return np.asarray(np.clip(np.minimum(up, down), 0, 1))


#: Names of the rules of :data:`RULES`.
Rule = Literal["dempster", "smets", "yager", "disjunctive", "dubois-prade", "florea"]


def smets(*sources: NDArray[Any]) -> NDArray[Any]:
    """Combine by intersections; the conflict stays on the empty set.

    Source: thesis, equation (II.19), which leaves out the empty set although its mass is K.
    """
    return reduce(lambda a, b: _paired(a, b, and_), _checked(sources))


def conflict(*sources: NDArray[Any]) -> NDArray[Any]:
    """Return the conflict K of the sources, shape (...): thesis, equation (II.18)."""
    return np.asarray(smets(*sources)[..., 0])


def dempster(*sources: NDArray[Any]) -> NDArray[Any]:
    """Combine by intersections and divide by what is no conflict: thesis, equation (II.17).

    Raises
    ------
    TotalConflictError
        Where the sources agree on nothing (K = 1) in some row.
    """
    masses = smets(*sources)
    # the sum of what agrees, and not 1 - K, is exactly 0 only where every product is
    agreed = np.asarray(masses[..., 1:].sum(axis=-1))
    total = np.asarray(agreed == 0)
    if total.any():
        raise TotalConflictError(
            f"dempster: expected sources that agree on something, found total conflict in "
            f"{int(total.sum())} of {total.size} rows"
        )
    masses[..., 0] = masses[..., 0] * 0
    return np.asarray(masses / agreed[..., None])


def yager(*sources: NDArray[Any]) -> NDArray[Any]:
    """Combine by intersections; the conflict becomes ignorance: thesis, equation (II.20)."""
    masses = smets(*sources)
    masses[..., -1] = masses[..., -1] + masses[..., 0]
    masses[..., 0] = masses[..., 0] * 0
    return masses


def disjunctive(*sources: NDArray[Any]) -> NDArray[Any]:
    """Combine by unions: thesis, equation (II.21)."""
    return reduce(lambda a, b: _paired(a, b, or_), _checked(sources))


def dubois_prade(*sources: NDArray[Any]) -> NDArray[Any]:
    """Combine by intersections, by unions where there is none: thesis, equation (II.22)."""
    given = _checked(sources)
    masses = _zeros(*given)
    for subsets in product(range(masses.shape[-1]), repeat=len(given)):
        subset = reduce(and_, subsets) or reduce(or_, subsets)
        parts = [m[..., each] for m, each in zip(given, subsets, strict=True)]
        masses[..., subset] = masses[..., subset] + reduce(mul, parts)
    return masses


def florea(*sources: NDArray[Any]) -> NDArray[Any]:
    """Mix unions and intersections by how much conflict there is: thesis, equation (II.23)."""
    masses = smets(*sources)
    k = masses[..., :1].copy()
    masses[..., 0] = masses[..., 0] * 0
    mixed = (k * disjunctive(*sources) + (1 - k) * masses) / (1 - k + k * k)
    return np.asarray(mixed)


#: The rules by name.
RULES: dict[Rule, Callable[..., NDArray[Any]]] = {
    "dempster": dempster,
    "smets": smets,
    "yager": yager,
    "disjunctive": disjunctive,
    "dubois-prade": dubois_prade,
    "florea": florea,
}


def discount(masses: NDArray[Any], reliability: Any) -> NDArray[Any]:
    """Move a part of a source's masses to the whole frame.

    Parameters
    ----------
    masses
        Shape (..., 2^k).
    reliability
        Number or shape (...), from 0 (the source says nothing) to 1 (as it is).

    Raises
    ------
    BeliefError
        Where a reliability is outside [0, 1].

    Notes
    -----
    Source: thesis, equation (II.24), whose second line holds for the whole frame only; printed for
    every subset, the masses do not add up to 1. Corrected: all are multiplied by the reliability,
    and what is lost goes to the whole frame.
    """
    hypotheses_of(masses)
    factor = np.asarray(reliability)
    if not ((factor >= 0) & (factor <= 1)).all():
        raise BeliefError(f"discount: expected a reliability from 0 to 1, found {reliability}")
    discounted = np.asarray(masses * factor[..., None])
    discounted[..., -1] = discounted[..., -1] + (1 - factor)
    return discounted


def _checked(sources: tuple[NDArray[Any], ...]) -> tuple[NDArray[Any], ...]:
    sizes = {hypotheses_of(masses) for masses in sources}
    if len(sizes) != 1:
        shapes = [masses.shape for masses in sources]
        raise BeliefError(f"sources: expected masses on one frame, found shapes {shapes}")
    # a single source is returned as a copy: rules write into what they get
    return (sources[0].copy(), *sources[1:])


def _zeros(*sources: NDArray[Any]) -> NDArray[Any]:
    """Return zeros of the kind of number the sources are made of, fractions included."""
    return np.asarray(reduce(mul, sources) * 0)


def _paired(
    first: NDArray[Any], second: NDArray[Any], subset_of: Callable[[int, int], int]
) -> NDArray[Any]:
    masses = _zeros(first, second)
    for a in range(masses.shape[-1]):
        for b in range(masses.shape[-1]):
            to = subset_of(a, b)
            masses[..., to] = masses[..., to] + first[..., a] * second[..., b]
    return masses


#: Corners of the trapezoids that must not fall.
RISING = (
    ("certain_from", "certain_at"),
    ("true_from", "true_at"),
    ("true_at", "shock_from"),
    ("shock_from", "shock_at"),
)


@dataclass(frozen=True, slots=True)
class BeliefParameters:
    """Parameters of :class:`DempsterShaferDetector`."""

    cutoff_hz: Annotated[float, measured("Hz", "Corner of the low-pass.", gt=0)] = 3.0
    gravity_hz: Annotated[float, measured("Hz", "Corner of the high-pass.", gt=0)] = 0.25
    lead_s: Annotated[float, measured("s", "Initial contact precedes its peak by this.", ge=0)] = (
        0.05
    )
    around_s: Annotated[float, measured("s", "Time before and after that is around.", gt=0)] = 2.0
    match_s: Annotated[
        float, measured("s", "The gyroscope's peak is this near the accelerometer's.", ge=0)
    ] = 0.15
    valley_s: Annotated[float, measured("s", "Its valley is looked for so long.", gt=0)] = 0.6
    floor: Annotated[float, measured("m/s2", "Lowest peak kept as a candidate.", ge=0)] = 0.05
    least_acceleration: Annotated[
        float, measured("m/s2", "Heights are compared with at least this.", gt=0)
    ] = 0.4
    least_rotation: Annotated[
        float, measured("rad/s", "Heights are compared with at least this.", gt=0)
    ] = 0.1
    certain_from: Annotated[
        float, measured("1", "Height over level below which nothing can be told.", ge=0)
    ] = 0.0
    certain_at: Annotated[
        float, measured("1", "Height over level from which it surely can be told.", ge=0)
    ] = 1.0
    true_from: Annotated[
        float, measured("1", "Height over level below which it is none.", ge=0)
    ] = 0.0
    true_at: Annotated[float, measured("1", "Height over level from which it is one.", ge=0)] = 0.5
    shock_from: Annotated[
        float, measured("1", "Height over level from which it is too high for one.", ge=0)
    ] = 4.0
    shock_at: Annotated[
        float, measured("1", "Height over level from which it surely is none.", ge=0)
    ] = 6.0
    accelerometer: Annotated[
        float, measured("1", "Reliability of the accelerometer.", ge=0, le=1)
    ] = 0.95
    gyroscope: Annotated[float, measured("1", "Reliability of the gyroscope.", ge=0, le=1)] = 0.5
    rule: Annotated[Rule, measured("", "Rule that combines the sensors.")] = "dempster"
    criterion: Annotated[Criterion, measured("", "What a decision takes the largest of.")] = (
        "belief"
    )
    peak_lead: Annotated[float, gate("1", "Least score of a peak over none.", ge=0)] = 0.0
    peak_mass: Annotated[float, gate("1", "Least mass of a peak.", ge=0, le=1)] = 0.5
    peak_certainty: Annotated[float, gate("1", "Least mass of a peak over Theta.", ge=0)] = 0.0
    valley_lead: Annotated[float, gate("1", "Least score of a valley over none.", ge=0)] = 0.0
    valley_mass: Annotated[float, gate("1", "Least mass of a valley.", ge=0, le=1)] = 0.5
    valley_certainty: Annotated[float, gate("1", "Least mass of a valley over Theta.", ge=0)] = 0.0
    fall_s: Annotated[float, gate("s", "Longest time from a peak to its valley.", ge=0)] = 0.6
    pause_s: Annotated[float, gate("s", "Least time from a valley to the next peak.", ge=0)] = 0.0
    refractory_s: Annotated[float, gate("s", "Least time between two steps.", ge=0)] = 0.3

    def __post_init__(self) -> None:
        """Refuse a trapezoid whose corners fall."""
        for lower, upper in RISING:
            low, high = getattr(self, lower), getattr(self, upper)
            if low > high:
                raise ValueError(f"{lower}: expected at most {upper} ({high:g}), found {low:g}")


class _Pair(NamedTuple):
    """A peak and its valley: heights over zero and levels around, accelerometer and gyroscope."""

    time_ns: int
    fall_s: float
    peak: tuple[float, float]
    valley: tuple[float, float]
    level: tuple[float, float]


@dataclass(slots=True)
class _State:
    acceleration: WalkingSignal
    rotation: WalkingSignal
    columns: tuple[list[int], list[int]]  # of the accelerometer and of the gyroscope
    trace: FrameTrace
    signal: CentredWindow
    evidence: SensorMass
    rate_hz: float
    curve: Curve | None = None


class DempsterShaferDetector(Stage):
    """A step is a peak that both sensors believe in, followed by a valley they believe in.

    The candidates are the peaks of the acceleration's magnitude, each with the lowest valley before
    the signal is higher again. The gyroscope says how high it was near both. Without a gyroscope
    the second source is vacuous: every rule but the disjunctive then says what the accelerometer
    says, and the disjunctive one knows nothing. Where Dempster's rule or the pignistic probability
    is not defined (total conflict), masses are not a number and the candidate is rejected.
    """

    Parameters = BeliefParameters
    takes = (Input(SignalBlock, frozenset({"acceleration", "angular_velocity"})),)
    gives = (StepEvent,)
    compiles = ("filters", "frames", "grid", "steps")
    columns = (
        Quantity("height", "m/s2"),
        Quantity("depth", "m/s2"),
        Quantity("fall", "s"),
        *SensorMass.columns("peak"),
        *SensorMass.columns("valley"),
    )
    trace = trace_of(Quantity("height", "m/s2"), "m/s2", "m/s2")
    gates = (
        Level("peak_lead", "1", "peak_lead"),
        Level("peak_mass", "1", "peak_mass"),
        Level("peak_certainty", "1", "peak_certainty"),
        Level("valley_lead", "1", "valley_lead"),
        Level("valley_mass", "1", "valley_mass"),
        Level("valley_certainty", "1", "valley_certainty"),
        Level("fall", "s", "fall_s", at_least=False),
        Pairing(),
        Refractory(),
    )

    @classmethod
    def unfiltered(
        cls, parameters: BeliefParameters
    ) -> tuple[type[DempsterShaferDetector], BeliefParameters]:
        """Return what measures the same with the low-pass and the high-pass wide open."""
        return cls, replace(parameters, cutoff_hz=OPEN_CUTOFF_HZ, gravity_hz=OPEN_GRAVITY_HZ)

    def __init__(self, parameters: BeliefParameters) -> None:
        self.parameters = parameters

    def start(self, context: Context) -> tuple[str, ...]:
        """Begin a run; the norm of all acceleration axes is one channel."""
        stream = context.stream
        p, rate = self.parameters, stream.rate_hz
        around, match = round(p.around_s * rate), round(p.match_s * rate)
        after = max(around, self._valley_samples(rate) + match) + 1
        columns = (stream.columns_of({"acceleration"}), stream.columns_of({"angular_velocity"}))
        self.state = _State(
            WalkingSignal(rate, p.cutoff_hz, p.gravity_hz),
            WalkingSignal(rate, p.cutoff_hz, p.gravity_hz),
            columns,
            FrameTrace(rate, 1),
            CentredWindow(2, max(around, match, 1), after),
            _evidence(p, has_gyroscope=bool(columns[1])),
            rate,
        )
        return ("norm",)

    def reach(self) -> dict[str, Reach]:
        """Return what the combined masses can reach, whatever the heights of both sensors."""
        evidence, p = self.state.evidence, self.parameters
        reliabilities = " and ".join(f"{reliability:g}" for reliability in evidence.reliability)
        why = f"rule {p.rule}, reliabilities {reliabilities}"
        most = zip(("lead", "mass", "certainty"), evidence.most(), strict=True)
        return {
            f"{what}_{name}": Reach(value, why)
            for name, value in most
            for what in ("peak", "valley")
        }

    def process(self, block: SignalBlock) -> Measured:
        """Find the peaks; each waits until its valley and its surroundings are complete."""
        state = self.state
        norm, y = state.acceleration(block.select(state.columns[0]))
        _, turning = state.rotation(block.select(state.columns[1]))
        times = block.sample_times()
        state.curve = Curve(times - state.acceleration.delay_ns, y.T)
        frames = state.trace.add(times, y, np.abs(y), y * y, norm, norm)
        return Measured(self._look(state.signal.add(times, np.concatenate([y, turning]))), frames)

    def curve(self) -> Curve | None:
        """Return the accelerometer's filtered norm of the last block, without the delay."""
        return self.state.curve

    def flush(self) -> Measured:
        """End the run; a peak at its very end is not one."""
        return Measured(self._look(self.state.signal.flush()), self.state.trace.flush())

    def _look(self, columns: range) -> Candidates:
        """Return the peaks among some samples of the signal."""
        signal = self.state.signal
        peaks = signal.maxima(columns)
        peaks = peaks[signal.values[0, peaks] > self.parameters.floor]
        return self._candidates([self._pair(int(peak)) for peak in peaks])

    def _pair(self, peak: int) -> _Pair:
        """Measure a peak and the lowest point before the signal is higher again."""
        p, signal, rate = self.parameters, self.state.signal, self.state.rate_hz
        x, turning = signal.values
        following = x[peak + 1 : peak + 1 + self._valley_samples(rate)]
        higher = np.flatnonzero(following > x[peak])
        valley = peak + 1 + int(np.argmin(following[: higher[0]] if len(higher) else following))
        match, around = round(p.match_s * rate), signal.around(peak, round(p.around_s * rate))
        shift_s = vertex(x[peak - 1 : peak + 2]) / rate
        return _Pair(
            time_ns=int(signal.times[peak]) + round(shift_s * NS_PER_S),
            fall_s=(valley - peak) / rate - shift_s,
            peak=(x[peak], turning[signal.around(peak, match)].max()),
            valley=(-x[valley], -turning[signal.around(valley, match)].min()),
            level=(level(x[around]), level(turning[around])),
        )

    def _candidates(self, pairs: list[_Pair]) -> Candidates:
        """Let the evidence speak about all pairs at once."""
        p, state = self.parameters, self.state
        if not pairs:
            return Candidates.empty(len(self.columns))
        least = (p.least_acceleration, p.least_rotation)
        levels = np.maximum([pair.level for pair in pairs], least)
        peaks, valleys = (np.array([getattr(q, w) for q in pairs]) for w in ("peak", "valley"))
        shift_ns = state.acceleration.delay_ns + round(p.lead_s * NS_PER_S)
        values = np.column_stack(
            [
                peaks[:, 0],
                valleys[:, 0],
                [pair.fall_s for pair in pairs],
                state.evidence.of(peaks / levels),
                state.evidence.of(valleys / levels),
            ]
        )
        times = np.array([q.time_ns for q in pairs], np.int64) - shift_ns
        return Candidates(times, np.zeros(len(pairs), np.int32), values.astype(np.float32))

    def _valley_samples(self, rate_hz: float) -> int:
        return max(1, round(self.parameters.valley_s * rate_hz))


def vertex(three: NDArray[np.float64]) -> float:
    """Return where the parabola through three samples is highest, from the middle [samples].

    At 6 samples per second a peak would else be up to 83 ms off.
    """
    before, middle, after = three.tolist()
    bend = before - 2 * middle + after
    return 0.5 * (before - after) / bend if bend else 0.0


def _evidence(p: BeliefParameters, *, has_gyroscope: bool) -> SensorMass:
    return SensorMass(
        certainty=TrapezoidMembership(p.certain_from, p.certain_at),
        truth=TrapezoidMembership(p.true_from, p.true_at, p.shock_from, p.shock_at),
        reliability=(p.accelerometer, p.gyroscope if has_gyroscope else 0.0),
        rule=p.rule,
        criterion=p.criterion,
    )
