"""Hard and soft iron: the ellipsoid, and when it is not taken."""

from __future__ import annotations

import numpy as np
import pytest
from turning_sensor import run, turning

from groundtrace.inertial.magnetometer import TOO_LITTLE, Calibration, _quadric, fit_ellipsoid

RNG = np.random.default_rng(4)
SOFT = np.array([[1.15, 0.06, 0.0], [0.06, 0.9, 0.03], [0.0, 0.03, 1.0]])
HARD = np.array([31.0, -12.0, 20.0])


def sphere(count: int = 600, radius: float = 45.0) -> np.ndarray:
    directions = RNG.normal(size=(count, 3))
    return radius * directions / np.linalg.norm(directions, axis=1)[:, None]


def test_hard_and_soft_iron_are_found_and_undone() -> None:
    fields = sphere() @ SOFT.T + HARD + RNG.normal(0, 0.3, (600, 3))
    found = fit_ellipsoid(fields)
    assert found is not None
    assert found.centre == pytest.approx(HARD, abs=0.2)
    norms = np.linalg.norm(found.corrected(fields), axis=1)
    assert norms.std() < 0.5
    assert found.radius == pytest.approx(45.0, rel=0.05)


def test_a_minority_of_disturbed_fields_does_not_move_the_fit() -> None:
    fields = sphere() + HARD + RNG.normal(0, 0.3, (600, 3))
    fields[::5] += np.array([40.0, 40.0, -10.0])
    found = fit_ellipsoid(fields)
    assert found is not None
    assert found.centre == pytest.approx(HARD, abs=0.5)


def test_fields_on_two_sheets_are_no_ellipsoid() -> None:
    x, y = RNG.uniform(-1, 1, (2, 200))
    z = RNG.choice([-1.0, 1.0], 200) * np.sqrt(1 + 5 * x**2 + 3 * y**2)
    assert _quadric(np.stack([x, y, z], axis=1), np.ones(200)) is None


def test_turning_in_a_plane_is_too_little() -> None:
    angle = np.linspace(0, 6, 300)
    flat = np.stack([20 * np.cos(angle), 20 * np.sin(angle), np.full(300, -40.0)], axis=1)
    assert fit_ellipsoid(flat + RNG.normal(0, 0.3, flat.shape)) is None


def test_a_filter_calibrates_its_magnetometer_and_says_so() -> None:
    case = turning(90.0).attached((35, -25, 15), 0.0, 90.0)
    found = run(case)
    assert any("hard iron" in note for note in found.notes)
    assert not found.disturbed[case.seconds > 80].any()


def test_too_little_turning_is_said() -> None:
    calibration = Calibration()
    for _ in range(400):
        calibration.watch(np.array([60e-6, 0, 0]) + RNG.normal(0, 1e-7, 3), undisturbed=False)
    assert calibration.ellipsoid is None
    assert calibration.wanting
    assert "too little" in TOO_LITTLE
