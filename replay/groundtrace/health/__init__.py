"""Health of recorded signals: faults of sensors and cables, found in one pass in constant memory.

One file for each kind of fault; :mod:`.watch` hears the blocks of a stream and asks all of them.
What only several vectors of a sensor together tell, :mod:`.imu` asks.
"""

from __future__ import annotations

from .finding import Finding
from .watch import HealthWatch, Listened

__all__ = ["Finding", "HealthWatch", "Listened"]
