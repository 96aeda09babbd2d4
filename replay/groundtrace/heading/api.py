"""What a heading filter is, and what it says of a frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, overload

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

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


@dataclass(frozen=True, slots=True, eq=False)
class HeadingFrames(Sequence[HeadingFrame]):
    """Consecutive frames in columns.

    Attributes
    ----------
    time_ns, orientation, heading_rad
        Of the samples of all frames, shapes (m,), (m, 4), (m,), as those of a frame.
    first
        Where each frame begins among them, and where the last ends, shape (n + 1,), int64.
    sigma_rad, bias, values, undisturbed, compass, resting
        Of each frame, shapes (n,), (n, 3), (n, n_columns), (n,), (n,), (n,).
    notes
        Of each frame that has some.
    """

    time_ns: NDArray[np.int64]
    orientation: Array
    heading_rad: Array
    first: NDArray[np.int64]
    sigma_rad: Array
    bias: Array
    values: Array
    undisturbed: NDArray[np.bool_]
    compass: NDArray[np.bool_]
    resting: NDArray[np.bool_]
    notes: dict[int, tuple[str, ...]]

    @classmethod
    def of(cls, frames: Sequence[HeadingFrame]) -> HeadingFrames:
        """Return frames, at least one, in columns."""
        return cls(
            np.concatenate([f.time_ns for f in frames]),
            np.concatenate([f.orientation for f in frames]),
            np.concatenate([f.heading_rad for f in frames]),
            np.cumsum([0, *(len(f.time_ns) for f in frames)], dtype=np.int64),
            np.array([f.sigma_rad for f in frames]),
            np.stack([f.bias for f in frames]),
            np.stack([f.values for f in frames]),
            np.array([f.undisturbed for f in frames], np.bool_),
            np.array([f.compass for f in frames], np.bool_),
            np.array([f.resting for f in frames], np.bool_),
            {i: f.notes for i, f in enumerate(frames) if f.notes},
        )

    @classmethod
    def concatenate(cls, parts: Sequence[HeadingFrames]) -> HeadingFrames:
        """Return all frames of some parts, at least one."""
        if len(parts) == 1:
            return parts[0]
        begins = np.cumsum([0, *(len(p.time_ns) for p in parts)])
        frames = np.cumsum([0, *(len(p) for p in parts)]).tolist()
        firsts = [p.first[:-1] + at for p, at in zip(parts, begins[:-1], strict=True)]
        return cls(
            np.concatenate([p.time_ns for p in parts]),
            np.concatenate([p.orientation for p in parts]),
            np.concatenate([p.heading_rad for p in parts]),
            np.concatenate([*firsts, begins[-1:]]),
            np.concatenate([p.sigma_rad for p in parts]),
            np.concatenate([p.bias for p in parts]),
            np.concatenate([p.values for p in parts]),
            np.concatenate([p.undisturbed for p in parts]),
            np.concatenate([p.compass for p in parts]),
            np.concatenate([p.resting for p in parts]),
            {at + i: n for p, at in zip(parts, frames, strict=False) for i, n in p.notes.items()},
        )

    @property
    def lengths(self) -> NDArray[np.int64]:
        """How many samples each frame has, shape (n,)."""
        return np.diff(self.first)

    def __len__(self) -> int:
        return len(self.sigma_rad)

    @overload
    def __getitem__(self, index: int) -> HeadingFrame: ...

    @overload
    def __getitem__(self, index: slice) -> list[HeadingFrame]: ...

    def __getitem__(self, index: int | slice) -> HeadingFrame | list[HeadingFrame]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        place = range(len(self))[index]
        rows = slice(int(self.first[place]), int(self.first[place + 1]))
        return HeadingFrame(
            self.time_ns[rows],
            self.orientation[rows],
            self.heading_rad[rows],
            float(self.sigma_rad[place]),
            self.bias[place],
            self.values[place],
            bool(self.undisturbed[place]),
            bool(self.compass[place]),
            bool(self.resting[place]),
            self.notes.get(place, ()),
        )


class HeadingFilter(Protocol):
    """A heading filter: samples in, frames out, in any portions.

    Notes
    -----
    A frame is undisturbed where all gates of its stage pass. All state can be deep-copied.
    """

    def add(self, samples: Samples) -> Sequence[HeadingFrame]:
        """Take samples of any number; return the frames that are complete by now."""

    def finish(self) -> Sequence[HeadingFrame]:
        """Return what was held back."""
