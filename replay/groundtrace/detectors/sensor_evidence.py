"""What two sensors say of a peak or a valley, as masses: each sensor's, and combined.

Source: Dempster-Shafer thesis, chapter III, section V.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.events import Quantity

from ..belief import (
    RULES,
    Criterion,
    Frame,
    Rule,
    conflict,
    discount,
    graded,
    over_ignorance,
    scores,
    trapezoid,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

#: The sensors, in the order of the columns.
SOURCES = ("accelerometer", "gyroscope")
FRAME = Frame(("it", "none"))
IT, NONE = FRAME.subset(["it"]), FRAME.subset(["none"])
#: Corners of a trapezoid, and so many heights are looked at besides them.
CORNERS, GRID = ("rise", "full", "fade", "gone"), 100


@dataclass(frozen=True, slots=True)
class Heights:
    """A trapezoid over heights: 0 up to ``rise``, 1 from ``full`` to ``fade``, 0 from ``gone``."""

    rise: float
    full: float
    fade: float = np.inf
    gone: float = np.inf

    def __call__(self, heights: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the membership of heights, from 0 to 1."""
        return trapezoid(heights, self.rise, self.full, self.fade, self.gone)


@dataclass(frozen=True, slots=True)
class Evidence:
    """Turns heights into masses and combines them.

    Attributes
    ----------
    certainty, truth
        The probabilities p and q of (III.4) over the height.
    reliability
        Of each source of :data:`SOURCES`; 0 makes it vacuous.
    rule
        That combines the sources.
    criterion
        What the decision takes the largest of.
    """

    certainty: Heights
    truth: Heights
    reliability: tuple[float, float]
    rule: Rule
    criterion: Criterion

    @staticmethod
    def columns(what: str) -> tuple[Quantity, ...]:
        """Return what :meth:`of` gives, for a peak or a valley.

        Scores and masses that gates look at, the rest of the combined masses, their conflict, and
        the masses of each source: that it is one, that it is none, and that it may be either.
        """
        names = [f"{what}_lead", f"{what}_mass", f"{what}_certainty"]
        names += [f"non{what}_mass", f"{what}_ignorance", f"{what}_conflict"]
        for source in SOURCES:
            names += [f"{source}_{what}", f"{source}_non{what}", f"{source}_{what}_ignorance"]
        return tuple(Quantity(name, "1") for name in names)

    def most(self) -> tuple[float, float, float]:
        """Return the most that lead, mass and certainty of :meth:`of` can be, over all heights.

        Looked for over all pairs of heights of a grid that holds every corner of the trapezoids;
        between corners the masses of a source are polynomials of its height, of degree 2.
        """
        corners = [getattr(h, name) for h in (self.certainty, self.truth) for name in CORNERS]
        known = np.array([c for c in corners if np.isfinite(c)])
        grid = np.linspace(0, 1.1 * known.max() + 1, GRID)
        grid = np.unique(np.concatenate([[-1.0], known, grid]))
        pairs = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
        lead, mass, certainty = np.nanmax(self.of(pairs)[:, :3], axis=0).tolist()
        return lead, mass, certainty

    def of(self, heights: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the columns of each height, shape (n, 12).

        Parameters
        ----------
        heights
            Shape (n, 2): of each source, over the level around.

        Returns
        -------
        Not a number in a row of total conflict where rule or criterion are not defined for it.
        """
        masses = [
            discount(graded(FRAME, IT, self.certainty(h), self.truth(h)), reliability)
            for h, reliability in zip(heights.T, self.reliability, strict=True)
        ]
        k = conflict(*masses)
        undefined = (k >= 1) & (self.rule == "dempster" or self.criterion == "pignistic")
        combined, lead = np.full_like(masses[0], np.nan), np.full(len(heights), np.nan)
        kept = ~undefined
        combined[kept] = RULES[self.rule](*(m[kept] for m in masses))
        score = scores(combined[kept], self.criterion)
        lead[kept] = score[:, 0] - score[:, 1]
        columns = [lead, combined[:, IT], over_ignorance(combined, IT), combined[:, NONE]]
        columns += [combined[:, FRAME.whole], k]
        for m in masses:
            columns += [m[:, IT], m[:, NONE], m[:, FRAME.whole]]
        return np.column_stack(columns)
