"""Waves over the floor: their decay, and reflections from walls (method of images).

The wave that a straight wall sends back is that of a second force behind the wall, as far from it
as the true one, its amplitude multiplied by the reflection. A sensor sees that image where the ray
from the image crosses its wall, and no other wall stands in the ray's way. A rectangle also has the
images of images: eight, one behind each corner and two more behind each pair of walls, which every
place inside sees. Any other outline has the first reflections only.

The slab goes on under the walls: where an outline is not convex and a wall hides the foot from the
sensor, the direct wave comes straight through with sqrt(1 - reflection^2) for each wall it crosses,
so that the law of arrivals holds there too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.geometry import Medium

from ..localizers.wave_physics import Plate
from .footfall import SHOES, ArrivalLaw, Shoe
from .wave_laws import Ground, ground_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from groundtrace_codecs.geometry import Geometry

    from .room_plan import RoomOptions

    Array = NDArray[np.float64]

#: Rounding that is no distance [m]. Chosen by judgement: a nanometre.
_EPSILON = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Images:
    """Where waves seem to come from: the force first, then its images.

    Attributes
    ----------
    places
        Shape (n, 2) [m].
    gains
        Factor of the wave from each at each place asked for, shape (n, n_places); 0 where unseen.
    """

    places: Array
    gains: Array


@dataclass(frozen=True, slots=True, eq=False)
class Walls:
    """The outline as a mirror.

    Attributes
    ----------
    corners
        In order round the room, clockwise or not, shape (k, 2) [m].
    reflection
        Of the amplitude, 0 to 1.
    """

    corners: Array
    reflection: float

    @property
    def _ends(self) -> Array:
        return np.roll(self.corners, -1, axis=0)

    @property
    def _inward(self) -> Array:
        """Unit vectors into the room, square to each wall, shape (k, 2)."""
        x, y = self.corners.T
        along = self._ends - self.corners
        along /= np.hypot(*along.T)[:, None]
        turn = np.sign(x @ np.roll(y, -1) - y @ np.roll(x, -1))
        inward: Array = turn * np.stack([-along[:, 1], along[:, 0]], axis=1)
        return inward

    @property
    def rectangular(self) -> bool:
        """Whether the outline is a rectangle."""
        along = self._ends - self.corners
        turned = np.einsum("ij,ij->i", along, np.roll(along, -1, axis=0))
        return len(self.corners) == 4 and bool(np.abs(turned).max() < 1e-6)

    def images(self, source: Array, places: Array) -> Images:
        """Return the force at ``source``, shape (2,), and its images, as seen from ``places``."""
        if self.reflection == 0:
            return Images(source[None], np.ones((1, len(places))))
        through = np.sqrt(1 - self.reflection**2) ** self._crossed(source, places, None)
        mirrored = [self._mirrored(source, wall) for wall in range(len(self.corners))]
        seen = [
            self.reflection * self._seen(source, places, wall) for wall in range(len(self.corners))
        ]
        if self.rectangular:
            inside = self._inside(places)
            # opposite walls both ways round, neighbours once: their images coincide
            for first, second in ((0, 1), (1, 2), (2, 3), (3, 0), (0, 2), (2, 0), (1, 3), (3, 1)):
                mirrored.append(self._mirrored(mirrored[first], second))
                seen.append(self.reflection**2 * inside)
        return Images(np.array([source, *mirrored]), np.array([through, *seen]))

    def _mirrored(self, place: Array, wall: int) -> Array:
        inward = self._inward[wall]
        mirrored: Array = place - 2 * ((place - self.corners[wall]) @ inward) * inward
        return mirrored

    def _inside(self, places: Array) -> Array:
        """Return 1 for each of ``places`` before all walls of a convex room, else 0."""
        before = np.einsum("nkj,kj->nk", places[:, None] - self.corners, self._inward)
        inside: Array = (before > -_EPSILON).all(axis=1).astype(np.float64)
        return inside

    def _seen(self, source: Array, places: Array, wall: int) -> Array:
        """Return 1 for each of ``places`` that sees ``source`` in ``wall``, else 0."""
        start, end, inward = self.corners[wall], self._ends[wall], self._inward[wall]
        source_m, place_m = (source - start) @ inward, (places - start) @ inward
        span = max(float(source_m), _EPSILON) + np.maximum(place_m, 0)
        share = max(float(source_m), _EPSILON) / span
        foot = source - source_m * inward
        feet = places - place_m[:, None] * inward
        mirror = foot + (feet - foot) * share[:, None]
        along = (mirror - start) @ (end - start) / ((end - start) @ (end - start))
        before = (source_m > -_EPSILON) & (place_m > -_EPSILON)
        seen = before & (along > -_EPSILON) & (along < 1 + _EPSILON)
        hidden = self._crossed(source, mirror, wall) + self._crossed(mirror, places, wall)
        unhidden: Array = (seen & (hidden == 0)).astype(np.float64)
        return unhidden

    def _crossed(self, one: Array, other: Array, but: int | None) -> NDArray[np.intp]:
        """Return how many walls but ``but`` lie between, shape (n,); touching is not crossing."""
        one, other = np.broadcast_arrays(one, other)
        ray, wall = (other - one)[:, None], (self._ends - self.corners)[None]
        to_wall = self.corners[None] - one[:, None]
        across = ray[..., 0] * wall[..., 1] - ray[..., 1] * wall[..., 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            on_ray = (to_wall[..., 0] * wall[..., 1] - to_wall[..., 1] * wall[..., 0]) / across
            on_wall = (to_wall[..., 0] * ray[..., 1] - to_wall[..., 1] * ray[..., 0]) / across
        low, high = _EPSILON, 1 - _EPSILON
        between = (on_ray > low) & (on_ray < high) & (on_wall > low) & (on_wall < high)
        between &= np.abs(across) > _EPSILON**2
        if but is not None:
            between[:, but] = False
        crossed: NDArray[np.intp] = between.sum(axis=1)
        return crossed


@dataclass(frozen=True, slots=True, eq=False)
class Floor:
    """A plate, and the arrivals of the shoes that are worn on it.

    Attributes
    ----------
    plate
        The slab, or ground of another law.
    shoes
        Worn on it.
    laws
        Of the arrivals of each shoe.
    """

    plate: Plate | Ground
    shoes: tuple[Shoe, ...]
    laws: tuple[ArrivalLaw, ...]

    @classmethod
    def of(cls, options: RoomOptions, site: Geometry) -> Floor:
        """Return the floor; the laws reach from one end of the site to the other."""
        shoes = SHOES[options.shoe or "heel"]
        floor: Plate | Ground = plate_of(options)
        law = options.wave_law
        if law is not None and law != "plate" and law != "any":
            floor = ground_of(law, options.seed, options.speed_mps)
        reach_m = extent_m(site)
        return cls(floor, shoes, tuple(ArrivalLaw.of(floor, x, reach_m) for x in shoes))

    @property
    def medium(self) -> Medium:
        """What a calibration with the first of the shoes would find."""
        law = self.laws[0]
        thickness_m = self.plate.thickness_m if isinstance(self.plate, Plate) else None
        return Medium(thickness_m, law.velocity_mps, law.theta_s)

    def law_of(self, shoe: Shoe) -> ArrivalLaw:
        """Return the law of one of the shoes."""
        return self.laws[self.shoes.index(shoe)]


def plate_of(options: RoomOptions) -> Plate:
    """Return the slab: concrete, its thickness from the option, the dispersion or the geometry."""
    plate = Plate()
    thickness_m = options.thickness_m
    if options.dispersion_m2s is not None:
        # a grows with the thickness
        thickness_m = plate.thickness_m * options.dispersion_m2s / plate.dispersion_m2s
    elif thickness_m is None and options.geometry is not None:
        thickness_m = options.geometry.medium.thickness_m
    if thickness_m is not None:
        plate = replace(plate, thickness_m=thickness_m)
    return plate if options.loss_s is None else replace(plate, loss_s=options.loss_s)


def extent_m(site: Geometry) -> float:
    """Return the diagonal of the rectangle around outline and sensors [m]."""
    places = [*site.outline, *((s.x, s.y) for s in site.sensors)]
    x, y = zip(*places, strict=True)
    return float(((max(x) - min(x)) ** 2 + (max(y) - min(y)) ** 2) ** 0.5)
