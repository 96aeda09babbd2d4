"""The stages that find headings: the streams of one body-worn sensor are fused."""

from __future__ import annotations

from itertools import repeat
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.events import Disturbance, Heading, Note
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

from .gates import Candidates
from .heading.aligned import Aligner, columns_of_axes
from .heading.api import HeadingFrames
from .heading.compass import COLUMNS, GATES
from .heading.disturbed_spans import DisturbedSpans
from .heading.parameters import HeadingParameters
from .later import Later
from .stage import CannotStart, Context, Input, Stage

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from groundtrace_codecs.events import CandidateBlock, Event

    from .heading import frame_kernels
    from .heading.api import HeadingFilter, HeadingFrame
    from .heading.estimator import HeadingEstimator
    from .stage import Output
else:
    frame_kernels = Later("groundtrace.heading.frame_kernels")


class HeadingStage(Stage):
    """Runs a heading filter on every sensor with a gyroscope and an accelerometer.

    Streams of one placement are one sensor: its magnetometer may have a topic of its own. Each
    frame is a candidate, accepted where the field is undisturbed. A gap of the gyroscope that is
    not bridged, and a step of its clock, begin anew; other gaps leave the field or the force out.

    Notes
    -----
    ``Parameters`` has ``output_hz`` and ``join_s``.
    """

    takes = (
        Input(SignalBlock, frozenset({"angular_velocity"}), hold=False),
        Input(SignalBlock, frozenset({"acceleration"}), hold=False),
        Input(SignalBlock, frozenset({"magnetic_field"}), hold=False, required=False),
    )
    gives = (Heading, Disturbance)
    scope = "placement"
    rounds = ("angular_velocity",)

    def __init__(self, parameters: Any) -> None:
        self.parameters = parameters

    def filter(self, rate_hz: float) -> HeadingFilter:
        """Return a filter of samples at a rate [Hz]."""
        raise NotImplementedError

    def start(self, context: Context) -> tuple[str, ...]:
        """Begin with a gyroscope."""
        if not columns_of_axes(context.stream, "angular_velocity"):
            raise CannotStart
        self._stage, self._topic = context.stage, context.topic
        self._period_ns = context.stream.period_ns
        self._filter = self.filter(context.stream.rate_hz)
        self._spans = DisturbedSpans(context.stage, round(self.parameters.join_s * NS_PER_S))
        self._aligner = Aligner()
        self._due_ns: int | None = None
        self._told: frozenset[str] = frozenset()
        self._turning = False
        return ("field",)

    def process(self, block: SignalBlock) -> Iterator[Output]:
        """Take what a stream measures; the first of the gyroscope begins it all."""
        self._aligner.hear(block)
        if not self._turning and not columns_of_axes(block.stream, "angular_velocity"):
            return
        self._turning = True
        remark = self._aligner.remark
        if remark and remark not in self._told:
            self._told |= {remark}
            yield Note(block.start_ns, remark, "WARN", self._stage)
        yield from self._frames(self._filter.add(self._aligner.take()))

    def flush(self) -> Iterator[Output]:
        """End the run."""
        yield from self._frames([*self._filter.add(self._aligner.finish()), *self._filter.finish()])
        yield from self._spans.finish()

    def decided(self, block: CandidateBlock) -> Sequence[Event]:  # noqa: ARG002
        """Yield nothing: whether the field is undisturbed is known to the filter already."""
        return ()

    def _frames(self, given: Sequence[HeadingFrame]) -> Iterator[Output]:
        """Yield what frames say: the tests of the field, disturbances, headings, notes."""
        if not given:
            return
        frames = given if isinstance(given, HeadingFrames) else HeadingFrames.of(given)
        tested = np.flatnonzero(frames.compass)
        if len(tested):
            yield Candidates(
                frames.time_ns[frames.first[tested]],
                np.zeros(len(tested), np.int32),
                frames.values[tested].astype(np.float32),
            )
        yield from self._disturbances(frames)
        yield from self._headings(frames)
        yield from self._notes(frames)

    def _disturbances(self, frames: HeadingFrames) -> Iterator[Event]:
        """Yield the disturbances that are over."""
        disturbed = frames.compass & ~frames.undisturbed
        if not (disturbed.any() or self._spans.under_way):
            return
        starts_ns = frames.time_ns[frames.first[:-1]].tolist()
        ends_ns = (frames.time_ns[frames.first[1:] - 1] + self._period_ns).astype(np.int64).tolist()
        offs = np.where(frames.compass, frames.values[:, 0], np.nan).tolist()
        for start_ns, end_ns, off, bad in zip(
            starts_ns, ends_ns, offs, disturbed.tolist(), strict=True
        ):
            yield from self._spans.add(start_ns, end_ns, off, disturbed=bad)

    def _headings(self, frames: HeadingFrames) -> Iterator[Heading]:
        """Return the headings that are due."""
        every_ns = max(NS_PER_S / self.parameters.output_hz, self._period_ns)
        due_ns = -1 if self._due_ns is None else self._due_ns
        due, self._due_ns = frame_kernels.due_places(
            frames.time_ns, due_ns, every_ns, self._period_ns
        )
        sigma = np.repeat(frames.sigma_rad, frames.lengths)[due]
        columns = (frames.time_ns[due], frames.heading_rad[due], sigma)
        return map(Heading, *(x.tolist() for x in columns), repeat(self._stage))

    def _notes(self, frames: HeadingFrames) -> Iterator[Note]:
        """Yield what a person should know, each once."""
        for place, texts in frames.notes.items():
            for text in texts:
                if text not in self._told:
                    self._told |= {text}
                    time_ns = int(frames.time_ns[frames.first[place + 1] - 1])
                    yield Note(time_ns, f"{self._topic}: {text}", "INFO", self._stage)


class CompassHeading(HeadingStage):
    """Fuses gyroscope, specific force and magnetic field of one body-worn sensor."""

    Parameters = HeadingParameters
    columns = COLUMNS
    gates = GATES

    def filter(self, rate_hz: float) -> HeadingEstimator:
        """Return an estimator at a rate [Hz]."""
        from .heading.estimator import HeadingEstimator

        return HeadingEstimator(self.parameters, rate_hz)
