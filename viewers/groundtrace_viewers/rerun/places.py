"""The map of a site: sensors, fixes, regions, tracks, and localizers that disagree."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from groundtrace.localizers.arrival_order import (
    borders,
    corners,
    distances,
    known_regions,
    measured_signs,
)
from groundtrace.localizers.base import LocalizerParameters, first_arrivals, outline_of
from groundtrace.pipeline.stage import LEAST_PICKS
from groundtrace_codecs.events import (
    SMOOTHED,
    Bearing,
    Disagreement,
    Fix,
    Pick,
    StageSpec,
    StepEvent,
    TrackPoint,
)
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

from .context import View
from .site import SITE, ArrivalSigns, bounds
from .stations import StationViews
from .timeline import (
    DISAGREEMENT,
    FAINT,
    TRACK_COLOURS,
    Entity,
    GrowingLine,
    Strips,
    dimmed,
    used,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray
    from rerun import ComponentColumn, ComponentColumnList

    from groundtrace.localizers.arrival_order import Regions
    from groundtrace_codecs.geometry import Geometry

    from .context import ViewContext
    from .timeline import Bounds, Timeline

    Ring = NDArray[np.float64]


FIXES = f"{SITE}/fixes"
POINTS, ELLIPSES = f"{FIXES}/points", f"{FIXES}/ellipses"
#: Of fixes that come in every cycle and are crosses; and their size as a part of the map's width.
CROSSES, CROSS_ELLIPSES, CROSS = f"{SITE}/crosses/places", f"{SITE}/crosses/ellipses", 0.013
FIX_KEY = f"{FIXES}/key"
#: How long places and their ellipses are seen [s].
POINTS_S, CROSSES_S = {POINTS: 3.0, ELLIPSES: 0.5}, {CROSSES: 12.0, CROSS_ELLIPSES: 1.0}
CORNERS = 33
#: The key stands above the site, this far up the margin.
FIX_MARGIN = 0.88


#: A cross as one line, from tip to tip through the middle.
TIPS = np.array([(-1, -1), (1, 1), (0, 0), (-1, 1), (1, -1)], np.float32)


#: Corners of a circle about the origin, the first twice.
CIRCLE = np.stack([f(np.linspace(0.0, 2 * np.pi, CORNERS)) for f in (np.cos, np.sin)], axis=1)
#: Corners that a dash of an ellipse has after its first one, and the gap after it.
DASH = 2


def ellipses(places: ArrayLike, covariances: ArrayLike) -> NDArray[np.float32]:
    """Return closed lines at one standard deviation about places, shape (n, CORNERS, 2) [m].

    Parameters
    ----------
    places
        Shape (n, 2) [m].
    covariances
        Shape (n, 3): of x, of x and y, of y [m^2]; one that is unknown gives the place alone.
    """
    middles, spread = np.asarray(places, np.float64), np.asarray(covariances, np.float64)
    valid = np.isfinite(spread).all(axis=1, keepdims=True)
    matrices = np.where(valid, spread, 0.0)[:, [0, 1, 1, 2]].reshape(-1, 2, 2)
    value, vector = np.linalg.eigh(matrices)
    radii = np.sqrt(np.maximum(value, 0.0))[:, np.newaxis]
    lines = middles[:, np.newaxis] + CIRCLE * radii @ np.swapaxes(vector, 1, 2)
    return np.asarray(lines, np.float32)


def _ellipses(placed: Sequence[Fix | TrackPoint]) -> NDArray[np.float32]:
    return ellipses([(p.x_m, p.y_m) for p in placed], [p.covariance for p in placed])


class FixView(View):
    """Logs fixes: those of the last seconds are shown; crosses beside a road, else points."""

    def __init__(self, context: ViewContext) -> None:
        self._crosses = context.session.application == "vehicle"
        self._colour = context.place_colour
        self._timeline = context.timeline
        self._shown = bounds(context.session)
        self._stages: list[str] = []
        self._pending: list[Fix] = []

    def stage(self, spec: StageSpec) -> None:
        """Take a stage."""
        if spec.emits == "fix":
            self._begin(spec.stage)

    def _begin(self, stage: str) -> None:
        """Give a stage that finds places its colour, and name it in the key."""
        import rerun as rr

        if stage in self._stages or self._shown is None:
            return
        self._stages.append(stage)
        key = rr.Points2D(
            self._shown.key(len(self._stages), FIX_MARGIN),
            labels=self._stages,
            show_labels=True,
            colors=np.array([self._colour(s) for s in self._stages], np.uint32),
            radii=-5.0,
        )
        self._timeline.static(FIX_KEY, key)

    def fix(self, fix: Fix) -> None:
        """Take a fix."""
        self._begin(fix.stage)
        self._pending.append(fix)

    def flush(self, before_ns: int | None = None) -> None:  # noqa: ARG002
        """Log what is pending."""
        for stage in dict.fromkeys(fix.stage for fix in self._pending):
            if self._shown is not None:
                fixes = [fix for fix in self._pending if fix.stage == stage]
                self._send(stage, fixes, self._shown)
        self._pending = []

    def _send(self, stage: str, fixes: list[Fix], shown: Bounds) -> None:
        import rerun as rr

        colours = np.full(len(fixes), self._colour(stage), np.uint32)
        strips, counts = _outlines(fixes)
        lines = rr.LineStrips2D.columns(
            strips=strips,
            colors=np.repeat(colours, counts),
            radii=np.full(len(strips), -0.8),
        ).partition(counts)
        shapes = _crosses(fixes, colours, shown) if self._crosses else _points(fixes, colours)
        seen = CROSSES_S if self._crosses else POINTS_S
        for (root, visible_s), columns in zip(seen.items(), (shapes, lines), strict=True):
            self._timeline.declare(Entity(f"{root}/{stage}", "map", visible_s=visible_s))
            self._timeline.send(f"{root}/{stage}", [fix.time_ns for fix in fixes], columns)

    kinds: ClassVar = {StageSpec: stage, Fix: fix}


def _outlines(fixes: list[Fix]) -> tuple[list[NDArray[np.float32]], list[int]]:
    """Return the lines round fixes, and how many each has: dashes where its model is doubted."""
    strips: list[NDArray[np.float32]] = []
    counts = []
    for fix, ring in zip(fixes, _ellipses(fixes), strict=True):
        starts = range(0, len(ring) - 1, 2 * DASH)
        parts = [ring[i : i + DASH + 1] for i in starts] if fix.doubted else [ring]
        strips += parts
        counts.append(len(parts))
    return strips, counts


def _crosses(fixes: list[Fix], colours: NDArray[np.uint32], shown: Bounds) -> ComponentColumnList:
    import rerun as rr

    size = CROSS * (shown.x[1] - shown.x[0])
    places = np.array([(fix.x_m, fix.y_m) for fix in fixes], np.float32)
    return rr.LineStrips2D.columns(
        strips=places[:, np.newaxis, :] + size * TIPS,
        colors=colours,
        radii=np.full(len(fixes), -1.2),
    )


def _points(fixes: list[Fix], colours: NDArray[np.uint32]) -> ComponentColumnList:
    import rerun as rr

    return rr.Points2D.columns(
        positions=np.array([(fix.x_m, fix.y_m) for fix in fixes], np.float32),
        colors=colours,
        radii=np.full(len(fixes), -4.0),
    )


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
    level = (low + radius * (2 * np.arange(STROKES) + 1))[:, np.newaxis]
    (x, y), (x_after, y_after) = ring[:-1].T, ring[1:].T
    crossed = (y - level) * (y_after - level) < 0
    rise = np.where(y_after == y, 1.0, y_after - y)  # a level edge crosses no level
    ends = x + (level - y) / rise * (x_after - x)
    left = np.where(crossed, ends, np.inf).min(axis=1) + radius
    right = np.where(crossed, ends, -np.inf).max(axis=1) - radius
    lines = np.stack([left, level[:, 0], right, level[:, 0]], axis=1).reshape(-1, 2, 2)
    return list(lines[left < right]), radius * OVERLAP


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """How a region is drawn: its border, and the strokes that fill it with their radii [m]."""

    rings: list[Ring]
    lines: list[Ring]
    radii: list[float]


class RegionView:
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

        room = outline_of(self._positions, self._outline)
        lines = [line.astype(np.float32) for line in borders(self._regions, room)]
        faint = np.full(len(lines), FAINT, np.uint32)
        strips = rr.LineStrips2D(lines, colors=faint, radii=-0.5, draw_order=-30.0)
        self._timeline.declare(Entity(BORDERS, "map"), strips)

    def step(self, time_ns: int, picks: Sequence[Pick]) -> None:
        """Light the regions that fit a step's arrivals best, and tell its signs."""
        stage_picks = [pick for pick in picks if pick.stage == self._picking]
        times = first_arrivals(stage_picks, self._channels, time_ns, self._window_s, self._offsets)
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
            rings = corners(self._regions, row)
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


