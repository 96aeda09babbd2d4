"""What a detector is: parameters, columns, gates, and ``measure``. It never decides."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np

from .gates import Candidates

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from groundtrace_codecs.events import Pick, Quantity, StageSpec
    from groundtrace_codecs.signals import SignalBlock, Stream

    from .gates import Gate

#: What an accepted candidate becomes.
Emits = Literal[
    "pick",
    "step",
    "impact",
    "fix",
    "track",
    "bearing",
    "disagreement",
    "heading",
    "presence",
    "pass",
]


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """The trace of a measurement: what was reached in each 50 ms frame.

    Attributes
    ----------
    time_ns
        Shape (n,), int64: start of each frame.
    value
        Shape (n, n_channels, n_quantities), float32, in the order of the detector's ``trace``.
    """

    time_ns: NDArray[np.int64]
    value: NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """A decision function sample by sample.

    Attributes
    ----------
    time_ns
        Shape (n,), int64.
    value
        Shape (n, n_channels), in the unit of the detector's first ``trace`` quantity.
    """

    time_ns: NDArray[np.int64]
    value: NDArray[np.float64]


NO_FRAMES = Frames(np.empty(0, np.int64), np.empty((0, 0, 0), np.float32))


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """What ``measure`` gives for a block: candidates and frames that are complete by now.

    A detector whose ``trace`` is empty gives no frames; then "why was there no candidate" cannot
    be answered for it.
    """

    candidates: Candidates
    frames: Frames = NO_FRAMES


def joined(first: Measured, second: Measured) -> Measured:
    """Return two measurements, one after the other, as one."""
    return Measured(
        Candidates.concatenate([first.candidates, second.candidates]),
        Frames(
            np.concatenate([first.frames.time_ns, second.frames.time_ns]),
            np.concatenate([first.frames.value, second.frames.value]),
        ),
    )


class Detector(Protocol):
    """A detector: parameters, columns, gates, and ``measure``.

    A detector never decides: it lists its gates, and :func:`groundtrace.gates.decide` applies
    them. Its ``state`` holds everything that crosses blocks and can be deep-copied.

    A class that names this one as its base is checked by the type checker where it is written, and
    may leave out ``trace`` (there is none) and ``finish`` (nothing is held back).

    Notes
    -----
    ``Parameters`` is a frozen dataclass of documented fields (:mod:`groundtrace.parameters`).
    ``quantities`` are those of the channels it wants; it runs on every stream that has some.
    ``emits`` is what an accepted candidate becomes. ``columns`` are name and unit of what is
    measured of each candidate, first the peak of the decision function; ``trace`` the same of each
    frame, first the decision function. ``gates`` stand in the order of the decision. A detector
    may have a method ``curve`` without arguments that returns, as a :class:`Curve`, its decision
    function over the samples that the last ``measure`` completed; viewers draw it around steps.
    One that brings signals of unknown units to gravity says so by ``mean_is_gravity = True``.
    It may have a method ``reach`` without arguments, called after ``start``, that returns by the
    names of gates the most that their values can be, each a :class:`groundtrace.gates.Reach`: a
    threshold above it is told.

    It may have a class method ``unfiltered`` that takes parameters and returns the class and the
    parameters of what measures the same without its filter, or with its band as wide as can be: by
    measuring again with it, ``why`` tells whether the filter took a step out. Where what it looks
    for is no local maximum of its decision function, ``sought`` says what it is.
    """

    Parameters: type[Any]
    quantities: frozenset[str]
    emits: Emits
    columns: tuple[Quantity, ...]
    trace: tuple[Quantity, ...] = ()
    gates: tuple[Gate, ...]
    state: Any

    def __init__(self, parameters: Any) -> None: ...

    def start(self, stream: Stream) -> tuple[str, ...]:
        """Begin a contiguous run of ``stream``; return the names of the candidates' channels."""

    def measure(self, block: SignalBlock) -> Measured:
        """Take a block of any length; return what is complete, in the order of (time, channel).

        A time may be before the run's first sample, where a filter's delay is taken off: it is set
        to that sample's before anything is decided.
        """

    def finish(self) -> Measured:
        """End the run; return what was held back."""
        return Measured(Candidates.empty(len(self.columns)))


class Associator(Protocol):
    """Groups picks: like a detector, but what it measures are picks, in the order of time.

    The attributes are those of :class:`Detector`, and so is ``reach``; there is no trace.
    """

    Parameters: type[Any]
    emits: Emits
    columns: tuple[Quantity, ...]
    gates: tuple[Gate, ...]
    state: Any

    def __init__(self, parameters: Any) -> None: ...

    def start(self, spec: StageSpec) -> tuple[str, ...]:
        """Begin with the picks of the stage ``spec``; return the names of the channels."""

    def associate(self, pick: Pick) -> Candidates:
        """Take the next pick; return the groups that are complete by now."""

    def finish(self) -> Candidates:
        """Return what was held back."""
