"""True places on the map: footfalls, and the path between them, which grows."""

from __future__ import annotations

from itertools import cycle
from typing import TYPE_CHECKING

import numpy as np

from .growing_line import GrowingLine
from .palette import LEFT, RIGHT, WALKER_COLOURS
from .timeline import Entity

if TYPE_CHECKING:
    from collections.abc import Sequence

    from groundtrace_codecs.labels import Label

    from .timeline import Timeline

TRUE = "/map/site/truth"
PATH, FOOTFALLS = f"{TRUE}/path", f"{TRUE}/footfalls"


def log_truth_places(timeline: Timeline, labels: Sequence[Label]) -> None:
    """Log where steps and impacts were, and between steps the path, which grows."""
    import rerun as rr

    if not labels:
        return
    known = sorted(labels)
    targets = sorted({x.target for x in known})
    walkers = dict(zip(targets, cycle(WALKER_COLOURS), strict=False))
    feet = {"left": LEFT, "right": RIGHT} if len(targets) == 1 else {}
    columns = rr.Points2D.columns(
        positions=np.array([(x.x_m, x.y_m) for x in known], np.float32),
        colors=np.array([feet.get(x.label, walkers[x.target]) for x in known], np.uint32),
        radii=np.full(len(known), -4.0),
    )
    timeline.declare(Entity(FOOTFALLS, "map"))
    timeline.send(FOOTFALLS, [x.time_ns for x in known], columns)
    for target in targets:
        walked = [x for x in known if x.kind != "impact" and x.target == target]
        path = f"{PATH}/{target}" if target else PATH
        line = GrowingLine(timeline, path, walkers[target], -1.2)
        line.add([(x.time_ns, (x.x_m or 0.0, x.y_m or 0.0)) for x in walked])
        line.close()
