"""The magnetometer: tests of the field, its calibration, and compasses that survive disturbances.

Source of the tests: Moix, Steiner, Ladetto and Merminod (EPFL), "Detection des perturbations":
norm, its moving deviation, planimetric norm, difference of the azimuths with a threshold that
follows the gyroscope's drift, and difference of their derivatives. Inclination, the difference of
the whole field, and the iron test are ours.

A field that fails need not be useless. Iron attached to the sensor adds a field that turns with it;
once that is known, the compass continues with it subtracted. So there are two beliefs: the clean
one, and while tests fail one in which the iron on the sensor has changed. A magnet beside the path
is no constant in the body's axes: it is blamed anew at every frame, which teaches nothing.

Calibration fits an ellipsoid over the recording so far. In an undisturbed place the field of a
turned sensor lies on a sphere about 0. Iron that turns with the sensor moves the sphere (hard iron)
and makes it an ellipsoid (soft iron).

The compass of a standing foot only uses the field as the same direction as before. Indoors the
field changes every few steps. So it counts only where strength and dip are those of the start, and
weighs little.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.events import Disturbance, Quantity

from .. import kernels
from ..pipeline.gates import Level
from .attitude import EARTH, IRON
from .heading_baselines import turn_about_vertical
from .rotations import rotated, wrap_angle

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from .attitude import Attitude, HeadingParameters
    from .rotations import Array

    #: Centre, shape (3,), and the matrix that undoes the soft iron, shape (3, 3).
    Fit = tuple[Array, Array]

#: What the tests look at.
TESTS = (
    Quantity("field", "uT"),
    Quantity("norm", "uT"),
    Quantity("deviation", "uT"),
    Quantity("planimetric", "uT"),
    Quantity("azimuth", "deg"),
    Quantity("derivative", "deg/s"),
    Quantity("dip", "deg"),
    Quantity("iron", "uT"),
)
#: Of each frame: what its tests look at, and its heading by gyroscope alone and by compass alone.
COLUMNS = (*TESTS, Quantity("gyroscope", "deg"), Quantity("compass", "deg"))
GATES = (
    Level("norm", "uT", "norm_ut", at_least=False),
    Level("deviation", "uT", "deviation_ut", at_least=False),
    Level("planimetric", "uT", "planimetric_ut", at_least=False),
    Level("azimuth", "deg", "azimuth_deg", at_least=False),
    Level("derivative", "deg/s", "derivative_dps", at_least=False),
    Level("dip", "deg", "dip_deg", at_least=False),
    Level("field", "uT", "field_ut", at_least=False),
    Level("iron", "uT", "iron_ut", at_least=False),
)
#: A microtesla [T]. Source: SI.
TESLA = 1e-6
#: Windows of the moving deviation and of the derivative [s]. Chosen by judgement: the document
#: leaves them open; half a step, so that iron beside the path shows while it is passed.
DEVIATION_S, DERIVATIVE_S = 0.3, 0.3


#: So many frames in a row must be explained by the learned iron before it is believed in, and so
#: many better explained by the clean belief before it is dropped. Chosen by judgement: frames come
#: ten a second, so half a second and a fifth.
TO_BELIEVE, TO_CLEAN = 5, 2
#: Iron on the sensor is told from a field of the place where it turned by more than this against
#: the earth, and still explains what is seen: the cosine. Chosen by judgement: 60 degrees, by which
#: a field turns as far as it is strong. With 45 to 90 the disturbances of BROAD come out the same.
TURNED = 0.5
#: What is left of a field when it is blamed on iron [T]. Chosen by judgement: the noise of a
#: compass and what its calibration leaves.
BLAME_SIGMA_T = 2e-6
#: A field this far from what the learned iron explains says that it is not iron [T].
#: Chosen by judgement: half as much again.
CONSISTENT_T = 3e-6
#: Turning faster than this counts [rad/s]; so much of it makes a field known [s], [rad].
#: Chosen by judgement: two full turns show every side of the sensor.
TURNING_RPS, LEAST_S, LEAST_RAD = 0.3, 10.0, 4 * math.pi
#: Norm and inclination hold still within these standard deviations [T], [rad]. Chosen by judgement:
#: some times what a still sensor shows.
STILL_T, STILL_RAD = 1.5e-6, math.radians(2.5)


@dataclass(slots=True)
class Compass:
    """What is known of the last fields, and what is believed where one fails its tests.

    Attributes
    ----------
    parameters
        Thresholds and noise.
    norms, azimuths
        Of the last fields [T], [rad], with room for more.
    for_clean, for_iron
        Frames in a row that speak for the clean belief, and for that of other iron.
    plain_s
        For how long fields have passed all tests but that of the iron [s].
    blamed, iron_turned
        The other iron's field where it was blamed first, earth frame, shape (3,) [T]; whether it
        has turned far from there and explained what was seen.
    clean_covariance
        Of the iron by the clean belief, shape (3, 3).
    watched
        Fields that failed while the sensor turned and may be the place's: horizontal and vertical
        part, norm [T], inclination, and turn [rad].
    """

    parameters: HeadingParameters
    norms: Array = field(default_factory=lambda: np.empty(0))
    azimuths: Array = field(default_factory=lambda: np.empty(0))
    for_clean: int = 0
    for_iron: int = 0
    plain_s: float = 0.0
    blamed: Array = field(default_factory=lambda: np.zeros(3))
    iron_turned: bool = False
    clean_covariance: Array = field(default_factory=lambda: np.zeros((3, 3)))
    watched: list[tuple[float, ...]] = field(default_factory=list)

    def make_room(self, state: NDArray[Any], keep: int, more: int) -> None:
        """Keep norms and azimuths of the last fields, and have room for more."""
        count = int(state["fields"])
        rows, room = slice(max(count - keep, 0), count), np.empty(more)
        self.norms = np.concatenate([self.norms[rows], room])
        self.azimuths = np.concatenate([self.azimuths[rows], room])
        state["fields"] = min(count, keep)

    def judge(self, attitude: Attitude, frame: NDArray[Any], length_s: float, p: Any) -> bool:
        """Learn from a field that failed a test, or came in doubt; return whether it passes.

        Parameters
        ----------
        attitude
            Goes on in place.
        frame
            As :data:`.kernels.attitude.FRAME` names its fields; takes the value of the iron's test.
        length_s
            Of the frame [s].
        p
            As :data:`.kernels.attitude.SETTINGS` names them.
        """
        tests = frame["tests"]
        others = (p["limits"] - tests.astype(np.float32))[:-1]
        self.plain_s = self.plain_s + length_s if bool((others >= 0.0).all()) else 0.0
        tests[7] = self._iron_change(attitude.state, frame) / TESLA
        passed = bool((p["limits"] - tests.astype(np.float32) >= 0.0).all())
        if not passed:  # what changes is looked at among fields that pass
            attitude.state["fields"] = 0
        before = attitude.orientation
        self._learn(attitude, frame, length_s, p, passed=passed)
        turn = turn_about_vertical(before, attitude.orientation)
        attitude.state["gyroscope_offset_rad"] -= turn
        return passed

    def _iron_change(self, state: NDArray[Any], frame: NDArray[Any]) -> float:
        """Return how much the iron changed [T], 0 where that is no better explanation."""
        if not state["doubted"]:
            return 0.0
        miss = math.hypot(*kernels.attitude.field_innovation(state[()], frame[()]))
        seen = state["seen"]
        variance = float(np.einsum("ij,ij", seen @ state["covariance"], seen)) / 3
        explained = miss <= CONSISTENT_T + 2 * math.sqrt(variance)
        self.for_iron = self.for_iron + 1 if explained else 0
        self.for_clean = self.for_clean + 1 if frame["tests"][0] * TESLA < miss else 0
        iron = frame["earth_turn"] @ (state["hard_iron"] - state["clean_iron"])
        lengths = float(np.linalg.norm(iron) * np.linalg.norm(self.blamed))
        self.iron_turned |= explained and float(iron @ self.blamed) < TURNED * lengths
        of_place = self.plain_s >= self.parameters.plain_s and not self.iron_turned
        plain = self.for_clean >= TO_CLEAN or of_place
        if self.for_iron < TO_BELIEVE or plain:
            return 0.0
        return float(np.linalg.norm(state["hard_iron"] - state["clean_iron"]))

    def _learn(
        self, attitude: Attitude, frame: NDArray[Any], length_s: float, p: Any, *, passed: bool
    ) -> None:
        """Correct the attitude by a field, as iron on the sensor where it is disturbed."""
        state, turned_rad = attitude.state, float(frame["speed"]) * length_s
        undecided = 0 < self.for_iron < TO_BELIEVE and self.for_clean < TO_CLEAN
        plain_t = self.parameters.field_sigma_ut * TESLA
        if passed and not (state["doubted"] and undecided):
            state["verified_rad"] += turned_rad
            self.watched.clear()
            self._believe_clean(attitude)
            self._correct(state, frame, p, kernels.attitude.TILT)
        elif not passed and self._is_of_the_place(frame, turned_rad, length_s):
            self._replace_reference(attitude, frame["clean_field"], plain_t)
            self._believe_clean(attitude)
        elif state["doubted"] and self.for_iron:
            # where both beliefs explain it neither is dropped, and the clean one learns nothing
            self._correct(state, frame, p, kernels.attitude.TILT_AND_EARTH)
        else:
            self._doubt(state)
            self._blame_iron(attitude, frame)

    def _correct(
        self, state: NDArray[Any], frame: NDArray[Any], p: Any, frozen: NDArray[np.bool_]
    ) -> None:
        innovation = kernels.attitude.field_innovation(state[()], frame[()])
        variance = float(p["field_sigma_t"]) ** 2
        kernels.attitude.measurement_update(state[()], innovation, variance, frozen)

    def _believe_clean(self, attitude: Attitude) -> None:
        """Drop the belief in other iron."""
        state = attitude.state
        if state["doubted"]:
            state["hard_iron"], state["doubted"] = state["clean_iron"], 0
            attitude.reset(IRON, self.clean_covariance)
            self.for_iron = self.for_clean = 0

    def _doubt(self, state: NDArray[Any]) -> None:
        """Keep the clean belief, where it is not kept yet; nothing speaks for one or the other."""
        if not state["doubted"]:
            state["doubted"], state["clean_iron"] = 1, state["hard_iron"]
            self.clean_covariance = state["covariance"][IRON, IRON].copy()
        self.for_iron = self.for_clean = 0

    def _blame_iron(self, attitude: Attitude, frame: NDArray[Any]) -> None:
        """Explain a frame's field by iron alone; it is known as well as orientation is."""
        state, back = attitude.state, np.linalg.inv(frame["earth_turn"])
        north, up = state["earth_field"].tolist()
        state["hard_iron"] = back @ (frame["earth_field"] - [0.0, north, up])
        self.blamed = frame["earth_turn"] @ (state["hard_iron"] - state["clean_iron"])
        self.iron_turned = False
        slope = np.zeros((3, kernels.attitude.SIZE))
        slope[:, 0] = back[:, 2] * north - back[:, 1] * up
        slope[:, 1], slope[:, 2] = back[:, 0] * up, -back[:, 0] * north
        slope[:, EARTH] = -back[:, 1:]
        covariance = state["covariance"]
        covariance[IRON, :] = covariance[:, IRON] = 0.0
        across = slope @ covariance
        covariance[IRON, :], covariance[:, IRON] = across, across.T
        covariance[IRON, IRON] = across @ slope.T + BLAME_SIGMA_T**2 * np.eye(3)

    def _is_of_the_place(self, frame: NDArray[Any], turned_rad: float, length_s: float) -> bool:
        """Watch a field that failed; return whether those watched are the place's."""
        if turned_rad < TURNING_RPS * length_s:
            return False
        x, y, z = frame["clean_field"].tolist()
        flat = math.hypot(x, y)
        self.watched.append((flat, z, math.hypot(flat, z), math.atan2(z, flat), turned_rad))
        if len(self.watched) * length_s > LEAST_S:
            del self.watched[0]
        elif len(self.watched) * length_s <= LEAST_S - length_s:
            return False
        fields = np.array(self.watched)
        norm_t, dip_rad = fields[:, 2:4].std(axis=0).tolist()
        return norm_t < STILL_T and dip_rad < STILL_RAD and float(fields[:, 4].sum()) >= LEAST_RAD

    def _replace_reference(self, attitude: Attitude, seen: Array, sigma_t: float) -> None:
        """Take the watched fields for the place's; face them where the one before failed."""
        state, fields = attitude.state, np.array(self.watched)
        verified = state["verified_rad"] >= LEAST_RAD
        state["verified_rad"] = fields[:, 4].sum()
        self.watched.clear()
        north, up = fields[:, :2].mean(axis=0).tolist()
        attitude.take_earth(north, up, sigma_t)
        if not verified:
            attitude.face(seen, sigma_t)


