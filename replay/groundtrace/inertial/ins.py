"""ZUPT-INS: inertial navigation of a foot, corrected whenever the foot stands still."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.events import SMOOTHED, Note, Quantity, TrackPoint
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

from .. import kernels
from ..pipeline.gates import Candidates, Level
from ..pipeline.source import BRIDGE_S, NonFiniteHold
from ..pipeline.stage import CannotStart, Context, Input, Stage
from .frames import columns_of_axes
from .magnetometer import FootCompass, sigma_of
from .rotations import levelled
from .strapdown import (
    LOST_MPS,
    PLACE,
    STATES,
    ErrorStateFilter,
    FootNavigatorParameters,
    Pose,
    SensorNoise,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import CandidateBlock, Gap
    from groundtrace_codecs.signals import Stream

    from ..pipeline.stage import Output
    from .strapdown import Innovation, Segment, SegmentRun, Segments

    Array = NDArray[np.float64]
    #: Moments of a walk in columns, by their names in :data:`.kernels.navigation.KNOT`, shape (n,).
    FilterHistory = NDArray[Any]

#: Errors of a standing foot's velocity, and of the rate of one at rest, last for so long [s].
#: Chosen by judgement: a part of a stance, so that its samples are not taken for as many witnesses,
#: and twice that for the sway of who stands.
CORRELATION_S, REST_CORRELATION_S = 0.1, 0.2
#: Held at its limit for so long [s] and so many samples, a gyroscope is worth a warning. Chosen by
#: trial on the feet of docs/accuracy/inertial.md: tracks went astray after plateaus of 60 ms and
#: more, after no shorter ones; smooth tops of fewer samples look like plateaus at 50 Hz.
WARNED_S, WARNED_SAMPLES = 0.05, 5
#: Lost samples are worth a warning where they are more than this part. Bench: lost_samples.py ->
#: with 0.02 of them the worst tenth of tracks ends three times as far off.
LOST_PART = 0.02
#: Of so many swings the median is the usual one. Chosen by judgement: a few strides, so that who
#: begins to run is followed.
SWINGS = 9
#: No usual swing is slower than this [m/s]. Chosen by judgement: a shuffling foot reaches it.
SLOWEST_MPS = 1.0
#: Strides come out short or long together by this part of them. Bench: foot_accuracy.py -> true
#: ways are 2 to 3 % longer, as a foot rolls on while it is taken to stand.
SHORT = 0.03
#: Where place and velocity of a pose in the plane are, and the place's covariance. Source:
#: definition.
COLUMNS = [7, 8, 4, 5]
#: Values of a pose as a row, and where in a covariance that of the place in the plane is. Source:
#: definition.
POSE = 16
PLANE = ([PLACE.start, PLACE.start, PLACE.start + 1], [PLACE.start, *[PLACE.start + 1] * 2])
#: Most knots of one call: they take memory before it is known how many there are. Chosen by
#: judgement: 128 covariances are a quarter of a MB.
ROOM = 128
#: Of a point without an update that stands for itself.
NO_NIS = float("nan")


class InsTrajectory:
    """A track from where the foot first stood.

    Parameters
    ----------
    parameters
        Of the navigator.
    orientation
        At the start, shape (4,).
    stage, number
        Go into the points.
    """

    def __init__(
        self, parameters: FootNavigatorParameters, orientation: Array, stage: str, number: int
    ) -> None:
        self.parameters = parameters
        self.filter = ErrorStateFilter(SensorNoise(), orientation)
        self.stage = stage
        self.number = number
        self._swings: deque[float] = deque(maxlen=SWINGS)
        self._knots: list[FilterHistory] = []
        self._compass = FootCompass()
        self._ready_points: list[TrackPoint] = []
        self._set()

    @property
    def position(self) -> Array:
        """Where the foot is, shape (3,) [m]."""
        return self.filter.pose.position

    @property
    def usual_mps(self) -> float:
        """How fast the foot swings: in the last swings, or in the one under way."""
        median_mps = float(np.median(self._swings)) if self._swings else 0.0
        return max(median_mps, float(self.filter.state["fastest_mps"]), SLOWEST_MPS)

    def predict(self, segment: Segment, *, still: bool, stands: bool) -> float:
        """Go on by a segment.

        Parameters
        ----------
        segment
            The next one.
        still
            Whether it is still in it.
        stands
            Whether it stood in the segment before, so that it goes on standing if it is still.

        Returns
        -------
        How long the foot has been under way [s]; 0 where it stands.
        """
        self.filter.predict(segment)
        state = self.filter.state[()]
        if not still:
            kernels.navigation.end_stance(state)
        if still and stands:
            return 0.0
        state["still_s"] = state["still_s"] + segment.length_s if still else 0.0
        kernels.navigation.swing_on(state, segment.length_s)
        return float(state["swung_s"])

    def go_on(self, segments: SegmentRun, start: int, *, stands: bool) -> tuple[int, bool]:
        """Go on from a segment until one of which it is to be decided whether a stance begins.

        Parameters
        ----------
        segments
            Not predicted yet.
        start
            The first of them that counts.
        stands
            Whether the foot stood in the segment before.

        Returns
        -------
        The segment where that is, or the number of segments; and whether the foot stood before it.
        Points wait for :meth:`take_points`.
        """
        state, settings, at, full = self.filter.state, self.filter.settings, start, True
        state["stands"], s = stands, segments
        given = (s.time_ns, s.interval_s, s.rate, s.force, s.statistic, s.peak, s.length_s)
        while full:
            knots = np.empty(min(len(s) - at, ROOM), kernels.navigation.KNOT)
            at, count = kernels.navigation.navigate(
                *(at, *given, s.missed, s.unseen, state[()], settings[()], knots)
            )
            full = count == ROOM
            self._add(knots[:count].copy(), NO_NIS)
        return at, bool(state["stands"])

    def take_points(self) -> list[TrackPoint]:
        """Return the points that are known by now."""
        points, self._ready_points = self._ready_points, []
        return points

    def _set(self) -> None:
        """Put the parameters where compiled functions find them."""
        p, settings = self.parameters, self.filter.settings
        for name in ("sure", "share", "sole_m", "still_mps", "still_radps", "rest_s", "lost_s"):
            settings[name] = getattr(p, name)
        settings["point_ns"], settings["keep_all"] = p.point_s * NS_PER_S, p.smooth
        settings["correlation_s"], settings["lost_mps"] = CORRELATION_S, LOST_MPS
        settings["rest_correlation_s"] = REST_CORRELATION_S

    def stillness(self, segment: Segment) -> Innovation:
        """Return what it says of the velocity if the foot stands in a segment just predicted."""
        return self.filter.still(self._rolling_mps(segment))

    def _rolling_mps(self, segment: Segment) -> float:
        """Return how fast the foot may move though it stands, as it rolls over the sole."""
        p = self.parameters
        rate = segment.rate[1:] - self.filter.pose.gyro_bias
        rolling = p.sole_m * float(np.sqrt(np.einsum("ij,ij->i", rate, rate).mean()))
        lasting = math.sqrt(max(1.0, CORRELATION_S / segment.length_s))
        return math.hypot(p.still_mps, rolling) * lasting

    def follow(self, segment: Segment, stands: bool, accepted: bool | None) -> list[TrackPoint]:
        """Take it that the foot stands in the segment just predicted, or does not.

        Parameters
        ----------
        segment
            As predicted.
        stands
            Whether it does.
        accepted
            The verdict on a stance that begins here; None where none does.

        Returns
        -------
        The points that are known now.
        """
        state, p, nis = self.filter.state[()], self.parameters, NO_NIS
        if accepted:
            self._swings.append(float(state["fastest_mps"]))
            nis = _horizontal(self.stillness(segment))
        # no swing is so long, and rest is rest: what the filter knows is wrong
        rests = accepted is False and state["still_s"] > p.settle_s - 0.5 * segment.length_s
        lost = not accepted and state["swung_s"] >= p.lost_s
        if rests or lost:
            sigma = self._rolling_mps(segment) if rests else LOST_MPS
            kernels.navigation.doubt(state, sigma)
        predicted, spread = self.filter.pose, self.filter.covariance
        if stands:
            kernels.navigation.stance_update(
                state, segment.rate, segment.length_s, self.filter.settings[()]
            )
            self._face(segment)
        elif rests or lost:
            kernels.navigation.speed_update(state, sigma)
            state["swung_s"] = 0.0
        point_is_due = segment.time_ns - state["pointed_ns"] >= p.point_s * NS_PER_S
        shown = accepted is True or bool(point_is_due)
        if shown or stands or rests or lost:
            self._remember(segment.time_ns, shown, predicted, spread, nis)
        return self.take_points()

    def _face(self, segment: Segment) -> None:
        """Hold the heading of a standing foot by the field, where that is asked for."""
        if self.parameters.magnetometer:
            angle = self._compass.turned_by(self.filter.pose.orientation, segment.field)
            if angle is not None:
                self.filter.update(self.filter.vertical_turn(angle, sigma_of(segment.length_s)))

    def flush(self) -> list[TrackPoint]:
        """Return where the track ends, and the track smoothed, as far as not said yet."""
        points: list[TrackPoint] = []
        if self._knots and not self._knots[-1]["shown"][-1]:
            last = self._knots[-1]
            self._knots[-1:] = [last[:-1], last[-1:].copy()]
            self._knots[-1]["shown"] = 1
            points += self._points(self._knots[-1], self.stage, NO_NIS)
        points += self._smoothed()
        self._knots = []
        return points

    def _remember(
        self, time_ns: int, shown: bool, predicted: Pose, spread: Array, nis: float
    ) -> None:
        state = self.filter.state
        if self.parameters.smooth or shown:
            knot = np.zeros(1, kernels.navigation.KNOT)
            knot["time_ns"], knot["shown"] = time_ns, shown
            knot["predicted"], knot["predicted_covariance"] = predicted.row, spread
            for name in ("pose", "covariance", "transition"):
                knot[name] = state[name]
            if shown:
                state["pointed_ns"] = time_ns
            self._add(knot, nis)
        state["transition"] = np.eye(STATES)

    def _add(self, knots: FilterHistory, nis: float) -> None:
        """Keep knots; say the points of those that are shown, and what is smoothed by then."""
        self._ready_points += self._points(knots, self.stage, nis)
        if not (self.parameters.smooth and len(knots)):
            return
        begin, times, longest_ns = 0, knots["time_ns"].tolist(), self.parameters.smooth_s * NS_PER_S
        for index in np.flatnonzero(knots["shown"]).tolist():
            first = int(self._knots[0]["time_ns"][0]) if self._knots else times[begin]
            if times[index] - first > longest_ns:
                self._knots.append(knots[begin : index + 1])
                self._ready_points += self._smoothed()[:-1]
                self._knots, begin = [knots[index : index + 1]], index + 1
        if begin < len(knots):
            self._knots.append(knots[begin:])

    def _smoothed(self) -> list[TrackPoint]:
        """Return the points of all knots that are kept as all of them tell."""
        smoothed: list[list[TrackPoint]] = []
        if not self._knots:
            return []
        last = self._knots[-1][-1:]
        state = np.zeros((), kernels.navigation.STATE)
        state["pose"], state["covariance"] = last["pose"][0], last["covariance"][0]
        smoothed.append(self._points(last, self.stage + SMOOTHED, NO_NIS))
        later = last
        for part in [*self._knots[:-1], self._knots[-1][:-1]][::-1]:
            if not len(part):
                continue
            poses, planar = np.empty((len(part), POSE)), np.empty((len(part), 3))
            kernels.navigation.smooth(part, later[0], state[()], poses, planar)
            smoothed.append(self._points(part, self.stage + SMOOTHED, NO_NIS, poses, planar))
            later = part
        return [point for points in smoothed[::-1] for point in points]

    def _points(
        self,
        knots: FilterHistory,
        stage: str,
        nis: float,
        pose: Array | None = None,
        planar: Array | None = None,
    ) -> list[TrackPoint]:
        """Return points where knots are shown, by their own poses or by others."""
        rows, number = np.flatnonzero(knots["shown"]), self.number
        if not len(rows):
            return []
        pose = knots["pose"] if pose is None else pose
        covariance = (
            knots["covariance"][rows[:, None], PLANE[0], PLANE[1]]
            if planar is None
            else planar[rows]
        )
        moved = pose[rows[:, None], COLUMNS]
        x, y = (SHORT * moved[:, :2]).T  # all strides are short or long together
        covariance = covariance + np.column_stack([x * x, x * y, y * y])
        columns = (knots["time_ns"][rows], moved, covariance)
        return [
            TrackPoint(time_ns, number, x, y, vx, vy, (xx, xy, yy), stage, nis)
            for time_ns, (x, y, vx, vy), (xx, xy, yy) in zip(
                *(column.tolist() for column in columns), strict=True
            )
        ]


def _horizontal(seen: Innovation) -> float:
    """Return the normalised square of an innovation's horizontal part."""
    value, spread = seen.value[:2], seen.spread[:2, :2]
    return float(value @ np.linalg.solve(spread, value))


