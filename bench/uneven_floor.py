"""Places on floors that are faster here than there: how many truths lie in the claimed regions.

    python bench/uneven_floor.py [--first 101 --last 120] [--over 1 2 4] [--alone]

Rooms of 4 to 10 m, waves of 200 to 1200 m/s whose slowness differs from place to place by a given
part (a smooth random field, its logarithm's deviation) over a given length; arrivals are its
integrals along straight lines, and their own errors. Thirty impacts a room, of which the first
eight are learnt from and not counted. Nothing but the localizers runs here, no signal. With
``--alone`` covariances reckon with errors that each arrival has on its own.

ALIKE_RAD, SHARED and SHARED_DEVIATION were chosen on seeds 1 to 8, floors uneven by 0.15 over 2 m,
and on the rooms of room_laws.py of seeds 101 to 140.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

import numpy as np
from room_laws import MIDDLE, Errors, print_table

from groundtrace.localizers.base import PlacedSensors
from groundtrace.localizers.methods import Hyperbolic, PowerLaw, SelfCalibrating, SoTdoa
from groundtrace.simulate.wave_laws import UnevenFloor
from groundtrace_codecs.geometry import Medium

if TYPE_CHECKING:
    Tables = dict[str, Errors]

LEARNT, IMPACTS, NOISE_S = 8, 30, 2e-4
METHODS: dict[str, tuple[Any, dict[str, Any]]] = {
    "so-tdoa": (SoTdoa, {}),
    "hyperbolic": (Hyperbolic, {}),
    "power-law": (PowerLaw, {"exponent": 1.0}),
    "self-calibrating": (SelfCalibrating, {"exponent": 1.0}),
}


def errors(seed: int, sensors: int, part: float, over_m: float, *, alone: bool) -> Tables:
    """Return the errors of each method in a room."""
    rng = np.random.default_rng(seed)
    size, velocity = rng.uniform(4, 10, 2), float(rng.uniform(200, 1200))
    places = rng.uniform(0, 1, (sensors, 2)) * size
    for k, side in enumerate(rng.integers(0, 4, sensors)):
        if rng.random() < 0.8:  # most stand along walls
            places[k, side // 2] = 0 if side % 2 else size[side // 2]
    corners = np.array([[0, 0], [size[0], 0], size, [0, size[1]]])
    if sensors == 4:
        places = corners
    floor = UnevenFloor.drawn(np.zeros(2), size, part, over_m, rng)
    truth = rng.uniform(0.1, 0.9, (IMPACTS, 2)) * size
    times = np.array([floor.lengths_m(p, places) for p in truth]) / velocity
    times += rng.normal(0, NOISE_S, times.shape)
    tables: Tables = {name: Errors(truths=IMPACTS - LEARNT) for name in METHODS}
    for name, (kind, given) in METHODS.items():
        method = kind(kind.Parameters(**given))
        method.begin(PlacedSensors(places, corners, Medium(velocity_mps=velocity)))
        for number, (place, row) in enumerate(zip(truth, times, strict=True)):
            found = method.locate(row) if alone else method.locate_step(number, row)
            if number >= LEARNT and found.located:
                tables[name].add(np.array([found.x, found.y]) - place, found.covariance)
    middle = np.hypot(*(truth[LEARNT:] - size / 2).T).tolist()
    return tables | {MIDDLE: Errors(middle, [np.inf] * len(middle), len(middle))}


def main() -> None:
    """Print a table for each unevenness."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=101)
    parser.add_argument("--last", type=int, default=120)
    parser.add_argument("--sensors", type=int, nargs="+", default=[4, 6, 9, 16])
    parser.add_argument("--parts", type=float, nargs="+", default=[0.0, 0.15, 0.3])
    parser.add_argument("--over", type=float, nargs="+", default=[2.0], metavar="M")
    parser.add_argument("--alone", action="store_true")
    options = parser.parse_args()
    for over_m in options.over:
        for part in options.parts:
            for sensors in options.sensors:
                tables: Tables = {}
                for seed in range(options.first, options.last + 1):
                    for name, of_room in errors(
                        seed, sensors, part, over_m, alone=options.alone
                    ).items():
                        total = tables.setdefault(name, Errors())
                        total += of_room
                print_table(f"{sensors} sensors, uneven by {part:g} over {over_m:g} m", tables)


if __name__ == "__main__":
    main()
