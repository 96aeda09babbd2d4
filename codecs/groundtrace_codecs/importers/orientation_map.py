"""The part of a map that describes a reference orientation."""

from __future__ import annotations

from typing import Literal

import msgspec


class OrientationMap(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A reference orientation in the file, one row for each sample of the first stream.

    Attributes
    ----------
    quaternion
        Path to unit quaternions (w, x, y, z) that turn the sensor's axes to x east, y north,
        z up; NaN where the reference was blind.
    axis
        The sensor's axis whose direction in the horizontal plane is the true heading.
    every_s
        Time between true headings [s].
    steepest_deg
        An axis that rises or falls by more has no heading [deg].
    field, field_unit
        Path to the magnetic field, one column an axis, and its unit: where it is off by
        ``disturbed_ut``, averaged over ``average_s``, it is disturbed. Without it nothing is said
        of disturbances.
    """

    quaternion: str
    axis: Literal["x", "y", "z", "-x", "-y", "-z"] = "x"
    every_s: float = 0.02
    steepest_deg: float = 75.0
    field: str | None = None
    field_unit: str = "uT"
    disturbed_ut: float = 5.0
    average_s: float = 0.1
