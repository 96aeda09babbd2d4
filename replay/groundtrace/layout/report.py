"""The analysis of a layout as one document, in words and as a figure.

The figure is a PNG, drawn by matplotlib. Its colours are told apart by colour-blind people: viridis
and cividis rise evenly in lightness.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely

from ..pipeline.results import atomic_write
from ..runtime import unconfigured
from .analysis import MIRRORED, SMALL_M, region_at

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage
    from numpy.typing import NDArray

    from .analysis import Advice, ErrorMap, Grid, Layout, RoomAnalysis

    Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SensorReport:
    """A sensor, and by how much the mean error rises without it [m]; None with three sensors."""

    name: str
    x_m: float
    y_m: float
    contribution_m: dict[str, float] | None


@dataclass(frozen=True, slots=True)
class ErrorReport:
    """Root mean square errors of a localizer over the room [m]."""

    localizer: str
    mean_m: float
    p95_m: float
    max_m: float
    worst_x_m: float
    worst_y_m: float
    below_1_m: float
    rmse_m: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class SignReport:
    """Wrong signs: their mean number over the room, and the law at the worst place."""

    mean: float
    max: float
    x_m: float
    y_m: float
    variance_there: float
    most_of_95_percent: int


@dataclass(frozen=True, slots=True)
class RegionReport:
    """A region, the rival it is most like, and how often it is taken for one beyond neighbours."""

    x_m: float
    y_m: float
    area_m2: float
    rival: int | None
    rival_signs: int | None
    rival_m: float | None
    confusion: float | None
    ambiguous: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class AdviceReport:
    """A change of the layout, and the mean errors without and with it [m]."""

    change: str
    sensor: str | None
    x_m: float
    y_m: float
    localizer: str
    before_m: dict[str, float]
    after_m: dict[str, float]
    better: bool
    places_tried: int


@dataclass(frozen=True, slots=True)
class RoomReport:
    """All that is known of a layout."""

    geometry: str
    sigma_s: float
    theta_s: float
    thickness_m: float | None
    area_m2: float
    lattice: int
    draws: int
    seed: int
    x_m: tuple[float, ...]
    y_m: tuple[float, ...]
    sensors: tuple[SensorReport, ...]
    errors: tuple[ErrorReport, ...]
    pairs: int
    signs_physical: SignReport
    signs_independent: SignReport
    regions: tuple[RegionReport, ...]
    advice: tuple[AdviceReport, ...]
    remarks: tuple[str, ...]


def report(analysis: RoomAnalysis) -> RoomReport:
    """Return an analysis as a document; numbers of its arrays stand in the order of its nodes."""
    layout, how, signs = analysis.layout, analysis.settings, analysis.signs
    independent = (signs.independent, signs.variance_independent, signs.most_independent)
    x, y = (tuple(axis.tolist()) for axis in analysis.grid.nodes.T)
    return RoomReport(
        layout.name,
        layout.sigma_s,
        layout.theta_s,
        layout.thickness_m,
        float(shapely.area(layout.room)),
        how.lattice,
        how.draws,
        how.seed,
        x,
        y,
        _sensors(analysis),
        tuple(_errors(analysis, errors) for errors in analysis.errors),
        signs.pairs,
        _signs(analysis, signs.physical, signs.variance, signs.most),
        _signs(analysis, *independent),
        tuple(_region(analysis, i) for i in range(len(analysis.ambiguity.regions))),
        tuple(_advice(analysis, advice) for advice in analysis.advice),
        analysis.remarks,
    )


def _sensors(analysis: RoomAnalysis) -> tuple[SensorReport, ...]:
    spared = analysis.contributions or (None,) * len(analysis.layout.sensors)
    rows = zip(analysis.layout.sensors, analysis.layout.positions.tolist(), spared, strict=True)
    return tuple(SensorReport(name, x, y, without) for name, (x, y), without in rows)


def _errors(analysis: RoomAnalysis, errors: ErrorMap) -> ErrorReport:
    rmse = errors.rmse_m
    return ErrorReport(
        errors.method,
        errors.mean_m,
        float(np.quantile(rmse, 0.95)),
        float(rmse.max()),
        *analysis.worst(errors),
        float(np.mean(rmse < SMALL_M)),
        tuple(rmse.tolist()),
    )


def _signs(analysis: RoomAnalysis, mean: np.ndarray, variance: float, most: int) -> SignReport:
    x, y = analysis.sign_grid.nodes[mean.argmax()]
    return SignReport(float(mean.mean()), float(mean.max()), float(x), float(y), variance, most)


def _region(analysis: RoomAnalysis, index: int) -> RegionReport:
    a = analysis.ambiguity
    (x, y), rival = a.regions.centres[index], int(a.rival[index])
    confusion = float(a.confusion[index])
    return RegionReport(
        float(x),
        float(y),
        float(a.regions.areas[index]),
        rival if rival >= 0 else None,
        round(float(a.rival_signs[index])) if rival >= 0 else None,
        float(a.rival_m[index]) if rival >= 0 else None,
        confusion if np.isfinite(confusion) else None,
        a.reasons(index),
    )


def _advice(analysis: RoomAnalysis, advice: Advice) -> AdviceReport:
    moved = None if advice.moved is None else analysis.layout.sensors[advice.moved]
    return AdviceReport(
        "add" if moved is None else "move",
        moved,
        *advice.position,
        advice.method,
        advice.before_m,
        advice.after_m,
        advice.gain_m > 0,
        advice.tried,
    )


#: Localizers as people write them.
NAMES = {"so-tdoa": "SO-TDOA", "hyperbolic": "hyperbolic", "power-law": "power law"}
#: A change counts where the mean error falls by more than this part of it.
WORTH = 0.02


def assumed(layout: Layout) -> str:
    """Return what was assumed of the floor and of the arrivals."""
    floor = "a = 183 m²/s" if layout.thickness_m is None else f"{layout.thickness_m:g} m thick"
    return (
        f"{len(layout.sensors)} sensors, arrivals ± {layout.sigma_s * 1e3:g} ms each, "
        f"theta {layout.theta_s:g} s, floor {floor}"
    )


def error_words(analysis: RoomAnalysis, errors: ErrorMap) -> str:
    """Return what an error map says."""
    x, y = analysis.worst(errors)
    small = float(np.mean(errors.rmse_m < SMALL_M))
    return (
        f"{NAMES[errors.method]}: mean {errors.mean_m:.2f} m, worst {errors.rmse_m.max():.2f} m "
        f"at ({x:.1f}, {y:.1f}); {small:.0%} of the room below {SMALL_M:g} m"
    )


def sign_words(analysis: RoomAnalysis) -> str:
    """Return what the map of wrong signs says."""
    signs = analysis.signs
    x, y = analysis.sign_grid.nodes[signs.physical.argmax()]
    return (
        f"wrong signs of {signs.pairs}: mean {signs.physical.mean():.2f}, worst "
        f"{signs.physical.max():.2f} at ({x:.1f}, {y:.1f}), where 95 % of steps have at most "
        f"{signs.most}"
    )


def region_words(analysis: RoomAnalysis) -> str:
    """Return which regions are ambiguous."""
    a = analysis.ambiguity
    total, areas = len(a.regions), a.regions.areas
    parts = [
        f"{int(which.sum())} {text} ({areas[which].sum() / areas.sum():.1%} of the area)"
        for which, text in (
            (a.tiny, "tiny"),
            (a.doubled, "like one far away"),
            (a.confused, "mostly taken for one beyond their neighbours"),
        )
        if which.any()
    ]
    if MIRRORED in analysis.remarks:
        parts.insert(0, "all the same on both sides of the sensors' line")
    ambiguities = ", ".join(parts) if parts else "none ambiguous"
    if np.isnan(a.confusion).all():
        return f"{total} regions: {ambiguities}; too many to try each"
    return (
        f"{total} regions: {ambiguities}; confused "
        f"{np.average(a.confusion, weights=areas):.1%} of steps"
    )


def contribution_words(analysis: RoomAnalysis) -> str:
    """Return which sensors count most and least."""
    if not analysis.contributions:
        return "no sensor can be spared: three are needed to locate"
    rises = [without[analysis.settings.localizer] for without in analysis.contributions]
    most, least = int(np.argmax(rises)), int(np.argmin(rises))
    names = analysis.layout.sensors
    return (
        f"{names[most]} counts most (without it {NAMES[analysis.settings.localizer]} "
        f"{rises[most]:+.2f} m), {names[least]} least ({rises[least]:+.2f} m)"
    )


def advice_words(analysis: RoomAnalysis, advice: Advice) -> str:
    """Return what a change gains."""
    x, y = advice.position
    before, after = advice.before_m[advice.method], advice.after_m[advice.method]
    if advice.moved is None:
        what, verb = "one more sensor", "add one"
    else:
        what = f"moving {analysis.layout.sensors[advice.moved]}"
        verb = f"move {analysis.layout.sensors[advice.moved]}"
    means = f"mean error of {NAMES[advice.method]} {before:.2f} to {after:.2f} m"
    if advice.gain_m <= WORTH * before:
        return f"{what} gains little: best at ({x:.1f}, {y:.1f}), {means}"
    return f"{verb} to ({x:.1f}, {y:.1f}): {means} ({-advice.gain_m / before:+.0%})"


def findings(analysis: RoomAnalysis) -> list[str]:
    """Return all findings, one a line."""
    return [
        *(error_words(analysis, errors) for errors in analysis.errors),
        sign_words(analysis),
        region_words(analysis),
        contribution_words(analysis),
        *(advice_words(analysis, advice) for advice in analysis.advice),
    ]


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


def save(analysis: RoomAnalysis, path: Path, mark: str) -> None:
    """Write the figure.

    Parameters
    ----------
    analysis
        The analysis.
    path
        The PNG to write.
    mark
        What its metadata says of where it comes from.
    """
    # without pyplot there is no window and no state that figures share
    with atomic_write(path) as fresh:
        room_figure(analysis).savefig(fresh, metadata={"Description": mark})


def room_figure(analysis: RoomAnalysis) -> Figure:
    """Return the figure: three error maps over wrong signs, regions, and sensors."""
    sheet = _Sheet(analysis)
    top = max(float(errors.rmse_m.max()) for errors in analysis.errors)
    for column, errors in enumerate(analysis.errors):
        axis = sheet.axes(0, column)
        image = _map(axis, analysis.grid, errors.rmse_m, top)
        sheet.scale(axis, image, "RMS error [m]")
        _mark(axis, analysis.worst(errors), "worst")
        sheet.finish(axis, error_words(analysis, errors))
    _draw_signs(sheet)
    _regions(sheet)
    _draw_sensors(sheet)
    return sheet.figure


class _Sheet:
    """Two rows of three maps of equal scale, each with room for a title, a scale and a key."""

    def __init__(self, analysis: RoomAnalysis) -> None:
        with unconfigured():
            from matplotlib.backends.backend_agg import FigureCanvasAgg
            from matplotlib.figure import Figure

        self.analysis = analysis
        every = np.vstack([analysis.layout.outline, analysis.layout.positions])
        low, high = every.min(axis=0), every.max(axis=0)
        pad = PAD * float((high - low).max())
        self._low, self._high = low - pad, high + pad
        sides = self._high - self._low
        self._map_in = MAP_IN * sides / sides.max()
        self._rows_in = [above + float(self._map_in[1]) + BELOW_IN for above in ABOVE_IN]
        size = (3 * COLUMN_IN, sum(self._rows_in) + HEAD_IN)
        self.figure = Figure(size, DPI, facecolor="white")
        FigureCanvasAgg(self.figure)
        head = f"{analysis.layout.name}: {assumed(analysis.layout)}"
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
        layout = self.analysis.layout
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
        legend: dict[str, Any] = {
            "loc": "upper left",
            "bbox_to_anchor": (-0.02, below),
            "borderaxespad": 0.0,
        }
        axis.legend(**legend, ncols=4, fontsize=8, frameon=False, columnspacing=1.2)


def _map(axis: Axes, grid: Grid, values: Array, top: float) -> AxesImage:
    """Draw values of the nodes."""
    (left, bottom), (right, upper) = grid.bounds
    extent = (left, right, bottom, upper)
    cells = grid.image(values)
    return axis.imshow(cells, origin="lower", extent=extent, cmap="viridis", vmin=0.0, vmax=top)


def _mark(axis: Axes, position: tuple[float, float], name: str) -> None:
    axis.plot(*position, "x", color=ORANGE, markersize=10, markeredgewidth=2.5, label=name)


def _draw_signs(sheet: _Sheet) -> None:
    analysis = sheet.analysis
    signs, grid, axis = analysis.signs, analysis.sign_grid, sheet.axes(1, 0)
    most = float(signs.physical.max())
    image = _map(axis, grid, signs.physical, most)
    sheet.scale(axis, image, f"mean number of wrong signs, of {signs.pairs}")
    cells = grid.image(signs.physical)
    if min(cells.shape) > 1 and most > float(signs.physical.min()):
        lines = axis.contour(grid.x, grid.y, cells, 4, colors="white", linewidths=0.7)
        axis.clabel(lines, fontsize=7, fmt="%.2g")
    x, y = grid.nodes[signs.physical.argmax()]
    _mark(axis, (float(x), float(y)), "most")
    sheet.finish(axis, sign_words(analysis))


def _regions(sheet: _Sheet) -> None:
    """Draw how often each region is confused, and mark those that are ambiguous."""
    from matplotlib.collections import LineCollection

    analysis, axis = sheet.analysis, sheet.axes(1, 1)
    a, raster = analysis.ambiguity, analysis.raster
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
    sheet.finish(axis, region_words(analysis))


def _draw_sensors(sheet: _Sheet) -> None:
    """Draw each sensor as large as its contribution, and what would be better."""
    analysis, axis = sheet.analysis, sheet.axes(1, 2)
    layout, localizer = analysis.layout, analysis.settings.localizer
    rises = [without[localizer] for without in analysis.contributions] or [0.0] * len(
        layout.sensors
    )
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
    for name, position, rise in zip(layout.sensors, layout.positions, rises, strict=True):
        text = f"{name} {rise:+.2f}" if analysis.contributions else name
        # beside walls names stand towards the middle
        far = position[0] - middle[0]
        aside = -np.sign(far) if abs(far) > BESIDE_WALL * float(np.ptp(layout.outline[:, 0])) else 0
        below = position[1] > middle[1]
        offset, align = (
            (9 * aside, -14 if below else 14),
            {1: "left", -1: "right", 0: "center"}[int(aside)],
        )
        at: dict[str, Any] = {"ha": align, "va": "top" if below else "bottom", "fontsize": 8.5}
        axis.annotate(text, position, offset, textcoords="offset points", **at)
    for advice in analysis.advice:
        _draw_advice(axis, analysis, advice)
    advice_lines = [advice_words(analysis, advice) for advice in analysis.advice]
    sheet.finish(axis, "\n".join([contribution_words(analysis), *advice_lines]), sensors=False)


def _draw_advice(axis: Axes, analysis: RoomAnalysis, advice: Advice) -> None:
    """Draw where one more sensor, or one moved, would do best."""
    mark, name = ("*", "one more") if advice.moved is None else ("P", "moved")
    shape: dict[str, Any] = {"markersize": 14, "markeredgecolor": INK, "linestyle": "", "zorder": 4}
    axis.plot(*advice.position, mark, color=ORANGE, label=name, **shape)
    if advice.moved is not None:
        start = analysis.layout.positions[advice.moved]
        arrow: dict[str, Any] = {
            "arrowstyle": "->",
            "color": ORANGE,
            "linewidth": 1.6,
            "shrinkB": 7,
        }
        axis.annotate("", advice.position, start, arrowprops=arrow)


def wrapped(text: str) -> str:
    """Return a title broken into lines that fit above a map."""
    import textwrap

    return "\n".join(part for line in text.split("\n") for part in textwrap.wrap(line, LINE))
