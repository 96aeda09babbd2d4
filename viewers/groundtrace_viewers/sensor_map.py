"""The site from above: outline, sensors in their colours, shot points and the true path."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .palette import IMPACT, LEFT, OUTLINE, RIGHT, TRUTH
from .timeline import Entity

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace.sinks import Session
    from groundtrace_codecs.geometry import Geometry
    from groundtrace_codecs.labels import Label

    from .palette import SensorColours
    from .timeline import Timeline

#: Everything on the map hangs below this entity, which turns y upwards.
SITE = "/map/site"
PATH = f"{SITE}/truth/path"
FOOTFALLS = f"{SITE}/truth/footfalls"
ARRIVALS = f"{SITE}/arrivals"


@dataclass(frozen=True, slots=True)
class Bounds:
    """What of the site to show [m], y upwards."""

    x: tuple[float, float]
    y: tuple[float, float]


def places(session: Session) -> NDArray[np.float64]:
    """Return every place the session knows, shape (n, 2) [m]."""
    points: list[tuple[float, float]] = [
        (label.x_m, label.y_m)
        for label in session.labels
        if label.x_m is not None and label.y_m is not None
    ]
    if session.geometry is not None:
        geometry = session.geometry
        points += [(s.x, s.y) for s in geometry.sensors]
        points += list(geometry.outline)
        points += [(x, y) for _, x, y in geometry.sources]
    return np.array(points, np.float64).reshape(-1, 2)


def bounds(session: Session) -> Bounds | None:
    """Return what the map must show, or None where the session knows fewer than two places."""
    known = places(session)
    if len(np.unique(known, axis=0)) < 2:
        return None
    low, high = known.min(axis=0), known.max(axis=0)
    pad = 0.1 * float(np.max(high - low))
    return Bounds(
        (float(low[0]) - pad, float(high[0]) + pad), (float(low[1]) - pad, float(high[1]) + pad)
    )


class SensorMap:
    """Logs the map of a session and lights sensors up as waves arrive.

    Parameters
    ----------
    timeline
        Where to.
    session
        Gives geometry and truth.
    colours
        Of the sensors.
    """

    def __init__(self, timeline: Timeline, session: Session, colours: SensorColours) -> None:
        import rerun as rr

        self._timeline = timeline
        self._colours = colours
        sensors = session.geometry.sensors if session.geometry else ()
        self._place = {s.channel: (s.x, s.y) for s in sensors}
        self._arrivals: list[tuple[int, str]] = []
        upwards = rr.Transform3D(mat3x3=[[1, 0, 0], [0, -1, 0], [0, 0, 1]])
        timeline.declare(Entity(SITE, "map"), upwards)
        if session.geometry is not None:
            self._log_geometry(session.geometry)
        self._log_path([x for x in session.labels if x.x_m is not None and x.y_m is not None])

    def _log_geometry(self, geometry: Geometry) -> None:
        import rerun as rr

        if geometry.outline:
            ring = [*geometry.outline, geometry.outline[0]]
            line = rr.LineStrips2D([ring], colors=[OUTLINE], radii=-1.0)
            self._timeline.static(f"{SITE}/outline", line)
        if geometry.sensors:
            sensors = rr.Points2D(
                [(s.x, s.y) for s in geometry.sensors],
                labels=[s.name for s in geometry.sensors],
                show_labels=len(geometry.sensors) <= 16,
                colors=np.array([self._colours.of(s.channel) for s in geometry.sensors], np.uint32),
                radii=-6.0,
            )
            self._timeline.static(f"{SITE}/sensors", sensors)
        if geometry.sources:
            shots = rr.Points2D(
                [(x, y) for _, x, y in geometry.sources],
                labels=[name for name, _, _ in geometry.sources],
                show_labels=len(geometry.sources) <= 12,
                colors=np.full(len(geometry.sources), IMPACT, np.uint32),
                radii=-4.0,
            )
            self._timeline.static(f"{SITE}/sources", shots)

    def _log_path(self, labels: Sequence[Label]) -> None:
        """Log one segment a row, so that the path grows with the cursor."""
        import rerun as rr

        if not labels:
            return
        walked = sorted(labels)
        points = np.array([(x.x_m, x.y_m) for x in walked], np.float32)
        times = [x.time_ns for x in walked]
        feet = [{"left": LEFT, "right": RIGHT}.get(x.label, TRUTH) for x in walked]
        columns = rr.Points2D.columns(
            positions=points,
            colors=np.array(feet, np.uint32),
            radii=np.full(len(walked), -4.0),
        )
        self._timeline.declare(Entity(FOOTFALLS, "map"))
        self._timeline.send(FOOTFALLS, times, columns)
        if len(walked) > 1:
            strips = rr.LineStrips2D.columns(
                strips=np.stack([points[:-1], points[1:]], axis=1),
                colors=np.full(len(walked) - 1, TRUTH, np.uint32),
                radii=np.full(len(walked) - 1, -1.2),
            )
            self._timeline.declare(Entity(PATH, "map"))
            self._timeline.send(PATH, times[1:], strips)

    def arrival(self, time_ns: int, channel: str) -> None:
        """Take the arrival of a wave at a sensor."""
        if channel in self._place:
            self._arrivals.append((time_ns, channel))

    def flush(self) -> None:
        """Log what is pending."""
        import rerun as rr

        if not self._arrivals:
            return
        times = [t for t, _ in self._arrivals]
        names = [name for _, name in self._arrivals]
        columns = rr.Points2D.columns(
            positions=np.array([self._place[n] for n in names], np.float32),
            colors=np.array([self._colours.of(n) for n in names], np.uint32),
            radii=np.full(len(names), -10.0),
        )
        self._timeline.declare(Entity(ARRIVALS, "map"))
        self._timeline.send(ARRIVALS, times, columns)
        self._arrivals = []
