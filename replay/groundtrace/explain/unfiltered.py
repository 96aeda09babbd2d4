"""Measuring again without the filter: whether the filter removed a step is shown, not guessed.

A recorded signal that exceeds its noise by more than the filtered one proves nothing: what stands
out may be no step. So the stretch of the recording is measured again with the filter taken out, as
the detector defines it, and the filter is to blame only where a candidate then passes all
thresholds. That needs the recording; results alone are not enough.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.events import CandidateBlock
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

from ..pipeline.chain import bridge_of
from ..pipeline.parameters import StageConfig, build
from ..pipeline.plugins import stage_named
from ..pipeline.results import Unmuted, recording_in, stage_evidence
from ..pipeline.source import Source
from ..pipeline.stage import StageRunner, wanted_quantities
from .reasons import accepted_picks, unfiltered_kind
from .redecide import associated

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from groundtrace_codecs.mcap.byte_source import ByteSource

    from ..pipeline.config import PipelineConfig
    from ..pipeline.results import Evidence, StageEvidence

#: Stretches of this length are measured at once [s], so that misses side by side share one. Chosen
#: by judgement: as long as what is read before and after it.
STRETCH_S = 30.0
#: A flat top has so many samples, as one alone has in the faults of a recording; and a corner: the
#: signal comes to it, or leaves it, by so many of the least differences between two of its levels
#: up to so long beside it [s]. A slow maximum of few levels is flat too, but has no corner. Source:
#: LONG_TOP of the faults of signals for the first; the others chosen by judgement.
FLAT_SAMPLES, CORNER_LEVELS, BESIDE_S = 5, 4, 1.0
#: A stretch is measured from so long before it on, and until so long after [s]: what detectors look
#: back and ahead, of which the rhythm of a phone in a hand is the longest, 12 s and 6 s. Chosen by
#: judgement: those and half as much again.
BEFORE_S, AFTER_S = 20.0, 15.0


class Unfiltered:
    """The signal of a result, and what its stages find in it without their filters.

    Parameters
    ----------
    config
        The pipeline, every parameter as it stood.
    locate
        Returns the recording, None where it is not at hand; asked when it is needed first.
    """

    def __init__(
        self, config: PipelineConfig, locate: Callable[[], Path | ByteSource | str | None]
    ) -> None:
        self._stages = {stage.key: stage for stage in config.stage}
        self._placements = config.placements
        self._locate = locate
        self._source: Path | ByteSource | str | None = None
        self._located = False
        self._measured: dict[tuple[str, str, int], StageEvidence | None] = {}

    @property
    def at_hand(self) -> bool:
        """Whether the recording is."""
        if not self._located:
            self._source, self._located = self._locate(), True
        return self._source is not None

    def nearest(
        self, part: StageEvidence, channel: int, start_ns: int, end_ns: int
    ) -> Unmuted | None:
        """Return what passes all thresholds in a span without the filter, nearest its middle.

        A refractory time is no threshold of the signal: it is left out.

        Parameters
        ----------
        part
            The stage and topic as they stood.
        channel
            Whose candidates.
        start_ns, end_ns
            First and last moment that count.

        Returns
        -------
        None where there is none, the recording is not at hand, or the detector has no filter.
        """
        middle_ns = (start_ns + end_ns) // 2
        measured = self.around(part, middle_ns)
        if measured is None:
            return None
        rows = measured.between(start_ns, end_ns)
        passed = passes_levels(measured)
        channel_rows = [r for r in rows if measured.candidates.channel[r] == channel and passed[r]]
        if not channel_rows:
            return None
        times = measured.candidates.time_ns
        row = min(channel_rows, key=lambda r: abs(int(times[r]) - middle_ns))
        return Unmuted(int(times[row]), float(measured.candidates.value[row, 0]))

    def group(
        self, part: StageEvidence, source: StageEvidence, start_ns: int, end_ns: int
    ) -> Unmuted | None:
        """Return the accepted group of picks in a span where they are picked without the filter.

        Parameters
        ----------
        part, source
            The stage that groups picks, and the one that picked, as they stood.
        start_ns, end_ns
            First and last moment that count.

        Returns
        -------
        As :meth:`nearest`; its value is that of the first column, the channels that saw it.
        """
        middle_ns = (start_ns + end_ns) // 2
        picked = self.around(source, middle_ns)
        if picked is None:
            return None
        stage = self._stages[part.spec.stage]
        kind: Any = stage_named(stage.use)
        parameters = build(kind.Parameters, stage.parameters, stage.key)
        runner = StageRunner(stage, kind, parameters, {kind.takes[0]: (source.spec.stage,)})
        groups = [
            Unmuted(int(time_ns), float(value[0]))
            for block in associated(runner, [(picked.spec, accepted_picks(picked))])
            if isinstance(block, CandidateBlock)
            for time_ns, value, good in zip(block.time_ns, block.value, block.accepted, strict=True)
            if good and start_ns <= time_ns <= end_ns
        ]
        return min(groups, key=lambda one: abs(one.time_ns - middle_ns), default=None)

    def clipped(self, part: StageEvidence, start_ns: int, end_ns: int) -> tuple[str, float] | None:
        """Return the channel that stood still at its extreme for longest, and for how long [s].

        What a stage makes of several channels, such as the length of an acceleration, goes on
        moving where one of them is clipped; so they are looked at as recorded.

        Parameters
        ----------
        part
            The stage and topic.
        start_ns, end_ns
            First and last moment that count.

        Returns
        -------
        None where no channel stood still there for :data:`FLAT_SAMPLES` at its extreme, or the
        recording is not at hand.
        """
        if not self.at_hand or self._source is None:
            return None
        kind: Any = stage_named(self._stages[part.spec.stage].use)
        longest: dict[str, float] = {}
        with Recording.open(self._source) as recording:
            stream = next((s for s in recording.streams if s.topic == part.spec.topic), None)
            if stream is None:
                return None
            columns = stream.columns_of(wanted_quantities(kind))
            beside = round(BESIDE_S * NS_PER_S)
            span = (start_ns - beside, end_ns + beside)
            source = self._source_within(recording, stream.topic, *span)
            blocks = [item for item in source if isinstance(item, SignalBlock)]
        if not blocks:
            return None
        times = np.concatenate([block.sample_times() for block in blocks])
        samples = np.concatenate([block.samples[:, columns] for block in blocks])
        inside = (times >= start_ns) & (times <= end_ns)
        for number, values in zip(columns, samples.T, strict=True):
            levels = np.unique(values)
            if not inside.any() or len(levels) < 2:
                continue
            flat = _longest_flat(values[inside], CORNER_LEVELS * float(np.diff(levels).min()))
            if flat >= FLAT_SAMPLES:
                longest[stream.channels[number].name] = flat / stream.rate_hz
        return max(longest.items(), key=lambda item: item[1], default=None)

    def around(self, part: StageEvidence, time_ns: int) -> StageEvidence | None:
        """Return what a stage measures without its filter in the stretch that a time lies in.

        None where the recording is not at hand, or the detector has no filter.
        """
        spec, length = part.spec, round(STRETCH_S * NS_PER_S)
        key = (spec.stage, spec.topic, time_ns // length)
        if key not in self._measured:
            start_ns = key[2] * length
            self._measured[key] = self._measure(part, start_ns, start_ns + length)
        return self._measured[key]

    def _source_within(
        self, recording: Recording, topic: str, start_ns: int, stop_ns: int
    ) -> Source:
        """Return what a stream holds of a span, as the pipeline took it."""
        bridge_s = bridge_of(stage_named(stage.use) for stage in self._stages.values())
        return Source(
            recording, topics={topic}, start_ns=start_ns, stop_ns=stop_ns, bridge_s=bridge_s
        )

    def _measure(self, part: StageEvidence, start_ns: int, end_ns: int) -> StageEvidence | None:
        worker = unfiltered_kind(self._stages[part.spec.stage])
        if worker is None or not self.at_hand or self._source is None:
            return None
        kind, parameters = worker
        spec = part.spec
        config = StageConfig(spec.plugin, spec.stage)
        stage = StageRunner(config, kind, parameters, placements=self._placements)
        events = []
        with Recording.open(self._source) as recording:
            if spec.topic not in {stream.topic for stream in recording.streams}:
                return None
            span = (start_ns - round(BEFORE_S * NS_PER_S), end_ns + round(AFTER_S * NS_PER_S))
            for item in self._source_within(recording, spec.topic, *span):
                events += list(stage.process(item))
        events += list(stage.flush())
        parts = stage_evidence(events, [spec.stage])
        return parts[0] if parts else None


def passes_levels(part: StageEvidence) -> NDArray[np.bool_]:
    """Return which candidates pass all gates but a refractory time, which is none of the signal."""
    levels = [i for i, gate in enumerate(part.spec.gates) if gate.name != "refractory"]
    passed: NDArray[np.bool_] = part.margin[:, levels].min(axis=1, initial=0.0) >= 0
    return passed


def _longest_flat(values: NDArray[Any], least_corner: float) -> int:
    """Return the most samples in a row that are the largest, or the smallest, with a corner."""
    longest = 0
    for end in (values.max(), values.min()):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], values == end, [False]])))
        for first, after in zip(edges[::2], edges[1::2], strict=True):
            beside = values[[i for i in (first - 1, after) if 0 <= i < len(values)]]
            if (np.abs(beside - end) >= least_corner).any():
                longest = max(longest, int(after - first))
    return longest


def with_recording(evidence: Evidence, sha256: str, places: Sequence[Path]) -> Evidence:
    """Return evidence that measures its recording again where that is at hand.

    Parameters
    ----------
    evidence
        Of a result.
    sha256
        Of the recording.
    places
        Where it may be; the first that holds it counts.
    """
    locate = partial(recording_in, places, sha256)
    return replace(evidence, unfiltered=Unfiltered(evidence.config, locate))
