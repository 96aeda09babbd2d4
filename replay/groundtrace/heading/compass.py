"""The compass: tests of the magnetic field, and what is known of it when they fail.

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
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.events import Quantity

from ..gates import Level
from ..later import Later

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from . import belief_kernels, compass_kernels
    from .attitude import Attitude
    from .inertial_frames import InertialFrame
    from .parameters import HeadingParameters
    from .rotations import Array
else:
    belief_kernels = Later("groundtrace.heading.belief_kernels")
    compass_kernels = Later("groundtrace.heading.compass_kernels")

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


@dataclass(slots=True)
class Compass:
    """What is known of the last fields, as compiled functions lay it out.

    Attributes
    ----------
    parameters
        Thresholds and noise.
    length_s
        Of a frame [s].
    recent, counts
        Norms and azimuths of the last frames [T], [rad], shape (2, m); how many there are and may
        be, shape (2, 2).
    belief, fields
        What is believed of the sensor's iron, and fields that may be the place's: see
        :mod:`.belief_kernels`.
    """

    parameters: HeadingParameters
    length_s: float
    recent: Array = field(init=False)
    counts: NDArray[np.int64] = field(init=False)
    belief: Array = field(init=False)
    fields: Array = field(init=False)

    def __post_init__(self) -> None:
        """Know nothing yet."""
        self.counts = np.zeros((2, 2), np.int64)
        self.last(self.length_s)
        # the last frame of a run is shorter, so that one more counts
        self.recent = np.zeros((2, int(self.counts.max()) + 1))
        self.belief = np.zeros(belief_kernels.BELIEF)
        self.fields = np.zeros(
            (int(belief_kernels.LEAST_S / self.length_s) + 2, belief_kernels.WATCH)
        )

    @property
    def turn_rad(self) -> float:
        """The compass's heading over that of the attitude, of the frame examined last [rad]."""
        return float(self.recent[1, self.counts[1, 0] - 1])

    def last(self, length_s: float) -> None:
        """Let the windows hold frames of a length [s]."""
        for row, span_s in enumerate((DEVIATION_S, DERIVATIVE_S)):
            self.counts[row, 1] = max(round(span_s / length_s), 2)

    def examine(self, attitude: Attitude, frame: InertialFrame, axes: Array) -> Array:
        """Return what the tests look at; ``axes`` is the rotation matrix at its start."""
        self.last(frame.length_s)
        x, y, z = (axes @ (frame.field - frame.mean_turn @ attitude.iron)).tolist()
        allowed = self.parameters.drift_factor * min(attitude.heading_sigma_rad, math.pi)
        out = np.zeros(len(TESTS))
        earth = attitude.earth
        compass_kernels.tests(
            earth, (x, y, z), allowed, self.recent, self.counts, frame.length_s, out
        )
        return out