#: Wrong pairs named one by one; the rest are in the matrix.
NAMED = 6
#: With more sensors than this the matrix would not fit beside the log.
MATRIX_SENSORS, FEW_SENSORS = 16, 10
MARKS = {1: "+", -1: "−", 0: "·"}
SIGN_KEY = (
    "Sign of the time at i (column) less that at j (row): + the wave reached j first, − i first, "
    "✗ the region lit on the map says otherwise, · not known."
)


@dataclass(frozen=True, slots=True, eq=False)
class ArrivalOrderView:
    """The signs of one step.

    Attributes
    ----------
    hit
        Shape (k,): the regions that fit best.
    measured, expected
        Shape (n_pairs,): sign(t_i - t_j), 0 where there is none, and that of the first such region.
    compared
        Shape (n_pairs,): which pairs were measured and tell regions apart.
    distance
        Of the regions that fit best, (5.6).
    """

    hit: NDArray[np.intp]
    measured: NDArray[np.int8]
    expected: NDArray[np.int8]
    compared: NDArray[np.bool_]
    distance: float

    @property
    def wrong(self) -> NDArray[np.intp]:
        """Pairs whose measured sign is not the region's."""
        pairs: NDArray[np.intp] = np.flatnonzero(self.compared & (self.measured != self.expected))
        return pairs

    @property
    def residual(self) -> float:
        """Part of the compared signs that the region contradicts."""
        return self.distance / max(int(self.compared.sum()), 1)


