"""Walks of all types of steps: each moves the body as its type does, and the truth says which."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt
from simulated_walks import moved, walked

OPTIONS = {"types": True, "path": "random", "duration_s": 150.0}
SIGN = {"left": 1, "right": -1}


@pytest.fixture(scope="module")
def walk():
    return walked(seed=1, **OPTIONS)


@pytest.fixture(scope="module")
def motions():
    return [moved(seed=seed, **OPTIONS) for seed in range(4)]


def bouts(motion, kind):
    return [b for b in motion.walker.plan.bouts if b.kind == kind and len(b.contact_s) >= 6]


def test_all_four_types_are_walked_and_named(walk):
    counts = Counter(step.label for step in walk.of_kind("step"))
    assert set(counts) == {"forward", "backward", "left", "right"}
    assert min(counts.values()) >= 6
    assert {step.note for step in walk.of_kind("step")} == {"left foot", "right foot"}


def test_a_side_step_is_one_step_of_two_contacts(walk):
    for side in SIGN:
        leads, trails = (walk.seconds(walk.of_kind(k, side)) for k in ("step", "trailing"))
        assert len(leads) == len(trails)
        assert (trails > leads).all()
        assert (trails - leads < 1.0).all()
        assert {x.note for x in walk.of_kind("step", side)} == {f"{side} foot"}
        assert {x.note for x in walk.of_kind("trailing", side)}.isdisjoint({f"{side} foot"})


def test_places_go_where_the_type_says(walk):
    headings = walk.of_kind("heading")
    at, facing = walk.seconds(headings), np.unwrap([h.value for h in headings])
    course = {"forward": 0.0, "backward": np.pi, "left": np.pi / 2, "right": -np.pi / 2}
    for kind, against in course.items():
        steps = walk.of_kind("step", kind)
        times = walk.seconds(steps)
        apart = np.diff([(s.x_m, s.y_m) for s in steps], axis=0)
        near = np.diff(times) < 2.5
        went = np.arctan2(apart[near, 1], apart[near, 0])
        off = went - np.interp(times[:-1][near], at, facing) - against
        assert np.median(np.abs((off + np.pi) % (2 * np.pi) - np.pi)) < 0.05


def test_the_axis_of_the_walk_is_the_strongest_of_the_level_ones(motions):
    for motion in motions:
        for kind, strong in (("backward", 0), ("left", 1), ("right", 1)):
            for bout in bouts(motion, kind):
                near = slice(*np.searchsorted(motion.time_s, bout.contact_s[[1, -2]]))
                level = motion.body[near, :2].std(axis=0)
                if kind == "backward":
                    assert level[0] > 0.4 * level[1]
                else:
                    assert level[strong] > 1.5 * level[1 - strong]


@pytest.mark.parametrize(("kind", "order"), [("forward", -1), ("backward", 1)])
def test_ahead_peaks_before_up_going_forward_and_after_it_going_backward(motions, kind, order):
    sos = butter(3, 4, fs=100, output="sos")
    found = []
    for motion in motions:
        smooth = sosfiltfilt(sos, motion.body, axis=0)
        for bout in bouts(motion, kind):
            phase = np.linspace(-0.5, 0.5, 101)
            grid = bout.contact_s[2:-2, None] + phase * bout.step_s
            ahead, up = (np.interp(grid, motion.time_s, smooth[:, i]).mean(0) for i in (0, 2))
            found.append((phase[ahead.argmax()] - phase[up.argmax()] + 0.5) % 1 - 0.5)
    assert len(found) >= 3
    assert np.mean(np.sign(found) == order) > 0.9


@pytest.mark.parametrize("side", SIGN)
def test_a_side_step_pushes_before_the_lead_foot_lands_and_brakes_after(motions, side):
    for motion in motions:
        for bout in bouts(motion, side):
            leads = bout.contact_s[2:-2:2]
            towards = SIGN[side] * np.interp(
                leads[:, None] + np.array([-0.4, 0.25]) * bout.step_s,
                motion.time_s,
                motion.body[:, 1],
            ).mean(axis=0)
            assert towards[0] > 0 > towards[1]


def test_up_moves_less_in_side_steps_than_in_forward_ones_of_the_same_strength(motions):
    forward, side = ([], [])
    for motion in motions:
        for bout in motion.walker.plan.bouts:
            near = slice(*np.searchsorted(motion.time_s, bout.contact_s[[0, -1]]))
            if bout.kind == "backward" or bout.contact_s[-1] > motion.time_s[-1]:
                continue
            up = motion.body[near, 2].std() / np.mean(bout.strength) ** 2
            (forward if bout.kind == "forward" else side).append(up)
    assert np.median(side) < 0.6 * np.median(forward)


def test_without_types_a_step_is_named_by_its_foot():
    labels = {x.label for x in walked(path="straight", duration_s=20.0).of_kind("step")}
    assert labels == {"left", "right"}
