"""Colours: one per sensor everywhere, told apart by colour-blind people, on a dark background.

Colours are ``0xRRGGBBAA`` integers, as the viewer stores them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import SEISMIC_QUANTITIES

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from groundtrace.sinks import Session
    from groundtrace_codecs.signals import Channel

#: Okabe and Ito (2008) without black, its blue lightened, then colours between them.
SENSOR_COLOURS = (
    0xE69F00FF,
    0x56B4E9FF,
    0x00B283FF,
    0xF0E442FF,
    0x4C8FE0FF,
    0xE8702AFF,
    0xDB8FBBFF,
    0xB8C4CCFF,
    0xA6D854FF,
    0x9E7BD6FF,
    0xFFC9A3FF,
    0x2FD0D6FF,
    0xC7A35CFF,
    0xFF8FA3FF,
    0x8CB369FF,
    0x8EA4F5FF,
)
AXIS_COLOURS = {"x": 0xE8702AFF, "y": 0x00B283FF, "z": 0x56B4E9FF}

ACCEPTED = 0x4CE08AFF
REJECTED = 0xB4B4BCA0
THRESHOLD = 0xFF5D5DFF
LEFT = 0x56B4E9FF
RIGHT = 0xE69F00FF
STEP = 0x4CE08AFF
IMPACT = 0xF0E442FF
SPAN = 0x5B6B7AFF
IGNORED = 0x8A7050FF
LOSS = 0xC0392BFF
OUTLINE = 0x8A94A0FF
TRUTH = 0xB7A6FFFF
TRACE = 0xB4BCC6FF
NORM = 0xF2F2F2FF
#: Of places found, by the order of their stages.
FIX_COLOURS = (0xFF6FB5FF, 0x2FE6D6FF, 0xFFFFFFFF, 0x9E7BD6FF)
#: Of courses, the last word first; of vehicles, by number; of estimators of a ratio.
COURSE_COLOURS = (0xB6F23CFF, 0xFF7A6BFF, 0x3DDCA0FF, 0xFFE45CFF)
VEHICLE_COLOURS = (0xB6F23CFF, 0x35C9F0FF, 0xFFE45CFF, 0xFF7A6BFF)
ESTIMATOR_COLOURS = {
    "blue": 0x56B4E9FF,
    "yellow": 0xF0E442FF,
    "green": 0x00B283FF,
    "orange": 0xE8702AFF,
}
#: A road, and the signs of its forward direction.
ROAD, ROAD_SIGN = 0x2C333CFF, 0x66707CFF
#: Of borders between regions, and of sensors without an arrival.
FAINT = 0x424A55FF
SILENT = 0x6A727CFF
FILTERED_TRACK = 0xB6F23CFF
SMOOTHED_TRACK = 0xFFA733FF
#: Filtered and smoothed tracks, by the number of the track.
TRACK_COLOURS = (
    (FILTERED_TRACK, SMOOTHED_TRACK),
    (0x35C9F0FF, 0x7F8CFFFF),
    (0xFFE45CFF, 0xFF7A6BFF),
    (0x3DDCA0FF, 0xC68CF0FF),
)
#: True paths of several walkers, by the order of their names.
WALKER_COLOURS = (TRUTH, 0xE8C9A0FF, 0x9FD8C8FF, 0xF0A6C6FF)
MISSED = 0xFF4D4DFF
FALSE = 0xE85AD8FF
DISAGREEMENT = 0xFFD23FFF
STEP_COLOURS = {"left": LEFT, "right": RIGHT, "step": STEP, "impact": IMPACT}
#: Types of steps, besides left and right; the second contact of a side step.
TYPE_COLOURS = {"forward": STEP, "backward": 0xE85AD8FF, "trailing": 0x7A8794FF}
#: Of what people marked; steps by foot and type are as everywhere.
ANNOTATION_COLOURS = {
    "missed": 0xE8702AFF,
    "false": 0xDB8FBBFF,
    "step": 0x00B283FF,
    "pick": 0xF2F2F2FF,
    "note": 0xF0E442FF,
    "walking": SPAN,
    "ignore": IGNORED,
    "disturbed": 0x9E7BD6FF,
    "pass": 0x4C8FE0FF,
    "span": 0x8EA4F5FF,
}
#: A step detector's signal, the valleys of its candidates, and those refused.
CURVE, VALLEY, REFUSED = 0xC9D2DBFF, 0x56B4E9FF, 0xFF7A6BFF
#: Masses on a peak, none, and either, and the conflict.
PEAK, NO_PEAK, EITHER, CONFLICT = 0x4CE08AFF, 0xFF7A6BFF, 0x8A94A0FF, 0xFFD23FFF
#: Headings by the order of their stages; spans in which they are disturbed.
HEADING_COLOURS = {"green": 0xB6F23CFF, "blue": 0x35A9F0FF, "pink": 0xFF6FB5FF, "white": 0xF2F2F2FF}
DISTURBED, DISTURBED_SHADE = 0xC8862AFF, 0xE0A04AFF
WAYPOINT, SATELLITE = 0xFFFFFFFF, 0x35C9F0FF

#: Colours of rejections, by the place of the failing gate in the detector.
REJECTION_COLOURS = (0xA85A5AFF, 0xA67C4AFF, 0x7F66A8FF, 0x4F7EA8FF, 0x5F927AFF, 0x92925FFF)

#: Dark violet over red and orange to pale yellow, of evenly rising lightness.
_HEAT = np.array(
    [
        (10, 8, 26),
        (38, 14, 74),
        (84, 18, 106),
        (132, 32, 104),
        (180, 50, 84),
        (218, 78, 54),
        (242, 122, 26),
        (248, 180, 48),
        (250, 246, 176),
    ],
    np.float64,
)


class SensorColours:
    """Assigns colours to channels: by place in the geometry, else by order of appearance."""

    def __init__(self, session: Session) -> None:
        names = [s.channel for s in session.geometry.sensors] if session.geometry else []
        for stream in session.streams:
            names += [stream.channels[i].name for i in stream.columns_of(SEISMIC_QUANTITIES)]
        self._place = {name: i for i, name in enumerate(dict.fromkeys(names))}

    def of(self, name: str) -> int:
        """Return the colour of the channel called ``name``."""
        place = self._place.setdefault(name, len(self._place))
        return SENSOR_COLOURS[place % len(SENSOR_COLOURS)]

    def of_channel(self, channel: Channel) -> int:
        """Return the axis' colour for a worn sensor's axis, else the sensor's."""
        if channel.quantity not in SEISMIC_QUANTITIES and channel.axis in AXIS_COLOURS:
            return AXIS_COLOURS[channel.axis]
        return self.of(channel.name)


def vehicle_colour(number: int) -> int:
    """Return the colour of a vehicle, numbered from 1."""
    return VEHICLE_COLOURS[(number - 1) % len(VEHICLE_COLOURS)]


def dimmed(colour: int, part: float) -> int:
    """Return a colour that is only so bright: ``part`` of each of its components."""
    parts = [round(((colour >> shift) & 0xFF) * part) << shift for shift in (24, 16, 8)]
    return sum(parts) | (colour & 0xFF)


def heat(level: NDArray[np.floating]) -> NDArray[np.uint32]:
    """Return the colours of levels within [0, 1], of the same shape; others are clipped."""
    stops = np.linspace(0.0, 1.0, len(_HEAT))
    packed = np.full(np.shape(level), 0xFF, np.uint32)
    for shift, component in zip((24, 16, 8), _HEAT.T, strict=True):
        packed |= np.rint(np.interp(level, stops, component)).astype(np.uint32) << np.uint32(shift)
    return packed