def signs_of(regions: Regions, times_s: NDArray[np.float64]) -> ArrivalOrderView:
    """Return the signs of arrivals, shape (n,) [s], NaN where a sensor has none."""
    signs, compared = measured_signs(regions, times_s)
    apart = distances(regions, signs, compared)
    hit = np.flatnonzero(apart == apart.min())
    expected = regions.signs[hit[0]]
    return ArrivalOrderView(hit, signs.astype(np.int8), expected, compared, float(apart.min()))


def signs_page(signs: ArrivalOrderView, regions: Regions, names: Sequence[str], when: str) -> str:
    """Return the signs of a step as a page, markdown.

    Parameters
    ----------
    signs, regions
        Of the step, and of the room.
    names
        Of the sensors.
    when
        The step's time, for people.
    """
    wrong, count = signs.wrong, int(signs.compared.sum())
    tied = f", {len(signs.hit)} regions fit equally" if len(signs.hit) > 1 else ""
    lines = [
        f"**Step at {when}: {len(wrong)} of {count} signs wrong**, "
        f"residual {signs.residual:.2g}{tied}",
        "",
    ]
    if len(names) <= MATRIX_SENSORS:
        lines += ["```", *_matrix(signs, regions, names), "```", ""]
    if len(wrong):
        lines += ["| pair i–j | measured | region |", "|---|---|---|"]
        lines += [_row(signs, regions, names, pair) for pair in wrong[:NAMED]]
        more = len(wrong) - NAMED
        lines += ["", f"and {more} more" if more > 0 else "", ""]
    lines += [SIGN_KEY]
    return "\n".join(lines)


def _row(signs: ArrivalOrderView, regions: Regions, names: Sequence[str], pair: int) -> str:
    i, j = names[regions.first[pair]], names[regions.second[pair]]
    measured, expected = (MARKS[int(s[pair])] for s in (signs.measured, signs.expected))
    return f"| {i}–{j} | {measured} ✗ | {expected} |"


def _matrix(signs: ArrivalOrderView, regions: Regions, names: Sequence[str]) -> list[str]:
    """Return the signs of all pairs i < j: i a column, j a row, the names on the diagonal."""
    width = 3 if len(names) <= FEW_SENSORS else 2
    marks = np.array([MARKS[int(s)] for s in signs.measured], dtype=object)
    marks[~signs.compared] = MARKS[0]
    marks[signs.wrong] = "✗"
    cell = np.full((len(names), len(names)), "", dtype=object)
    cell[regions.second, regions.first] = marks
    return [
        "".join(str(mark).ljust(width) for mark in cell[row, :row]) + name
        for row, name in enumerate(names)
    ]


