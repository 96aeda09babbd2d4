"""Way along a road over time: stations, their passes, and the vehicles that go through them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from .palette import MISSED, REJECTED, TRACE, TRUTH, dimmed, vehicle_colour
from .sensor_map import signs_of
from .timeline import Entity
from .true_ways import true_ways, vehicles

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    from groundtrace.sinks import Session
    from groundtrace_codecs.events import Pass

    from .palette import SensorColours
    from .pass_verdicts import PassVerdict
    from .timeline import Timeline

    Array = NDArray[np.float64]

ROAD = "/road"
#: Beyond the first and last station the plot shows this part of the way between them, and this
#: much at least [m].
BEYOND, LEAST_M = 0.3, 10.0
#: Vehicles use so many curves in turn: two that are there at once never share one.
CURVES = 4
#: Brightness of the lines of stations.
STATION = 0.45


class RoadPlot:
    """Logs the plot; without two stations at places there is none.

    Parameters
    ----------
    timeline
        Where to.
    session
        Gives stations, road and truth.
    colours
        Of the sensors.
    """

    def __init__(self, timeline: Timeline, session: Session, colours: SensorColours) -> None:
        self._timeline = timeline
        self._session = session
        self._passes: list[Pass] = []
        self._begun = False
        geometry = session.geometry
        self._site = geometry.stations() if geometry is not None else None
        self._along: dict[str, float] = {}
        if self._site is not None and self._site.names:
            along, _ = self._site.along_road()
            self._along = dict(zip(self._site.names, along.tolist(), strict=True))
        signs = signs_of(geometry, colours) if geometry is not None else []
        self._shades = {sign.name: sign.colour for sign in signs}

    def add(self, one: Pass) -> None:
        """Take a pass; those of a vehicle come together."""
        if len(set(self._along.values())) > 1 and one.station in self._along:
            self._passes.append(one)

    def flush(self) -> None:
        """Log what is pending."""
        if self._passes and not self._begun:
            self._begin()
        for number in dict.fromkeys(p.vehicle for p in self._passes if p.vehicle):
            self._vehicle([p for p in self._passes if p.vehicle == number])
        for station in dict.fromkeys(p.station for p in self._passes):
            self._marks(station, [p for p in self._passes if p.station == station])
        self._passes = []

    @property
    def _reach_m(self) -> tuple[float, float]:
        """What the plot shows of the way along the road [m]."""
        low, high = min(self._along.values()), max(self._along.values())
        beyond = max(BEYOND * (high - low), LEAST_M)
        return low - beyond, high + beyond

    def _begin(self) -> None:
        """Log what does not come with passes: the stations, and the truth."""
        self._begun = True
        session, (low, high) = self._session, self._reach_m
        title = "Way along the road [m]: passes at stations, vehicles, missed red; truth violet"
        entity = Entity(ROAD, "road", title, bottom=low, top=high)
        self._timeline.declare(entity)
        span_ns = session.shown_ns or (session.start_ns, session.end_ns)
        for name, along in self._along.items():
            colour = dimmed(self._shades.get(name, TRACE), STATION)
            self._curve(f"stations/{name}", span_ns, (along, along), name, colour, 1.0)
        for number, name in enumerate(vehicles(session.labels)):
            self._true(number, name)

    def _true(self, number: int, name: str) -> None:
        """Log where a vehicle truly was along the road, or when at the stations without a road."""
        if self._site is None:
            return
        way = true_ways(self._session.labels).get(name)
        if len(self._site.road) > 1 and way is not None:
            times = way.times_ns
            along, _ = replace(self._site, places=way.places).along_road()
        else:
            passes = vehicles(self._session.labels)[name]
            known = [
                (x.time_ns, self._along[x.channel]) for x in passes if x.channel in self._along
            ]
            times = np.array([t for t, _ in known], np.int64)
            along = np.array([a for _, a in known])
        low, high = self._reach_m
        near = (along > low) & (along < high)
        if near.sum() > 1:
            path = f"truth/{number % CURVES}"
            self._curve(path, times[near], along[near], "truth", TRUTH, 1.0)

    def _vehicle(self, passes: list[Pass]) -> None:
        """Log the line that a vehicle's passes make, over the whole plot."""
        passes = sorted(passes, key=lambda p: p.time_ns)
        since = np.array([p.time_ns - passes[0].time_ns for p in passes]) / NS_PER_S
        along = np.array([self._along[p.station] for p in passes])
        one = passes[0]
        speed = one.speed_mps if one.direction == "forward" else -one.speed_mps
        if not np.isfinite(speed) or speed == 0.0:
            return
        start = float(np.mean(along - speed * since))
        ends = sorted((edge - start) / speed for edge in self._reach_m)
        times = [one.time_ns + round(t * NS_PER_S) for t in ends]
        path = f"vehicles/{one.vehicle % CURVES}"
        line = [start + speed * t for t in ends]
        self._curve(path, times, line, "vehicle", vehicle_colour(one.vehicle), 1.8)

    def _marks(self, station: str, passes: list[Pass]) -> None:
        """Log a station's passes: in its colour, or grey where no vehicle has them."""
        import rerun as rr

        whose = [p for p in passes if p.vehicle], rr.components.MarkerShape.Circle
        alone = [p for p in passes if not p.vehicle], rr.components.MarkerShape.Cross
        for kind, (those, marker) in (("whose", whose), ("alone", alone)):
            if those:
                colour = self._shades.get(station, TRACE) if kind == "whose" else REJECTED
                path = f"{ROAD}/passes/{station}/{kind}"
                style = rr.SeriesPoints(
                    names=station,
                    colors=np.array([colour], np.uint32),
                    markers=marker,
                    marker_sizes=5.0,
                )
                self._timeline.static(path, style)
                along = np.full((len(those), 1), self._along[station])
                self._timeline.scalars(path, [p.time_ns for p in those], along)

    def missed(self, verdicts: Sequence[PassVerdict]) -> None:
        """Take the true passes that were missed."""
        import rerun as rr

        known = [one for one in verdicts if one.station in self._along]
        if not known or len(set(self._along.values())) < 2:
            return
        if not self._begun:
            self._begin()
        style = rr.SeriesPoints(
            names="missed",
            colors=np.array([MISSED], np.uint32),
            markers=rr.components.MarkerShape.Cross,
            marker_sizes=6.0,
        )
        self._timeline.static(f"{ROAD}/missed", style)
        along = np.array([[self._along[one.station]] for one in known])
        self._timeline.scalars(f"{ROAD}/missed", [one.time_ns for one in known], along)

    def _curve(
        self,
        name: str,
        times: ArrayLike,
        values: ArrayLike,
        title: str,
        colour: int,
        width: float,
    ) -> None:
        """Log a line that ends: the viewer would draw it on to the next."""
        import rerun as rr

        path = f"{ROAD}/{name}"
        style = rr.SeriesLines(names=title, colors=np.array([colour], np.uint32), widths=width)
        self._timeline.static(path, style)
        ends = np.append(np.asarray(times, np.int64), np.asarray(times, np.int64)[-1] + 1)
        along = np.append(np.asarray(values, np.float64), np.nan)
        self._timeline.scalars(path, ends, along[:, np.newaxis])
