"""The truth of a room: strikes, arrivals, walking spans."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.labels import Label
from groundtrace_codecs.signals import NS_PER_S

from .simulation import AUTHOR, START_NS

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from groundtrace_codecs.geometry import Geometry

    from .faults import Faults
    from .floor import Floor
    from .walkers import Strike

_BEYOND_NS = NS_PER_S // 4  # a walking span before its first step and after its last


def labels_of(
    strikes: Sequence[Strike], site: Geometry, floor: Floor, faults: Faults
) -> tuple[Label, ...]:
    """Return the labels in order of time."""
    labels = list(_spans(strikes))
    places = np.array([(s.x, s.y) for s in site.sensors])
    names = [s.channel for s in site.sensors]
    for strike in strikes:
        labels.append(_struck(strike))
        distance = np.hypot(*(places - (strike.x_m, strike.y_m)).T)
        late_s = floor.law_of(strike.footfall.shoe)(distance) + faults.offset_s
        for name, delay_ns, dead in zip(names, late_s * NS_PER_S, faults.dead, strict=True):
            if not dead:
                time_ns = START_NS + strike.time_ns + round(delay_ns)
                target = strike.target
                labels.append(Label(time_ns, "pick", channel=name, author=AUTHOR, target=target))
    return tuple(sorted(labels, key=lambda x: (x.time_ns, x.kind, x.channel)))


def _struck(strike: Strike) -> Label:
    return Label(
        START_NS + strike.time_ns,
        "step" if strike.foot else "impact",
        x_m=strike.x_m,
        y_m=strike.y_m,
        label=strike.foot,
        author=AUTHOR,
        target=strike.target,
    )


def _spans(strikes: Sequence[Strike]) -> Iterator[Label]:
    """Give the walking span of each walker."""
    for target in dict.fromkeys(x.target for x in strikes):
        times = [x.time_ns for x in strikes if x.target == target and x.foot]
        if times:
            start_ns, end_ns = START_NS + times[0] - _BEYOND_NS, START_NS + times[-1] + _BEYOND_NS
            yield Label(start_ns, "walking", end_ns, author=AUTHOR, target=target)
