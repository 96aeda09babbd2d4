"""Train the step score of the trunk on all people at hand: the weights that ship.

    python bench/train_step_score.py --data FOLDER

``bench/step_people.py`` judges it, each person left out in turn.

The folder holds ``back-steps`` and ``mobgap`` as published: 60 walks of ten people and 6 of two,
all at the lower back. A point of the grid is a contact by a Gaussian of 50 ms about each true one.
What is seen of it is made by the product's own code, from the recordings and from copies of them:
walked slower and faster, stronger and weaker, sampled at 6 Hz, and with a pause in every step. The
network is scikit-learn's, of which the weights are kept; several, of different seeds, are put side
by side. The second network learns from candidates of people that the first one, trained for that on
two thirds of them, never saw.
"""

from __future__ import annotations

import argparse
import json
import os
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from step_accuracy import Walk, read, sampled

from groundtrace.detectors import step_score
from groundtrace.detectors.body_signals import Upward
from groundtrace.detectors.step_score import (
    CONTACT_S,
    Network,
    StepWindows,
    Surroundings,
    Weights,
    judged,
    moving,
    scores,
)
from groundtrace.evaluation.matching import inside, scored_spans
from groundtrace_codecs.signals import NS_PER_S, Channel, SignalBlock, Stream
from groundtrace_recordings import map_path

if TYPE_CHECKING:
    from collections.abc import Iterator

    Array = np.ndarray

UNITS, NETWORKS, ALPHA, EPOCHS = 16, 3, 1e-2, 12
#: Of the second network. Chosen in the table of people left out; 3 instead of 1 is alike.
SECOND_UNITS, SECOND_ALPHA = 12, 1.0
#: Groups of people, each left out in turn for the lessons of the second network.
FOLDS = 3
#: A candidate within this of a true contact is taken for it [s].
TAKEN_S = 0.15
CUTOFF_HZ = 3.5
AXES = tuple(Channel(f"acc_{axis}", "acceleration", "m/s2", axis) for axis in "xyz")
#: Copies: how much slower, how much stronger, their rate [Hz], and weight.
COPIES = (
    (1.0, 1.0, None, 1.0),
    (0.65, 1.3, None, 0.3),
    (0.85, 1.2, None, 0.5),
    (1.2, 0.8, None, 0.5),
    (1.5, 0.8, None, 0.3),
    (2.0, 0.7, None, 0.3),
    (3.0, 0.6, None, 0.3),
    (1.0, 1.0, 6.0, 0.3),
)
PAUSES_S, PAUSED_WEIGHT = (0.5, 2.5), 0.5
#: What the last step of a walk and steps in turns count for, beside others: there are few.
LAST, TURNING = 4.0, 2.0


class Run(NamedTuple):
    """A stretch of one walk without a gap: acceleration (3, n) [m/s2] and its true contacts [s]."""

    person: str
    walk: str
    rate_hz: float
    start_s: float
    force: Array
    true_s: Array
    spans: Array
    turning: Array
    last_s: float


class Points(NamedTuple):
    """Points of the grid: what is seen of each, whether it is a contact, its weight, and whose."""

    seen: Array
    contact: Array
    weight: Array
    person: Array


def runs_of(person: str, name: str, walk: Walk) -> Iterator[Run]:
    """Yield the stretches of a walk that are long enough to walk in."""
    true = np.array(sorted(x.time_ns for x in walk.labels if x.kind == "step"), np.int64)
    true_s = (true - walk.start_ns) / NS_PER_S
    spans = scored_spans(walk.labels, walk.start_ns, walk.end_ns, 0.1)
    turning = walk.turning(true)
    for block in walk.runs():
        stream, start_s = block.stream, (block.start_ns - walk.start_ns) / NS_PER_S
        if len(block) < 1.5 * stream.rate_hz:
            continue
        columns = stream.columns_of({"acceleration"})
        force = (block.values[:, columns]).T.astype(np.float64)
        yield Run(
            person, name, stream.rate_hz, start_s, force, true_s, spans, turning, float(true_s[-1])
        )


