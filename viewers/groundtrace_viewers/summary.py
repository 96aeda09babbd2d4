"""The summary of a result: one page with figures that opens in any browser and prints well."""

from __future__ import annotations

from html import escape
from itertools import pairwise
from typing import TYPE_CHECKING

from groundtrace.score.html_parts import (
    STYLE,
    figure,
    folded,
    section,
    shown,
    table,
    tiles,
    warned,
)
from groundtrace_codecs.signals import NS_PER_S

from .summary_figures import interval_plot, pick_plot, place_map, steps_plot, tolerance_plot
from .summary_rows import event_table, fact_rows, mark_table, pick_table, step_table, wrong_table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from groundtrace.score import TrackScore

    from .share_sources import Sources
    from .summary_rows import Row

POLICY = "default-src 'none'; style-src 'unsafe-inline'"
#: What the score's page does not need: links, and tables longer than a screen.
MORE_STYLE = """
nav{display:flex;flex-wrap:wrap;gap:6px 22px;margin-top:12px}
nav a,td a{color:var(--result)}
.long{max-height:430px;overflow:auto;border:1px solid var(--rule);border-radius:8px;padding:0 14px}
.long .scroll{margin:0;overflow:visible}.long table{width:100%}
.long :is(th,td):not(:last-child){white-space:nowrap}
.long thead th{position:sticky;top:0;background:var(--paper)}
.facts td:first-child{color:var(--soft);white-space:nowrap}
@media print{.long{max-height:none;border:0;padding:0}nav{display:none}}
"""
#: A table of more rows scrolls by itself.
LONG = 12
TRUTH_COLUMN = (
    "Column truth: how long after the true step it was found, or false; empty where nothing is "
    "scored."
)
Link = tuple[str, str]


def summary_page(sources: Sources, shown_signals: str, links: Sequence[Link] = ()) -> str:
    """Return the summary as HTML; it runs no script, asks nobody for anything, names no folder.

    Parameters
    ----------
    sources
        What is shared.
    shown_signals
        What of the signals the replay beside it shows.
    links
        Name and address of what lies beside it.
    """
    parts = [
        _figures_of_merit(sources),
        _plots(sources),
        _wrong(sources),
        _decisions(sources),
        _marks(sources),
        _facts(sources, shown_signals),
    ]
    named = "".join(f'<a href="{escape(to)}">{escape(name)}</a>' for name, to in links)
    nav = f"<nav>{named}</nav>" if named else ""
    said = escape(f"{_duration(sources)} through {sources.config.name}")
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(sources.name)}: summary</title>"
        f"<style>{STYLE}{MORE_STYLE}</style></head>\n<body><main>"
        f'<header><p class="brand">groundtrace summary</p><h1>{escape(sources.name)}</h1>'
        f'<p class="sub">{said}</p>{warned(sources.results.warnings)}{nav}</header>\n'
        f"{''.join(parts)}</main></body></html>\n"
    )


def _duration(sources: Sources) -> str:
    origin = sources.results.provenance
    return f"{(origin.end_ns - origin.start_ns) / NS_PER_S:.1f} s"


def _figures_of_merit(sources: Sources) -> str:
    """Return the score in tiles, each with the level of chance or what it rests on."""
    score, unit = sources.score, _unit(sources)
    items = _found_tiles(sources)
    if score.steps is not None and score.steps.truth:
        s = score.steps
        chance = f"by chance {s.chance_f1:.2f}, blind metronome {s.chance_f1_metronome:.2f}"
        wrong = f"{s.truth - s.matched} missed, {s.detected - s.matched} false"
        outside = len(sources.said.steps) - s.detected
        wrong += f"; {outside} found where nothing is scored" if outside else ""
        items.append(("F1 of steps", f"{s.f1:.3f}", chance))
        items.append(("Steps right", f"{s.matched} of {s.truth}", wrong))
        if s.latency_ms is not None:
            late = f"{s.latency_ms.median:+.0f} ms"
            items.append(("Latency", late, f"median; IQR {s.latency_ms.iqr:.0f} ms"))
    if score.picks is not None:
        e = score.picks.all
        remark = f"{e.answered} of {e.truth} within 50 ms"
        items.append(("Arrivals answered", f"{e.answered_fraction:.1%}", remark))
        items.append(("Median error", shown(e.median_abs_ms, "ms"), "of answered arrivals"))
    if score.positions is not None and score.positions.n:
        p = score.positions
        remark = f"{p.n} of {p.truth} places; half within {shown(p.cep50_m, unit, 3)}"
        items.append(("Place, RMSE", shown(p.rmse_m, unit, 3), remark))
    if score.track is not None:
        items += _track_tiles(score.track, unit, free=sources.free)
    if score.heading is not None:
        h = score.heading
        remark = f"at {h.n} of {h.truth} headings; bias {shown(h.bias_deg, 'deg', 1, sign=True)}"
        items.append(("Heading, RMSE", shown(h.rmse_deg, "deg", 1), remark))
    if score.disturbance is not None:
        d = score.disturbance
        if d.f1 is None:
            alarm = f"{d.false_alarm_s:.1f} s"
            items.append(("False alarm of disturbances", alarm, "truth has no disturbed span"))
        else:
            items.append(("F1 of disturbances", f"{d.f1:.3f}", f"{d.truth_s:.1f} s are disturbed"))
    remark = "" if sources.scored else "<p>No truth in the recording: nothing is scored.</p>"
    return section("Result", tiles(items) + remark)


