"""The summary of a result: one page with figures that opens in any browser and prints well."""

from __future__ import annotations

import math
from bisect import bisect_left
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from importlib.metadata import version
from itertools import islice, pairwise
from pathlib import Path, PureWindowsPath
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from groundtrace.annotate.store import kept_in
from groundtrace.api.files import unheard
from groundtrace.api.known_truth import scored_truth_of
from groundtrace.errors import AnnotationError
from groundtrace.evaluation.drawing import Drawing
from groundtrace.evaluation.figures import (
    TIME,
    map_figure,
    pick_figure,
    timeline_figure,
    tolerance_figure,
)
from groundtrace.evaluation.matching import answers_text, match_steps, timing_pairs
from groundtrace.evaluation.page import rendered, shown
from groundtrace.evaluation.picks import pick_residuals
from groundtrace.evaluation.positions import true_places, turn_onto
from groundtrace.evaluation.report import answers_of, last_word, score_events
from groundtrace.pipeline.config import parse_pipeline
from groundtrace.pipeline.results import read_results
from groundtrace_codecs.annotations import RecordingKey, annotated, sidecar_path
from groundtrace_codecs.errors import CodecError
from groundtrace_codecs.events import readable
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import FIRST_DATE_NS, NS_PER_S

from ..rerun.moments import moments_of_results
from ..rerun.wrong_decisions import TOLERANCE_S

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from markupsafe import Markup

    from groundtrace.api.files import Report
    from groundtrace.evaluation.matching import StepMatch
    from groundtrace.evaluation.positions import Places
    from groundtrace.evaluation.report import ResultEvents, Score
    from groundtrace.evaluation.tracks import TrackScore
    from groundtrace.pipeline.config import PipelineConfig
    from groundtrace.pipeline.results import Results
    from groundtrace_codecs.annotations import Annotation
    from groundtrace_codecs.events import Fix, Label, Pick, StepEvent, TrackPoint
    from groundtrace_codecs.signals import Stream

    from ..rerun.moments import PageMoment, PageMoments

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
    return rendered(
        "summary.html.jinja",
        Path(__file__).parent,
        kind="summary",
        name=sources.name,
        subtitle=f"{_duration(sources)} through {sources.config.name}",
        warnings=sources.results.warnings,
        links=links,
        tiles_shown=_figures_of_merit(sources),
        scored=sources.scored,
        beside=list(islice(filter(None, _beside(sources)), 2)),
        below=list(filter(None, _below(sources))),
        tables=list(_tables(sources)),
        long=LONG,
        facts=fact_rows(
            sources.results, sources.name, sources.streams, sources.config.name, shown_signals
        ),
        pipeline=sources.results.provenance.pipeline,
    )


def _duration(sources: Sources) -> str:
    origin = sources.results.provenance
    return f"{(origin.end_ns - origin.start_ns) / NS_PER_S:.1f} s"


def _figures_of_merit(sources: Sources) -> list[tuple[str, str, str]]:
    """Return the score in tiles, each with the level of chance or what it rests on."""
    score, unit = sources.score, _unit(sources)
    items = _found_tiles(sources)
    if score.steps is not None and score.steps.truth:
        s = score.steps
        chance = f"by chance {s.chance_f1:.2f}, blind metronome {s.chance_f1_metronome:.2f}"
        wrong = f"{s.truth - s.matched} missed, {s.detected - s.matched} false"
        outside = len(sources.events.steps) - s.detected
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
    return items


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
    events = sources.events
    walking = sorted(step.time_ns for step in events.steps)
    items = [("Recorded", _duration(sources), _streams(sources))]
    if walking:
        apart = sorted(b - a for a, b in pairwise(walking))
        interval_text = f"usually {apart[len(apart) // 2] / NS_PER_S:.2f} s apart" if apart else ""
        items.append(("Steps found", str(len(walking)), interval_text))
    elif events.picks:
        channels = len({pick.channel for pick in events.picks})
        items.append(("Arrivals found", str(len(events.picks)), f"on {channels} channels"))
    return items


def _streams(sources: Sources) -> str:
    count = len(sources.streams)
    return {0: "", 1: "1 stream"}.get(count, f"{count} streams")


def _unit(sources: Sources) -> str:
    geometry = sources.results.geometry
    return "m" if geometry is None else geometry.length_unit


