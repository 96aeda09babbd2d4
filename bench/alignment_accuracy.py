"""How often clocks are found by steps, refused, or wrong: drawn walks seen by two devices.

Usage: python bench/alignment_accuracy.py [PAIRS]

These walks were seen while the alignment was made (docs/accuracy.md).
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace.api.align import AlignmentEvents, align
from groundtrace_codecs.signals import NS_PER_S

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

START_NS = 1_700_000_000 * NS_PER_S
AHEAD_S, STEP_S = 12.345, 0.54


@dataclass(frozen=True, slots=True)
class Case:
    """Walks: how many, of how many steps; how uneven, how badly seen; drift [1e-6]."""

    name: str
    bouts: int
    steps: int
    unsteady: float
    scatter_s: float
    missed: float
    drift_ppm: float = 35.0
    heard: float = 1.0


CASES = (
    Case("60 uneven steps", 1, 60, 0.045, 0.012, 0.0),
    Case("20 uneven steps", 1, 20, 0.045, 0.012, 0.0),
    Case("two walks", 2, 40, 0.025, 0.012, 0.03),
    Case("40 even steps", 1, 40, 0.015, 0.015, 0.05),
    Case("metronome, 40 steps", 1, 40, 0.0, 0.01, 0.0),
    Case("metronome, 200 steps", 1, 200, 0.0, 0.01, 0.03),
    Case("metronome with 3 stops", 4, 20, 0.0, 0.01, 0.02),
    Case("the middle third heard", 6, 40, 0.03, 0.02, 0.05, 35.0, 1 / 3),
    Case("10 minutes", 12, 90, 0.03, 0.012, 0.03),
    Case("20 minutes", 25, 90, 0.03, 0.015, 0.05, -60.0),
)


def walk(case: Case, rng: np.random.Generator) -> Array:
    """Return the contacts [s]: the pace wanders, walks are of half to all of the steps."""
    now_s, bouts_s = 5.0, []
    for _ in range(case.bouts):
        few = case.steps // 2 if case.bouts > 1 else case.steps
        count = int(rng.integers(few, case.steps + 1))
        wander = 0.03 * np.sin(np.arange(count) / 4) * (case.unsteady > 0)
        gaps = STEP_S * (1 + case.unsteady * rng.standard_normal(count) + wander)
        bouts_s.append(now_s + np.cumsum(gaps))
        now_s = float(bouts_s[-1][-1]) + rng.uniform(1, 5)
    return np.concatenate(bouts_s)


def seen(
    case: Case, rng: np.random.Generator, contact_s: Array, end_s: float, scatter_s: float
) -> Array:
    """Return contacts as a device finds them: some missed, as many invented."""
    detected_s = contact_s[rng.random(len(contact_s)) >= case.missed]
    detected_s = detected_s + scatter_s * rng.standard_normal(len(detected_s))
    invented = rng.uniform(0, end_s, rng.poisson(case.missed * len(detected_s)))
    return np.sort(np.concatenate([detected_s, invented]))


def on_clock(found_s: Array, end_s: float, ahead_s: float, drift_ppm: float) -> AlignmentEvents:
    """Return moments as a device with a wrong clock stamps them."""
    bounds = np.concatenate([[0.0, end_s], found_s]) * (1 + drift_ppm * 1e-6) + ahead_s
    start, end, *times = (START_NS + np.rint(bounds * NS_PER_S).astype(np.int64)).tolist()
    return AlignmentEvents(np.array(times, np.int64), start, end)


def main() -> None:
    """Print for each case how many offsets are right, refused, and wrong."""
    pairs = int(sys.argv[1]) if len(sys.argv) > 1 else 40
    for case in CASES:
        right, refused, wrong, off_ms, off_ppm = 0, 0, 0, 0.0, 0.0
        for seed in range(pairs if case.bouts < 10 else max(1, pairs // 10)):
            rng = np.random.default_rng(seed)
            contact_s = walk(case, rng)
            end_s = float(contact_s[-1]) + 5.0
            margin = round(len(contact_s) * (1 - case.heard) / 2)
            heard_s = contact_s[margin : len(contact_s) - margin]
            one = seen(case, rng, heard_s, end_s, 0.3 * case.scatter_s)
            other = seen(case, rng, contact_s, end_s, case.scatter_s)
            alignment = align(
                on_clock(one, end_s, 0.0, 0.0), on_clock(other, end_s, AHEAD_S, case.drift_ppm)
            )
            if alignment is None or alignment.ambiguous:
                refused += 1
                continue
            error_s = alignment.clock.ahead_ns / NS_PER_S - AHEAD_S
            wrong += abs(error_s) > 0.1
            right += abs(error_s) <= 0.1
            off_ms = max(off_ms, abs(error_s) * 1e3)
            if alignment.best.drift_fitted:
                off_ppm = max(off_ppm, abs(alignment.clock.drift_ppm - case.drift_ppm))
        print(
            f"{case.name:24s} right {right:3d}  refused {refused:3d}  wrong {wrong:3d}  "
            f"off by {off_ms:.1f} ms, {off_ppm:.1f} ppm at most"
        )


if __name__ == "__main__":
    main()
