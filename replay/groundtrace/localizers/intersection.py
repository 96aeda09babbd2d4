"""One place of what several localizers found of a step, by covariance intersection.

Localizers that measure different things err in different places: delays of waveforms where a wave
law fails, onsets and heights where a floor echoes. But they share sensors and a room, so that their
errors are alike by an amount that nobody knows, and to add up what they tell would claim too much.
Covariance intersection claims no more than each does, whatever the errors have in common (S. J.
Julier and J. K. Uhlmann, American Control Conference, 1997): with the information of each, the
inverse of its covariance P_i, and n of them

    P^-1 = 1/n sum_i P_i^-1,    x = P 1/n sum_i P_i^-1 x_i.

That bound holds for errors that have everything in common, and so claims too little where they have
less. A part q of what each tells may be taken for its own, which the others' errors do not share:
1/n becomes (1 + (n - 1) q) / n, 1/n for q = 0 and 1, as of independent errors, for q = 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Annotated

import numpy as np

from groundtrace_codecs.events import Fix, StepEvent

from ..pipeline.gates import Level
from ..pipeline.parameters import gate, measured
from ..pipeline.stage import Input, LocationEstimate, Memory, Stage, no_location
from .base import columns, place_candidate
from .disagreement import apart

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from groundtrace_codecs.events import CandidateBlock, Event

    from ..pipeline.stage import Context, Output


@dataclass(frozen=True, slots=True)
class IntersectionParameters:
    """Parameters of :class:`CovarianceIntersection`."""

    min_picks: Annotated[int, gate("1", "Least number of arrivals, one a channel.", ge=3)] = 3
    own: Annotated[
        float,
        measured("1", "Part of what each tells that the others' errors do not share.", ge=0, le=1),
    ] = 0.0


class CovarianceIntersection(Stage):
    """The place of a step by all localizers that found one, each as much as it claims to know.

    A fix whose localizer doubts its own waves does not count. Where a single one is left the place
    is that. Its residual is how far the two that differ most are apart, in deviations.
    """

    Parameters = IntersectionParameters
    takes = (Input(Fix, every=True), Input(StepEvent, anywhere=True))
    gives = (Fix,)
    scope = "recording"
    ends_at = "clock step"
    site_lengths = True
    columns = columns("1")
    gates = (Level("picks", "1", "min_picks"),)

    def __init__(self, parameters: IntersectionParameters) -> None:
        self.parameters = parameters

    @property
    def memory(self) -> Memory:
        """The fixes of one step, which have one time."""
        return Memory(0.0, 0.0)

    def start(self, context: Context) -> tuple[str, ...]:
        """Begin without fixes."""
        self._context = context
        self._fixes: list[Fix] = []
        return ("all",)

    def process(self, item: Fix | StepEvent) -> Iterable[Output]:
        """Gather the fixes of a step, which come before it does."""
        if isinstance(item, Fix):
            self._fixes.append(item)
            return ()
        fixes = [f for f in self._fixes if f.time_ns == item.time_ns and not f.doubted]
        self._fixes.clear()
        self._latest_estimate = item.time_ns, intersected(fixes, self.parameters.own)
        return (place_candidate(*self._latest_estimate),)

    def decided(self, block: CandidateBlock) -> Iterator[Event]:
        """Yield the place just found where it counts."""
        if block.accepted[0]:
            time_ns, estimate = self._latest_estimate
            yield estimate.fix(time_ns, self._context.plugin, self._context.stage)


def intersected(fixes: Sequence[Fix], independent: float = 0.0) -> LocationEstimate:
    """Return the place that fixes of one moment tell together.

    Parameters
    ----------
    fixes
        Those whose covariance is finite and not singular count.
    independent
        Part of what each tells that the others' errors do not share, 0 to 1.
    """
    regular = [fix for fix in fixes if _is_known(fix.covariance)]
    if not regular:
        return no_location(0)
    information = [
        np.linalg.inv([(xx, xy), (xy, yy)]) for xx, xy, yy in (f.covariance for f in regular)
    ]
    mean = np.mean(information, axis=0)
    pulls = [matrix @ (fix.x_m, fix.y_m) for matrix, fix in zip(information, regular, strict=True)]
    x, y = np.linalg.solve(mean, np.mean(pulls, axis=0)).tolist()
    covariance = np.linalg.inv(mean) / (1 + (len(regular) - 1) * independent)
    farthest = max((apart(*two)[1] for two in combinations(regular, 2)), default=0.0)
    return LocationEstimate(x, y, covariance, farthest, max(fix.picks for fix in fixes))


def _is_known(covariance: tuple[float, float, float]) -> bool:
    """Whether a covariance, (xx, xy, yy), is finite and not singular."""
    xx, xy, yy = covariance
    return xx > 0 and xx * yy - xy * xy > 0
