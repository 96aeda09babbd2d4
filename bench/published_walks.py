"""Steps and tracks of feet of walks that nothing was chosen on.

    python bench/published_walks.py --walks FOLDER

The folder is ``GaitData`` of github.com/CyrilVoisard/ipol_dataset_1 (C. Voisard et al., IPOL 2023):
110 walks of 19 people, 10 m out, a turn, 10 m back, with a sensor at the lower back and one on each
foot. The ten people of odd number are those of ``back-steps``, which the score of steps was made
from; the nine of even number it has never seen, and of nobody the sensors of the feet.

- Steps of the nine people, by what ships and by its rivals, which have the placement stated.
- What feet do beside steps that the truth has not: whether one swings in the half second before as
  fast as in 99 of 100 steps that it has.
- Types of their steps, which are all forward, and where their sensors are guessed to be.
- Tracks of both feet of a walk: where they end, each turned so that its farthest point lies in one
  direction. They should lie as far from each other as feet stand, within what both claim; the
  walker may stop elsewhere than he began.
- How far the lower back comes by the lengths of its steps, nothing calibrated, against its feet.
"""

from __future__ import annotations

import argparse
import itertools
import json
import tempfile
from collections import Counter
from dataclasses import dataclass
from multiprocessing import Pool
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from foot_accuracy import CHI2_90, Said
from placement_guess import Case, guess_of, table
from step_accuracy import Walk, read
from step_people import HEADER, RIVALS, WIDE_S, Judged, judged, metronome, rival, whole
from step_type_accuracy import forward, told
from train_step_score import candidates, runs_of

from groundtrace.detectors import step_score
from groundtrace.detectors.adaptive import AdaptiveParameters
from groundtrace.evaluation.matching import f1_score, inside, match
from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import load_pipeline
from groundtrace.pipeline.engine import replay
from groundtrace.pipeline.source import Source
from groundtrace_codecs.importers.run import import_recording
from groundtrace_codecs.recording import Recording

if TYPE_CHECKING:
    from train_step_score import Run

    Array = np.ndarray

RATE_HZ = 100.0
AXES = "xyz"
QUANTITIES = (
    ("acc", "acceleration", "m/s2"),
    ("gyro", "angular_velocity", "rad/s"),
    ("mag", "magnetic_field", "a.u."),
)
#: Feet stand apart by about this, in any direction [m].
APART_M = 0.3
#: Parts of the samples of the worse foot that were lost: limits of classes.
LOST = (0.0, 0.001, 0.02, 0.1, 1.0)
#: A step begins at most so long before its contact, and may be told so long after it [s].
BEFORE_S, AFTER_S = 0.45, 0.05


def values_of(path: Path) -> Array:
    """Return the samples of a published file that were not lost, the first column their number."""
    return np.loadtxt(path, skiprows=2)


def map_text(topic: str) -> str:
    """Return an import map of the columns that :func:`write` writes."""
    columns = [
        f'{{column = "{name}_{axis}", quantity = "{quantity}", axis = "{axis}", unit = "{unit}"}}'
        for name, quantity, unit in QUANTITIES
        for axis in AXES
    ]
    time = 'format = "csv"\ntime = {column = "time_s", unit = "s"}\n'
    return f'{time}[[stream]]\ntopic = "{topic}"\ncolumns = [{", ".join(columns)}]\n'


def write(path: Path, folder: Path, topic: str) -> tuple[Path, Path]:
    """Write a published file as CSV and its map; return their paths."""
    values = values_of(path)
    values[:, 0] /= RATE_HZ
    header = ",".join(["time_s", *(f"{name}_{axis}" for name, *_ in QUANTITIES for axis in AXES)])
    table, columns = folder / "signal.csv", folder / "map.toml"
    np.savetxt(table, values[:, :10], "%.6f", ",", header=header, comments="")
    columns.write_text(map_text(topic))
    return table, columns


def write_back(path: Path, folder: Path) -> tuple[Path, Path, Path]:
    """Write a published walk of a lower back as CSV, its map and its truth; return their paths."""
    described = json.loads(Path(str(path).replace("_lb.txt", ".json")).read_text())
    events = described["LeftFootEvents"] + described["RightFootEvents"]
    contacts = sorted(end / RATE_HZ for _, end in events)
    truth = folder / "truth.csv"
    truth.write_text("time_s,kind\n" + "".join(f"{t:g},step\n" for t in contacts))
    return *write(path, folder, "/imu"), truth


def unseen(folder: Path) -> list[Path]:
    """Return the walks of lower backs of the people that the score of steps has not seen."""
    paths = sorted(folder.glob("*_lb.txt"))
    return [path for path in paths if not int(path.name.split("-")[0]) % 2]


def walks_of(folder: Path) -> list[tuple[str, str, Walk]]:
    """Return person, name and walk of the people that the score of steps has not seen."""
    walks = []
    for path in unseen(folder):
        code = path.name.removesuffix("_lb.txt")
        with tempfile.TemporaryDirectory() as scratch:
            walks.append(
                (code.split("-")[0], f"back-steps {code}", read(*write_back(path, Path(scratch))))
            )
    return walks


