"""A picker's decision function at every sample around steps, by the picker itself."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .curves import Retold
from .detector import ceiling, decision_gate
from .excerpts import Excerpts
from .timeline import Entity

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from groundtrace.sinks import Session
    from groundtrace_codecs.events import Gap, StageSpec
    from groundtrace_codecs.signals import SignalBlock

    from .excerpts import Piece
    from .palette import SensorColours
    from .timeline import Timeline

#: How much is drawn around a step [s].
BEFORE_S, AFTER_S = 0.1, 0.1
#: Steps of the value axis, about a pixel each: samples that change nothing need no row.
LEVELS = 128


class PickerCurve:
    """Logs the decision function of one picking stage on one topic.

    Parameters
    ----------
    timeline
        Where to.
    session
        Its pipeline says what the stage runs.
    spec
        The stage.
    colours
        Of the sensors.
    """

    def __init__(
        self, timeline: Timeline, session: Session, spec: StageSpec, colours: SensorColours
    ) -> None:
        self._timeline = timeline
        self._spec = spec
        self._colours = colours
        self._path = f"/decision/{spec.stage}/{spec.topic.strip('/')}"
        self._top = ceiling(spec)
        self._excerpts = Excerpts(BEFORE_S, AFTER_S)
        self._retold = Retold(session, spec)
        self._declared = False

    def feed(self, item: SignalBlock | Gap) -> None:
        """Take what the picker is given: a block, or a gap."""
        curve = self._retold.feed(item)
        if curve is not None:
            self._excerpts.push(curve.time_ns, curve.value)

    def expect(self, time_ns: int) -> None:
        """Take an arrival, which may become a step, or a true step, which may be missed."""
        self._excerpts.expect(time_ns)

    def show(self, time_ns: int) -> None:
        """Log the curve around a moment."""
        piece = self._excerpts.around(time_ns)
        if piece is None or not len(piece[0]):
            return
        if not self._declared:
            self._declare()
            self._declared = True
        times, values = self._drawn(*piece)
        # the viewer would draw a line to the next step
        ended = np.full((1, values.shape[1]), np.nan)
        end_ns = times[-1:] + 1
        self._timeline.scalars(
            self._path, np.concatenate([times, end_ns]), np.concatenate([values, ended])
        )

    def _drawn(self, times: NDArray[np.int64], values: NDArray[np.float32]) -> Piece:
        """Return the samples that make the drawn curve: the first and last of equal ones."""
        if not self._top:
            return times, values
        grain = self._top / LEVELS
        level = np.round(np.minimum(values, self._top) / grain)
        changed = (np.diff(level, axis=0) != 0).any(axis=1)
        kept = np.append(changed, True) | np.append(True, changed)
        return times[kept], (level[kept] * grain).astype(np.float32)

    def _declare(self) -> None:
        import rerun as rr

        spec, gate = self._spec, decision_gate(self._spec)
        decision = spec.trace[0]
        limit = f", threshold {gate.threshold:g} in red" if gate else ""
        unit = f" [{decision.unit}]" if decision.unit not in ("", "1") else ""
        title = (
            f"{spec.stage} {spec.topic}: {decision.name.replace('_', ' ')}{unit} "
            f"at every sample{limit}"
        )
        lines = rr.SeriesLines(
            names=list(spec.channels),
            colors=np.array([self._colours.of(c) for c in spec.channels], np.uint32),
            aggregation_policy=rr.components.AggregationPolicy.Max,
        )
        channels = len(spec.channels)
        self._timeline.declare(
            Entity(self._path, "decision", title, channels, top=self._top), lines
        )
