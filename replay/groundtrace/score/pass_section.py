"""The section of the score's page on passes: when at which station, and every vehicle."""

from __future__ import annotations

from typing import TYPE_CHECKING

from groundtrace_codecs.signals import NS_PER_S

from .html_parts import figure, section, shown, table, tiles
from .passes import match_passes, scored_passes
from .svg import Axis, Plot

if TYPE_CHECKING:
    from collections.abc import Sequence

    from groundtrace_codecs.events import Pass
    from groundtrace_codecs.labels import Label

    from .passes import PassScore, VehiclePass

_WIDTH, _ROW_PX, _FRAME_PX = 1160, 44, 90
_RIGHT = {None: "not told", True: "right", False: "wrong"}


def pass_section(
    labels: Sequence[Label], passes: Sequence[Pass], p: PassScore, span_ns: tuple[int, int]
) -> str:
    """Return the section of a score of passes.

    Parameters
    ----------
    labels, passes
        What was scored.
    p
        The score.
    span_ns
        First and last sample of the recording [ns].
    """
    drawn = figure(
        "Every pass",
        pass_figure(labels, passes, span_ns),
        "One row for each station. Rest the mouse on a dot for its vehicle, direction and speed.",
        result="found",
        truth="true, found",
        missed="true, missed",
        false="false",
    )
    header = ("vehicle", "stations", "told as one", "direction", "speed", "error of speed")
    vehicles = table("By vehicle", header, [_row(v) for v in p.vehicles])
    return section("Passes", _tiles(p) + drawn + vehicles)


def _tiles(p: PassScore) -> str:
    right = f"{p.vehicles_right} of {len(p.vehicles)}"
    return tiles(
        [
            ("Found", f"{p.matched} of {p.truth}", f"within {p.tolerance_s:g} s at their station"),
            ("False", str(p.found - p.matched), f"of {p.found} found, stage {p.stage}"),
            ("Vehicles right", right, "told as one, and the direction right"),
            ("Order", "right" if p.order_right else "wrong", "of passes that are clearly apart"),
            ("Median |error|", shown(p.median_abs_s, "s"), f"bias {shown(p.bias_s, 's')}"),
            ("Error of speed", shown(p.speed_median_percent, "%", 1), "median over vehicles"),
        ]
    )


def _row(v: VehiclePass) -> tuple[str, ...]:
    return (
        v.target or "\N{EN DASH}",
        f"{v.found} of {v.truth}",
        str(v.together),
        _RIGHT[v.direction_right],
        shown(v.speed_mps, "m/s", 1),
        shown(v.speed_error_mps, "m/s", sign=True),
    )


def pass_figure(labels: Sequence[Label], passes: Sequence[Pass], span_ns: tuple[int, int]) -> str:
    """Return true and found passes on a time axis, a row for each station."""
    truth, found = scored_passes(labels, passes)
    pairs = match_passes(truth, found)
    stations = list(dict.fromkeys([x.channel for x in truth] + [p.station for p in found]))
    rows = {name: len(stations) - i for i, name in enumerate(sorted(stations))}
    last_s = (span_ns[1] - span_ns[0]) / NS_PER_S
    plot = Plot(
        Axis("Time since the first sample [s]", 0, last_s),
        Axis("", 0.4, len(stations) + 0.6),
        _WIDTH,
        _FRAME_PX + _ROW_PX * len(stations),
    )
    known = {id(item) for pair in pairs for item in pair}
    for x in truth:
        style = "truth" if id(x) in known else "missed"
        words = f"{x.target}, {x.label}, {shown(x.value, 'm/s', 1)}"
        at_s = (x.time_ns - span_ns[0]) / NS_PER_S
        plot.dot(at_s, rows[x.channel] - 0.14, f"dot {style}", f"{at_s:.2f} s: true, {words}", 5)
    for p in found:
        style = "result" if id(p) in known else "false"
        words = f"vehicle {p.vehicle or 'untold'}, {p.direction or 'no direction'}"
        at_s = (p.time_ns - span_ns[0]) / NS_PER_S
        words = f"{at_s:.2f} s: found, {words}, {p.speed_mps:.1f} m/s"
        plot.dot(at_s, rows[p.station] + 0.14, f"dot {style}", words, 5)
    return plot.named_rows({row: name for name, row in rows.items()}).svg("Every pass")
