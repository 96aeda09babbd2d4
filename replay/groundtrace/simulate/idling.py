"""What people do who do not walk: stand, fidget, sit down, reach, handle the sensor, ride."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .gait import smooth_step

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .gait import Idle, Plan
    from .gait_shapes import Sway

    Array = NDArray[np.float64]

_SEAT_M = 0.42  # a seat is this much lower than a standing pelvis


def add_idle(sway: Sway, plan: Plan, seed: int, time_s: Array) -> None:
    """Add what a person does who stands: breathe and sway, shift the weight, look round, tap."""
    rng = np.random.default_rng([seed, 2])
    for hz in (0.25, 0.6, 1.1):
        swing = np.sin(2 * np.pi * (hz * time_s[:, None] + rng.uniform(0, 1, 3)))
        sway.acceleration[:] += 0.012 * swing
        sway.angle[:] += 0.004 / (1 + hz) * np.roll(swing, 1, axis=1)
    for start_s, end_s in plan.fidget_s:
        near = slice(*np.searchsorted(time_s, (start_s, end_s)))
        for middle_s in rng.uniform(start_s + 0.4, end_s - 0.4, 5):
            half_s = rng.uniform(0.25, 0.4)
            bump = np.clip(1 - ((time_s[near] - middle_s) / half_s) ** 2, 0, None) ** 2
            sway.acceleration[near] += bump[:, None] * rng.normal(0, (0.5, 0.7, 0.5))
            sway.angle[near] += bump[:, None] * rng.normal(0, (0.12, 0.04, 0.05))
        late = np.clip(time_s[near] - rng.uniform(start_s + 0.4, end_s - 0.4), 0, None)
        sway.acceleration[near, 2] += 200 * late * np.exp(-late / 0.02)
    for index, idle in enumerate(plan.idles):
        near = slice(*np.searchsorted(time_s, (idle.start_s, idle.end_s)))
        moves = {"sit": _sit, "reach": _reach, "handle": _handle, "ride": _ride}[idle.activity]
        moved, angle = moves(time_s[near], idle, np.random.default_rng([seed, 6, index]))
        sway.acceleration[near] += moved
        sway.angle[near] += angle


def _sit(time_s: Array, idle: Idle, rng: np.random.Generator) -> tuple[Array, Array]:
    """Sit down and stand up again: lean forward, sink, land, lean back; and the way back."""
    moved, angle = np.zeros((len(time_s), 3)), np.zeros((len(time_s), 3))
    down_s, up_s = rng.uniform(1.2, 1.8), rng.uniform(1.2, 1.8)
    for start_s, length_s, sign in (
        (idle.start_s, down_s, -1.0),
        (idle.end_s - up_s, up_s, 1.0),
    ):
        part = (time_s - start_s) / length_s
        # second derivative of the smooth step: the pelvis goes down, and back where one sits
        curve = np.where((part > 0) & (part < 1), 60 * part * (1 - part) * (1 - 2 * part), 0.0)
        moved[:, 2] += sign * _SEAT_M / length_s**2 * curve
        moved[:, 0] += sign * 0.25 / length_s**2 * curve
        angle[:, 1] += 0.5 * _bump(part)
    angle[:, 1] -= 0.15 * smooth_step((time_s - idle.start_s) / down_s)
    angle[:, 1] += 0.15 * smooth_step((time_s - idle.end_s + up_s) / up_s)
    landed = np.clip(time_s - idle.start_s - down_s, 0, None)
    moved[:, 2] += 6.0 * np.sin(2 * np.pi * 9.0 * landed) * np.exp(-landed / 0.06)
    return moved, angle


def _reach(time_s: Array, idle: Idle, rng: np.random.Generator) -> tuple[Array, Array]:
    """Reach for things: turn and bend for a second or two."""
    moved, angle = np.zeros((len(time_s), 3)), np.zeros((len(time_s), 3))
    for _ in range(int(rng.integers(1, 4))):
        length_s = min(float(rng.uniform(1.0, 2.0)), idle.end_s - idle.start_s)
        start_s = rng.uniform(idle.start_s, idle.end_s - length_s)
        part = (time_s - start_s) / length_s
        angle += _bump(part)[:, None] * rng.normal(0, (0.25, 0.25, 0.12))
        inside = (part > 0) & (part < 1)
        swing = np.where(inside, np.sin(2 * np.pi * part), 0.0) * _bump(part)
        moved += swing[:, None] * rng.normal(0, (0.9, 0.9, 0.6))
    return moved, angle


def _handle(time_s: Array, idle: Idle, rng: np.random.Generator) -> tuple[Array, Array]:
    """Take the sensor off, turn it in the hands and put it back."""
    moved, angle = np.zeros((len(time_s), 3)), np.zeros((len(time_s), 3))
    length_s = idle.end_s - idle.start_s
    held = smooth_step((time_s - idle.start_s) / 0.8) * smooth_step((idle.end_s - time_s) / 0.8)
    for hz in rng.uniform(0.3, 2.5, 6):
        swing = np.sin(2 * np.pi * (hz * time_s[:, None] + rng.uniform(0, 1, 3)))
        moved += held[:, None] * swing * rng.normal(0, 1.0, 3)
        angle += held[:, None] * swing * rng.normal(0, 0.25 / (1 + hz), 3)
    for knock_s in idle.start_s + length_s * rng.uniform(0.1, 0.9, 3):
        late = np.clip(time_s - knock_s, 0, None)
        shake = np.sin(2 * np.pi * 22.0 * late) * np.exp(-late / 0.03)
        moved += shake[:, None] * rng.normal(0, 4.0, 3)
    return moved, angle


def _ride(time_s: Array, idle: Idle, rng: np.random.Generator) -> tuple[Array, Array]:
    """Stand in a vehicle that comes from and goes to nowhere: it bounces, hums and sways."""
    moved, angle = np.zeros((len(time_s), 3)), np.zeros((len(time_s), 3))
    on = smooth_step((time_s - idle.start_s) / 2.0) * smooth_step((idle.end_s - time_s) / 2.0)
    for hz, across, up in (
        *((hz, 0.15, 0.35) for hz in rng.uniform(1.1, 1.8, 3)),  # on its springs
        *((hz, 0.05, 0.2) for hz in rng.uniform(9.0, 14.0, 3)),  # its wheels
        *((hz, 0.05, 0.08) for hz in rng.uniform(20.0, 35.0, 2)),  # its engine
    ):
        swing = np.sin(2 * np.pi * (hz * time_s[:, None] + rng.uniform(0, 1, 3)))
        gain = 1 + 0.6 * np.sin(2 * np.pi * (rng.uniform(0.05, 0.2) * time_s + rng.random()))
        moved += (on * gain)[:, None] * swing * (across, across, up)
        angle += on[:, None] * np.roll(swing, 1, axis=1) * (0.004 / hz, 0.012 / hz, 0.012 / hz)
    return moved, angle


def _bump(part: Array) -> Array:
    """Return 0 outside 0 to 1 and a smooth hill of height 1 between."""
    inside = np.clip(part, 0.0, 1.0)
    hill: Array = 64 * (inside * (1 - inside)) ** 3
    return hill
