"""What to simulate in the room, and which values are possible."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ..errors import SimulationError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from groundtrace_codecs.geometry import Geometry

#: Side of the room of the thesis's test (section 6.2) [m].
SIDE_M = 5.4
#: Sensors in a room where nobody says how many.
CHANNELS = 9
#: Largest offset of a clock [s].
LATEST_S = 0.1

ShoeName = Literal["heel", "bare", "mixed"]
PathName = Literal["straight", "l", "v", "u", "circle", "ellipse", "there-and-back", "crossing"]


def refused(option: str, expected: str, found: object) -> SimulationError:
    """Return the error that an option of the room is not what it must be."""
    return SimulationError(f"simulate room: {option}: expected {expected}, found {found}")


@dataclass(frozen=True, slots=True)
class RoomOptions:
    """What to simulate in the room. None leaves a choice open: see each, and ``random``.

    Attributes
    ----------
    seed
        Of everything that is random.
    duration_s
        Length [s]; None: as long as the steps need.
    channels
        How many sensors, 3 to 16; None: 9, or those of ``geometry``.
    rate_hz
        Sampling rate [Hz], from 1000.
    steps
        How many steps of each walker, or impacts; None: as many as fit in ``duration_s``, or 20.
    snr
        Peak of a mean step at 1 m over the standard deviation of the noise; of a heel where shoes
        are mixed. The default leaves about 20 for the weakest step at the farthest of the sensors.
    geometry
        Outline of the room, convex or not, and sensors; its thickness where it has one. None: a
        rectangle with rows of sensors.
    side_m
        Sides of that rectangle along x and y [m], 2 to 30; None: 5.4 by 5.4.
    thickness_m
        Of the concrete slab [m], 0.05 to 1; None: 0.2.
    dispersion_m2s
        Dispersion constant a of the slab [m2/s], 46 to 913, in place of its thickness.
    loss_s
        theta of the slab's loss [s], 1e-6 to 1e-3; None: 1e-5.
    shoe
        ``heel``, ``bare`` or ``mixed`` (each step one or the other); None: heel.
    walls
        Reflection of a wave's amplitude at the outline, 0 to 0.9; None: 0.
    resonances
        True gives each sensor a resonance of its mounting, 150 to 600 Hz, Q 3 to 8.
    path
        Where people walk; None: ``u``, or ``crossing`` for two.
    walkers
        1, or 2 who cross in the middle; None: 1, or 2 for ``crossing``.
    impacts
        True: single impacts at random places, 1 to 3 s apart, and nobody walks.
    clock_offset_s
        Sensor and how late its samples are stamped [s], -0.1 to 0.1. The geometry of the recording
        does not tell; an offset that stands in ``geometry`` is simulated and told.
    clock_spread_s
        Standard deviation of a random clock offset of every other sensor [s], to 0.03.
    dead
        Sensors that give 0 all the time.
    clipped
        Sensors with so much gain that most steps clip.
    triaxial
        True makes a station of x, y and z of every sensor.
    random
        True draws what is open of room, floor, shoe, walls and path from ``seed``.
    """

    seed: int = 1
    duration_s: float | None = None
    channels: int | None = None
    rate_hz: float = 20_000.0
    steps: int | None = None
    snr: float = 100.0
    geometry: Geometry | None = None
    side_m: tuple[float, float] | None = None
    thickness_m: float | None = None
    dispersion_m2s: float | None = None
    loss_s: float | None = None
    shoe: ShoeName | None = None
    walls: float | None = None
    resonances: bool = False
    path: PathName | None = None
    walkers: int | None = None
    impacts: bool = False
    clock_offset_s: tuple[tuple[str, float], ...] = ()
    clock_spread_s: float | None = None
    dead: tuple[str, ...] = ()
    clipped: tuple[str, ...] = ()
    triaxial: bool = False
    random: bool = False

    def check(self) -> None:
        """Raise SimulationError where an option is out of its range or two exclude each other."""
        for name, good, expected, found in self._limits():
            if not good:
                raise refused(name, expected, found)
        for name, other in self._excluded():
            raise refused(name, f"none beside {other}", "both")

    def _limits(self) -> Iterator[tuple[str, bool, str, Any]]:
        yield "channels", _within(self.channels, 3, 16), "3 to 16", self.channels
        yield "rate_hz", 1000 <= self.rate_hz <= 1e6, "1000 to 1e6", self.rate_hz
        yield "seed", self.seed >= 0, "0 or more", self.seed
        yield "steps", self.steps is None or self.steps >= 1, "1 or more", self.steps
        yield "snr", self.snr > 0, "more than 0", self.snr
        duration_s = 1.0 if self.duration_s is None else self.duration_s
        yield "duration_s", 0 < duration_s < np.inf, "> 0", duration_s
        for side in self.side_m or ():
            yield "side_m", 2 <= side <= 30, "2 to 30", side
        yield "thickness_m", _within(self.thickness_m, 0.05, 1), "0.05 to 1", self.thickness_m
        a = self.dispersion_m2s
        yield "dispersion_m2s", _within(a, 46, 913), "46 to 913", a
        yield "loss_s", _within(self.loss_s, 1e-6, 1e-3), "1e-6 to 1e-3", self.loss_s
        yield "walls", _within(self.walls, 0, 0.9), "0 to 0.9", self.walls
        yield "walkers", _within(self.walkers, 1, 2), "1 or 2", self.walkers
        for name, offset_s in self.clock_offset_s:
            yield f"clock offset of {name}", abs(offset_s) <= LATEST_S, "-0.1 to 0.1 s", offset_s
        spread_s = self.clock_spread_s
        yield "clock_spread_s", _within(spread_s, 0, 0.03), "0 to 0.03", spread_s

    def _excluded(self) -> Iterator[tuple[str, str]]:
        if self.geometry is not None and self.side_m is not None:
            yield "side_m", "a geometry"
        if self.geometry is not None and self.geometry.sensors and self.channels is not None:
            yield "channels", "a geometry's sensors"
        if self.thickness_m is not None and self.dispersion_m2s is not None:
            yield "thickness_m", "dispersion_m2s"
        if self.impacts and (self.path is not None or self.walkers is not None):
            yield "impacts", "a path or walkers"
        if self.walkers == 2 and self.path not in (None, "crossing"):
            yield "path", "two walkers, who cross"
        if self.walkers == 1 and self.path == "crossing":
            yield "path crossing", "a single walker"


def _within(value: float | None, low: float, high: float) -> bool:
    return value is None or low <= value <= high
