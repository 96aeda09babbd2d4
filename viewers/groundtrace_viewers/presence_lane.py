"""When a vehicle is heard, as a lane; and where the power is there, why it is taken for none."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .palette import ACCEPTED, REJECTION_COLOURS

if TYPE_CHECKING:
    from groundtrace_codecs.events import CandidateBlock, StageSpec

    from .lanes import Lane, StageLanes

HEARD = "vehicle"
#: Cycles as long as this, where there is but one [ns].
CYCLE_NS = 500_000_000
#: No span: its start and end [ns] and its state.
NONE = (0, 0, "")


class PresenceLane:
    """Puts the channels together: any that hears a vehicle, else the loudest above the threshold.

    Parameters
    ----------
    spec
        The stage that hears vehicles; its first gate is on power.
    lanes
        Among which its own is.
    """

    def __init__(self, spec: StageSpec, lanes: StageLanes) -> None:
        names = [f"no: {gate.name.replace('_', ' ')}" for gate in spec.gates]
        self._names = names
        shades = (REJECTION_COLOURS[i % len(REJECTION_COLOURS)] for i in range(len(names)))
        colours = {HEARD: ACCEPTED, **dict(zip(names, shades, strict=True))}
        self._lane: Lane = lanes.of(spec.stage, spec.topic, colours, spec.emits)
        self._cycles: dict[int, tuple[float, str]] = {}
        self._cycle_ns = 0
        self._open = NONE

    def candidates(self, block: CandidateBlock) -> None:
        """Take decided cycles of channels."""
        rows = zip(block.time_ns.tolist(), block.margin, block.accepted.tolist(), strict=True)
        for time_ns, margin, accepted in rows:
            if accepted:
                self._cycles[time_ns] = (np.inf, HEARD)
                continue
            loudness, _ = self._cycles.get(time_ns, (0.0, ""))
            failed = int(np.argmax(~(margin >= 0)))
            if failed and margin[0] >= loudness:
                self._cycles[time_ns] = (float(margin[0]), self._names[failed])
        times = np.unique(block.time_ns)
        if len(times) > 1:
            apart_ns = int(np.diff(times).min())
            self._cycle_ns = min(self._cycle_ns or apart_ns, apart_ns)

    def flush(self, before_ns: int | None = None) -> None:
        """Fill the lane up to a time; all channels have told what was before."""
        length_ns = self._cycle_ns or CYCLE_NS
        ready = sorted(t for t in self._cycles if before_ns is None or t < before_ns)
        for time_ns in ready:
            _, found = self._cycles.pop(time_ns)
            start_ns, end_ns, state = self._open
            first_ns = time_ns - length_ns // 2
            if found != state or first_ns > end_ns:
                self._end()
                start_ns = first_ns
            self._open = start_ns, first_ns + length_ns, found
        if before_ns is None or self._open[1] < before_ns - length_ns:
            self._end()

    def _end(self) -> None:
        """Put the span that is open into the lane."""
        start_ns, end_ns, state = self._open
        if state:
            self._lane.add(start_ns, state, end_ns)
        self._open = NONE