def _beside(sources: Sources) -> Iterator[SummaryFigure | None]:
    """Yield the figures that stand side by side: of them the first two that there are."""
    yield place_map(sources)
    yield tolerance_plot(sources)
    yield interval_plot(sources)


def _below(sources: Sources) -> Iterator[SummaryFigure | None]:
    """Yield the figures that are as wide as the page."""
    yield steps_plot(sources)
    yield None if sources.events.steps else pick_plot(sources)


def _tables(sources: Sources) -> Iterator[SummaryTable]:
    """Yield what is wrong, what was found, and what people marked."""
    events, start_ns = sources.events, sources.results.provenance.start_ns
    misses = sources.moments.misses
    if sources.moments.truth and misses:
        yield SummaryTable(f"Wrong decisions: {len(misses)}", *wrong_table(misses))
    elif sources.moments.truth:
        yield SummaryTable("Wrong decisions", (), [], "None within the tolerance.")
    if events.steps:
        header, rows = step_table(events, sources.matching, start_ns, _unit(sources))
        note = TRUTH_COLUMN if "truth" in header else ""
        yield SummaryTable(f"Steps: {len(rows)}", header, rows, note)
    elif events.picks:
        header, rows = pick_table(events.picks, start_ns)
        yield SummaryTable(f"Arrivals: {len(rows)}", header, rows)
    elif sources.moments.events:
        header, rows = event_table(sources.moments.events)
        yield SummaryTable(f"Events: {len(rows)}", header, rows)
    if sources.annotations:
        header, rows = mark_table(sources.annotations, start_ns)
        yield SummaryTable(f"Annotations: {len(rows)}", header, rows)


Row = tuple[str, ...]
NONE = "\N{EN DASH}"


class SummaryTable(NamedTuple):
    """A section with a table: its title, header and rows, and what is said above."""

    title: str
    header: Row
    rows: list[Row]
    note: str = ""


def step_table(
    events: ResultEvents, matching: StepMatch | None, start_ns: int, unit: str
) -> tuple[Row, list[Row]]:
    """Return header and rows of every step; columns that nothing fills are left out.

    Parameters
    ----------
    events
        What a result says.
    matching
        Which steps answer which true ones; None without truth.
    start_ns
        First sample of the recording [ns].
    unit
        Of lengths.
    """
    steps = sorted(events.steps, key=lambda step: step.time_ns)
    position_of, verdict = _places(events), _verdicts(matching)
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
        f"place [{unit}]": [position_of(step) for step in steps],
        "decision peak": [_value(step.value) for step in steps],
        "channels": [str(s.channels) if s.channels > 1 else "" for s in steps],
    }
    shown = {name: cells for name, cells in columns.items() if any(cells)}
    return tuple(shown), list(zip(*shown.values(), strict=True))


def _verdicts(matching: StepMatch | None) -> dict[int, str]:
    """Return by a step's time how far it is from the true one, or that there is none."""
    if matching is None:
        return {}
    steps_ns = matching.found_ns.tolist()
    texts = {steps_ns[j]: "false" for j in matching.false.tolist()}
    for pair in timing_pairs(matching):
        if pair.found_ns in texts:
            texts[pair.found_ns] = f"false: {answers_text(pair, matching.tolerance_s)}"
    for i, j in matching.pairs.tolist():
        texts[steps_ns[j]] = f"{(steps_ns[j] - int(matching.truth_ns[i])) / 1e6:+.0f} ms"
    return texts


def _value(value: float) -> str:
    return readable(value, 3) if math.isfinite(value) else ""


def _places(events: ResultEvents) -> Callable[[StepEvent], str]:
    """Return what tells where a step was: the last stage's fix, else the track."""
    fixes: Sequence[Fix | TrackPoint] = last_word(events.fixes)
    positions = sorted(fixes or events.points, key=lambda each: each.time_ns)
    times = [each.time_ns for each in positions]

    def position_text(step: StepEvent) -> str:
        at = bisect_left(times, step.time_ns)
        near = positions[max(at - 1, 0) : at + 1]
        if not near:
            return ""
        nearest = min(near, key=lambda each: abs(each.time_ns - step.time_ns))
        if abs(nearest.time_ns - step.time_ns) > TOLERANCE_S * NS_PER_S:
            return ""
        return f"{nearest.x_m:.2f}, {nearest.y_m:.2f}{_sigma(nearest.covariance)}"

    return position_text


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


#: Longer pauses between steps are no rhythm [s].
PAUSE_S = 2.0


