"""One walker's steps and signal, followed until each step's type is known."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from scipy import signal

from groundtrace_codecs.signals import NS_PER_S

from ..detectors.filters import StreamingFilter, corner, phase_delay_s
from ..detectors.walking import NOMINAL_CADENCE_HZ
from ..nonfinite import Holder
from .axes import BodyAxes
from .chains import AFTER, BEFORE
from .corrections import LINKED, linked

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from groundtrace_codecs.events import StepEvent
    from groundtrace_codecs.signals import SignalBlock, Stream

    from .classifier import StepTypes
    from .corrections import Shape

#: Order of the low-pass (EPFL).
ORDER = 3
#: Steps nearer or further apart say nothing of the step time [s].
SHORTEST_STEP_S, LONGEST_STEP_S = 0.2, 2.0
#: Step time before anything tells it [s].
USUAL_STEP_S = 0.6


def smoothing(cutoff_hz: float, rate_hz: float) -> NDArray[np.float64]:
    """Design the low-pass of all three axes, a Butterworth filter of order 3.

    Source: EPFL, 4 Hz at 30 Hz. It delays by 2.3 to 3.4 samples there, not by "its 4 coefficients"
    as printed; here the delay at the usual cadence is taken out of the times.

    Returns
    -------
    Second-order sections, shape (2, 6).
    """
    hz = corner(cutoff_hz, rate_hz)
    return np.asarray(signal.butter(ORDER, hz, fs=rate_hz, output="sos"))


@dataclass(slots=True)
class _Signal:
    """The body's accelerations, low-passed, as far back as steps may ask."""

    axes: BodyAxes
    filter: StreamingFilter
    delay_ns: int
    holder: Holder = field(default_factory=Holder)
    time_ns: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    values: NDArray[np.float64] = field(default_factory=lambda: np.empty((3, 0)))

    @property
    def end_ns(self) -> int:
        """Time of the last sample [ns]."""
        return int(self.time_ns[-1])

    def add(self, block: SignalBlock) -> None:
        """Take a block."""
        part = self.axes(self.holder.held(block))
        self.time_ns = np.concatenate([self.time_ns, part.time_ns - self.delay_ns])
        self.values = np.concatenate([self.values, self.filter(part.values)], axis=1)

    def forget_before(self, time_ns: int) -> None:
        """Drop the samples before a time."""
        first = int(np.searchsorted(self.time_ns, time_ns))
        self.time_ns, self.values = self.time_ns[first:], self.values[:, first:]


class Follower:
    """Takes signal and steps of one stream in any order; gives each step's candidates in time.

    A step's candidates need the two steps after it, measured, or to be sure that none follow.

    Parameters
    ----------
    worker
        Measures steps.
    """

    def __init__(self, worker: StepTypes) -> None:
        self.worker = worker
        self._forward = worker.parameters.forward
        self._signal: _Signal | None = None
        self._steps: list[StepEvent] = []  # not measured
        self._waiting: list[StepEvent] = []  # measured, not told
        self._shapes: list[Shape] = []  # of up to two that were told, and of those that wait

    def hear(self, block: SignalBlock) -> None:
        """Take the next block of the run."""
        if self._signal is None:
            self._signal = self._begin(block.stream)
        self._signal.add(block)
        self._forward = self._signal.axes.forward

    def step(self, step: StepEvent) -> None:
        """Take the next step."""
        self._steps.append(step)

    def told(self, *, final: bool = False) -> Iterator[tuple[StepEvent, list[tuple[float, ...]]]]:
        """Yield the steps whose candidates are known by now, and these row by row.

        That is all steps where the run ends.
        """
        run = self._signal
        if run is None or not len(run.time_ns):
            return
        while (step_s := self._measurable(run, final=final)) is not None:
            self._measure(run, step_s)
        while self._waiting and (final or self._surrounded(run)):
            place = len(self._shapes) - len(self._waiting)
            shapes = self._shapes
            found = self.worker.rows(shapes[:place], shapes[place], shapes[place + 1 :])
            del shapes[: max(0, place - 1)]
            yield self._waiting.pop(0), found
        self._forget(run)

    def end(self) -> None:
        """Forget the signal and the steps; what is known of the mounting stays."""
        self._signal = None
        self._steps, self._waiting, self._shapes = [], [], []

    def _begin(self, stream: Stream) -> _Signal:
        p = self.worker.parameters
        sos = smoothing(p.cutoff_hz, stream.rate_hz)
        delay_s = phase_delay_s(sos, NOMINAL_CADENCE_HZ, stream.rate_hz)
        axes = BodyAxes(stream, self._forward, p.gravity_s)
        return _Signal(axes, StreamingFilter(sos), round(delay_s * NS_PER_S))

    def _measurable(self, run: _Signal, *, final: bool) -> float | None:
        """Return the step time around the next step [s]; None while it must wait."""
        if not self._steps:
            return None
        time_ns = self._steps[0].time_ns
        if not (final or len(self._steps) > 1 or run.end_ns >= time_ns + self._late_ns):
            return None
        near = [shape.time_ns for shape in self._shapes[-1:]]
        near += [step.time_ns for step in self._steps[1:2]]
        apart = [abs(other_ns - time_ns) / NS_PER_S for other_ns in near]
        step_s = min((s for s in apart if SHORTEST_STEP_S <= s <= LONGEST_STEP_S), default=None)
        if step_s is None:
            step_s = self._shapes[-1].step_s if self._shapes else USUAL_STEP_S
        needed_ns = time_ns + round(AFTER * step_s * NS_PER_S)
        return step_s if final or run.end_ns >= needed_ns else None

    def _measure(self, run: _Signal, step_s: float) -> None:
        step = self._steps.pop(0)
        reach_ns = round((BEFORE + 0.5) * step_s * NS_PER_S)
        low = run.time_ns.searchsorted(step.time_ns - reach_ns)
        high = run.time_ns.searchsorted(step.time_ns + reach_ns)
        near = slice(max(0, min(int(low), len(run.time_ns) - 1)), max(int(high), 1))
        times_s = (run.time_ns[near] - step.time_ns) / NS_PER_S
        shape = self.worker.shape(step.time_ns, step_s, times_s, run.values[:, near])
        self._shapes.append(shape)
        self._waiting.append(step)

    def _surrounded(self, run: _Signal) -> bool:
        """Return whether all steps that count after the first that waits are measured."""
        place = len(self._shapes) - len(self._waiting)
        step, after = self._shapes[place], self._shapes[place + 1 :]
        if len(after) >= 2 or len(linked(step, after)) < len(after):
            return True
        last = self._shapes[-1]
        if self._steps:
            return self._steps[0].time_ns - last.time_ns > LINKED * last.step_s * NS_PER_S
        return run.end_ns >= last.time_ns + self._late_ns

    @property
    def _late_ns(self) -> int:
        return round(self.worker.parameters.late_s * NS_PER_S)

    def _forget(self, run: _Signal) -> None:
        """Drop signal that no step can ask for any more."""
        oldest_ns = run.end_ns - self._late_ns
        if self._steps:
            oldest_ns = min(oldest_ns, self._steps[0].time_ns)
        run.forget_before(oldest_ns - round((BEFORE + 0.5) * LONGEST_STEP_S * NS_PER_S))