#: Least eigenvalue of the directions' second moments, 1/3 where they are all around. Chosen by
#: judgement: of a walk on the level with turns the fields lie on a cone, and an ellipsoid has five
#: unknowns more than a sphere.
SPHERE_COVERAGE, ELLIPSOID_COVERAGE = 0.08, 0.15
#: A field is explained within this part of the radius. Chosen by judgement: 3 uT of 50, and 3.4
#: degrees.
EXPLAINED = 0.06
#: Spheres through four fields that the robust fit begins with, and rounds of reweighting. Chosen by
#: judgement: with a third of the fields off, a hundred draws of four miss every good one once in
#: 10^9 times.
SUBSETS, ROUNDS = 100, 6
#: Norm of the earth's field anywhere, with a margin [T]. Source: IGRF-13, 22 to 67 uT.
EARTH_T = (18e-6, 72e-6)
#: Iron that adds less than this part of the field is left to the heading filter. Chosen by
#: judgement: iron of a quarter turns a heading by 14 degrees at most.
SMALL = 0.25
#: Fields nearer to each other than this part of their norm are one for the fit, and so many of them
#: are needed. Chosen by judgement: 8 degrees, and four times an ellipsoid's nine unknowns.
APART, LEAST_APART = 0.15, 40
#: Iron makes no ellipsoid with an axis longer than this many others. Chosen by judgement: it is
#: then a fit of too few directions.
LONGEST_AXIS = 3
#: Fields nearer to the sphere than this part weigh alike. Chosen by judgement: 0.5 uT of 50, noise.
LEAST_OFF = 0.01
#: Fields kept of a recording; when there are more, every second one is dropped. Chosen by
#: judgement: it bounds memory and the cost of a fit.
HISTORY = 2048
#: Every so many frames a calibration is tried, and from this many on. Chosen by judgement: they
#: bound the cost; 200 frames at 10 a second are a loop of 20 s.
TRY_EVERY, LEAST = 50, 200
#: It is tried where more of the frames than this fail, and taken where it explains this part.
#: Chosen by judgement: disturbances in passing last for less, and no calibration of those that fail
#: is right that leaves a tenth unexplained.
FAILING, WHOLE = 0.3, 0.9

