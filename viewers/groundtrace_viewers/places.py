"""What is known of places, on the map of a site: sensors, places found, tracks, disagreements."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from groundtrace_codecs.events import Disagreement, Fix, TrackPoint

from .disagreements import DisagreementLog
from .fixes import FixLog
from .palette import FIX_COLOURS
from .sensor_map import SensorMap, bounds
from .tracks import TrackLog

if TYPE_CHECKING:
    from groundtrace.sinks import Session
    from groundtrace_codecs.events import Event, Pick, StageSpec

    from .details import Views
    from .events import LogLines
    from .palette import SensorColours
    from .timeline import Timeline


class Places:
    """Logs the map of a site; a walker has one of its own, and without places there is none.

    Parameters
    ----------
    timeline
        Where to.
    session
        What is replayed.
    colours
        Of the sensors.
    lines
        Where disagreements are told.

    Attributes
    ----------
    shown
        What the map must show; None without a map.
    sensors
        The sensors on it, or None.
    views
        What it shows of events, by their kind.
    """

    def __init__(
        self, timeline: Timeline, session: Session, colours: SensorColours, lines: LogLines
    ) -> None:
        shown = None if session.application == "walker" else bounds(session)
        self.shown = shown
        self.sensors = SensorMap(timeline, session, colours) if shown else None
        on_road = session.application == "vehicle"
        self._fixes = FixLog(timeline, shown, crosses=on_road) if shown else None
        self._tracks = TrackLog(timeline, shown) if shown and not on_road else None
        unit = session.geometry.length_unit if session.geometry is not None else "m"
        self._disagreements = DisagreementLog(timeline, lines, unit, on_map=shown is not None)

    def stage(self, spec: StageSpec) -> int:
        """Take a stage and return the colour of its places."""
        if spec.emits != "fix" or self._fixes is None:
            return FIX_COLOURS[0]
        self._fixes.begin(spec.stage)
        return self._fixes.colour(spec.stage) or FIX_COLOURS[0]

    def pick(self, pick: Pick) -> None:
        """Take an arrival of the stage that has the last word on arrivals."""
        if self.sensors is not None:
            self.sensors.arrival(pick.time_ns, pick.channel)

    def fix(self, fix: Fix) -> None:
        """Take a place."""
        self._disagreements.fix(fix)
        if self._fixes is not None:
            self._fixes.add(fix)

    def track(self, point: TrackPoint) -> None:
        """Take a point of a track."""
        if self._tracks is not None:
            self._tracks.add(point)

    def disagreement(self, found: Disagreement) -> None:
        """Take a disagreement of localizers."""
        self._disagreements.add(found)

    def event(self, event: Event) -> None:
        """Take an event; one of a kind without a view here is not shown on the map."""
        view = self.views.get(type(event))
        if view is not None:
            view(self, event)

    def flush(self) -> None:
        """Log what is pending."""
        for part in (self.sensors, self._fixes, self._tracks):
            if part is not None:
                part.flush()

    def close(self) -> None:
        """Log what was held back."""
        if self._tracks is not None:
            self._tracks.close()

    views: ClassVar[Views] = {Fix: fix, TrackPoint: track, Disagreement: disagreement}
