"""A new reference field: what fails every test but holds still while the sensor turns.

The reference at the start may have been taken beside something magnetic. A field whose norm and
inclination stay the same while the sensor turns is neither iron on the sensor (that would change
them with its orientation) nor a magnet in passing: it is the field of the place.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np

#: Turning faster than this counts [rad/s]; so much of it makes a field known [s], [rad].
TURNING_RPS, LEAST_S, LEAST_RAD = 0.3, 10.0, 4 * math.pi
#: Norm and inclination hold still within these standard deviations [T], [rad].
STILL_T, STILL_RAD = 1.5e-6, math.radians(2.5)


@dataclass(slots=True)
class Newcomer:
    """Watches fields that fail; says when they are the field of the place.

    Attributes
    ----------
    verified_rad
        How far the sensor turned while the present reference passed its tests [rad].
    """

    verified_rad: float = 0.0
    _frames: deque[tuple[float, float, float]] = field(default_factory=deque)

    @property
    def verified(self) -> bool:
        """Whether the present reference held while the sensor turned."""
        return self.verified_rad >= LEAST_RAD

    def passed(self, turned_rad: float) -> None:
        """Take a frame that passed, or all of some by how far the sensor turned in them."""
        self.verified_rad += turned_rad
        self._frames.clear()

    def failed(
        self, flat_t: float, up_t: float, turned_rad: float, length_s: float
    ) -> tuple[float, float] | None:
        """Take a frame that failed, its field's horizontal and vertical part [T].

        Returns
        -------
        The two parts of a new reference, once there is one.
        """
        if turned_rad < TURNING_RPS * length_s:
            return None
        self._frames.append((flat_t, up_t, turned_rad))
        if len(self._frames) * length_s > LEAST_S:
            self._frames.popleft()
        elif len(self._frames) * length_s <= LEAST_S - length_s:
            return None
        flat, up, turned = np.array(self._frames).T
        still = np.hypot(flat, up).std() < STILL_T and np.arctan2(up, flat).std() < STILL_RAD
        if not still or turned.sum() < LEAST_RAD:
            return None
        self._frames.clear()
        self.verified_rad = float(turned.sum())
        return float(flat.mean()), float(up.mean())