@dataclass(frozen=True, slots=True)
class SummaryFigure:
    """A figure: its title, what to say below it, and what its colours stand for."""

    title: str
    svg: Markup
    caption: str
    keys: dict[str, str] = field(default_factory=dict)


def place_map(sources: Sources) -> SummaryFigure | None:
    """Return truth, places and tracks on the plan, to scale; None where no place was found."""
    events, geometry = sources.events, sources.results.geometry
    truth = true_places(sources.labels)
    fixes = last_word(events.fixes)
    if not (fixes or events.points):
        return None
    caption = ""
    if sources.free:
        truth = _aligned_truth(truth, events.points)
        caption = "The track begins and heads anywhere: the truth is turned and shifted onto it."
    keys = {"hit": "truth"} if len(truth) else {}
    keys |= {"random": f"places of {fixes[0].stage}"} if fixes else {}
    keys |= {"result": f"track of {events.points[0].stage}"} if events.points else {}
    keys |= {"soft": "sensors"} if geometry is not None and geometry.sensors else {}
    drawn = map_figure(truth, fixes, events.points, geometry)
    return SummaryFigure("Places", drawn, caption, keys)


def _aligned_truth(truth: Places, points: Sequence[TrackPoint]) -> Places:
    """Return the truth turned and shifted onto the only track, where both are at its times."""
    ordered = sorted(points, key=lambda point: point.time_ns)
    since = np.array([point.time_ns - ordered[0].time_ns for point in ordered], np.float64)
    at = (truth.time_ns - ordered[0].time_ns).astype(np.float64)
    columns = ([p.x_m for p in ordered], [p.y_m for p in ordered])
    tracked = np.column_stack([np.interp(at, since, column) for column in columns])
    during = (at >= since[0]) & (at <= since[-1])
    if during.sum() < 2:
        return truth
    return replace(truth, xy=turn_onto(truth.xy[during], tracked[during])(truth.xy))


def pick_plot(sources: Sources) -> SummaryFigure | None:
    """Return the errors of arrivals, impact by impact; None without true ones."""
    score = sources.score.picks
    if score is None or not score.all.truth:
        return None
    keys = {"result": "answered", "false": "more than 50 ms off", "missed": "no pick"}
    drawn = pick_figure(pick_residuals(sources.labels, sources.events.picks))
    keys["ink"] = "median"
    return SummaryFigure("Errors of arrivals", drawn, "Channels side by side.", keys)


def tolerance_plot(sources: Sources) -> SummaryFigure | None:
    """Return F1 over tolerance beside two levels of chance; None without true steps."""
    score, matching = sources.score.steps, sources.matching
    if score is None or matching is None:
        return None
    keys = {"result": "this result", "chance": "blind metronome", "random": "random times"}
    start_ns = sources.results.provenance.start_ns
    drawn = tolerance_figure(score, matching, start_ns)
    caption = "What counts is the distance to chance."
    return SummaryFigure("Steps and chance", drawn, caption, keys)


def steps_plot(sources: Sources) -> SummaryFigure | None:
    """Return every step and what became of it; None without true steps."""
    matching, origin = sources.matching, sources.results.provenance
    if matching is None:
        return None
    keys = {"hit": "matched", "missed": "missed", "false": "false"}
    drawn = timeline_figure(matching, origin.start_ns, origin.end_ns)
    caption = "Above each line the true steps, below it the detections. Shaded time is scored. "
    caption += "Rest the mouse on a stroke for its time."
    return SummaryFigure("Every step", drawn, caption, keys)


def interval_plot(sources: Sources) -> SummaryFigure | None:
    """Return the time from step to step, in which missed and doubled steps stand out."""
    start_ns = sources.results.provenance.start_ns
    since = np.array([step.time_ns - start_ns for step in sources.events.steps], np.int64)
    times = np.sort(since) / NS_PER_S
    apart = np.diff(times)
    valid = (apart > 0) & (apart <= PAUSE_S)
    if not valid.any():
        return None
    ends, lengths = times[1:][valid], apart[valid]
    middle = float(np.median(lengths))
    plot = Drawing("Time from step to step", TIME, "From step to step [s]")
    plot.mark(y=middle)
    tips = [f"{at:.2f} s: {apart:.3f} s later" for at, apart in zip(ends, lengths, strict=True)]
    plot.dots(ends, lengths, "result", tips)
    plot.axes.set_ylim(0, 1.15 * float(lengths.max()))
    caption = f"Broken line: median {middle:.2f} s. Pauses of more than {PAUSE_S:g} s are left out."
    return SummaryFigure("Rhythm", plot.svg(), caption)


