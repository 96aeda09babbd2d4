"""Outlines: which part of the plane a place is looked for in."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import shapely

from ..errors import PipelineError

if TYPE_CHECKING:
    from numpy.typing import NDArray

#: Without an outline the sensors' rectangle is searched, widened by this part of its longer side.
MARGIN = 0.1


def outline_of(
    positions: NDArray[np.float64], outline: NDArray[np.float64] | None = None
) -> shapely.Polygon:
    """Return the area to search.

    Parameters
    ----------
    positions
        Shape (n, 2): sensors [m].
    outline
        Shape (k, 2): corners of the room [m]; None stands for the sensors' rectangle, widened.

    Raises
    ------
    PipelineError
        Where the outline encloses no area or crosses itself, or no sensors span one.
    """
    if outline is None or len(outline) == 0:
        low, high = positions.min(axis=0), positions.max(axis=0)
        pad = MARGIN * float(np.max(high - low))
        room = shapely.box(*(low - pad), *(high + pad))
    else:
        room = shapely.Polygon(outline) if len(outline) > 2 else shapely.Polygon()
    if room.area <= 0 or not room.is_valid:
        raise PipelineError(
            f"geometry: outline: expected corners around an area, found "
            f"{shapely.is_valid_reason(room) if room.area > 0 else 'none'}"
        )
    return room
