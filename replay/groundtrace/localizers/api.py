"""What a localizer is to a pipeline: parameters, columns, gates, and ``locate``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Protocol

from groundtrace_codecs.events import Quantity

from ..gates import Level
from ..parameters import gate, measured

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from groundtrace_codecs.geometry import Medium

    from ..detector import Emits
    from ..gates import Gate
    from .location import Location


@dataclass(frozen=True, slots=True, eq=False)
class Site:
    """Where a localizer works.

    Attributes
    ----------
    positions
        Shape (n, 2): sensors [m].
    outline
        Shape (k, 2): corners of the room [m]; None where unknown.
    medium
        What the waves run through.
    length_unit
        ``m``, or ``units`` where the unit of all these lengths is unknown.
    """

    positions: NDArray[np.float64]
    outline: NDArray[np.float64] | None
    medium: Medium
    length_unit: str = "m"


@dataclass(frozen=True, slots=True)
class LocalizerParameters:
    """Parameters that every localizer has."""

    window_s: Annotated[
        float, measured("s", "Longest time after a step that arrivals belong to it.", gt=0)
    ] = 0.05
    min_picks: Annotated[int, gate("1", "Least number of arrivals, one a channel.", ge=3)] = 3


class Localizer(Protocol):
    """Finds places: it locates, and its gates decide which places count.

    Notes
    -----
    ``Parameters`` is a dataclass that derives from :class:`LocalizerParameters`. ``columns`` are
    those of :func:`columns`; ``gates`` stand in the order of the decision.
    """

    Parameters: type[Any]
    emits: Emits
    columns: tuple[Quantity, ...]
    gates: tuple[Gate, ...]

    def __init__(self, parameters: Any) -> None: ...

    def start(self, site: Site) -> str:
        """Prepare for a site; return what it lacks, or an empty text."""

    def locate(self, times_s: NDArray[np.float64]) -> Location:
        """Return the place for arrivals, shape (n,), NaN where a sensor has none."""


def columns(unit: str) -> tuple[Quantity, ...]:
    """Return the columns of a localizer whose residual has a unit."""
    return (
        Quantity("picks", "1"),
        Quantity("residual", unit),
        Quantity("x", "m"),
        Quantity("y", "m"),
        Quantity("sigma", "m"),
    )


def gates(unit: str, parameter: str) -> tuple[Gate, ...]:
    """Return the gates on the number of arrivals and on the residual."""
    return (
        Level("picks", "1", "min_picks"),
        Level("residual", unit, parameter, at_least=False),
    )