@dataclass(frozen=True, slots=True)
class Sources:
    """What a shared folder is made of.

    Attributes
    ----------
    path
        The file of the results.
    results, config
        What it holds, and its pipeline.
    labels, score
        The truth, and how well the results answer it.
    events
        The results' events, sorted by the truth they answer.
    moments
        What a page jumps to.
    recording
        The recording, or None where it is not there.
    streams
        Of the recording; none where it is not there.
    annotations
        What people marked, by time.
    sidecar
        The file that it is kept in, or None.
    """

    path: Path
    results: Results
    config: PipelineConfig
    labels: tuple[Label, ...]
    score: Score
    events: ResultEvents
    moments: PageMoments
    recording: Path | None
    streams: tuple[Stream, ...]
    annotations: tuple[Annotation, ...]
    sidecar: Path | None

    @property
    def name(self) -> str:
        """File name of the recording, without any folder."""
        return PureWindowsPath(self.results.provenance.recording).name

    @property
    def stem(self) -> str:
        """The same without its ending."""
        return PureWindowsPath(self.name).stem

    @property
    def key(self) -> RecordingKey:
        """The recording as annotations name it."""
        origin = self.results.provenance
        return RecordingKey(self.name, origin.sha256, origin.start_ns)

    @property
    def matching(self) -> StepMatch | None:
        """Which steps answer which true ones; None without true steps."""
        if self.score.steps is None or not self.score.steps.truth:
            return None
        origin = self.results.provenance
        found_ns = np.array([step.time_ns for step in self.events.steps], np.int64)
        return match_steps(self.labels, found_ns, origin.start_ns, origin.end_ns, TOLERANCE_S)

    @property
    def free(self) -> bool:
        """Whether the track is a walker's that begins anywhere and heads anywhere."""
        quantities = {c.quantity for stream in self.streams for c in stream.channels}
        is_referenced = not quantities or quantities & {"magnetic_field", "latitude"}
        track = self.score.track
        closed = track is not None and track.closure is not None
        return self.config.application == "walker" and closed and not is_referenced

    @property
    def scored(self) -> bool:
        """Whether there is truth to score anything by."""
        return bool(self.score.parts)


def sources_of(path: Path, recording: Path | None, report: Report = unheard) -> Sources:
    """Read everything that a shared folder is made of.

    Parameters
    ----------
    path
        The results; annotations are looked for beside the recording, then beside them.
    recording
        Their recording, or None where it is not there.
    report
        Told what a person should know of truth and annotations.

    Raises
    ------
    GroundtraceError, CodecError
        Where one of the files cannot be read.
    """
    results = read_results(path)
    origin = results.provenance
    beside = path.parent / PureWindowsPath(origin.recording).name
    labels = scored_truth_of(results, beside, report=report).labels
    streams: tuple[Stream, ...] = ()
    if recording is not None:
        with Recording.open(recording) as opened:
            streams = opened.streams
    annotations, sidecar = _source_marks(results, beside, recording, report)
    return Sources(
        path,
        results,
        parse_pipeline(origin.pipeline.encode(), f"{path.name}: pipeline"),
        labels,
        score_events(labels, results.events, origin.start_ns, origin.end_ns, TOLERANCE_S),
        answers_of(results.events),
        moments_of_results(results, streams, labels, recording),
        recording,
        streams,
        annotations,
        sidecar,
    )


def _source_marks(
    results: Results, beside: Path, recording: Path | None, report: Report
) -> tuple[tuple[Annotation, ...], Path | None]:
    """Return what people marked, and the sidecar; a sidecar of no use is said and left out."""
    origin = results.provenance
    key = RecordingKey(origin.recording, origin.sha256, origin.start_ns)
    for path in (recording, beside):
        if path is None or not annotated(path):
            continue
        try:
            marks = kept_in(sidecar_path(path), key)
        except (AnnotationError, CodecError) as error:
            report(f"annotations are left out: {error}")
            continue
        for remark in marks.remarks:
            report(remark)
        sidecar = sidecar_path(path)
        return marks.annotations, sidecar if sidecar.is_file() else None
    return results.annotations, None