TOO_LITTLE = (
    "the magnetic field does not fit one that only turns, and the sensor turned too little to "
    "calibrate its magnetometer"
)


@dataclass(frozen=True, slots=True, eq=False)
class Ellipsoid:
    """What iron makes of a sphere.

    Attributes
    ----------
    centre
        Field of the hard iron, shape (3,), in the unit of the fields.
    unbend
        Matrix that undoes the soft iron, shape (3, 3), and keeps the mean radius.
    radius
        Norm of the field when corrected.
    explained
        Part of the fields that lie within :data:`EXPLAINED` of it.
    coverage
        Least eigenvalue of the second moments of the directions, 0 (in a plane) to 1/3.
    """

    centre: Array
    unbend: Array
    radius: float
    explained: float
    coverage: float

    def corrected(self, fields: Array) -> Array:
        """Return fields, shape (..., 3), without what iron adds."""
        return np.asarray((fields - self.centre) @ self.unbend.T)


def fit_ellipsoid(fields: Array) -> Ellipsoid | None:
    """Fit an ellipsoid, or a sphere where the directions cover too little for one.

    Parameters
    ----------
    fields
        Shape (n, 3), in any unit.

    Returns
    -------
    The fit, robust against a minority of fields from elsewhere; None where the sensor turned too
    little for a sphere.
    """
    scale = float(np.median(np.linalg.norm(fields, axis=1)))
    if len(fields) < 10 or not scale > 0:
        return None
    x = fields / scale
    sphere = _robust(x, _sphere, _start(x))
    if sphere is None or _coverage(x, sphere[0]) < SPHERE_COVERAGE:
        return None
    middle, (shift, unbend) = sphere[0], (np.zeros(3), sphere[1])
    if _coverage(x, middle) >= ELLIPSOID_COVERAGE:
        # about the sphere's centre: the quadric's scale is lost where it passes through 0
        shift, unbend = _robust(x - middle, _quadric, (shift, unbend)) or (shift, unbend)
    centre = middle + shift
    corrected = (x - centre) @ unbend.T
    norms = np.linalg.norm(corrected, axis=1)
    radius = float(np.median(norms))
    return Ellipsoid(
        centre=centre * scale,
        unbend=unbend,
        radius=radius * scale,
        explained=float((np.abs(norms - radius) <= EXPLAINED * radius).mean()),
        coverage=_coverage(x, centre),
    )


