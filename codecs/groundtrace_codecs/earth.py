"""The ellipsoid WGS 84: metres to the east and to the north near a place."""

from __future__ import annotations

import math

#: Metadata record of a recording that says where on earth its site's zero lies: ``latitude_deg``,
#: ``longitude_deg``, ``height_m``; x points east, y north.
ORIGIN = "groundtrace.origin"
#: Radius of the equator, and first eccentricity squared (NIMA TR8350.2, third edition).
EQUATOR_M, ECCENTRICITY = 6_378_137.0, 6.694_379_990_14e-3


def metres_per_radian(latitude_rad: float) -> tuple[float, float]:
    """Return metres per radian of longitude and per radian of latitude at a latitude [rad]."""
    bent = 1 - ECCENTRICITY * math.sin(latitude_rad) ** 2
    east = EQUATOR_M / math.sqrt(bent) * math.cos(latitude_rad)
    return east, EQUATOR_M * (1 - ECCENTRICITY) / bent**1.5