def types_of(path: Path) -> Counter[str]:
    """Return the types of the steps of a walk."""
    with tempfile.TemporaryDirectory() as scratch:
        table, columns, _ = write_back(path, Path(scratch))
        return forward([(table, columns)])


def types(folder: Path) -> None:
    """Print how many steps are called forward: all are."""
    with Pool() as pool:
        counted = sum(pool.map(types_of, unseen(folder), chunksize=4), Counter())
    print("\ntypes of steps")
    told("nine people", counted)


class Rates:
    """How fast the feet of a walk turn."""

    def __init__(self, folder: Path, code: str) -> None:
        self._feet = []
        for side in ("lf", "rf"):
            values = values_of(folder / f"{code}_{side}.txt")
            self._feet.append((values[:, 0] / RATE_HZ, np.linalg.norm(values[:, 4:7], axis=1)))

    def fastest(self, start_s: float, end_s: float) -> float:
        """Return the fastest of both feet in a span [rad/s]; 0 without a sample."""
        spans = [rate[(time >= start_s) & (time <= end_s)] for time, rate in self._feet]
        return float(max(span.max(initial=0.0) for span in spans))


def extra_steps(folder: Path, runs: list[Run], score: Judged) -> None:
    """Print what feet do beside steps that the truth has not, and F1 if those they do count."""
    default, weights = AdaptiveParameters(), step_score.trained()
    rows = []
    for run in runs:
        peaks = candidates(run, weights)
        rows.append(peaks[(peaks[:, 2] >= default.score) & (peaks[:, 3] >= default.apart)])
    true_fastest: list[float] = []
    extra: list[tuple[str, float]] = []
    total = 0
    for run, steps in whole(runs, rows):
        feet = Rates(folder, run.walk.split()[1])
        found_s = np.sort(steps[:, 0])
        found_s = found_s[inside(found_s, run.spans)]
        total += len(found_s)
        true_fastest += [feet.fastest(t - BEFORE_S, t + AFTER_S) for t in run.true_s]
        pairs = match(run.true_s, found_s, WIDE_S)
        for time_s in np.delete(found_s, pairs[:, 1]):
            fastest = feet.fastest(time_s - BEFORE_S, time_s + AFTER_S)
            extra.append((where(run, float(time_s)), fastest))
    swing = float(np.percentile(true_fastest, 1))
    print(
        f"\n{len(extra)} of {total} steps are not in the truth; before 99 of 100 true ones a foot"
    )
    print(f"turns at {swing:.1f} rad/s or faster, and so does one before")
    kinds = Counter(kind for kind, _ in extra)
    for kind, count in kinds.most_common():
        swung = sum(fastest >= swing for each, fastest in extra if each == kind)
        print(f"  {kind:28} {swung:3} of {count}")
    more = sum(fastest >= swing for _, fastest in extra)
    narrow, wide = (
        f1_score(one.true + more, one.found, one.matched + more)
        for one in (score.narrow, score.wide)
    )
    print(f"F1 if the truth had those {more}: {narrow:.3f} / {wide:.3f}")


def where(run: Run, time_s: float) -> str:
    """Return where a step lies that the truth has not."""
    after = int(np.searchsorted(run.true_s, time_s))
    if after in (0, len(run.true_s)):
        return "after the last step" if after else "before the first step"
    turning = run.turning[after] or run.turning[after - 1]
    return "in a turn" if turning else "between steps straight on"


def guessed(path: Path) -> tuple[str, str]:
    """Return where a sensor was worn and is guessed to be."""
    worn = "lower back" if path.stem.endswith("lb") else "foot"
    with tempfile.TemporaryDirectory() as scratch:
        guess = guess_of(Case(worn, *write(path, Path(scratch), "/imu")))
    return worn, "no guess" if guess is None else guess.site


def placements(folder: Path) -> None:
    """Print where sensors are guessed to be."""
    paths = [path for path in sorted(folder.glob("*.txt")) if not int(path.name.split("-")[0]) % 2]
    counts: dict[str, Counter[str]] = {"lower back": Counter(), "foot": Counter()}
    with Pool() as pool:
        for worn, place in pool.map(guessed, paths, chunksize=4):
            counts[worn][place] += 1
    print()
    table("placement", counts)


class Way(NamedTuple):
    """A track whose farthest point lies on the x axis: where it ends, and how far it came.

    Covariances are those of its end, and of the farthest point along the axis; ``lost`` is the part
    of the samples that was lost.
    """

    end: Array
    covariance: Array
    farthest_m: float
    variance_m2: float
    lost: float


