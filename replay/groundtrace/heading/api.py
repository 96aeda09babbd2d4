"""What a heading filter is, and what it says of a frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    from groundtrace_codecs.events import Quantity

    from ..detector import Emits
    from ..gates import Gate
    from .inertial_frames import Samples
    from .rotations import Array


@dataclass(frozen=True, slots=True, eq=False)
class HeadingFrame:
    """What is known at the samples of one frame; causal: later samples change nothing of it.

    Attributes
    ----------
    time_ns
        Of the samples, shape (n,), int64.
    orientation
        Body to earth (x east, y magnetic north, z up), shape (n, 4), (w, x, y, z).
    heading_rad
        Direction of the chosen axis in the horizontal plane, counter-clockwise from east,
        shape (n,) [rad].
    sigma_rad
        Its standard deviation [rad].
    bias
        Of the gyroscope, shape (3,) [rad/s].
    values
        The filter's columns, first how much the field is off; NaN without a field.
    undisturbed
        Whether all tests of the field passed; True where there is no field to be disturbed.
    compass
        Whether the frame has a field.
    resting
        Whether the sensor stands still.
    notes
        What a person should know, a line each.
    """

    time_ns: NDArray[np.int64]
    orientation: Array
    heading_rad: Array
    sigma_rad: float
    bias: Array
    values: Array
    undisturbed: bool
    compass: bool
    resting: bool
    notes: tuple[str, ...] = ()


class HeadingMethod(Protocol):
    """A heading filter: samples in, frames out, in any portions.

    Notes
    -----
    ``columns`` and ``gates`` are as those of a detector; a frame is undisturbed where all gates
    pass. ``Parameters`` has ``output_hz`` and ``join_s``. All state can be deep-copied.
    """

    Parameters: type[Any]
    emits: Emits
    columns: tuple[Quantity, ...]
    gates: tuple[Gate, ...]

    def __init__(self, parameters: Any, rate_hz: float) -> None: ...

    def add(self, samples: Samples) -> Sequence[HeadingFrame]:
        """Take samples of any number; return the frames that are complete by now."""

    def finish(self) -> Sequence[HeadingFrame]:
        """Return what was held back."""
