"""The walking axis of a body-worn sensor, and its sign."""

from __future__ import annotations

import numpy as np
import pytest

from groundtrace.heading.axes import walking_axis


def walk(heading_rad: float, seconds: float = 6.0, rate_hz: float = 100.0) -> np.ndarray:
    """Acceleration of a trunk that walks: forward lags upward by a quarter of a step."""
    t = np.arange(round(seconds * rate_hz)) / rate_hz
    step = 2 * np.pi * 1.9 * t
    up, forward, side = np.cos(step), -np.sin(step), 0.4 * np.sin(step / 2)
    c, s = np.cos(heading_rad), np.sin(heading_rad)
    flat = np.stack([c * forward - s * side, s * forward + c * side], axis=1)
    noise = np.random.default_rng(1).normal(0, 0.05, (len(t), 3))
    return np.column_stack([flat, 2.5 * up]) + noise


@pytest.mark.parametrize("heading_deg", [-170.0, -60.0, 0.0, 35.0, 120.0])
def test_the_axis_and_its_sign_are_found_in_any_direction(heading_deg: float) -> None:
    found = walking_axis(walk(np.radians(heading_deg)), 100.0)
    off = np.degrees(found.heading_rad) - heading_deg
    assert (off + 180) % 360 - 180 == pytest.approx(0.0, abs=4.0)
    assert found.prominence > 0.5
    assert found.sign_ratio > 0.8


def test_a_sway_to_the_sides_larger_than_the_swing_does_not_matter() -> None:
    t = np.arange(600) / 100.0
    steps = walk(0.0)
    steps[:, 1] += 3.0 * np.sin(np.pi * 1.9 * t)
    assert abs(np.degrees(walking_axis(steps, 100.0).heading_rad)) < 10.0


def test_walking_backwards_turns_the_sign() -> None:
    backwards = walk(0.0) * np.array([-1.0, 1.0, 1.0])
    assert abs(np.degrees(walking_axis(backwards, 100.0).heading_rad)) > 170.0


def test_too_short_a_signal_is_refused() -> None:
    with pytest.raises(ValueError, match=r"expected 1\.5 s, found 0\.5 s"):
        walking_axis(np.zeros((50, 3)), 100.0)
