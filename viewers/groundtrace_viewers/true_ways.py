"""True ways of vehicles, from labels that say where they were."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .ways import Way

if TYPE_CHECKING:
    from collections.abc import Sequence

    from groundtrace_codecs.labels import Label

#: Labels that say where a vehicle is.
PLACED = ("waypoint", "pass")


def vehicles(labels: Sequence[Label]) -> dict[str, list[Label]]:
    """Return what is known of each vehicle that passes, in the order of time."""
    names = dict.fromkeys(x.target for x in sorted(labels) if x.kind == "pass")
    return {
        name: sorted(x for x in labels if x.target == name and x.kind in PLACED) for name in names
    }


def true_ways(labels: Sequence[Label]) -> dict[str, Way]:
    """Return the way of each vehicle that is known at two moments or more."""
    found = {}
    for name, those in vehicles(labels).items():
        placed = [x for x in those if x.x_m is not None and x.y_m is not None]
        times, rows = np.unique([x.time_ns for x in placed], return_index=True)
        if len(times) > 1:
            places = np.array([(placed[i].x_m, placed[i].y_m) for i in rows], np.float64)
            found[name] = Way(times.astype(np.int64), places)
    return found