DISAGREEMENT_LINES = f"{SITE}/disagreements"
#: Places of so many fixes are remembered: a step is compared when the next has been located.
MOST_FIXES = 64


class DisagreementView(View):
    """Logs disagreements: lines of the log, and of the map where there is one."""

    def __init__(self, context: ViewContext) -> None:
        geometry = context.session.geometry
        self._timeline = context.timeline
        self._lines = context.lines
        self._unit = geometry.length_unit if geometry is not None else "m"
        self._on_map = bounds(context.session) is not None
        self._places: dict[tuple[int, str], tuple[float, float]] = {}
        self._order: deque[tuple[int, str]] = deque()

    def fix(self, fix: Fix) -> None:
        """Remember a place."""
        key = (fix.time_ns, fix.stage)
        self._places[key] = (fix.x_m, fix.y_m)
        self._order.append(key)
        if len(self._order) > MOST_FIXES:
            self._places.pop(self._order.popleft(), None)

    def disagreement(self, disagreement: Disagreement) -> None:
        """Take a disagreement."""
        where = self._timeline.seconds(disagreement.time_ns)
        text = (
            f"{where}  {disagreement.methods.replace(', ', ' and ')} disagree by "
            f"{disagreement.distance_m:.2f} {self._unit}, {disagreement.value:.1f} sigma "
            f"({disagreement.stage})"
        )
        self._lines.add("disagreements", disagreement.time_ns, text, "WARN")
        stages = disagreement.methods.split(", ")
        ends = [self._places.get((disagreement.time_ns, stage)) for stage in stages]
        if self._on_map and len(ends) == 2 and None not in ends:
            self._line(disagreement.time_ns, np.array(ends, np.float32))

    def _line(self, time_ns: int, ends: np.ndarray) -> None:
        import rerun as rr

        columns = rr.LineStrips2D.columns(
            strips=ends[np.newaxis],
            colors=np.array([DISAGREEMENT], np.uint32),
            radii=np.array([-0.8], np.float32),
        )
        self._timeline.declare(Entity(DISAGREEMENT_LINES, "map", visible_s=0.5))
        self._timeline.send(DISAGREEMENT_LINES, [time_ns], columns)

    kinds: ClassVar = {Fix: fix, Disagreement: disagreement}


TRACKS = f"{SITE}/tracks"
TRACK_LINES, PRESENT = f"{TRACKS}/lines", f"{TRACKS}/present"
TRACK_KEY = f"{TRACKS}/key"
#: A walker is shown where it was last for so long after its last step [s].
HOLD_S = 2.0
#: The key stands below the site, this far down the margin.
TRACK_MARGIN = 0.47
#: More would not fit below the site.
MOST_NAMED = 4


class MapTracks(View):
    """Tracks on the map of a site; a walker has a map of its own, vehicles have courses."""

    def __init__(self, context: ViewContext) -> None:
        self._tracks = TrackView(context.timeline, bounds(context.session))

    @staticmethod
    def fits(context: ViewContext) -> bool:
        """Whether a map has tracks of walkers."""
        vehicles = context.session.application == "vehicle"
        return not vehicles and bounds(context.session) is not None

    def track(self, point: TrackPoint) -> None:
        """Take a point of a track."""
        self._tracks.add(point)

    def flush(self, before_ns: int | None = None) -> None:  # noqa: ARG002
        """Log what is pending."""
        self._tracks.flush()

    def close(self) -> None:
        """Log that the walkers are gone."""
        self._tracks.close()

    kinds: ClassVar = {TrackPoint: track}


