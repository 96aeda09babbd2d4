"""True ways of vehicles: on the map, and as lanes of who passes which way and how fast."""

from __future__ import annotations

from itertools import cycle
from typing import TYPE_CHECKING

import numpy as np

from .lanes import TRUTH as LANES
from .lanes import Lane
from .palette import TRUTH, WALKER_COLOURS
from .sensor_map import SITE
from .strips import Strips
from .true_ways import true_ways, vehicles
from .ways import log_moving

if TYPE_CHECKING:
    from collections.abc import Sequence

    from groundtrace_codecs.labels import Label

    from .timeline import Timeline

TRUE_WAYS = f"{SITE}/true-ways"


def log_true_ways(timeline: Timeline, labels: Sequence[Label]) -> None:
    """Log the way of each vehicle while it is on it, and where it is; of several with its name."""
    ways = true_ways(labels)
    for number, (name, way) in enumerate(ways.items()):
        path = f"{TRUE_WAYS}/{number}"
        line = Strips(timeline, f"{path}/way", 5.0)
        line.add(int(way.times_ns[0]), [way.places], [TRUTH & 0xFFFFFF80], [-0.8])
        line.clear(int(way.times_ns[-1]))
        line.flush()
        log_moving(timeline, f"{path}/place", way, TRUTH, 5.0, name if len(ways) > 1 else "")


def log_true_passes(timeline: Timeline, labels: Sequence[Label]) -> None:
    """Log a lane for each direction: vehicles from their first station to their last."""
    lanes: dict[str, Lane] = {}
    colours = cycle(WALKER_COLOURS)
    for name, those in vehicles(labels).items():
        passes = [x for x in those if x.kind == "pass"]
        direction = passes[0].label or "passes"
        speeds = [x.value for x in passes if x.value is not None]
        state = f"{name} {np.mean(speeds):.1f} m/s" if speeds else name
        lane = lanes.setdefault(direction, Lane(timeline, f"{LANES}/{direction}", {}))
        lane.allow({state: next(colours)})
        lane.add(passes[0].time_ns, state, passes[-1].time_ns)
    for lane in lanes.values():
        lane.flush()
