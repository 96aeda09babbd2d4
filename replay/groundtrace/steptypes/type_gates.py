"""Gates of the types of steps: levels for some types alone, and one chain for each step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Quantity

    from ..gates import Candidates, Carry, Level

TYPES = ("forward", "backward", "left", "right")
FRONTAL, LATERAL = frozenset({0, 1}), frozenset({2, 3})


def _which(types: frozenset[int]) -> NDArray[np.bool_]:
    """Return of each type whether it is one of some."""
    return np.array([place in types for place in range(len(TYPES))])


@dataclass(frozen=True, slots=True)
class Applies:
    """A level that only some types must reach; the others pass whatever it is."""

    level: Level
    types: frozenset[int]

    @property
    def name(self) -> str:
        """Name of the level."""
        return self.level.name

    @property
    def unit(self) -> str:
        """Unit of the level."""
        return self.level.unit

    @property
    def parameter(self) -> str:
        """Parameter of the level."""
        return self.level.parameter

    @property
    def at_least(self) -> bool:
        """Whether the level must be reached, or not exceeded."""
        return self.level.at_least

    def values(
        self,
        candidates: Candidates,
        columns: Sequence[Quantity],
        alive: NDArray[np.bool_],
        threshold: float,
        carry: Carry,
    ) -> NDArray[np.float64]:
        """Return the measured column; infinitely good where the level does not apply."""
        seen = self.level.values(candidates, columns, alive, threshold, carry)
        applies = _which(self.types)[candidates.channel]
        return np.where(applies, seen, np.inf if self.at_least else -np.inf)


@dataclass(frozen=True, slots=True)
class Duplicate:
    """Where a step has a pattern in both chains, the lateral one is its own."""

    parameter: str = "share"
    name: str = "duplicate"
    unit: str = "1"
    at_least: bool = False

    def values(
        self,
        candidates: Candidates,
        columns: Sequence[Quantity],
        alive: NDArray[np.bool_],
        threshold: float,  # noqa: ARG002
        carry: Carry,  # noqa: ARG002
    ) -> NDArray[np.float64]:
        """Return the lateral share of frontal candidates whose step passed the lateral tests."""
        share = candidates.value[:, [c.name for c in columns].index("share")]
        aside = _which(LATERAL)[candidates.channel]
        times = candidates.time_ns[aside & alive]
        # a step's candidates have one time, and come in order
        place = np.searchsorted(times, candidates.time_ns)
        twice = np.append(times, -1)[place] == candidates.time_ns
        # just the threshold would pass
        return np.where(twice & ~aside, np.nextafter(share, np.float32(np.inf)), -np.inf)
