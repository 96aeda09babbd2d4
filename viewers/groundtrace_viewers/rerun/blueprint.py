"""The layout of a session: one function chooses the views from what was logged.

The layout is at the end of a file, when all that it shows is known. The native viewer finds it
there. A viewer that gets the file over a network has made a layout of its own by then, and keeps
it; so :func:`layout_of` takes the layout out of a file, and a page sends it before the data.
"""

from __future__ import annotations

from dataclasses import replace
from math import isinf
from typing import TYPE_CHECKING, Any, NamedTuple

from groundtrace_codecs.signals import NS_PER_S, SEISMIC_QUANTITIES

from ..errors import ViewerError
from .headings import DIAL_SIDE, HEADING, TURN
from .samples import FULL_RATE_HZ
from .shots import FAR_HIGH, FAR_WIDE, HIGH, WIDE
from .spectrogram import AROUND_S
from .stations import ROOT as HODOGRAM
from .stations import extent
from .timeline import APART, AXIS, FIRST_ROW, LANES, MOST_ROWS, PAGE, TIMELINE, lane_number
from .walk import ROOT as STREETS
from .waves import HIGH as WAVES_HIGH
from .waves import WIDE as WAVES_WIDE

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    import rerun.blueprint as rrb

    from groundtrace.pipeline.engine import ReplaySession

    from .timeline import Bounds, Entity

#: Component of a page.
TEXT = "TextDocument:text"
#: A view and its share of the height.
Part = tuple["rrb.View | rrb.Container", float]

ACCELERATIONS = ("acceleration", "acceleration_magnitude")
#: Quantities of worn sensors by row, and the rows' shares of the height.
ROWS = (
    (("acceleration",), 1.9),
    (("acceleration_magnitude",), 1.9),
    (("angular_velocity",), 1.5),
    (("magnetic_field", "pressure"), 1.5),
)
WORN = frozenset(quantity for row, _ in ROWS for quantity in row)
#: What is on the map of a walk in metres.
ON_MAP = frozenset({"latitude", "longitude"})
#: Parts of the window's height that the lanes' heading and each lane need.
LANE_HEADING, LANE = 0.08, 0.033
#: Of the height beside the time panel, a view that can be read: 100 of 690 pixels in a window of
#: 1280 x 720.
LEAST_ROW = 0.145
MOST_LANES, MOST_ON_ROAD = 8, 6
#: Share of texts below a map, and width of that column as a part of the window's height.
TEXTS, LEFT_WIDTH = 2.0, 0.8
#: Share of the decision at the cursor, above a map: in words alone, and with bars.
DECIDED = (0.9, 1.9)
#: The same of words and bars that have the width of their column.
DECIDED_ALONE = (1.0, 1.1)
#: What is shown before and after the cursor [s]: of shots, of footsteps on a floor, of a vehicle.
SHOT_S, FAST_S, ROAD_S = (0.05, 0.25), (0.02, 0.06), (0.5, 0.5)
SPECTRUM_S = (0.05, 0.25)
HEADING_S = 5.0
#: A walker's samples, and what a wrong step is decided on, to either side of the cursor: some six
#: steps [s].
STEPS_S = 4.0
#: Recordings up to this are seen whole at first, of longer ones so much to either side of the
#: cursor [s].
WHOLE_S, AROUND_CURSOR_S = 60, 30
#: Behind what is drawn in light colours, so that it is seen in a light theme too.
GROUND = (17, 19, 22, 255)


def blueprint(
    session: ReplaySession,
    entities: Sequence[Entity],
    shown: Bounds | None = None,
    *,
    follow: bool = False,
) -> rrb.Blueprint:
    """Return the layout of a session.

    Parameters
    ----------
    session
        What is replayed.
    entities
        What was logged: there is no view without an entity.
    shown
        What the map must show; None lets the viewer choose.
    follow
        True while data arrive: the cursor stays at the latest.
    """
    import rerun.blueprint as rrb

    if _of(entities, "section"):
        return _page(_shots(session, entities, shown), session, follow=follow)
    if _of(entities, "dial") and not _of(entities, "detector"):
        return _page(_headings(session, entities), session, follow=follow)
    mapped = bool(_of(entities, "map"))
    on_road = session.application == "vehicle"
    detail = [] if on_road else _detail(session, entities)
    overview = _overview(session, entities)
    most = MOST_ON_ROAD if on_road else MOST_LANES
    decided = _decided(entities, halves=mapped)
    if mapped:
        side = [*decided, *_map(session, shown, entities), *_texts(entities)]
        stack = overview + _lanes(entities, overview + detail, most) + detail
    elif decided and overview:  # what is wrong has the left, all signals the right
        side = [*decided, *_texts(entities)]
        stack = [*overview[:1], *detail, *overview[1:]]
        stack += _lanes(entities, stack, most)
    else:
        side = [*decided, *detail, *_texts(entities)]
        stack = overview + _lanes(entities, overview, most)
    columns = [_rows(side), _rows(stack)] if stack else [_rows(side)]
    shares = [2.2, 3.0] if mapped else [1.0, 1.7]
    whole_page = rrb.Horizontal(*columns, column_shares=shares[: len(columns)])
    return _page(whole_page, session, follow=follow)


