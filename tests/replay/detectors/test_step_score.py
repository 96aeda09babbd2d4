"""Steps by score: turned any way, at any rate, in turns, at the ends of walks, and one by one."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from replay_blocks import START_NS, cuts_of, parts_of
from scipy import ndimage
from scipy.spatial.transform import Rotation
from step_accuracy import read

from groundtrace.detectors.adaptive import AdaptiveDetector, AdaptiveParameters
from groundtrace.detectors.step_score import SCALES, TAPS, USUAL_STEP_S, Scores, Surroundings
from groundtrace.evaluation.matching import match
from groundtrace.pipeline.conformance import run
from groundtrace.pipeline.parameters import StageConfig
from groundtrace.pipeline.source import Source
from groundtrace.pipeline.stage import StageRunner
from groundtrace_codecs.events import Note, StepEvent
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S, Channel, SignalBlock, Stream
from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from pathlib import Path

AXES = tuple(Channel(f"acc_{axis}", "acceleration", "m/s2", axis) for axis in "xyz")


def runner(**parameters: object) -> StageRunner:
    told = StageConfig("adaptive", "steps", parameters=parameters)
    return StageRunner(told, AdaptiveDetector, AdaptiveParameters(**parameters))  # type: ignore[arg-type]


def block(force: np.ndarray, rate_hz: float = 100.0, **stream: str) -> SignalBlock:
    return SignalBlock(Stream("/acc", AXES, rate_hz, **stream), START_NS, 0, force)


def steps_of(force: np.ndarray, rate_hz: float = 100.0, **parameters: object) -> np.ndarray:
    found = run(runner(**parameters), [block(force, rate_hz, placement="trunk")])
    return np.array([e.time_ns - START_NS for e in found.events]) / NS_PER_S


@pytest.fixture(scope="module")
def bundled() -> np.ndarray:
    """Force of the bundled walk at the waist, shape (n, 3) [m/s2]."""
    with Recording.open(path_of("waist-walk.mcap")) as recording:
        items = list(Source(recording, topics=["/imu/waist"]))
    return np.concatenate([b.values[:, :3] for b in items if isinstance(b, SignalBlock)])


@pytest.mark.parametrize("seed", range(3))
def test_the_way_the_sensor_is_turned_changes_nothing(seed: int, bundled: np.ndarray) -> None:
    force = bundled[:2500]
    turned = Rotation.random(random_state=seed).apply(force)
    np.testing.assert_allclose(steps_of(turned), steps_of(force), atol=1e-6)


def single_steps(force: np.ndarray, every_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a walk that stands still after every step, and when its contacts are [s]."""
    contacts = steps_of(force)
    middles = np.rint((contacts[2:12] + contacts[3:13]) / 2 * 100).astype(int)
    mean = force.mean(axis=0)
    pieces, times, at = [np.tile(mean, (500, 1))], [], 500
    for low, high in pairwise(middles):
        fade = np.minimum(1, np.minimum(np.arange(high - low), np.arange(high - low)[::-1]) / 15)
        pieces.append(mean + (force[low:high] - mean) * fade[:, None])
        own = contacts[(contacts * 100 >= low) & (contacts * 100 < high)]
        times += list((own * 100 - low + at) / 100)
        still = round(every_s * 100) - (high - low)
        pieces.append(np.tile(mean, (still, 1)))
        at += high - low + still
    pieces.append(np.tile(mean, (500, 1)))
    whole = np.concatenate(pieces)
    return whole + np.random.default_rng(1).normal(0, 0.02, whole.shape), np.array(times)


@pytest.mark.parametrize("every_s", [2.0, 3.0])
def test_single_steps_seconds_apart_are_found_once(every_s: float, bundled: np.ndarray) -> None:
    force, contacts = single_steps(bundled[:2500], every_s)
    found = steps_of(force)
    assert len(match(contacts, found, 0.12)) >= len(contacts) - 1
    assert len(found) <= len(contacts) + 1


def test_standing_still_and_leaning_are_no_steps() -> None:
    rng = np.random.default_rng(2)
    t = np.arange(6000) / 100
    lean = 0.2 * np.sin(2 * np.pi * t / 20)
    force = 9.81 * np.column_stack([np.sin(lean), 0 * t, np.cos(lean)])
    assert not len(steps_of(force + rng.normal(0, 0.03, force.shape)))


LONG = 1200


