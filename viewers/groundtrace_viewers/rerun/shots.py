"""Shots on a line: the record section at the cursor, travel times, and what became of each shot.

A record section shows the traces of a shot side by side with their picks, time downwards. True
amplitudes span decades from the nearest geophone to the farthest, so that every trace is scaled to
itself: it then shows its onset. All shots share the entities of one section, whatever recorded
them, so that the viewer shows the latest at the cursor.
"""

from __future__ import annotations

from bisect import bisect_right, insort
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from groundtrace.evaluation.picks import RIGHT_S
from groundtrace.pipeline.results import evidence_of
from groundtrace_codecs.events import CandidateBlock, Gap, Pick, StageSpec, TraceBlock
from groundtrace_codecs.signals import NS_PER_S, SEISMIC_QUANTITIES, SignalBlock

from .context import View
from .sketch import Sketch, crosses, thinned, ticks
from .timeline import (
    ACCEPTED,
    FAINT,
    IMPACT,
    MISSED,
    NOT_PICKED,
    OUTLINE,
    TRACE,
    TRUTH,
    Entity,
    strips_of,
)
from .wrong_decisions import results_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from groundtrace.explain.why_picks import BadPick
    from groundtrace_codecs.events import Event
    from groundtrace_codecs.geometry import Geometry

    from .context import ViewContext
    from .samples import Traces
    from .timeline import Line, Timeline

    Array = NDArray[np.float64]

SECTION, TRAVEL, PICKS, SHOTS = "/shots/section", "/shots/travel", "/shots/picks", "/shots/all"
#: A pick this long before its shot is still of it, and a shot is shown from then on; picks so long
#: after it are of it. Chosen by judgement: the longest way of a wave along a line.
BEFORE_NS, AFTER_NS = 50_000_000, 300_000_000
#: Largest error of a right pick, as the score has it [ms].
TOLERANCE_MS = RIGHT_S * 1e3
#: Width and height of a section and of the travel times, in units of their views: a view keeps its
#: shape, and is filled where it has that of its place in the layout.
WIDE, HIGH = 146.0, 150.0
FAR_WIDE, FAR_HIGH = 185.0, 84.0
#: The largest deflection, in distances between traces, and the part of the samples below it: beyond
#: it a trace is cut, so that a late wave leaves the onset its size.
DEFLECTION, BELOW = 0.62, 0.985
#: More samples of a trace than this are more than a screen has.
MOST_SAMPLES = 600
#: A section ends at the latest arrival times this, but not before so much [ms].
BEYOND, LEAST_MS = 1.6, 40.0
#: A label stands this far below its point; at most so many stand in a row.
LABEL_UP, MOST_LABELS = 2.6, 9
#: Of wrong picks so many are listed, and named beside travel times where they are so far apart.
MOST_LISTED, MOST_NAMED, NAMED_APART = 8, 4, 17.0


@dataclass(slots=True)
class Shot:
    """A shot, its picks and the true arrivals.

    Attributes
    ----------
    time_ns
        When it was [ns]; where no label says, its first pick.
    position
        Where it was [m]; None where unknown.
    picks
        By channel: the first one.
    truth
        By channel: the true arrival [ns].
    names
        Channels that recorded it, along the line; empty until its signal has come.
    along
        Shape (n,): of those, how far from the shot [m], negative towards the line's begin; the
        number along the line where places are unknown.
    signal
        Times [ms after the shot] and traces, shape (n_samples, n_channels), until it is drawn.
    drawn
        How many picks its section has; None where it is not drawn yet.
    end_ms
        Where its section ends [ms].
    """

    time_ns: int
    position: tuple[float, float] | None = None
    picks: dict[str, Pick] = field(default_factory=dict)
    truth: dict[str, int] = field(default_factory=dict)
    names: list[str] = field(default_factory=list)
    along: Array = field(default_factory=lambda: np.empty(0))
    signal: tuple[Array, Array] | None = None
    drawn: int | None = None
    end_ms: float = 0.0

    def after_ms(self, time_ns: int) -> float:
        """Return a time after the shot [ms]."""
        return (time_ns - self.time_ns) / 1e6

    def error_ms(self, channel: str) -> float:
        """Return pick minus true arrival [ms]; NaN where either is unknown."""
        if channel not in self.picks or channel not in self.truth:
            return float("nan")
        return (self.picks[channel].time_ns - self.truth[channel]) / 1e6

    @property
    def wrong(self) -> list[str]:
        """Channels whose pick is off by more than the tolerance, the worst first."""
        off = {name: abs(self.error_ms(name)) for name in self.names}
        return sorted((n for n in off if off[n] > TOLERANCE_MS), key=lambda n: -off[n])

    @property
    def lost(self) -> list[str]:
        """Channels with a true arrival and no pick."""
        return [name for name in self.names if name in self.truth and name not in self.picks]

    @property
    def right(self) -> int:
        """How many picks are right; where there is no truth, how many there are."""
        return len(self.picks.keys() & set(self.names)) - len(self.wrong)

    def ends_ms(self) -> float:
        """Return where its section ends [ms]: once it is drawn, there."""
        if self.drawn is None:
            times = [*self.truth.values(), *(p.time_ns for p in self.picks.values())]
            latest = max((self.after_ms(t) for t in times), default=AFTER_NS / 2e6)
            self.end_ms = ticks(min(max(BEYOND * latest, LEAST_MS), AFTER_NS / 1e6))[-1]
        return self.end_ms


