"""Calibration of a magnetometer: hard and soft iron by an ellipsoid, over the recording so far.

In an undisturbed place the field of a turned sensor lies on a sphere about 0. Iron that turns with
the sensor moves the sphere (hard iron) and makes it an ellipsoid (soft iron).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ..later import Later

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from . import field_kernels
    from .rotations import Array

    #: Centre, shape (3,), and the matrix that undoes the soft iron, shape (3, 3).
    Fit = tuple[Array, Array]
else:
    field_kernels = Later("groundtrace.heading.field_kernels")

#: Least eigenvalue of the directions' second moments, 1/3 where they are all around.
SPHERE_COVERAGE, ELLIPSOID_COVERAGE = 0.08, 0.15
#: A field is explained within this part of the radius.
EXPLAINED = 0.06
#: Spheres through four fields that the robust fit begins with, and rounds of reweighting.
SUBSETS, ROUNDS = 100, 6
#: Norm of the earth's field anywhere, with a margin [T].
EARTH_T = (18e-6, 72e-6)
#: Iron that adds less than this part of the field is left to the heading filter.
SMALL = 0.25
#: Fields nearer to each other than this part of their norm are one for the fit, and so many of
#: them are needed.
APART, LEAST_APART = 0.15, 40
#: Fields kept of a recording; when there are more, every second one is dropped.
HISTORY = 2048
#: Every so many frames a calibration is tried, and from this many on.
TRY_EVERY, LEAST = 50, 200
#: It is tried where more of the frames than this fail, and taken where it explains this part.
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
    found, failed = start, True
    for _ in range(ROUNDS):
        made = solve(x, _weights(x, found))
        if made is None:
            return None if failed else found
        found, failed = made, False
    return found


def _weights(x: Array, fit: Fit) -> Array:
    """Return the weight of each field by how far off the sphere it comes out."""
    norms = np.linalg.norm((x - fit[0]) @ fit[1].T, axis=1)
    off = np.abs(norms / np.median(norms) - 1)
    width = max(2 * float(np.median(off)), 0.01)
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
    found = np.linalg.lstsq(rows * root, squares * root, rcond=None)[0][:, 0]
    return found[:3], np.eye(3)


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
    if values.min() <= 0 or values.max() > 9 * values.min():
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
    _kept: list[Array] = field(default_factory=list)
    _stride: int = 1
    _seen: int = 0
    _failed: int = 0

    def corrected(self, fields: Array) -> Array:
        """Return fields [T], shape (n, 3), as calibrated so far."""
        return fields if self.ellipsoid is None else self.ellipsoid.corrected(fields)

    @property
    def tries(self) -> tuple[int, int, float]:
        """Every how many fields, from how many on, and where what part fails it is tried."""
        return TRY_EVERY, LEAST if self.ellipsoid is None else np.iinfo(np.int64).max, FAILING

    @property
    def watched(self) -> NDArray[np.int64]:
        """How many fields there were, and how many of them failed."""
        return np.array([self._seen, self._failed])

    def _keep(self, raws: Array) -> None:
        while len(raws):
            first, room = -self._seen % self._stride, HISTORY + 1 - len(self._kept)
            taken = raws[: first + room * self._stride]
            self._kept += list(taken[first :: self._stride])
            self._seen += len(taken)
            raws = raws[len(taken) :]
            if len(self._kept) > HISTORY:
                self._kept, self._stride = self._kept[::2], 2 * self._stride

    def watch(self, raw: Array, *, undisturbed: bool) -> bool:
        """Take a frame's field as measured, shape (3,) [T]; say whether the calibration changed."""
        return self.take(raw[None, :], int(not undisturbed))

    def take(self, raws: Array, failed: int) -> bool:
        """Take fields as measured, shape (n, 3) [T], so many of which failed their tests.

        At the last of them a calibration is tried, where one is due. Returns whether it changed.
        """
        self._failed += failed
        self._keep(raws)
        every, least, failing = self.tries
        due = len(raws) and self._seen >= least and self._seen % every == 0
        if not due or self._failed < failing * self._seen:
            return False
        kept = np.array(self._kept)
        turned = apart(kept)
        found = fit_ellipsoid(turned) if len(turned) >= LEAST_APART else None
        self.wanting = found is None and self._failed > 2 * FAILING * self._seen
        if found is None or not EARTH_T[0] < found.radius < EARTH_T[1]:
            return False
        if float(np.linalg.norm(found.centre)) < SMALL * found.radius:
            return False
        off = np.abs(np.linalg.norm(found.corrected(kept), axis=1) / found.radius - 1)
        if float((off <= EXPLAINED).mean()) < WHOLE:
            return False
        self.ellipsoid = found
        return True


def apart(fields: Array) -> Array:
    """Return fields, shape (n, 3), without those near to the one kept before."""
    least = APART * float(np.median(np.linalg.norm(fields, axis=1)))
    return np.asarray(fields[field_kernels.far_apart(fields, least)])
