"""Sensors on the map: at each step every sensor's name says when the wave arrived."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from .palette import SILENT

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from groundtrace_codecs.events import Pick

    from .sensor_map import Sign
    from .timeline import Timeline


def first_at(signs: Sequence[Sign], picks: Sequence[Pick]) -> dict[str, int]:
    """Return the first arrival of each sign that has one [ns], by the sign's name."""
    owner = {channel: sign.name for sign in signs for channel in sign.channels}
    found: dict[str, int] = {}
    for pick in picks:
        name = owner.get(pick.channel)
        if name is not None:
            found[name] = min(found.get(name, pick.time_ns), pick.time_ns)
    return found


def shown_names(signs: Sequence[Sign], arrived: Mapping[str, int]) -> list[str]:
    """Return the signs' texts: name, and how long after the first arrival its own came."""
    first_ns = min(arrived.values(), default=0)
    return [
        f"{sign.name} {(arrived[sign.name] - first_ns) / NS_PER_S * 1e3:+.1f} ms"
        if sign.name in arrived
        else sign.name
        for sign in signs
    ]


class ArrivalSigns:
    """Logs the names of the sensors; at a step with their arrivals, grey where there is none.

    Parameters
    ----------
    timeline
        Where to.
    path
        Of the names on the map: places and sizes are there already.
    signs
        The names shown.
    start_ns
        From when on names alone are shown [ns].
    """

    def __init__(self, timeline: Timeline, path: str, signs: Sequence[Sign], start_ns: int) -> None:
        self._timeline = timeline
        self._path = path
        self._signs = tuple(signs)
        self._rows: list[tuple[int, list[str], list[int]]] = []
        self.clear(start_ns)

    def step(self, time_ns: int, picks: Sequence[Pick]) -> None:
        """Show a step's arrivals."""
        arrived = first_at(self._signs, picks)
        shades = [s.colour if s.name in arrived else SILENT for s in self._signs]
        self._rows.append((time_ns, shown_names(self._signs, arrived), shades))

    def clear(self, time_ns: int) -> None:
        """Show names alone."""
        names = [sign.name for sign in self._signs]
        self._rows.append((time_ns, names, [sign.colour for sign in self._signs]))

    def flush(self) -> None:
        """Log what is pending."""
        import rerun as rr

        if not self._signs or not self._rows:
            return
        columns = rr.Points2D.columns(
            labels=[text for _, texts, _ in self._rows for text in texts],
            colors=np.array([colours for _, _, colours in self._rows], np.uint32).ravel(),
        )
        counts = [len(self._signs)] * len(self._rows)
        self._timeline.send(self._path, [row[0] for row in self._rows], columns.partition(counts))
        self._rows = []