def scaled(values: Array) -> Array:
    """Return traces scaled to themselves, cut at 1, and so that noise before them is about 0.

    Parameters
    ----------
    values
        Shape (n, n_channels), from the shot on.
    """
    swing = values - np.median(values[: max(len(values) // 20, 1)], axis=0)
    most = np.quantile(np.abs(swing), BELOW, axis=0)
    cut: Array = np.clip(swing / np.where(most > 0, most, 1.0), -1.0, 1.0)
    return cut


class ShotViews(View):
    """The section of the shot at the cursor, travel times, and what became of each shot."""

    def __init__(self, context: ViewContext) -> None:
        self._context = context
        self._shots: list[Shot] = []
        self._events: list[Event] = []
        self._logged_ns: set[int] = set()
        self._page = _Drawing(context.timeline, _ORDER)
        self._streams = {s.topic: s.columns_of(SEISMIC_QUANTITIES) for s in context.session.streams}
        context.summed.add("pick")
        for label in sorted(context.session.labels):
            if label.kind == "impact":
                has_position = label.x_m is not None and label.y_m is not None
                position = (label.x_m or 0.0, label.y_m or 0.0) if has_position else None
                insort(self._shots, Shot(label.time_ns, position), key=lambda s: s.time_ns)
        for label in context.session.labels:
            shot = self._at(label.time_ns)
            if label.kind == "pick" and shot is not None:
                shot.truth.setdefault(label.channel, label.time_ns)

    @staticmethod
    def fits(context: ViewContext) -> bool:
        """Whether shots are replayed, on channels that can stand side by side."""
        streams = context.session.streams
        beside = sum(len(stream.columns_of(SEISMIC_QUANTITIES)) for stream in streams)
        return context.session.application == "shots" and beside > 1

    def _at(self, time_ns: int) -> Shot | None:
        """Return the shot that a moment is of."""
        after = bisect_right(self._shots, time_ns, key=lambda s: s.time_ns)
        if after and time_ns < self._shots[after - 1].time_ns + AFTER_NS:
            return self._shots[after - 1]
        soon = after < len(self._shots) and time_ns >= self._shots[after].time_ns - BEFORE_NS
        return self._shots[after] if soon else None

    def pick(self, pick: Pick) -> None:
        """Take a pick of the stage that is reported."""
        if not self._context.stages.decides("pick", pick):
            return
        shot = self._at(pick.time_ns)
        if shot is None:
            shot = Shot(pick.time_ns)
            insort(self._shots, shot, key=lambda s: s.time_ns)
        previous = shot.picks.get(pick.channel)
        if previous is None or pick.time_ns < previous.time_ns:
            shot.picks[pick.channel] = pick

    def event(self, event: Event) -> None:
        """Keep what picks are explained by."""
        self._events.append(event)

    def signal(self, block: SignalBlock) -> None:
        """Take a block: the signal of shots that end before its end is there."""
        self._streams.setdefault(block.topic, block.stream.columns_of(SEISMIC_QUANTITIES))
        ended = bisect_right(self._shots, block.end_ns - AFTER_NS, key=lambda s: s.time_ns)
        for shot in reversed(self._shots[:ended]):
            if shot.names or shot.drawn is not None:
                break
            self._record(shot)

    def _record(self, shot: Shot) -> None:
        """Take the signal of a shot, of all streams that have some, along the line."""
        if shot.names:
            return
        gather = recorded(shot.time_ns, self._streams, self._context.traces)
        if gather is None:
            return
        times, names, values = gather
        shot.names, shot.along, order = along(shot, names, self._context.session.geometry)
        shot.signal = times, values[:, order]

    def flush(self, before_ns: int | None = None) -> None:
        """Log the sections that are picked, and in the end all, with the picks that came since."""
        fresh = []
        for number, shot in enumerate(self._shots):
            if before_ns is not None and (shot.time_ns + AFTER_NS > before_ns or not shot.picks):
                continue
            self._record(shot)
            if shot.drawn != len(shot.picks):
                self._page.section(shot, self._begins(number))
                fresh.append(number)
        if fresh and before_ns is not None and self._context.watched:
            self._tell(fresh, {})

    def _begins(self, number: int) -> int:
        """Return from when on a shot is the one at the cursor [ns]: the first one always is."""
        start_ns, time_ns = self._context.span_ns[0], self._shots[number].time_ns
        return min(start_ns, time_ns) if not number else max(time_ns - BEFORE_NS, start_ns)

    def close(self) -> None:
        """Log what is known when all shots are."""
        self.flush()
        self._tell(range(len(self._shots)), self._why())
        wrong = next((s for s in self._shots if s.names and (s.wrong or s.lost)), None)
        if wrong is not None:
            self._context.opens_ns = wrong.time_ns

    def _tell(self, fresh: Iterable[int], why: Mapping[tuple[str, int], BadPick]) -> None:
        """Log travel times, and of some shots by number the words and the place in the whole."""
        context, page = self._context, self._page
        numbers = [k for k in fresh if self._shots[k].names]
        shots = [self._shots[k] for k in numbers]
        if not shots:
            return
        timed_shots = [(shot, self._begins(k)) for k, shot in enumerate(self._shots) if shot.names]
        page.travel_times(timed_shots)
        texts = [
            card(self._shots[k], k + 1, len(self._shots), context.timeline, why) for k in numbers
        ]
        page.cards([self._begins(k) for k in numbers], texts)
        most = max(len(shot.names) for shot, _ in timed_shots)
        page.overview(shots, most, context.span_ns)
        for number, shot in zip(numbers, shots, strict=True):
            if shot.time_ns not in self._logged_ns:
                self._logged_ns.add(shot.time_ns)
                text, level = line(shot, number + 1, context.timeline)
                context.lines.add("shots", shot.time_ns, text, level)

    def _why(self) -> Mapping[tuple[str, int], BadPick]:
        """Return the account of bad picks, by channel and true arrival [ns]."""
        session = self._context.session
        has_picks = any(label.kind == "pick" for label in session.labels)
        if not has_picks or not session.pipeline or self._context.stages.last("pick") is None:
            return {}
        from groundtrace.explain.why_picks import pick_account

        evidence = evidence_of(results_of(session, self._events))
        if not evidence.labels or not any(part.spec.emits == "pick" for part in evidence.stages):
            return {}
        bad = [one for one in pick_account(evidence).bad if one.state != "false"]
        return {(b.channel, evidence.start_ns + round(b.time_s * NS_PER_S)): b for b in bad}

    kinds: ClassVar[Mapping[type[Any], Callable[[Any, Any], None]]] = {
        StageSpec: event,
        CandidateBlock: event,
        TraceBlock: event,
        Gap: event,
        Pick: pick,
        SignalBlock: signal,
    }


def recorded(
    time_ns: int, streams: Mapping[str, Sequence[int]], traces: Traces
) -> tuple[Array, list[str], Array] | None:
    """Return times after a shot [ms], channels, and their traces; None where there are none.

    Streams of other rates are brought to the times of the first one.
    """
    names: list[str] = []
    parts: list[Array] = []
    times = np.empty(0)
    for topic, columns in streams.items():
        segment = traces.between(topic, time_ns, time_ns + AFTER_NS, columns)
        if segment is None or not columns:
            continue
        times_ms = (segment[0] - time_ns) / 1e6
        times = times if len(times) else times_ms
        same = len(times) == len(times_ms)
        parts += [v if same else np.interp(times, times_ms, v) for v in segment[1].T]
        channels = traces.blocks(topic, time_ns, time_ns + AFTER_NS)[0].stream.channels
        names += [channels[i].name for i in columns]
    return (times, names, np.stack(parts, axis=1)) if parts else None


def along(
    shot: Shot, names: Sequence[str], geometry: Geometry | None
) -> tuple[list[str], Array, NDArray[np.intp]]:
    """Return channels along the line, how far from the shot they are, and their order.

    Where places are unknown they keep their order, and are so far from the first as they are many.
    """
    places = {s.channel: (s.x, s.y) for s in geometry.sensors} if geometry is not None else {}
    index = np.arange(len(names))
    if not all(name in places for name in names):
        return list(names), index.astype(np.float64), index
    at = np.array([places[name] for name in names])
    centred = at - at.mean(axis=0)
    axis = np.linalg.svd(centred)[2][0]
    axis = axis * (1.0 if axis[np.abs(axis).argmax()] > 0 else -1.0)
    way = centred @ axis
    order: NDArray[np.intp] = np.argsort(way, kind="stable")
    if shot.position is None:
        return [names[i] for i in order], way[order] - way.min(), order
    from_shot = at - np.array(shot.position)
    side = np.where(from_shot @ axis < 0, -1.0, 1.0)
    return [names[i] for i in order], (side * np.hypot(*from_shot.T))[order], order


def card(
    shot: Shot,
    number: int,
    count: int,
    timeline: Timeline,
    why: Mapping[tuple[str, int], BadPick],
) -> str:
    """Return what became of a shot as markdown: how many picks are right, and the worst ones."""
    late = [name for name in shot.wrong if shot.error_ms(name) > 0]
    missed, wrong = shot.lost, shot.wrong
    lines = [f"**Shot {number} of {count}, {timeline.seconds(shot.time_ns)}**"]
    if not shot.truth:
        return f"{lines[0]}  \n{shot.right} of {len(shot.names)} picked; no truth to judge them by"
    lines += [
        f"**{shot.right} right** to {TOLERANCE_MS:g} ms, {len(wrong) - len(late)} early, "
        f"{len(late)} late, {len(missed)} not picked"
    ]
    for name in [*wrong[:1], *missed[:1]]:
        bad_pick = why.get((name, shot.truth[name]))
        if bad_pick is not None:
            lines.append(f"**{name}** {bad_pick.reason.cause}: {bad_pick.reason.text}")
    text = "  \n".join(lines)
    if not wrong:
        return text
    rows = "".join(
        f"| **{name}** | **{shot.error_ms(name):+.1f}** | {pick.uncertainty_s * 1e3:.1f} "
        f"| {shot.after_ms(pick.time_ns):.1f} | {shot.after_ms(shot.truth[name]):.1f} |\n"
        for name in wrong[:MOST_LISTED]
        for pick in [shot.picks[name]]
    )
    return (
        f"{text}\n\n| worst | error ms | claimed ± | pick | truth |\n|:--|--:|--:|--:|--:|\n{rows}"
    )


def line(shot: Shot, number: int, timeline: Timeline) -> tuple[str, str]:
    """Return the line of a shot for the log, and its level by the share of bad picks."""
    when = timeline.seconds(shot.time_ns)
    if not shot.truth:
        return f"shot {number}: {shot.right} of {len(shot.names)} picked; {when}", "INFO"
    bad = len(shot.wrong) + len(shot.lost)
    text = f"shot {number}: {shot.right} of {shot.right + bad} right"
    if shot.wrong:
        worst = shot.wrong[0]
        off = shot.error_ms(worst)
        text += f", {worst} {abs(off):.1f} ms {'late' if off > 0 else 'early'}"
    text += f", {len(shot.lost)} not picked" if shot.lost else ""
    level = "ERROR" if bad > shot.right else "WARN" if 3 * bad > shot.right else "INFO"
    return f"{text}; {when}", level


class _Drawing(Sketch):
    """Draws shots in 2-D views."""

    def section(self, shot: Shot, begins_ns: int) -> None:
        """Log the section of a shot."""
        title = "Section of the shot at the cursor [ms]: × pick"
        if shot.truth:
            title += f", red if over {TOLERANCE_MS:g} ms off; + truth"
        self.timeline.declare(Entity(SECTION, "section", title))
        if not shot.names:
            return
        when, end_ms = [begins_ns], shot.ends_ms()
        down = HIGH / end_ms
        base: Array = WIDE * np.arange(1.0, len(shot.names) + 1.0) / (len(shot.names) + 1.0)
        self._traces(shot, when, base)
        shot.signal, shot.drawn = None, len(shot.picks)
        marks = ticks(end_ms)
        grid: list[Line] = [[(0.0, down * m), (WIDE, down * m)] for m in marks]
        self.lines(f"{SECTION}/grid", when, [grid], FAINT, -0.5)
        at_side = [((-6.0, down * m - LABEL_UP), f"{m:g}") for m in marks]
        self.words(f"{SECTION}/time", when, [at_side], OUTLINE)
        named = range(0, len(base), -(-len(base) // MOST_LABELS))
        heads = [((float(base[i]), -13.5), shot.names[i]) for i in named]
        self.words(f"{SECTION}/geophones", when, [heads], TRACE)
        if shot.position is not None:
            far = [((float(base[i]), -6.5), f"{round(float(shot.along[i]), 1):+g}") for i in named]
            self.words(f"{SECTION}/offsets", when, [far], OUTLINE)
            at = float(np.interp(0.0, shot.along, base, left=0.0, right=WIDE))  # also beside it
            self.lines(f"{SECTION}/shot", when, [[[(at, 0.0), (at, HIGH)]]], IMPACT, -0.9)
        self._marks(shot, when, dict(zip(shot.names, base.tolist(), strict=True)), down)

    def _traces(self, shot: Shot, when: Sequence[int], base: Array) -> None:
        """Log the traces: what swings to the right is filled, a stroke a sample."""
        if shot.signal is None:
            return
        end_ms = shot.end_ms
        seen = shot.signal[0] <= end_ms
        times, values = thinned(shot.signal[0][seen], scaled(shot.signal[1][seen]), MOST_SAMPLES)
        down, reach = times * HIGH / end_ms, DEFLECTION * WIDE / (len(base) + 1.0)
        swung = base + reach * values
        wiggles: list[Line] = [np.stack([trace, down], axis=1) for trace in swung.T]
        self.lines(f"{SECTION}/wiggle", when, [wiggles], TRACE, -0.6)
        channel, row = np.nonzero(values.T > 0.03)
        fills = np.stack(
            [
                np.stack([base[channel], down[row]], axis=1),
                np.stack([swung[row, channel], down[row]], axis=1),
            ],
            axis=1,
        )
        half = 0.85 * HIGH / len(times)
        self.lines(f"{SECTION}/area", when, [list(fills)], _AREA, half)

    def _marks(self, shot: Shot, when: Sequence[int], x: Mapping[str, float], down: float) -> None:
        """Log picks with what they claim, true arrivals, and the error between them."""
        wrong, at = set(shot.wrong), {n: p for n, p in shot.picks.items() if n in x}
        y = {name: down * shot.after_ms(pick.time_ns) for name, pick in at.items()}
        true = {n: down * shot.after_ms(t) for n, t in shot.truth.items() if n in x}
        claims = {n: down * 1e3 * p.uncertainty_s for n, p in at.items() if p.uncertainty_s > 0}
        spread: list[Line] = [[(x[n], y[n] - c), (x[n], y[n] + c)] for n, c in claims.items()]
        self.lines(f"{SECTION}/claim", when, [spread], ACCEPTED, -0.7)
        error: list[Line] = [[(x[n], y[n]), (x[n], true[n])] for n in wrong]
        self.lines(f"{SECTION}/error", when, [error], MISSED, -1.2)
        for what, colour, half, names in (
            ("pick", ACCEPTED, 1.5, [n for n in y if n not in wrong]),
            ("wrong", MISSED, 2.0, [n for n in y if n in wrong]),
        ):
            drawn = crosses([(x[n], y[n]) for n in names], half, upright=False)
            self.lines(f"{SECTION}/{what}", when, [drawn], colour, -1.5)
        drawn = crosses([(x[n], t) for n, t in true.items()], 1.7, upright=True)
        self.lines(f"{SECTION}/truth", when, [drawn], TRUTH, -1.0)
        lost = [(x[n], true[n]) for n in shot.lost]
        self.points(f"{SECTION}/lost", when, [lost], NOT_PICKED, -4.5)

    def travel_times(self, shots: Sequence[tuple[Shot, int]]) -> None:
        """Log travel times over the distance from the shot: of all shots, and of the one now."""
        import rerun as rr

        unit = "offset [m]" if any(s.position for s, _ in shots) else "channel"
        title = f"Travel times [ms] over {unit}: this shot bold, the others grey"
        axes = _Axes.of([shot for shot, _ in shots])
        self.timeline.declare(Entity(TRAVEL, "travel", title))
        across, up = axes.grid()
        grid = rr.LineStrips2D([*across, *up], colors=FAINT, radii=-0.5, draw_order=-5.0)
        self.timeline.static(f"{TRAVEL}/grid", grid)
        words = axes.words()
        scale = rr.Points2D(
            [position for position, _ in words],
            labels=[text for _, text in words],
            show_labels=True,
            radii=0.0,
            colors=OUTLINE,
        )
        self.timeline.static(f"{TRAVEL}/scale", scale)
        curves = [axes.curves(shot) for shot, _ in shots]
        flat = [curve for shot_curves in curves for curve in shot_curves]
        if flat:
            all_of = rr.LineStrips2D(strips_of(flat), colors=_BESIDE, radii=-0.6, draw_order=1.0)
            self.timeline.static(f"{TRAVEL}/others", all_of)
        times = [begins for _, begins in shots]
        self.lines(f"{TRAVEL}/now", times, curves, TRACE, -1.3)
        marks = [axes.marks(shot) for shot, _ in shots]
        for number, (what, colour, half, upright) in enumerate(
            (
                ("truth", TRUTH, 1.5, True),
                ("pick", ACCEPTED, 1.3, False),
                ("wrong", MISSED, 1.9, False),
            )
        ):
            rows = [
                crosses(list(channels[number].values()), half, upright=upright)
                for channels in marks
            ]
            self.lines(f"{TRAVEL}/{what}", times, rows, colour, -1.2)
        named = [
            _apart(shot, channels[2]) for (shot, _), channels in zip(shots, marks, strict=True)
        ]
        self.words(f"{TRAVEL}/names", times, named, MISSED)

    def cards(self, times: Sequence[int], texts: Sequence[str]) -> None:
        """Log what became of each shot in words."""
        import rerun as rr

        self.timeline.declare(Entity(PICKS, "shot", "Picks of this shot"))
        types = ["text/markdown"] * len(texts)
        columns = rr.TextDocument.columns(text=list(texts), media_type=types)
        self.timeline.send(PICKS, list(times), columns)

    def overview(self, shots: Sequence[Shot], most: int, span_ns: tuple[int, int]) -> None:
        """Log how many picks of shots, of ``most`` traces, are right and wrong."""
        import rerun as rr

        title = "Shots of the recording, yellow: ● right picks, × wrong or missing"
        self.timeline.declare(Entity(SHOTS, "shots", title, top=1.05 * most))
        off = rr.components.AggregationPolicy.Off
        for what, colour, values in (
            ("floor", OUTLINE, None),
            ("shot", IMPACT, [len(shot.names) for shot in shots]),
        ):
            style = rr.SeriesLines(colors=[colour], widths=1.5, names=what, aggregation_policy=off)
            self.timeline.static(f"{SHOTS}/{what}", style)
            if values is None:  # it keeps the axis to the recording
                self.timeline.level(f"{SHOTS}/{what}", span_ns, 0.0)
                continue
            times = np.array([s.time_ns + k for s in shots for k in (0, 1, 2)])
            stems = np.array([v for value in values for v in (0.0, value, np.nan)])
            self.timeline.scalars(f"{SHOTS}/{what}", times, stems[:, np.newaxis])
        bad = [float(len(shot.wrong) + len(shot.lost)) for shot in shots]
        marks: tuple[tuple[str, int, Any, list[float]], ...] = (
            ("right", ACCEPTED, "circle", [float(shot.right) for shot in shots]),
            ("bad", MISSED, "cross", [one if one else np.nan for one in bad]),
        )
        for what, colour, shape, counts in marks:
            points = rr.SeriesPoints(colors=[colour], markers=shape, marker_sizes=5.0, names=what)
            self.timeline.static(f"{SHOTS}/{what}", points)
            at = [shot.time_ns for shot in shots]
            self.timeline.scalars(f"{SHOTS}/{what}", at, np.array(counts)[:, np.newaxis])


@dataclass(frozen=True, slots=True)
class _Axes:
    """The axes of travel times: up to which distance and time they go."""

    far: list[float]
    late_ms: list[float]

    @classmethod
    def of(cls, shots: Sequence[Shot]) -> _Axes:
        """Return axes that hold the true arrivals, or nearly all picks where there are none."""
        far = max(float(np.abs(shot.along).max()) for shot in shots)
        true = [s.after_ms(t) for s in shots for t in s.truth.values()]
        picked = [s.after_ms(p.time_ns) for s in shots for p in s.picks.values()]
        late = 1.2 * max(true) if true else float(np.quantile(picked, 0.98)) if picked else 100.0
        return cls(ticks(max(far, 1.0)), ticks(max(late, 1.0)))

    def at(self, far: float, time_ms: float) -> tuple[float, float]:
        """Return a place in the view, whose y points down; later times are at its upper edge."""
        up = min(max(time_ms / self.late_ms[-1], 0.0), 1.0)
        return abs(far) / self.far[-1] * FAR_WIDE, -up * FAR_HIGH

    def grid(self) -> tuple[list[Line], list[Line]]:
        """Return the lines of the grid, upright ones first."""
        end_m, end_ms = self.far[-1], self.late_ms[-1]
        upright: list[Line] = [[self.at(m, 0.0), self.at(m, end_ms)] for m in self.far]
        return upright, [[self.at(0.0, t), self.at(end_m, t)] for t in self.late_ms]

    def words(self) -> list[tuple[tuple[float, float], str]]:
        """Return the numbers at the axes."""
        below = [((self.at(m, 0.0)[0], 2.0), f"{m:g}") for m in self.far]
        return below + [((-7.0, self.at(0.0, t)[1] - LABEL_UP), f"{t:g}") for t in self.late_ms]

    def curves(self, shot: Shot) -> list[Line]:
        """Return the picks of a shot as a curve to either side."""
        far = dict(zip(shot.names, shot.along.tolist(), strict=True))
        curves: list[Line] = []
        for side in (-1.0, 1.0):
            names = [
                n for n in shot.names if n in shot.picks and side * far[n] >= (side < 0) * 1e-9
            ]
            names.sort(key=lambda n: abs(far[n]))
            if len(names) > 1:
                curves.append(
                    [self.at(far[n], shot.after_ms(shot.picks[n].time_ns)) for n in names]
                )
        return curves

    def marks(self, shot: Shot) -> tuple[dict[str, tuple[float, float]], ...]:
        """Return where true arrivals, picks that are right, and wrong ones are, by channel."""
        far = dict(zip(shot.names, shot.along.tolist(), strict=True))
        wrong = set(shot.wrong)
        true = {n: self.at(far[n], shot.after_ms(shot.truth[n])) for n in far if n in shot.truth}
        at = {
            n: self.at(far[n], shot.after_ms(shot.picks[n].time_ns)) for n in far if n in shot.picks
        }
        right = {n: point for n, point in at.items() if n not in wrong}
        return true, right, {n: at[n] for n in wrong}


def _apart(
    shot: Shot, places: Mapping[str, tuple[float, float]]
) -> list[tuple[tuple[float, float], str]]:
    """Return wrong picks that can be named without one name over another, the worst first."""
    labels: list[tuple[tuple[float, float], str]] = []
    for name in shot.wrong:
        x, y = places[name]
        if len(labels) < MOST_NAMED and all(abs(x - other[0]) > NAMED_APART for other, _ in labels):
            labels.append(((x, y - 9.0 if shot.error_ms(name) > 0 else y + 4.0), name))
    return labels


#: What is filled of a trace, and travel times of other shots.
_AREA, _BESIDE = 0x7C8896FF, 0x56606CFF
#: What lies over what.
_ORDER = {
    f"{SECTION}/grid": -5.0,
    f"{SECTION}/time": 10.0,
    f"{SECTION}/geophones": 10.0,
    f"{SECTION}/offsets": 10.0,
    f"{SECTION}/shot": 0.0,
    f"{SECTION}/area": 1.0,
    f"{SECTION}/wiggle": 2.0,
    f"{SECTION}/claim": 4.0,
    f"{SECTION}/truth": 5.0,
    f"{SECTION}/error": 6.0,
    f"{SECTION}/pick": 7.0,
    f"{SECTION}/wrong": 8.0,
    f"{SECTION}/lost": 9.0,
    f"{TRAVEL}/now": 5.0,
    f"{TRAVEL}/truth": 6.0,
    f"{TRAVEL}/pick": 7.0,
    f"{TRAVEL}/wrong": 8.0,
    f"{TRAVEL}/names": 9.0,
}
