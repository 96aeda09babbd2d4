"""A calibration put into the geometry that the next replay uses."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from groundtrace_codecs.geometry import Geometry, Sensor

    from .estimate import Calibration


def calibrated_geometry(geometry: Geometry, found: Calibration) -> Geometry:
    """Return a geometry with what was found; what is not identifiable stays as it was."""
    medium = replace(geometry.medium, arrival_sigma_s=found.arrival_sigma_s)
    if found.scale.identifiable:
        medium = replace(
            medium,
            arrival_scale=found.scale.value,
            arrival_exponent=found.exponent.value,
            velocity_mps=found.velocity or medium.velocity_mps,
        )
    ahead = {o.channel: o.offset_s for o in found.offsets}
    sensors = tuple(_with_offset(sensor, ahead) for sensor in geometry.sensors)
    return replace(geometry, medium=medium, sensors=sensors)


def _with_offset(sensor: Sensor, ahead: dict[str, float]) -> Sensor:
    return replace(sensor, clock_offset_s=ahead.get(sensor.channel, sensor.clock_offset_s))
