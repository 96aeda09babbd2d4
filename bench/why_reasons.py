"""Reasons of missed steps on real recordings: how many of each cause, and whether any is amiss.

    python bench/why_reasons.py --data FOLDER

The folder holds ``mobgap``, ``oxford-step``, ``back-steps`` and other sets as published; what is
absent, or says nothing of single steps, is left out. Nothing is chosen on any of them. A violation
is a miss that has another cause than its time though a detection that answers nothing lies near
it, or that is said to have no candidate though one that is nearer to it than to any other true step
does; near is half of the step time around it, at most 0.5 s. This file looks for them on its own,
with none of what ``why`` pairs by.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from groundtrace.errors import PipelineError
from groundtrace.evaluation.matching import best_shift
from groundtrace.explain.reasons import StepReasons
from groundtrace.explain.sweep import measure_evidence
from groundtrace.explain.unfiltered import with_recording
from groundtrace.pipeline.config import load_pipeline
from groundtrace_codecs.errors import CodecError
from groundtrace_codecs.importers.run import import_recording
from groundtrace_recordings import map_path

if TYPE_CHECKING:
    from collections.abc import Iterator

#: Data set, its files, the map that says what they are (beside them where none), and pipelines.
SETS = (
    ("mobgap", "*/*/data.mat", "mobgap-test11.toml"),
    ("oxford-step/validation", "user*.csv", "oxford-step-validation.toml"),
    ("back-steps", "*/signal.csv", ""),
    ("xio-gait", "*.csv", "xio-gait.toml"),
    ("llio-pyshoe", "*_LLIO.mat", "llio-pyshoe.toml"),
    ("rieck-stepcounter", "*/*.csv", "rieck-stepcounter.toml"),
)
PIPELINES = ("waist-steps", "waist-peaks")
#: Causes that say that no candidate was there.
WITHOUT = frozenset({"filter", "quiet", "shape"})


@dataclass
class Tally:
    """What was counted of a set."""

    recordings: int = 0
    refused: int = 0
    truth: int = 0
    missed: int = 0
    pairs: int = 0
    mended: int = 0
    violations: int = 0
    causes: Counter[str] = field(default_factory=Counter)
    seconds: float = 0.0


def recordings(data: Path, folder: str, pattern: str, map_name: str) -> Iterator[Path]:
    """Import the recordings of a set, one after the other."""
    for source in sorted((data / folder).glob(pattern)):
        columns = map_path(map_name) if map_name else source.parent / "map.toml"
        truth = source.parent / "truth.csv"
        with tempfile.TemporaryDirectory() as scratch:
            out = Path(scratch) / f"{source.parent.name}-{source.stem}.mcap"
            given = truth if truth.is_file() else None
            try:
                import_recording([source], out, map_path=columns, truth=given)
            except CodecError as error:
                print(error)
                continue
            yield out


def violations(reasons: StepReasons) -> list[tuple[int, str]]:
    """Return misses whose cause is not what it must be: number of the step, and why."""
    matching, evidence = reasons.matching, reasons.evidence
    truth = matching.truth_ns.tolist()
    final = [part for part in evidence.stages if part.spec.emits == "step"]
    final = [part for part in final if part.spec.stage == final[-1].spec.stage]
    candidates = sorted(t for part in final for t in part.candidates.time_ns.tolist())
    free = set(matching.found_ns[matching.false].tolist()) - {p.found_ns for p in reasons.pairs}
    amiss = []
    for index in matching.missed.tolist():
        at, reason = truth[index], reasons.at(truth[index])
        gaps = np.diff(truth[max(0, index - 2) : index + 3])
        near = min(0.5 * float(np.median(gaps)), 0.5e9) if len(gaps) else 0.5e9
        if reason.cause != "timing" and any(abs(t - at) <= near for t in free):
            amiss.append((index + 1, "an unmatched detection is near"))
        near_candidates = [t for t in candidates if abs(t - at) <= near]
        others = truth[:index] + truth[index + 1 :]
        near_candidates = [
            t for t in near_candidates if all(abs(t - o) > abs(t - at) for o in others)
        ]
        if reason.cause in WITHOUT and near_candidates:
            amiss.append((index + 1, "a candidate is near"))
    return amiss


def judge(path: Path, pipeline: str, tally: Tally) -> None:
    """Explain every miss of a recording, and add it up; a pipeline may refuse its signals."""
    try:
        evidence = measure_evidence(path, load_pipeline(pipeline))
    except PipelineError:
        tally.refused += 1
        return
    if not any(label.kind == "step" for label in evidence.labels) or not evidence.stages:
        return
    began = time.perf_counter()
    reasons = StepReasons(with_recording(evidence, "", [path]), 0.12)
    matching = reasons.matching
    missed = matching.truth_ns[matching.missed].tolist()
    tally.causes.update(reasons.at(t).cause for t in missed)
    tally.seconds += time.perf_counter() - began
    shift = best_shift(matching, reasons.pairs)
    tally.recordings += 1
    tally.truth += len(matching.truth_ns)
    tally.missed += len(missed)
    tally.pairs += len(reasons.pairs)
    tally.mended += 0 if shift is None else shift.mends
    for step, why in violations(reasons):
        tally.violations += 1
        print(f"  {path.stem}, step {step}: {why}")


def main() -> None:
    """Print a line for each set and pipeline."""
    parser = argparse.ArgumentParser(description=__doc__)
    default = os.environ.get("GROUNDTRACE_DATA", "../shared/data")
    parser.add_argument("--data", type=Path, default=Path(default))
    options = parser.parse_args()
    for folder, pattern, map_name in SETS:
        tallies = {pipeline: Tally() for pipeline in PIPELINES}
        for path in recordings(options.data, folder, pattern, map_name):
            for pipeline, tally in tallies.items():
                judge(path, pipeline, tally)
        for pipeline, t in tallies.items():
            if not t.recordings:
                refused = f", {t.refused} recordings refused" if t.refused else ""
                print(f"{folder}, {pipeline}: no true steps{refused}")
                continue
            causes = ", ".join(f"{n} {cause}" for cause, n in t.causes.most_common())
            print(
                f"{folder}, {pipeline}: {t.recordings} recordings, {t.missed} of {t.truth} steps "
                f"missed ({causes or 'none'}); {t.pairs} found at the wrong time, {t.mended} of "
                f"them mended by one shift; {t.violations} violations; {t.seconds:.1f} s"
            )


if __name__ == "__main__":
    main()