def way_of(path: Path, topic: str, pipeline: str) -> Way | None:
    """Replay a sensor; None where it gives no track."""
    with tempfile.TemporaryDirectory() as scratch:
        table, columns = write(path, Path(scratch), topic)
        file, sink = Path(scratch) / "walk.mcap", Said()
        import_recording([table], file, map_path=columns)
        with Recording.open(file) as recording:
            replay(Source(recording), build_pipeline(load_pipeline(pipeline)), [sink])
    if not sink.points:
        return None
    places = np.array([(p.x_m, p.y_m) for p in sink.points])
    spreads = np.array(
        [[(p.covariance[0], p.covariance[1]), p.covariance[1:]] for p in sink.points]
    )
    places -= places[0]
    far = int(np.argmax(np.hypot(*places.T)))
    x, y = places[far]
    turn = np.array([[x, y], [-y, x]]) / np.hypot(x, y)
    counter = values_of(path)[:, 0]
    lost = 1 - len(counter) / (counter[-1] - counter[0] + 1)
    end = turn @ places[-1], turn @ spreads[-1] @ turn.T
    along = turn[0] @ spreads[far] @ turn[0]
    return Way(*end, float(np.hypot(x, y)), float(along), float(lost))


def foot_way(path: Path) -> Way | None:
    """Return the way of a foot."""
    return way_of(path, "/imu/foot", "foot-inertial")


def back_way(path: Path) -> Way | None:
    """Return the way of the lower back, reckoned by its steps."""
    return way_of(path, "/imu/waist", "pedestrian")


@dataclass(frozen=True)
class Pair:
    """Both feet of a walk: how far their tracks end apart [m], claimed, its square, and lost."""

    apart_m: float
    claimed_m: float
    square: float
    lost: float


def pair_of(left: Way, right: Way) -> Pair:
    """Compare where the tracks of two feet end."""
    off = left.end - right.end
    spread = left.covariance + right.covariance + APART_M**2 * np.eye(2)
    claimed = float(np.sqrt(CHI2_90 * np.linalg.eigvalsh(spread)[-1]))
    square = float(off @ np.linalg.solve(spread, off))
    return Pair(float(np.hypot(*off)), claimed, square, max(left.lost, right.lost))


def tracks(folder: Path) -> None:
    """Print how far apart the tracks of both feet end, and how far the back came by its steps."""
    codes = sorted(path.name.removesuffix("_lb.txt") for path in folder.glob("*_lb.txt"))
    ways = []
    with Pool() as pool:
        for side, way in (("lf", foot_way), ("rf", foot_way), ("lb", back_way)):
            ways.append(
                pool.map(way, [folder / f"{code}_{side}.txt" for code in codes], chunksize=4)
            )
    walks = [one for one in zip(codes, *ways, strict=True) if None not in one]
    pairs = [pair_of(left, right) for _, left, right, _ in walks]
    print("\nlost samples     walks   feet apart: median, 90 of 100, most   claimed   within 90 %")
    for low, high in itertools.pairwise(LOST):
        some = [pair for pair in pairs if low <= pair.lost < high]
        apart = np.array([pair.apart_m for pair in some])
        within = sum(pair.square <= CHI2_90 for pair in some)
        print(
            f"{low:6.1%} to {high:4.0%} {len(some):8} {np.median(apart):17.2f} m "
            f"{np.percentile(apart, 90):7.2f} m {apart.max():6.2f} m "
            f"{np.median([pair.claimed_m for pair in some]):8.2f} m {within:7} of {len(some)}"
        )
    parts: dict[str, list[float]] = {}
    off = []
    for code, left, right, back in walks:
        true_m = (left.farthest_m + right.farthest_m) / 2
        parts.setdefault(code.split("-")[0], []).append(back.farthest_m / true_m - 1)
        off.append((back.farthest_m - true_m) / np.sqrt(back.variance_m2))
    people = sorted(float(np.median(part)) for part in parts.values())
    sizes = [np.mean(np.abs(off) <= quantile) for quantile in (1.0, 1.645)]
    print(f"\nway of the back by its steps, against that of its feet, {len(people)} people: from")
    print(f"{people[0]:+.0%} to {people[-1]:+.0%}, in the median {np.median(people):+.1%}; within")
    print(f"68 % of what it claims {sizes[0]:.2f}, within 90 % {sizes[1]:.2f} of {len(off)} walks")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--walks", type=Path, required=True, help="GaitData as published")
    options = parser.parse_args()
    walks = walks_of(options.walks)
    runs = [run for each in walks for run in runs_of(*each)]
    people = sorted({run.person for run in runs}, key=int)
    print(HEADER)
    score = judged(runs, dict.fromkeys(people, step_score.trained()))
    print(score.row("score, as it ships"))
    for name, pipeline, parameters in RIVALS[:-1]:
        print(rival(walks, pipeline, None, parameters).row(name), flush=True)
    narrow, wide = metronome(runs)
    print(f"{'metronome in the walk':26} {narrow:.3f} / {wide:.3f}")
    by_person = [f"{p} {score.people[p][0].f1:.3f} / {score.people[p][1].f1:.3f}" for p in people]
    print("score by person:", ", ".join(by_person))
    extra_steps(options.walks, runs, score)
    types(options.walks)
    placements(options.walks)
    tracks(options.walks)


if __name__ == "__main__":
    main()