@dataclass(slots=True)
class HeldRates:
    """When a gyroscope was held at its limit for :data:`WARNED_S` or longer.

    Attributes
    ----------
    count
        How often.
    first_ns, first_s
        The end of the first time [ns], and how long it was [s].
    longest_ns, longest_s
        The same of the longest.
    """

    count: int = 0
    first_ns: int = 0
    first_s: float = 0.0
    longest_ns: int = 0
    longest_s: float = 0.0

    def add(self, segments: SegmentRun) -> None:
        """Take the next segments."""
        period_s = float(segments.interval_s[0, 0]) if len(segments) else 0.0
        least_s = max(WARNED_S, (WARNED_SAMPLES - 0.5) * period_s)
        for index in np.flatnonzero(segments.held_s >= least_s):
            time_ns, held_s = int(segments.time_ns[index]), float(segments.held_s[index])
            if not self.count:
                self.first_ns, self.first_s = time_ns, held_s
            if held_s > self.longest_s:
                self.longest_ns, self.longest_s = time_ns, held_s
            self.count += 1

    def warning(self) -> str:
        """Return what is said at the first time."""
        return (
            f"the gyroscope was held at its limit for {1e3 * self.first_s:.0f} ms, and turned "
            "further than it says: the track is unsure from here on; record with a wider range"
        )

    def summary(self) -> str:
        """Return what is said at the end."""
        return (
            f"the gyroscope was held at its limit for {1e3 * WARNED_S:.0f} ms or longer "
            f"{self.count} times, the longest {1e3 * self.longest_s:.0f} ms: the track is unsure "
            "after them"
        )


