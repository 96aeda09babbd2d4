"""The layout: one function chooses the views of a session from what was logged."""

from __future__ import annotations

from typing import TYPE_CHECKING

from groundtrace_codecs.signals import SEISMIC_QUANTITIES

from .about import PAGE
from .sensor_map import ARRIVALS, FOOTFALLS, PATH, bounds
from .signals import FULL_RATE_HZ
from .timeline import TIMELINE

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    import rerun.blueprint as rrb

    from groundtrace.sinks import Session

    from .sensor_map import Bounds
    from .timeline import Entity

#: A view and its share of the height.
Part = tuple["rrb.View | rrb.Container", float]

ACCELERATIONS = ("acceleration", "acceleration_magnitude")
#: Quantities of worn sensors that get a row of their own, in this order.
ROWS = (*ACCELERATIONS, "angular_velocity", "magnetic_field", "pressure")
#: Parts of the window's height that the lanes' heading and each lane need.
LANE_HEADING, LANE = 0.07, 0.05
#: More curves than this would hide the plot behind its own legend.
LEGEND_CURVES = 4


def blueprint(
    session: Session, entities: Sequence[Entity], *, follow: bool = False
) -> rrb.Blueprint:
    """Return the layout of a session.

    Parameters
    ----------
    session
        What is replayed.
    entities
        What was logged: there is no view without an entity.
    follow
        True while data arrive: the cursor stays at the latest.
    """
    import rerun.blueprint as rrb

    site = bounds(session) if _of(entities, "map") else None
    detail = _detail(entities, legend=site is None)
    below = detail if site else []
    overview = _overview(entities)
    stack = overview + _lanes(entities, overview + below) + below
    side = (_map(site, entities) if site else detail) + _texts(entities)
    columns = [_rows(side), _rows(stack)] if stack else [_rows(side)]
    shares = [2.0, 3.0] if site else [1.0, 2.0]
    return rrb.Blueprint(
        rrb.Horizontal(*columns, column_shares=shares[: len(columns)]),
        rrb.TimePanel(
            state="collapsed",
            timeline=TIMELINE,
            play_state="following" if follow else "paused",
            playback_speed=0.5,
            loop_mode="off",
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )


def _of(entities: Iterable[Entity], role: str) -> list[Entity]:
    return [e for e in entities if e.role == role]


def _rows(parts: Sequence[Part]) -> rrb.Vertical:
    import rerun.blueprint as rrb

    return rrb.Vertical(*[view for view, _ in parts], row_shares=[share for _, share in parts])


def _tabbed(views: Sequence[rrb.View]) -> list[rrb.View | rrb.Container]:
    """Return views of one kind in one place: itself, or one tab each."""
    import rerun.blueprint as rrb

    return list(views) if len(views) < 2 else [rrb.Tabs(*views, active_tab=0)]


def _texts(entities: Sequence[Entity]) -> list[Part]:
    import rerun.blueprint as rrb

    tabs: list[rrb.View] = []
    if _of(entities, "log"):
        tabs.append(_log())
    query = rrb.archetypes.DataframeQuery(timeline=TIMELINE, auto_scroll=True)
    tabs += [
        rrb.DataframeView(origin=e.path, name=e.title, query=query) for e in _of(entities, "table")
    ]
    tabs.append(rrb.TextDocumentView(origin=PAGE, name="About"))
    return [(rrb.Tabs(*tabs, active_tab=0), 2.0)]


def _log() -> rrb.View:
    import rerun.blueprint as rrb

    kinds = rrb.encodings.TextLogColumnKind
    columns = rrb.archetypes.TextLogColumns(
        timeline_columns=[rrb.encodings.TimelineColumn(TIMELINE, visible=False)],
        text_log_columns=[kinds.LogLevel, kinds.Body],
    )
    return rrb.TextLogView(origin="/log", name="Events", columns=columns)


def _map(site: Bounds, entities: Sequence[Entity]) -> list[Part]:
    import rerun.blueprint as rrb

    until = {PATH: None, FOOTFALLS: -3.0, ARRIVALS: -0.25}
    logged = {e.path for e in entities}
    wide = (site.x[1] - site.x[0]) > 3.0 * (site.y[1] - site.y[0])
    view = rrb.Spatial2DView(
        origin="/map",
        name="Site [m]",
        # The view's y points down.
        visual_bounds=rrb.VisualBounds2D(x_range=site.x, y_range=(-site.y[1], -site.y[0])),
        overrides={path: _before(s) for path, s in until.items() if path in logged},
    )
    return [(view, 1.0 if wide else 3.0)]


def _before(seconds: float | None) -> rrb.VisibleTimeRanges:
    """Show what lies before the cursor: all, or since some seconds before it."""
    import rerun.blueprint as rrb

    edge = rrb.TimeRangeBoundary
    start = edge.infinite() if seconds is None else edge.cursor_relative(seconds=seconds)
    end = edge.cursor_relative(seconds=0)
    return rrb.VisibleTimeRanges([rrb.VisibleTimeRange(TIMELINE, start=start, end=end)])


def _linked() -> rrb.TimeAxis:
    import rerun.blueprint as rrb

    return rrb.TimeAxis(link=rrb.components.LinkAxis.LinkToGlobal)


def _around(seconds: float) -> rrb.TimeAxis:
    import rerun.blueprint as rrb

    edge = rrb.TimeRangeBoundary
    window = rrb.TimeRange(
        start=edge.cursor_relative(seconds=-seconds), end=edge.cursor_relative(seconds=seconds)
    )
    return rrb.TimeAxis(link=rrb.components.LinkAxis.Independent, view_range=window)


def _legend(curves: int, most: int = LEGEND_CURVES) -> rrb.PlotLegend:
    import rerun.blueprint as rrb

    return rrb.PlotLegend(rrb.Corner2D.RightTop, visible=1 < curves <= most)


def _plot(entity: Entity, *, legend: bool = True) -> rrb.View:
    import rerun.blueprint as rrb

    return rrb.TimeSeriesView(
        origin=entity.path,
        name=entity.title,
        axis_x=_linked(),
        plot_legend=_legend(entity.series, LEGEND_CURVES if legend else 0),
    )


def _overview(entities: Sequence[Entity]) -> list[Part]:
    """Everything on the common time axis, from signals to decisions."""
    seismic = _of(entities, "envelope") or [
        e for e in _of(entities, "signal") if e.quantity not in ROWS and not _is_other(e)
    ]
    parts: list[Part] = [(view, 2.0) for view in _tabbed([_plot(e) for e in seismic])]
    parts += _worn(entities)
    parts += [(view, 2.0) for view in _tabbed([_bands(e) for e in _of(entities, "spectrogram")])]
    parts += [(view, 1.7) for view in _tabbed([_decision(e) for e in _of(entities, "detector")])]
    return parts


def _is_other(entity: Entity) -> bool:
    """Whether a signal is slow company: temperature, a position, ..."""
    return entity.quantity not in SEISMIC_QUANTITIES


def _worn(entities: Sequence[Entity]) -> list[Part]:
    signals = _of(entities, "signal")
    parts: list[Part] = []
    for quantity in ROWS:
        # The colours of the axes stand in the legend of the samples around the cursor.
        legend = not any(e.quantity in ACCELERATIONS for e in signals)
        views = [_plot(e, legend=legend) for e in signals if e.quantity == quantity]
        share = 1.7 if quantity.startswith("acceleration") else 1.2
        parts += [(view, share) for view in _tabbed(views)]
    others = [_plot(e) for e in signals if e.quantity not in ROWS and _is_other(e)]
    return parts + [(view, 1.0) for view in _tabbed(others)]


def _bands(entity: Entity) -> rrb.View:
    import rerun.blueprint as rrb

    return rrb.TimeSeriesView(
        origin=entity.path,
        name=entity.title,
        axis_x=_linked(),
        axis_y=rrb.ScalarAxis(range=(0.0, entity.top)),
        plot_legend=rrb.PlotLegend(visible=False),
    )


def _decision(entity: Entity) -> rrb.View:
    import rerun.blueprint as rrb

    return rrb.TimeSeriesView(
        origin=entity.path.removesuffix("/decision"),
        name=entity.title,
        axis_x=_linked(),
        plot_legend=rrb.PlotLegend(visible=False),
    )


def _lanes(entities: Sequence[Entity], others: Sequence[Part]) -> list[Part]:
    """Show the lanes, which need a fixed part of the height whatever else there is."""
    import rerun.blueprint as rrb

    lanes = len(_of(entities, "lane"))
    if not lanes:
        return []
    view = rrb.StateTimelineView(origin="/state", name="States and truth", time_view=_linked())
    height = LANE_HEADING + LANE * min(lanes, 6)
    rest = sum(share for _, share in others) or 1.0
    return [(view, rest * height / (1.0 - height))]


def _detail(entities: Sequence[Entity], *, legend: bool) -> list[Part]:
    """Show the samples around the cursor: fast streams, else the first acceleration."""
    import rerun.blueprint as rrb

    signals = _of(entities, "signal")
    fast = [e for e in signals if e.rate_hz > FULL_RATE_HZ]
    slow = [e for e in signals if e.quantity in ACCELERATIONS]
    marks = [e.path for e in _of(entities, "mark")]
    views = [
        rrb.TimeSeriesView(
            origin="/",
            contents=[e.path, *marks],
            name=f"{e.title}: every sample, cursor ± {seconds:g} s",
            axis_x=_around(seconds),
            plot_legend=_legend(e.series, 12 if legend else 0),
        )
        for e, seconds in [(e, 0.25) for e in fast] or [(e, 2.0) for e in slow[:1]]
    ]
    return [(view, 2.5) for view in _tabbed(views)]
