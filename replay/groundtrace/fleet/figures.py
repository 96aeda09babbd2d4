"""Which figures of a score are columns of a fleet's table."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..exports.tables import ColumnType
    from ..score import Score

_CONFUSION = "compared:int agreed:int accuracy:float"
_CONSISTENCY = (
    "n:int dof:int mean:float lower:float upper:float consistent:bool inside_fraction:float"
)
#: Parts of a score, and their figures; lists (curves, impacts, vehicles) stay in ``score_json``.
_PARTS = {
    "steps": "truth:int detected:int matched:int precision:float recall:float f1:float "
    "chance_f1:float chance_f1_metronome:float f1_debiased:float count_truth:int count_error:int "
    "count_error_signed:int",
    "steps.latency_ms": "median:float iqr:float",
    "steps.feet": _CONFUSION,
    "steps.kinds": _CONFUSION,
    "positions": "stage:text truth:int found:int n:int rmse_m:float cep50_m:float cep95_m:float "
    "bias_x_m:float bias_y_m:float",
    "picks": "stage:text",
    "picks.all": "truth:int right:int late:int early:int missed:int answered:int "
    "answered_fraction:float median_abs_ms:float median_ms:float iqr_ms:float earliest_ms:float "
    "latest_ms:float",
    "track": "stage:text times:int tracks:int ospa_m:float gospa_m:float localisation_rmse_m:float "
    "missed:int false:int completeness:float ambiguity:float spuriousness:float accuracy_m:float "
    "cutoff_m:float order:float",
    "track.identity": "switches:int idf1:float",
    "track.closure": "walked_m:float apart_m:float true_apart_m:float percent:float "
    "aligned_rmse_m:float aligned_end_m:float",
    "track.waypoints": "n:int median_m:float mean_m:float p95_m:float end_m:float way_m:float "
    "end_percent:float way_error_percent:float",
    "track.ways": "n:int across_median_m:float across_p90_m:float along_median_m:float "
    "speed_median_mps:float",
    "heading": "stage:text truth:int n:int rmse_deg:float bias_deg:float p95_deg:float",
    "disturbance": "stage:text precision:float recall:float f1:float truth_s:float found_s:float "
    "both_s:float false_alarm_s:float scored_s:float",
    "consistency.nees_fixes": _CONSISTENCY,
    "consistency.nees_tracks": _CONSISTENCY,
    "consistency.nis": _CONSISTENCY,
    "passes": "stage:text truth:int found:int matched:int tolerance_s:float median_abs_s:float "
    "bias_s:float order_right:bool vehicles_right:int speed_median_percent:float",
}


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure of a score.

    Attributes
    ----------
    name
        Of its column.
    type
        Of its cells.
    path
        Where a :class:`~groundtrace.score.Score` has it.
    """

    name: str
    type: ColumnType
    path: tuple[str, ...]

    def of(self, score: Score) -> Any:
        """Return the figure; None where there is no truth for it."""
        value: Any = score
        for step in self.path:
            value = None if value is None else getattr(value, step)
        return value


def _figures() -> tuple[Figure, ...]:
    found = []
    for part, listed in _PARTS.items():
        prefix = part.removesuffix(".all").replace(".", "_")
        for item in listed.split():
            name, _, kind = item.partition(":")
            path = (*part.split("."), name)
            found.append(Figure(f"{prefix}_{name}", kind, path))  # type: ignore[arg-type]
    return tuple(found)


#: In the order of the columns.
FIGURES = _figures()