#: A sensor that stands and works measures gravity, at least about half of it. Chosen by judgement:
#: a scale can be off by half, and less is no gravity.
LEAST_FORCE_MPS2 = 5.0
#: Sampled slower, the samples do not tell how fast a foot went between them. Chosen by trial on a
#: made-up loop: off by 3 % at 12 Hz, lost at 6 Hz (docs/limits.md).
LEAST_RATE_HZ = 25.0
QUANTITIES = ("angular_velocity", "acceleration")
#: With the magnetometer's, where the stream has one. Source: definition, three axes of three
#: sensors.
SIGNAL_COLUMNS = 9


class FootNavigator(Stage):
    """ZUPT-INS: integrates a foot's motion, and corrects it by each stance that fits.

    The candidates are the beginnings of stances. ``distance`` and ``speed`` say how far the
    velocity had strayed from zero, in standard deviations and in parts of the fastest that the foot
    usually swings; ``swing`` is how long the foot had been under way. A stance that is rejected
    changes nothing at first, and each of its further segments is another candidate. A foot that is
    still for ``settle_s`` stands all the same: then the filter is wrong, and is made less sure.

    Streams whose placement is given and is no foot are left alone. After a bridged gap the track is
    less sure, by what straight lines over lost samples may be off; any other gap ends it, and the
    next begins at the origin again: nothing says how far the foot came meanwhile.
    """

    Parameters = FootNavigatorParameters
    takes = (
        Input(SignalBlock, frozenset({"angular_velocity"}), hold=False),
        Input(SignalBlock, frozenset({"acceleration"}), hold=False),
        Input(SignalBlock, hold=False, required=False),  # a field, or what else it has
    )
    gives = (TrackPoint,)
    compiles = ("navigation",)
    bridges_s = BRIDGE_S
    feedback = True
    #: What it takes, in words.
    needs = "three axes of a foot"
    columns = (
        Quantity("stillness", "1"),
        Quantity("distance", "1"),
        Quantity("speed", "1"),
        Quantity("swing", "s"),
        Quantity("x", "m"),
        Quantity("y", "m"),
    )
    gates = (
        Level("stillness", "1", "stillness"),
        Level("distance", "1", "max_distance", at_least=False),
        Level("speed", "1", "max_speed", at_least=False),
    )

    def __init__(self, parameters: FootNavigatorParameters) -> None:
        self.parameters = parameters
        self.stage = ""
        self.number = 0
        self._walk: InsTrajectory | None = None
        self._standing: list[Segment] = []
        self._stands = False
        self._rate_told = False
        self._held_rates = HeldRates()

    @property
    def pose(self) -> Pose | None:
        """Where the foot is and how its sensor is biased; None before it first stood."""
        return None if self._walk is None else self._walk.filter.pose

    def start(self, context: Context) -> tuple[str, ...]:
        """Begin a track where a stream is of a foot and has three axes of each sensor."""
        stream = context.stream
        if "foot" not in (stream.placement or "foot"):
            raise CannotStart
        columns = inertial_columns(stream)
        if columns is None:
            text = f"no track: expected three axes of {' and '.join(QUANTITIES)}, found others"
            raise CannotStart(text if stream.placement else "")
        self._columns, self._topic, self._holder = columns, context.topic, NonFiniteHold()
        self._held_rates = HeldRates()
        self._lost_count = self._lost_ns = self._sample_count = 0
        self._segments = segments_of(self.parameters, stream.rate_hz)
        self.begin(context.stage, context.tracks.next())
        return ("foot",)

    def process(self, block: SignalBlock) -> Iterator[Output]:
        """Go on by the samples of a block."""
        rate_hz = block.stream.rate_hz
        if rate_hz < LEAST_RATE_HZ and not self._rate_told:
            text = f"{block.topic}: a swing of a foot needs {LEAST_RATE_HZ:g} Hz to be followed"
            yield Note(block.start_ns, f"{text}, found {rate_hz:g}", "WARN", self.stage)
        self._rate_told = True
        finite = self._holder.fill(block.select(self._columns))
        self._sample_count += len(block)
        values = finite.values
        if values.shape[1] < SIGNAL_COLUMNS:
            values = np.pad(values, ((0, 0), (0, 3)), constant_values=np.nan)
        yield from self._navigate(self._segments.add(block.sample_times(), values))

    def filled(self, gap: Gap) -> None:
        """Take it that the next samples are straight lines over a gap: they tell less."""
        self._segments.lose(gap.lost)
        self._lost_count, self._lost_ns = self._lost_count + gap.lost, gap.end_ns

    def flush(self) -> Iterator[Output]:
        """End the track."""
        for segments in self._segments.flush():
            yield from self._navigate(segments)
        yield from self.finish()
        if self._held_rates.count > 1:
            text = f"{self._topic}: {self._held_rates.summary()}"
            yield Note(self._held_rates.longest_ns, text, "WARN", self.stage)
        if self._lost_count > LOST_PART * self._sample_count:
            text = (
                f"{self._topic}: {self._lost_count} of {self._sample_count} samples were lost: the "
                "track is less sure for the straight lines in their place"
            )
            yield Note(self._lost_ns, text, "WARN", self.stage)
        if self._holder.count:
            text = f"{self._topic}: {self._holder.count} samples not finite, last value held"
            yield Note(self._holder.last_ns, text, "WARN", self.stage)

    def decided(self, block: CandidateBlock) -> Sequence[TrackPoint]:
        """Go on by the segment just decided."""
        return self.follow(self._segment, bool(block.accepted[0]))

    def _navigate(self, segments: SegmentRun) -> Iterator[Output]:
        """Go on by segments, each with which a stance may begin decided before the next."""
        at, previous_count = 0, self._held_rates.count
        self._held_rates.add(segments)
        if self._held_rates.count and not previous_count:
            text = f"{self._topic}: {self._held_rates.warning()}"
            yield Note(self._held_rates.first_ns, text, "WARN", self.stage)
        while at < len(segments):
            at, points = self.go_on(segments, at)
            yield from points
            if at < len(segments):
                self._segment = segments[at]
                candidates = self.measure(self._segment)
                if len(candidates):
                    yield candidates
                else:
                    yield from self.follow(self._segment, None)
                at += 1

    def begin(self, stage: str, number: int) -> None:
        """Begin a track of its own; ``stage`` and ``number`` go into its points."""
        self.stage, self.number = stage, number
        self._walk, self._standing, self._stands = None, [], False

    def go_on(self, segments: SegmentRun, start: int) -> tuple[int, list[TrackPoint]]:
        """Go on from a segment until one that is to be measured; return it, and what is known."""
        walk = self._walk
        if walk is None or self.parameters.magnetometer:
            return start, []
        at, self._stands = walk.go_on(segments, start, stands=self._stands)
        return at, walk.take_points()

    def measure(self, segment: Segment) -> Candidates:
        """Go on by a segment; return the stance that may begin with it, or none."""
        stillness = 1 / (1 + segment.statistic)
        still = segment.statistic <= self._limit(segment)
        none = Candidates.empty(len(self.columns))
        if self._walk is None:
            self._standing = [*self._standing, segment] if still else []
            return none
        walk = self._walk
        swung_s = walk.predict(segment, still=still, stands=self._stands)
        if not still:
            self._stands = False
        if self._stands or not still:
            return none
        seen = walk.stillness(segment)
        speed = float(np.linalg.norm(seen.value)) / walk.usual_mps
        row = [stillness, seen.distance, speed, swung_s, *walk.position[:2]]
        return Candidates(
            np.array([segment.time_ns], np.int64),
            np.zeros(1, np.int32),
            np.array([row], np.float32),
        )

    def follow(self, segment: Segment, accepted: bool | None) -> list[TrackPoint]:
        """Take the verdict on what was just measured, None if nothing; return what is known."""
        if self._walk is None:
            return self._align(segment)
        if accepted is not None:
            self._stands = accepted
        return self._walk.follow(segment, self._stands, accepted)

    def finish(self) -> list[TrackPoint]:
        """End the track; return what is still to say of it."""
        walk, self._walk = self._walk, None
        return [] if walk is None else walk.flush()

    def _limit(self, segment: Segment) -> float:
        """Return up to what statistic a foot stands: a fast one rolls on while it does."""
        return max(self.parameters.sure, self.parameters.share * segment.peak)

    def _align(self, segment: Segment) -> list[TrackPoint]:
        """Begin the track where the foot has stood for long enough."""
        if sum(part.length_s for part in self._standing) < self.parameters.align_s:
            return []
        force = np.concatenate([part.force[1:] for part in self._standing]).mean(axis=0)
        if np.linalg.norm(force) < LEAST_FORCE_MPS2:
            return []
        self._walk = InsTrajectory(self.parameters, levelled(force), self.stage, self.number)
        for part in self._standing[:-1]:
            kernels.navigation.stand_on(self._walk.filter.state[()], part.rate, part.length_s)
        self._standing, self._stands = [], True
        return self._walk.follow(segment, self._stands, None)


def inertial_columns(stream: Stream) -> list[int] | None:
    """Return the columns of rate and force, x, y, z each, and of the magnetic field if it is there.

    None where rate or force do not have three axes.
    """
    columns = []
    for quantity in (*QUANTITIES, "magnetic_field"):
        axis_columns = columns_of_axes(stream, quantity)
        if not axis_columns and quantity in QUANTITIES:
            return None
        columns += axis_columns
    return columns


def segments_of(p: FootNavigatorParameters, rate_hz: float) -> Segments:
    """Return what cuts samples into segments in which a foot stands or swings."""
    # what filters is not imported where pipelines are only listed
    from ..detectors.zero_velocity import ZeroVelocityParameters
    from .strapdown import Segments

    statistic = ZeroVelocityParameters(
        p.window_s, p.acceleration_sigma, p.rotation_sigma, stride_s=p.stride_s
    )
    return Segments(rate_hz, statistic)
