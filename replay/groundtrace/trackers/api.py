"""What a tracker is to a pipeline: parameters, columns, gates, ``measure`` and ``follow``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Protocol

from ..parameters import measured

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    from groundtrace_codecs.events import Fix, Quantity, TrackPoint

    from ..detector import Emits
    from ..gates import Gate

#: What the name of a stage gets appended for its smoothed tracks.
SMOOTHED = ".smoothed"


@dataclass(frozen=True, slots=True)
class TrackerParameters:
    """Parameters that every tracker has."""

    source: Annotated[
        str, measured("", "Stage whose fixes are tracked; empty takes the first localizer.")
    ] = ""
    together_s: Annotated[
        float, measured("s", "Fixes so close in time are of different walkers.", ge=0)
    ] = 0.1


class Tracker(Protocol):
    """Follows walkers: it measures how well fixes fit, and its gates decide which belong.

    Notes
    -----
    ``Parameters`` is a dataclass that derives from :class:`TrackerParameters`. Each group of
    fixes is measured, decided, then followed.
    """

    Parameters: type[Any]
    emits: Emits
    columns: tuple[Quantity, ...]
    gates: tuple[Gate, ...]

    def __init__(self, parameters: Any) -> None: ...

    def start(self, stage: str) -> None:
        """Begin; ``stage`` goes into the points."""

    def expire(self, time_ns: int) -> list[TrackPoint]:
        """End the tracks that are over by a time; return what is still to say of them."""

    def measure(self, fixes: Sequence[Fix]) -> NDArray[np.float32]:
        """Return the columns of fixes that came together, shape (n, n_columns)."""

    def follow(self, fixes: Sequence[Fix], accepted: NDArray[np.bool_]) -> list[TrackPoint]:
        """Go on with the fixes just measured and decided; return what is known of the tracks."""

    def finish(self) -> list[TrackPoint]:
        """End all tracks; return what is still to say of them."""
