"""The layout: one function chooses the views of a session from what was logged."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from groundtrace_codecs.signals import SEISMIC_QUANTITIES

from . import views
from .full_rate import FULL_RATE_HZ
from .spectrogram import AROUND_S
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
LANE_HEADING, LANE = 0.065, 0.048
MOST_LANES, MOST_ON_ROAD = 8, 6
#: Share of texts below a map, and width of that column as a part of the window's height.
TEXTS, LEFT_WIDTH = 2.0, 0.8
#: What is shown before and after the cursor [s]: of shots, of footsteps on a floor, of a walker,
#: of a vehicle.
SHOT_S, FAST_S, SLOW_S, ROAD_S = (0.05, 0.25), (0.02, 0.06), (2.0, 2.0), (0.5, 0.5)
SPECTRUM_S = (0.05, 0.25)


def blueprint(
    session: Session,
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

    mapped = bool(_of(entities, "map"))
    on_road = session.application == "vehicle"
    detail = [] if on_road else _detail(session.application, entities, legend=not mapped)
    below = detail if mapped else []
    overview = _overview(session, entities)
    most = MOST_ON_ROAD if on_road else MOST_LANES
    stack = overview + _lanes(entities, overview + below, most) + below
    side = (_map(session, shown, entities) if mapped else detail) + _texts(entities)
    columns = [_rows(side), _rows(stack)] if stack else [_rows(side)]
    shares = [2.2, 3.0] if mapped else [1.0, 2.0]
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


def _tabbed(shown: Sequence[rrb.View]) -> list[rrb.View | rrb.Container]:
    """Return views of one kind in one place: itself, or one tab each."""
    import rerun.blueprint as rrb

    return list(shown) if len(shown) < 2 else [rrb.Tabs(*shown, active_tab=0)]


def _parts(shown: Sequence[rrb.View], share: float) -> list[Part]:
    return [(view, share) for view in _tabbed(shown)]


def _texts(entities: Sequence[Entity]) -> list[Part]:
    tabs = [views.log()] if _of(entities, "log") else []
    tabs += [views.table(e) for e in _of(entities, "table")]
    tabs.append(views.page())
    of_step = [views.text(e) for e in _of(entities, "page")]
    of_step += [views.hodograms(e) for e in _of(entities, "hodogram")]
    if not of_step:
        return _parts(tabs, TEXTS)
    import rerun.blueprint as rrb

    halves = [*_tabbed(tabs), *_tabbed(of_step)]
    return [(rrb.Horizontal(*halves, column_shares=[1.15, 1.0]), TEXTS)]


def _map(session: Session, site: Bounds | None, entities: Sequence[Entity]) -> list[Part]:
    unit = session.geometry.length_unit if session.geometry is not None else "m"
    name = f"{'Way' if session.application == 'walker' else 'Site'} [{unit}]"
    wide = site is not None and (site.x[1] - site.x[0]) > 3.0 * (site.y[1] - site.y[0])
    shown = [views.site(site, entities, name)]
    shown += [views.streets()] if _of(entities, "geo") else []
    if session.application == "vehicle" and site is not None:
        return _parts(shown, _share(site))
    return _parts(shown, 0.5 if wide else 3.0)


def _share(site: Bounds) -> float:
    """Return the share of a map beside a road, which may be narrow: texts have what it leaves."""
    height = LEFT_WIDTH * (site.y[1] - site.y[0]) / (site.x[1] - site.x[0])
    height = min(max(height, 0.25), 0.6)
    return TEXTS * height / (1.0 - height)


def _overview(session: Session, entities: Sequence[Entity]) -> list[Part]:
    """Everything on the common time axis, from signals to decisions."""
    overview, finest = _of(entities, "overview"), _of(entities, "envelope")
    enveloped = [*overview, *map(_short, finest)] if overview else finest
    seismic = enveloped or [
        e for e in _of(entities, "signal") if e.quantity not in WORN and not _is_other(e)
    ]
    named = session.application != "vehicle" or not _of(entities, "map")
    signals = [views.plot(e, legend_shown=named) for e in seismic]
    shown_ns = session.shown_ns or (session.start_ns, session.end_ns)
    span_ns = shown_ns[0] - session.start_ns, shown_ns[1] - session.start_ns
    signals += [views.whole(_short(e), span_ns) for e in _of(entities, "whole")]
    tonal = [views.fixed(e, e.path, views.linked()) for e in _of(entities, "spectrogram")]
    follow = views.around(AROUND_S, AROUND_S)
    tonal += [views.fixed(e, e.path, follow) for e in _of(entities, "tones")]
    tonal += [views.fixed(e, e.path, views.around(*SPECTRUM_S)) for e in _of(entities, "spectrum")]
    decisions = _parts([_decision(e) for e in _of(entities, "detector")], 1.8)
    if session.application == "shots":
        return [*_parts([*signals, *tonal], 1.4), *_worn(entities), *decisions]
    if session.application == "walker":
        return [*_walked(entities, [*signals, *tonal]), *decisions, *_believed(entities)]
    if session.application == "vehicle":
        fast = [e for e in _of(entities, "signal") if e.rate_hz > FULL_RATE_HZ]
        signals += [views.samples(e, (), ROAD_S, 0) for e in fast]
        return [
            *_parts([*signals, *tonal[1:]], 1.3),
            *_parts(tonal[:1], 1.3),
            *_driven(entities, decisions),
        ]
    return [*_parts(signals, 2.0), *_worn(entities), *_parts(tonal, 1.9), *decisions]


def _short(entity: Entity) -> Entity:
    """Return an envelope under the title of a tab beside that of the same signal."""
    return replace(entity, title=entity.title.rpartition(": ")[2])


def _is_other(entity: Entity) -> bool:
    """Whether a signal is slow company: temperature, a position, ..."""
    return entity.quantity not in SEISMIC_QUANTITIES


def _worn(entities: Sequence[Entity]) -> list[Part]:
    signals = _of(entities, "signal")
    parts: list[Part] = []
    # The colours of the axes stand in the legend of the samples around the cursor.
    legend = not any(e.quantity in ACCELERATIONS for e in signals)
    for row, share in ROWS:
        shown = [views.plot(e, legend_shown=legend) for e in signals if e.quantity in row]
        parts += _parts(shown, share)
    others = [views.plot(e) for e in signals if e.quantity not in WORN and _is_other(e)]
    return parts + _parts(others, 1.0)


def _walked(entities: Sequence[Entity], others: Sequence[rrb.View]) -> list[Part]:
    """Show worn sensors: the acceleration, and the others behind tabs where there is much else."""
    signals = [e for e in _of(entities, "signal") if e.quantity in WORN or _is_other(e)]
    signals = [e for e in signals if e.quantity not in ON_MAP]
    signals.sort(key=lambda e: e.quantity not in ACCELERATIONS)
    worn = [views.plot(e) for e in signals]
    crowded = any(e.role in ("masses", "heading") for e in entities)
    first = [] if crowded else worn[:1]
    return [*_parts(first, 1.9), *_parts([*worn[len(first) :], *others], 1.9)]


def _believed(entities: Sequence[Entity]) -> list[Part]:
    """Show the masses of each source, and headings."""
    parts: list[Part] = [(views.masses(e), 1.5) for e in _of(entities, "masses")]
    headings = _of(entities, "heading")
    return [*parts, (views.headings(headings), 3.0)] if headings else parts


def _driven(entities: Sequence[Entity], decisions: Sequence[Part]) -> list[Part]:
    """Show powers, their ratios, and the way along the road."""
    ratios = _parts([views.plot(e, legend_shown=False) for e in _of(entities, "ratio")], 2.0)
    return [*decisions, *ratios, *((views.road(e), 2.6) for e in _of(entities, "road"))]


def _decision(entity: Entity) -> rrb.View:
    return views.fixed(entity, entity.path.removesuffix("/decision"), views.linked())


def _lanes(entities: Sequence[Entity], others: Sequence[Part], most: int) -> list[Part]:
    """Show the lanes, which need a fixed part of the height whatever else there is."""
    lanes = len(_of(entities, "lane"))
    if not lanes:
        return []
    height = LANE_HEADING + LANE * min(lanes, most)
    rest = sum(share for _, share in others) or 1.0
    return [(views.lanes(), rest * height / (1.0 - height))]


def _detail(application: str, entities: Sequence[Entity], *, legend: bool) -> list[Part]:
    """Show the samples around the cursor: fast streams, else the first acceleration."""
    signals = _of(entities, "signal")
    fast = [e for e in signals if e.rate_hz > FULL_RATE_HZ]
    slow = [e for e in signals if e.quantity in ACCELERATIONS]
    most = 12 if legend else 0
    sections = [
        views.fixed(e, e.path.removesuffix("/traces"), views.around(*SHOT_S))
        for e in _of(entities, "section")
    ]
    span = SHOT_S if application == "shots" else FAST_S
    shown = [
        views.samples(e, _companions(e, entities), around, most)
        for e, around in [(e, span) for e in fast] or [(e, SLOW_S) for e in slow[:1]]
    ]
    parts = _parts([*sections, *shown], 6.0 if sections else 3.0)
    decisions = [views.decision(e, span) for e in _of(entities, "decision")]
    return parts + _parts(decisions, 2.3)


def _companions(signal: Entity, entities: Sequence[Entity]) -> list[Entity]:
    """Return the magnitude of a signal and the marks on its stream."""
    path = signal.path.removeprefix("/signals")
    norms = [e for e in _of(entities, "norm") if e.path == f"/norm{path}"]
    marks = [e for e in _of(entities, "mark") if f"{path}/".startswith(f"{_stream(e)}/")]
    return [*norms, *marks]


def _stream(mark: Entity) -> str:
    """Return the topic of a mark's path, ``/picks/TOPIC`` or ``/steps/TOPIC``."""
    return mark.path[mark.path.index("/", 1) :]
