"""Ahead, right and up from a sensor in any orientation; the mounting told by walking."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typed_walks import accelerations

from groundtrace.inertial.body_motion import Swing, WalkingAxis, step_swing
from groundtrace.inertial.step_type import BodyAxes, axis_vector
from groundtrace.pipeline.conformance import rechunked

G = 9.80665


def walked(seconds: float = 40.0) -> tuple[np.ndarray, np.ndarray]:
    """Times, and true acceleration ahead, to the right and up of a made-up walk."""
    t = np.arange(round(100 * seconds)) / 100
    turn = 2 * np.pi * 1.8 * t
    ahead, right, up = np.cos(turn), 0.8 * np.sin(turn / 2), 2.0 * np.sin(turn)
    return t, np.stack([ahead, right, up])


def resolved(samples: np.ndarray, size: int = 10_000, **settings: object) -> np.ndarray:
    blocks = accelerations(samples)
    axes = BodyAxes(blocks[0].stream, **settings)
    return np.concatenate([axes(b).values for b in rechunked(blocks, size)], axis=1)


def worn(true: np.ndarray, mount: Rotation) -> np.ndarray:
    """What a sensor measures whose axes lie ahead, left and up but for its mounting."""
    body = np.stack([true[0], -true[1], true[2] + G], axis=1)
    return mount.inv().apply(body)


@pytest.mark.parametrize("pitch_deg", [-60.0, 0.0, 25.0])
@pytest.mark.parametrize("roll_deg", [-170.0, -20.0, 40.0])
def test_up_ahead_and_right_come_back_however_the_sensor_hangs(
    pitch_deg: float, roll_deg: float
) -> None:
    _, true = walked()
    mount = Rotation.from_euler("ZYX", (0.0, pitch_deg, roll_deg), degrees=True)
    found = resolved(worn(true, mount))[:, 1000:]
    assert np.sqrt(np.mean((found - true[:, 1000:]) ** 2)) < 0.1


@pytest.mark.parametrize("forward", ["x", "-x", "y", "-y", "z", "-z"])
def test_any_axis_may_look_ahead(forward: str) -> None:
    _, true = walked()
    ahead = axis_vector(forward)
    up = np.roll(ahead, 1)
    left = np.cross(up, ahead)
    samples = np.outer(true[0], ahead) - np.outer(true[1], left) + np.outer(true[2] + G, up)
    found = resolved(samples, forward=forward)[:, 1000:]
    assert np.sqrt(np.mean((found - true[:, 1000:]) ** 2)) < 0.1


def test_a_gyroscope_keeps_gravity_out_of_a_nodding_trunk() -> None:
    t, true = walked()
    pitch = np.radians(4.0) * np.sin(2 * np.pi * 1.8 * t + 1.0)
    attitude = Rotation.from_euler("Y", pitch[:, None])
    force = attitude.inv().apply(np.stack([true[0], -true[1], true[2] + G], axis=1))
    rate = np.zeros_like(force)
    rate[:, 1] = np.gradient(pitch, t) + 0.01  # and its offset
    errors = [
        np.sqrt(np.mean((resolved(samples)[0, 1000:] - true[0, 1000:]) ** 2))
        for samples in (force, np.hstack([force, rate]))
    ]
    assert errors[0] > 0.4  # 4 degrees of gravity
    assert errors[1] < 0.15


def test_blocks_of_any_size_give_the_same_axes() -> None:
    _, true = walked(10.0)
    rng = np.random.default_rng(3)
    samples = np.hstack([worn(true, Rotation.identity()), rng.normal(0, 0.2, (1000, 3))])
    whole = resolved(samples)
    for size in (1, 7, 200):
        np.testing.assert_allclose(resolved(samples, size), whole, atol=1e-12)


@pytest.mark.parametrize("mounted_deg", [-20.0, 0.0, 15.0])
@pytest.mark.parametrize("lead", [0.25, -0.25])
def test_the_mounting_is_the_principal_axis_of_what_goes_with_every_step(
    mounted_deg: float, lead: float
) -> None:
    phase = np.arange(-80, 51) / 32
    angle = np.radians(mounted_deg)
    rng = np.random.default_rng(4)
    axis = WalkingAxis()
    for _ in range(20):
        ahead = np.cos(2 * np.pi * (phase + lead)) + 0.1 * rng.normal(size=len(phase))
        sway = 1.5 * np.sin(np.pi * phase + rng.choice([0.0, np.pi]))  # every second step
        up = 2.0 * np.cos(2 * np.pi * phase)
        turned = np.stack(
            [
                np.cos(angle) * ahead - np.sin(angle) * sway,
                np.sin(angle) * ahead + np.cos(angle) * sway,
                up,
            ]
        )
        swing = step_swing(turned, phase)
        assert swing is not None
        axis.add(swing)
    assert np.degrees(axis.angle_rad) == pytest.approx(mounted_deg, abs=3.0)
    np.testing.assert_allclose(axis.rotated(turned)[2], up)


def test_steps_to_the_side_say_nothing_of_the_mounting() -> None:
    phase = np.arange(-80, 51) / 32
    up = np.cos(2 * np.pi * phase)
    axis = WalkingAxis()
    swing = step_swing(np.stack([0.1 * up, 3.0 * up, up]), phase)
    assert swing is not None
    axis.add(swing)
    assert axis.angle_rad == 0.0


def swing_of(
    direction_deg: float, lead: float = 0.25, size: float = 0.5, up_mps2: float = 1.0
) -> Swing:
    """Swing of one step whose acceleration in a direction leads the one upward, in steps."""
    phase = np.arange(-80, 51) / 32
    along = size * np.cos(2 * np.pi * (phase + lead))
    angle = np.radians(direction_deg)
    unit = [np.cos(angle) * along, np.sin(angle) * along, np.cos(2 * np.pi * phase)]
    swing = step_swing(up_mps2 * np.stack(unit), phase)
    assert swing is not None
    return swing


def apart_deg(axis: WalkingAxis, direction_deg: float) -> float:
    return abs((np.degrees(axis.angle_rad) - direction_deg + 180) % 360 - 180)


@pytest.mark.parametrize("direction_deg", [-170.0, -60.0, 0.0, 35.0, 90.0, 120.0, 180.0])
def test_without_a_nominal_direction_four_steps_tell_axis_and_sign(direction_deg: float) -> None:
    axis = WalkingAxis(nominal=False)
    for _ in range(4):
        axis.add(swing_of(direction_deg, 0.2))
    assert apart_deg(axis, direction_deg) < 25.0
    for _ in range(30):
        axis.add(swing_of(direction_deg, 0.2))
    assert apart_deg(axis, direction_deg) < 5.0


#: Median swing of steps down a stair (HAPT, phone at the waist) and of jogged ones (sensor at the
#: chest): how far its acceleration ahead leads, its size against the vertical one, and that [m/s2].
DOWN, JOG = (0.57, 0.19, 3.6), (-0.13, 0.15, 11.2)


@pytest.mark.parametrize("gait", [DOWN, JOG])
@pytest.mark.parametrize("direction_deg", [-170.0, -60.0, 90.0, 120.0])
def test_steps_down_a_stair_and_of_a_runner_tell_the_way(
    gait: tuple[float, float, float], direction_deg: float
) -> None:
    axis = WalkingAxis(nominal=False)
    for _ in range(60):
        axis.add(swing_of(direction_deg, *gait))
    assert apart_deg(axis, direction_deg) < 25.0
    # who walks on walks the same way
    for _ in range(10):
        axis.add(swing_of(direction_deg, 0.3, 0.6, 2.1))
        assert apart_deg(axis, direction_deg) < 25.0


def test_the_swing_has_the_amplitude_of_the_vertical_acceleration() -> None:
    for samples in (32, 7):
        phase = np.arange(-3 * samples, 3 * samples) / samples
        swing = step_swing(np.stack([0 * phase, 0 * phase, 3.0 * np.cos(2 * np.pi * phase)]), phase)
        assert swing is not None
        assert swing.up_mps2 == pytest.approx(3.0)


def test_some_dozens_of_steps_back_do_not_turn_the_sign_and_a_whole_walk_back_does() -> None:
    axis = WalkingAxis(nominal=False)
    for lead, count, direction_deg in ((0.25, 60, 90.0), (-0.25, 30, 90.0), (-0.25, 200, -90.0)):
        for _ in range(count):
            axis.add(swing_of(90.0, lead))
        assert apart_deg(axis, direction_deg) < 5.0


def test_with_a_nominal_direction_a_whole_walk_back_stays_one() -> None:
    axis = WalkingAxis()
    for _ in range(200):
        axis.add(swing_of(10.0, -0.25))
    assert apart_deg(axis, 10.0) < 2.0


@pytest.mark.parametrize("first", ["aside", "ahead"])
def test_steps_to_the_side_do_not_turn_the_axis_of_the_walk(first: str) -> None:
    # their swing goes with the acceleration upward, not against the velocity
    aside, ahead = [swing_of(90.0, 0.03, 1.5)] * 12, [swing_of(0.0)] * 6
    axis = WalkingAxis(nominal=False)
    for swing in [*aside, *ahead] if first == "aside" else [*ahead, *aside]:
        axis.add(swing)
    assert apart_deg(axis, 0.0) < 20.0


def test_the_walk_s_reference_is_an_axis_that_is_level_at_the_start() -> None:
    _, true = walked(12.0)
    body = np.stack([true[2] + G, true[0], -true[1]], axis=1)  # x up, y ahead, z to the left
    found = resolved(body, forward="walk")[:, 500:]
    assert np.sqrt(np.mean((found - true[:, 500:]) ** 2)) < 0.1


def test_without_a_vertical_swing_there_is_none() -> None:
    assert step_swing(np.zeros((3, 131)), np.arange(-80, 51) / 32) is None


def test_an_axis_that_the_walk_tells_says_how_sure_it_is() -> None:
    rng = np.random.default_rng(5)
    errors, claims = [], []
    for direction_deg in np.linspace(-175.0, 175.0, 30):
        axis = WalkingAxis(nominal=False, keep=0.99)
        assert axis.sigma_rad == pytest.approx(np.pi / np.sqrt(3))
        for count in range(1, 21):
            turn, lead = rng.normal(0, 15.0), rng.normal(0.28, 0.05)
            axis.add(swing_of(direction_deg + turn, lead, 0.6, 2.0))
            if count in (1, 4, 20):
                errors.append(np.radians(apart_deg(axis, direction_deg)))
                claims.append(axis.sigma_rad)
    errors_rad, claims_rad = (np.reshape(x, (-1, 3)) for x in (errors, claims))
    assert (claims_rad[:, 0] > 1.0).all()  # one step may have either sign
    assert (claims_rad[:, 2] < 0.15).all()
    assert (errors_rad < 2 * claims_rad).mean(axis=0).min() >= 0.9


def test_steps_that_contradict_each_other_leave_the_axis_unknown() -> None:
    axis = WalkingAxis(nominal=False, keep=0.99)
    for direction_deg in np.arange(40) * 222.5:  # all round
        axis.add(swing_of(direction_deg))
    assert axis.sigma_rad > 0.6
