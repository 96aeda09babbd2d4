"""Inputs of dead reckoning: length of a step, facing, known positions, satellite fixes and height.

The length of a step is constant, or follows from the walker's height, or from how the body moved.
Sources: H. Weinberg, Using the ADXL202 in pedometer and personal navigation applications, Analog
Devices AN-602 (2002): the length goes with the fourth root of the swing of the vertical
acceleration. W. Zijlstra and A. L. Hof, Displacement of the pelvis during human walking, Gait &
Posture 6 (1997) 249: the body is an inverted pendulum on the leg, and its rise gives the length,
times a factor, 1.25 there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple

import numpy as np

from groundtrace_codecs.signals import ACCURACY, ACCURACY_SIGMAS, NS_PER_S

from .. import kernels
from ..pipeline.parameters import Updates, gate, measured
from .body_motion import MEMORY_S, STEEP, WalkingAxis, level_axis, step_swing
from .heading import axis_of
from .rotations import mean_matrix

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Label, StepEvent
    from groundtrace_codecs.geometry import TangentPlane
    from groundtrace_codecs.signals import SignalBlock, Stream

    from .body_motion import Ahead, Axis, LevelFrameMotion


#: Models of the length of a step; empty leaves it to the placement.
LengthModel = Literal[
    "",
    "fixed",
    "calibrated",
    "height",
    "weinberg",
    "pendulum",
    "cadence",
    "interval",
    "fused",
]


@dataclass(frozen=True, slots=True)
class ReckoningParameters:
    """Parameters of :class:`.pdr.PedestrianDeadReckoning`."""

    axis: Annotated[
        Literal["", "walk", "x", "y", "z", "-x", "-y", "-z"],
        measured(
            "",
            "Sensor axis that looks ahead, or walk: the walk tells; "
            "empty: y of a phone, x of foot and wrist, walk elsewhere.",
        ),
    ] = ""
    azimuth: Annotated[
        Literal["fused", "compass", "gyroscope"],
        measured("", "What the azimuth of steps rests on."),
    ] = "fused"
    updates: Annotated[
        Updates,
        measured("", "Known places taken in: satellite fixes, two waypoints or all of them."),
    ] = "gnss"
    step_length: Annotated[
        LengthModel,
        measured("", "Model of the length of a step; empty: weinberg of a phone, fused elsewhere."),
    ] = ""
    length_m: Annotated[float, measured("m", "Of a step, model fixed.", gt=0)] = 0.65
    calibrated_m: Annotated[float, measured("m", "Distance walked to calibrate.", gt=0)] = 65.0
    calibrated_steps: Annotated[int, measured("1", "Steps it took.", gt=0)] = 100
    height_m: Annotated[float, measured("m", "Of the walker.", gt=0)] = 1.7
    height_part: Annotated[
        float, measured("1", "Part of the height that a step is, model height.", gt=0)
    ] = 0.4
    weinberg: Annotated[
        float, measured("m^(3/4) s^(1/2)", "Length over the fourth root of the swing.", gt=0)
    ] = 0.38
    pendulum: Annotated[float, measured("1", "Step over that of an inverted pendulum.", gt=0)] = (
        1.25
    )
    cadence_part: Annotated[
        float,
        measured("s^(1/2)", "Step over height and the root of the cadence.", gt=0),
    ] = 0.31
    interval_mps: Annotated[
        float, measured("m/s", "Step over the time from its peak to the end of it.", gt=0)
    ] = 2.0
    backward: Annotated[float, measured("1", "A step back in steps ahead.", gt=0)] = 0.7
    sideways: Annotated[float, measured("1", "A step aside in steps ahead.", gt=0)] = 0.5
    pause_s: Annotated[
        float, measured("s", "Two steps further apart are not of one walk.", gt=0)
    ] = 2.0
    mount_deg: Annotated[
        float, measured("deg", "How far the axis may look away from the way.", ge=0)
    ] = 5.0
    drift_dps: Annotated[
        float, measured("deg/s", "Bias left in the gyroscope about the vertical.", ge=0)
    ] = 0.1
    compass_deg: Annotated[
        float, measured("deg", "What an undisturbed magnetic azimuth is off by.", gt=0)
    ] = 10.0
    compass_memory_m: Annotated[
        float, measured("m", "For how far it is off the same way.", ge=0)
    ] = 3.0
    direction_deg: Annotated[
        float,
        measured("deg", "What all azimuths are off by together; 0 where one was measured.", ge=0),
    ] = 10.0
    declination_deg: Annotated[
        float, measured("deg", "Of magnetic north, positive to the east of y.")
    ] = 0.0
    length_error: Annotated[float, measured("1", "Part that a single step is off by.", gt=0)] = 0.15
    scale_error: Annotated[
        float, measured("1", "Part that all lengths are off by together.", ge=0)
    ] = 0.12
    way_deg: Annotated[
        float, measured("deg", "How far a single step strays from the azimuth.", ge=0)
    ] = 6.0
    waypoint_m: Annotated[float, measured("m", "Standard deviation of a waypoint.", gt=0)] = 1.0
    gnss_m: Annotated[
        float,
        measured("m", "Standard deviation of a satellite fix that does not say its own.", gt=0),
    ] = 5.0
    gnss_s: Annotated[
        float,
        measured(
            "s",
            "Time constant of the errors of satellite fixes: those within it err alike.",
            gt=0,
        ),
    ] = 30.0
    smooth: Annotated[bool, measured("", "Also give the track smoothed, when it ends.")] = True
    smooth_s: Annotated[
        float,
        measured("s", "Longest piece of a track that is smoothed, or gone again, at once.", gt=0),
    ] = 3600.0
    cadence_hz: Annotated[float, gate("Hz", "Most steps a second.", gt=0)] = 3.5
    speed_mps: Annotated[float, gate("m/s", "Fastest walk.", gt=0)] = 3.0


#: Vertical accelerations are averaged over this [s]: impacts say nothing of a step's length. Chosen
#: by judgement: an impact lasts for less, a bob for half a second.
SMOOTH_S = 0.1
#: Signal on both sides of a step that serves its smoothing [ns]. Source: definition, half of
#: :data:`SMOOTH_S`.
MARGIN_NS = NS_PER_S // 20
#: Part of the height that the leg is. Source: D. A. Winter, Biomechanics and motor control of human
#: movement: 0.53.
LEG = 0.53


class StepShape(NamedTuple):
    """How the body moved up and down during a step.

    Attributes
    ----------
    swing
        Highest minus lowest vertical acceleration [m/s2].
    rise_m
        How far it rose and sank [m].
    peak_end_s
        Time from the highest vertical acceleration to the lowest after it [s].
    """

    swing: float
    rise_m: float
    peak_end_s: float


def shape_of(motion: LevelFrameMotion, start_ns: int, stop_ns: int) -> StepShape:
    """Return the shape of a step in ``[start_ns, stop_ns)``.

    The body's height is taken to be after it as before it.
    """
    rows = motion.rows(start_ns - MARGIN_NS, stop_ns + MARGIN_NS)
    time_ns = motion.time_ns[rows]
    if len(time_ns) < 3:
        return StepShape(0.0, 0.0, 0.0)
    given, room = (MARGIN_NS, SMOOTH_S, NS_PER_S), np.empty((2, len(time_ns)))
    return StepShape(*kernels.strides.shape(time_ns, motion.acceleration[rows], *given, room))


#: The parameter of each model that its lengths are in proportion to.
CONSTANTS = {
    "fixed": "length_m",
    "height": "height_part",
    "weinberg": "weinberg",
    "pendulum": "pendulum",
    "cadence": "cadence_part",
    "interval": "interval_mps",
}
#: By how much the lengths of a person are off together by each of the models that are fused, as a
#: part of them. Chosen by trial on 38 simulated people: weinberg 15 %, cadence 7 %; on
#: phones in the hand they are 8 and 10 % (docs/pedestrian.md).
BELIEFS = {"weinberg": 0.15, "cadence": 0.08}


def step_measures(shape: StepShape, step_s: float, height_m: float) -> dict[str, float]:
    """Return what lengths are in proportion to by each model of :data:`CONSTANTS`.

    Parameters
    ----------
    shape
        How the body moved.
    step_s
        Time of the step [s].
    height_m
        Of the walker [m].
    """
    leg = LEG * height_m
    rise = min(shape.rise_m, leg)
    return {
        "fixed": 1.0,
        "height": height_m,
        "weinberg": math.sqrt(math.sqrt(shape.swing)),
        "pendulum": 2 * math.sqrt(2 * leg * rise - rise**2),
        "cadence": height_m / math.sqrt(step_s),
        "interval": shape.peak_end_s,
    }


def step_length(
    shape: StepShape, kind: str, step_s: float, parameters: ReckoningParameters
) -> float:
    """Return the length of a step [m].

    Parameters
    ----------
    shape
        How the body moved.
    kind
        Type of the step: ``backward``, ``left``, ``right``; anything else is one ahead.
    step_s
        Time of the step [s].
    parameters
        Choose the model and hold its constants.

    Notes
    -----
    ``cadence``: people who take more steps a second take longer ones. ``interval``: source, Abadleh
    et al., MDM 2017, as told in the Dempster-Shafer thesis, chapter III.2: a step's length by the
    time from its peak to the end of the peak. ``fused``: each of :data:`BELIEFS` is a belief about
    the logarithm of the length, a Gaussian as wide as the model is off; Dempster's rule for two
    such beliefs gives their product: its middle is their mean, weighted by the inverse variances.
    """
    p = parameters
    by_kind = {"backward": p.backward, "left": p.sideways, "right": p.sideways}
    return _ahead(step_measures(shape, step_s, p.height_m), p) * by_kind.get(kind, 1.0)


def _ahead(measures: dict[str, float], p: ReckoningParameters) -> float:
    if p.step_length == "calibrated":
        return p.calibrated_m / p.calibrated_steps
    if p.step_length != "fused":
        model: str = p.step_length or "weinberg"
        return float(getattr(p, CONSTANTS[model])) * measures[model]
    weight, total = 0.0, 0.0
    for model, sigma in BELIEFS.items():
        length_m = float(getattr(p, CONSTANTS[model])) * measures[model]
        weight += 1 / sigma**2
        total += math.log(max(length_m, SHORTEST_M)) / sigma**2
    return math.exp(total / weight)


#: No step is believed to be shorter [m]. Chosen by judgement: a foot that is put down again.
SHORTEST_M = 0.05
#: A step of another time than this says nothing of the walking axis [s]. Chosen by judgement:
#: outside are double detections and pauses.
SHORTEST_S, LONGEST_S = 0.25, 1.5
#: Weight of the steps before in the walking axis: a degree bends a whole walk, so that a sensor
#: that slips is followed more slowly here than for the type of a step. Chosen by judgement: a
#: hundred steps.
KEEP = 0.99
#: So many steps tell the walking axis but for some tenths of a degree. Chosen by trial on simulated
#: loops: within 0.3 degrees from the 30th step on (docs/accuracy/pedestrian.md).
SETTLED = 60
#: Sign of the swing by the type of a step: back it is that ahead in a sensor turned half round.
#: Source: definition.
SIGN = {"backward": -1.0, "left": 0.0, "right": 0.0}


@dataclass(slots=True)
class BodyHeadingOffset:
    """Tells the direction a wearer looks in from the orientation of the sensor.

    Attributes
    ----------
    ahead
        The axis that looks ahead; ``walk``: what the swing of the steps tells against the first of
        the sensor's axes that is level enough.
    reference
        The axis whose direction is given; None before the first step where the walk tells.
    steps
        How many steps have told.
    turn_rad
        The way ahead against the reference, counter-clockwise [rad].
    """

    ahead: Ahead
    reference: Axis | None = None
    steps: int = 0
    turn_rad: float = 0.0
    _walking: WalkingAxis = field(default_factory=lambda: WalkingAxis(nominal=False, keep=KEEP))

    @property
    def settled(self) -> bool:
        """Whether what is told will hardly change."""
        return self.ahead != "walk" or self.steps >= SETTLED

    @property
    def sigma_rad(self) -> float:
        """Standard deviation of the way ahead as told by now [rad]; 0 of an axis that was given."""
        return self._walking.sigma_rad if self.ahead == "walk" else 0.0

    @property
    def news(self) -> str:
        """What a person should know when the walk has told the axis; empty at other steps."""
        if self.ahead != "walk" or self.steps != SETTLED:
            return ""
        angle = math.degrees(self.turn_rad)
        side = "left" if angle > 0 else "right"
        direction = f"{abs(angle):.0f} degrees to the {side} of the sensor's {self.reference}"
        return f"the walk tells that ahead is {direction}; steps before were gone again with that"

    def watch(self, step: StepEvent, interval_s: float, motion: LevelFrameMotion) -> None:
        """Take the next step; the motion must be known until a step after it."""
        if self.ahead != "walk":
            self.reference = self.ahead
            return
        reach_ns = round(min(interval_s, LONGEST_S) * NS_PER_S)
        rows = motion.rows(step.time_ns - reach_ns, step.time_ns + reach_ns)
        time_ns, orientation = motion.time_ns[rows], motion.orientation[rows]
        axis = axis_of(self._refer(mean_matrix(orientation)[2]))
        self.steps += 1
        # where a twentieth of the time has no samples nothing is told
        covered = time_ns[-1] - time_ns[0] >= 1.9 * reach_ns
        sign = SIGN.get(step.type, 1.0) if SHORTEST_S <= interval_s <= LONGEST_S else 0.0
        if covered and sign:
            values = np.empty((3, len(time_ns)))
            kernels.strides.resolve(orientation, motion.acceleration[rows], axis, values)
            swing = step_swing(values, (time_ns - step.time_ns) / reach_ns)
            if swing is not None:
                signed = swing._replace(ahead=sign * swing.ahead, right=sign * swing.right)
                self._walking.add(signed)
        self.turn_rad = -self._walking.angle_rad

    def heading(self, motion: LevelFrameMotion, start_ns: int, stop_ns: int) -> float:
        """Return the mean direction of the reference in the level axes in a time [rad]."""
        assert self.reference is not None  # a step was watched
        orientation = motion.orientation[motion.rows(start_ns, stop_ns)]
        return kernels.strides.mean_heading(orientation, axis_of(self.reference))

    def _refer(self, up: NDArray[np.float64]) -> Axis:
        """Return the reference; another one, and all to be told anew, where it stands upright."""
        if self.reference is None or abs(up["xyz".index(self.reference[-1])]) > STEEP:
            self.reference, self.steps = level_axis(up), 0
            self._walking = WalkingAxis(nominal=False, keep=KEEP)
        return self.reference


@dataclass(frozen=True, slots=True)
class PositionReference:
    """Where the walker was at a time.

    Attributes
    ----------
    time_ns
        When.
    x_m, y_m
        Where, to the east and to the north [m].
    sigma_m
        Standard deviation, per axis [m].
    repeats
        How many in a row err alike: together they tell as much as one.
    """

    time_ns: int
    x_m: float
    y_m: float
    sigma_m: float
    repeats: float = 1.0

    @property
    def position(self) -> NDArray[np.float64]:
        """Where, shape (2,) [m]."""
        return np.array([self.x_m, self.y_m])


def repeats_of(apart_s: float, lasting_s: float) -> float:
    """Return how many fixes in a row err alike where errors are a Gauss-Markov process.

    The mean of N such errors has the variance of one over 1 + (N - 1) (1 - rho) / (1 + rho), where
    rho is the correlation of neighbours (first-order autoregression).

    Parameters
    ----------
    apart_s
        Time since the fix before [s].
    lasting_s
        Time constant of the errors [s].
    """
    correlation = math.exp(-max(apart_s, 0.0) / lasting_s)
    return (1 + correlation) / max(1 - correlation, _LEAST_NEW)


#: A fix tells so much anew at least, as a part: it bounds how little one of the same moment counts.
#: Chosen by judgement: a thousandth of a time constant.
_LEAST_NEW = 1e-3


def waypoints_of(labels: Sequence[Label], sigma_m: float) -> list[PositionReference]:
    """Return the waypoints that a reckoning is given as known places."""
    return [
        PositionReference(x.time_ns, x.x_m, x.y_m, sigma_m)
        for x in labels
        if x.x_m is not None and x.y_m is not None
    ]


def satellite_columns(stream: Stream) -> tuple[int, int] | None:
    """Return the columns of latitude and longitude, or None."""
    columns = [stream.columns_of({name}) for name in ("latitude", "longitude")]
    return (columns[0][0], columns[1][0]) if all(columns) else None


def satellite_fixes(
    block: SignalBlock, plane: TangentPlane, sigma_m: float
) -> list[PositionReference]:
    """Return the finite fixes of a block of degrees, each as exact as it says, else as given."""
    columns = satellite_columns(block.stream)
    if columns is None:
        return []
    degrees = np.radians(block.values[:, list(columns)])
    columns_of_accuracy = block.stream.columns_of(ACCURACY)
    accuracy = np.full(len(block), np.nan)
    if columns_of_accuracy:
        accuracy = block.values[:, columns_of_accuracy[0]]
    sigmas = np.where(accuracy > 0, accuracy / ACCURACY_SIGMAS, sigma_m)
    times = block.sample_times().tolist()
    return [
        PositionReference(time_ns, *plane.map_position(float(lat), float(lon)), sigma)
        for time_ns, (lat, lon), sigma in zip(times, degrees, sigmas.tolist(), strict=True)
        if math.isfinite(lat + lon)
    ]


#: Pressure of the standard atmosphere falls to 1/e over this, at 15 degrees [m]. Source: U.S.
#: Standard Atmosphere (1976): R T / (M g) at 288.15 K.
SCALE_HEIGHT_M = 8434.5
#: The pressure is averaged over so long before and after a step [s]. Chosen by judgement: noise
#: averages out, a stair stays.
AVERAGE_S = 1.0

#: The climb is the slope of so long before and after a step [s], by so many pressures at least.
#: Chosen by trial on logs of IPIN 2023: with 1.5 s 6 % of the steps on level floors rise by more
#: than 0.1 m, with 2.5 s 0.5 %.
CLIMB_S, CLIMB_LEAST = 2.5, 5
#: A step that rises by this is on a stair [m]. Source: no ramp for walkers is steeper than 1 in 8,
#: 0.08 m a step; risers are 0.14 to 0.2 m (DIN 18065).
RISER_M = 0.1
#: Two risers and a tread together, and the least tread [m]. Source: F. Blondel, Cours
#: d'architecture (1675), as in DIN 18065: 0.59 to 0.65 m; treads of 0.21 m at least.
PACE_M, TREAD_M = 0.63, 0.21


@dataclass(slots=True)
class Barometer:
    """Remembers half a minute of pressure before what came last, and that of the first step.

    Attributes
    ----------
    start_pa
        Pressure at the first step [Pa]; NaN before.
    """

    start_pa: float = math.nan
    _time_ns: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    _pressure: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))

    def update(self, block: SignalBlock) -> None:
        """Take a block that has a pressure [Pa]."""
        values = block.values[:, block.stream.columns_of({"pressure"})[0]]
        sound = np.isfinite(values) & (values > 0)
        times = np.concatenate([self._time_ns, block.sample_times()[sound]])
        keep = times >= block.start_ns - round(MEMORY_S * NS_PER_S)
        self._time_ns = times[keep]
        self._pressure = np.concatenate([self._pressure, values[sound]])[keep]

    def height_m(self, time_ns: int) -> float:
        """Return the height over the first time asked for [m]; NaN where it is not known.

        By the barometric formula of an atmosphere of one temperature.
        """
        near = np.abs(self._time_ns - time_ns) <= round(AVERAGE_S * NS_PER_S)
        if not near.any():
            return math.nan
        pressure = float(self._pressure[near].mean())
        if math.isnan(self.start_pa):
            self.start_pa = pressure
        return SCALE_HEIGHT_M * math.log(self.start_pa / pressure)

    def climb_mps(self, time_ns: int) -> float:
        """Return how fast the sensor rises around a time [m/s]; 0 where too little tells it.

        By the line through the logarithms of the pressures.
        """
        near = np.abs(self._time_ns - time_ns) <= round(CLIMB_S * NS_PER_S)
        if near.sum() < CLIMB_LEAST:
            return 0.0
        since_s = (self._time_ns[near] - time_ns) / NS_PER_S
        since_s -= since_s.mean()
        squares = float(since_s @ since_s)
        if squares < CLIMB_LEAST * (CLIMB_S / 3) ** 2:
            return 0.0
        return -SCALE_HEIGHT_M * float(since_s @ np.log(self._pressure[near])) / squares


def stair_length(rise_m: float) -> float | None:
    """Return the length of a step that rises or falls by so much [m]; None where it is on no stair.

    The tread of a stair by its riser: two risers and a tread are a pace of 0.63 m.
    """
    if abs(rise_m) < RISER_M:
        return None
    return max(PACE_M - 2 * abs(rise_m), TREAD_M)
