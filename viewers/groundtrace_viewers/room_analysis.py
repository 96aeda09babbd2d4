"""The analysis of a layout: maps of errors, wrong signs and regions, each on the room."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from groundtrace.analyze.ambiguity import region_at
from groundtrace.analyze.words import (
    NAMES,
    advice_words,
    assumed,
    contribution_words,
    error_words,
    region_words,
    sign_words,
)

from .evidence import PAGE, page_view
from .moment import recording_at
from .palette import FIX_COLOURS, OUTLINE, THRESHOLD, heat
from .timeline import Timeline

if TYPE_CHECKING:
    from pathlib import Path

    import rerun as rr
    import rerun.blueprint as rrb
    from numpy.typing import NDArray

    from groundtrace.analyze.layout import Grid
    from groundtrace.analyze.room import RoomAnalysis

    Array = NDArray[np.float64]

APPLICATION = "groundtrace-room-analysis"
#: Pixels along the longer side of a map, so that a lattice keeps its cells' borders.
PIXELS = 420
#: Around the room, as part of its longer side; more on the right, where the scale of colours is.
PAD, SCALE_PAD, SCALE_PART, SCALE_WIDTH = 0.14, 0.26, (0.07, 0.11), 12
SENSOR, MOST_RADIUS, LEAST_RADIUS = 0xFFFFFFFF, 16.0, 4.0
ADDED, MOVED = FIX_COLOURS[1], FIX_COLOURS[0]
REGION_BORDER = 0xFFFFFF60
#: Least end of the scale of confusion.
LEAST_SCALE = 0.1

READING = """
## How to read it

