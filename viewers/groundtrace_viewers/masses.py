"""What sensors believe of each candidate: masses of each and combined, with their conflict."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .palette import CONFLICT, EITHER, NO_PEAK, PEAK
from .timeline import Entity

if TYPE_CHECKING:
    from groundtrace_codecs.events import CandidateBlock, StageSpec

    from .timeline import Timeline

#: A plot's source, and the columns of its masses: on peak, no peak, either; combined also K.
PLOTS = (
    (
        "accelerometer",
        ("accelerometer_peak", "accelerometer_nonpeak", "accelerometer_peak_ignorance"),
    ),
    ("gyroscope", ("gyroscope_peak", "gyroscope_nonpeak", "gyroscope_peak_ignorance")),
    ("combined", ("peak_mass", "nonpeak_mass", "peak_ignorance", "peak_conflict")),
)
NAMES = ("pic", "nonpic", "Θ", "K")
COLOURS = (PEAK, NO_PEAK, EITHER, CONFLICT)


class MassLog:
    """Logs the masses of one stage's candidates.

    Parameters
    ----------
    timeline
        Where to.
    spec
        The stage; its columns are masses.
    span_ns
        Of the recording: the plots begin and end with it [ns].
    """

    def __init__(self, timeline: Timeline, spec: StageSpec, span_ns: tuple[int, int]) -> None:
        self._timeline = timeline
        self._root = f"/masses/{spec.stage}/{spec.topic.strip('/')}"
        names = [q.name for q in spec.columns]
        self._columns = {
            source: [names.index(column) for column in columns] for source, columns in PLOTS
        }
        for source, columns in PLOTS:
            self._declare(source, len(columns))
            nothing = np.full((2, len(columns)), np.nan)
            timeline.scalars(f"{self._root}/{source}/lines", span_ns, nothing)

    @staticmethod
    def fits(spec: StageSpec) -> bool:
        """Whether a stage measures masses."""
        names = {q.name for q in spec.columns}
        return all(names.issuperset(columns) for _, columns in PLOTS)

    def candidates(self, block: CandidateBlock) -> None:
        """Log the masses of decided candidates."""
        if not len(block):
            return
        for source, columns in self._columns.items():
            values = block.value[:, columns]
            for kind in ("lines", "points"):
                self._timeline.scalars(f"{self._root}/{source}/{kind}", block.time_ns, values)

    def _declare(self, source: str, count: int) -> None:
        import rerun as rr

        conflict = ", their conflict K yellow" if source == "combined" else ""
        title = f"Masses, {source}: pic green, nonpic red, Θ grey{conflict}"
        colours = np.array(COLOURS[:count], np.uint32)
        points = rr.SeriesPoints(
            names=NAMES[:count],
            colors=colours,
            markers=["circle"] * count,
            marker_sizes=[3.0] * count,
        )
        # the lines only lead the eye from candidate to candidate
        faint = (colours & np.uint32(0xFFFFFF00)) | np.uint32(0x50)
        lines = rr.SeriesLines(
            names=[" "] * count,
            colors=faint,
            widths=[1.0] * count,
            aggregation_policy=rr.components.AggregationPolicy.MinMax,
        )
        path = f"{self._root}/{source}"
        self._timeline.declare(Entity(path, "masses", title, count, top=1.0))
        self._timeline.static(f"{path}/lines", lines)
        self._timeline.static(f"{path}/points", points)