def _robust(x: Array, solve: Callable[[Array, Array], Fit | None], start: Fit) -> Fit | None:
    """Solve again and again, with less weight on what lies off (Geman and McClure)."""
    fit, failed = start, True
    for _ in range(ROUNDS):
        made = solve(x, _weights(x, fit))
        if made is None:
            return None if failed else fit
        fit, failed = made, False
    return fit


def _weights(x: Array, fit: Fit) -> Array:
    """Return the weight of each field by how far off the sphere it comes out."""
    norms = np.linalg.norm((x - fit[0]) @ fit[1].T, axis=1)
    off = np.abs(norms / np.median(norms) - 1)
    width = max(2 * float(np.median(off)), LEAST_OFF)
    return np.asarray(1 / (1 + (off / width) ** 2) ** 2)


def _start(x: Array) -> Fit:
    """Return the sphere through four of the fields that the most lie near to, of many such."""
    chosen = np.random.default_rng(0).integers(0, len(x), (SUBSETS, 4))
    four = x[chosen]
    rows = np.concatenate([2 * four, np.ones((SUBSETS, 4, 1))], axis=2)
    squares = np.einsum("sij,sij->si", four, four)[..., None]
    centres = (np.linalg.pinv(rows) @ squares)[:, :3, 0]
    norms = np.linalg.norm(x[None] - centres[:, None], axis=2)
    off = np.abs(norms / np.median(norms, axis=1)[:, None] - 1)
    return centres[int(np.argmin(np.median(off, axis=1)))], np.eye(3)


