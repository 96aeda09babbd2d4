"""The rows of a summary's tables: steps, picks, marks, facts. All of them are text."""

from __future__ import annotations

import math
from bisect import bisect_left
from datetime import UTC, datetime
from importlib.metadata import version
from typing import TYPE_CHECKING

from groundtrace.score import timing_pairs
from groundtrace.score.report import last_word
from groundtrace.score.step_timing import answers_text
from groundtrace_codecs.signals import FIRST_DATE_NS, NS_PER_S

from .verdict import TOLERANCE_S

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from groundtrace.results import Results
    from groundtrace.score import StepMatch
    from groundtrace.score.report import Answers
    from groundtrace_codecs.annotations import Annotation
    from groundtrace_codecs.events import Fix, Pick, StepEvent, TrackPoint
    from groundtrace_codecs.signals import Stream

    from .moments import PageMoment

Row = tuple[str, ...]
NONE = "\N{EN DASH}"


def step_table(
    said: Answers, matching: StepMatch | None, start_ns: int, unit: str
) -> tuple[Row, list[Row]]:
    """Return header and rows of every step; columns that nothing fills are left out.

    Parameters
    ----------
    said
        What a result says.
    matching
        Which steps answer which true ones; None without truth.
    start_ns
        First sample of the recording [ns].
    unit
        Of lengths.
    """
    steps = sorted(said.steps, key=lambda step: step.time_ns)
    place, verdict = _places(said), _verdicts(matching)
    before = [None, *(step.time_ns for step in steps[:-1])]
    columns: dict[str, list[str]] = {
        "": [str(number) for number in range(1, len(steps) + 1)],
        "time [s]": [f"{(s.time_ns - start_ns) / NS_PER_S:.3f}" for s in steps],
        "after [s]": [
            "" if earlier is None else f"{(step.time_ns - earlier) / NS_PER_S:.3f}"
            for step, earlier in zip(steps, before, strict=True)
        ],
        "truth": [verdict.get(step.time_ns, "") for step in steps],
        "kind": [step.kind for step in steps],
        "foot": [step.foot for step in steps],
        "type": [step.type for step in steps],
        f"place [{unit}]": [place(step) for step in steps],
        "decision peak": [_value(step.value) for step in steps],
        "channels": [str(s.channels) if s.channels > 1 else "" for s in steps],
    }
    shown = {name: cells for name, cells in columns.items() if any(cells)}
    return tuple(shown), list(zip(*shown.values(), strict=True))


def _verdicts(matching: StepMatch | None) -> dict[int, str]:
    """Return by a step's time how far it is from the true one, or that there is none."""
    if matching is None:
        return {}
    found = matching.found_ns.tolist()
    said = {found[j]: "false" for j in matching.false.tolist()}
    for pair in timing_pairs(matching):
        if pair.found_ns in said:
            said[pair.found_ns] = f"false: {answers_text(pair, matching.tolerance_s)}"
    for i, j in matching.pairs.tolist():
        said[found[j]] = f"{(found[j] - int(matching.truth_ns[i])) / 1e6:+.0f} ms"
    return said


def _value(value: float) -> str:
    return f"{value:.3g}" if math.isfinite(value) else ""


def _places(said: Answers) -> Callable[[StepEvent], str]:
    """Return what tells where a step was: the last stage's fix, else the track."""
    fixes: Sequence[Fix | TrackPoint] = last_word(said.fixes)
    found = sorted(fixes or said.points, key=lambda each: each.time_ns)
    times = [each.time_ns for each in found]

    def place(step: StepEvent) -> str:
        at = bisect_left(times, step.time_ns)
        near = found[max(at - 1, 0) : at + 1]
        if not near:
            return ""
        nearest = min(near, key=lambda each: abs(each.time_ns - step.time_ns))
        if abs(nearest.time_ns - step.time_ns) > TOLERANCE_S * NS_PER_S:
            return ""
        return f"{nearest.x_m:.2f}, {nearest.y_m:.2f}{_sigma(nearest.covariance)}"

    return place


