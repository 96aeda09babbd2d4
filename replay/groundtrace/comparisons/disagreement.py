"""Disagreement: the two localizers that place a step farthest apart for their uncertainty."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Annotated

import numpy as np

from groundtrace_codecs.events import Quantity

from ..gates import Candidates, Level
from ..parameters import gate

if TYPE_CHECKING:
    from collections.abc import Sequence

    from groundtrace_codecs.events import Fix

    from ..detector import Emits


@dataclass(frozen=True, slots=True)
class DisagreementParameters:
    """Parameters of :class:`LocalizerDisagreement`."""

    min_distance: Annotated[float, gate("m", "Least distance of the two places.", ge=0)] = 0.5
    min_sigma: Annotated[
        float, gate("1", "Least distance of them in standard deviations.", ge=0)
    ] = 3.0


class LocalizerDisagreement:
    """The pair of localizers whose places of one step differ most for their uncertainty.

    The distance in standard deviations is that of Mahalanobis with the sum of both covariances:
    as if the errors were independent. Localizers share their arrivals, so that it is rather
    understated.
    """

    Parameters = DisagreementParameters
    emits: Emits = "disagreement"
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

    def compare(self, fixes: Sequence[Fix | None]) -> Candidates:
        """Return the pair farthest apart, with the middle between its places."""
        rows = []
        for channel, (one, other) in enumerate(combinations(fixes, 2)):
            if one is not None and other is not None:
                middle = (one.x_m + other.x_m) / 2, (one.y_m + other.y_m) / 2
                rows.append((channel, one.time_ns, (*_apart(one, other), *middle)))
        if not rows:
            return Candidates.empty(len(self.columns))
        known = [row for row in rows if np.isfinite(row[2][1])] or rows
        channel, time_ns, value = max(known, key=lambda row: row[2][1])
        count = sum(fix is not None for fix in fixes)
        return Candidates(
            np.array([time_ns], np.int64),
            np.array([channel], np.int32),
            np.array([(*value, count)], np.float32),
        )


def _apart(one: Fix, other: Fix) -> tuple[float, float]:
    """Return the distance of two places [m], and in standard deviations; NaN where unknown."""
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
