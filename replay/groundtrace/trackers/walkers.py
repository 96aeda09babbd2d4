"""Several walkers, each with a step-clocked Kalman filter, separated by where they go.

Source: the thesis on footstep localisation, chapter 6, for each walker; it has one only. Fixes and
predicted steps are assigned one to one inside a gate. Two walkers may set their feet down at any
times, but of one walker two impacts within the least pace and at one place are heel and toe: the
second joins no track and begins none.

A fix is the next step of a track, the same one again, or that of a new walker. A track is matched
by the likeliest of its motions: straight on; straight on with steps missed, as many as its pace
suggests; or anywhere within a pace, as when it turns about. Of several fixes and tracks the pairs
are made at once, first for the tracks that count: a track that has just begun knows so little that
it is near everything, and must not take a walker's fix from him.

Paths that people walk along may be known beforehand, as the outlook of the thesis suggests: a fix
near one is drawn to it, by the variances of both.

A track that ended is smoothed. Errors of fixes are in part the same during a whole walk, for they
come of the same sensors and floor, and no smoother takes these away: to its covariances a part of
that which all fixes of the track have together is added.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Annotated

import numpy as np

from groundtrace_codecs.events import SMOOTHED, Fix, Note, Quantity, TrackPoint
from groundtrace_codecs.signals import NS_PER_S

from ..dsp.assignment import assign
from ..dsp.robust import ChiSquareCheck
from ..pipeline.gates import Candidates, Level
from ..pipeline.parameters import measured
from ..pipeline.stage import Context, Input, Memory, Stage
from .kalman import PACE_M, Motion, StepFilter, WalkModel, first_spread, smoothed

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import CandidateBlock
    from groundtrace_codecs.geometry import Geometry

    from ..pipeline.stage import Output

    Array = NDArray[np.float64]

#: How improbable a turn is, as minus twice the logarithm of 5 %. Chosen by judgement: the usual 5 %
#: of a test.
TURN_SURPRISE = 6.0
#: A walker can only turn when his next step is due: from this part of his pace on. Chosen by
#: judgement: paces of one walker scatter by some per cent, hardly by a fifth.
TURN_DUE = 0.8


@dataclass(frozen=True, slots=True, eq=False)
class FixObservation:
    """A fix as a tracker takes it.

    Attributes
    ----------
    time_ns
        When.
    position
        Shape (2,) [m].
    noise
        Its covariance, shape (2, 2) [m^2].
    """

    time_ns: int
    position: Array
    noise: Array


#: Where the straight parts of a line start, and where they end. Source: definition.
PARTS = slice(None, -1), slice(1, None)
#: A fix further from all paths is of somebody who walks elsewhere [deviations]. Chosen by
#: judgement: one of 400 on a path is.
ELSEWHERE = 3.0


@dataclass(slots=True, eq=False)
class WalkPaths:
    """Lines that people walk along, as is known beforehand: the outlook of the thesis.

    A place on a path is observed twice: by the fix, and by the path, from which walkers stray to
    either side by a normal law. Assumed is that they keep to the paths; it is checked by how far
    fixes are from them, as chi-square over the last ones, and where it does not hold the paths
    count no more.

    Attributes
    ----------
    starts, ends
        Of the straight parts of all paths, shape (k, 2) [m].
    sigma_m
        How far walkers stray [m].
    """

    starts: Array
    ends: Array
    sigma_m: float
    contradicted: bool = False
    check: ChiSquareCheck = field(default_factory=ChiSquareCheck)

    @classmethod
    def of(cls, geometry: Geometry | None, sigma_m: float) -> WalkPaths | None:
        """Return the paths of a geometry; None where there are none, or ``sigma_m`` is 0."""
        lines = [np.array(path, np.float64) for path in geometry.paths] if geometry else []
        lines = [line for line in lines if len(line) > 1]
        if not lines or sigma_m <= 0:
            return None
        starts, ends = (np.concatenate([line[part] for line in lines]) for part in PARTS)
        apart = (starts != ends).any(axis=1)
        return cls(starts[apart], ends[apart], sigma_m) if apart.any() else None

    def kept_to(self, seen: FixObservation) -> FixObservation:
        """Return a fix as it and its path tell the place."""
        off_m, across, spread = self._off(seen)
        if self.contradicted or off_m**2 > ELSEWHERE**2 * (across @ spread + self.sigma_m**2):
            return seen
        gain = spread / (across @ spread + self.sigma_m**2)
        noise = seen.noise - np.outer(gain, spread)
        return FixObservation(seen.time_ns, seen.position - gain * off_m, noise)

    def learn(self, seen: FixObservation) -> bool:
        """Take in how far a fix is from the paths; return whether that changes what paths count."""
        off_m, across, spread = self._off(seen)
        self.check.learn(float(off_m**2 / (across @ spread + self.sigma_m**2)))
        before, self.contradicted = self.contradicted, self.check.ratio > self.check.limit
        return self.contradicted != before

    def _off(self, seen: FixObservation) -> tuple[float, Array, Array]:
        """Return how far a fix is from the part of a path that is nearest for its covariance.

        Returns
        -------
        To the left of it [m], the unit vector to the left, and the covariance times that, (2,).
        """
        along = self.ends - self.starts
        inverse = np.linalg.inv(seen.noise)
        since = seen.position - self.starts
        way = ((since @ inverse) * along).sum(axis=1) / ((along @ inverse) * along).sum(axis=1)
        left = since - way.clip(0, 1)[:, None] * along
        part = int(np.argmin(((left @ inverse) * left).sum(axis=1)))
        forward = along[part] / np.hypot(*along[part])
        across = np.array([-forward[1], forward[0]])
        return float(across @ since[part]), across, seen.noise @ across


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """How a fix fits the next step of a track.

    Attributes
    ----------
    distance
        Mahalanobis distance.
    surprise
        Minus twice the logarithm of the likelihood.
    motion
        The likeliest.
    """

    distance: float
    surprise: float
    motion: Motion


@dataclass(frozen=True, slots=True)
class AssociationGate:
    """How far apart, in distance and in time, a fix and the last step of a track may be."""

    max_distance: float
    least_pace_s: float


def fit(
    track: Track, seen: FixObservation, model: WalkModel, limits: AssociationGate
) -> Fit | None:
    """Return the likeliest motion of a track to a fix, or None where it is too soon for a step.

    A motion out of the gate is never the likeliest while another is inside.
    """
    elapsed_s = (seen.time_ns - track.last_ns) / NS_PER_S
    # here and below of the precision that is stored: the gates then decide what is decided here
    if elapsed_s <= 0 or np.float32(elapsed_s) < limits.least_pace_s:
        return None
    fits = []
    for motion, penalty in _motions(track, elapsed_s, model):
        distance, surprise = track.filter.fit(seen.position, seen.noise, motion)
        fits.append(Fit(distance, surprise + penalty, motion))
    return min(fits, key=lambda f: (max(f.distance, limits.max_distance), f.surprise))


def _motions(track: Track, elapsed_s: float, model: WalkModel) -> list[tuple[Motion, float]]:
    motions = [(Motion.ahead(model), 0.0)]
    pace_s = track.pace_s
    if track.counts and pace_s is not None:
        ticks = max(1, round(elapsed_s / pace_s))
        if ticks > 1:
            motions.append((Motion.ahead(model, ticks), 0.0))
        if elapsed_s >= TURN_DUE * pace_s:
            motions.append((Motion.turning(PACE_M, ticks), TURN_SURPRISE))
    return motions


def paired(
    fits: Sequence[Sequence[Fit | None]], tracks: Sequence[Track], limits: AssociationGate
) -> dict[int, int]:
    """Pair fixes and tracks one to one inside the gate: the likeliest of as many as can be.

    Returns
    -------
    Index of the track by that of the fix.
    """
    surprise = np.full((len(fits), len(tracks)), np.inf)
    for row, each in enumerate(fits):
        for column, candidate in enumerate(each):
            if candidate is not None and np.float32(candidate.distance) <= limits.max_distance:
                surprise[row, column] = max(candidate.surprise, 0.0)
    owner: dict[int, int] = {}
    counts = np.array([track.counts for track in tracks], np.bool_)
    for among in (counts, ~counts):
        left = np.where(among, surprise, np.inf)
        left[list(owner)] = np.inf
        owner |= {int(row): int(column) for row, column in assign(left, np.inf)}
    return owner


@dataclass(frozen=True, slots=True, eq=False)
class FootPosition:
    """Where and when a foot was last set down; ``spread`` is the covariance of the place."""

    time_ns: int
    position: Array
    spread: Array

    def distance(self, seen: FixObservation) -> float:
        """Return the Mahalanobis distance of a fix from this very place."""
        innovation = seen.position - self.position
        solved = np.linalg.solve(self.spread + seen.noise, innovation)
        return float(np.sqrt(innovation @ solved))

    def since_s(self, seen: FixObservation) -> float:
        """Return the time between this and a fix [s]."""
        return abs(seen.time_ns - self.time_ns) / NS_PER_S


def foot_of(track: Track) -> FootPosition:
    """Return the last step of a track."""
    last = track.steps[-1]
    return FootPosition(last.time_ns, last.state[2:], last.spread[2:, 2:])


def nearest(
    seen: FixObservation,
    feet: Mapping[int, FootPosition],
    fits: Sequence[Fit | None],
    limits: AssociationGate,
) -> tuple[float, float]:
    """Return distance and time [s] of a fix from the track that is nearest to it.

    Parameters
    ----------
    seen
        A fix that is the next step of no track.
    feet
        Where each track, then each stranger, was last, the fixes beside this one counted.
    fits
        How it fits each track.
    limits
        A foot set down within the least pace is compared to where it stands: one cannot step
        again so soon, but set down the toe.

    Returns
    -------
    0 and infinity where there is none.
    """
    distances = [(0.0, float("inf"))] if not feet else []
    for index, foot in feet.items():
        since_s = foot.since_s(seen)
        step = fits[index] if index < len(fits) else None
        if step is None or since_s < limits.least_pace_s:
            distances.append((foot.distance(seen), since_s))
        else:
            distances.append((step.distance, since_s))
    return min(distances)


#: The pace of a walker is known from so many intervals on, and judged by the last of them. Chosen
#: by judgement: one interval may be of two walkers; older ones may be of another speed.
LEAST_PACES, PACES = 2, 5


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """The state after a step.

    Attributes
    ----------
    time_ns
        When.
    state, spread
        Shape (4,) [m], and its covariance, shape (4, 4) [m^2].
    motion
        How it was predicted.
    noise
        Covariance of its fix, shape (2, 2) [m^2].
    nis
        Of its fix; NaN for a first step.
    """

    time_ns: int
    state: Array
    spread: Array
    motion: Motion
    noise: Array
    nis: float


@dataclass(slots=True, eq=False)
class Track:
    """A walker followed.

    Attributes
    ----------
    filter
        Its Kalman filter.
    steps
        What the filter said.
    chances
        How many fixes could have been its own so far.
    counts
        Whether it is taken for a walker's, before whom one that has just begun must stand back.
    number
        Its number once it is confirmed and given; 0 while it may yet turn out to be none.
    """

    filter: StepFilter
    steps: list[Step]
    chances: int = 1
    counts: bool = False
    number: int = 0

    @property
    def last_ns(self) -> int:
        """Time of its last step."""
        return self.steps[-1].time_ns

    @property
    def pace_s(self) -> float | None:
        """Usual time between its last steps [s]; None while there are too few to tell."""
        times = [step.time_ns for step in self.steps[-1 - PACES :]]
        if len(times) <= LEAST_PACES:
            return None
        return float(np.median(np.diff(times))) / NS_PER_S

    def take(self, seen: FixObservation, motion: Motion, nis: float) -> None:
        """Remember what the filter says now that it has taken in a fix."""
        filtered = self.filter.state, self.filter.spread
        self.steps.append(Step(seen.time_ns, *filtered, motion, seen.noise, nis))


def filtered_points(track: Track, stage: str, first: int) -> list[TrackPoint]:
    """Return the points of a track from its step ``first`` on."""
    before = track.steps[first - 1].time_ns if first else None
    return _points(track.steps[first:], before, track.number, stage)


#: The same sensors hear a whole walk on the same floor: a part of what its fixes err by is alike in
#: all of them, and no mean over many steps takes it away. To what the smoother claims so much is
#: added of what the fixes claim together (the covariance intersection of all of the track).
#: Bench: room_laws.py --walks --first 101 --last 140, by how far the parts of truths in claimed
#: regions are from 68 and 90 %, of 0.1, 0.125, 0.15, 0.175 and 0.2.
COMMON = 0.2


def smoothed_points(track: Track, stage: str) -> list[TrackPoint]:
    """Return all points of a track, smoothed, under a stage of their own."""
    states = np.stack([step.state for step in track.steps])
    spreads = np.stack([step.spread for step in track.steps])
    motions = [step.motion for step in track.steps]
    information = np.linalg.inv(np.stack([step.noise for step in track.steps]))
    common = COMMON * np.tile(np.linalg.inv(information.mean(axis=0)), (2, 2))
    smooth_steps = zip(track.steps, *smoothed(states, spreads, motions), strict=True)
    steps = [
        replace(step, state=state, spread=spread + common) for step, state, spread in smooth_steps
    ]
    return _points(steps, None, track.number, stage + SMOOTHED)


def _points(
    steps: Sequence[Step], before_ns: int | None, number: int, stage: str
) -> list[TrackPoint]:
    points = []
    for step in steps:
        x, y = step.state[2:].tolist()
        vx, vy = _velocity(step, before_ns)
        spread = step.spread[2:, 2:]
        covariance = (float(spread[0, 0]), float(spread[0, 1]), float(spread[1, 1]))
        points.append(
            TrackPoint(step.time_ns, number, x, y, vx, vy, covariance, stage, nis=step.nis)
        )
        before_ns = step.time_ns
    return points


def _velocity(step: Step, before_ns: int | None) -> tuple[float, float]:
    """Return the way from the place before over the time it took [m/s]; NaN for a first step.

    The place before is one tick ago: where steps were missed that is not where the last fix was.
    """
    if before_ns is None:
        return float("nan"), float("nan")
    tick_s = (step.time_ns - before_ns) / NS_PER_S / step.motion.ticks
    vx, vy = (step.state[2:] - step.state[:2]) / tick_s
    return float(vx), float(vy)


#: What a law of waves gets wrong is alike from step to step, and the more so the fewer arrivals
#: could contradict it: by this over one more than there are to spare the own covariance of a fix
#: grows. Bench: room_laws.py --walks --first 101 --last 140, by the truths in claimed regions, of
#: 1, 2 and 3.
REPEATED = 1.0
#: Place, moment and scale. Source: definition.
UNKNOWNS = 4


@dataclass(frozen=True, slots=True)
class TrackerParameters:
    """Parameters that every tracker has."""

    source: Annotated[
        str, measured("", "Stage whose fixes are tracked; empty takes the first localizer.")
    ] = ""
    together_s: Annotated[
        float, measured("s", "Fixes so close in time are of different walkers.", ge=0)
    ] = 0.1


#: A track counts from its second fix on, which must be among three that could be its own. Chosen by
#: judgement: a single false fix starts no track, a single missed step stops none.
START_FIXES, START_CHANCES = 2, 3


@dataclass(frozen=True, slots=True)
class WalkersParameters(TrackerParameters):
    """Parameters of :class:`WalkerTracker`.

    The two gates say whose step a fix is, and with it where the track goes on: to change one is
    to track again, it cannot be tried on stored candidates.
    """

    sigma_q: Annotated[
        float, measured("m", "How far a step strays from going straight on.", gt=0)
    ] = 0.1
    sigma_r: Annotated[float, measured("m", "Error of a fix, per axis.", gt=0)] = 0.5
    own_covariance: Annotated[
        bool, measured("", "Take the covariance of a fix that has one, not sigma_r.")
    ] = False
    max_distance: Annotated[
        float, measured("1", "Largest Mahalanobis distance from the predicted step.", gt=0)
    ] = 3.7
    least_pace_s: Annotated[
        float, measured("s", "Least time between two steps of a walker.", ge=0)
    ] = 0.25
    confirm: Annotated[
        int, measured("1", "A track is given once it has so many steps, all of them then.", ge=2)
    ] = 3
    end_s: Annotated[float, measured("s", "A track without a fix for so long ends.", gt=0)] = 2.0
    path_sigma_m: Annotated[
        float,
        measured("m", "How far walkers stray from the geometry's paths; 0: without paths.", ge=0),
    ] = 0.6
    smooth: Annotated[bool, measured("", "Also give each track smoothed, when it ends.")] = True


class WalkerTracker(Stage):
    """Kalman filters with a clock of steps, one a walker; each track is smoothed when it ends.

    Fixes that come together are of different walkers, so they are decided at once: when the first
    fix after them has come. Where the clock steps, all tracks end. Where the geometry has paths, a
    fix near one is drawn to it.
    """

    Parameters = WalkersParameters
    takes = (Input(Fix, first=True),)
    gives = (TrackPoint,)
    scope = "recording"
    ends_at = "clock step"
    feedback = True
    columns = (
        Quantity("distance", "1"),
        Quantity("since", "s"),
        Quantity("x", "m"),
        Quantity("y", "m"),
    )
    gates = (
        Level("distance", "1", "max_distance", at_least=False),
        Level("since", "s", "least_pace_s"),
    )

    def __init__(self, parameters: WalkersParameters) -> None:
        self.parameters = parameters
        self.model = WalkModel(parameters.sigma_q, parameters.sigma_r)
        self.stage = ""
        self._tracks: list[Track] = []
        self._steps: dict[int, tuple[Track, Motion]] = {}
        self._again: set[int] = set()
        self._count = 0
        self._waiting: list[Fix] = []  # fixes that may still get company
        self._together: list[Fix] = []  # those being decided
        self._paths: WalkPaths | None = None

    @property
    def memory(self) -> Memory:
        """All before; and the fixes that come together."""
        return Memory(None, self.parameters.together_s)

    def start(self, context: Context) -> tuple[str, ...]:
        """Begin without tracks."""
        self.stage = context.stage
        self._paths = WalkPaths.of(context.geometry, self.parameters.path_sigma_m)
        return ("all",)

    def process(self, fix: Fix) -> Iterator[Output]:
        """Take a fix; where it is too late to be together with those that wait, decide these.

        A fix whose localizer doubts its model is left out.
        """
        if fix.doubted:
            return
        together_ns = self.parameters.together_s * NS_PER_S
        if self._waiting and fix.time_ns - self._waiting[0].time_ns > together_ns:
            yield from self._candidates()
        self._waiting.append(fix)

    def flush(self) -> Iterator[Output]:
        """End all tracks."""
        yield from self._candidates()
        yield from self.finish()

    def decided(self, block: CandidateBlock) -> Sequence[TrackPoint]:
        """Go on with the fixes just decided."""
        return self.follow(self._together, block.accepted)

    def _candidates(self) -> Iterator[Output]:
        """Yield the fixes that came together as candidates, and before them what has ended."""
        self._together = fixes = sorted(self._waiting, key=lambda fix: fix.time_ns)
        self._waiting = []
        if not fixes:
            return
        yield from self.expire(fixes[0].time_ns)
        yield from self._checked(fixes)
        times = np.array([fix.time_ns for fix in fixes], np.int64)
        yield Candidates(times, np.zeros(len(fixes), np.int32), self.measure(fixes))

    def _checked(self, fixes: Sequence[Fix]) -> Iterator[Note]:
        """Say when fixes begin to contradict the geometry's paths, and when they no longer do."""
        paths = self._paths
        if paths is None:
            return
        for fix in fixes:
            if not paths.learn(self._raw(fix)):
                continue
            ratio, limit = paths.check.ratio, paths.check.limit
            text = (
                f"{self.stage}: the last fixes are not where the geometry's paths lead: chi-square "
                f"is {ratio:.1f} times the expected one ({limit:.1f} allowed); paths count no more"
                if paths.contradicted
                else f"{self.stage}: the last fixes are where the geometry's paths lead: paths "
                f"count again"
            )
            yield Note(fix.time_ns, text, "WARN" if paths.contradicted else "INFO", self.stage)

    def expire(self, time_ns: int) -> list[TrackPoint]:
        """End the tracks that had no fix for too long."""
        limit = time_ns - self.parameters.end_s * NS_PER_S
        over = [track for track in self._tracks if track.last_ns < limit]
        self._tracks = [track for track in self._tracks if track.last_ns >= limit]
        return self._ended(over)

    def measure(self, fixes: Sequence[Fix]) -> NDArray[np.float32]:
        """Find whose steps the fixes are.

        Returns
        -------
        Shape (n, 4). Distance and time of a fix are those from the track whose next step it is,
        else from the nearest track; that may have another step within the least pace, from the
        place of which the distance is then. Where there are no tracks they are 0 and infinite.
        """
        limits = AssociationGate(self.parameters.max_distance, self.parameters.least_pace_s)
        seen = [self._observed(fix) for fix in fixes]
        fits = [[fit(track, one, self.model, limits) for track in self._tracks] for one in seen]
        owner = paired(fits, self._tracks, limits)
        self._steps, self._again = {}, set()
        feet = {column: foot_of(track) for column, track in enumerate(self._tracks)}
        rows = np.zeros((len(fixes), 2), np.float32)
        for row, column in owner.items():
            best, one = fits[row][column], seen[row]
            if best is not None:
                self._steps[row] = (self._tracks[column], best.motion)
                rows[row] = best.distance, feet[column].since_s(one)
                feet[column] = FootPosition(one.time_ns, one.position, one.noise)
        for row, one in enumerate(seen):
            if row not in owner:
                rows[row] = nearest(one, feet, fits[row], limits)
                if rows[row, 0] <= limits.max_distance and rows[row, 1] < limits.least_pace_s:
                    self._again.add(row)
                else:
                    feet[len(feet)] = FootPosition(one.time_ns, one.position, one.noise)
        places = np.array([(fix.x_m, fix.y_m) for fix in fixes])
        return np.column_stack([rows, places]).astype(np.float32)

    def follow(self, fixes: Sequence[Fix], accepted: NDArray[np.bool_]) -> list[TrackPoint]:
        """Take a step with each fix that belongs to a track; begin tracks with strangers."""
        points: list[TrackPoint] = []
        begun: list[Track] = []
        for row, fix in enumerate(fixes):
            if row in self._steps and accepted[row]:
                points += self._step(*self._steps[row], fix)
            elif row not in self._again:
                self._missed(fix)
                begun.append(self._begin(fix))
        counted = [t for t in self._tracks if t.counts or t.chances < START_CHANCES]
        self._tracks = counted + begun
        return points

    def finish(self) -> list[TrackPoint]:
        """End all tracks."""
        over, self._tracks = self._tracks, []
        return self._ended(over)

    def _observed(self, fix: Fix) -> FixObservation:
        """Return a fix as it is taken, by the path that it is near."""
        seen = self._raw(fix)
        return seen if self._paths is None else self._paths.kept_to(seen)

    def _raw(self, fix: Fix) -> FixObservation:
        """Return a fix with the covariance that it is taken to have."""
        position, noise = np.array([fix.x_m, fix.y_m]), self.model.r
        xx, xy, yy = fix.covariance
        positive = np.isfinite(xx + xy + yy) and xx > 0 and xx * yy > xy**2
        if self.parameters.own_covariance and positive:
            spare = max(fix.picks - UNKNOWNS, 0)
            noise = np.array([[xx, xy], [xy, yy]]) * (1 + REPEATED / (1 + spare))
        return FixObservation(fix.time_ns, position, noise)

    def _step(self, track: Track, motion: Motion, fix: Fix) -> list[TrackPoint]:
        seen = self._observed(fix)
        track.take(seen, motion, track.filter.step(seen.position, seen.noise, motion))
        track.chances += 1
        first = len(track.steps) - 1
        track.counts = track.counts or len(track.steps) >= START_FIXES
        if not track.number and len(track.steps) >= self.parameters.confirm:
            self._count += 1
            track.number, first = self._count, 0
        return filtered_points(track, self.stage, first) if track.number else []

    def _missed(self, fix: Fix) -> None:
        """Count a fix against the nearest track that does not count yet."""
        position = np.array([fix.x_m, fix.y_m])
        stepped = [track for track, _ in self._steps.values()]
        free = [t for t in self._tracks if not t.counts and t not in stepped]
        if free:
            nearby = min(free, key=lambda t: float(np.hypot(*(t.steps[-1].state[2:] - position))))
            nearby.chances += 1

    def _begin(self, fix: Fix) -> Track:
        seen = self._observed(fix)
        track = Track(StepFilter(self.model, seen.position, first_spread(seen.noise)), [])
        track.take(seen, Motion.ahead(self.model), float("nan"))
        return track

    def _ended(self, over: Sequence[Track]) -> list[TrackPoint]:
        numbered = [t for t in over if t.number] if self.parameters.smooth else []
        return [p for t in numbered for p in smoothed_points(t, self.stage)]