* Each map is the room from above, in metres; the bar at its right says what its colours mean. \
Error maps share one scale, so that localizers compare. Hover over a map for places.
* **Error maps**: root mean square distance between a step at that place and where the localizer \
puts it, over random errors of the arrivals. Red ring: the worst place.
* **Wrong signs**: how many signs of time differences are measured wrong on average, where the \
arrivals of each sensor err on their own.
* **Regions**: places with the same order of arrivals. Brighter: more of the steps inside are \
taken to be in a region beyond its neighbours. A ring marks a region that is ambiguous: tiny, \
like one far away but for two signs, or mostly confused.
* **Sensors**: a disc's size is by how much the mean error rises without that sensor. Turquoise: \
the best place tried for one more; pink: the best for the sensor that counts least, moved along \
the line.
* The velocity of the hyperbolic fit is calibrated in the same room without errors, and no arrival \
is late or missing: recordings will be worse. The power law is fitted by least squares.
"""


def room_view(found: RoomAnalysis, *, path: Path | None, spawn: bool = False) -> None:
    """Show an analysis.

    Parameters
    ----------
    found
        The analysis.
    path
        The ``.rrd`` to write; may be None with ``spawn``.
    spawn
        Open the native viewer.

    Raises
    ------
    ViewerError
        Where the viewer does not start, or neither it nor a file is asked for.
    """
    import rerun as rr

    with recording_at(APPLICATION, found.layout.name, path, spawn=spawn, at_s=None) as recording:
        top = max(float(errors.rmse_m.max()) for errors in found.errors)
        views = []
        for errors in found.errors:
            board = _Board(recording, f"/{errors.method}", found)
            board.image(found.grid, errors.rmse_m, top, "m")
            board.room()
            board.ring(np.array([found.worst(errors)]))
            views.append(board.view(error_words(found, errors).partition(";")[0]))
        views += [_signs(recording, found), _regions(recording, found), _sensors(recording, found)]
        # the viewer wants a timeline even where nothing depends on time
        page = rr.TextDocument.columns(text=[room_page(found)], media_type=["text/markdown"])
        Timeline(recording, 0).send(PAGE, [0], page)
        recording.send_blueprint(_layout(views))


def room_page(found: RoomAnalysis) -> str:
    """Return the page about an analysis, markdown."""
    lines = [f"# {found.layout.name}", "", assumed(found.layout), ""]
    lines += [f"* {error_words(found, errors)}" for errors in found.errors]
    lines += [f"* {sign_words(found)}", f"* {region_words(found)}"]
    lines += [f"* {contribution_words(found)}"]
    lines += [f"* **{advice_words(found, advice)}**" for advice in found.advice]
    lines += [f"* remark: {remark}" for remark in found.remarks]
    if found.contributions:
        lines += ["", "Mean error without each sensor, rise [m]:", ""]
        lines += [f"| sensor | {' | '.join(NAMES.values())} |", "|---" * (len(NAMES) + 1) + "|"]
        lines += [
            f"| {name} | {' | '.join(f'{rise:+.3f}' for rise in without.values())} |"
            for name, without in zip(found.layout.sensors, found.contributions, strict=True)
        ]
    return "\n".join(lines) + "\n" + READING


class _Board:
    """One map: everything hangs below an entity that turns y upwards."""

    def __init__(self, recording: rr.RecordingStream, origin: str, found: RoomAnalysis) -> None:
        import rerun as rr

        self._recording, self._origin, self._found = recording, origin, found
        corners = np.vstack([found.layout.outline, found.layout.positions])
        self._low, self._high = corners.min(axis=0), corners.max(axis=0)
        self._extent = float((self._high - self._low).max())
        upwards = rr.Transform3D(mat3x3=[[1, 0, 0], [0, -1, 0], [0, 0, 1]])
        self.log("", upwards)

    def log(self, part: str, *archetypes: rr.AsComponents) -> None:
        """Log something of the map, which no time changes."""
        self._recording.log(f"{self._origin}/room{part}", *archetypes, static=True)

    def image(self, grid: Grid, values: Array, top: float, unit: str) -> None:
        """Draw values of a lattice's nodes, from 0 to ``top``, with the scale of colours."""
        cells = grid.image(values)
        factor = max(1, round(PIXELS / max(cells.shape)))
        self._picture(
            "/map", _coloured(np.kron(cells, np.ones((factor, factor))), top), grid.bounds
        )
        low, high = self._low, self._high
        left, right = high[0] + self._extent * np.array(SCALE_PART)
        ramp = np.tile(np.linspace(0.0, top, 128)[:, None], (1, SCALE_WIDTH))
        self._picture("/scale", _coloured(ramp, top), ((left, low[1]), (right, high[1])))
        marks = np.linspace(0.0, 1.0, 3)
        texts = [f"{top * part:.2g} {unit}".strip() for part in marks]
        places = np.stack([np.full(3, right), low[1] + marks * (high[1] - low[1])], axis=1)
        self.points("/marks", places, SENSOR, 0.5, texts)

    def _picture(
        self, part: str, pixels: NDArray[np.uint8], bounds: tuple[tuple[float, float], ...]
    ) -> None:
        """Put an image, first row at the bottom, between two corners [m]."""
        import rerun as rr

        (left, bottom), (right, upper) = bounds
        wide, high = (right - left) / pixels.shape[1], (upper - bottom) / pixels.shape[0]
        place = rr.Transform3D(
            translation=[left, bottom, 0.0], mat3x3=[[wide, 0, 0], [0, high, 0], [0, 0, 1]]
        )
        self.log(part, place, rr.Image(pixels, draw_order=-10.0))

    def room(self, *, sensors: bool = True) -> None:
        """Draw walls and sensors."""
        import rerun as rr

        corners = self._found.layout.outline
        ring = np.vstack([corners, corners[:1]])
        self.log(
            "/outline", rr.LineStrips2D([ring], colors=np.array([OUTLINE], np.uint32), radii=-1.2)
        )
        if sensors:
            self.points("/sensors", self._found.layout.positions, SENSOR, LEAST_RADIUS)

    def points(
        self,
        part: str,
        places: Array,
        colour: int,
        radii: float | Array,
        labels: list[str] | None = None,
    ) -> None:
        """Draw points of radii in screen points."""
        import rerun as rr

        colours = np.full(len(places), colour, np.uint32)
        shown = rr.Points2D(
            places, colors=colours, radii=-np.asarray(radii), labels=labels, show_labels=True
        )
        self.log(part, shown)

    def lines(self, part: str, strips: list[Array], colour: int, width: float) -> None:
        """Draw lines of a width in screen points."""
        import rerun as rr

        colours = np.full(len(strips), colour, np.uint32)
        self.log(part, rr.LineStrips2D(strips, colors=colours, radii=-width / 2))

    def ring(self, places: Array, radius: float = 0.028) -> None:
        """Draw rings around places."""
        turn = np.linspace(0, 2 * np.pi, 33)
        circle = radius * self._extent * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        self.lines("/rings", [place + circle for place in places], THRESHOLD, 3.0)

    def view(self, title: str) -> rrb.View:
        """Return the view of the map."""
        import rerun.blueprint as rrb

        pad = PAD * self._extent
        right = self._high[0] + SCALE_PAD * self._extent
        bounds = rrb.VisualBounds2D(
            x_range=(self._low[0] - pad, right),
            y_range=(-self._high[1] - pad, -self._low[1] + pad),
        )
        return rrb.Spatial2DView(origin=self._origin, name=title, visual_bounds=bounds)