def _track_tiles(track: TrackScore, unit: str, *, free: bool) -> list[tuple[str, str, str]]:
    """Return how good a track is; of one that heads anywhere its shape and its end."""
    closure = track.closure
    if not free or closure is None:
        remark = f"OSPA, cut off at {track.cutoff_m:g} {unit}"
        return [("Track", shown(track.ospa_m, unit), remark)]
    way = f"of {closure.walked_m:.0f} {unit} walked, between start and end"
    return [
        ("Shape of the track", shown(closure.aligned_rmse_m, unit), "RMSE, truth turned onto it"),
        ("Closure", f"{closure.percent:.2f} %", way),
    ]


def _found_tiles(sources: Sources) -> list[tuple[str, str, str]]:
    """Return how much was found, whatever the truth."""
    said = sources.said
    walking = sorted(step.time_ns for step in said.steps)
    items = [("Recorded", _duration(sources), _streams(sources))]
    if walking:
        apart = sorted(b - a for a, b in pairwise(walking))
        usual = f"usually {apart[len(apart) // 2] / NS_PER_S:.2f} s apart" if apart else ""
        items.append(("Steps found", str(len(walking)), usual))
    elif said.picks:
        channels = len({pick.channel for pick in said.picks})
        items.append(("Arrivals found", str(len(said.picks)), f"on {channels} channels"))
    return items


def _streams(sources: Sources) -> str:
    count = len(sources.streams)
    return {0: "", 1: "1 stream"}.get(count, f"{count} streams")


def _unit(sources: Sources) -> str:
    geometry = sources.results.geometry
    return "m" if geometry is None else geometry.length_unit


def _plots(sources: Sources) -> str:
    """Return the figures: places, chance, and every step in time."""
    side = []
    drawn = place_map(sources)
    if drawn is not None:
        side.append(figure("Places", drawn.svg, drawn.caption, **drawn.keys))
    curve = tolerance_plot(sources)
    if curve is not None:
        side.append(figure("Steps and chance", curve.svg, curve.caption, **curve.keys))
    apart = interval_plot(sources)
    if apart is not None and len(side) < 2:
        side.append(figure("Rhythm", apart.svg, apart.caption, **apart.keys))
    below = ""
    steps = steps_plot(sources)
    if steps is not None:
        below = figure("Every step", steps.svg, steps.caption, **steps.keys)
    picks = None if sources.said.steps else pick_plot(sources)
    if picks is not None:
        below += figure("Errors of arrivals", picks.svg, picks.caption, **picks.keys)
    if not side and not below:
        return ""
    return section("Figures", f'<div class="pair">{"".join(side)}</div>{below}')


def _long(header: Row, rows: Sequence[Row]) -> str:
    """Return a table; a long one scrolls by itself, but is printed whole."""
    drawn = table("", header, rows)
    return f'<div class="long">{drawn}</div>' if len(rows) > LONG else drawn


def _wrong(sources: Sources) -> str:
    misses = sources.moments.misses
    if not sources.moments.truth:
        return ""
    if not misses:
        return section("Wrong decisions", "<p>None within the tolerance.</p>")
    return section(f"Wrong decisions: {len(misses)}", _long(*wrong_table(misses)))


def _decisions(sources: Sources) -> str:
    said, start_ns = sources.said, sources.results.provenance.start_ns
    if said.steps:
        header, rows = step_table(said, sources.matching, start_ns, _unit(sources))
        note = f"<p>{TRUTH_COLUMN}</p>" if "truth" in header else ""
        return section(f"Steps: {len(rows)}", note + _long(header, rows))
    if said.picks:
        header, rows = pick_table(said.picks, start_ns)
        return section(f"Arrivals: {len(rows)}", _long(header, rows))
    if sources.moments.events:
        header, rows = event_table(sources.moments.events)
        return section(f"Events: {len(rows)}", _long(header, rows))
    return ""


def _marks(sources: Sources) -> str:
    if not sources.annotations:
        return ""
    start_ns = sources.results.provenance.start_ns
    header, rows = mark_table(sources.annotations, start_ns)
    return section(f"Annotations: {len(rows)}", _long(header, rows))


def _facts(sources: Sources, shown_signals: str) -> str:
    rows = fact_rows(
        sources.results, sources.name, sources.streams, sources.config.name, shown_signals
    )
    recipe = f"<pre>{escape(sources.results.provenance.pipeline)}</pre>"
    facts = f'<div class="facts">{table("", ("", ""), rows)}</div>'
    return section("Recording", facts + folded("Pipeline, with every parameter", recipe))
