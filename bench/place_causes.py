"""Faults planted in arrivals: what places are blamed on, and clocks by known places.

    python bench/place_causes.py causes --seeds 4 --stage power-law
    python bench/place_causes.py clocks --seeds 8

``causes`` prints for each planted cause and number of sensors what bad places and sensors are
blamed for; ``clocks`` how often offsets are called identifiable, without and with some, for laws
of distance of several shapes. docs/rooms.md and docs/howto/calibrate.md have the results.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

import planted_arrivals as planted

from groundtrace.layout.calibrate import _held_out
from groundtrace.localizers.joint_calibration import Impacts

STEPS = 24
VARIANTS = (
    {},
    {"exponent": 1.0, "scale": 2e-3},
    {"exponent": 7 / 6, "scale": 1e-3},
    {"noise_s": 4e-4},
)
LAWS = {
    "plate": lambda d: 8e-4 * d ** (4 / 3),
    "constant velocity": lambda d: 2e-3 * d,
    "saturating": lambda d: 8e-3 * (1 - np.exp(-d / 3)),
    "two waves": lambda d: np.minimum(8e-4 * d ** (4 / 3), 2e-3 + 1.1e-3 * d),
    "logarithm": lambda d: 4e-3 * np.log1p(d),
}


def plant(cause: str, walk: planted.Walk, rng: np.random.Generator) -> list[int]:
    """Plant a cause; return the steps that it concerns."""
    channel, sign = int(rng.integers(len(walk.positions))), int(rng.choice([-1, 1]))
    row = int(rng.integers(STEPS))
    if cause == "clock":
        planted.late_clock(walk, channel, sign * rng.uniform(2e-3, 6e-3))
    if cause == "position":
        angle, far = rng.uniform(0, 2 * np.pi), rng.uniform(1, 2)
        planted.displaced(walk, channel, (far * np.cos(angle), far * np.sin(angle)))
    if cause == "swap":
        planted.swapped(walk, channel, (channel + 1) % len(walk.positions))
    if cause in ("late", "early"):
        late_s = rng.uniform(4e-3, 12e-3)
        planted.off_pick(walk, row, channel, late_s if cause == "late" else -late_s)
        return [row]
    if cause == "together":
        planted.off_together(walk, [3, 7, 11, 15], int(rng.integers(1000)))
        return [3, 7, 11, 15]
    if cause == "together in all":
        planted.off_together(walk, list(range(STEPS)), int(rng.integers(1000)))
    return list(range(STEPS))


def causes(seeds: int, stage: str) -> None:
    """Print what is blamed for planted causes."""
    names = ("nothing", "clock", "position", "swap", "late", "early", "together", "together in all")
    for sensors in planted.LAYOUTS:
        for cause in names:
            places: Counter[str] = Counter()
            blamed: Counter[str] = Counter()
            for seed in range(seeds):
                walk = planted.Walk.make(sensors, seed, STEPS, **VARIANTS[seed % len(VARIANTS)])
                rows = plant(cause, walk, np.random.default_rng(100 * seed + sensors))
                account = walk.account(stage)
                places.update(f.cause.cause for f in account.bad if f.fix - 1 in rows and f.cause)
                blamed[" ".join(sorted(s.cause for s in account.sensors)) or "none"] += 1
            print(f"{sensors:3} {cause:16} places {dict(places)}, sensors {dict(blamed)}")


def clocks(seeds: int) -> None:
    """Print how often offsets of clocks are called identifiable, and their largest error."""
    for law, travel_s in LAWS.items():
        for offset_s in (0.0, 2e-3, 3e-3):
            identified, runs, worst_s = 0, 0, 0.0
            for sensors in planted.LAYOUTS:
                for count in (12, 18, 30):
                    for seed in range(seeds):
                        walk = planted.Walk.make(sensors, seed, count)
                        rng = np.random.default_rng(31 * seed + sensors)
                        apart = np.hypot(
                            *(walk.places[:, None] - walk.positions).transpose(2, 0, 1)
                        )
                        ahead = rng.normal(size=sensors)
                        ahead *= offset_s / np.abs(ahead).max()
                        ahead -= ahead.mean()
                        times = travel_s(apart) + rng.normal(0, 3e-4, apart.shape) + ahead
                        bounds = np.array([[0.0, 0.0], [planted.SIDE_M, planted.SIDE_M]])
                        held_out = _held_out(Impacts(walk.positions, times, bounds, walk.places))
                        assert held_out is not None
                        runs += 1
                        if held_out.identifiable:
                            identified += 1
                            worst_s = max(worst_s, float(np.abs(held_out.offsets_s - ahead).max()))
            print(
                f"{law:18} {offset_s * 1e3:g} ms: {identified} of {runs}, "
                f"worst {worst_s * 1e3:.2f} ms"
            )


def main() -> None:
    """Run one of the two."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("what", choices=("causes", "clocks"))
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--stage", default="power-law")
    given = parser.parse_args()
    causes(given.seeds, given.stage) if given.what == "causes" else clocks(given.seeds)


if __name__ == "__main__":
    main()