def _coloured(values: NDArray[np.floating], top: float) -> NDArray[np.uint8]:
    """Return pixels of values from 0 to ``top``, shape (..., 4); clear where there is none."""
    packed = heat(np.nan_to_num(values) / (top or 1.0)).astype(">u4")
    pixels = np.ascontiguousarray(packed).view(np.uint8).reshape(*values.shape, 4).copy()
    pixels[np.isnan(values)] = 0
    return pixels


def _signs(recording: rr.RecordingStream, found: RoomAnalysis) -> rrb.View:
    board, mean = _Board(recording, "/signs", found), found.signs.physical
    board.image(found.sign_grid, mean, float(mean.max()), "")
    board.room()
    board.ring(found.sign_grid.nodes[[mean.argmax()]])
    return board.view(sign_words(found).partition(", where")[0])


def _regions(recording: rr.RecordingStream, found: RoomAnalysis) -> rrb.View:
    """Draw regions in the colour of their confusion, their borders, and rings where ambiguous."""
    board, a, raster = _Board(recording, "/regions", found), found.ambiguity, found.raster
    home = region_at(a.regions, raster.nodes)
    tried = np.nan_to_num(a.confusion)
    board.image(raster, tried[home], max(LEAST_SCALE, float(tried.max())), "")
    board.lines("/borders", raster.borders(home), REGION_BORDER, 1.0)
    board.room()
    marked = a.tiny | a.doubled | a.confused
    if marked.any():
        board.ring(a.sources[marked], 0.012)
    return board.view(region_words(found))


def _sensors(recording: rr.RecordingStream, found: RoomAnalysis) -> rrb.View:
    """Draw each sensor as large as its contribution, and what would be better."""
    board, layout = _Board(recording, "/sensors", found), found.layout
    board.room(sensors=False)
    localizer = found.settings.localizer
    rises = np.array([without[localizer] for without in found.contributions])
    size = np.zeros(len(layout.sensors))
    labels = list(layout.sensors)
    if len(rises):
        size = np.maximum(rises, 0.0) / max(rises.max(), 1e-9)
        labels = [f"{name} {rise:+.2f} m" for name, rise in zip(labels, rises, strict=True)]
    radii = LEAST_RADIUS + (MOST_RADIUS - LEAST_RADIUS) * np.sqrt(size)
    board.points("/sensors", layout.positions, SENSOR, radii, labels)
    for advice in found.advice:
        place = np.array(advice.place)
        added = advice.moved is None
        # the line of a sensor that is moved says as much as a name
        colour, name = (ADDED, ["one more"]) if added else (MOVED, None)
        board.points(f"/{'added' if added else 'moved'}", place[None], colour, 9.0, name)
        if advice.moved is not None:
            board.lines("/move", [np.array([layout.positions[advice.moved], place])], MOVED, 2.0)
    return board.view(contribution_words(found))


def _layout(views: list[rrb.View]) -> rrb.Blueprint:
    """Return the layout: three error maps over signs, regions and sensors, and the page."""
    import rerun.blueprint as rrb

    rows = [rrb.Horizontal(*views[:3]), rrb.Horizontal(*views[3:])]
    return rrb.Blueprint(
        rrb.Horizontal(rrb.Vertical(*rows), page_view("What is shown"), column_shares=[3.0, 1.0]),
        rrb.TimePanel(state="hidden"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )
