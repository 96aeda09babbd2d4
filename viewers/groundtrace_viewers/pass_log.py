"""Passes and crossings of vehicles: lines of the log, rows of tables, lanes, places on the map."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from .lanes import Lane
from .palette import COURSE_COLOURS, vehicle_colour
from .sensor_map import SITE
from .timeline import Entity

if TYPE_CHECKING:
    from groundtrace_codecs.events import LineCrossing, Pass

    from .events import LogLines
    from .sensor_map import Bounds
    from .timeline import Timeline

CROSSINGS = f"{SITE}/crossings"
PASSES, CROSSED = "/table/passes", "/table/crossings"
#: A lane for each direction of the vehicles that passed.
LANES = "/state/5-passes"
#: Where at the map's side what a crossing says stands: a part of its width from the edge.
LABEL = 0.07


def pass_text(one: Pass) -> str:
    """Return what there is to say of a pass at a station."""
    if not one.vehicle:
        return f"a vehicle at {one.station} alone"
    return f"V{one.vehicle} {one.direction} {speed_text(one)} at {one.station}"


def crossing_text(one: LineCrossing) -> str:
    """Return what there is to say of a crossing."""
    place = f"({one.x_m:.1f}, {one.y_m:.1f}) ± {one.along_sigma_m:.1f} m"
    return f"V{one.track} {speed_text(one)} crosses {one.line} at {place}"


def speed_text(one: Pass | LineCrossing) -> str:
    """Return a speed with its standard deviation; nothing where it is unknown."""
    if not math.isfinite(one.speed_mps):
        return "of unknown speed"
    return f"{one.speed_mps:.1f} ± {one.speed_sigma_mps:.1f} m/s"


class PassLog:
    """Logs passes and crossings, which are told when a vehicle has gone.

    Parameters
    ----------
    timeline
        Where to.
    lines
        Of the log.
    shown
        What of the site the map shows; None where there is no map.
    """

    def __init__(self, timeline: Timeline, lines: LogLines, shown: Bounds | None) -> None:
        self._timeline = timeline
        self._lines = lines
        self._shown = shown
        self._passes: list[Pass] = []
        self._crossings: list[LineCrossing] = []
        self._lanes: dict[str, Lane] = {}

    def passed(self, one: Pass) -> None:
        """Take a pass; those of a vehicle come together."""
        self._passes.append(one)
        level = "INFO" if one.vehicle else "WARN"
        self._lines.add("passes", one.time_ns, f"{self._when(one)}  {pass_text(one)}", level)

    def crossed(self, one: LineCrossing, *, told: bool) -> None:
        """Take a crossing: a row, and if it is told a line of the log and a mark on the map."""
        self._crossings.append(one)
        if told:
            line = f"{self._when(one)}  {crossing_text(one)}"
            self._lines.add("crossings", one.time_ns, line, "INFO")
        if told and self._shown is not None:
            self._mark(one, self._shown)

    def _when(self, one: Pass | LineCrossing) -> str:
        return f"{self._timeline.seconds(one.time_ns)} ± {one.sigma_s:.2g} s"

    def _mark(self, one: LineCrossing, shown: Bounds) -> None:
        """Log a mark where a line was crossed, and at the map's side time and speed."""
        import rerun as rr

        path = f"{CROSSINGS}/{one.line}"
        when = f"{(one.time_ns - self._timeline.start_ns) / NS_PER_S:.2f} s"
        side = (shown.x[1] - LABEL * (shown.x[1] - shown.x[0]), one.y_m)
        columns = rr.Points2D.columns(
            positions=[(one.x_m, one.y_m), side],
            labels=["", f"{one.line}: {when}, {one.speed_mps:.1f} m/s"],
            colors=np.array([COURSE_COLOURS[0]] * 2, np.uint32),
            radii=[-4.0, -0.1],
        )
        self._timeline.declare(Entity(path, "map"), rr.Points2D.from_fields(show_labels=True))
        self._timeline.send(path, [one.time_ns], columns.partition([2]))

    def flush(self) -> None:
        """Log what is pending."""
        if self._passes:
            self._rows()
            for number in dict.fromkeys(p.vehicle for p in self._passes if p.vehicle):
                self._span([p for p in self._passes if p.vehicle == number])
        if self._crossings:
            self._crossing_rows()
        self._passes, self._crossings = [], []
        for lane in self._lanes.values():
            lane.flush()

    def _span(self, passes: list[Pass]) -> None:
        """Put a vehicle into the lane of its direction, from its first station to its last."""
        first, direction = passes[0], passes[0].direction
        lane = self._lanes.setdefault(direction, Lane(self._timeline, f"{LANES}/{direction}", {}))
        state = f"V{first.vehicle} {first.speed_mps:.1f} m/s"
        lane.allow({state: vehicle_colour(first.vehicle)})
        times = [p.time_ns for p in passes]
        lane.add(min(times), state, max(times))

    def _rows(self) -> None:
        import rerun as rr

        passes = self._passes
        self._timeline.declare(Entity(PASSES, "table", "Passes"))
        columns = rr.AnyValues.columns(
            vehicle=np.array([p.vehicle for p in passes]),
            direction=[p.direction for p in passes],
            speed_mps=np.array([p.speed_mps for p in passes]),
            speed_sigma_mps=np.array([p.speed_sigma_mps for p in passes]),
            station=[p.station for p in passes],
            time_sigma_s=np.array([p.sigma_s for p in passes]),
            half_width_s=np.array([p.half_width_s for p in passes]),
            over_noise_db=np.array([p.value for p in passes]),
        )
        self._timeline.send(PASSES, [p.time_ns for p in passes], columns)

    def _crossing_rows(self) -> None:
        import rerun as rr

        found = self._crossings
        self._timeline.declare(Entity(CROSSED, "table", "Crossings"))
        columns = rr.AnyValues.columns(
            stage=[c.stage for c in found],
            track=np.array([c.track for c in found]),
            line=[c.line for c in found],
            x_m=np.array([c.x_m for c in found]),
            y_m=np.array([c.y_m for c in found]),
            along_sigma_m=np.array([c.along_sigma_m for c in found]),
            time_sigma_s=np.array([c.sigma_s for c in found]),
            speed_mps=np.array([c.speed_mps for c in found]),
            speed_sigma_mps=np.array([c.speed_sigma_mps for c in found]),
            heading_deg=np.degrees([c.heading_rad for c in found]),
        )
        self._timeline.send(CROSSED, [c.time_ns for c in found], columns)
