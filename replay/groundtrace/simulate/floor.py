"""The floor: its plate, and when waves of each kind of shoe arrive on it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from groundtrace_codecs.geometry import Medium

from .footfall import SHOES, ArrivalLaw, Shoe
from .plate import Plate

if TYPE_CHECKING:
    from groundtrace_codecs.geometry import Geometry

    from .options import RoomOptions


@dataclass(frozen=True, slots=True, eq=False)
class Floor:
    """A plate, and the arrivals of the shoes that are worn on it.

    Attributes
    ----------
    plate
        The slab.
    shoes
        Worn on it.
    laws
        Of the arrivals of each shoe.
    """

    plate: Plate
    shoes: tuple[Shoe, ...]
    laws: tuple[ArrivalLaw, ...]

    @classmethod
    def of(cls, options: RoomOptions, site: Geometry) -> Floor:
        """Return the floor; the laws reach from one end of the site to the other."""
        plate, shoes = plate_of(options), SHOES[options.shoe or "heel"]
        reach_m = extent_m(site)
        return cls(plate, shoes, tuple(ArrivalLaw.of(plate, x, reach_m) for x in shoes))

    @property
    def medium(self) -> Medium:
        """What a calibration with the first of the shoes would find."""
        law = self.laws[0]
        return Medium(self.plate.thickness_m, law.velocity_mps, law.theta_s)

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
