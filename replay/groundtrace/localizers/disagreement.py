"""Disagreement: the two localizers whose fixes of a step differ most for their uncertainty."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Annotated

import numpy as np

from groundtrace_codecs.events import Disagreement, Fix, Note, Quantity

from ..pipeline.gates import Candidates, Level
from ..pipeline.parameters import gate
from ..pipeline.stage import Context, Input, Memory, Stage, length_note

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from ..pipeline.stage import Output


@dataclass(frozen=True, slots=True)
class DisagreementParameters:
    """Parameters of :class:`LocalizerDisagreement`."""

    min_distance: Annotated[float, gate("m", "Least distance of the two places.", ge=0)] = 0.5
    min_sigma: Annotated[
        float, gate("1", "Least distance of them in standard deviations.", ge=0)
    ] = 3.0


class LocalizerDisagreement(Stage):
    """The pair of localizers whose places of one step differ most for their uncertainty.

    The distance in standard deviations is that of Mahalanobis with the sum of both covariances:
    as if the errors were independent. Localizers share their arrivals, so that it is rather
    understated.

    Fixes of one step share its time. They are compared when the first fix of the next step has
    come, or at the end. A step with a single fix has nothing to compare, and no candidate.
    """

    Parameters = DisagreementParameters
    takes = (Input(Fix, every=True),)
    gives = (Disagreement,)
    scope = "recording"
    ends_at = "clock step"
    site_lengths = True
    columns = (
        Quantity("distance", "m"),
        Quantity("deviations", "1"),
        Quantity("x", "m"),
        Quantity("y", "m"),
        Quantity("localizers", "1"),
    )
    gates = (Level("distance", "m", "min_distance"), Level("deviations", "1", "min_sigma"))

    def __init__(self, parameters: DisagreementParameters) -> None:
        self.parameters = parameters
        self._waiting: dict[str, Fix] = {}
        self._reported = False

    @property
    def memory(self) -> Memory:
        """The fixes of one step, which have one time."""
        return Memory(0.0, 0.0)

    def start(self, context: Context) -> tuple[str, ...]:
        """Begin with the pairs of the localizers."""
        self._context, self._localizers = context, tuple(context.sources)
        return tuple(f"{one}, {other}" for one, other in combinations(self._localizers, 2))

    def process(self, fix: Fix) -> Iterator[Output]:
        """Take a fix; where it is of another step than those that wait, compare these."""
        if self._waiting and next(iter(self._waiting.values())).time_ns != fix.time_ns:
            yield from self.flush()
        self._waiting[fix.stage] = fix
        note = "" if self._reported else length_note(self._context.geometry)
        self._reported = True
        if note:
            yield Note(fix.time_ns, note, "INFO", self._context.stage)

    def flush(self) -> Iterator[Output]:
        """Compare the fixes of the last step."""
        fixes, self._waiting = self._waiting, {}
        yield self.compare([fixes.get(name) for name in self._localizers])

    def compare(self, fixes: Sequence[Fix | None]) -> Candidates:
        """Return the pair farthest apart, with the middle between its places."""
        rows = []
        for channel, (one, other) in enumerate(combinations(fixes, 2)):
            if one is not None and other is not None:
                middle = (one.x_m + other.x_m) / 2, (one.y_m + other.y_m) / 2
                rows.append((channel, one.time_ns, (*apart(one, other), *middle)))
        if not rows:
            return Candidates.empty(len(self.columns))
        comparable = [row for row in rows if np.isfinite(row[2][1])] or rows
        channel, time_ns, value = max(comparable, key=lambda row: row[2][1])
        count = sum(fix is not None for fix in fixes)
        return Candidates(
            np.array([time_ns], np.int64),
            np.array([channel], np.int32),
            np.array([(*value, count)], np.float32),
        )


def apart(one: Fix, other: Fix) -> tuple[float, float]:
    """Return the distance of two places [m], and in standard deviations; NaN where unknown.

    The deviations are Mahalanobis' with the sum of both covariances, as of independent errors.
    """
    offset = np.array([one.x_m - other.x_m, one.y_m - other.y_m])
    xx, xy, yy = np.add(one.covariance, other.covariance)
    determinant = xx * yy - xy**2
    deviations = float("nan")
    if xx > 0 and determinant > 0:
        square = (yy * offset[0] ** 2 - 2 * xy * offset[0] * offset[1] + xx * offset[1] ** 2) / (
            determinant
        )
        deviations = float(np.sqrt(square))
    return float(np.hypot(*offset)), deviations
