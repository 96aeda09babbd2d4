"""Health of recorded signals: faults of sensors and cables, found in one pass in constant memory.

One file for each kind of fault; :mod:`.watch` hears the blocks and asks all of them.
"""

from __future__ import annotations

from .finding import Finding
from .watch import HealthWatch, Listened

__all__ = ["Finding", "HealthWatch", "Listened"]
