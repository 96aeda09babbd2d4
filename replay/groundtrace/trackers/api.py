"""What trackers share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from ..parameters import measured


@dataclass(frozen=True, slots=True)
class TrackerParameters:
    """Parameters that every tracker has."""

    source: Annotated[
        str, measured("", "Stage whose fixes are tracked; empty takes the first localizer.")
    ] = ""
    together_s: Annotated[
        float, measured("s", "Fixes so close in time are of different walkers.", ge=0)
    ] = 0.1