def _sigma(covariance: tuple[float, float, float]) -> str:
    """Return one standard deviation by axis."""
    xx, _, yy = covariance
    if not (math.isfinite(xx) and math.isfinite(yy)) or min(xx, yy) < 0:
        return ""
    return f" ± {math.sqrt(xx):.2f}, {math.sqrt(yy):.2f}"


def pick_table(picks: Iterable[Pick], start_ns: int) -> tuple[Row, list[Row]]:
    """Return header and rows of every pick."""
    rows: list[Row] = [
        (
            f"{(p.time_ns - start_ns) / NS_PER_S:.4f}",
            p.channel,
            f"{p.uncertainty_s * 1e3:.2f}" if math.isfinite(p.uncertainty_s) else NONE,
            _value(p.value) or NONE,
        )
        for p in sorted(picks, key=lambda p: (p.time_ns, p.channel))
    ]
    return ("time [s]", "channel", "± [ms]", "decision peak"), rows


def wrong_table(misses: Iterable[PageMoment]) -> tuple[Row, list[Row]]:
    """Return header and rows of every wrong decision, with its cause."""
    rows: list[Row] = [(f"{m.t_s:.3f}", m.kind, m.stage or NONE, m.text) for m in misses]
    return ("time [s]", "what", "stage", "why"), rows


def event_table(events: Iterable[PageMoment]) -> tuple[Row, list[Row]]:
    """Return header and rows of what else was found."""
    rows: list[Row] = [(f"{e.t_s:.3f}", e.kind, e.stage or NONE, e.text) for e in events]
    return ("time [s]", "what", "stage", ""), rows


def mark_table(annotations: Iterable[Annotation], start_ns: int) -> tuple[Row, list[Row]]:
    """Return header and rows of what people marked."""
    rows: list[Row] = []
    for annotation in annotations:
        label = annotation.label
        times = [label.time_ns] if label.end_ns is None else [label.time_ns, label.end_ns]
        span = " to ".join(f"{(t - start_ns) / NS_PER_S:.3f}" for t in times)
        rows.append((span, label.kind, label.label, label.channel, label.author, label.note))
    return ("time [s]", "kind", "label", "channel", "author", "note"), rows


def fact_rows(
    results: Results, name: str, streams: Sequence[Stream], pipeline: str, shown: str
) -> list[Row]:
    """Return what is known of a recording and of its replay.

    Parameters
    ----------
    results
        Of the recording.
    name
        File name of the recording.
    streams
        Of the recording; none where it is not there.
    pipeline
        Name of the pipeline.
    shown
        What of the signals the replay shows.
    """
    origin = results.provenance
    rows = [("recording", name), ("SHA-256", origin.sha256)]
    if origin.start_ns >= FIRST_DATE_NS:
        began = datetime.fromtimestamp(origin.start_ns / NS_PER_S, UTC)
        rows.append(("begins", f"{began:%Y-%m-%d %H:%M:%S} UTC"))
    rows.append(("lasts", f"{(origin.end_ns - origin.start_ns) / NS_PER_S:.2f} s"))
    if origin.from_ns is not None or origin.to_ns is not None:
        first, last = origin.from_ns or origin.start_ns, origin.to_ns or origin.end_ns
        since = [(t - origin.start_ns) / NS_PER_S for t in (first, last)]
        rows.append(("replayed", f"{since[0]:.2f} to {since[1]:.2f} s of it"))
    rows += [("sensors", _stream(stream)) for stream in streams]
    if results.geometry is not None and results.geometry.sensors:
        rows.append(("places known", f"of {len(results.geometry.sensors)} sensors"))
    versions = origin.versions | {"viewer (rerun-sdk)": version("rerun-sdk")}
    return [
        *rows,
        ("pipeline", pipeline),
        ("replay shows", shown),
        ("versions", ", ".join(f"{package} {number}" for package, number in versions.items())),
    ]


def _stream(stream: Stream) -> str:
    quantities = dict.fromkeys(c.quantity.replace("_", " ") for c in stream.channels)
    worn = f", at {stream.placement}" if stream.placement else ""
    count = len(stream.channels)
    return f"{stream.topic}: {', '.join(quantities)}, {count} x {stream.rate_hz:g} Hz{worn}"