def changed(run: Run, slower: float, gain: float, rate_hz: float | None) -> Run:
    """Return a copy that is walked slower, stronger, or sampled at another rate."""
    force, own_hz = run.force, run.rate_hz
    if rate_hz is not None:
        if force.shape[1] < 1.5 * own_hz:
            return run
        force, own_hz = sampled(force.T, own_hz, rate_hz).T, rate_hz
    if slower != 1.0 or gain != 1.0:
        mean = _smooth(force, own_hz)
        at = np.arange(int(force.shape[1] * slower)) / slower
        scaled = mean + (force - mean) * gain
        force = np.array([np.interp(at, np.arange(len(row)), row) for row in scaled])
    return run._replace(
        force=force,
        rate_hz=own_hz,
        start_s=run.start_s * slower,
        true_s=run.true_s * slower,
        spans=run.spans * slower,
        last_s=run.last_s * slower,
    )


def paused(run: Run, rng: np.random.Generator) -> Run | None:
    """Return a copy that stands still for a while in the middle of every step."""
    rate_hz, count = run.rate_hz, run.force.shape[1]
    contacts_s = run.true_s - run.start_s
    contacts_s = contacts_s[(contacts_s > 0.5) & (contacts_s < count / rate_hz - 0.5)]
    if len(contacts_s) < 3:
        return None
    mean = _smooth(run.force, rate_hz)
    moved = run.force - mean
    cuts = np.rint((contacts_s[1:] + contacts_s[:-1]) / 2 * rate_hz).astype(int)
    fade = np.minimum(
        1, np.abs(np.arange(count)[:, None] - cuts[None, :]).min(1) / (0.15 * rate_hz)
    )
    faded = mean + moved * (0.5 - 0.5 * np.cos(np.pi * fade))
    lengths = np.rint(rng.uniform(*PAUSES_S, len(cuts)) * rate_hz).astype(int)
    pieces, true_s, before = [], [], 0.0
    for low, high, still in zip([0, *cuts], [*cuts, count], [*lengths, 0], strict=True):
        pieces.append(faded[:, low:high])
        inside_piece = contacts_s[(contacts_s * rate_hz >= low) & (contacts_s * rate_hz < high)]
        true_s += list(inside_piece + before)
        if still:
            level = np.linspace(faded[:, high - 1], faded[:, min(high, count - 1)], still).T
            pieces.append(level + rng.normal(0, 0.03, level.shape))
            before += still / rate_hz
    force = np.concatenate(pieces, axis=1)
    spans = np.array([[-1.0, force.shape[1] / rate_hz + 1]])
    return run._replace(
        force=force,
        start_s=0.0,
        true_s=np.array(true_s),
        spans=spans,
        turning=np.zeros(len(true_s), bool),
        last_s=float("nan"),
    )


def _smooth(force: Array, rate_hz: float) -> Array:
    """Return the mean over about two seconds, held at the ends."""
    half = int(2.5 * rate_hz)
    kernel = np.exp(-0.5 * (np.arange(-half, half + 1) / rate_hz) ** 2)
    kernel /= kernel.sum()
    return np.array([np.convolve(np.pad(row, half, mode="edge"), kernel, "valid") for row in force])


def windows_of(run: Run) -> tuple[Array, Array, Array]:
    """Return time, what is seen, and step time of every point of the grid."""
    stream = Stream("/acc", AXES, run.rate_hz)
    block = SignalBlock(stream, round(run.start_s * NS_PER_S), 0, np.ascontiguousarray(run.force.T))
    upward, windows = Upward(stream, CUTOFF_HZ), StepWindows()
    parts = [upward(block), upward.flush()]
    window_parts = [windows(moving(part.force, part.gravity)) for part in parts] + [windows.flush()]
    time_s = np.concatenate([part.time_ns for part in parts]) / NS_PER_S
    seen = np.concatenate([each.seen for each in window_parts])
    return time_s, seen, np.concatenate([each.step_s for each in window_parts])


def points_of(run: Run, weight: float, slower: float, rng: np.random.Generator) -> Points:
    """Return the points of a run that teach something: all near contacts, some of the others."""
    time_s, seen, _ = windows_of(run)
    near = np.abs(time_s[:, None] - run.true_s[None, :]).min(axis=1)
    contact = np.exp(-0.5 * (near / CONTACT_S) ** 2)
    other = contact <= 0.02
    selected = inside(time_s, run.spans) & (
        rng.random(len(time_s)) < np.where(other, 0.5, 1.0) / max(1.0, slower)
    )
    weights = weight * np.where(other, 2.0, 1.0) * max(1.0, slower) ** 0.5
    turning = run.true_s[run.turning]
    for times, gain in ((np.array([run.last_s]), LAST), (turning, TURNING)):
        if len(times):
            beside = np.abs(time_s[:, None] - times[None, :]).min(axis=1) < 0.25 * slower
            weights = weights * np.where(beside, gain, 1.0)
    person = np.full(int(selected.sum()), run.person)
    return Points(seen[selected].astype(np.float32), contact[selected], weights[selected], person)


