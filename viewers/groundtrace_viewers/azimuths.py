"""Where steps went: the azimuths and lengths of dead reckoning in the table of steps."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from groundtrace_codecs.events import CandidateBlock

    from .timeline import Timeline

#: Columns of a reckoner's candidates that the table shows, with their names there.
SHOWN = {"azimuth": "azimuth_deg", "length": "length_m", "mounting": "mounting_deg"}


class AzimuthLog:
    """Adds columns to the rows of steps that a reckoner took.

    A row of the table is a moment, so that what is logged at the time of a step stands in its row.
    """

    def __init__(self, timeline: Timeline) -> None:
        self._timeline = timeline
        self._pending: list[CandidateBlock] = []

    def candidates(self, block: CandidateBlock) -> None:
        """Take decided candidates; those of a reckoner are the steps, moment by moment."""
        names = {column.name for column in block.spec.columns}
        if block.spec.emits == "track" and SHOWN.keys() <= names:
            self._pending.append(block)

    def flush(self) -> None:
        """Log what is pending."""
        import rerun as rr

        for spec in dict.fromkeys(block.spec for block in self._pending):
            blocks = [block for block in self._pending if block.spec == spec]
            taken = np.concatenate([block.accepted for block in blocks])
            times = np.concatenate([block.time_ns for block in blocks])[taken]
            values = np.concatenate([block.value for block in blocks])[taken]
            names = [column.name for column in spec.columns]
            # more digits would only fill the table
            values = values.astype(np.float64).round(2)
            shown = {title: values[:, names.index(name)] for name, title in SHOWN.items()}
            if len(times):
                self._timeline.send("/table/steps", times, rr.AnyValues.columns(**shown))
        self._pending = []
