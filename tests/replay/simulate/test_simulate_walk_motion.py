"""Drawn people on paths: what sensors feel agrees with where the body goes."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from simulated_walks import moved, walked

from groundtrace.simulate.gait import PlacementName, WalkOptions, person

PLACEMENTS = PlacementName.__args__


@pytest.mark.parametrize("placement", PLACEMENTS)
def test_acceleration_integrates_to_the_path_of_every_walk(placement):
    motion = moved(rate_hz=200.0, placement=placement, types=True, duration_s=60.0, seed=1)
    for bout in motion.walker.plan.bouts:
        start_s, end_s = bout.span_s[0] - 1.0, bout.span_s[1] + 0.8
        if end_s > motion.time_s[-1]:
            continue
        near = slice(*np.searchsorted(motion.time_s, (start_s, end_s)))
        place = np.cumsum(np.cumsum(motion.world[near], axis=0), axis=0)[-1] / 200.0**2
        path = motion.track[near][-1] - motion.track[near][0]
        assert np.hypot(*(place[:2] - path)) < 0.35 + 0.05 * np.hypot(*path)
        assert abs(place[2]) < 0.5


@pytest.mark.parametrize("placement", PLACEMENTS)
def test_gravity_is_the_mean_of_the_force_and_noise_that_of_a_sensor(placement):
    walk = walked(placement=placement, path="straight", seed=3)
    force = walk.values["imu"][:, :3]
    still = force[: int(3.5 * 100)]
    assert np.linalg.norm(still.mean(axis=0)) == pytest.approx(9.81, abs=0.15)
    white = np.diff(still, 2, axis=0).std(axis=0) / np.sqrt(6)
    assert ((white > 0.010) & (white < 0.024)).all()
    rates = np.diff(walk.values["imu"][:350, 3:], 2, axis=0).std(axis=0) / np.sqrt(6)
    assert ((rates > 0.0015) & (rates < 0.0035)).all()


def test_axes_lie_ahead_left_and_up_within_the_mounting_errors():
    for seed in range(12):
        who = person(WalkOptions(person=seed, path="straight"))
        assert np.abs(who.sensor.mount_deg).max() <= 20
        force = walked(seed=seed, path="straight", duration_s=4.0).values["imu"][:, :3]
        assert force[:, 2].mean() > 9.81 * np.cos(np.radians(20)) ** 2 - 0.3


def attitudes(walk) -> Rotation:
    """Integrate the gyroscope from standing, where gravity tells what is up; ten a second."""
    up = walk.values["imu"][:350, :3].mean(axis=0)
    now, _ = Rotation.align_vectors([(0.0, 0.0, 1.0)], [up])
    rate = walk.values["imu"][:, 3:] - walk.values["imu"][:350, 3:].mean(axis=0)
    found = []
    for ten in (
        Rotation.from_rotvec(rate / 100)[: len(rate) // 10 * 10].as_quat().reshape(-1, 10, 4)
    ):
        found.append(now)
        for quaternion in ten:
            now = now * Rotation.from_quat(quaternion)
    return Rotation.concatenate(found)


@pytest.mark.parametrize("placement", PLACEMENTS)
def test_the_gyroscope_integrates_to_the_heading(placement):
    walk = walked(path="l", person=1, placement=placement)
    found = attitudes(walk)
    turned = np.unwrap((found * found[0].inv()).as_euler("ZYX")[:, 0])
    true = np.array([h.value for h in walk.of_kind("heading")])[: len(turned)]
    assert true[-1] == pytest.approx(np.pi / 2, abs=1e-3)
    assert np.abs(turned - true).mean() < 0.15
    assert turned[-1] == pytest.approx(true[-1], abs=0.15)


def test_the_compass_follows_the_heading():
    walk = walked(path="loop", seed=4)
    who = person(WalkOptions(path="loop", seed=4))
    mount = Rotation.from_euler("ZYX", who.sensor.mount_deg, degrees=True)
    ahead = mount.apply(walk.values["mag"])
    compass = np.arctan2(ahead[:, 0], ahead[:, 1])
    headings = walk.of_kind("heading")
    true = np.interp(walk.time_s["mag"], walk.seconds(headings), [h.value for h in headings])
    off = (compass - true + np.pi) % (2 * np.pi) - np.pi
    assert np.abs(np.median(off)) < 0.05
    assert np.percentile(np.abs(off), 90) < 0.35


def test_headings_come_ten_times_a_second_with_places():
    headings = walked(path="straight", seed=2).of_kind("heading")
    assert {b.time_ns - a.time_ns for a, b in pairwise(headings)} == {100_000_000}
    assert all(h.x_m is not None for h in headings)


def test_up_peaks_near_each_contact():
    for seed in (1, 3, 5):
        motion = moved(path="straight", seed=seed)
        bout = motion.walker.plan.bouts[0]
        phase = np.linspace(-0.5, 0.5, 101)
        grid = bout.contact_s[2:-2, None] + phase * bout.step_s
        cycle = np.interp(grid, motion.time_s, motion.body[:, 2]).mean(axis=0)
        assert 0.0 <= phase[cycle.argmax()] <= 0.3


def test_the_foot_rests_between_its_swings():
    motion = moved(rate_hz=200.0, placement="foot", path="straight", seed=1)
    still = np.linalg.norm(motion.world, axis=1) < 0.05
    for bout in motion.walker.plan.bouts:
        own = [c for i, c in enumerate(bout.contact_s) if bout.foot(i) == "right"]
        for contact_s in own[1:-1]:
            near = slice(
                *np.searchsorted(motion.time_s, (contact_s + 0.22, contact_s + 0.9 * bout.step_s))
            )
            assert still[near].mean() > 0.95
    assert np.abs(motion.world).max() > 5


def test_people_differ_in_cadence_and_amplitude():
    people = [person(WalkOptions(person=seed, path="straight")) for seed in range(60)]
    strides = [p.strides["forward"] for p in people]
    cadences = [s.cadence_hz for s in strides]
    assert 0.7 <= min(cadences) < 0.85
    assert 2.05 < max(cadences) <= 2.2
    ahead = [p.manner.ahead * s.strength for p, s in zip(people, strides, strict=True)]
    assert max(ahead) > 2.5 * min(ahead)
    assert len({p.sensor.mount_deg for p in people}) == 60


def test_a_person_stays_the_same_on_other_walks():
    first, again, other = (
        person(WalkOptions(person=p, seed=s, path="straight")) for p, s in ((4, 1), (4, 2), (5, 1))
    )
    assert first == again
    assert first != other
