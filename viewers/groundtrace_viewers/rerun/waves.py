"""The waves of the step at the cursor: every channel, what was picked of it, and what was not.

All are scaled alike and cut, by the channel in the middle, so that weak channels are seen to be
weak beside the others of that step, and a soft step as large as a loud one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from groundtrace_codecs.events import CandidateBlock, StepEvent, readable
from groundtrace_codecs.signals import SEISMIC_QUANTITIES, SignalBlock

from .context import View
from .sketch import Sketch, crosses, ticks
from .timeline import ACCEPTED, FAINT, MISSED, OUTLINE, TRACE, TRUTH, Entity
from .wrong_decisions import TOLERANCE_NS

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from .context import ViewContext
    from .timeline import Line

    Array = NDArray[np.float64]

WAVES = "/waves"
#: What is shown before and after a step [ns], and how long before it the drawing is there.
BEFORE_NS, AFTER_NS, AHEAD_NS = 20_000_000, 100_000_000, 60_000_000
#: A pick so long before or after a step is of it [ns]. Chosen by judgement: a wave crosses a room
#: in less.
EARLY_NS, LATE_NS = 10_000_000, 60_000_000
#: Width and height of the drawing, in units of its view.
WIDE, HIGH = 280.0, 100.0
#: Of more samples of a trace than this neighbours are averaged; of more steps than this only wrong
#: ones are drawn, and of those so many.
MOST_SAMPLES, MOST_STEPS = 240, 100
#: The largest deflection in distances between traces; samples are kept in so many steps of it.
DEFLECTION, LEVELS = 0.62, 127
LABEL_UP = 4.0
#: Of more traces than this, those that picked are named in turn: names would lie on each other.
MOST_NAMED = 12


class Wave(NamedTuple):
    """The waves of a step: times [ms after it], channels, and traces of shape (n, n_channels)."""

    topic: str
    names: list[str]
    times: Array
    values: NDArray[np.int8]


class ArrivalAt(NamedTuple):
    """What a channel had at a step: when [ns], the value of its gate, and whether it passed."""

    time_ns: int
    value: float
    picked: bool


def scaled(values: Array) -> NDArray[np.int8]:
    """Return traces scaled to the channel in the middle and cut, in :data:`LEVELS` steps."""
    swing = values - np.median(values, axis=0)
    most = float(np.median(np.abs(swing).max(axis=0))) or 1.0
    cut: NDArray[np.int8] = np.rint(np.clip(swing / most, -1.0, 1.0) * LEVELS).astype(np.int8)
    return cut


def averaged(times: Array, values: Array) -> tuple[Array, Array]:
    """Return at most :data:`MOST_SAMPLES` samples, each the mean of neighbours: less noise."""
    size = -(-len(times) // MOST_SAMPLES)
    count = len(times) // size
    means: Array = values[: count * size].reshape(count, size, -1).mean(axis=1)
    return times[: count * size].reshape(count, size).mean(axis=1), means


class StepWaves(View):
    """The waves of every step, or of wrong ones, with picks, candidates below, and truth."""

    def __init__(self, context: ViewContext) -> None:
        self._context = context
        labels = context.session.labels
        self._true = np.unique([x.time_ns for x in labels if x.kind in ("step", "impact")])
        self._next = 0
        self._waves: dict[int, list[Wave]] = {}
        self._steps_ns: list[int] = []
        self._candidates: list[CandidateBlock] = []
        self._streams: dict[str, list[int]] = {}
        self._drawn_ns: int | None = None
        self._unanswered: list[int] = []
        self._ended_ns = 0

    @staticmethod
    def fits(context: ViewContext) -> bool:
        """Whether steps in a room are replayed, and truth says when they were, or they come now."""
        has_truth = any(x.kind in ("step", "impact") for x in context.session.labels)
        return context.session.application == "room" and (has_truth or context.session.live)

    def signal(self, block: SignalBlock) -> None:
        """Take a block: the waves of steps that end before its end are there."""
        columns = block.stream.columns_of(SEISMIC_QUANTITIES)
        if len(columns) < 2:
            return
        self._streams.setdefault(block.topic, columns)
        while self._next < len(self._true):
            time_ns = int(self._true[self._next])
            if time_ns + AFTER_NS > block.end_ns:
                break
            self._keep(time_ns)
            self._next += 1
        self._ended_ns = max(self._ended_ns, block.end_ns)
        self._keep_answers(self._ended_ns)

    def _keep_answers(self, end_ns: int) -> None:
        """Keep the waves of steps that answer no true one, once they are there."""
        there = [t for t in self._unanswered if t + AFTER_NS <= end_ns]
        for time_ns in there:
            self._keep(time_ns)
            self._unanswered.remove(time_ns)

    def step(self, step: StepEvent) -> None:
        """Take a step; of those that answer no true one the waves are kept as well."""
        if not self._context.stages.decides("step", step):
            return
        self._steps_ns.append(step.time_ns)
        if not len(self._true) or np.abs(self._true - step.time_ns).min() > TOLERANCE_NS:
            self._unanswered.append(step.time_ns)
            self._keep_answers(self._ended_ns)

    def candidates(self, block: CandidateBlock) -> None:
        """Keep what channels picked, and what they did not."""
        if block.spec.emits == "pick" and block.spec.gates and block.spec.trace:
            self._candidates.append(block)

    def _keep(self, time_ns: int) -> None:
        """Keep the waves of a step, of all streams that have some."""
        for topic, columns in self._streams.items():
            span = time_ns - BEFORE_NS, time_ns + AFTER_NS
            piece = self._context.traces.between(topic, *span, columns)
            if piece is None or len(piece[0]) < 2:
                continue
            channels = self._context.traces.blocks(topic, *span)[0].stream.channels
            names = [channels[i].name for i in columns]
            times, values = averaged((piece[0] - time_ns) / 1e6, piece[1])
            self._waves.setdefault(time_ns, []).append(Wave(topic, names, times, scaled(values)))

    def flush(self, before_ns: int | None = None) -> None:
        """Draw those of steps before a time while somebody looks on: they are decided."""
        context = self._context
        if before_ns is None or not context.watched or context.stages.last("step") is None:
            return
        steps_ns = set(self._steps_ns)
        self._draw_all([t for t in sorted(self._waves) if t in steps_ns or t < before_ns])
        # a replay that goes on for days keeps nothing that is drawn
        recent = [b for b in self._candidates if b.time_ns[-1] >= before_ns - LATE_NS]
        self._candidates = recent or self._candidates[-1:]
        self._steps_ns = [t for t in self._steps_ns if t >= before_ns - LATE_NS]

    def close(self) -> None:
        """Draw them, where a stage finds steps."""
        self._keep_answers(self._ended_ns + AFTER_NS)
        times = sorted(self._waves)
        if self._context.stages.last("step") is None or not times:
            return
        if len(times) > MOST_STEPS:
            times = [t for t in times if self._wrong(t)][:MOST_STEPS]
        self._draw_all(times)

    def _draw_all(self, times: Sequence[int]) -> None:
        """Draw the waves of steps, each once."""
        for time_ns in times:
            last_ns = self._drawn_ns
            ahead = AHEAD_NS if last_ns is None else min(AHEAD_NS, abs(time_ns - last_ns) // 2)
            when = time_ns - ahead
            if last_ns is None:
                when = min(self._context.span_ns[0], time_ns)
            self._draw(time_ns, when)
            self._drawn_ns = time_ns
            del self._waves[time_ns]

    def _wrong(self, time_ns: int) -> bool:
        """Whether a true step was not found at its time, or a found one is none."""
        steps_ns = np.array(self._steps_ns, np.int64)
        near = len(steps_ns) and np.abs(steps_ns - time_ns).min() <= TOLERANCE_NS
        return not near or time_ns not in self._true

    def _arrivals_at(self, time_ns: int) -> dict[tuple[str, str], ArrivalAt]:
        """Return what each topic and channel had at a step: its pick, else its best candidate."""
        arrivals: dict[tuple[str, str], ArrivalAt] = {}
        for block in self._candidates:
            first, last = np.searchsorted(block.time_ns, [time_ns - EARLY_NS, time_ns + LATE_NS])
            for row in range(int(first), int(last)):
                name = block.spec.topic, block.spec.channels[int(block.channel[row])]
                value, picked = float(block.gate_value[row, 0]), bool(block.accepted[row])
                before = arrivals.get(name)
                if before is None or (picked, value) > (before.picked, before.value):
                    arrivals[name] = ArrivalAt(int(block.time_ns[row]), value, picked)
        return arrivals

    def _draw(self, time_ns: int, when_ns: int) -> None:
        """Draw the waves of a step."""
        waves, timeline = self._waves[time_ns], self._context.timeline
        rows = [(wave, column) for wave in waves for column in range(len(wave.names))]
        gate = self._candidates[0].spec.gates[0] if self._candidates else None
        what = f"; {gate.name} of {gate.threshold:g} needed" if gate is not None else ""
        title = f"Waves of the step at the cursor [ms]: ● pick × below + truth{what}"
        timeline.declare(Entity(WAVES, "waves", title, len(rows)))
        sketch, when = Sketch(timeline, _ORDER), [when_ns]
        apart = HIGH / (len(rows) + 1.0)
        height = {
            (wave.topic, wave.names[column]): apart * (index + 1.0)
            for index, (wave, column) in enumerate(rows)
        }
        lines: list[Line] = []
        for wave, column in rows:
            middle = height[wave.topic, wave.names[column]]
            swing = wave.values[:, column].astype(np.float64) / LEVELS
            down = middle - DEFLECTION * apart * swing
            lines.append(np.stack([_across(wave.times), down], axis=1))
        sketch.lines(f"{WAVES}/trace", when, [lines], TRACE, -0.7)
        marks = ticks(AFTER_NS / 1e6)
        at = [float(_across(np.array(m))) for m in marks if m <= AFTER_NS / 1e6]
        grid: list[Line] = [[(x, 0.0), (x, HIGH)] for x in at]
        sketch.lines(f"{WAVES}/grid", when, [grid], FAINT, -0.5)
        below = [((x, HIGH - 1.0), f"{m:g}") for x, m in zip(at, marks, strict=False)]
        sketch.words(f"{WAVES}/time", when, [below], OUTLINE)
        self._draw_heard(sketch, when, time_ns, height)

    def _draw_heard(
        self,
        sketch: Sketch,
        when: list[int],
        time_ns: int,
        height: Mapping[tuple[str, str], float],
    ) -> None:
        """Draw what each channel had, its name and value, and the true arrivals."""
        arrivals = self._arrivals_at(time_ns)
        positions = {
            name: (float(_across(np.array((one.time_ns - time_ns) / 1e6))), height[name])
            for name, one in arrivals.items()
            if name in height
        }
        picked = [positions[n] for n in positions if arrivals[n].picked]
        lost = [positions[n] for n in positions if not arrivals[n].picked]
        sketch.points(f"{WAVES}/picked", when, [picked], ACCEPTED, -4.5)
        sketch.lines(f"{WAVES}/below", when, [crosses(lost, 2.0, upright=False)], MISSED, -1.6)
        of_step = {
            x.channel: float(_across(np.array((x.time_ns - time_ns) / 1e6)))
            for x in self._context.session.labels
            if x.kind == "pick" and -BEFORE_NS <= x.time_ns - time_ns < LATE_NS
        }
        true = [(of_step[name], y) for (_, name), y in height.items() if name in of_step]
        sketch.lines(f"{WAVES}/truth", when, [crosses(true, 2.6, upright=True)], TRUTH, -1.1)
        named = list(height)[:: 1 if len(height) <= MOST_NAMED else 2]
        for what, colour, wanted in (
            ("yes", ACCEPTED, [n for n in height if n in arrivals and arrivals[n].picked]),
            ("no", MISSED, [n for n in height if n not in arrivals or not arrivals[n].picked]),
        ):
            wanted = [n for n in wanted if what == "no" or n in named]
            names = [((-12.0, height[n] - LABEL_UP), n[1]) for n in wanted]
            values = [
                (
                    (WIDE + 12.0, height[n] - LABEL_UP),
                    readable(arrivals[n].value, 3) if n in arrivals else "-",
                )
                for n in wanted
            ]
            sketch.words(f"{WAVES}/{what}", when, [names + values], colour)

    kinds: ClassVar[Mapping[type[Any], Callable[[Any, Any], None]]] = {
        SignalBlock: signal,
        StepEvent: step,
        CandidateBlock: candidates,
    }


def _across(times: Array) -> Array:
    """Return where times are drawn [ms after the step]."""
    part: Array = (times + BEFORE_NS / 1e6) / ((BEFORE_NS + AFTER_NS) / 1e6)
    return WIDE * part


#: What lies over what.
_ORDER = {
    f"{WAVES}/{name}": float(layer)
    for layer, name in enumerate(
        ("grid", "trace", "truth", "below", "picked", "time", "yes", "no"),
    )
}
