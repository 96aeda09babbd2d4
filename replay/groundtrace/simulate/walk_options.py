"""What to simulate on a walking person, and which values are possible."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from ..errors import SimulationError

if TYPE_CHECKING:
    from collections.abc import Iterator

PlacementName = Literal["waist", "trunk", "foot", "phone", "wrist"]
RouteName = Literal["straight", "l", "loop", "epfl", "random"]

#: Length of a walk whose path does not say how long it takes [s].
_DURATION_S = {None: 60.0, "random": 120.0}


@dataclass(frozen=True, slots=True)
class WalkOptions:
    """What to simulate on a walking person.

    With nothing but ``seed``, ``duration_s`` and ``rate_hz``: the bundled walk, the standard
    person of :data:`.person.STANDARD` on the minute of :func:`.gait.plan`. Whatever else is asked
    of the walker draws a person and takes a path.

    Attributes
    ----------
    seed
        Of everything that is random.
    duration_s
        Length [s]; the walk is cut or goes on round its path. None: once along the path, two
        minutes of a random one, a minute of the bundled one.
    rate_hz
        Of accelerometer and gyroscope [Hz], 6 to 400; the magnetometer has half of it, at most
        50 Hz, the barometer a tenth, at least 1 Hz.
    placement
        Where the sensor is worn. Waist, trunk and foot: axes ahead, left, up; phone: in the right
        trouser pocket; wrist: the right one.
    path
        ``straight`` 40 m, to and fro; ``l`` 20 m and 15 m; ``loop`` of 20 x 12 m; ``epfl`` of
        100 x 30 m with magnetic disturbances; ``random`` legs of 5 to 20 m.
    types
        True: stops for backward, left and right steps on the way; the label of a step is its type.
    person
        Seed of the person, where it is not to follow ``seed``.
    with_idle
        True: stops for sitting down, reaching, handling the sensor, riding in a vehicle.
    gnss
        True: positions once a second.
    disturbances
        How many stretches of the path disturb the magnetic field, to 50; None: those of the path.
    hard_iron_t
        Length of the field the carrier adds in the sensor's axes [T], to 1e-4.
    soft_iron
        By how much the carrier's iron stretches the field along one of its axes, to 0.3.
    """

    seed: int = 2
    duration_s: float | None = None
    rate_hz: float = 100.0
    placement: PlacementName = "waist"
    path: RouteName | None = None
    types: bool = False
    person: int | None = None
    with_idle: bool = False
    gnss: bool = False
    disturbances: int | None = None
    hard_iron_t: float | None = None
    soft_iron: float | None = None

    @property
    def standard(self) -> bool:
        """True for the standard person's minute."""
        asked = self.types or self.with_idle or self.person is not None or self.path is not None
        return self.placement == "waist" and not asked

    def resolved(self) -> WalkOptions:
        """Return the options with the path chosen and, where it is fixed, the length.

        Raises
        ------
        SimulationError
            Where an option is out of its range.
        """
        for name, good, expected, found in self._limits():
            if not good:
                raise SimulationError(f"simulate walk: {name}: expected {expected}, found {found}")
        path = self.path if self.standard else self.path or "random"
        duration_s = _DURATION_S.get(path) if self.duration_s is None else self.duration_s
        return replace(self, path=path, duration_s=duration_s)

    def _limits(self) -> Iterator[tuple[str, bool, str, Any]]:
        duration_s = 1.0 if self.duration_s is None else self.duration_s
        yield "duration_s", 0 < duration_s < np.inf, "> 0", duration_s
        yield "seed", self.seed >= 0, "0 or more", self.seed
        yield "rate_hz", 6 <= self.rate_hz <= 400, "6 to 400", self.rate_hz
        places, routes = get_args(PlacementName), get_args(RouteName)
        yield "placement", self.placement in places, " or ".join(places), self.placement
        yield "path", self.path in (None, *routes), " or ".join(routes), self.path
        yield "person", self.person is None or self.person >= 0, "0 or more", self.person
        count = self.disturbances
        yield "disturbances", count is None or 0 <= count <= 50, "0 to 50", count
        yield "hard_iron_t", 0 <= (self.hard_iron_t or 0) <= 1e-4, "0 to 1e-4 T", self.hard_iron_t
        yield "soft_iron", 0 <= (self.soft_iron or 0) <= 0.3, "0 to 0.3", self.soft_iron
