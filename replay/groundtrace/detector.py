"""What a detector measures: candidates, the trace of frames, and the curve that viewers draw."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .gates import Candidates

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray


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
    """What a block completes: frames and candidates, which ``process`` yields.

    A detector whose ``trace`` is empty gives no frames; then "why was there no candidate" cannot
    be answered for it.
    """

    candidates: Candidates
    frames: Frames = NO_FRAMES

    def __iter__(self) -> Iterator[Frames | Candidates]:
        """Yield the frames, then the candidates, as results hold them."""
        yield self.frames
        yield self.candidates


def joined(first: Measured, second: Measured) -> Measured:
    """Return two measurements, one after the other, as one."""
    return Measured(
        Candidates.concatenate([first.candidates, second.candidates]),
        Frames(
            np.concatenate([first.frames.time_ns, second.frames.time_ns]),
            np.concatenate([first.frames.value, second.frames.value]),
        ),
    )
