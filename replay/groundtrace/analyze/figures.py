"""The figure of an analysis, as PNG: the only module that knows matplotlib.

Colours are told apart by colour-blind people: viridis and cividis rise evenly in lightness.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from ..appearing import appearing
from .ambiguity import region_at
from .words import (
    advice_words,
    assumed,
    contribution_words,
    error_words,
    region_words,
    sign_words,
)

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.image import AxesImage
    from numpy.typing import NDArray

    from .advice import Advice
    from .layout import Grid
    from .room import RoomAnalysis

    Array = NDArray[np.float64]

DPI = 110
#: Inches: a column, a map at most, and what lies left of, above and below it.
COLUMN_IN, MAP_IN, LEFT_IN, BELOW_IN, HEAD_IN = 5.2, 3.6, 0.75, 0.95, 0.45
#: Above the maps of either row: titles of two lines, and of five.
ABOVE_IN = (0.5, 0.95)
#: Inches from a map to its scale, and its width.
GAP_IN, BAR_IN = 0.12, 0.14
#: Around the room, as part of its longer side; characters in a line of a title.
PAD, LINE = 0.06, 58
#: A sensor this far from the middle, as part of the room's width, is beside a wall.
BESIDE_WALL = 0.35
#: Least end of the scale of confusion.
LEAST_SCALE = 0.1
ORANGE, BLUE, INK = "#d55e00", "#0072b2", "#1b2028"


def save(found: RoomAnalysis, path: Path) -> None:
    """Write the figure.

    Parameters
    ----------
    found
        The analysis.
    path
        The PNG to write.
    """
    # without pyplot there is no window and no state that figures share
    with appearing(path) as fresh:
        room_figure(found).savefig(fresh)


def room_figure(found: RoomAnalysis) -> Figure:
    """Return the figure: three error maps over wrong signs, regions, and sensors."""
    sheet = _Sheet(found)
    top = max(float(errors.rmse_m.max()) for errors in found.errors)
    for column, errors in enumerate(found.errors):
        axis = sheet.axes(0, column)
        image = _map(axis, found.grid, errors.rmse_m, top)
        sheet.scale(axis, image, "RMS error [m]")
        _mark(axis, found.worst(errors), "worst")
        sheet.finish(axis, error_words(found, errors))
    _signs(sheet)
    _regions(sheet)
    _sensors(sheet)
    return sheet.figure


class _Sheet:
    """Two rows of three maps of equal scale, each with room for a title, a scale and a key."""

    def __init__(self, found: RoomAnalysis) -> None:
        self.found = found
        every = np.vstack([found.layout.outline, found.layout.positions])
        low, high = every.min(axis=0), every.max(axis=0)
        pad = PAD * float((high - low).max())
        self._low, self._high = low - pad, high + pad
        sides = self._high - self._low
        self._map_in = MAP_IN * sides / sides.max()
        self._rows_in = [above + float(self._map_in[1]) + BELOW_IN for above in ABOVE_IN]
        size = (3 * COLUMN_IN, sum(self._rows_in) + HEAD_IN)
        self.figure = Figure(size, DPI, facecolor="white")
        FigureCanvasAgg(self.figure)
        head = f"{found.layout.name}: {assumed(found.layout)}"
        y = 1 - 0.6 * HEAD_IN / size[1]
        self.figure.text(LEFT_IN / size[0], y, head, fontsize=13, weight="bold", va="center")

    def axes(self, row: int, column: int) -> Axes:
        """Return the axes of one map."""
        left = column * COLUMN_IN + LEFT_IN
        return self._axes(left, sum(self._rows_in[row + 1 :]) + BELOW_IN, *self._map_in)

    def _axes(self, left: float, bottom: float, width: float, height: float) -> Axes:
        """Return axes at a place in inches."""
        across, up = self.figure.get_size_inches()
        return self.figure.add_axes((left / across, bottom / up, width / across, height / up))

    def scale(self, axis: Axes, image: AxesImage, label: str) -> None:
        """Draw the scale of colours beside a map."""
        across, up = self.figure.get_size_inches()
        box = axis.get_position()
        bar = self._axes(box.x1 * across + GAP_IN, box.y0 * up, BAR_IN, box.height * up)
        self.figure.colorbar(image, cax=bar, label=label)

    def finish(self, axis: Axes, title: str, *, sensors: bool = True) -> None:
        """Draw walls and sensors, and say what the picture shows."""
        layout = self.found.layout
        corners = np.vstack([layout.outline, layout.outline[:1]])
        axis.plot(*corners.T, color=INK, linewidth=1.4)
        if sensors:
            shape: dict[str, Any] = {
                "color": "white",
                "markeredgecolor": INK,
                "markersize": 9,
                "zorder": 3,
            }
            axis.plot(*layout.positions.T, "^", label="sensor", **shape)
        axis.set_xlim(self._low[0], self._high[0])
        axis.set_ylim(self._low[1], self._high[1])
        axis.set_aspect("equal")
        axis.set_xlabel("x [m]")
        axis.set_ylabel("y [m]")
        axis.set_title(wrapped(title), fontsize=9.5, loc="left", color=INK)
        below = -0.45 / float(self._map_in[1])
        place: dict[str, Any] = {
            "loc": "upper left",
            "bbox_to_anchor": (-0.02, below),
            "borderaxespad": 0.0,
        }
        axis.legend(**place, ncols=4, fontsize=8, frameon=False, columnspacing=1.2)


def _map(axis: Axes, grid: Grid, values: Array, top: float) -> AxesImage:
    """Draw values of the nodes."""
    (left, bottom), (right, upper) = grid.bounds
    extent = (left, right, bottom, upper)
    cells = grid.image(values)
    return axis.imshow(cells, origin="lower", extent=extent, cmap="viridis", vmin=0.0, vmax=top)


def _mark(axis: Axes, place: tuple[float, float], name: str) -> None:
    axis.plot(*place, "x", color=ORANGE, markersize=10, markeredgewidth=2.5, label=name)


def _signs(sheet: _Sheet) -> None:
    found = sheet.found
    signs, grid, axis = found.signs, found.sign_grid, sheet.axes(1, 0)
    most = float(signs.physical.max())
    image = _map(axis, grid, signs.physical, most)
    sheet.scale(axis, image, f"mean number of wrong signs, of {signs.pairs}")
    cells = grid.image(signs.physical)
    if min(cells.shape) > 1 and most > float(signs.physical.min()):
        lines = axis.contour(grid.x, grid.y, cells, 4, colors="white", linewidths=0.7)
        axis.clabel(lines, fontsize=7, fmt="%.2g")
    x, y = grid.nodes[signs.physical.argmax()]
    _mark(axis, (float(x), float(y)), "most")
    sheet.finish(axis, sign_words(found))


def _regions(sheet: _Sheet) -> None:
    """Draw how often each region is confused, and mark those that are ambiguous."""
    found, axis = sheet.found, sheet.axes(1, 1)
    a, raster = found.ambiguity, found.raster
    home = region_at(a.regions, raster.nodes)
    tried = np.nan_to_num(a.confusion)
    (left, bottom), (right, upper) = raster.bounds
    image = axis.imshow(
        raster.image(tried[home]),
        origin="lower",
        extent=(left, right, bottom, upper),
        cmap="cividis",
        vmin=0.0,
        vmax=max(LEAST_SCALE, float(tried.max())),
        interpolation="nearest",
    )
    axis.add_collection(LineCollection(raster.borders(home), colors="white", linewidths=0.5))
    sheet.scale(axis, image, "part of steps taken beyond the neighbours")
    kinds = ((a.tiny, "o", "tiny"), (a.doubled, "D", "double"), (a.confused, "X", "confused"))
    for which, mark, name in kinds:
        if which.any():
            shape: dict[str, Any] = {
                "markersize": 4.5,
                "markeredgecolor": INK,
                "markeredgewidth": 0.6,
            }
            axis.plot(*a.sources[which].T, mark, color=ORANGE, label=name, **shape)
    sheet.finish(axis, region_words(found))


def _sensors(sheet: _Sheet) -> None:
    """Draw each sensor as large as its contribution, and what would be better."""
    found, axis = sheet.found, sheet.axes(1, 2)
    layout, localizer = found.layout, found.settings.localizer
    rises = [without[localizer] for without in found.contributions] or [0.0] * len(layout.sensors)
    sizes = 50 + 550 * np.maximum(rises, 0.0) / max(*rises, 1e-9)
    axis.scatter(
        layout.positions[:, 0],
        layout.positions[:, 1],
        s=sizes,
        color=BLUE,
        alpha=0.75,
        edgecolor=INK,
    )
    axis.plot([], [], "o", color=BLUE, label="rise of mean error without it [m]")
    middle = (layout.outline.min(axis=0) + layout.outline.max(axis=0)) / 2
    for name, place, rise in zip(layout.sensors, layout.positions, rises, strict=True):
        text = f"{name} {rise:+.2f}" if found.contributions else name
        # beside walls names stand towards the middle
        far = place[0] - middle[0]
        aside = -np.sign(far) if abs(far) > BESIDE_WALL * float(np.ptp(layout.outline[:, 0])) else 0
        below = place[1] > middle[1]
        offset, align = (
            (9 * aside, -14 if below else 14),
            {1: "left", -1: "right", 0: "center"}[int(aside)],
        )
        at: dict[str, Any] = {"ha": align, "va": "top" if below else "bottom", "fontsize": 8.5}
        axis.annotate(text, place, offset, textcoords="offset points", **at)
    for advice in found.advice:
        _advice(axis, found, advice)
    said = [advice_words(found, advice) for advice in found.advice]
    sheet.finish(axis, "\n".join([contribution_words(found), *said]), sensors=False)


def _advice(axis: Axes, found: RoomAnalysis, advice: Advice) -> None:
    """Draw where one more sensor, or one moved, would do best."""
    mark, name = ("*", "one more") if advice.moved is None else ("P", "moved")
    shape: dict[str, Any] = {"markersize": 14, "markeredgecolor": INK, "linestyle": "", "zorder": 4}
    axis.plot(*advice.place, mark, color=ORANGE, label=name, **shape)
    if advice.moved is not None:
        start = found.layout.positions[advice.moved]
        arrow: dict[str, Any] = {
            "arrowstyle": "->",
            "color": ORANGE,
            "linewidth": 1.6,
            "shrinkB": 7,
        }
        axis.annotate("", advice.place, start, arrowprops=arrow)


def wrapped(text: str) -> str:
    """Return a title broken into lines that fit above a map."""
    import textwrap

    return "\n".join(part for line in text.split("\n") for part in textwrap.wrap(line, LINE))
