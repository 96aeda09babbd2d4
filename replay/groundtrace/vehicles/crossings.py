"""Lines that vehicles cross: of antennas, of a road, or as told."""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import groupby, pairwise
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S
from groundtrace_codecs.traffic import LineCrossing

from ..errors import PipelineError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from groundtrace_codecs.geometry import Stations

    from .lines import Course

    Array = NDArray[np.float64]

#: Sine of the angle at which a line has to be crossed: along it, place and time are unknown.
_STEEP = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """A line through two points [m], and its name."""

    name: str
    start: Array
    end: Array


@dataclass(frozen=True, slots=True)
class Way:
    """What a vehicle's course is known by.

    Attributes
    ----------
    track, stage
        Number of the track, and the stage.
    origin_ns
        Time that the course's times count from.
    """

    track: int
    stage: str
    origin_ns: int


def lines_of(site: Stations, text: str = "") -> tuple[Line, ...]:
    """Return the lines of a site, and the one told as ``x,y x,y`` [m].

    Stations whose names differ by their number alone, as A1 to A3, are an antenna; its line goes
    through the two that are farthest apart.

    Raises
    ------
    PipelineError
        Where the text is not two places.
    """
    lines = []
    if text:
        lines.append(_told(text))
    lines += [Line("road", a, b) for a, b in pairwise(site.road)]
    order = sorted(range(len(site.names)), key=lambda i: site.names[i])
    for _, members in groupby(order, key=lambda i: re.sub(r"\d+$", "", site.names[i])):
        those = list(members)
        if len(those) > 1:
            places = site.places[those]
            apart = np.linalg.norm(places[:, None] - places, axis=2)
            a, b = sorted(np.unravel_index(int(apart.argmax()), apart.shape))
            name = f"{site.names[those[a]]}-{site.names[those[b]]}"
            lines.append(Line(name, places[a], places[b]))
    return tuple(lines)


def _told(text: str) -> Line:
    try:
        (x0, y0), (x1, y1) = (map(float, place.split(",")) for place in text.split())
    except ValueError:
        raise PipelineError(f"line: expected two places as x,y x,y, found {text!r}") from None
    if (x0, y0) == (x1, y1):
        raise PipelineError(f"line: expected two places apart, found {text!r}")
    return Line("line", np.array([x0, y0]), np.array([x1, y1]))


def crossing_of(
    line: Line, course: Course, span_s: tuple[float, float], way: Way
) -> Iterator[LineCrossing]:
    """Yield where a course crosses a line between its ends, within a span of time [s]."""
    along = (line.end - line.start) / np.hypot(*(line.end - line.start))
    vx, vy = course.velocity
    steep = abs(along[0] * vy - along[1] * vx) / max(course.speed_mps, 1e-9)
    found = course.crossing(line.start, line.end) if steep >= _STEEP else None
    if found is None or not found.inside or not span_s[0] <= found.time_s <= span_s[1]:
        return
    x, y = found.place.tolist()
    yield LineCrossing(
        way.origin_ns + round(found.time_s * NS_PER_S),
        found.time_sigma_s,
        way.track,
        line.name,
        x,
        y,
        found.along_sigma_m,
        course.speed_mps,
        course.speed_sigma_mps,
        course.heading_rad,
        way.stage,
    )
