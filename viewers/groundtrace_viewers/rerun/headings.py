"""Headings of a worn sensor: wrapped curves, their error beside what they claim, a dial.

Curves are drawn from -180 to 180 degrees and interrupted where they jump by a turn: the viewer
would draw a line across. The truth is interrupted at its holes, since what lies between two of its
directions is not known; errors are taken where it has one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np

from groundtrace.evaluation.matching import STEP_TOLERANCE_S
from groundtrace_codecs.events import (
    CandidateBlock,
    Disturbance,
    Heading,
    StageSpec,
    readable,
    unit_after,
)
from groundtrace_codecs.signals import NS_PER_S

from .context import View
from .decisions import worn
from .timeline import (
    DISTURBED,
    DISTURBED_SHADE,
    HEADING_COLOURS,
    OUTLINE,
    THRESHOLD,
    TRACE,
    TRUTH,
    Entity,
    Lane,
    strips_of,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import GateSpec

    from .context import ViewContext
    from .timeline import Timeline

    Array = NDArray[np.float64]
    Times = NDArray[np.int64]

HEADING, ERROR, COMPASS = "/heading", "/heading-error", "/heading-gates"
DIAL, NOW = "/heading-dial", "/heading-now"
DISTURBANCES = "/state/6-disturbances"
#: Longer without a heading, the curve is interrupted [ns].
PATIENCE_NS = 2_000_000_000
#: Directions of truth further apart than so many times the usual have a hole between them.
#: Chosen by judgement: two in a row may be lost.
HOLE = 3.0
#: Where the plot of headings ends [degrees], and that of gates [thresholds].
TURN, MOST_RATIO = 185.0, 3.0
#: Columns of a heading stage's frames that are headings [degrees], by one kind of sensor alone.
ALONE = ("gyroscope", "compass")
#: The dial is drawn so often, in long recordings less: at most so many times.
DIAL_NS, MOST_DIALS = 100_000_000, 18_000
#: While headings come, those at the cursor are told beside so many of the last pieces of frames.
LAST_BLOCKS = 8
#: An error is told that is beyond so many claimed deviations for so long [s]. Chosen by judgement.
BEYOND, LASTING_S = 3.0, 0.2
#: Half the side of the dial's view, the radius of its ring, and of what is in it.
DIAL_SIDE, RING, NEEDLE, WEDGE = 138.0, 100.0, 92.0, 80.0
#: A label stands this far below its point.
LABEL_UP = 5.0


def wrapped(degrees: Array) -> Array:
    """Return directions from -180 to 180 degrees."""
    signed_deg: Array = (np.asarray(degrees, np.float64) + 180.0) % 360.0 - 180.0
    return signed_deg


def cut(times: Times, *curves: Array, hole_ns: float) -> tuple[Times, list[Array]]:
    """Return curves, the first of them wrapped, that are interrupted where they are not known.

    Parameters
    ----------
    times
        Shape (n,) [ns].
    curves
        Each of shape (n,); the first is of directions [degrees].
    hole_ns
        They are interrupted where no time follows for longer [ns], and where the first jumps by a
        turn.
    """
    first, *others = curves
    jumps = np.abs(np.diff(wrapped(first))) > 180.0
    at = np.flatnonzero(jumps | (np.diff(times) > hole_ns)) + 1
    broken = [np.insert(np.asarray(c, np.float64), at, np.nan) for c in (wrapped(first), *others)]
    return np.insert(times, at, times[at - 1] + 1), broken


class Truth:
    """True headings, and where they have holes."""

    def __init__(self, times: Times, radians: Array) -> None:
        self.times = times
        self._unwrapped_deg = np.degrees(np.unwrap(radians))
        period_ns = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
        self.hole_ns = HOLE * period_ns

    def __len__(self) -> int:
        return len(self.times)

    @property
    def degrees(self) -> Array:
        """The headings."""
        return self._unwrapped_deg

    def at(self, times: Times) -> Array:
        """Return headings at times [degrees]; NaN in holes and outside."""
        if not len(self):
            return np.full(len(times), np.nan)
        after = np.clip(np.searchsorted(self.times, times), 1, max(len(self) - 1, 1))
        after = np.minimum(after, len(self) - 1)
        hole = self.times[after] - self.times[np.maximum(after - 1, 0)] > self.hole_ns
        outside = (times < self.times[0]) | (times > self.times[-1])
        heading_deg = np.interp(times, self.times, self._unwrapped_deg)
        return np.where(hole | outside, np.nan, wrapped(heading_deg))


class Frames(NamedTuple):
    """What a stage looked at: times, ratios of gates to thresholds, and headings alone [degrees].

    The ratio has shape (n, n_gates) and is above 1 where a gate fails.
    """

    times: Times
    ratio: Array
    value: Array
    alone: dict[str, Array]


def ratios(gates: Sequence[GateSpec], value: Array) -> Array:
    """Return how near values are to the thresholds of gates: above 1 where one fails.

    Parameters
    ----------
    gates
        Of the stage.
    value
        Shape (n, n_gates).
    """
    ratio = np.full(value.shape, np.nan)
    for column, gate in enumerate(gates):
        measured = value[:, column].astype(np.float64)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio[:, column] = (
                gate.threshold / measured if gate.at_least else measured / gate.threshold
            )
    clipped: Array = np.clip(ratio, 0.0, MOST_RATIO)
    return clipped


def _merged(parts: Sequence[Frames]) -> Frames | None:
    """Return frames as one, in the order of time; None of none."""
    if not parts:
        return None
    order = np.argsort(np.concatenate([f.times for f in parts]), kind="stable")
    names = [n for n in ALONE if all(n in frames.alone for frames in parts)]
    alone = {n: np.concatenate([f.alone[n] for f in parts])[order] for n in names}
    times = np.concatenate([f.times for f in parts])[order]
    ratio = np.concatenate([f.ratio for f in parts])[order]
    return Frames(times, ratio, np.concatenate([f.value for f in parts])[order], alone)


class HeadingView(View):
    """Logs headings in degrees, their error where truth is known, and a dial at the cursor.

    Those by gyroscope or compass alone come with the frames of their stage.
    """

    def __init__(self, context: ViewContext) -> None:
        self._context, self._timeline = context, context.timeline
        reference = sorted(
            (x.time_ns, x.value)
            for x in context.session.labels
            if x.kind == "heading" and x.value is not None
        )
        times = np.array([time for time, _ in reference], np.int64)
        self._truth = Truth(times, np.array([value for _, value in reference], np.float64))
        self._pending: dict[str, list[Heading]] = {}
        self._blocks: list[CandidateBlock] = []
        self._stages: list[str] = []
        self._ended: dict[str, tuple[int, float]] = {}
        self._headings: dict[str, list[Heading]] = {}
        self._frames: list[Frames] = []
        self._spec: StageSpec | None = None
        self._lane = Lane(self._timeline, DISTURBANCES, {"disturbed": DISTURBED})
        self._spans: list[Disturbance] = []

    fits = staticmethod(worn)

    def heading(self, heading: Heading) -> None:
        """Take a heading; those of a stage come in the order of time."""
        self._pending.setdefault(heading.stage, []).append(heading)

    def frames(self, block: CandidateBlock) -> None:
        """Take the frames of a stage; those with headings by one kind of sensor are drawn."""
        if block.spec.emits == "heading":
            self._blocks.append(block)

    def disturbance(self, disturbance: Disturbance) -> None:
        """Take a span in which the field is disturbed."""
        self._spans.append(disturbance)
        self._lane.add(disturbance.time_ns, "disturbed", disturbance.end_ns)

    def flush(self, before_ns: int | None = None) -> None:  # noqa: ARG002
        """Log the headings that are pending, and while somebody looks on the dial."""
        fresh = self._deciding(self._pending)
        for stage, headings in self._pending.items():
            times = np.array([h.time_ns for h in headings], np.int64)
            sigma = np.degrees([h.sigma_rad for h in headings])
            self._log(stage, times, np.degrees([h.heading_rad for h in headings]), sigma)
            self._headings.setdefault(stage, []).extend(headings)
        self._pending = {}
        for block in self._blocks:
            names = [column.name for column in block.spec.columns]
            alone = {
                name: block.value[:, names.index(name)].astype(np.float64)
                for name in ALONE
                if name in names
            }
            for name, degrees in alone.items():
                curve = f"{block.spec.stage}/{name}"
                self._log(curve, block.time_ns, degrees, np.zeros(len(degrees)))
            value = block.gate_value.astype(np.float64)
            ratio = ratios(block.spec.gates, value)
            self._frames.append(Frames(block.time_ns, ratio, value, alone))
            self._spec = block.spec
        self._blocks = []
        if fresh and self._context.watched:
            gates = self._spec.gates if self._spec is not None else ()
            self._story(fresh, self._frames[-LAST_BLOCKS:]).log_cursor(gates)

    def _deciding(self, headings: Mapping[str, list[Heading]]) -> list[Heading]:
        """Return the headings of the stage with the last word, else of the first one."""
        last = self._context.stages.last("heading")
        stage = (
            last.stage if last is not None and last.stage in headings else next(iter(headings), "")
        )
        return headings.get(stage, [])

    def _story(self, headings: Sequence[Heading], frames: Sequence[Frames]) -> _Story:
        return _Story(self._context, headings, self._truth, self._spans, _merged(frames))

    def close(self) -> None:
        """Log what is pending, what is disturbed, errors, and the dial."""
        self.flush()
        self._lane.flush()
        if self._headings:
            self._story(self._deciding(self._headings), self._frames).log(self._spec)

    def _begin(self, stage: str) -> None:
        if not self._stages and len(self._truth):
            self._log_truth()
        name = list(HEADING_COLOURS)[len(self._stages) % len(HEADING_COLOURS)]
        title = f"{stage.replace('/', ': ')} {name}"
        self._timeline.declare(Entity(f"{HEADING}/{stage}", "heading", title))
        self._stages.append(stage)

    def _log_truth(self) -> None:
        import rerun as rr

        style = rr.SeriesLines(names="truth", colors=np.array([TRUTH], np.uint32), widths=2.6)
        self._timeline.declare(Entity(f"{HEADING}/truth", "heading", "truth violet"), style)
        truth = self._truth
        times, [degrees] = cut(truth.times, truth.degrees, hole_ns=truth.hole_ns)
        self._timeline.scalars(f"{HEADING}/truth", times, degrees[:, np.newaxis])

    def _log(self, stage: str, times: Times, degrees: Array, sigma: Array) -> None:
        """Log a piece of a curve, which goes on from the piece before."""
        import rerun as rr

        if stage not in self._stages:
            self._begin(stage)
        before = self._ended.get(stage)
        self._ended[stage] = int(times[-1]), float(degrees[-1])
        if before is not None:
            times = np.insert(times, 0, before[0])
            degrees, sigma = np.insert(degrees, 0, before[1]), np.insert(sigma, 0, sigma[0])
        times, [degrees, sigma] = cut(times, degrees, sigma, hole_ns=PATIENCE_NS)
        if before is not None:
            times, degrees, sigma = times[1:], degrees[1:], sigma[1:]
        colours = list(HEADING_COLOURS.values())
        colour = colours[self._stages.index(stage) % len(colours)]
        rows = len(times)
        columns = rr.Measurements.columns(
            values=degrees,
            variances=np.nan_to_num(sigma) ** 2,
            units=["°"] * rows,
            colors=np.full(rows, colour, np.uint32),
            widths=np.full(rows, 1.5, np.float32),
            names=[stage] * rows,
        )
        self._timeline.send(f"{HEADING}/{stage}", times, columns)

    kinds: ClassVar = {Heading: heading, Disturbance: disturbance, CandidateBlock: frames}


@dataclass(frozen=True, slots=True)
class _Story:
    """What became of the headings of one stage: logged when all are known."""

    context: ViewContext
    headings: Sequence[Heading]
    truth: Truth
    spans: Sequence[Disturbance]
    frames: Frames | None

    def log(self, spec: StageSpec | None) -> None:
        """Log all of it."""
        times = np.array([h.time_ns for h in self.headings], np.int64)
        sigma = np.degrees([h.sigma_rad for h in self.headings])
        _shade(self._timeline, HEADING, self.spans, TURN)
        if len(self.truth):
            self._log_error(times, sigma)
        gates = spec.gates if spec is not None else ()
        if gates and self.frames is not None:
            self._log_gates(gates)
        self._log_spans(gates)
        self.log_cursor(gates)

    @property
    def _timeline(self) -> Timeline:
        return self.context.timeline

    def _log_error(self, known_ns: Times, sigma: Array) -> None:
        """Log heading minus truth, with twice what the headings claim as a band."""
        # what compares places with the truth is not imported before there is a heading
        import rerun as rr

        from groundtrace.evaluation.headings import heading_errors

        timeline, labels = self._timeline, self.context.session.labels
        times, radians = heading_errors(labels, self.headings, STEP_TOLERANCE_S)
        error = np.degrees(radians)
        valid = np.isfinite(error)
        if not valid.any():
            return
        claimed = np.interp(times, known_ns, np.nan_to_num(sigma))
        worst = int(np.nanargmax(np.abs(error)))
        rms = float(np.sqrt(np.nanmean(error**2)))
        inside = float(np.mean(np.abs(error[valid]) <= 2 * claimed[valid]))
        when = (times[worst] - timeline.start_ns) / NS_PER_S
        title = (
            f"Error [°]: rms {rms:.1f}, worst {error[worst]:+.1f} at {when:.1f} s; "
            f"{inside:.0%} in blue, the claimed ± 2 σ"
        )
        most = float(np.quantile(np.abs(error[valid]), 0.999))
        end = 1.2 * max(most, 2 * float(np.median(claimed)), 1.0)
        timeline.declare(Entity(ERROR, "heading-error", title, top=end, bottom=-end))
        _shade(timeline, ERROR, self.spans, end)
        step = max(len(known_ns) // MOST_DIALS, 5)
        band_ns, band = known_ns[::step], 2 * np.nan_to_num(sigma[::step])
        style = rr.SeriesLines(names="claimed ± 2 σ", colors=[_CLAIMED], widths=[0.01])
        timeline.static(f"{ERROR}/claimed", style)
        columns = rr.Measurements.columns(
            values=np.zeros(len(band)),
            variances=band**2,
            colors=np.full(len(band), _CLAIMED, np.uint32),
        )
        timeline.send(f"{ERROR}/claimed", band_ns, columns)
        style = rr.SeriesLines(names="error", colors=[TRACE], widths=1.2)
        timeline.static(f"{ERROR}/error", style)
        holes = np.flatnonzero(np.diff(times) > self.truth.hole_ns) + 1
        shown_ns = np.insert(times, holes, times[holes - 1] + 1)
        shown = np.insert(error, holes, np.nan)
        timeline.scalars(f"{ERROR}/error", shown_ns, shown[:, np.newaxis])
        _level(timeline, f"{ERROR}/zero", self.context.span_ns, 0.0, OUTLINE)
        self._tell_errors(times, error, claimed)

    def _tell_errors(self, times: Times, error: Array, claimed: Array) -> None:
        """Log a line where an error is more than is claimed, and the cursor opens at the first."""
        beyond = np.flatnonzero(np.abs(error) > BEYOND * claimed)
        if not len(beyond):
            return
        apart = np.flatnonzero(np.diff(times[beyond]) > NS_PER_S) + 1
        for group in np.split(beyond, apart):
            first, last = int(times[group[0]]), int(times[group[-1]])
            if last - first < LASTING_S * NS_PER_S:
                continue
            worst = group[int(np.argmax(np.abs(error[group])))]
            off = abs(error[worst]) / max(claimed[worst], 1e-9)
            text = (
                f"{self._timeline.seconds(first)}  error {error[worst]:+.1f}°, {off:.1f} times the "
                f"claimed σ, for {(last - first) / NS_PER_S:.2f} s"
            )
            self.context.lines.add("heading", first, text, "WARN")
            self.context.opens(first)

    def _log_gates(self, gates: Sequence[GateSpec]) -> None:
        """Log the worst of the compass's gates, as a part of its threshold."""
        import rerun as rr

        if self.frames is None:
            return
        timeline = self._timeline
        title = "Compass: worst gate, value / threshold; above 1 it is not used"
        timeline.declare(Entity(COMPASS, "heading-gates", title, len(gates), top=MOST_RATIO))
        worst = np.nanmax(np.nan_to_num(self.frames.ratio), axis=1)
        style = rr.SeriesLines(names="worst gate", colors=[TRACE], widths=1.2)
        timeline.static(f"{COMPASS}/worst", style)
        timeline.scalars(f"{COMPASS}/worst", self.frames.times, worst[:, np.newaxis])
        _level(timeline, f"{COMPASS}/threshold", self.context.span_ns, 1.0, THRESHOLD)
        _shade(timeline, COMPASS, self.spans, MOST_RATIO)

    def _log_spans(self, gates: Sequence[GateSpec]) -> None:
        """Log a line for each disturbance that was found or missed."""
        labels, seconds = self.context.session.labels, self._timeline.seconds
        true = [(x.time_ns, x.end_ns) for x in labels if x.kind == "disturbed" and x.end_ns]
        for span in self.spans:
            met = any(start < span.end_ns and end > span.time_ns for start, end in true)
            lasts = (span.end_ns - span.time_ns) / NS_PER_S
            text = f"{seconds(span.time_ns)}  disturbed for {lasts:.2f} s{self._gate(span, gates)}"
            text += "" if met or not labels else "; truth has none"
            level = "INFO" if met or not labels else "WARN"
            self.context.lines.add("heading", span.time_ns, text, level)
        for start, end in true:
            if not any(s.time_ns < end and s.end_ns > start for s in self.spans):
                lasts = (end - start) / NS_PER_S
                text = f"{seconds(start)}  disturbance of {lasts:.2f} s missed"
                self.context.lines.add("heading", start, text, "ERROR")

    def _gate(self, span: Disturbance, gates: Sequence[GateSpec]) -> str:
        """Return which gate was furthest beyond its threshold in a span, as a phrase."""
        if self.frames is None or not gates:
            return ""
        first, last = np.searchsorted(self.frames.times, [span.time_ns, span.end_ns])
        part = np.nan_to_num(self.frames.ratio[first : max(last, first + 1)])
        if not part.size or part.max() <= 1.0:
            return ""
        row, column = np.unravel_index(int(part.argmax()), part.shape)
        value = self.frames.value[first + int(row), int(column)]
        return f": {_compared(gates[int(column)], float(value))}"

    def log_cursor(self, gates: Sequence[GateSpec]) -> None:
        """Log the dial and the words at the cursor."""
        import rerun as rr

        timeline = self._timeline
        times = np.array([h.time_ns for h in self.headings], np.int64)
        degrees = np.degrees([h.heading_rad for h in self.headings])
        sigma = np.degrees([h.sigma_rad for h in self.headings])
        start_ns, end_ns = int(times[0]), int(times[-1])
        step_ns = max(DIAL_NS, (end_ns - start_ns) // MOST_DIALS)
        now = np.arange(start_ns, end_ns + 1, step_ns)
        rows = np.clip(np.searchsorted(times, now), 0, len(times) - 1)
        true = self.truth.at(times[rows])
        timeline.declare(Entity(DIAL, "dial", f"Heading: green ± 2 σ{self._key}"))
        _log_ring(timeline)
        _log_needles(timeline, now, degrees[rows], np.nan_to_num(sigma[rows]))
        path, valid = f"{DIAL}/truth", np.isfinite(true)
        timeline.static(path, rr.LineStrips2D.from_fields(colors=TRUTH, radii=-2.6, draw_order=1.0))
        lines = [[(0.0, 0.0), _at(d, RING)] for d in true[valid].tolist()]
        columns = rr.LineStrips2D.columns(strips=strips_of(lines) if lines else [])
        timeline.send(path, now, columns.partition(valid.astype(np.int64).tolist()))
        texts = [
            self._words(int(n), float(degrees[r]), float(sigma[r]), float(t), gates)
            for n, r, t in zip(now[::5], rows[::5], true[::5], strict=True)
        ]
        timeline.declare(Entity(NOW, "card", "Heading at the cursor"))
        columns = rr.TextDocument.columns(text=texts, media_type=["text/markdown"] * len(texts))
        timeline.send(NOW, now[::5], columns)

    @property
    def _key(self) -> str:
        return ", truth violet" if len(self.truth) else ""

    def _words(
        self, now_ns: int, degrees: float, sigma: float, true: float, gates: Sequence[GateSpec]
    ) -> str:
        """Return what is known at a moment, as markdown."""
        is_known, direction = sigma < UNKNOWN_DEG, f"{wrapped(np.array(degrees)):+.1f}°"
        lines = [f"**Heading {direction} ± {sigma:.1f}°**"]
        if not is_known:
            lines = [f"**Heading not known**: {direction} from an unknown beginning"]
        if len(self.truth):
            error = float(wrapped(np.array(degrees - true)))
            off = f" ({abs(error) / sigma:.1f} σ)" if is_known and sigma > 0 else ""
            error_text = f"truth {true:+.1f}°, **error {error:+.1f}°**{off}"
            lines.append(error_text if math.isfinite(true) else "no truth here")
        frames = self.frames
        if frames is not None and len(frames.times):
            row = int(np.argmin(np.abs(frames.times - now_ns)))
            if abs(int(frames.times[row]) - now_ns) > FRAME_NS:
                return "  \n".join([*lines, "no field is tested here"])
            alone = [
                f"{name} alone {wrapped(value[row : row + 1])[0]:+.1f}°"
                for name, value in frames.alone.items()
                if math.isfinite(value[row])
            ]
            lines += [", ".join(alone)] if alone else []
            lines += [self._used(now_ns, row, gates)] if gates else []
        return "  \n".join(lines)

    def _used(self, now_ns: int, row: int, gates: Sequence[GateSpec]) -> str:
        """Say whether the compass is used, by the gate nearest to its threshold."""
        if self.frames is None:
            return ""
        part = np.nan_to_num(self.frames.ratio[row])
        column = int(part.argmax())
        gate_text = _compared(gates[column], float(self.frames.value[row, column]))
        if part[column] > 1.0:
            return f"**compass not used**: {gate_text}"
        if any(s.time_ns <= now_ns < s.end_ns for s in self.spans):
            return "**compass not used**: disturbed until it is calm for long enough"
        return f"compass used; nearest gate {gate_text}"


#: A deviation from which on a heading is not known [degrees]. Source: definition, half a turn.
UNKNOWN_DEG = 180.0
#: A frame is no longer than this [ns]. Source: the largest ``frame_s`` of a heading.
FRAME_NS = NS_PER_S // 2
#: What headings claim.
_CLAIMED = 0x56B4E9FF


def _compared(gate: GateSpec, value: float) -> str:
    """Return a gate's value beside its threshold."""
    sign = ">" if value > gate.threshold else "<"
    unit = unit_after(gate.unit)
    return f"{gate.name} {readable(value, 3)} {sign} {readable(gate.threshold)}{unit}"


def _at(degrees: float, radius: float) -> tuple[float, float]:
    """Return a place on the dial, whose y points down: east to the right, north up."""
    turn = math.radians(degrees)
    return radius * math.cos(turn), -radius * math.sin(turn)


def _log_ring(timeline: Timeline) -> None:
    import rerun as rr

    ring = [_at(d, RING) for d in range(0, 361, 3)]
    marks = [[_at(d, NEEDLE), _at(d, RING)] for d in range(0, 360, 15)]
    drawn = rr.LineStrips2D([ring, *marks], colors=OUTLINE, radii=-0.7, draw_order=-2.0)
    timeline.static(f"{DIAL}/ring", drawn)
    names = {0.0: "0° E", 90.0: "90° N", 180.0: "180° W", -90.0: "-90° S"}
    places = [(_at(d, 1.2 * RING)[0], _at(d, 1.14 * RING)[1] - LABEL_UP) for d in names]
    words = rr.Points2D(
        places, labels=list(names.values()), show_labels=True, radii=0.0, colors=OUTLINE
    )
    timeline.static(f"{DIAL}/words", words)


def _log_needles(timeline: Timeline, now: Times, degrees: Array, sigma: Array) -> None:
    """Log an arrow along each heading, and a wedge of twice its deviation to either side."""
    import rerun as rr

    path, colour = f"{DIAL}/needle", HEADING_COLOURS["green"]
    timeline.static(path, rr.LineStrips2D.from_fields(colors=colour, radii=-1.3, draw_order=2.0))
    turn = np.radians(degrees)[:, np.newaxis]
    spread = np.radians(2 * np.minimum(sigma, 90.0))[:, np.newaxis] * np.linspace(-1, 1, 9)
    arc = turn + spread
    edge = WEDGE * np.stack([np.cos(arc), -np.sin(arc)], axis=2)
    middle = np.zeros((len(now), 1, 2))
    wedges = np.concatenate([middle, edge, middle], axis=1)
    tip = np.array(
        [(0.0, 0.0), (NEEDLE, 0.0), (NEEDLE - 9, 4.5), (NEEDLE, 0.0), (NEEDLE - 9, -4.5)]
    )
    cos, sin = np.cos(turn), np.sin(turn)
    arrows = np.stack(
        [tip[:, 0] * cos - tip[:, 1] * sin, -(tip[:, 0] * sin + tip[:, 1] * cos)], axis=2
    )
    lines = [line for pair in zip(wedges, arrows, strict=True) for line in pair]
    columns = rr.LineStrips2D.columns(strips=strips_of(lines)).partition([2] * len(now))
    timeline.send(path, now, columns)


def _level(
    timeline: Timeline, path: str, span_ns: tuple[int, int], value: float, colour: int
) -> None:
    """Log a line across a plot, which keeps its axis to the recording."""
    import rerun as rr

    timeline.static(
        path, rr.SeriesLines(names=path.rpartition("/")[2], colors=[colour], widths=1.0)
    )
    timeline.level(path, span_ns, value)


def _shade(timeline: Timeline, root: str, spans: Sequence[Disturbance], end: float) -> None:
    """Log a band over each span: that of measurements whose deviation covers the plot."""
    import rerun as rr

    times: list[int] = []
    end_ns = 0
    for span in sorted(spans, key=lambda s: s.time_ns):
        start_ns = max(span.time_ns, end_ns)
        if span.end_ns > start_ns:
            times += [start_ns, span.end_ns - 1, span.end_ns]
            end_ns = span.end_ns + 1
    rows = len(times)
    if not rows:
        return
    columns = rr.Measurements.columns(
        values=np.tile([0.0, 0.0, math.nan], rows // 3),
        variances=np.full(rows, end**2),
        units=[""] * rows,
        colors=np.full(rows, DISTURBED_SHADE, np.uint32),
        widths=np.zeros(rows, np.float32),
        names=["disturbed"] * rows,
    )
    timeline.send(f"{root}/disturbed", times, columns)
