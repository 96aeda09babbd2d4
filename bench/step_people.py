"""Steps of people that nothing was trained on: the tables by person of steps.md.

    python bench/step_people.py --data FOLDER

The folder holds ``back-steps`` and ``mobgap`` as published. Both networks are trained anew without
each person in turn, and judged on that one (``--groups 4``: three people at a time, which is
quicker); what ships is trained on all. Threshold and sizes were looked at in the same
tables, so the last digit is none. The rivals, which are not trained, run through their pipelines
with the placement stated.
"""

from __future__ import annotations

import argparse
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from train_step_score import (
    Points,
    Run,
    candidates,
    changed,
    lessons,
    paused,
    runs_of,
    runs_of_all,
    train_both,
    walks_of_all,
)

from groundtrace.detectors.adaptive import AdaptiveParameters
from groundtrace.evaluation.matching import f1_score, inside, match, metronome_f1
from groundtrace_codecs.signals import NS_PER_S

if TYPE_CHECKING:
    from groundtrace.detectors.step_score import Weights

    Array = np.ndarray

NARROW_S, WIDE_S = 0.12, 0.25
RATES_HZ = (None, 30.0, 10.0, 6.0)
#: Copies of walks: so much slower.
SLOWER = (0.65, 0.8, 1.0, 1.25, 1.5, 2.0, 3.0, 4.5)
PAUSED_SEED = 11
RIVALS = (
    ("rhythm at the trunk", "waist-steps", {"method": "rhythm"}),
    ("peaks (DP)", "waist-peaks", {}),
    ("belief (DSTP)", "waist-dstp", {}),
    ("crossings (ZC)", "waist-crossings", {}),
    ("rest and swing", "waist-swing", {}),
    ("stances of a foot (ZVI)", "foot-stances", {}),
)


@dataclass
class Tally:
    """Counts of matched steps."""

    true: int = 0
    found: int = 0
    matched: int = 0
    hits: dict[str, list[bool]] = field(default_factory=dict)

    def add(self, run: Run, found_s: Array, tolerance_s: float) -> Array:
        """Match what was found in a walk; return index pairs of (all true, all found)."""
        spans = run.spans + np.array([0.1 - tolerance_s, tolerance_s - 0.1])
        scored = np.flatnonzero(inside(run.true_s, spans))
        counted = np.flatnonzero(inside(found_s, spans))
        pairs = match(run.true_s[scored], found_s[counted], tolerance_s)
        self.true, self.found = self.true + len(scored), self.found + len(counted)
        self.matched += len(pairs)
        hit = np.zeros(len(run.true_s), bool)
        if len(pairs):
            hit[scored[pairs[:, 0]]] = True
        if run.walk.startswith("back-steps"):  # whole walks, from standing to standing
            for row in scored:
                self.hits.setdefault(kind_of(run, row), []).append(bool(hit[row]))
        return np.column_stack([scored[pairs[:, 0]], counted[pairs[:, 1]]])

    @property
    def f1(self) -> float:
        """F1 of all."""
        return f1_score(self.true, self.found, self.matched)

    def part(self, kind: str) -> float:
        """Part of the steps of a kind that was found."""
        return float(np.mean(self.hits.get(kind, [False])))


def kind_of(run: Run, row: int) -> str:
    """Return whether a step is the first or last one, in a turn, or straight."""
    if row in (0, len(run.true_s) - 1):
        return "last" if row else "first"
    return "turn" if run.turning[row] else "straight"


@dataclass
class Judged:
    """Tallies at two tolerances, of everybody and of each person."""

    narrow: Tally = field(default_factory=Tally)
    wide: Tally = field(default_factory=Tally)
    people: dict[str, tuple[Tally, Tally]] = field(default_factory=dict)
    errors: list[tuple[float, float]] = field(default_factory=list)

    def add(self, run: Run, rows: Array) -> None:
        """Take the steps found in a walk: times, and their uncertainty in the last column."""
        rows = rows[np.argsort(rows[:, 0])]
        tallies = self.people.setdefault(run.person, (Tally(), Tally()))
        for tally, tolerance_s in zip((self.narrow, tallies[0]), (NARROW_S, NARROW_S), strict=True):
            tally.add(run, rows[:, 0], tolerance_s)
        tallies[1].add(run, rows[:, 0], WIDE_S)
        pairs = self.wide.add(run, rows[:, 0], WIDE_S)
        late = rows[pairs[:, 1], 0] - run.true_s[pairs[:, 0]]
        self.errors += list(zip(late, rows[pairs[:, 1], -1], strict=True))

    def row(self, name: str) -> str:
        """Return a line of the table."""
        narrow, wide = self.narrow, self.wide
        parts = "  ".join(
            f"{narrow.part(kind):.2f} / {wide.part(kind):.2f}"
            for kind in ("first", "last", "turn", "straight")
        )
        return f"{name:26} {narrow.f1:.3f} / {wide.f1:.3f}  {parts}"


def whole(runs: list[Run], rows: list[Array]) -> list[tuple[Run, Array]]:
    """Return the walks whose runs these are, with all that was found in them."""
    together: dict[str, tuple[Run, list[Array]]] = {}
    for run, steps in zip(runs, rows, strict=True):
        together.setdefault(run.walk, (run, []))[1].append(steps)
    return [(run, np.concatenate(parts)) for run, parts in together.values()]


