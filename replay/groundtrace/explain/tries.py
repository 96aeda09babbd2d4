"""Steps of a result with thresholds changed, again and again: all of them, or about a moment."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any

from ..errors import PipelineError
from .chain import StepChain
from .counted import counted_kind
from .grid import Axis

if TYPE_CHECKING:
    from collections.abc import Sequence

    from .chain import Passed
    from .redecide import Redecider, Settings


class Tries:
    """Decides with some parameters changed.

    Parameters
    ----------
    redecider
        Says what can be decided from what was stored.

    Raises
    ------
    RecordingError
        Where no stage finds steps.
    """

    def __init__(self, redecider: Redecider) -> None:
        evidence = redecider.evidence
        self._redecider = redecider
        self._stages = {stage.key: (stage, kind) for stage, kind in redecider.stages}
        stood = {name: redecider.parameters(*stage, {}) for name, stage in self._stages.items()}
        #: Every gate's parameter as it stood.
        self._base = {
            (part.spec.stage, gate.parameter): getattr(stood[part.spec.stage], gate.parameter)
            for part in evidence.stages
            if part.spec.stage in stood
            for gate in part.spec.gates
        }
        axes = [Axis(*key, "", (value,), False, False) for key, value in self._base.items()]
        self._chain = StepChain(evidence, axes)

    @classmethod
    def of(cls, redecider: Redecider) -> Tries | None:
        """Return the tries of a result; None where it has no steps to decide."""
        evidence = redecider.evidence
        steps = any(part.spec.emits == "step" for part in evidence.stages)
        return cls(redecider) if steps and counted_kind(evidence.config) == "step" else None

    @property
    def stages(self) -> tuple[str, ...]:
        """Names of the stages that steps depend on."""
        return tuple(link.stage.key for link in self._chain.links)

    def within(self, start_ns: int, end_ns: int) -> Tries:
        """Return the tries of candidates with start <= time <= end."""
        found = copy.copy(self)
        found._chain = self._chain.within(start_ns, end_ns)
        return found

    def passed(self, settings: Settings) -> list[Passed]:
        """Return the steps with some parameters changed, topic by topic.

        Raises
        ------
        PipelineError
            Where a value is not allowed, or needs a replay.
        """
        for name in {stage for stage, _ in settings}:
            if name not in self._stages:
                raise PipelineError(
                    f"{name}: expected a stage that candidates decide, found another"
                )
            self._redecider.parameters(*self._stages[name], settings)
        return self._chain.passed(self._row(settings))

    def order(self, tried: Sequence[Settings]) -> list[int]:
        """Return the order of settings in which the early gates change least often."""
        return self._chain.order([self._row(settings) for settings in tried])

    def _row(self, settings: Settings) -> list[Any]:
        return [settings.get(key, value) for key, value in self._base.items()]

    def unchanged(self) -> list[Passed]:
        """Return the steps as they stood, topic by topic."""
        return self._chain.passed([*self._base.values()])