def lessons(runs: list[Run], seed: int = 0) -> Points:
    """Return the points of all runs and of their copies."""
    rng = np.random.default_rng(seed)
    parts = [
        points_of(changed(run, slower, gain, rate_hz), weight, slower, rng)
        for slower, gain, rate_hz, weight in COPIES
        for run in runs
    ]
    copies = [paused(run, rng) for run in runs if not run.walk.startswith("mobgap")]
    parts += [points_of(copy, PAUSED_WEIGHT, 1.0, rng) for copy in copies if copy is not None]
    return Points(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def train(points: Points, networks: int = NETWORKS) -> tuple[Network, Array]:
    """Return the first network, several side by side, and the usual step."""
    unsure = points.contact > 0.02  # both a contact and none, by parts
    seen = np.concatenate([points.seen, points.seen[unsure]])
    labels = np.concatenate([np.zeros(len(points.seen), int), np.ones(unsure.sum(), int)])
    weight = np.concatenate(
        [points.weight * (1 - points.contact), (points.weight * points.contact)[unsure]]
    )
    scale = points.seen.std(axis=0) + 1e-6
    network = fitted(seen, labels, weight, 0.0 * scale, scale, UNITS, ALPHA, 500, networks)
    steps = np.average(points.seen, axis=0, weights=points.weight * (points.contact > 0.9))
    return network, np.ascontiguousarray(steps.astype(np.float64))


def fitted(
    seen: Array,
    labels: Array,
    weight: Array,
    mean: Array,
    scale: Array,
    units: int,
    alpha: float,
    batch: int,
    networks: int = NETWORKS,
) -> Network:
    """Return networks of different seeds, side by side, as one."""
    from sklearn.neural_network import MLPClassifier

    made = []
    for seed in range(networks):
        network = MLPClassifier(
            (units,), activation="tanh", alpha=alpha, batch_size=batch, max_iter=EPOCHS,
            random_state=seed, learning_rate_init=3e-3, tol=0.0, n_iter_no_change=EPOCHS + 1,
        )  # fmt: skip
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # it is stopped early on purpose
            network.fit((seen - mean) / scale, labels, sample_weight=weight)
        made.append([np.asarray(x, np.float64) for x in (*network.coefs_, *network.intercepts_)])
    hidden = np.concatenate([m[0] for m in made], axis=1) / scale[:, None]
    return Network(
        hidden=np.ascontiguousarray(hidden, np.float64),
        bias=np.concatenate([m[2] for m in made]) - mean @ hidden,
        out=np.concatenate([m[1][:, 0] for m in made]) / networks,
        offset=float(np.mean([m[3][0] for m in made])),
    )


class Cases(NamedTuple):
    """Candidates: what stands around each, whether it is a contact, and its weight."""

    inputs: Array
    contact: Array
    weight: Array


def cases_of(run: Run, first: Weights, weight: float, slower: float) -> Cases:
    """Return the candidates of a run that teach the second network."""
    rows, inputs = surrounded(run, first)
    contact, weights = np.zeros(len(rows), int), np.full(len(rows), weight)
    if not len(rows):
        return Cases(inputs, contact, weights)
    away = np.abs(rows[:, :1] - run.true_s[None, :])
    for true in away.T:
        near = np.flatnonzero(true < TAKEN_S * max(1.0, slower))
        if len(near):
            contact[near[np.argmax(rows[near, 1])]] = 1
    turning = run.true_s[run.turning]
    for times, gain in ((np.array([run.last_s]), LAST), (turning, TURNING)):
        if len(times):
            beside = np.abs(rows[:, :1] - times[None, :]).min(axis=1) < 0.25 * slower
            weights = weights * np.where(beside, gain, 1.0)
    in_spans = inside(rows[:, 0], run.spans)
    return Cases(inputs[in_spans], contact[in_spans], weights[in_spans])


def train_both(runs: list[Run], points: Points) -> Weights:
    """Return the weights of both networks, by all of these runs and their points."""
    people = sorted({run.person for run in runs}, key=lambda p: p.zfill(3))
    rng = np.random.default_rng(0)
    parts: list[Cases] = []
    for fold in range(FOLDS):
        left_out = people[fold::FOLDS]
        in_training = ~np.isin(points.person, left_out)
        first = _first(Points(*(column[in_training] for column in points)))
        left_out_runs = [run for run in runs if run.person in left_out]
        for slower, gain, rate_hz, weight in COPIES:
            copies = [changed(run, slower, gain, rate_hz) for run in left_out_runs]
            parts += [cases_of(copy, first, weight, slower) for copy in copies]
        stopped = [paused(run, rng) for run in left_out_runs if not run.walk.startswith("mobgap")]
        parts += [cases_of(copy, first, PAUSED_WEIGHT, 1.0) for copy in stopped if copy is not None]
    cases = Cases(*(np.concatenate(column) for column in zip(*parts, strict=True)))
    mean, scale = cases.inputs.mean(axis=0), cases.inputs.std(axis=0) + 1e-6
    second = fitted(
        cases.inputs, cases.contact, cases.weight, mean, scale, SECOND_UNITS, SECOND_ALPHA, 100
    )
    return _first(points)._replace(candidate=second)


def _first(points: Points) -> Weights:
    network, mean_step = train(points)
    return Weights(network, network, mean_step)  # the second one is trained later


def surrounded(run: Run, weights: Weights) -> tuple[Array, Array]:
    """Return the candidates of a run, the place replaced by the time [s], and what is around."""
    time_s, seen, step_s = windows_of(run)
    stage, point_scores = Surroundings(), scores(seen, weights)
    parts = [stage(seen, point_scores, step_s), stage.flush()]
    rows, inputs = (np.concatenate([part[k] for part in parts]) for k in range(2))
    rows[:, 0] = np.interp(rows[:, 0], np.arange(len(time_s)), time_s)
    return rows, inputs


def candidates(run: Run, weights: Weights) -> Array:
    """Return the candidates of a run with their scores, the place replaced by the time [s]."""
    return judged(*surrounded(run, weights), weights.candidate)


def walks_of_all(folder: Path) -> list[tuple[str, str, Walk]]:
    """Return person, name and walk of all recordings."""
    walks = []
    for path in sorted(folder.glob("back-steps/*/signal.csv")):
        walk = read(path, path.with_name("map.toml"), path.with_name("truth.csv"))
        name = path.parent.name
        walks.append((name.split("-")[0], f"back-steps {name}", walk))
    map_text = map_path("mobgap-test11.toml").read_text()
    for path in sorted(folder.glob("mobgap/*/*/data.mat")):
        person = path.parent.parent.name
        for test in ("Test11.Trial1", "Test5.Trial1", "Test5.Trial2"):
            walk = read(path, map_text.replace("Test11.Trial1", test))
            walks.append((person, f"mobgap {person} {test}", walk))
    return walks


def runs_of_all(walks: list[tuple[str, str, Walk]]) -> list[Run]:
    """Return the runs of all walks."""
    return [run for each in walks for run in runs_of(*each)]


def rounded(weights: Weights) -> dict[str, object]:
    """Return weights as the file holds them."""
    networks = {
        name: {key: np.round(value, 5).tolist() for key, value in network._asdict().items()}
        for name, network in (("moment", weights.moment), ("candidate", weights.candidate))
    }
    return {
        "made_by": "bench/train_step_score.py",
        "recordings": "back-steps (C. Voisard et al., IPOL 2023), mobgap example data (Mobilise-D)",
        "usual": np.round(weights.mean_step, 5).tolist(),
        **networks,
    }


def main() -> None:
    """Train on all, and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--data", type=Path, default=Path(os.environ.get("GROUNDTRACE_DATA", "../shared/data"))
    )
    options = parser.parse_args()
    runs = runs_of_all(walks_of_all(options.data))
    points = lessons(runs)
    path = Path(step_score.__file__).with_name("step_score.json")
    path.write_text(json.dumps(rounded(train_both(runs, points))) + "\n")
    print(f"{len(points.seen)} points; wrote {path.name}")


if __name__ == "__main__":
    main()
