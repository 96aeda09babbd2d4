"""Reasons of missed steps on recordings that others made: none that its numbers do not bear out."""

from __future__ import annotations

import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from reason_texts import Claims

from groundtrace.evaluation.matching import best_shift
from groundtrace.explain.reasons import StepReasons
from groundtrace.explain.sweep import measure_evidence
from groundtrace.explain.unfiltered import with_recording
from groundtrace.pipeline.config import load_pipeline
from groundtrace_codecs.importers.run import import_recording
from groundtrace_recordings import map_path

if TYPE_CHECKING:
    from collections.abc import Callable

    Reader = Callable[[str, str], StepReasons]

BENCH = Path(__file__).parents[3] / "bench" / "why_reasons.py"
BACK = "mobgap-test11.toml"
PHONE = "oxford-step-validation.toml"
PLACES = (
    ("mobgap/MS/001/data.mat", BACK),
    ("mobgap/HA/001/data.mat", BACK),
    ("oxford-step/validation/user1_armband_1506423438471.csv", PHONE),
    ("oxford-step/validation/user1_hand_1506421989895.csv", PHONE),
)


@pytest.fixture(scope="module")
def bench() -> Any:
    """Return the bench, which finds violations with none of what ``why`` pairs by."""
    spec = spec_from_file_location("why_reasons", BENCH)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    sys.modules["why_reasons"] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def read(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Reader:
    """Return what imports a recording once, and explains what a pipeline makes of it."""
    folder, maps = tmp_path_factory.mktemp("real"), dict(PLACES)

    def of(name: str, pipeline: str) -> StepReasons:
        path = folder / name.replace("/", "-").replace(".csv", ".mcap").replace(".mat", ".mcap")
        if not path.exists():
            import_recording([data / name], path, map_path=map_path(maps[name]))
        evidence = measure_evidence(path, load_pipeline(pipeline))
        return StepReasons(with_recording(evidence, "", [path]), 0.12)

    return of


@pytest.mark.parametrize("pipeline", ["waist-steps", "waist-peaks"])
@pytest.mark.parametrize("name", [name for name, _ in PLACES])
def test_every_reason_of_a_real_miss_is_borne_out(
    name: str, pipeline: str, read: Reader, bench: Any
) -> None:
    reasons = read(name, pipeline)
    assert bench.violations(reasons) == []
    missed = reasons.matching.truth_ns[reasons.matching.missed].tolist()
    assert missed
    for time_ns in missed:
        Claims(reasons, reasons.at(time_ns), time_ns).check()


def test_one_shift_is_told_first_where_it_mends_nearly_all(read: Reader) -> None:
    reasons = read(PLACES[2][0], "waist-steps")
    shift = best_shift(reasons.matching, reasons.pairs)
    assert shift is not None
    assert shift.pairs >= 0.95 * len(reasons.matching.missed)
    assert shift.mends >= 0.95 * shift.pairs
    assert shift.late_ms < -100