def _sphere(x: Array, weight: Array) -> Fit | None:
    """Return centre and identity by weighted least squares of |x|^2 = 2 c.x + d."""
    root = np.sqrt(weight)[:, None]
    rows = np.concatenate([2 * x, np.ones((len(x), 1))], axis=1)
    squares = np.einsum("ij,ij->i", x, x)[:, None]
    solution = np.linalg.lstsq(rows * root, squares * root, rcond=None)[0][:, 0]
    return solution[:3], np.eye(3)


def _quadric(x: Array, weight: Array) -> Fit | None:
    """Return centre and shape of the quadric x'Ax + 2b'x = 1; None where it is no ellipsoid."""
    root = np.sqrt(weight)[:, None]
    a, b, c = x.T
    rows = np.stack([a * a, b * b, c * c, 2 * a * b, 2 * a * c, 2 * b * c, 2 * a, 2 * b, 2 * c], 1)
    v = np.linalg.lstsq(rows * root, root, rcond=None)[0][:, 0]
    shape = np.array([[v[0], v[3], v[4]], [v[3], v[1], v[5]], [v[4], v[5], v[2]]])
    values, vectors = np.linalg.eigh(shape)
    # a quadric that does not enclose its centre comes out with the other sign
    if values[1] < 0:
        values, shape, v = -values, -shape, -v
    if values.min() <= 0 or values.max() > LONGEST_AXIS**2 * values.min():
        return None
    lengths = np.sqrt(values / np.cbrt(values.prod()))
    return -np.linalg.solve(shape, v[6:]), (vectors * lengths) @ vectors.T


