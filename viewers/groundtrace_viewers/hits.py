"""Regions on the map: the borders of all, and at each step those that fit its signs best."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace.localizers.api import first_arrivals
from groundtrace.localizers.location import LEAST_PICKS
from groundtrace.localizers.outline import outline_of
from groundtrace.localizers.regions import borders, corners
from groundtrace.localizers.so_tdoa import known_regions

from .palette import FAINT, dimmed
from .sensor_map import SITE
from .signs import signs_of, signs_page
from .strips import Strips
from .timeline import Entity

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Pick, StageSpec
    from groundtrace_codecs.geometry import Geometry

    from .timeline import Timeline

    Ring = NDArray[np.float64]

REGIONS = f"{SITE}/regions"
BORDERS, FILLS, RINGS = f"{REGIONS}/borders", f"{REGIONS}/fills", f"{REGIONS}/rings"
PAGE = "/signs"
#: On the page before the first step that has signs.
NO_STEP = f"No step with {LEAST_PICKS} arrivals so far."
#: Strokes that fill a region; they overlap, so that no gap is seen between them.
STROKES, OVERLAP = 24, 1.15
#: Brightness of the fill as part of the border's.
FILL = 0.4
#: With more regions than this equally good the signs say nothing: none is lit.
MOST_HITS = 24


def strokes(ring: Ring) -> tuple[list[Ring], float]:
    """Fill a convex ring with level strokes: their ends, each of shape (2, 2), and their radius."""
    low, high = ring[:, 1].min(), ring[:, 1].max()
    radius = (high - low) / STROKES / 2
    x, y = ring.T
    x_after, y_after = np.roll(ring, -1, axis=0).T
    lines = []
    for level in low + radius * (2 * np.arange(STROKES) + 1):
        crossed = (y - level) * (y_after - level) < 0
        if np.count_nonzero(crossed) < 2:
            continue
        share = (level - y[crossed]) / (y_after[crossed] - y[crossed])
        ends = x[crossed] + share * (x_after[crossed] - x[crossed])
        left, right = ends.min() + radius, ends.max() - radius
        if left < right:
            lines.append(np.array([(left, level), (right, level)]))
    return lines, radius * OVERLAP


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """How a region is drawn: its border, and the strokes that fill it with their radii [m]."""

    rings: list[Ring]
    lines: list[Ring]
    radii: list[float]


class RegionLog:
    """Logs the regions of a stage that locates by signs, and the signs of each step.

    Parameters
    ----------
    timeline
        Where to.
    geometry
        Where the sensors are.
    picking
        The stage whose arrivals the localizer takes.
    window_s
        How long after a step arrivals belong to it [s].
    colour
        Of the stage's places.
    """

    def __init__(
        self,
        timeline: Timeline,
        geometry: Geometry,
        picking: StageSpec,
        window_s: float,
        colour: int,
    ) -> None:
        self._timeline = timeline
        self._window_s = window_s
        self._colour = colour
        self._channels, self._positions = geometry.placed(picking.channels)
        self._offsets = geometry.clock_offsets(self._channels)
        self._outline = np.array(geometry.outline, np.float64)
        shown = {s.channel: s.name for s in geometry.sensors}
        self._names = [shown[channel] for channel in self._channels]
        self._regions = known_regions(self._positions, self._outline)
        self._room = outline_of(self._positions, self._outline)
        self._picking = picking.stage
        self._fills = Strips(timeline, FILLS, -40.0)
        self._rings = Strips(timeline, RINGS, -20.0)
        self._pages = [(timeline.start_ns, NO_STEP)]
        self._drawn: dict[int, Drawn] = {}
        self._timeline.declare(Entity(PAGE, "page", "Signs"))
        self._log_borders()

    @staticmethod
    def fits(geometry: Geometry | None, picking: StageSpec | None) -> bool:
        """Whether there are enough sensors with places to have regions."""
        if geometry is None or picking is None:
            return False
        _, positions = geometry.placed(picking.channels)
        return len(np.unique(positions, axis=0)) >= LEAST_PICKS

    def _log_borders(self) -> None:
        import rerun as rr

        lines = [line.astype(np.float32) for line in borders(self._regions, self._room)]
        faint = np.full(len(lines), FAINT, np.uint32)
        strips = rr.LineStrips2D(lines, colors=faint, radii=-0.5, draw_order=-30.0)
        self._timeline.declare(Entity(BORDERS, "map"), strips)

    def step(self, time_ns: int, picks: Sequence[Pick]) -> None:
        """Light the regions that fit a step's arrivals best, and tell its signs."""
        own = [pick for pick in picks if pick.stage == self._picking]
        times = first_arrivals(own, self._channels, time_ns, self._window_s, self._offsets)
        if np.isfinite(times).sum() < LEAST_PICKS:
            self.clear(time_ns)
            return
        signs = signs_of(self._regions, times)
        if len(signs.hit) > MOST_HITS:
            self.clear(time_ns)
        else:
            self._light(time_ns, signs.hit)
        when = self._timeline.seconds(time_ns)
        page = signs_page(signs, self._regions, self._names, when)
        self._pages.append((time_ns, page))

    def _light(self, time_ns: int, hit: NDArray[np.intp]) -> None:
        drawn = [self._drawing(int(row)) for row in hit]
        rings = [ring for part in drawn for ring in part.rings]
        lines = [line for part in drawn for line in part.lines]
        radii = [radius for part in drawn for radius in part.radii]
        dim = dimmed(self._colour, FILL)
        self._fills.add(time_ns, lines, [dim] * len(lines), radii)
        self._rings.add(time_ns, rings, [self._colour] * len(rings), [-0.8] * len(rings))

    def _drawing(self, row: int) -> Drawn:
        """Return how a region is drawn; walkers come back to the same ones."""
        if row not in self._drawn:
            rings = corners(self._regions, row, self._room)
            filled = [strokes(ring) for ring in rings]
            lines = [line for part, _ in filled for line in part]
            radii = [radius for part, radius in filled for _ in part]
            self._drawn[row] = Drawn(rings, lines, radii)
        return self._drawn[row]

    def clear(self, time_ns: int) -> None:
        """Light no region any more."""
        self._fills.clear(time_ns)
        self._rings.clear(time_ns)

    def flush(self) -> None:
        """Log what is pending."""
        import rerun as rr

        self._fills.flush()
        self._rings.flush()
        if self._pages:
            times, pages = zip(*self._pages, strict=True)
            kinds = ["text/markdown"] * len(pages)
            columns = rr.TextDocument.columns(text=list(pages), media_type=kinds)
            self._timeline.send(PAGE, times, columns)
            self._pages = []
