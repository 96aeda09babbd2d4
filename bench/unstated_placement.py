"""Steps where nobody states the placement of the sensor: the second table of placement.md.

    python bench/unstated_placement.py --data FOLDER [--each]

The folder holds ``mobgap``, ``oxford-step``, ``back-steps``, ``llio-pyshoe``, ``xio-gait`` and
``indoor-location-20`` as published; what is absent is left out. What a recording states is taken
away; then ``waist-steps`` runs with its defaults (as it did before the guess counted), with the
guess as a replay takes it, and with the placement stated. How sure a guess must be was chosen on
``mobgap`` and ``oxford-step``; the other sets had no part in it.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from placement_guess import HANDLED, Case, cases
from step_accuracy import PHONE, Steps

from groundtrace.evaluation.steps import score_steps
from groundtrace.explain.suitability import with_placements
from groundtrace.inertial.placement import PlacementWatch
from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import load_pipeline
from groundtrace.pipeline.engine import replay
from groundtrace.pipeline.source import Source
from groundtrace_codecs.importers.run import import_recording
from groundtrace_codecs.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from groundtrace.evaluation.steps import StepScore
    from groundtrace.pipeline.config import PipelineConfig
    from groundtrace_codecs.recording import LoggedBlock
    from groundtrace_codecs.signals import Stream

TOLERANCE_S = 0.12
#: Sets that the sureness was chosen on.
CHOSEN_ON = ("mobgap", "oxford-step")
WAYS = ("before", "now", "stated")


class Unstated:
    """One stream of a recording whose placement nobody states."""

    def __init__(self, recording: Recording, stream: Stream) -> None:
        self._recording = recording
        self.streams = (replace(stream, placement=""),)

    def blocks(
        self,
        topics: Collection[str] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
        joined_ns: int = 0,
    ) -> Iterator[LoggedBlock]:
        """Yield its blocks."""
        wanted = topics or [stream.topic for stream in self.streams]
        logged_blocks = self._recording.blocks(wanted, start_ns, stop_ns, joined_ns)
        for stamped in logged_blocks:
            unstated = replace(stamped.block.stream, placement="")
            yield stamped._replace(block=replace(stamped.block, stream=unstated))


class Run(NamedTuple):
    """What came of a recording: the guess that was taken, and steps and score of each way."""

    name: str
    taken: str
    steps: dict[str, int]
    scores: dict[str, StepScore | None]


def run_of(case: Case, truth: Path | None) -> Run:
    """Import a recording, take its placement away, and find its steps in three ways."""
    with tempfile.TemporaryDirectory() as scratch:
        file = Path(scratch) / "rec.mcap"
        columns = case.columns
        if columns is not None and '"a.u."' in (text := columns.read_text()):
            columns = Path(scratch) / "map.toml"  # a field that no step looks at
            columns.write_text(text.replace('"a.u."', '"count"'))
        import_recording([case.path], file, map_path=columns, truth=truth)
        with Recording.open(file) as opened:
            stream = next(s for s in opened.streams if PlacementWatch.fits(s))
            recording = Unstated(opened, stream)
            config = load_pipeline("waist-steps")
            now, _, _ = with_placements(config, recording)
            worn = stream.placement or "waist"
            ways = {
                "before": replace(config, placements={stream.topic: ""}),
                "now": now,
                "stated": replace(config, placements={stream.topic: worn}),
            }
            times_by_way = {name: _steps(way, recording) for name, way in ways.items()}
            span = opened.start_ns, opened.end_ns
            scored = any(label.kind == "step" for label in opened.labels)
            scores = {
                name: score_steps(opened.labels, times, *span, TOLERANCE_S) if scored else None
                for name, times in times_by_way.items()
            }
    name = "/".join(
        case.path.parts[-3:-1] if case.path.stem in ("data", "signal") else case.path.parts[-1:]
    )
    counts = {way: len(times) for way, times in times_by_way.items()}
    return Run(name, now.placements[stream.topic], counts, scores)


def _steps(config: PipelineConfig, recording: Unstated) -> np.ndarray:
    sink = Steps()
    replay(Source(recording), build_pipeline(config), [sink])
    return np.array(sorted(sink.times), np.int64)


def all_cases(folder: Path, phone: Path) -> Iterator[tuple[str, Case, Path | None]]:
    """Yield set, recording and truth."""
    for case in cases(folder, phone):
        if case.worn != HANDLED:
            yield case.path.relative_to(folder).parts[0], case, None
    for path in sorted(folder.glob("back-steps/*/signal.csv")):
        columns, truth = path.with_name("map.toml"), path.with_name("truth.csv")
        yield "back-steps", Case("lower back", path, columns), truth


def main() -> None:
    """Print a row for each set, and with ``--each`` one for each recording."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--data", type=Path, default=Path(os.environ.get("GROUNDTRACE_DATA", "../shared/data"))
    )
    parser.add_argument("--each", action="store_true", help="print every recording")
    options = parser.parse_args()
    sets: dict[str, list[Run]] = defaultdict(list)
    with tempfile.TemporaryDirectory() as scratch:
        phone = Path(scratch) / "phone.toml"
        phone.write_text(PHONE)
        for name, case, truth in all_cases(options.data, phone):
            run = run_of(case, truth)
            sets[name].append(run)
            if options.each:
                _print_run(name, run)
    print(
        f"{'set':20} recordings  taken for      F1 at 0.12 s           latency [ms]   fell by .02"
    )
    for name, runs in sets.items():
        _print_set(name, runs)


def _print_run(name: str, run: Run) -> None:
    parts = []
    for way in WAYS:
        score = run.scores[way]
        f1 = (
            "" if score is None else f" F1 {score.f1:.3f} ({score.f1_debiased:.3f} without latency)"
        )
        parts.append(f"{way} {run.steps[way]}{f1}")
    print(f"{name} {run.name}: taken for {run.taken or 'nothing'}; " + "; ".join(parts), flush=True)


def _print_set(name: str, runs: list[Run]) -> None:
    taken = defaultdict(int)
    for run in runs:
        taken[run.taken or "-"] += 1
    placements = " ".join(f"{count} {placement}" for placement, count in sorted(taken.items()))
    scored = [run.scores for run in runs if run.scores["now"] is not None]
    row = f"{name:20} {len(runs):10}  {placements:30}"
    if scored:
        f1 = " ".join(f"{np.mean([s[way].f1 for s in scored]):.3f}" for way in WAYS)
        late = " ".join(
            f"{np.mean([s[way].latency_ms.median for s in scored if s[way].latency_ms]):+.0f}"
            for way in WAYS
        )
        worse = sum(s["now"].f1 < s["before"].f1 - 0.02 for s in scored)
        row += f"  {f1}   {late}   {worse}"
    else:
        changed = sum(run.steps["now"] != run.steps["before"] for run in runs)
        row += f"  steps changed in {changed}"
    print(row + ("  (chosen on)" if name in CHOSEN_ON else ""))


if __name__ == "__main__":
    main()
