"""What a comparison is to a pipeline: parameters, columns, gates, and ``compare``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from collections.abc import Sequence

    from groundtrace_codecs.events import Fix, Quantity

    from ..detector import Emits
    from ..gates import Candidates, Gate


class Comparison(Protocol):
    """Compares the fixes of one step: it measures, and its gates decide what counts.

    Notes
    -----
    The first two columns are a distance [m] and the same in standard deviations. The channel of a
    candidate is the pair of localizers, counted in the order of :func:`itertools.combinations`.
    """

    Parameters: type[Any]
    emits: Emits
    columns: tuple[Quantity, ...]
    gates: tuple[Gate, ...]

    def __init__(self, parameters: Any) -> None: ...

    def compare(self, fixes: Sequence[Fix | None]) -> Candidates:
        """Return one candidate, or none, of the fixes of a step; None for a localizer without."""