def _coverage(x: Array, centre: Array) -> float:
    """Return the least eigenvalue of the second moments of the directions from ``centre``."""
    away = x - centre
    length = np.linalg.norm(away, axis=1)
    unit = away[length > 0] / length[length > 0, None]
    return float(np.linalg.eigvalsh(unit.T @ unit / max(len(unit), 1))[0])


@dataclass(slots=True)
class Calibration:
    """Watches fields and, where they fit no sphere about 0, finds the ellipsoid that they fit.

    A magnet put on the sensor later is a disturbance, not its calibration: the ellipsoid has to
    explain nearly all of the recording so far.

    Attributes
    ----------
    ellipsoid
        What fields are corrected by; None where they are taken as they are.
    wanting
        Whether a calibration was due and the sensor had turned too little for it.
    """

    ellipsoid: Ellipsoid | None = None
    wanting: bool = False
    _history: list[Array] = field(default_factory=list)
    _stride: int = 1
    _seen: int = 0
    _failed: int = 0

    def corrected(self, fields: Array) -> Array:
        """Return fields [T], shape (n, 3), as calibrated so far."""
        return fields if self.ellipsoid is None else self.ellipsoid.corrected(fields)

    @property
    def next_try(self) -> int:
        """After how many more fields a calibration may be tried."""
        return TRY_EVERY - self._seen % TRY_EVERY if self.ellipsoid is None else 2**62

    def _keep(self, raws: Array) -> None:
        while len(raws):
            first, room = -self._seen % self._stride, HISTORY + 1 - len(self._history)
            taken = raws[: first + room * self._stride]
            self._history += list(taken[first :: self._stride])
            self._seen += len(taken)
            raws = raws[len(taken) :]
            if len(self._history) > HISTORY:
                self._history, self._stride = self._history[::2], 2 * self._stride

    def watch(self, raw: Array, *, undisturbed: bool) -> bool:
        """Take a frame's field as measured, shape (3,) [T]; say whether the calibration changed."""
        return self.take(raw[None, :], int(not undisturbed))

    def take(self, raws: Array, failed: int) -> bool:
        """Take fields as measured, shape (n, 3) [T], so many of which failed their tests.

        At the last of them a calibration is tried, where one is due. Returns whether it changed.
        """
        self._failed += failed
        self._keep(raws)
        is_due = self.ellipsoid is None and len(raws) and self._seen >= LEAST
        if not is_due or self._seen % TRY_EVERY or self._failed < FAILING * self._seen:
            return False
        fields = np.array(self._history)
        spaced = apart(fields)
        ellipsoid = fit_ellipsoid(spaced) if len(spaced) >= LEAST_APART else None
        self.wanting = ellipsoid is None and self._failed > 2 * FAILING * self._seen
        if ellipsoid is None or not EARTH_T[0] < ellipsoid.radius < EARTH_T[1]:
            return False
        if float(np.linalg.norm(ellipsoid.centre)) < SMALL * ellipsoid.radius:
            return False
        off = np.abs(np.linalg.norm(ellipsoid.corrected(fields), axis=1) / ellipsoid.radius - 1)
        if float((off <= EXPLAINED).mean()) < WHOLE:
            return False
        self.ellipsoid = ellipsoid
        return True


