"""Differences of two results beside their steps: parameters that differ, places that differ."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.events import Fix
from groundtrace_codecs.signals import NS_PER_S

from ..score.places import found_places, match_places, true_places
from ..score.report import last_word

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Event
    from groundtrace_codecs.labels import Label

    from ..pipeline import PipelineConfig, StageConfig


@dataclass(frozen=True, slots=True)
class ParameterChange:
    """A parameter of a stage that differs; None where a side does not have it.

    ``parameter`` is ``use`` or ``topics`` where the stage itself runs something else, or elsewhere.
    """

    stage: str
    parameter: str
    a: Any
    b: Any


def changed_parameters(a: PipelineConfig, b: PipelineConfig) -> tuple[ParameterChange, ...]:
    """Return what differs between two pipelines as their results keep them: in full.

    Of a stage that only one has, or that runs another plugin, the parameters are not compared.
    """
    one, other = ({stage.key: stage for stage in config.stage} for config in (a, b))
    changes = []
    for key in dict.fromkeys([*one, *other]):
        values = _values(one.get(key)), _values(other.get(key))
        names = list(dict.fromkeys([*values[0], *values[1]]))
        if values[0].get("use") != values[1].get("use"):
            names = ["use"]
        for name in names:
            found = values[0].get(name), values[1].get(name)
            if found[0] != found[1]:
                changes.append(ParameterChange(key, name, *found))
    return tuple(changes)


def _values(stage: StageConfig | None) -> dict[str, Any]:
    if stage is None:
        return {}
    return {"use": stage.use, "topics": list(stage.topics), **stage.parameters}


@dataclass(frozen=True, slots=True)
class PlacePair:
    """What both say about one moment.

    Attributes
    ----------
    time_s
        Of A's fix [s since the first sample].
    apart_m
        Between the two places [m].
    error_a_m, error_b_m
        Distances to the true place [m]; None where there is none.
    """

    time_s: float
    apart_m: float
    error_a_m: float | None
    error_b_m: float | None


@dataclass(frozen=True, slots=True)
class PlaceComparison:
    """Fixes of both sides, of the last stage that gives any.

    Attributes
    ----------
    a, b
        How many each has.
    median_apart_m, largest_apart_m
        Between the places of one moment [m]; None where no moment has both.
    rmse_a_m, rmse_b_m
        Of the moments that both fixed and that have a true place [m]; None where there is none.
    pairs
        Moment by moment.
    """

    a: int
    b: int
    median_apart_m: float | None
    largest_apart_m: float | None
    rmse_a_m: float | None
    rmse_b_m: float | None
    pairs: tuple[PlacePair, ...]


def compare_places(
    a: Iterable[Event],
    b: Iterable[Event],
    labels: Sequence[Label],
    start_ns: int,
    tolerance_s: float,
) -> PlaceComparison | None:
    """Compare the fixes of two results; None where one of them has none.

    Parameters
    ----------
    a, b
        All events of each.
    labels
        The truth.
    start_ns
        First sample [ns].
    tolerance_s
        Largest distance in time between two fixes of a moment, and to its truth [s].
    """
    one, other = (_fixes(events) for events in (a, b))
    if not one or not other:
        return None
    here, there, truth = found_places(one), found_places(other), true_places(labels)
    pairs = match_places(here, there, tolerance_s)
    apart = np.hypot(*(here.xy[pairs[:, 0]] - there.xy[pairs[:, 1]]).T)
    known = dict(match_places(truth, here, tolerance_s)[:, ::-1].tolist()) if len(truth) else {}
    rows = []
    for (i, j), distance in zip(pairs.tolist(), apart.tolist(), strict=True):
        at = truth.xy[known[i]] if i in known else None
        errors = (_error(here.xy[i], at), _error(there.xy[j], at))
        rows.append(PlacePair((one[i].time_ns - start_ns) / NS_PER_S, distance, *errors))
    return PlaceComparison(
        len(one),
        len(other),
        float(np.median(apart)) if len(apart) else None,
        float(apart.max()) if len(apart) else None,
        _rms([row.error_a_m for row in rows]),
        _rms([row.error_b_m for row in rows]),
        tuple(rows),
    )


def _error(xy: NDArray[np.float64], at: NDArray[np.float64] | None) -> float | None:
    return None if at is None else float(np.hypot(*(xy - at)))


def _fixes(events: Iterable[Event]) -> list[Fix]:
    found = [event for event in events if isinstance(event, Fix)]
    return sorted(last_word(found), key=lambda fix: fix.time_ns) if found else []


def _rms(errors: Sequence[float | None]) -> float | None:
    known: NDArray[np.float64] = np.array([e for e in errors if e is not None], np.float64)
    return float(np.sqrt(np.mean(known**2))) if len(known) else None
