"""The magnetic field as a compass of a foot that stands: only ever the same direction as before.

Indoors the field is another every few steps. So it counts only where strength and dip are those
of the start, and weighs little.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..heading.rotations import turned, wrapped

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: Largest difference from the field of the start: of strength as a part, and of dip [rad].
STRENGTH, DIP_RAD = 0.1, 0.1
#: Deviation of an undisturbed heading [rad], and how long it goes on [s].
SIGMA_RAD, LASTING_S = 0.1, 1.0


@dataclass(slots=True)
class Compass:
    """The field where the foot first stood, in the frame of the track.

    Attributes
    ----------
    field
        Shape (3,) [T]; None before the first.
    """

    field: Array | None = None

    def turned_by(self, orientation: Array, field: Array) -> float | None:
        """Return how far the frame seems to have turned since the start [rad].

        Parameters
        ----------
        orientation
            Body to earth, shape (4,).
        field
            In the sensor's axes, shape (3,) [T]; NaN where there is none.

        Returns
        -------
        What to turn the orientation by; None where the field is new or not that of the start.
        """
        if not np.isfinite(field).all() or not field.any():
            return None
        now = turned(orientation, field)
        if self.field is None:
            self.field = now
            return None
        strengths = [float(np.linalg.norm(one)) for one in (now, self.field)]
        dips = [math.atan2(one[2], math.hypot(one[0], one[1])) for one in (now, self.field)]
        other = abs(strengths[0] / strengths[1] - 1) > STRENGTH
        if other or abs(dips[0] - dips[1]) > DIP_RAD:
            return None
        headings = [math.atan2(one[1], one[0]) for one in (now, self.field)]
        return wrapped(headings[1] - headings[0])


def sigma_of(length_s: float) -> float:
    """Return the deviation of one segment's heading as if segments were independent [rad]."""
    return SIGMA_RAD * math.sqrt(max(1.0, LASTING_S / length_s))