def apart(fields: Array) -> Array:
    """Return fields, shape (n, 3), without those near to the one kept before."""
    least = APART * float(np.median(np.linalg.norm(fields, axis=1)))
    rows, indices = fields.tolist(), [0]
    for i, (x, y, z) in enumerate(rows):
        a, b, c = rows[indices[-1]]
        if max(abs(x - a), abs(y - b), abs(z - c)) > least:
            indices.append(i)
    return np.asarray(fields[indices[: len(rows)]])


@dataclass(slots=True)
class DisturbedSpans:
    """Joins disturbed frames; an undisturbed time shorter than ``join_ns`` between them is part.

    Attributes
    ----------
    stage
        Name of the stage that finds them.
    join_ns
        How far apart two disturbances are at least [ns].
    """

    stage: str
    join_ns: int
    _open: Disturbance | None = None

    @property
    def under_way(self) -> bool:
        """Whether a disturbance may go on."""
        return self._open is not None

    def add(
        self, start_ns: int, end_ns: int, value: float, *, disturbed: bool
    ) -> Iterator[Disturbance]:
        """Take a frame [start, end) and how much it is off; yield a disturbance that is over."""
        span = self._open
        if span is not None and start_ns - span.end_ns > self.join_ns:
            self._open = None
            yield span
            span = None
        if not disturbed:
            return
        if span is None:
            self._open = Disturbance(start_ns, end_ns, value, self.stage)
        else:
            self._open = Disturbance(span.time_ns, end_ns, max(span.value, value), self.stage)

    def flush(self) -> Iterator[Disturbance]:
        """End: yield the disturbance that is still open."""
        span, self._open = self._open, None
        if span is not None:
            yield span


#: Largest difference from the field of the start: of strength as a part, and of dip [rad]. Chosen
#: by judgement: 5 uT of 50, and 6 degrees.
STRENGTH, DIP_RAD = 0.1, 0.1
#: Deviation of an undisturbed heading [rad], and how long it goes on [s]. Chosen by judgement: a
#: compass indoors is off by several degrees for as long as the foot is at one place.
SIGMA_RAD, LASTING_S = 0.1, 1.0


@dataclass(slots=True)
class FootCompass:
    """The field where the foot first stood, in the frame of the track.

    Attributes
    ----------
    field
        Shape (3,) [T]; None before the first.
    """

    field: Array | None = None

    def turned_by(self, orientation: Array, field: Array) -> float | None:
        """Return how far the frame seems to have turned since the start [rad].

        Parameters
        ----------
        orientation
            Body to earth, shape (4,).
        field
            In the sensor's axes, shape (3,) [T]; NaN where there is none.

        Returns
        -------
        What to turn the orientation by; None where the field is new or not that of the start.
        """
        if not np.isfinite(field).all() or not field.any():
            return None
        now = rotated(orientation, field)
        if self.field is None:
            self.field = now
            return None
        strengths = [float(np.linalg.norm(one)) for one in (now, self.field)]
        dips = [math.atan2(one[2], math.hypot(one[0], one[1])) for one in (now, self.field)]
        other = abs(strengths[0] / strengths[1] - 1) > STRENGTH
        if other or abs(dips[0] - dips[1]) > DIP_RAD:
            return None
        headings = [math.atan2(one[1], one[0]) for one in (now, self.field)]
        return wrap_angle(headings[1] - headings[0])


def sigma_of(length_s: float) -> float:
    """Return the deviation of one segment's heading as if segments were independent [rad]."""
    return SIGMA_RAD * math.sqrt(max(1.0, LASTING_S / length_s))
