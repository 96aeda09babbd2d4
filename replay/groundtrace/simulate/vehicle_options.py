"""What to simulate beside a road, and which values are possible."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ..errors import SimulationError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from groundtrace_codecs.geometry import Geometry

LayoutName = Literal["antennas", "stations"]

#: Of the fastest vehicle, and of the slowest wave [m/s]: nobody drives faster than sound.
FASTEST_MPS, SLOWEST_WAVE_MPS = 30.0, 80.0
#: Speed of one vehicle, and of several, where nobody says which [m/s].
SPEED_MPS, DRAWN_MPS = 10.0, (8.0, 20.0)
#: Highest frequency felt, as a part of the sampling rate; by what factor a band may reach beyond
#: its edge as it moves.
_HIGHEST, _BEYOND = 0.4, 1.2


def refused(option: str, expected: str, found: object) -> SimulationError:
    """Return the error that an option of the road is not what it must be."""
    return SimulationError(f"simulate vehicle: {option}: expected {expected}, found {found}")


@dataclass(frozen=True, slots=True)
class VehicleOptions:
    """What to simulate beside a road. None leaves a choice open: see each.

    Attributes
    ----------
    seed
        Of everything that is random.
    duration_s
        Length [s]; None: 30 for each pass.
    rate_hz
        Sampling rate [Hz], 50 to 1000.
    layout
        ``antennas``: two lines of three geophones that the road crosses, as in the paper's
        experiment; ``stations``: beside the road.
    geometry
        Sensors, and the road where it has one, in place of a layout.
    stations
        How many, 2 to 4; None: 3.
    spacing_m
        Between stations or the geophones of an antenna [m], 2 to 100; None: 20, antennas 10.
    components
        1: vertical, or 3: x, y and z of every sensor.
    passes
        How many vehicles pass; several come at random times, from both sides, on two lanes.
    overlap
        True: the second and the first of several pass within two seconds, against each other.
    speed_mps
        2 to 30 [m/s]; None: 10 for one vehicle, 8 to 20 drawn for each of several.
    end_speed_mps
        What the speed of a single vehicle changes to, evenly over the recording; None: nothing.
    offset_m
        Of the road from the middle of the sensors, to the road's left [m]; None: 5, antennas 1.
    heading_deg
        Of the road, counter-clockwise from x; None: 0, antennas 75.
    radius_m
        Of a road that bends to the left, or, negative, to the right [m]; None: straight.
    waypoints
        Corners of the road [m] in place of offset, heading and radius.
    velocity_mps
        Of the waves, 80 to 3000 [m/s].
    exponent
        n of the power P = mu / r^n, 0.5 to 6.
    loss_spm
        rho of the ground's loss exp(-2 rho pi f r) [s/m], to 0.01.
    coherence_m
        Way of a vehicle over which its fading changes [m]; None: no fading.
    band_hz
        Of the vehicles' noise; None: 10 to 40 Hz, or a quarter of the sampling rate.
    engine_hz
        Firing rate of the engine, whose first four orders have 0.3 of the power; None: no tones.
    snr
        Root of the mean power of a vehicle at 10 m over the noise.
    level_spread_db
        Standard deviation of the vehicles' levels; None: 0 for one vehicle, 3 for several.
    wind
        Root of the mean power of wind, 0.5 to 8 Hz, over that of the noise.
    gain_spread
        Standard deviation of the logarithm of the sensors' gains, which nobody knows.
    geophone_hz
        Natural frequency of the geophones (damping 0.7); None: they feel all frequencies alike.
    walkers, impacts
        How many people walk by, and how many single impacts there are.
    """

    seed: int = 1
    duration_s: float | None = None
    rate_hz: float = 200.0
    layout: LayoutName = "antennas"
    geometry: Geometry | None = None
    stations: int | None = None
    spacing_m: float | None = None
    components: int = 1
    passes: int = 1
    overlap: bool = False
    speed_mps: float | None = None
    end_speed_mps: float | None = None
    offset_m: float | None = None
    heading_deg: float | None = None
    radius_m: float | None = None
    waypoints: tuple[tuple[float, float], ...] = ()
    velocity_mps: float = 250.0
    exponent: float = 1.5
    loss_spm: float = 0.0
    coherence_m: float | None = None
    band_hz: tuple[float, float] | None = None
    engine_hz: float | None = None
    snr: float = 10.0
    level_spread_db: float | None = None
    wind: float = 0.0
    gain_spread: float = 0.0
    geophone_hz: float | None = None
    walkers: int = 0
    impacts: int = 0

    @property
    def length_s(self) -> float:
        """Length of the recording [s]."""
        return 30.0 * self.passes if self.duration_s is None else self.duration_s

    @property
    def source_hz(self) -> tuple[float, float]:
        """Edges of the vehicles' band [Hz]."""
        return self.band_hz or (10.0, min(40.0, 0.25 * self.rate_hz))

    def check(self) -> None:
        """Raise SimulationError where an option is out of its range or two exclude each other."""
        for name, value, low, high in self._ranges():
            if value is not None and not low <= value <= high:
                raise refused(name, f"{low:g} to {high:g}", value)
        for name, good, expected, found in self._others():
            if not good:
                raise refused(name, expected, found)
        for name, other in self._excluded():
            raise refused(name, f"none beside {other}", "both")

    @property
    def _top_hz(self) -> float:
        """Highest edge of a band that the fastest vehicle does not shift beyond what is felt."""
        fastest = self.speed_mps or (SPEED_MPS if self.passes == 1 else DRAWN_MPS[1])
        fastest = max(fastest, self.end_speed_mps or 0.0)
        return _HIGHEST * self.rate_hz / _BEYOND * (1 - fastest / self.velocity_mps)

    def _ranges(self) -> Iterator[tuple[str, float | None, float, float]]:
        yield "duration_s", self.duration_s, 2, 86400
        yield "rate_hz", self.rate_hz, 50, 1000
        yield "stations", self.stations, 2, 4
        yield "spacing_m", self.spacing_m, 2, 100
        yield "passes", self.passes, 1, 1000
        yield "speed_mps", self.speed_mps, 2, FASTEST_MPS
        yield "end_speed_mps", self.end_speed_mps, 2, FASTEST_MPS
        yield "offset_m", self.offset_m, -1000, 1000
        yield "velocity_mps", self.velocity_mps, SLOWEST_WAVE_MPS, 3000
        yield "exponent", self.exponent, 0.5, 6
        yield "loss_spm", self.loss_spm, 0, 0.01
        yield "coherence_m", self.coherence_m, 0.1, 1000
        yield "snr", self.snr, 1e-3, 1e9
        yield "level_spread_db", self.level_spread_db, 0, 10
        yield "wind", self.wind, 0, 1000
        yield "gain_spread", self.gain_spread, 0, 1
        yield "geophone_hz", self.geophone_hz, 0.5, 0.3 * self.rate_hz
        yield "walkers", self.walkers, 0, 10
        yield "impacts", self.impacts, 0, 1000

    def _others(self) -> Iterator[tuple[str, bool, str, Any]]:
        yield "seed", self.seed >= 0, "0 or more", self.seed
        yield "rate_hz", self.rate_hz == round(self.rate_hz), "a whole number", self.rate_hz
        yield "components", self.components in (1, 3), "1 or 3", self.components
        yield "overlap", not self.overlap or self.passes > 1, "2 passes or more", self.passes
        low, high = self.source_hz
        top = self._top_hz
        yield "band_hz", 1 <= low < 0.9 * high < top, f"1 to {top:.0f} Hz", f"{low:g}-{high:g}"
        tone = self.engine_hz
        yield "engine_hz", tone is None or 1 <= tone <= top, f"1 to {top:.0f}", tone
        bend = self.radius_m
        yield "radius_m", bend is None or 10 <= abs(bend) <= 1e5, "10 to 1e5 or negative", bend
        yield "heading_deg", np.isfinite(self.heading_deg or 0), "an angle", self.heading_deg
        corners = self.waypoints
        apart = all(a != b for a, b in pairwise(corners))
        yield "waypoints", len(corners) != 1 and apart, "2 places or more, each another", corners

    def _excluded(self) -> Iterator[tuple[str, str]]:
        if self.geometry is not None and (self.stations or self.spacing_m):
            yield "stations and spacing_m", "a geometry"
        if self.layout == "antennas" and self.stations:
            yield "stations", "the layout antennas"
        drawn = (self.offset_m, self.heading_deg, self.radius_m)
        if self.waypoints and any(x is not None for x in drawn):
            yield "waypoints", "offset, heading or radius"
        if self.end_speed_mps is not None and self.passes > 1:
            yield "end_speed_mps", "several passes"
