"""Frames of discernment: the hypotheses, and the order of their subsets in an array of masses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..errors import BeliefError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Frame:
    """Hypotheses of which exactly one is true.

    A subset is a number whose bit ``i`` says whether hypothesis ``i`` is in it: 0 is the empty
    set, ``2^k - 1`` the whole frame (total ignorance). Masses lie in that order along the last
    axis of an array; for ``Frame(("peak", "other"))`` it is empty, peak, other, both.

    Attributes
    ----------
    hypotheses
        Their names, all different, at least one.
    """

    hypotheses: tuple[str, ...]

    def __post_init__(self) -> None:
        if not self.hypotheses or len(set(self.hypotheses)) < len(self.hypotheses):
            raise BeliefError(
                f"Frame: hypotheses: expected different names, found {self.hypotheses!r}"
            )

    @property
    def size(self) -> int:
        """Number of subsets, 2^k."""
        return int(2 ** len(self.hypotheses))

    @property
    def whole(self) -> int:
        """The subset that holds every hypothesis."""
        return self.size - 1

    def subset(self, names: Iterable[str]) -> int:
        """Return the subset of some hypotheses.

        Raises
        ------
        BeliefError
            Where one is not of this frame.
        """
        found = 0
        for name in names:
            if name not in self.hypotheses:
                known = ", ".join(self.hypotheses)
                raise BeliefError(f"Frame: expected a hypothesis of {known}, found {name!r}")
            found |= 1 << self.hypotheses.index(name)
        return found

    def complement(self, subset: int) -> int:
        """Return what is not in a subset."""
        return self.whole & ~subset


def hypotheses_of(masses: NDArray[Any]) -> int:
    """Return the number of hypotheses of an array of masses, shape (..., 2^k).

    Raises
    ------
    BeliefError
        Where the last axis is no power of two from 2 on.
    """
    size = masses.shape[-1] if masses.ndim else 0
    if size < 2 or size & (size - 1):
        raise BeliefError(f"masses: expected a last axis of 2^k subsets, found {masses.shape}")
    return size.bit_length() - 1
