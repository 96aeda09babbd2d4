"""A sensor that rests, then turns and shakes in a known field."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from made_rotations import of_vectors, running_products

from groundtrace.inertial.attitude import HeadingParameters
from groundtrace.inertial.frames import Samples
from groundtrace.inertial.heading import HeadingEstimator
from groundtrace.inertial.rotations import headings_of, rotated

RATE_HZ = 100.0
#: The earth's field, east, north, up [T].
EARTH = np.array([0.0, 18e-6, -40e-6])
GRAVITY = np.array([0.0, 0.0, 9.80665])


@dataclass(frozen=True)
class Turning:
    """Samples and the true orientation at each, shape (n, 4)."""

    samples: Samples
    orientation: np.ndarray

    @property
    def seconds(self) -> np.ndarray:
        return self.samples.time_ns / 1e9

    def attached(
        self, field_ut: tuple[float, float, float], start_s: float, end_s: float
    ) -> Turning:
        """The same with a magnet on the sensor for a while."""
        on = (self.seconds >= start_s) & (self.seconds < end_s)
        field = self.samples.field + on[:, None] * np.array(field_ut) * 1e-6
        return replace(self, samples=replace(self.samples, field=field))


def turning(duration_s: float = 60.0, rest_s: float = 5.0, seed: int = 3) -> Turning:
    """Rest, then turn about all axes by up to 2 rad/s and shake by 1 m/s2."""
    rng = np.random.default_rng(seed)
    n = round(duration_s * RATE_HZ)
    t = np.arange(n) / RATE_HZ
    moves = np.clip(t - rest_s, 0, 1)[:, None]
    waves = np.array([[0.31, 0.53], [0.23, 0.71], [0.17, 0.41]])
    rate = np.stack([np.sin(2 * np.pi * w[0] * t) + np.cos(2 * np.pi * w[1] * t) for w in waves], 1)
    rate = moves * rate
    start = of_vectors(np.array([[0.1, -0.2, 0.9]]))
    steps = of_vectors(rate / RATE_HZ)
    orientation = running_products(np.concatenate([start, steps]))[1:]
    back = orientation * np.array([1, -1, -1, -1])
    shake = moves * np.sin(2 * np.pi * 2.1 * t)[:, None] * np.array([0.7, 0.7, 0.3])
    samples = Samples(
        time_ns=np.rint(t * 1e9).astype(np.int64),
        rate=rate + rng.normal(0, 0.002, (n, 3)) + np.array([0.004, -0.003, 0.005]),
        force=rotated(back, GRAVITY + shake) + rng.normal(0, 0.02, (n, 3)),
        field=rotated(back, np.broadcast_to(EARTH, (n, 3))) + rng.normal(0, 0.4e-6, (n, 3)),
        unseen=np.zeros((n, 6)),
    )
    return Turning(samples, orientation)


@dataclass(frozen=True)
class Found:
    """What a filter said of each sample."""

    heading: np.ndarray
    sigma: np.ndarray
    disturbed: np.ndarray
    notes: tuple[str, ...]


def run(
    case: Turning, parameters: HeadingParameters | None = None, portions: int | None = None
) -> Found:
    """Feed a filter, in portions of so many samples."""
    estimator = HeadingEstimator(parameters or HeadingParameters(), RATE_HZ)
    n = len(case.samples)
    size = portions or n
    frames = []
    for start in range(0, n, size):
        frames += estimator.add(case.samples.rows(start, min(start + size, n)))
    frames += estimator.flush()
    lengths = [len(f.time_ns) for f in frames]
    return Found(
        np.concatenate([f.heading_rad for f in frames]),
        np.repeat([f.sigma_rad for f in frames], lengths),
        np.repeat([not f.undisturbed for f in frames], lengths),
        tuple(note for f in frames for note in f.notes),
    )


def errors_deg(case: Turning, found: Found) -> np.ndarray:
    """Errors of the x axis's heading where it is not steep [deg]; NaN elsewhere."""
    axis = np.array([1.0, 0, 0])
    steep = np.abs(
        rotated(case.orientation, np.broadcast_to(axis, (len(case.orientation), 3)))[:, 2]
    )
    off = np.degrees(np.angle(np.exp(1j * (found.heading - headings_of(case.orientation, axis)))))
    return np.where(steep < np.sin(np.radians(60)), off, np.nan)
