"""The heading estimator: samples in, orientation, heading and tests of the field out.

It can be used without a pipeline::

    estimator = HeadingEstimator(HeadingParameters(), rate_hz=100.0)
    for frame in [*estimator.add(samples), *estimator.flush()]:
        frame.orientation, frame.heading_rad, frame.sigma_rad, frame.undisturbed
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import replace
from functools import cache
from itertools import repeat
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.events import Disturbance, Heading, Note
from groundtrace_codecs.signals import G0_MPS2, NS_PER_S, SignalBlock

from .. import kernels
from ..dsp.robust import MAD_SIGMA
from ..pipeline.gates import Candidates
from ..pipeline.stage import CannotStart, Context, Input, Memory, Stage
from .attitude import (
    LEVEL_RAD,
    Attitude,
    AttitudeNoise,
    HeadingFrame,
    HeadingFrames,
    HeadingParameters,
)
from .frames import PATIENCE_NS, Samples, SensorAligner, columns_of_axes, frame_of
from .heading_baselines import AzimuthKalman, Exponential, turn_about_vertical
from .magnetometer import (
    COLUMNS,
    DERIVATIVE_S,
    DEVIATION_S,
    GATES,
    TESLA,
    TESTS,
    TOO_LITTLE,
    Calibration,
    Compass,
    DisturbedSpans,
)
from .rotations import headings_of, matrix, product, wrap_angle

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import CandidateBlock, Event, Gap

    from ..pipeline.stage import Output
    from .attitude import HeadingFilter
    from .frames import InertialFrame
    from .heading_baselines import ScalarFilter
    from .rotations import Array


#: A second is a quiet one where the sensor turns and shakes by less than this about its mean: held
#: in a hand that stands, not only laid down. Standard deviations [rad/s], [m/s2]. Chosen by trial
#: on logs of IPIN 2023: with half of it some have no quiet second, with half as much again their
#: means scatter by twice as much.
QUIET_RATE, QUIET_FORCE = 0.1, 0.5
#: What the means of quiet seconds scatter by at least, per axis [rad/s], how many tell a bias at
#: least, and how many of the last are looked at. Chosen by trial on logs of IPIN 2023: with half
#: the scatter and four seconds gyroscopes without a bias get one.
QUIET_SCATTER, QUIET_LEAST, QUIET_MOST = 0.007, 6, 30
#: So many samples tell a spread. Chosen by judgement: a second of 6 Hz does, one of 1 Hz does not.
SPREAD_LEAST = 5
#: A bias is another one where an axis is off by this many standard deviations, or where it is known
#: this many times worse. Chosen by judgement: one of 120 by chance, of three axes; quiet seconds
#: err alike where somebody turns.
OTHER_SIGMAS, KNOWN_WORSE = 3.0, 2.0


class QuietSeconds:
    """Tells the bias of a gyroscope by the seconds in which its sensor is held still.

    A hand turns it a little all the same, now this way and now that: the median of several seconds
    is the bias, and what they scatter by tells how surely.

    Parameters
    ----------
    rate_hz
        Of the sensor [Hz].

    Attributes
    ----------
    means
        Of the last quiet seconds, shape (3,) each [rad/s].
    """

    def __init__(self, rate_hz: float) -> None:
        self._length = max(round(rate_hz), 1)
        self._rate, self._force = np.empty((0, 3)), np.empty((0, 3))  # of the second under way
        self.means: list[Array] = []

    def ends(self, samples: Samples) -> list[tuple[int, Array]]:
        """Take samples; return where quiet seconds end among them, and their mean rates [rad/s]."""
        before, length = len(self._rate), self._length
        rate = np.concatenate([self._rate, samples.rate])
        force = np.concatenate([self._force, samples.force])
        count = len(rate) // length
        self._rate, self._force = rate[count * length :], force[count * length :]
        seconds = [x[: count * length].reshape(count, length, 3) for x in (rate, force)]
        spreads = [np.sqrt(x.var(axis=1).sum(axis=1)) for x in seconds]
        quiet = (spreads[0] <= QUIET_RATE) & (spreads[1] <= QUIET_FORCE)
        rows = np.flatnonzero(quiet & (length >= SPREAD_LEAST))
        means = seconds[0][rows].mean(axis=1)
        return list(zip(((rows + 1) * length - before).tolist(), means, strict=True))

    def bias(self, mean: Array) -> tuple[Array, Array] | None:
        """Take the mean of a quiet second; return the bias and its deviations, shape (3,) [rad/s].

        None while there are too few.
        """
        self.means = [*self.means[1 - QUIET_MOST :], mean]
        if len(self.means) < QUIET_LEAST:
            return None
        means = np.array(self.means)
        bias = np.median(means, axis=0)
        scatter = np.maximum(MAD_SIGMA * np.median(np.abs(means - bias), axis=0), QUIET_SCATTER)
        # a median is less sure than a mean, by this part
        return bias, scatter * math.sqrt(math.pi / 2 / len(means))


class HeadingEstimator:
    """Fuses gyroscope, specific force and magnetic field of one body-worn sensor.

    Parameters
    ----------
    parameters
        As documented there.
    rate_hz
        Sampling rate [Hz].

    Attributes
    ----------
    attitude, compass, calibration
        What it is made of.
    scalar
        The filter of one angle, if there is one.
    turned_rad2
        By the time of a sample at which the gyroscope's bias became another one: variances of how
        far it may have turned before, about each axis [rad2].

    Notes
    -----
    The headings of the gyroscope alone and of the compass alone are told beside the fused one. Both
    share the tilt of the filter, which the field never changes, so that either differs from the
    fused orientation by a turn about the vertical. The gyroscope's begins at the first field's
    heading; of the bias it knows what the sensor showed at rest, nothing that the compass teaches.
    """

    def __init__(self, parameters: HeadingParameters, rate_hz: float) -> None:
        self.parameters = parameters
        self.rate_hz = rate_hz
        self.length = max(2, round(parameters.frame_s * rate_hz))
        self.axis = axis_of(parameters.axis)
        self.attitude = Attitude(AttitudeNoise(gyro_scale=parameters.gyro_scale))
        self.compass = Compass(parameters)
        self.scalar = _scalar_filter(parameters)
        self.calibration = Calibration()
        self._quiet = QuietSeconds(rate_hz)
        self._biased_ns: int | None = None  # since when the bias is what it is
        self._turned_rad2 = np.zeros(3)  # by another bias, of the next sample
        self.turned_rad2: dict[int, Array] = {}
        self._waiting: list[Samples] = []
        self._faced = False  # a field
        self._waits = False  # there is a field, but the sensor is not known to be level

    @property
    def delay_s(self) -> float:
        """How much later than the gyroscope the magnetometer answers [s]."""
        late, moved = self.attitude.state["delay_sums"].tolist()
        return float(late / moved)

    def resume(self, before: HeadingEstimator) -> None:
        """Know of the sensor and the field what was known before a gap, not where it points."""
        self._quiet.means, self.calibration = before._quiet.means, before.calibration
        self.attitude.resume(before.attitude)

    def add(self, samples: Samples) -> Sequence[HeadingFrame]:
        """Take samples of any number; return the frames that are complete by now."""
        parts: list[HeadingFrames] = []
        start = 0
        for stop, mean in self._quiet.ends(samples):
            parts += self._gathered(self._less_sure(samples.rows(start, stop)))
            self._compare(mean, int(samples.time_ns[stop - 1]))
            start = stop
        if start < len(samples):
            parts += self._gathered(self._less_sure(samples.rows(start, len(samples))))
        return HeadingFrames.concatenate(parts) if parts else []

    def _less_sure(self, samples: Samples) -> Samples:
        """Return samples of which the first may have turned as far as another bias says."""
        if self._biased_ns is None:
            self._biased_ns = int(samples.time_ns[0])
        if not self._turned_rad2.any():
            return samples
        turned_rad2, self._turned_rad2 = self._turned_rad2, np.zeros(3)
        self.turned_rad2[int(samples.time_ns[0])] = turned_rad2
        return samples.less_sure(0, turned_rad2)

    def _compare(self, mean: Array, time_ns: int) -> None:
        """Let the gyroscope have the bias of quiet seconds, where they know better."""
        bias_sigma = self._quiet.bias(mean)
        if bias_sigma is None or not self.attitude.started:
            return
        bias, sigma = bias_sigma
        off, believed = bias - self.attitude.bias, self.attitude.bias_sigma
        contradicted = np.abs(off) > OTHER_SIGMAS * np.hypot(sigma, believed)
        if not contradicted.any() and not (believed > KNOWN_WORSE * sigma).all():
            return
        self.attitude.take_bias(bias, sigma)
        assert self._biased_ns is not None  # samples came before
        self._turned_rad2 = (off * (time_ns - self._biased_ns) / NS_PER_S) ** 2
        self._biased_ns = time_ns

    def _gathered(self, samples: Samples) -> list[HeadingFrames]:
        """Take samples of one bias; return the frames that are complete by now."""
        buffered = Samples.joined([*self._waiting, samples])
        count = len(buffered) // self.length * self.length
        self._waiting = [buffered.rows(count, len(buffered))]
        frames: list[HeadingFrames] = []
        at = 0
        while at < count:
            frames.append(self._next(buffered.rows(at, count), self.length))
            at += len(frames[-1]) * self.length
        return frames

    def flush(self) -> Sequence[HeadingFrame]:
        """Return the last, shorter frame."""
        left, self._waiting = self._waiting, []
        frames = [self._next(part, len(part)) for part in left if len(part)]
        return HeadingFrames.concatenate(frames) if frames else []

    def _next(self, samples: Samples, length: int) -> HeadingFrames:
        """Go on by the next frames, at least one."""
        first = samples.rows(0, length)
        if self.scalar is not None:
            return HeadingFrames.of([self._frame(first, self.scalar)])
        if not self.attitude.started or not self.attitude.knows_field:
            self._begin(first)
        return fused_frames(self, samples, length)

    def _begin(self, samples: Samples) -> InertialFrame:
        """Begin with what the next frame is the first to tell; return that frame."""
        attitude = self.attitude
        samples = replace(samples, field=self.calibration.corrected(samples.field))
        frame = frame_of(samples, 1.0 / self.rate_hz, attitude.bias, self.delay_s)
        record = frame.record
        if not attitude.started:
            moves = (np.linalg.norm(record["rate"]), record["rate_spread"], record["force_spread"])
            still = bool((np.array(moves) < (REST_RATE, REST_SPREAD, REST_FORCE)).all())
            attitude.start(record["force"], still=still)
        field = record["field"]
        if not attitude.knows_field and np.isfinite(field).all():
            if attitude.tilt_rad <= LEVEL_RAD:
                self._meet(matrix(attitude.orientation) @ field)
            else:
                self._waits = not self._faced
        return frame

    def _frame(self, samples: Samples, scalar: ScalarFilter) -> HeadingFrame:
        """Go on by one frame, the heading by a filter of one angle."""
        attitude = self.attitude
        state, frame = attitude.state, self._begin(samples)
        orientation = product(attitude.orientation, frame.turns)
        heading = headings_of(orientation, self.axis)
        sigma, offset = attitude.heading_sigma_rad, float(state["gyroscope_offset_rad"])
        resting = self._move(frame, scalar)
        moved = attitude.orientation
        tests, compass_rad, undisturbed = self._look(frame, scalar)
        state["gyroscope_offset_rad"] -= turn_about_vertical(moved, attitude.orientation)
        compass = bool(np.isfinite(tests).all())
        alone = (wrap_angle(heading[0] + turn) for turn in (offset, compass_rad))
        raw = samples.field[len(samples) // 2 : len(samples) // 2 + 1]
        notes = self.calibrate(raw, np.array([compass]), np.array([undisturbed]))
        texts = (*self.news(), *notes.get(0, ()))
        return HeadingFrame(
            time_ns=samples.time_ns,
            orientation=orientation,
            heading_rad=heading,
            sigma_rad=sigma,
            bias=attitude.bias,
            values=np.array([*tests, *map(math.degrees, alone)]),
            undisturbed=undisturbed,
            compass=compass,
            resting=resting,
            notes=texts,
        )

    def _meet(self, field: Array) -> None:
        """Take the first field, earth frame [T], for the earth's, or face it by that of before."""
        sigma_t = self.parameters.field_sigma_ut * TESLA
        attitude, state, before = self.attitude, self.attitude.state, self.attitude.orientation
        place_t = self.parameters.place_ut * TESLA
        seen, earth = np.array([math.hypot(field[0], field[1]), field[2]]), attitude.earth_before
        off_t = float(np.nan_to_num(np.linalg.norm(seen - earth)))
        north_t, up_t = np.where(np.isnan(earth), seen, earth).tolist()
        attitude.take_earth(north_t, up_t, place_t)
        attitude.face(field, math.hypot(sigma_t, off_t))
        turn = turn_about_vertical(before, attitude.orientation)
        state["gyroscope_offset_rad"] = state["gyroscope_offset_rad"] - turn if self._faced else 0.0
        self._faced = True

    def news(self) -> tuple[str, ...]:
        """Return what a person should know since it was asked for last: of a late beginning."""
        if not (self._waits and self._faced):
            return ()
        self._waits = False
        return (LATE,)

    def _move(self, frame: InertialFrame, scalar: ScalarFilter) -> bool:
        """Go on to the frame's end by gyroscope and specific force; say whether it rests."""
        attitude = self.attitude
        state, p, length_s = attitude.state, settings_of(self, frame.length_s), frame.length_s
        before, last = float(state["covariance"][2, 2]), tuple(frame.turns[-1].tolist())
        kernels.attitude.propagate(state[()], frame.record[()], last, length_s, p[()])
        resting = kernels.attitude.motion_update(state[()], frame.record[()], length_s, p[()]) > 0
        grown = max(float(state["covariance"][2, 2]) - before, 0.0)
        turn = scalar.advance(frame.length_s, grown)
        attitude.turn_heading(turn)
        state["gyroscope_offset_rad"] -= turn
        return resting

    def _look(self, frame: InertialFrame, scalar: ScalarFilter) -> tuple[Array, float, bool]:
        """Test the frame's field and learn from it.

        Return the tests' values, the compass's heading over that of the attitude [rad], and the
        verdict.
        """
        record, state, compass = frame.record, self.attitude.state, self.compass
        if not (np.isfinite(record["field"]).all() and self.attitude.knows_field):
            return np.full(len(TESTS), np.nan), math.nan, True
        p = settings_of(self, frame.length_s)
        compass.make_room(state, int(p["deviation_frames"]), 1)
        state["fields"] += 1
        record["earth_field"] = seen = record["axes"] @ record["field"]
        kernels.attitude.field_tests(
            *(state[()], record[()], compass.norms, compass.azimuths, frame.length_s, p[()])
        )
        compass.make_room(state, int(p["deviation_frames"]), 0)
        undisturbed = bool((p["limits"] - record["tests"].astype(np.float32) >= 0.0).all())
        if undisturbed:
            sigma = self.parameters.field_sigma_ut * TESLA / max(state["earth_field"][0], TESLA)
            sigma *= math.sqrt(2 * self.parameters.field_memory_s / frame.length_s)
            self.attitude.turn_heading(scalar.correct(math.atan2(seen[0], seen[1]), sigma))
            late, moved = record["delay_sums"].tolist()
            state["delay_sums"] += late + self.delay_s * moved, moved
        else:  # what changes is looked at among fields that pass
            state["fields"] = 0
        self.attitude.reset_heading(scalar.sigma_rad)
        return np.array(record["tests"]), float(compass.azimuths[-1]), undisturbed

    def calibrate(
        self, raws: Array, seen: NDArray[np.bool_], passed: NDArray[np.bool_]
    ) -> dict[int, tuple[str, ...]]:
        """Watch fields as measured; begin anew with the field where it is now calibrated.

        Parameters
        ----------
        raws
            One of each frame, shape (n, 3) [T].
        seen, passed
            Frames that have a field, and those whose field passed its tests, shape (n,).

        Returns
        -------
        What a person should know at some of the frames.
        """
        calibration, places = self.calibration, np.flatnonzero(seen).tolist()
        if not places:
            return {}
        notes: dict[int, tuple[str, ...]] = {}
        if calibration.wanting:
            notes = dict.fromkeys(places[:-1], (TOO_LITTLE,))
        if calibration.take(raws[seen], int(np.count_nonzero(seen & ~passed))):
            notes[places[-1]] = (self._calibrated(),)
        elif calibration.wanting:
            notes[places[-1]] = (TOO_LITTLE,)
        return notes

    def _calibrated(self) -> str:
        """Begin anew with a field that is calibrated; return what a person should know."""
        assert self.calibration.ellipsoid is not None
        self.compass = Compass(self.parameters)
        self.attitude.forget_field()
        x, y, z = (self.calibration.ellipsoid.centre / TESLA).tolist()
        return f"magnetometer calibrated: hard iron {x:.1f}, {y:.1f}, {z:.1f} uT taken out"