def _page(content: rrb.Container, session: ReplaySession, *, follow: bool) -> rrb.Blueprint:
    """Return a layout of views, with nothing of the viewer's own beside it but the time."""
    import rerun.blueprint as rrb

    for view in _views(content):
        _grounded(view)
        if not follow:
            _opened(view, _shown_span(session))
    return rrb.Blueprint(
        content,
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


def _views(content: rrb.Container) -> Iterable[rrb.View]:
    """Yield all views of a layout."""
    import rerun.blueprint as rrb

    for part in content.contents:
        if isinstance(part, rrb.Container):
            yield from _views(part)
        elif isinstance(part, rrb.View):
            yield part


def _grounded(view: rrb.View) -> None:
    """Give a picture its dark ground in a light theme too: its colours are made for that."""
    import rerun.blueprint as rrb

    if isinstance(view, rrb.TimeSeriesView):
        view.properties["PlotBackground"] = rrb.archetypes.PlotBackground(color=GROUND)
    elif isinstance(view, rrb.Spatial2DView):
        view.properties["Background"] = rrb.archetypes.Background(
            kind=rrb.components.BackgroundKind.SolidColor, color=GROUND
        )


def _opened(view: rrb.View, span_ns: tuple[int, int]) -> None:
    """Say what a plot on the common axis shows at first.

    The viewer's own choice is half a minute to either side of the cursor, before the first sample
    too. Here that is all of a short recording; of a long one what there is of that half minute.
    """
    import rerun.blueprint as rrb

    axis = view.properties.get("TimeAxis")
    if not isinstance(axis, rrb.archetypes.TimeAxis) or not _is_linked(axis):
        return
    edge, around_ns = rrb.TimeRangeBoundary, NS_PER_S * AROUND_CURSOR_S
    first, last = (edge.absolute(nanos=t) for t in span_ns)
    if span_ns[1] - span_ns[0] > NS_PER_S * WHOLE_S:
        first, last = (edge.cursor_relative(nanos=t) for t in (-around_ns, around_ns))
    seen = rrb.VisibleTimeRange(TIMELINE, start=first, end=last)
    view.properties["VisibleTimeRanges"] = rrb.VisibleTimeRanges([seen])


def _is_linked(axis: rrb.TimeAxis) -> bool:
    import rerun.blueprint as rrb

    link = axis.link.as_arrow_array().to_pylist() if axis.link is not None else []
    return link == [rrb.components.LinkAxis.LinkToGlobal.value]


def _shots(
    session: ReplaySession, entities: Sequence[Entity], site: Bounds | None
) -> rrb.Container:
    """Show the shot at the cursor: its section beside travel times, words, and all shots."""
    import rerun.blueprint as rrb

    [section] = [section_view(e) for e in _of(entities, "section")]
    far: list[Any] = [travel_view(e) for e in _of(entities, "travel")]
    far += [view for view, _ in _map(session, site, entities)] if _of(entities, "map") else []
    texts: list[Any] = [text(e) for e in _of(entities, "shot")]
    tabs: list[Any] = [log("/log/shots", "Shots")] if far else []
    tabs += [log()] if _of(entities, "log") else []
    tabs += [table(e) for e in _of(entities, "table")]
    words = [*texts, rrb.Tabs(*tabs, page(), active_tab=0)]
    start_ns, end_ns = _shown_span(session)
    edge_ns = (end_ns - start_ns) // 100  # so that the first and last shot are clear of it
    span_ns = start_ns - edge_ns, end_ns + edge_ns
    rest: list[Any] = [full_span_view(e, span_ns) for e in _of(entities, "shots")]
    rest += [view for view, _ in _overview(session, entities)]
    rest += lanes_view(entities) if _of(entities, "lane") else []
    rest += [view for view, _ in _detail(session, entities)]
    parts: list[Part] = _parts(far, 4.6)
    parts.append((rrb.Horizontal(*words, column_shares=[5.0, 6.0][: len(words)]), 4.2))
    parts += _parts(rest, 1.9)
    return rrb.Horizontal(section, _rows(parts), column_shares=[1.05, 1.0])


def _headings(session: ReplaySession, entities: Sequence[Entity]) -> rrb.Container:
    """Show the heading at the cursor, and over the whole recording how far off it is, and why."""
    import rerun.blueprint as rrb

    span_ns = _shown_span(session)
    left: list[Part] = [(text(e), 1.7) for e in _of(entities, "card")]
    left += [(dial(e), 3.4) for e in _of(entities, "dial")]
    tabs: list[Any] = [log(), page()]
    left += _parts(tabs, 2.7)
    curves: list[Any] = [headings_view(_of(entities, "heading"))]
    right = _parts(curves, 2.6)
    plots = [*_of(entities, "heading-error"), *_of(entities, "heading-gates")]
    right += [(full_span_view(e, span_ns), 2.0) for e in plots]
    rest: list[Any] = lanes_view(entities, span_ns) if _of(entities, "lane") else []
    rest += [view for view, _ in _worn(entities)]
    right += _parts(rest, 1.8)
    return rrb.Horizontal(_rows(left), _rows(right), column_shares=[0.55, 1.0])


def _shown_span(session: ReplaySession) -> tuple[int, int]:
    """Return what is shown, since the first sample [ns]."""
    first, last = session.shown_ns or (session.start_ns, session.end_ns)
    return first - session.start_ns, last - session.start_ns


def _of(entities: Iterable[Entity], role: str) -> list[Entity]:
    return [e for e in entities if e.role == role]


def _rows(parts: Sequence[Part]) -> rrb.Vertical:
    import rerun.blueprint as rrb

    shares = legible_shares([share for _, share in parts])
    return rrb.Vertical(*[view for view, _ in parts], row_shares=shares)


def legible_shares(shares: Sequence[float]) -> list[float]:
    """Return shares of a height of which none is less than can be read; they add up to 1.

    What the small ones lack, the others give up in proportion.
    """
    least = min(LEAST_ROW, 1 / len(shares))
    raised: set[int] = set()
    while True:
        rest = sum(share for row, share in enumerate(shares) if row not in raised)
        left = 1.0 - least * len(raised)
        row_shares = [least if row in raised else left * s / rest for row, s in enumerate(shares)]
        small = {row for row, share in enumerate(row_shares) if share < least - 1e-12}
        if not small:
            return row_shares
        raised |= small


def _tabbed(shown: Sequence[rrb.View]) -> list[rrb.View | rrb.Container]:
    """Return views of one kind in one place: itself, or one tab each."""
    import rerun.blueprint as rrb

    return list(shown) if len(shown) < 2 else [rrb.Tabs(*shown, active_tab=0)]


def _parts(shown: Sequence[rrb.View], share: float) -> list[Part]:
    return [(view, share) for view in _tabbed(shown)]


def _texts(entities: Sequence[Entity]) -> list[Part]:
    tabs = [log(e.path, e.title) for e in _of(entities, "wrong")]
    tabs += [log()] if _of(entities, "log") or tabs else []
    tabs += [table(e) for e in _of(entities, "table")]
    tabs.append(page())
    of_step = [text(e) for e in _of(entities, "page")]
    of_step += [hodograms(e) for e in _of(entities, "hodogram")]
    if not of_step or _of(entities, "wrong"):  # the list of what is wrong needs the width
        return _parts([*tabs[:-1], *of_step, tabs[-1]], TEXTS)
    import rerun.blueprint as rrb

    halves = [*_tabbed(tabs), *_tabbed(of_step)]
    return [(rrb.Horizontal(*halves, column_shares=[1.15, 1.0]), TEXTS)]


def _map(session: ReplaySession, site: Bounds | None, entities: Sequence[Entity]) -> list[Part]:
    unit = session.geometry.length_unit if session.geometry is not None else "m"
    name = f"{'Way' if session.application == 'walker' else 'Site'} [{unit}]"
    wide = site is not None and (site.x[1] - site.x[0]) > 3.0 * (site.y[1] - site.y[0])
    shown = [site_view(site, entities, name)]
    shown += [streets_view(entities)] if _of(entities, "geo") else []
    if session.application == "vehicle" and site is not None:
        return _parts(shown, _share(site))
    return _parts(shown, 0.5 if wide else 3.0)


def _share(site: Bounds) -> float:
    """Return the share of a map beside a road, which may be narrow: texts have what it leaves."""
    height = LEFT_WIDTH * (site.y[1] - site.y[0]) / (site.x[1] - site.x[0])
    height = min(max(height, 0.25), 0.6)
    return TEXTS * height / (1.0 - height)


def _decided(entities: Sequence[Entity], *, halves: bool) -> list[Part]:
    """Show the decision at the cursor, where one is wrong: in words, and gate by gate.

    They stand in ``halves`` side by side where a map is below.
    """
    import rerun.blueprint as rrb

    shown: list[Any] = [text(e) for e in _of(entities, "card")]
    shown += [bars(e) for e in _of(entities, "bars")]
    if not shown:
        return []
    if not halves:
        return [(view, share) for view, share in zip(shown, DECIDED_ALONE, strict=False)]
    share = DECIDED[len(shown) - 1]
    return [(rrb.Horizontal(*shown, column_shares=[1.0, 1.1][: len(shown)]), share)]


def _overview(session: ReplaySession, entities: Sequence[Entity]) -> list[Part]:
    """Everything on the common time axis, from signals to decisions."""
    overview, finest = _of(entities, "overview"), _of(entities, "envelope")
    enveloped = [*overview, *map(_short, finest)] if overview else finest
    seismic = enveloped or [
        e for e in _of(entities, "signal") if e.quantity not in WORN and not _is_other(e)
    ]
    signals = [plot_view(e) for e in seismic]
    span_ns = _shown_span(session)
    signals += [full_span_view(_short(e), span_ns) for e in _of(entities, "whole")]
    if session.application == "vehicle":
        signals += [full_span_view(e, span_ns) for e in _of(entities, "rows")]
    tonal = [fixed(e, e.path, linked()) for e in _of(entities, "spectrogram")]
    follow = around(AROUND_S, AROUND_S)
    tonal += [fixed(e, e.path, follow) for e in _of(entities, "tones")]
    tonal += [fixed(e, e.path, around(*SPECTRUM_S)) for e in _of(entities, "spectrum")]
    margins = [bounded(e) for e in _of(entities, "margins")]
    decided = [_decision(e) for e in _of(entities, "detector")]
    if session.application == "walker" and _of(entities, "bars"):  # marks of minutes would crowd
        decided, margins = [_near(view) for view in decided], [_near(view) for view in margins]
    decisions = [*_parts(decided, 1.8), *_parts(margins, 1.8)]
    if session.application == "room":  # it has more plots than a small window has room for
        decisions = _parts([*margins, *decided], 1.8)
    if session.application == "shots":
        return [(view, 1.4) for view in (*signals, *tonal, *decided)] + _worn(entities)
    if session.application == "walker":
        return [*_walked(entities, [*signals, *tonal]), *decisions, *_believed(entities)]
    if session.application == "vehicle":
        fast = [e for e in _of(entities, "signal") if e.rate_hz > FULL_RATE_HZ]
        signals += [samples(e, (), ROAD_S) for e in fast]
        return [
            *_parts([*signals, *tonal[1:]], 1.3),
            *_parts(tonal[:1], 1.3),
            *_driven(entities, decisions),
        ]
    if session.application == "room" and _of(entities, "waves"):
        return [*_parts([*signals, *tonal], 1.9), *_worn(entities), *decisions]
    return [*_parts(signals, 1.9), *_worn(entities), *_parts(tonal, 1.9), *decisions]


def _short(entity: Entity) -> Entity:
    """Return an envelope under the title of a tab beside that of the same signal."""
    return replace(entity, title=entity.title.rpartition(": ")[2])


def _is_other(entity: Entity) -> bool:
    """Whether a signal is slow company: temperature, a position, ..."""
    return entity.quantity not in SEISMIC_QUANTITIES


def _worn(entities: Sequence[Entity]) -> list[Part]:
    signals = _of(entities, "signal")
    parts: list[Part] = []
    for row, share in ROWS:
        shown = [plot_view(e) for e in signals if e.quantity in row]
        parts += _parts(shown, share)
    others = [plot_view(e) for e in signals if e.quantity not in WORN and _is_other(e)]
    return parts + _parts(others, 1.0)


def _walked(entities: Sequence[Entity], others: Sequence[rrb.View]) -> list[Part]:
    """Show worn sensors: the acceleration, and the others behind tabs where there is much else."""
    signals = [e for e in _of(entities, "signal") if e.quantity in WORN or _is_other(e)]
    signals = [e for e in signals if e.quantity not in ON_MAP]
    signals.sort(key=lambda e: e.quantity not in ACCELERATIONS)
    worn = [plot_view(e) for e in signals]
    crowded = any(e.role in ("masses", "heading", "margins") for e in entities)
    first = [] if crowded else worn[:1]
    return [*_parts(first, 1.9), *_parts([*worn[len(first) :], *others], 1.9)]


def _believed(entities: Sequence[Entity]) -> list[Part]:
    """Show the masses of each source, and headings."""
    parts: list[Part] = [(masses(e), 1.5) for e in _of(entities, "masses")]
    headings = _of(entities, "heading")
    errors = [bounded(e) for e in _of(entities, "heading-error")]
    return [*parts, *_parts([headings_view(headings), *errors], 3.0)] if headings else parts


def _driven(entities: Sequence[Entity], decisions: Sequence[Part]) -> list[Part]:
    """Show powers, their ratios, and the way along the road."""
    ratios = _parts([plot_view(e) for e in _of(entities, "ratio")], 2.0)
    return [*decisions, *ratios, *((bounded(e), 2.6) for e in _of(entities, "road"))]


def _decision(entity: Entity) -> rrb.View:
    return fixed(entity, entity.path.removesuffix("/decision"), linked())


def _near(view: rrb.View) -> rrb.View:
    """Return a plot of the whole recording as one of what is about the cursor."""
    view.name = f"{view.name}, cursor ± {STEPS_S:g} s"
    return _followed(view, STEPS_S)


def _followed(view: rrb.View, span_s: float) -> rrb.View:
    """Let a plot show what there is to either side of the cursor [s], and nothing beyond the ends.

    An axis that is said shows so much whatever there is; one that is not fits what is in view.
    """
    import rerun.blueprint as rrb

    edge = rrb.TimeRangeBoundary
    first, last = (edge.cursor_relative(seconds=s) for s in (-span_s, span_s))
    view.properties["TimeAxis"] = rrb.TimeAxis(link=rrb.components.LinkAxis.Independent)
    seen = rrb.VisibleTimeRange(TIMELINE, start=first, end=last)
    view.properties["VisibleTimeRanges"] = rrb.VisibleTimeRanges([seen])
    return view


def _lanes(entities: Sequence[Entity], others: Sequence[Part], most: int) -> list[Part]:
    """Show the lanes, which need a fixed part of the height whatever else there is."""
    numbers = [lane_number(e.path) for e in _of(entities, "lane")]
    if not numbers:
        return []
    drawn = {number for number in numbers if number <= MOST_ROWS}
    rows = max(drawn) - min(drawn) + 1 if len(drawn) > len(BY_PLACE) else 0
    height = LANE_HEADING + LANE * max(min(len(numbers), most), rows)
    rest = sum(share for _, share in others) or 1.0
    return _parts(lanes_view(entities), rest * height / (1.0 - height))


def _detail(session: ReplaySession, entities: Sequence[Entity]) -> list[Part]:
    """Show samples around the cursor, of fast streams or the first acceleration, and rows."""
    application, span_ns = session.application, _shown_span(session)
    signals = _of(entities, "signal")
    fast = [e for e in signals if e.rate_hz > FULL_RATE_HZ]
    slow = [e for e in signals if e.quantity in ACCELERATIONS]
    span = SHOT_S if application == "shots" else FAST_S
    shown = [samples(e, _companions(e, entities), span) for e in fast]
    if not fast:
        shown = [worn_samples(e, _companions(e, entities)) for e in slow[:1]]
    decisions = [decision(e, span) for e in _of(entities, "decision")]
    shown += [full_span_view(e, span_ns) for e in _of(entities, "rows")]
    waves = [waves_view(e) for e in _of(entities, "waves")]
    if application == "room":  # it has more plots than a small window has room for
        return _parts([*waves, *shown, *decisions], 4.5 if waves else 2.6)
    return _parts(shown, 3.0 if application == "shots" else 2.4) + _parts(decisions, 2.3)


def _companions(signal: Entity, entities: Sequence[Entity]) -> list[Entity]:
    """Return the magnitude of a signal and the marks on its stream."""
    path = signal.path.removeprefix("/signals")
    norms = [e for e in _of(entities, "norm") if e.path == f"/norm{path}"]
    marks = [e for e in _of(entities, "mark") if f"{path}/".startswith(f"{_stream(e)}/")]
    return [*norms, *marks]


def _stream(mark: Entity) -> str:
    """Return the topic of a mark's path, ``/picks/TOPIC`` or ``/steps/TOPIC``."""
    return mark.path[mark.path.index("/", 1) :]


#: What a plot shows: its entity and those below it, and the axis that all have alike.
ALIGNED = ["$origin/**", AXIS]


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


def no_legend() -> rrb.PlotLegend:
    """Return no legend: it would hide what it explains; titles have the keys."""
    import rerun.blueprint as rrb

    return rrb.PlotLegend(visible=False)


def plot_view(entity: Entity) -> rrb.View:
    """Return curves on the common time axis."""
    import rerun.blueprint as rrb

    return rrb.TimeSeriesView(
        origin=entity.path,
        name=entity.title,
        axis_x=linked(),
        plot_legend=no_legend(),
        overrides=_drawn(entity),
    )


def full_span_view(entity: Entity, span_ns: tuple[int, int]) -> rrb.View:
    """Return curves over a span from end to end, since the first sample [ns]."""
    import rerun.blueprint as rrb

    return rrb.TimeSeriesView(
        origin=entity.path,
        name=entity.title,
        axis_x=end_to_end(span_ns),
        axis_y=rrb.ScalarAxis(range=(entity.bottom, entity.top)) if entity.top else None,
        plot_legend=no_legend(),
        overrides=_drawn(entity),
    )


def end_to_end(span_ns: tuple[int, int]) -> rrb.TimeAxis:
    """Return a time axis of its own over a span since the first sample [ns]."""
    import rerun.blueprint as rrb

    first, last = (rrb.TimeRangeBoundary.absolute(nanos=t) for t in span_ns)
    return rrb.TimeAxis(
        link=rrb.components.LinkAxis.Independent, view_range=rrb.TimeRange(start=first, end=last)
    )


def fixed(entity: Entity, origin: str, axis_x: rrb.TimeAxis) -> rrb.View:
    """Return a plot of an entity and its companions whose value axis ends where it says."""
    import rerun.blueprint as rrb

    return rrb.TimeSeriesView(
        origin=origin,
        contents=ALIGNED,
        name=entity.title,
        axis_x=axis_x,
        axis_y=rrb.ScalarAxis(range=(0.0, entity.top)) if entity.top else None,
        plot_legend=no_legend(),
    )


def samples(entity: Entity, companions: Sequence[Entity], span_s: tuple[float, float]) -> rrb.View:
    """Return every sample around the cursor, with what belongs to it.

    Parameters
    ----------
    entity
        The signal.
    companions
        Curves and marks of the same stream.
    span_s
        How much is shown before and after the cursor [s].
    """
    import rerun.blueprint as rrb

    before, after = span_s
    span = f"± {after:g} s" if before == after else f"−{before:g} to +{after:g} s"
    return rrb.TimeSeriesView(
        origin="/",
        contents=[entity.path, *(e.path for e in companions)],
        name=_sampled(entity, companions, span),
        axis_x=around(before, after),
        plot_legend=no_legend(),
        overrides=_drawn(entity),
    )


def worn_samples(entity: Entity, companions: Sequence[Entity]) -> rrb.View:
    """Return every sample of a worn sensor around the cursor, as far as what is decided on it."""
    view = samples(entity, companions, (STEPS_S, STEPS_S))
    return _followed(view, STEPS_S)


def _sampled(entity: Entity, companions: Sequence[Entity], span: str) -> str:
    """Return the title of samples: which curve is which stands at its end."""
    what, unit, key = entity.title.partition("]")
    norm = ", magnitude white" if any(e.role == "norm" for e in companions) else ""
    return f"{what}{unit}, cursor {span}{key}{norm}"


def _drawn(entity: Entity) -> dict[Any, Any] | None:
    """Return what draws curves that are no scalars; None of those that are."""
    return {entity.path: _mapped(entity.component)} if entity.component else None


def _mapped(component: str) -> rrb.Visualizer:
    """Return what draws curves that are no scalars."""
    import rerun as rr
    import rerun.blueprint as rrb

    source = rrb.encodings.ComponentSourceKind.SourceComponent
    mapping = rrb.encodings.VisualizerComponentMapping
    scalars = rr.Scalars.descriptor_scalars().component
    return rr.SeriesLines().visualizer(
        mappings=[mapping(scalars, source, source_component=component)]
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
        plot_legend=no_legend(),
    )


def bounded(entity: Entity) -> rrb.View:
    """Return curves between values that are known."""
    import rerun.blueprint as rrb

    return rrb.TimeSeriesView(
        origin=entity.path,
        contents=ALIGNED,
        name=entity.title,
        axis_x=linked(),
        axis_y=rrb.ScalarAxis(range=(entity.bottom, entity.top)),
        plot_legend=no_legend(),
    )


def masses(entity: Entity) -> rrb.View:
    """Return the masses of candidates, from 0 to 1 and a little room for those at the edge."""
    import rerun.blueprint as rrb

    return rrb.TimeSeriesView(
        origin=entity.path,
        contents=ALIGNED,
        name=entity.title,
        axis_x=linked(),
        axis_y=rrb.ScalarAxis(range=(-0.06, entity.top + 0.06)),
        plot_legend=no_legend(),
    )


def headings_view(entities: Sequence[Entity]) -> rrb.View:
    """Return the headings of all stages around the cursor."""
    import rerun.blueprint as rrb

    curves = ", ".join(e.title for e in entities)

    view = rrb.TimeSeriesView(
        origin=HEADING,
        contents=ALIGNED,
        name=f"Heading [°], cursor ± {HEADING_S:g} s: {curves}",
        axis_y=rrb.ScalarAxis(range=(-TURN, TURN)),
        plot_legend=no_legend(),
    )
    return _followed(view, HEADING_S)


def dial(entity: Entity) -> rrb.View:
    """Return the dial of the heading at the cursor."""
    import rerun.blueprint as rrb

    return rrb.Spatial2DView(
        origin=entity.path,
        name=entity.title,
        visual_bounds=rrb.VisualBounds2D(
            x_range=(-DIAL_SIDE, DIAL_SIDE), y_range=(-DIAL_SIDE, DIAL_SIDE)
        ),
    )


def bars(entity: Entity) -> rrb.View:
    """Return the gates of the candidate at the cursor as bars."""
    import rerun.blueprint as rrb

    return rrb.Spatial2DView(
        origin=entity.path,
        name=entity.title,
        visual_bounds=rrb.VisualBounds2D(
            x_range=(-150.0, 150.0), y_range=(-16.0, entity.top + 16.0)
        ),
    )


def section_view(entity: Entity) -> rrb.View:
    """Return the record section of the shot at the cursor."""
    import rerun.blueprint as rrb

    return rrb.Spatial2DView(
        origin=entity.path,
        name=entity.title,
        visual_bounds=rrb.VisualBounds2D(x_range=(-12.0, WIDE + 3.0), y_range=(-18.0, HIGH + 4.0)),
    )


def waves_view(entity: Entity) -> rrb.View:
    """Return the waves of the step at the cursor."""
    import rerun.blueprint as rrb

    return rrb.Spatial2DView(
        origin=entity.path,
        name=entity.title,
        visual_bounds=rrb.VisualBounds2D(
            x_range=(-24.0, WAVES_WIDE + 24.0), y_range=(2.0, WAVES_HIGH + 8.0)
        ),
    )


def travel_view(entity: Entity) -> rrb.View:
    """Return travel times over distance."""
    import rerun.blueprint as rrb

    return rrb.Spatial2DView(
        origin=entity.path,
        name=entity.title,
        visual_bounds=rrb.VisualBounds2D(
            x_range=(-14.0, FAR_WIDE + 4.0), y_range=(-FAR_HIGH - 6.0, 13.0)
        ),
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


def lanes_view(
    entities: Sequence[Entity], span_ns: tuple[int, int] | None = None
) -> list[rrb.View]:
    """Return the lanes as a plot that lines up with the others, and by their names.

    Parameters
    ----------
    entities
        What was logged.
    span_ns
        What is shown, since the first sample [ns]; None stands for that of the common axis.
    """
    import rerun.blueprint as rrb

    axis = linked() if span_ns is None else end_to_end(span_ns)
    states = rrb.StateTimelineView(origin="/state", name="States and truth", time_view=axis)
    paths = [e.path for e in _of(entities, "lane") if lane_number(e.path) <= MOST_ROWS]
    if not paths:
        return [states]
    names: dict[int, list[str]] = {}
    for path in paths:
        number = lane_number(path)
        name = path.removeprefix(f"/state/{number}-").partition("/")[0]
        names.setdefault(number, []).append(name)
    rows = {int(FIRST_ROW) - n: ", ".join(dict.fromkeys(names[n])) for n in sorted(names)}
    true = {e.path.rpartition("truth/step/")[2] for e in _of(entities, "row")}
    keys = {"score": "score, missed red, false pink"}
    keys |= {"truth": "truth, a foot unknown violet"} if "step" in true else {}
    keys |= {"truth": "truth, left blue, right orange"} if true & {"left", "right"} else {}
    rows = {height: keys.get(text, text) for height, text in rows.items()}
    below = min(FIRST_ROW - n - APART * (len(lane_names) - 1) for n, lane_names in names.items())
    plot = rrb.TimeSeriesView(
        origin=LANES,
        contents=ALIGNED,
        name=_lane_names(rows),
        axis_x=axis,
        axis_y=rrb.ScalarAxis(range=(below - 0.5, max(rows) + 0.5)),
        plot_legend=no_legend(),
    )
    return [plot, states]


#: Lanes are numbered where there are more than these.
BY_PLACE = ("above: ", "below: ")


def _lane_names(rows: Mapping[int, str]) -> str:
    """Return which lane is which: by number, or of two, whose numbers have no room, by place."""
    where = [f"{height} " for height in rows]
    if len(rows) <= len(BY_PLACE):
        where = list(BY_PLACE) if len(rows) == len(BY_PLACE) else [""]
    return " · ".join(f"{prefix}{text}" for prefix, text in zip(where, rows.values(), strict=True))


def log(origin: str = "/log", name: str = "Events") -> rrb.View:
    """Return the log; a click on the time of a line moves the cursor there."""
    import rerun.blueprint as rrb

    kinds = rrb.encodings.TextLogColumnKind
    columns = rrb.archetypes.TextLogColumns(
        timeline_columns=[rrb.encodings.TimelineColumn(TIMELINE, visible=True)],
        text_log_columns=[kinds.LogLevel, kinds.Body],
    )
    return rrb.TextLogView(origin=origin, name=name, columns=columns)


def table(entity: Entity) -> rrb.View:
    """Return a table that scrolls to the cursor."""
    import rerun.blueprint as rrb

    query = rrb.archetypes.DataframeQuery(timeline=TIMELINE, auto_scroll=True)
    return rrb.DataframeView(origin=entity.path, name=entity.title, query=query)


def page() -> rrb.View:
    """Return the page that says how to read all this."""
    import rerun.blueprint as rrb

    return rrb.TextDocumentView(origin=PAGE, name="About")


def site_view(
    bounds: Bounds | None, entities: Sequence[Entity], name: str = "Site [m]"
) -> rrb.View:
    """Return the map under a name."""
    import rerun.blueprint as rrb

    return rrb.Spatial2DView(
        origin="/map",
        name=name,
        # The view's y points down.
        visual_bounds=rrb.VisualBounds2D(x_range=bounds.x, y_range=(-bounds.y[1], -bounds.y[0]))
        if bounds is not None
        else None,
        overrides=_seen(entities, "map"),
    )


def streets_view(entities: Sequence[Entity]) -> rrb.View:
    """Return the street map, whose tiles the viewer loads from the internet."""
    import rerun.blueprint as rrb

    return rrb.MapView(
        origin=STREETS,
        name="Street map",
        zoom=17.0,
        background=rrb.components.MapProvider.OpenStreetMap,
        overrides=_seen(entities, "geo"),
    )


def _seen(entities: Iterable[Entity], role: str) -> dict[Any, rrb.VisibleTimeRanges]:
    """Return what of a map is seen after its time: all before the cursor, or of some seconds."""
    import rerun.blueprint as rrb

    edge, ranges = rrb.TimeRangeBoundary, {}
    for e in _of(entities, role):
        if e.visible_s:
            ever = isinf(e.visible_s)
            start = edge.infinite() if ever else edge.cursor_relative(seconds=-e.visible_s)
            seen = rrb.VisibleTimeRange(TIMELINE, start=start, end=edge.cursor_relative(seconds=0))
            ranges[e.path] = rrb.VisibleTimeRanges([seen])
    return ranges


def layout_of(rrd: Path) -> bytes:
    """Return a file of the viewer that holds nothing but the layout of another.

    Raises
    ------
    ViewerError
        Where the file has no layout, or is not one of the viewer's.
    """
    import rerun as rr
    import rerun_bindings as bindings

    try:
        reader = rr.chunk.RrdReader(str(rrd))
        layouts, recordings = reader.blueprints(), reader.recordings()
    except (OSError, RuntimeError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise ViewerError(f"{rrd.name}: expected a viewer's file, found: {reason}") from error
    if not layouts or not recordings:
        raise ViewerError(f"{rrd.name}: expected a recording and its layout, found none")
    layout, shown = layouts[-1], recordings[0]
    # As Blueprint.save() makes it, whose layouts are objects; this one is chunks of a file.
    copy = rr.RecordingStream._from_native(
        bindings.new_blueprint(
            application_id=shown.application_id,
            make_default=False,
            make_thread_default=False,
            default_enabled=True,
        )
    )
    memory = rr.memory_recording(copy)
    rr.send_chunks(reader.store(store=layout).stream(), recording=copy)
    target = rr.RecordingStream(
        shown.application_id, recording_id=shown.recording_id, send_properties=False
    )
    binary = rr.binary_stream(target)
    bindings.send_blueprint(memory.storage, True, True, recording=target.to_native())
    return binary.read() or b""


class FileIdentity(NamedTuple):
    """What a viewer's file says of itself: whose it is, and its page."""

    recording_id: str
    page: str


def file_identity(rrd: Path) -> FileIdentity | None:
    """Return what a viewer's file says of itself; None where it is none, or has no page."""
    import rerun as rr

    try:
        reader = rr.chunk.RrdReader(str(rrd))
        recordings = reader.recordings()
        chunks = reader.stream().filter(content=PAGE) if recordings else ()
        for chunk in chunks:
            batch = chunk.to_record_batch()
            if TEXT in batch.schema.names:
                [page] = batch.column(TEXT).to_pylist()[0]
                return FileIdentity(recordings[0].recording_id, page)
    except (OSError, RuntimeError, ValueError):
        pass
    return None
