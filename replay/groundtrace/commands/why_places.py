"""What ``groundtrace why`` prints about places."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .output import print_table
from .why_rows import first_to_last, spans

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..explain.place_causes import PlaceCause
    from ..explain.place_remedies import Figures, PlaceRemedy
    from ..explain.places import FixAccount, FixMoment, PlaceAccount
    from ..explain.sensor_accounts import SensorFault

AGAINST = {"truth": "the truth", "track": "the track (no true places)", "none": "nothing known"}


def print_places(found: PlaceAccount) -> None:
    """Print the figures, the wrong sensors and the bad places."""
    print(_headline(found))
    if found.undetected:
        print(f"{found.undetected} true steps were not detected; see --kind steps")
    if found.causes:
        causes = sorted(found.causes.items(), key=lambda item: -item[1])
        print("causes of bad places: " + ", ".join(f"{n} {cause}" for cause, n in causes))
    if found.sensors:
        print("\nsensors")
        rows = [_sensor_row(s, found.reference) for s in found.sensors]
        print_table(("sensor", "cause", "why", "change", "what it does"), rows)
    if found.bad:
        print("\nplaces")
        print("misfit: what a cause leaves unexplained of the arrivals; the next best beside it")
        header = ("fix", "time [s]", "off [m]", "cause", "misfit", "why", "smallest change")
        print_table(header, _fix_rows(found.bad, found.reference))


def _headline(found: PlaceAccount) -> str:
    f = found.figures
    counts = (
        f"{f.right} right, {f.far} more than {found.tolerance_m:g} m off, {f.rejected} rejected, "
        f"{f.missing} without a place"
    )
    rmse = f"RMSE {f.rmse_m:.2f} m" if np.isfinite(f.rmse_m) else "errors unknown"
    against = f"{rmse} against {AGAINST[found.reference]}"
    return f"{found.recording}: places of {found.stage}: {counts}; {against}"


def _sensor_row(s: SensorFault, reference: str) -> tuple[str, ...]:
    if s.before is None or s.after is None:
        return (s.channel, s.cause, s.text, "-", "-")
    off = f"its arrivals {s.before_ms:.2f} -> {s.after_ms:.2f} ms off the curve"
    gain = f"explains them better by {s.gain:.0f}, {s.rival} by {s.rival_gain:.0f} (BIC)"
    does = f"{off}, {_effect(s.before, s.after, reference)}"
    return (s.channel, s.cause, f"{s.text}; {gain}", s.change or "none without harm", does)


def _effect(before: Figures, after: Figures, reference: str) -> str:
    """Return what a change does to all places; a track that bad places made is no measure."""
    parts = []
    if reference == "truth":
        parts.append(f"RMSE {before.rmse_m:.2f} -> {after.rmse_m:.2f} m")
    elif np.isfinite(before.residual) and np.isfinite(after.residual):
        parts.append(f"median residual {before.residual:.3g} -> {after.residual:.3g}")
    wrong = [f.far + f.rejected + f.missing for f in (before, after)]
    return ", ".join([*parts, f"bad {wrong[0]} -> {wrong[1]}"])


def _fix_rows(bad: Sequence[FixAccount], reference: str) -> list[tuple[str, ...]]:
    """Return a row for each bad place; those with the same cause and remedy share one."""
    groups: dict[tuple[str, str, str], list[FixAccount]] = {}
    for fix in bad:
        groups.setdefault(_same(fix), []).append(fix)
    rows: list[tuple[str, ...]] = []
    for (cause, text, change), same in groups.items():
        remedy = same[0].cause.remedy if same[0].cause is not None else None
        mends = _remedy(remedy, change, reference, alone=len(same) == 1)
        rows.append(
            (
                spans([f.fix for f in same]),
                first_to_last([f.time_s for f in same]),
                _off(same),
                cause,
                _closest([f.cause for f in same if f.cause is not None]),
                text,
                mends,
            )
        )
    return rows


def _same(fix: FixAccount) -> tuple[str, str, str]:
    cause = fix.cause
    if cause is None:
        return "", "", ""
    change = cause.remedy.change if cause.remedy is not None else ""
    return cause.cause, cause.text, change


def _closest(causes: Sequence[PlaceCause]) -> str:
    """Return the misfit of a cause and of its rival, where they are closest."""
    known = [c for c in causes if np.isfinite(c.misfit)]
    if not known:
        return "-"
    c = min(known, key=lambda c: np.nan_to_num(c.rival_misfit - c.misfit, nan=np.inf))
    beside = f", {c.rival} {c.rival_misfit:.1f}" if c.rival else ""
    return f"{c.misfit:.1f}{beside}"


def _off(fixes: Sequence[FixAccount]) -> str:
    errors = [f.error_m for f in fixes if np.isfinite(f.error_m)]
    states = {f.state for f in fixes} - {"far"}
    note = "/".join(sorted(states))
    if not errors:
        return note or "-"
    span = f"{min(errors):.2f}" + (f"-{max(errors):.2f}" if len(errors) > 1 else "")
    return f"{span} {note}".rstrip()


def _remedy(remedy: PlaceRemedy | None, change: str, reference: str, *, alone: bool) -> str:
    if remedy is None:
        return "no change of one parameter or sensor does it without harm"
    to = f" ({remedy.error_m:.2f} m off)" if alone and np.isfinite(remedy.error_m) else ""
    return f"{change}{to}: {_effect(remedy.before, remedy.after, reference)}"


def print_place(found: FixMoment, reference: str) -> None:
    """Print everything about one place."""
    print(_place_line(found.fix))
    cause = found.fix.cause
    if cause is not None:
        print(f"{cause.cause}: {cause.text}")
        if np.isfinite(cause.misfit):
            print(f"misfit: {_closest([cause])}")
        change = cause.remedy.change if cause.remedy is not None else ""
        print(f"smallest change: {_remedy(cause.remedy, change, reference, alone=True)}")
    for r in found.fix.readings:
        verdict = "pass" if r.passed else "FAIL"
        unit = "" if r.unit == "1" else f" {r.unit}"
        print(f"gate {r.gate}: {r.value:.4g}{unit}, threshold {r.threshold:.4g}{unit}: {verdict}")
    print()
    header = ("channel", "arrival [ms]", "off [ms]", "without it: off [m]", "residual", "")
    print_table(header, _channel_rows(found))


def _channel_rows(found: FixMoment) -> list[tuple[str, ...]]:
    return [
        (
            c.channel,
            _number(c.arrival_ms, ".2f"),
            _number(c.off_ms, "+.2f"),
            _number(c.error_without_m, ".2f"),
            _number(c.residual_without, ".3g"),
            c.text,
        )
        for c in found.channels
    ]


def _number(value: float, form: str) -> str:
    return format(value, form) if np.isfinite(value) else "-"


def _place_line(fix: FixAccount) -> str:
    place = f"({fix.x_m:.2f}, {fix.y_m:.2f}) m" if np.isfinite(fix.x_m) else "nowhere"
    off = f", {fix.error_m:.2f} m off" if np.isfinite(fix.error_m) else ""
    return f"fix {fix.fix} at {fix.time_s:.3f} s: {fix.state}: placed {place}{off}"


def places_page(found: PlaceAccount) -> str:
    """Return the page about all places."""
    lines = [f"# {found.recording}", "", _headline(found), ""]
    lines += [f"* {s.channel}, {s.cause}: {s.text}" for s in found.sensors]
    if found.bad:
        lines += ["", "| fix | time [s] | off [m] | cause | misfit | why |"]
        lines += ["|---|---|---|---|---|---|"]
        rows = _fix_rows(found.bad, found.reference)
        lines += ["| " + " | ".join(row[:6]) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def place_page(found: FixMoment) -> str:
    """Return the page about one place."""
    lines = [f"# fix {found.fix.fix}", "", _place_line(found.fix), ""]
    if found.fix.cause is not None:
        lines += [f"**{found.fix.cause.cause}**: {found.fix.cause.text}", ""]
    lines += ["| channel | arrival [ms] | off [ms] | off without it [m] | residual | |"]
    lines += ["|---|---|---|---|---|---|"]
    lines += ["| " + " | ".join(row) + " |" for row in _channel_rows(found)]
    return "\n".join(lines) + "\n"
