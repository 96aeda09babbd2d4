"""Single views of the layout: how an entity is drawn, whatever stands beside it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .about import PAGE
from .disagreements import LINES as DISAGREEMENTS
from .fixes import CROSS_ELLIPSES, CROSSES, ELLIPSES, POINTS
from .growing_line import RUNS, SEGMENTS_S
from .headings import HEADING
from .hodogram import ROOT as HODOGRAM
from .hodogram import extent
from .pass_log import CROSSINGS
from .sensor_map import ARRIVALS
from .street_map import FIXES
from .street_map import ROOT as STREETS
from .timeline import TIMELINE
from .tracks import LINES
from .truth_map import FOOTFALLS, PATH
from .walk_map import SATELLITES

if TYPE_CHECKING:
    from collections.abc import Sequence

    import rerun.blueprint as rrb

    from .sensor_map import Bounds
    from .timeline import Entity

#: More curves than this would hide the plot behind its own legend.
LEGEND_CURVES = 4
#: Parts of what is below these on the map that it shows: all, or since so many seconds.
VISIBLE_S = {
    PATH: -SEGMENTS_S,
    FOOTFALLS: -3.0,
    ARRIVALS: -0.25,
    POINTS: -3.0,
    ELLIPSES: -0.5,
    DISAGREEMENTS: -0.5,
    LINES: -SEGMENTS_S,
    CROSSES: -12.0,
    CROSS_ELLIPSES: -1.0,
    CROSSINGS: -10.0,
    SATELLITES: None,
    f"{SATELLITES}/lines": -SEGMENTS_S,
}


def linked() -> rrb.TimeAxis:
    """Return the time axis that all overview plots share."""
    import rerun.blueprint as rrb

    return rrb.TimeAxis(link=rrb.components.LinkAxis.LinkToGlobal)


def around(before_s: float, after_s: float) -> rrb.TimeAxis:
    """Return a time axis that follows the cursor."""
    import rerun.blueprint as rrb

    edge = rrb.TimeRangeBoundary
    window = rrb.TimeRange(
        start=edge.cursor_relative(seconds=-before_s), end=edge.cursor_relative(seconds=after_s)
    )
    return rrb.TimeAxis(link=rrb.components.LinkAxis.Independent, view_range=window)


def legend(curves: int, most: int = LEGEND_CURVES) -> rrb.PlotLegend:
    """Return a legend that is shown for several, but not too many curves."""
    import rerun.blueprint as rrb

    return rrb.PlotLegend(rrb.Corner2D.RightTop, visible=1 < curves <= most)


def plot(entity: Entity, *, legend_shown: bool = True) -> rrb.View:
    """Return curves on the common time axis."""
    import rerun.blueprint as rrb

    return rrb.TimeSeriesView(
        origin=entity.path,
        name=entity.title,
        axis_x=linked(),
        plot_legend=legend(entity.series, LEGEND_CURVES if legend_shown else 0),
    )


def whole(entity: Entity, span_ns: tuple[int, int]) -> rrb.View:
    """Return curves over a span from end to end, since the first sample [ns]."""
    import rerun.blueprint as rrb

    first, last = (rrb.TimeRangeBoundary.absolute(nanos=t) for t in span_ns)
    axis = rrb.TimeAxis(
        link=rrb.components.LinkAxis.Independent, view_range=rrb.TimeRange(start=first, end=last)
    )
    return rrb.TimeSeriesView(
        origin=entity.path,
        name=entity.title,
        axis_x=axis,
        plot_legend=legend(entity.series),
    )


def fixed(entity: Entity, origin: str, axis_x: rrb.TimeAxis) -> rrb.View:
    """Return a plot of an entity and its companions whose value axis ends where it says."""
    import rerun.blueprint as rrb

    return rrb.TimeSeriesView(
        origin=origin,
        name=entity.title,
        axis_x=axis_x,
        axis_y=rrb.ScalarAxis(range=(0.0, entity.top)) if entity.top else None,
        plot_legend=rrb.PlotLegend(visible=False),
    )


def samples(
    entity: Entity, companions: Sequence[Entity], span_s: tuple[float, float], most: int
) -> rrb.View:
    """Return every sample around the cursor, with what belongs to it.

    Parameters
    ----------
    entity
        The signal.
    companions
        Curves and marks of the same stream.
    span_s
        How much is shown before and after the cursor [s].
    most
        Most curves with a legend.
    """
    import rerun.blueprint as rrb

    before, after = span_s
    span = f"± {after:g} s" if before == after else f"−{before:g} to +{after:g} s"
    return rrb.TimeSeriesView(
        origin="/",
        contents=[entity.path, *(e.path for e in companions)],
        name=f"{entity.title}: every sample, cursor {span}",
        axis_x=around(before, after),
        plot_legend=legend(entity.series, most),
    )


def decision(entity: Entity, span_s: tuple[float, float]) -> rrb.View:
    """Return a picker's decision function around the cursor, with its threshold."""
    import rerun.blueprint as rrb

    threshold = f"/detector{entity.path.removeprefix('/decision')}/threshold"
    return rrb.TimeSeriesView(
        origin="/",
        contents=[entity.path, threshold],
        name=entity.title,
        axis_x=around(*span_s),
        axis_y=rrb.ScalarAxis(range=(0.0, entity.top)) if entity.top else None,
        plot_legend=rrb.PlotLegend(visible=False),
    )