class TrackView:
    """Logs tracks; a smoothed one is known when it ends, but drawn at the times of its steps.

    Parameters
    ----------
    timeline
        Where to.
    shown
        What of the site the map shows; the key stands in its margin. None where that is not known
        yet: :meth:`name` then says so at the end.
    """

    def __init__(self, timeline: Timeline, shown: Bounds | None) -> None:
        self._timeline = timeline
        self._shown = shown
        self._keys: list[tuple[str, int]] = []
        self._last: dict[tuple[str, int], TrackPoint] = {}
        self._lines: dict[tuple[str, int], GrowingLine] = {}
        self._pending: list[TrackPoint] = []

    def add(self, point: TrackPoint) -> None:
        """Take a point; those of a track come in the order of time."""
        if (point.stage, point.track) not in self._keys:
            self._keys.append((point.stage, point.track))
            if self._shown is not None:
                self.name(self._shown)
        self._pending.append(point)

    def flush(self) -> None:
        """Log what is pending."""
        for key in dict.fromkeys((p.stage, p.track) for p in self._pending):
            points = [p for p in self._pending if (p.stage, p.track) == key]
            self._line(key, points)
            if not key[0].endswith(SMOOTHED):
                self._present(key, points)
            self._last[key] = points[-1]
        self._pending = []

    def close(self) -> None:
        """Log what is pending, and that the walkers are gone some time after their last step."""
        self.flush()
        for line in self._lines.values():
            line.close()
        for (stage, track), point in self._last.items():
            if not stage.endswith(SMOOTHED):
                time_ns = point.time_ns + round(HOLD_S * NS_PER_S)
                for path, columns in _drawn(_present_path(stage, track), [point]):
                    none = [column.partition([0]) for column in columns]
                    self._timeline.send(path, [time_ns], none)

    def _line(self, key: tuple[str, int], points: list[TrackPoint]) -> None:
        """Log the way to each point from the one before it."""
        if key not in self._lines:
            path = f"{TRACK_LINES}/{key[0]}/{key[1]}"
            self._lines[key] = GrowingLine(self._timeline, path, _colour(*key), -1.8)
        self._lines[key].add([(p.time_ns, (p.x_m, p.y_m)) for p in points])

    def _present(self, key: tuple[str, int], points: list[TrackPoint]) -> None:
        for path, columns in _drawn(_present_path(*key), points):
            self._timeline.declare(Entity(path, "map"))
            self._timeline.send(path, [p.time_ns for p in points], columns)

    def name(self, shown: Bounds) -> None:
        """Name the tracks in the key: by their stages, and where there are several by number."""
        import rerun as rr

        if not self._keys:
            return
        tracks = sorted(self._keys)[:MOST_NAMED]
        several = len({number for _, number in self._keys}) > 1
        texts = [f"{stage} {number}" if several else stage for stage, number in tracks]
        key = rr.Points2D(
            shown.key(len(tracks), -TRACK_MARGIN),
            labels=texts,
            show_labels=True,
            colors=np.array([_colour(*key) for key in tracks], np.uint32),
            radii=0.0,
        )
        self._timeline.static(TRACK_KEY, key)


def _present_path(stage: str, track: int) -> str:
    return f"{PRESENT}/{stage}/{track}"


def _drawn(path: str, points: list[TrackPoint]) -> list[tuple[str, list[ComponentColumn]]]:
    """Return where and how to log walkers: a point, and the line at one standard deviation."""
    import rerun as rr

    colours = np.array([_colour(p.stage, p.track) for p in points], np.uint32)
    dots = rr.Points2D.columns(
        positions=np.array([(p.x_m, p.y_m) for p in points], np.float32),
        colors=colours,
        radii=np.full(len(points), -6.0),
    )
    lines = rr.LineStrips2D.columns(
        strips=_ellipses(points),
        colors=colours,
        radii=np.full(len(points), -1.0),
    )
    return [(f"{path}/place", list(dots)), (f"{path}/ellipse", list(lines))]


def _colour(stage: str, track: int) -> int:
    filtered, smoothed = TRACK_COLOURS[(track - 1) % len(TRACK_COLOURS)]
    return smoothed if stage.endswith(SMOOTHED) else filtered


#: What is lit at a step goes out after this, or with the next step [ns].
LIT_NS = NS_PER_S // 2
#: Signal that must have come before what lies around a step is complete [ns].
COMPLETE_NS = NS_PER_S * 7 // 20
#: So many arrivals are remembered: a step is announced when a later arrival closes its window.
MOST_PICKS = 1024
#: Steps may be announced this much out of their order [ns].
LATE_NS = 10 * NS_PER_S
#: The plugin that locates by regions.
BY_SIGNS = "so-tdoa"


@dataclass(frozen=True, slots=True)
class PendingStep:
    """A step that waits for its signal, and for arrivals that are refined after it is found."""

    time_ns: int
    topic: str


