"""What an array method is: it looks at the waveforms of all sensors around one step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Protocol

from .parameters import measured

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from groundtrace_codecs.events import Quantity
    from groundtrace_codecs.geometry import Geometry
    from groundtrace_codecs.signals import Stream

    from .detector import Emits
    from .gates import Candidates, Gate


@dataclass(frozen=True, slots=True)
class ArrayParameters:
    """Parameters that every array method has."""

    before_s: Annotated[
        float, measured("s", "Signal looked at before a step's first arrival.", gt=0, le=1)
    ] = 0.02
    after_s: Annotated[
        float, measured("s", "Signal looked at from a step's first arrival on.", gt=0, le=1)
    ] = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """The waveforms around a step.

    Attributes
    ----------
    step_ns
        The step's first arrival, by the clock of its channel [ns].
    start_ns, rate_hz
        Time of the first sample by the clock common to all, and the sampling rate.
    values
        Shape (n_samples, n_channels), in the channels' units. Samples that were never recorded
        hold the nearest value that was. A channel whose clock is known to be off is moved, by
        whole samples (:func:`groundtrace.recall.whole_samples`).
    arrivals_s
        Shape (n_channels,): the first pick of each channel in the window, after ``start_ns`` and by
        the common clock; NaN where a channel has none.
    """

    step_ns: int
    start_ns: int
    rate_hz: float
    values: NDArray[np.float64]
    arrivals_s: NDArray[np.float64]


class ArrayMethod(Protocol):
    """Examines the waveforms around steps: it measures, and its gates decide.

    Notes
    -----
    ``Parameters`` is a dataclass that derives from :class:`ArrayParameters`; ``quantities`` are
    those of the channels it wants; ``needs`` says in words what ``start`` looks for; ``columns``
    and ``gates`` are as those of a detector.
    """

    Parameters: type[Any]
    quantities: frozenset[str]
    needs: str = "channels of another kind"
    emits: Emits
    columns: tuple[Quantity, ...]
    gates: tuple[Gate, ...]

    def __init__(self, parameters: Any) -> None: ...

    def start(self, stream: Stream, geometry: Geometry) -> tuple[str, ...]:
        """Begin with a stream; return the names of the candidates' channels, none if it cannot."""

    def examine(self, window: Window) -> Candidates:
        """Return what is found around one step, in the order of (time, channel)."""
