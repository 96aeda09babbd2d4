"""The compass: tests of the magnetic field, and what is learned of it when they fail.

Source of the tests: Moix, Steiner, Ladetto and Merminod (EPFL), "Detection des perturbations":
norm, its moving deviation, planimetric norm, difference of the azimuths with a threshold that
follows the gyroscope's drift, and difference of their derivatives. Inclination, the difference of
the whole field, and the iron test are ours.

A field that fails need not be useless. What is attached to the sensor adds a field that turns with
it; once that is known, the compass goes on behind it. So there are two beliefs: the clean one, and
while tests fail one in which the iron on the sensor has changed. A magnet beside the way is no
constant in the body's axes: it is blamed anew at every frame, which teaches nothing.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.events import Quantity

from ..gates import Level
from .attitude import IRON
from .newcomer import Newcomer
from .rotations import wrapped

if TYPE_CHECKING:
    from .attitude import Attitude
    from .inertial_frames import InertialFrame
    from .parameters import HeadingParameters
    from .rotations import Array

#: What the tests look at.
TESTS = (
    Quantity("field", "uT"),
    Quantity("norm", "uT"),
    Quantity("deviation", "uT"),
    Quantity("planimetric", "uT"),
    Quantity("azimuth", "deg"),
    Quantity("derivative", "deg/s"),
    Quantity("dip", "deg"),
    Quantity("iron", "uT"),
)
#: Of each frame: what its tests look at, and its heading by gyroscope alone and by compass alone.
COLUMNS = (*TESTS, Quantity("gyroscope", "deg"), Quantity("compass", "deg"))
GATES = (
    Level("norm", "uT", "norm_ut", at_least=False),
    Level("deviation", "uT", "deviation_ut", at_least=False),
    Level("planimetric", "uT", "planimetric_ut", at_least=False),
    Level("azimuth", "deg", "azimuth_deg", at_least=False),
    Level("derivative", "deg/s", "derivative_dps", at_least=False),
    Level("dip", "deg", "dip_deg", at_least=False),
    Level("field", "uT", "field_ut", at_least=False),
    Level("iron", "uT", "iron_ut", at_least=False),
)
TESLA = 1e-6
#: Windows of the moving deviation and of the derivative [s].
DEVIATION_S, DERIVATIVE_S = 0.3, 0.3
#: A field this far from what the learned iron explains says that it is not iron [T].
CONSISTENT_T = 3e-6
#: What is left of a field when it is blamed on iron [T].
BLAME_SIGMA_T = 2e-6
#: So many frames in a row must be explained by the learned iron before it is believed in, and so
#: many better explained by the clean belief before it is dropped.
FRAMES_TO_BELIEVE, FRAMES_TO_CLEAN = 5, 2


@dataclass(slots=True)
class Compass:
    """Tests fields and lets the attitude learn from them.

    Attributes
    ----------
    parameters
        Thresholds and noise.
    clean
        Iron and its covariance as believed while tests pass; None while they do.
    newcomer
        Watches fields that fail.
    norms, azimuths
        Of the last frames [T], [rad].
    """

    parameters: HeadingParameters
    clean: tuple[Array, Array] | None = None
    newcomer: Newcomer = field(default_factory=Newcomer)
    norms: deque[float] = field(default_factory=deque)
    azimuths: deque[float] = field(default_factory=deque)
    _for_clean: int = 0
    _for_iron: int = 0

    @property
    def turn_rad(self) -> float:
        """The compass's heading over that of the attitude, of the frame examined last [rad]."""
        return self.azimuths[-1]

    def examine(self, attitude: Attitude, frame: InertialFrame, axes: Array) -> Array:
        """Return what the tests look at; ``axes`` is the rotation matrix at its start."""
        iron = attitude.iron if self.clean is None else self.clean[0]
        seen = axes @ (frame.field - frame.mean_turn @ iron)
        flat, norm = math.hypot(seen[0], seen[1]), float(np.linalg.norm(seen))
        north, up = attitude.earth.tolist()
        turn = math.atan2(seen[0], seen[1])
        allowed = self.parameters.drift_factor * min(attitude.heading_sigma_rad, math.pi)
        left = math.copysign(max(abs(turn) - allowed, 0.0), turn)
        difference = math.hypot(
            flat * math.sin(left), flat * math.cos(left) - north, float(seen[2]) - up
        )
        _keep(self.norms, norm, DEVIATION_S / frame.length_s)
        _keep(self.azimuths, turn, DERIVATIVE_S / frame.length_s)
        changed = math.degrees(wrapped(self.azimuths[-1] - self.azimuths[0]))
        dip = math.atan2(-seen[2], flat) - math.atan2(-up, north)
        return np.array(
            [
                difference / TESLA,
                abs(norm - math.hypot(north, up)) / TESLA,
                float(np.std(self.norms)) / TESLA,
                abs(flat - north) / TESLA,
                abs(math.degrees(left)),
                abs(changed) / (len(self.azimuths) * frame.length_s),
                abs(math.degrees(dip)),
                self._iron_change(attitude, frame, axes, difference) / TESLA,
            ]
        )

    def learn(
        self, attitude: Attitude, frame: InertialFrame, axes: Array, *, undisturbed: bool
    ) -> None:
        """Correct the attitude by a frame's field, as iron on the sensor where it is disturbed."""
        p = self.parameters
        sigma = p.field_sigma_ut * TESLA * math.sqrt(2 * p.field_memory_s / frame.length_s)
        turned = frame.speed * frame.length_s
        undecided = 0 < self._for_iron < FRAMES_TO_BELIEVE and self._for_clean < FRAMES_TO_CLEAN
        if undisturbed and self.clean is not None and undecided:
            # both beliefs explain it: neither is dropped, and the clean one learns nothing wrong
            attitude.correct_field(frame, axes, sigma, earth=False)
        elif undisturbed:
            self.newcomer.passed(turned)
            self._come_clean(attitude)
            attitude.correct_field(frame, axes, sigma, earth=True)
        elif self._replaced(attitude, frame, axes):
            self._come_clean(attitude)
        elif self.clean is not None and self._for_iron:
            attitude.correct_field(frame, axes, sigma, earth=False)
        else:
            if self.clean is None:
                self.clean = (attitude.iron.copy(), attitude.covariance[IRON, IRON].copy())
            self._for_clean = self._for_iron = 0
            attitude.blame_iron(frame, axes, BLAME_SIGMA_T)

    def _come_clean(self, attitude: Attitude) -> None:
        """Drop the belief in other iron."""
        if self.clean is not None:
            attitude.believe_iron(*self.clean)
            self.clean = None
            self._for_iron = self._for_clean = 0

    def _replaced(self, attitude: Attitude, frame: InertialFrame, axes: Array) -> bool:
        """Take a field for the place's that fails but holds still; say whether there was one."""
        iron = attitude.iron if self.clean is None else self.clean[0]
        seen = axes @ (frame.field - frame.mean_turn @ iron)
        flat = math.hypot(seen[0], seen[1])
        turned = frame.speed * frame.length_s
        verified = self.newcomer.verified
        found = self.newcomer.failed(flat, float(seen[2]), turned, frame.length_s)
        if found is None:
            return False
        attitude.take_earth(*found, self.parameters.field_sigma_ut * TESLA)
        if not verified:
            attitude.face(seen, self.parameters.field_sigma_ut * TESLA)
        return True

    def _iron_change(
        self, attitude: Attitude, frame: InertialFrame, axes: Array, difference: float
    ) -> float:
        """Return how much the iron changed [T], 0 where that is no better explanation."""
        if self.clean is None:
            return 0.0
        innovation, _, spread = attitude.expected(frame, axes)
        miss = float(np.linalg.norm(innovation))
        explained = miss <= CONSISTENT_T + 2 * math.sqrt(np.trace(spread) / 3)
        self._for_iron = self._for_iron + 1 if explained else 0
        self._for_clean = self._for_clean + 1 if difference < miss else 0
        if self._for_iron < FRAMES_TO_BELIEVE or self._for_clean >= FRAMES_TO_CLEAN:
            return 0.0
        return float(np.linalg.norm(attitude.iron - self.clean[0]))


def _keep(values: deque[float], value: float, count: float) -> None:
    values.append(value)
    while len(values) > max(round(count), 2):
        values.popleft()