@cache
def axis_of(name: str) -> Array:
    """Return the unit vector of a body axis such as ``x`` or ``-z``, shape (3,), to read only."""
    unit = np.eye(3)["xyz".index(name[-1])]
    return np.asarray(-unit if name.startswith("-") else unit)


def _scalar_filter(parameters: HeadingParameters) -> ScalarFilter | None:
    if parameters.filter == "exponential":
        return Exponential()
    if parameters.filter == "kalman":
        return AzimuthKalman()
    return None


#: A sensor rests that turns and shakes by less than this for a time [rad/s], [m/s2], [s]. Chosen by
#: judgement: over the offset and noise of cheap sensors, under what a person who stands does.
REST_RATE, REST_SPREAD, REST_FORCE, REST_S = 0.05, 0.02, 0.15, 1.0
#: What a person is told where a sensor was not level at first.
LATE = (
    "the sensor moved when its signal began, so that its heading is known from here on: until then "
    "the deviation of headings is 180 degrees"
)
#: Velocity left at rest [m/s]. Chosen by judgement: who stands sways by some 0.01 m/s.
REST_SPEED = 0.02
#: What of the noise frames are filtered by.
NOISE = (
    *("gyro_walk", "gyro_scale", "bias_walk", "force_walk", "iron_walk", "earth_walk"),
    *("speed_mps", "rest_rate_left"),
)


