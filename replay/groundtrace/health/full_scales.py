"""Full scales of worn sensors, and words for what a channel at its limit does to results."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from groundtrace_codecs.units import G0_MPS2

if TYPE_CHECKING:
    from groundtrace_codecs.signals import Channel

#: Worn sensors whose limits are looked for in a replay.
WORN = frozenset({"acceleration", "angular_velocity"})
#: Full scales of accelerometers [m/s2] and gyroscopes [rad/s], and how far from them a calibration
#: and an offset bring them.
FULL_SCALES = {
    "acceleration": [(f"{n} g", n * G0_MPS2) for n in (2, 4, 8, 16)],
    "angular_velocity": [
        (f"{n} deg/s", math.radians(n)) for n in (125, 250, 300, 450, 500, 1000, 2000, 4000)
    ],
}
NEAR = 0.08


def full_scale(channel: Channel, level: float) -> str:
    """Return the full scale of a worn sensor that a level [SI] is near; empty where none is."""
    scales = FULL_SCALES.get(channel.quantity, []) if channel.unit != "count" else []
    off = [(abs(level - value) / value, name) for name, value in scales]
    return min((pair for pair in off if pair[0] <= NEAR), default=(0.0, ""))[1]


def near_scale(channel: Channel, level: float) -> str:
    """Return words for the full scale that a level [SI] is near; empty where none is."""
    found = full_scale(channel, level)
    return f", near the full scale of {found}," if found else ""


def clipped_effect(channel: Channel) -> tuple[str, str]:
    """Return effect and remedy of a channel that is clipped."""
    if channel.quantity in WORN:
        return (
            "it moved further than is recorded: what is integrated goes astray there",
            "record with a wider range",
        )
    return (
        "amplitudes there are lower bounds, onsets stay",
        "record with less gain or a wider range",
    )