def road(entity: Entity) -> rrb.View:
    """Return the way along a road over time."""
    import rerun.blueprint as rrb

    return rrb.TimeSeriesView(
        origin=entity.path,
        name=entity.title,
        axis_x=linked(),
        axis_y=rrb.ScalarAxis(range=(entity.bottom, entity.top)),
        plot_legend=rrb.PlotLegend(visible=False),
    )


def masses(entity: Entity) -> rrb.View:
    """Return the masses of candidates, from 0 to 1 and a little room for those at the edge."""
    import rerun.blueprint as rrb

    return rrb.TimeSeriesView(
        origin=entity.path,
        name=entity.title,
        axis_x=linked(),
        axis_y=rrb.ScalarAxis(range=(-0.06, entity.top + 0.06)),
        plot_legend=rrb.PlotLegend(visible=False),
    )


def headings(entities: Sequence[Entity]) -> rrb.View:
    """Return the headings of all stages."""
    import rerun.blueprint as rrb

    curves = ", ".join(e.title for e in entities)

    return rrb.TimeSeriesView(
        origin=HEADING,
        name=f"Heading [°], counter-clockwise from east, ± 1 σ: {curves}; disturbed shaded",
        axis_x=linked(),
        plot_legend=rrb.PlotLegend(visible=False),
    )


def hodograms(entity: Entity) -> rrb.View:
    """Return the hodograms of all stations."""
    import rerun.blueprint as rrb

    across, up = extent(entity.series)
    return rrb.Spatial2DView(
        origin=HODOGRAM,
        name=entity.title,
        visual_bounds=rrb.VisualBounds2D(x_range=across, y_range=(-up[1], -up[0])),
    )


def text(entity: Entity) -> rrb.View:
    """Return a page that changes over time."""
    import rerun.blueprint as rrb

    return rrb.TextDocumentView(origin=entity.path, name=entity.title)


def lanes() -> rrb.View:
    """Return the state lanes on the common time axis."""
    import rerun.blueprint as rrb

    return rrb.StateTimelineView(origin="/state", name="States and truth", time_view=linked())


def log() -> rrb.View:
    """Return the log, without its time column: the lines begin with the time."""
    import rerun.blueprint as rrb

    kinds = rrb.encodings.TextLogColumnKind
    columns = rrb.archetypes.TextLogColumns(
        timeline_columns=[rrb.encodings.TimelineColumn(TIMELINE, visible=False)],
        text_log_columns=[kinds.LogLevel, kinds.Body],
    )
    return rrb.TextLogView(origin="/log", name="Events", columns=columns)


def table(entity: Entity) -> rrb.View:
    """Return a table that scrolls to the cursor."""
    import rerun.blueprint as rrb

    query = rrb.archetypes.DataframeQuery(timeline=TIMELINE, auto_scroll=True)
    return rrb.DataframeView(origin=entity.path, name=entity.title, query=query)


def page() -> rrb.View:
    """Return the page that says how to read all this."""
    import rerun.blueprint as rrb

    return rrb.TextDocumentView(origin=PAGE, name="About")


def site(bounds: Bounds | None, entities: Sequence[Entity], name: str = "Site [m]") -> rrb.View:
    """Return the map under a name."""
    import rerun.blueprint as rrb

    logged = [e.path for e in entities]
    return rrb.Spatial2DView(
        origin="/map",
        name=name,
        # The view's y points down.
        visual_bounds=rrb.VisualBounds2D(x_range=bounds.x, y_range=(-bounds.y[1], -bounds.y[0]))
        if bounds is not None
        else None,
        overrides={
            path: _before(None if path.endswith(f"/{RUNS}") else seconds)
            for path in logged
            for part, seconds in VISIBLE_S.items()
            if path == part or path.startswith(part + "/")
        },
    )


def streets() -> rrb.View:
    """Return the street map, whose tiles the viewer loads from the internet."""
    import rerun.blueprint as rrb

    return rrb.MapView(
        origin=STREETS,
        name="Street map",
        zoom=17.0,
        background=rrb.components.MapProvider.OpenStreetMap,
        overrides={FIXES: _before(None)},
    )


def _before(seconds: float | None) -> rrb.VisibleTimeRanges:
    """Show what lies before the cursor: all, or since some seconds before it."""
    import rerun.blueprint as rrb

    edge = rrb.TimeRangeBoundary
    start = edge.infinite() if seconds is None else edge.cursor_relative(seconds=seconds)
    end = edge.cursor_relative(seconds=0)
    return rrb.VisibleTimeRanges([rrb.VisibleTimeRange(TIMELINE, start=start, end=end)])