def judged(runs: list[Run], weights: dict[str, Weights]) -> Judged:
    """Score the runs of each person by the network that never saw that person."""
    default, rows = AdaptiveParameters(), []
    for run in runs:
        peaks = candidates(run, weights[run.person])
        passing = (peaks[:, 2] >= default.score) & (peaks[:, 3] >= default.apart)
        rows.append(peaks[passing][:, [0, 6]])
    result = Judged()
    for run, steps in whole(runs, rows):
        result.add(run, steps)
    return result


def metronome(runs: list[Run]) -> tuple[float, float]:
    """Return what a blind metronome of the true count reaches, the mean of all walks."""
    walks = [run for run, _ in whole(runs, [np.empty((0, 2))] * len(runs))]
    scores = []
    for run in walks:
        true_s = run.true_s[inside(run.true_s, run.spans)]
        low, high = max(run.spans[0][0], true_s[0] - 0.5), min(run.spans[-1][1], true_s[-1] + 0.5)
        spans = np.clip(run.spans, low, high)
        spans = spans[spans[:, 1] > spans[:, 0]]
        scores.append([metronome_f1(true_s, spans, len(true_s), t) for t in (NARROW_S, WIDE_S)])
    narrow, wide = np.mean(scores, axis=0)
    return float(narrow), float(wide)


HEADER = f"{'':26} within 0.12 / 0.25 s: F1, and parts of first, last, turning, straight steps"


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--data", type=Path, default=Path(os.environ.get("GROUNDTRACE_DATA", "../shared/data"))
    )
    parser.add_argument(
        "--groups", type=int, help="groups of people left out together, instead of one by one"
    )
    options = parser.parse_args()
    walks = walks_of_all(options.data)
    runs = runs_of_all(walks)
    points = lessons(runs)
    people = sorted({run.person for run in runs}, key=lambda p: (not p.isdigit(), p.zfill(3)))
    weights = {}
    for group in range(options.groups or len(people)):
        left_out = people[group :: options.groups or len(people)]
        in_training = ~np.isin(points.person, left_out)
        trained = train_both(
            [run for run in runs if run.person not in left_out],
            Points(*(column[in_training] for column in points)),
        )
        weights |= dict.fromkeys(left_out, trained)
    print(HEADER)
    for rate_hz in RATES_HZ:
        copies = [changed(run, 1.0, 1.0, rate_hz) for run in runs]
        score = judged(copies, weights)
        print(score.row(f"score, {f'{rate_hz:g} Hz' if rate_hz else 'as recorded'}"), flush=True)
        if rate_hz is None:
            by_person, errors = score.people, np.array(score.errors)
    for name, pipeline, parameters in RIVALS:
        for rate_hz in (None, 6.0):
            print(rival(walks, pipeline, rate_hz, parameters).row(
                f"{name}{', 6 Hz' if rate_hz else ''}"), flush=True)  # fmt: skip
    narrow, wide = metronome(runs)
    print(f"{'metronome in the walk':26} {narrow:.3f} / {wide:.3f}")
    print("score by person, left out: F1 within 0.12 / 0.25 s")
    for person in people:
        one, other = by_person[person]
        print(f"  {person:4} {one.f1:.3f} / {other.f1:.3f}")
    print("score by cadence, copies of walks of people left out: F1 within 0.12 / 0.25 s")
    step_s = np.median(np.concatenate([np.diff(run.true_s) for run in runs]))
    for slower in SLOWER:
        score = judged([changed(run, slower, 1.0, None) for run in runs], weights)
        print(f"  {1 / step_s / slower:.2f} steps/s {score.narrow.f1:.3f} / {score.wide.f1:.3f}")
    rng = np.random.default_rng(PAUSED_SEED)
    straight = [run for run in runs if run.walk.startswith("back-steps")]
    stopped = [copy for run in straight if (copy := paused(run, rng)) is not None]
    score = judged(stopped, weights)
    pace = np.median(np.concatenate([np.diff(run.true_s) for run in stopped]))
    print(f"  {1 / pace:.2f}, a pause in each {score.narrow.f1:.3f} / {score.wide.f1:.3f}")
    within = [float(np.mean(np.abs(errors[:, 0]) <= k * errors[:, 1])) for k in (1, 2)]
    print(f"true times within 1 and 2 claimed standard deviations: {within[0]:.2f} {within[1]:.2f}")


def rival(
    walks: list, pipeline: str, rate_hz: float | None, parameters: dict[str, object]
) -> Judged:
    """Run a pipeline that was not trained on all walks."""
    result = Judged()
    for person, name, walk in walks:
        run = next(iter(runs_of(person, name, walk)))
        slow = walk if rate_hz is None else walk.at(rate_hz)
        step_ns = slow.steps(pipeline, "trunk", **parameters)
        times = (step_ns - walk.start_ns) / NS_PER_S
        result.add(run, np.column_stack([times, np.ones(len(times))]))
    return result


if __name__ == "__main__":
    main()