class StepDetails(View):
    """Lights up what belongs to single steps in a room: names, regions, hodograms and bearings.

    A step is shown when its signal is complete.
    """

    def __init__(self, context: ViewContext) -> None:
        self._context = context
        self._window_s = LocalizerParameters().window_s
        self._picks: deque[Pick] = deque(maxlen=MOST_PICKS)
        self._pending_steps: deque[PendingStep] = deque()
        self._lit_ns: int | None = None
        self._regions: RegionView | None = None
        site = context.session.geometry
        mapped = bounds(context.session) is not None
        self._names = ArrivalSigns(context.timeline, site if mapped else None, context.colours)
        self._stations = {
            stream.topic: StationViews(
                context.timeline, stream, site, context.colours, context.traces
            )
            for stream in context.session.streams
            if site is not None and not stream.irregular and StationViews.fits(stream, site)
        }

    @staticmethod
    def fits(context: ViewContext) -> bool:
        """Whether a room is replayed."""
        return context.session.application == "room"

    def stage(self, spec: StageSpec) -> None:
        """Take a stage: one that locates by regions has them on the map."""
        context, picking = self._context, self._context.stages.last("pick")
        geometry = context.session.geometry
        if spec.plugin != BY_SIGNS or self._regions is not None or picking is None:
            return
        if geometry is None or not RegionView.fits(geometry, picking):
            return
        plugin = used(context.session, spec)
        window_s = plugin.parameters.window_s if plugin is not None else self._window_s
        colour = context.place_colour(spec.stage)
        self._regions = RegionView(context.timeline, geometry, picking, window_s, colour)

    def signal(self, block: SignalBlock) -> None:
        """Take a block."""
        while self._pending_steps and self._pending_steps[0].time_ns + COMPLETE_NS <= block.last_ns:
            self._show(self._pending_steps.popleft())

    def pick(self, pick: Pick) -> None:
        """Take an arrival, which may become a step."""
        self._picks.append(pick)

    def step(self, step: StepEvent) -> None:
        """Take a step of the stage that is reported."""
        if self._context.stages.decides("step", step):
            self._pending_steps.append(PendingStep(step.time_ns, step.topic))

    def bearing(self, bearing: Bearing) -> None:
        """Take a bearing; it comes with its step."""
        for views in self._stations.values():
            views.bearing(bearing)

    def close(self) -> None:
        """Show the last steps."""
        while self._pending_steps:
            self._show(self._pending_steps.popleft())
        if self._lit_ns is not None:
            self._put_out(self._lit_ns + LIT_NS)

    def flush(self, before_ns: int | None = None) -> None:  # noqa: ARG002
        """Log what is pending."""
        self._names.flush()
        if self._regions is not None:
            self._regions.flush()
        for views in self._stations.values():
            views.flush()

    def _show(self, step: PendingStep) -> None:
        if self._lit_ns is not None and self._lit_ns + LIT_NS < step.time_ns:
            self._put_out(self._lit_ns + LIT_NS)
        self._lit_ns = step.time_ns
        picks = self._picks_of(step)
        self._names.step(step.time_ns, picks)
        if self._regions is not None:
            self._regions.step(step.time_ns, picks)
        if step.topic in self._stations:
            self._stations[step.topic].step(step.time_ns, picks)

    def _picks_of(self, step: PendingStep) -> list[Pick]:
        """Return the arrivals of a step, of the stage that is reported."""
        while self._picks and self._picks[0].time_ns < step.time_ns - LATE_NS:
            self._picks.popleft()
        first_ns, end_ns = step.time_ns, step.time_ns + round(self._window_s * NS_PER_S)
        picking = self._context.stages.last("pick")
        stage = picking.stage if picking is not None else ""
        near = [p for p in self._picks if first_ns <= p.time_ns <= end_ns]
        return [p for p in near if (p.topic, p.stage) == (step.topic, stage)]

    def _put_out(self, time_ns: int) -> None:
        self._names.clear(time_ns)
        if self._regions is not None:
            self._regions.clear(time_ns)
        for views in self._stations.values():
            views.clear(time_ns)

    kinds: ClassVar = {
        StageSpec: stage,
        SignalBlock: signal,
        Pick: pick,
        StepEvent: step,
        Bearing: bearing,
    }