def fused_frames(one: HeadingEstimator, samples: Samples, length: int) -> HeadingFrames:
    """Go on by frames of so many samples, at least one, until a calibration may change anything.

    What they begin with, tilt and earth's field, must be known; they end before the first field
    where the earth's is not.
    """
    attitude, calibration, compass = one.attitude, one.calibration, one.compass
    state, p = attitude.state, settings_of(one, length / one.rate_hz)
    field = np.ascontiguousarray(calibration.corrected(samples.field))
    count = min(len(samples) // length, calibration.next_try)
    if not attitude.knows_field:
        sees = np.isfinite(field[: count * length]).reshape(count, -1).all(axis=1)
        count = max(int(np.argmax(sees)) if sees.any() else count, 1)
        field = np.full_like(field, np.nan)  # it says nothing to a sensor that is not level
    rows = count * length
    orientation, heading = np.empty((rows, 4)), np.empty(rows)
    outputs, frame = np.zeros(count, kernels.attitude.TOLD), np.zeros((), kernels.attitude.FRAME)
    outputs["tests"] = outputs["compass_rad"] = np.nan
    compass.make_room(state, int(p["deviation_frames"]), count)
    unseen = samples.unseen[:rows].reshape(count, length, 6).sum(axis=1)
    rate, force = np.ascontiguousarray(samples.rate), np.ascontiguousarray(samples.force)
    given = (rate, force, field, unseen, length)
    into = (compass.norms, compass.azimuths, orientation, heading, outputs)
    records, at = (state[()], frame[()], p[()], one.axis), 0
    while (at := kernels.attitude.filter_frames(*given, at, *records, *into)) < count:
        late, moved = frame["delay_sums"].tolist()
        delay_s = one.delay_s
        if compass.judge(attitude, frame, length / one.rate_hz, p):
            state["delay_sums"] += late + delay_s * moved, moved
        else:
            outputs["passed"][at] = 0.0
        outputs["tests"][at], outputs["gyro_bias"][at] = frame["tests"], state["gyro_bias"]
        at += 1
    compass.make_room(state, int(p["deviation_frames"]), 0)
    if not attitude.knows_field:
        outputs["sigma_rad"] = attitude.heading_sigma_rad
    alone = (
        np.stack([outputs["gyroscope_rad"], outputs["compass_rad"]], axis=1)
        + heading[::length, None]
    )
    alone = np.degrees((alone + math.pi) % (2 * math.pi) - math.pi)
    seen, passed = np.isfinite(outputs["compass_rad"]), outputs["passed"] > 0
    notes = one.calibrate(samples.field[length // 2 : rows : length], seen, passed)
    if news := one.news():
        notes[0] = (*news, *notes.get(0, ()))
    return HeadingFrames(
        time_ns=samples.time_ns[:rows],
        orientation=orientation,
        heading_rad=heading,
        first=np.arange(0, rows + 1, length),
        sigma_rad=outputs["sigma_rad"],
        bias=outputs["gyro_bias"],
        values=np.concatenate([outputs["tests"], alone], axis=1),
        undisturbed=passed,
        compass=seen,
        resting=outputs["resting"] > 0,
        notes=notes,
    )


def settings_of(one: HeadingEstimator, length_s: float) -> NDArray[Any]:
    """Return what the filter takes its sensors for, for frames of a length [s].

    A record of shape (), as :data:`.kernels.attitude.SETTINGS` names its fields.
    """
    p, noise, settings = one.parameters, one.attitude.noise, np.zeros((), kernels.attitude.SETTINGS)
    window = max(round(DEVIATION_S / length_s), 2), max(round(DERIVATIVE_S / length_s), 2)
    field_sigma_t = p.field_sigma_ut * TESLA * math.sqrt(2 * p.field_memory_s / length_s)
    for name, value in {
        **{name: getattr(noise, name) for name in NOISE},
        "gravity_mps2": G0_MPS2,
        "rest_rate": REST_RATE,
        "rest_rate_spread": REST_SPREAD,
        "rest_force_spread": REST_FORCE,
        "rest_s": REST_S,
        "rest_speed_mps": REST_SPEED,
        "field_sigma_t": field_sigma_t,
        "drift_factor": p.drift_factor,
        "limits": limits_of(p),
        "step_s": 1 / one.rate_hz,
        "deviation_frames": window[0],
        "derivative_frames": window[1],
        "gyroscope_heading": one.attitude.free or not one.attitude.knows_field,
    }.items():
        settings[name] = value
    return settings


def limits_of(parameters: HeadingParameters) -> Array:
    """Return the threshold of each test, shape (8,)."""
    by_name = {gate.name: float(getattr(parameters, gate.parameter)) for gate in GATES}
    return np.array([by_name[test.name] for test in TESTS])


class HeadingStage(Stage):
    """Runs a heading filter on every sensor with a gyroscope and an accelerometer.

    Streams of one placement are one sensor: its magnetometer may have a topic of its own. Each
    frame is a candidate, accepted where the field is undisturbed. A gap of the gyroscope that is
    not bridged, and a step of its clock, begin anew; other gaps leave the field or the force out.

    Notes
    -----
    ``Parameters`` has ``output_hz`` and ``join_s``.
    """

    takes = (
        Input(SignalBlock, frozenset({"angular_velocity"}), hold=False),
        Input(SignalBlock, frozenset({"acceleration"}), hold=False),
        Input(SignalBlock, frozenset({"magnetic_field"}), hold=False, required=False),
    )
    gives = (Heading, Disturbance)
    compiles = ("attitude", "grid", "steps")
    scope = "placement"
    rounds = ("angular_velocity",)

    def __init__(self, parameters: Any) -> None:
        self.parameters = parameters

    @abstractmethod
    def filter(self, rate_hz: float) -> HeadingFilter:
        """Return a filter of samples at a rate [Hz]."""

    @property
    def memory(self) -> Memory:
        """All before, by which the filter knows; and the frame, other sensors, and what joins."""
        p = self.parameters
        return Memory(None, p.frame_s + PATIENCE_NS / NS_PER_S + p.join_s)

    def start(self, context: Context) -> tuple[str, ...]:
        """Begin with a gyroscope."""
        if not columns_of_axes(context.stream, "angular_velocity"):
            raise CannotStart
        self._stage, self._topic = context.stage, context.topic
        self._period_ns = context.stream.period_ns
        self._filter = self.filter(context.stream.rate_hz)
        self._spans = DisturbedSpans(context.stage, round(self.parameters.join_s * NS_PER_S))
        self._aligner = SensorAligner()
        self._due_ns: int | None = None
        self._noted_texts: frozenset[str] = frozenset()
        self._turning = False
        return ("field",)

    def process(self, block: SignalBlock) -> Iterator[Output]:
        """Take what a stream measures; the first of the gyroscope begins it all."""
        self._aligner.update(block)
        if not self._turning and not columns_of_axes(block.stream, "angular_velocity"):
            return
        self._turning = True
        remark = self._aligner.remark
        if remark and remark not in self._noted_texts:
            self._noted_texts |= {remark}
            yield Note(block.start_ns, remark, "WARN", self._stage)
        yield from self._frames(self._filter.add(self._aligner.take()))

    def filled(self, gap: Gap) -> None:
        """Take it that samples of the gyroscope are straight lines over a gap: they tell less."""
        self._aligner.lose(gap)

    def flush(self) -> Iterator[Output]:
        """End the run."""
        yield from self._frames([*self._filter.add(self._aligner.flush()), *self._filter.flush()])
        yield from self._spans.flush()
        if self._due_ns is not None and not self._aligner.has_field:
            text = "no magnetic field: headings are turns since the signal began, not against north"
            yield Note(self._due_ns, f"{self._topic}: {text}", "INFO", self._stage)

    def decided(self, block: CandidateBlock) -> Sequence[Event]:  # noqa: ARG002
        """Yield nothing: whether the field is undisturbed is known to the filter already."""
        return ()

    def _frames(self, given: Sequence[HeadingFrame]) -> Iterator[Output]:
        """Yield what frames say: the tests of the field, disturbances, headings, notes."""
        if not given:
            return
        frames = given if isinstance(given, HeadingFrames) else HeadingFrames.of(given)
        tested = np.flatnonzero(frames.compass)
        if len(tested):
            yield Candidates(
                frames.time_ns[frames.first[tested]],
                np.zeros(len(tested), np.int32),
                frames.values[tested].astype(np.float32),
            )
        yield from self._disturbances(frames)
        yield from self._headings(frames)
        yield from self._notes(frames)

    def _disturbances(self, frames: HeadingFrames) -> Iterator[Event]:
        """Yield the disturbances that are over."""
        disturbed = frames.compass & ~frames.undisturbed
        if not (disturbed.any() or self._spans.under_way):
            return
        starts_ns = frames.time_ns[frames.first[:-1]].tolist()
        ends_ns = (frames.time_ns[frames.first[1:] - 1] + self._period_ns).astype(np.int64).tolist()
        offs = np.where(frames.compass, frames.values[:, 0], np.nan).tolist()
        for start_ns, end_ns, off, bad in zip(
            starts_ns, ends_ns, offs, disturbed.tolist(), strict=True
        ):
            yield from self._spans.add(start_ns, end_ns, off, disturbed=bad)

    def _headings(self, frames: HeadingFrames) -> Iterator[Heading]:
        """Return the headings that are due."""
        every_ns = max(NS_PER_S / self.parameters.output_hz, self._period_ns)
        rows = []
        for row, time_ns in enumerate(frames.time_ns.tolist()):
            if self._due_ns is None or time_ns >= self._due_ns - self._period_ns / 2:
                rows.append(row)
                self._due_ns = round(max(self._due_ns or 0, time_ns - every_ns / 2) + every_ns)
        sigma = np.repeat(self.claimed_rad(frames.sigma_rad), frames.lengths)[rows]
        columns = (frames.time_ns[rows], frames.heading_rad[rows], sigma)
        return map(Heading, *(x.tolist() for x in columns), repeat(self._stage))

    def claimed_rad(self, sigma_rad: Array) -> Array:
        """Return the standard deviations of headings that a filter knows so well [rad]."""
        return sigma_rad

    def _notes(self, frames: HeadingFrames) -> Iterator[Note]:
        """Yield what a person should know, each once."""
        for frame_index, texts in frames.notes.items():
            for text in texts:
                if text not in self._noted_texts:
                    self._noted_texts |= {text}
                    time_ns = int(frames.time_ns[frames.first[frame_index + 1] - 1])
                    yield Note(time_ns, f"{self._topic}: {text}", "INFO", self._stage)


class CompassHeading(HeadingStage):
    """Fuses gyroscope, specific force and magnetic field of one body-worn sensor."""

    Parameters = HeadingParameters
    columns = COLUMNS
    gates = GATES

    def filter(self, rate_hz: float) -> HeadingEstimator:
        """Return an estimator at a rate [Hz]."""
        return HeadingEstimator(self.parameters, rate_hz)

    def claimed_rad(self, sigma_rad: Array) -> Array:
        """Add what the field's direction itself may be off by, which the filter cannot see."""
        both = np.hypot(sigma_rad, math.radians(self.parameters.direction_deg))
        return np.asarray(np.minimum(both, math.pi))

    def resume(self, before: CompassHeading) -> None:
        """Know what was known of the sensor before a gap."""
        now, then = self._filter, before._filter
        assert isinstance(now, HeadingEstimator)
        assert isinstance(then, HeadingEstimator)
        now.resume(then)
