"""A worn sensor that is turned about all axes, for the tests of what contradicts itself."""

from __future__ import annotations

import numpy as np

from groundtrace.inertial.worn_sensor_faults import rotations

RATE_HZ = 100.0


def turning_sensor(length_s: float = 60.0, seed: int = 1) -> np.ndarray:
    """Return gyroscope, acceleration and field of a sensor that is turned about all axes.

    Shape (n, 9). A right-handed frame: what is fixed in space, v, goes by dv/dt = v x w.
    """
    random = np.random.default_rng(seed)
    count = round(length_s * RATE_HZ)
    time_s = np.arange(count) / RATE_HZ
    rate = sum(
        random.normal(0, 0.4, 3)
        * np.sin(2 * np.pi * random.uniform(0.05, 0.6) * time_s[:, None] + k)
        for k in range(6)
    )
    step = np.zeros((count, 3))
    step[1:] = (rate[1:] + rate[:-1]) / (2 * RATE_HZ)
    to_start = np.moveaxis(rotations(step), -1, 0)
    force = np.einsum("nki,k->ni", to_start, [0.3, -1.0, 9.7])
    field = np.einsum("nki,k->ni", to_start, [20e-6, 3e-6, -40e-6])
    force = force + random.normal(0, 0.5, force.shape)
    field = field + random.normal(0, 5e-7, field.shape)
    return np.hstack([rate + random.normal(0, 0.01, rate.shape), force, field])
