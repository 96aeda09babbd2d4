"""A detector run once more for its decision function at every sample.

Results hold frames of 50 ms. Here the stage runs again on the same blocks, for its curve.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from groundtrace.stage import StageConfig, StageRunner

from .recipe import used

if TYPE_CHECKING:
    from groundtrace.detector import Curve
    from groundtrace.sinks import Session
    from groundtrace_codecs.events import Gap, StageSpec
    from groundtrace_codecs.signals import SignalBlock


class Retold:
    """The curve of one stage on one topic.

    Parameters
    ----------
    session
        Its pipeline says what the stage runs.
    spec
        The stage.
    """

    def __init__(self, session: Session, spec: StageSpec) -> None:
        self._topic = spec.topic
        self._stage: StageRunner | None = None
        self._last: Curve | None = None
        found = used(session, spec)
        if found is not None and hasattr(found.kind, "curve"):
            config = StageConfig(spec.plugin, spec.stage, found.topics)
            self._stage = StageRunner(config, found.kind, found.parameters)

    @property
    def known(self) -> bool:
        """Whether there is a curve: the stage is known, and its detector tells one."""
        return self._stage is not None

    def feed(self, item: SignalBlock | Gap) -> Curve | None:
        """Take what the stage is given, a block or a gap; return the curve completed by it."""
        if self._stage is None or item.topic != self._topic:
            return None
        for _ in self._stage.process(item):
            pass
        return self._completed(self._stage)

    def finish(self) -> Curve | None:
        """End the recording; return the curve that was held back."""
        if self._stage is None:
            return None
        for _ in self._stage.flush():
            pass
        return self._completed(self._stage)

    def _completed(self, stage: StageRunner) -> Curve | None:
        """Return what is new: a detector that holds nothing back tells its last piece again."""
        curve = stage.curve(self._topic)
        if curve is None or curve is self._last:
            return None
        self._last = curve
        return curve if len(curve.time_ns) else None