@given(
    seed=st.integers(0, 2**32 - 1),
    slow=st.sampled_from([0.35, 0.6, 1.7]),
    length=st.integers(0, LONG),
    cuts=cuts_of(LONG),
)
def test_surroundings_of_candidates_do_not_depend_on_how_points_come(
    seed: int, slow: float, length: int, cuts: list[int]
) -> None:
    """Candidates of any likeness, close and far apart, those of the first and last points too."""
    rng = np.random.default_rng(seed)
    seen = rng.normal(0, 2, (2 * len(TAPS), length))
    said = ndimage.gaussian_filter1d(rng.normal(0, 15, (3, length)), 40 * slow / 6, axis=1)
    step_s = np.minimum(slow * np.exp(rng.normal(0, 0.05, (1, length))), USUAL_STEP_S * SCALES[-2])

    def around(parts: list[np.ndarray]) -> list[np.ndarray]:
        stage, width = Surroundings(), 2 * len(TAPS)
        found = [stage(p[:width].T, Scores(*p[width:-1]), p[-1]) for p in parts]
        return [np.concatenate(both) for both in zip(*found, stage.flush(), strict=True)]

    whole = np.concatenate([seen, said, step_s])
    for once, cut in zip(around([whole]), around(parts_of(whole, cuts)), strict=True):
        np.testing.assert_array_equal(once, cut)


def test_a_magnitude_has_no_score_and_is_told_by_its_rhythm(bundled: np.ndarray) -> None:
    norm = np.linalg.norm(bundled, axis=1)[:, None]
    axis = (Channel("norm", "acceleration_magnitude", "m/s2"),)
    signal = SignalBlock(Stream("/acc", axis, 100.0, placement="waist"), START_NS, 0, norm)
    assert len(run(runner(), [signal]).events) > 60
    (note,) = [e for e in runner(method="score").process(signal) if isinstance(e, Note)]
    assert note.text == "/acc: method score: expected 3 axes of acceleration, found 0"


def test_a_threshold_that_decides_nothing_is_told(bundled: np.ndarray) -> None:
    signal = block(bundled[:500], placement="waist")
    (note,) = [e for e in runner(swing=0.5).process(signal) if isinstance(e, Note)]
    assert note.text == "/acc: steps.swing decides nothing here, but score and apart"
    for quiet in (runner(score=0.5), runner(method="rhythm", swing=0.5)):
        assert not [e for e in quiet.process(signal) if isinstance(e, Note)]


def test_a_step_is_announced_within_the_latency_that_is_stated(bundled: np.ndarray) -> None:
    stage, latest = runner(), 0.0
    for first in range(0, 3000, 50):
        part = SignalBlock(Stream("/acc", AXES, 100.0, placement="waist"), START_NS, first,
                           bundled[first : first + 50])  # fmt: skip
        for event in stage.process(part):
            if isinstance(event, StepEvent):
                latest = max(latest, (part.last_ns - event.time_ns) / NS_PER_S)
    assert 5.0 < latest <= 13.3 + 0.5  # a block


@pytest.mark.parametrize(("rate_hz", "turned", "last"), [(None, 20, 6), (6.0, 20, 4)])
def test_steps_of_real_walks_are_found_at_their_ends_and_in_turns(
    rate_hz: float | None, turned: int, last: int, data: Path
) -> None:
    """These walks trained the score: it holds what it reaches, and is no report of people."""
    folder, counts, found_of = data / "back-steps", np.zeros(3, int), np.zeros(3, int)
    for name in ("1-1", "5-1", "9-6", "11-2", "13-2", "17-1", "19-4"):
        walk = read(folder / name / "signal.csv", folder / name / "map.toml",
                    folder / name / "truth.csv")  # fmt: skip
        true = np.array(sorted(x.time_ns for x in walk.labels if x.kind == "step"), np.int64)
        slower = walk if rate_hz is None else walk.at(rate_hz)
        found = slower.steps("waist-steps", "trunk")
        narrow, wide = (match(true / NS_PER_S, found / NS_PER_S, s) for s in (0.12, 0.25))
        counts += (len(true), len(found), len(narrow))
        turning = walk.turning(true)
        found_of += (turning[wide[:, 0]].sum(), turning.sum(), len(true) - 1 in wide[:, 0])
    assert 2 * counts[2] / (counts[0] + counts[1]) >= (0.96 if rate_hz is None else 0.94)
    assert found_of[0] >= turned
    assert found_of[2] >= last
