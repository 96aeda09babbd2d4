"""Courses of vehicles on the map, and where each vehicle is by them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.events import Fix
from groundtrace_codecs.signals import NS_PER_S

from .fixes import ellipse
from .palette import COURSE_COLOURS, vehicle_colour
from .sensor_map import SITE
from .strips import Strips
from .ways import Way, dashes, log_moving

if TYPE_CHECKING:
    from groundtrace_codecs.events import StageSpec, TrackPoint

    from .lanes import StageLanes
    from .sensor_map import Bounds
    from .timeline import Timeline

COURSES = f"{SITE}/courses"
KEY = f"{COURSES}/key"
#: A course stays so long after its last place [ns].
HOLD_NS = 5 * NS_PER_S
#: Length of a dash as a part of the map's width; width of lines [screen points].
DASH, BROAD, THIN = 0.012, 1.6, 1.0
#: How far down the margin the key stands.
MARGIN = 0.55


class CourseLog:
    """Logs tracks of vehicles, which are told when a vehicle has gone, at the times they are of.

    Courses of a stage that follow one another use two entities in turn: one may still be seen
    when the next begins.

    Parameters
    ----------
    timeline
        Where to.
    shown
        What of the site the map shows; None where there is no map.
    lanes
        Of the stages: they show speeds.
    """

    def __init__(self, timeline: Timeline, shown: Bounds | None, lanes: StageLanes) -> None:
        self._timeline = timeline
        self._shown = shown
        self._lanes = lanes
        self._specs: dict[str, StageSpec] = {}
        self._pending: dict[tuple[str, int], list[TrackPoint]] = {}
        self._strips: dict[tuple[str, int, str], Strips] = {}

    @property
    def last(self) -> str:
        """The stage that has the last word; empty where none tells courses."""
        return next(reversed(self._specs), "")

    def stage(self, spec: StageSpec) -> None:
        """Take a stage that tells courses."""
        self._specs.setdefault(spec.stage, spec)
        if self._shown is not None:
            self._name(self._shown)

    def colour(self, stage: str) -> int:
        """Return the colour of a stage: the last one has the first."""
        place = list(reversed(self._specs)).index(stage)
        return COURSE_COLOURS[place % len(COURSE_COLOURS)]

    def _name(self, shown: Bounds) -> None:
        """Name the stages in the key."""
        import rerun as rr

        key = rr.Points2D(
            shown.key(len(self._specs), -MARGIN),
            labels=list(self._specs),
            show_labels=True,
            colors=np.array([self.colour(s) for s in self._specs], np.uint32),
            radii=-5.0,
        )
        self._timeline.static(KEY, key)

    def add(self, point: TrackPoint) -> None:
        """Take a place; those of a track come together, in the order of time."""
        if point.stage in self._specs:
            self._pending.setdefault((point.stage, point.track), []).append(point)

    def flush(self) -> None:
        """Log what is pending."""
        for (stage, track), points in self._pending.items():
            self._span(stage, track, points)
            if len(points) > 1 and self._shown is not None:
                self._log(stage, track, points, self._shown)
        self._pending = {}
        for strips in self._strips.values():
            strips.flush()

    def _span(self, stage: str, track: int, points: list[TrackPoint]) -> None:
        """Put a track into its stage's lane, with its mean speed."""
        spec = self._specs[stage]
        speed = float(np.mean([np.hypot(p.vx_mps, p.vy_mps) for p in points]))
        state = f"V{track} {speed:.1f} m/s"
        lane = self._lanes.of(stage, spec.topic, {state: vehicle_colour(track)}, spec.emits)
        lane.add(points[0].time_ns, state, points[-1].time_ns)

    def _log(self, stage: str, track: int, points: list[TrackPoint], shown: Bounds) -> None:
        times = np.array([p.time_ns for p in points], np.int64)
        way = Way(times, np.array([(p.x_m, p.y_m) for p in points]))
        best, colour, turn = stage == self.last, self.colour(stage), track % 2
        line = dashes(way.places, DASH * (shown.x[1] - shown.x[0]))
        radii = [-(BROAD if best else THIN)] * len(line)
        drawn = self._of(stage, turn, "course")
        drawn.add(points[0].time_ns, line, [colour] * len(line), radii)
        drawn.clear(points[-1].time_ns + HOLD_NS)
        path = f"{COURSES}/{stage}/{turn}/place"
        log_moving(self._timeline, path, way, colour, 6.0 if best else 3.0)
        if best:
            self._log_ellipses(stage, turn, way, points)

    def _log_ellipses(self, stage: str, turn: int, way: Way, points: list[TrackPoint]) -> None:
        drawn = self._of(stage, turn, "ellipse")
        spreads = way.between(np.array([p.covariance for p in points])).tolist()
        places = way.between(way.places).tolist()
        unknown = float("nan")
        fix = Fix(0, 0.0, 0.0, (0.0, 0.0, 0.0), unknown, "course", 0, stage)
        for time_ns, (x, y), spread in zip(way.steps_ns().tolist(), places, spreads, strict=True):
            here = replace(fix, x_m=x, y_m=y, covariance=tuple(spread))
            drawn.add(time_ns, [ellipse(here)], [self.colour(stage)], [-1.0])
        drawn.clear(int(way.times_ns[-1]) + 1)

    def _of(self, stage: str, turn: int, what: str) -> Strips:
        key = (stage, turn, what)
        if key not in self._strips:
            path = f"{COURSES}/{stage}/{turn}/{what}"
            self._strips[key] = Strips(self._timeline, path, 10.0)
        return self._strips[key]
