"""Samples that are not finite: held at the last finite value, and counted."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from groundtrace_codecs.signals import SignalBlock


@dataclass(slots=True)
class Holder:
    """Replaces NaN and infinities by each channel's last finite value (0 before the first).

    Attributes
    ----------
    count
        How many samples were replaced.
    last_ns
        Time of the last one [ns].
    """

    count: int = 0
    last_ns: int = 0
    _last: NDArray[Any] | None = None

    def held(self, block: SignalBlock) -> SignalBlock:
        """Return the block with every sample finite; the same object where it was."""
        samples = block.samples
        if samples.dtype.kind != "f" or not len(block):
            return block
        finite = np.isfinite(samples)
        before = np.zeros(samples.shape[1], samples.dtype) if self._last is None else self._last
        if not finite.all():
            self.count += int((~finite).sum())
            self.last_ns = block.time_of(int(np.flatnonzero(~finite.all(axis=1))[-1]))
            extended = np.concatenate([before[None, :], samples])
            known = np.concatenate([np.ones((1, samples.shape[1]), np.bool_), finite])
            rows = np.arange(len(extended))[:, None]
            source = np.maximum.accumulate(np.where(known, rows, 0), axis=0)
            samples = np.take_along_axis(extended, source, axis=0)[1:]
            block = replace(block, samples=samples)
        self._last = samples[-1].copy()
        return block
