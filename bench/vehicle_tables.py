"""Vehicles by seismic power: the tables of docs/accuracy/vehicles.md, and known numbers.

Powers are drawn by their law, not taken from waveforms: these are the methods' own errors. The
known numbers of places come from another arrangement of six sensors in two lines, which is not
handed down; here lines of three sensors 20 m apart are 40 m from one another, and vehicles are
anywhere up to 20 m around: of six arrangements tried, one that comes near the known numbers.
Estimators and courses are held to their targets.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass

import numpy as np

from groundtrace.vehicles import likelihood, lines, ratios
from groundtrace.vehicles.courses import Observed, Search, fit_course
from groundtrace.vehicles.likelihood import CyclePlace
from groundtrace.vehicles.medium import Geophone, PowerLaw, clamped, ranges
from groundtrace.vehicles.passes import station_peaks
from groundtrace.vehicles.tracker import cycle_places, track, track_places
from groundtrace.vehicles.traffic import RoadPowers, RoadVehicle, driven

SENSORS = np.array([(x, y) for y in (0.0, 40.0) for x in (0.0, 20.0, 40.0)])
MARGIN_M = 20.0
LAW = PowerLaw(1.0, 1.5)
#: Method: known mean / theta, and known standard deviation of ln theta times sqrt(1000 / K).
KNOWN_RATIOS: dict[ratios.Method, tuple[str, tuple[float, float]]] = {
    "likelihood": ("1.000-1.003", (0.053, 0.056)),
    "median": ("1.000-1.004", (0.062, 0.065)),
    "geometric": ("1.000-1.004", (0.056, 0.059)),
    "means": ("0.999-1.003", (0.043, 0.046)),
}
KNOWN_PLACES = {
    "(17) as printed": "5.39",
    "(17), theta^(1/n)": "2.50",
    "(17), and the reference": "2.03",
    "least squares of logarithms": "2.24",
    "(7), mu known": "3.35, rms 4.72",
    "(7), mu profiled": "6.02, rms 12.5",
}
#: Antennas of the courses [m], and what a course may be off in the median [m].
ANTENNAS = np.array([(x, y) for y in (0.0, 30.0) for x in (0.0, 15.0, 30.0)])
TARGET_M = 1.0
#: Of the integral in (2), evenly over the logarithm of frequency; and from how far below to how far
#: above the natural frequency it reaches.
NODES, SPAN = 4096, 1e6


def received_power(distance_m: np.ndarray, geophone: Geophone, loss_spm: float) -> np.ndarray:
    """Return the power (2) of white noise of density N0 / 2 = 1, with the prefactor 1 / r."""
    r = clamped(distance_m)
    log_f = np.linspace(*np.log(geophone.natural_hz * np.array([1 / SPAN, SPAN])), NODES)
    f = np.exp(log_f)
    density = np.abs(geophone.response(f)) ** 2 * f  # f d(ln f) = d f
    amplitude = r[:, None] ** -0.5 * np.exp(-np.pi * loss_spm * f * r[:, None])  # (1)
    return np.asarray(np.trapezoid(density * amplitude**2, log_f, axis=1))


def local_exponent(distance_m: np.ndarray, geophone: Geophone, loss_spm: float) -> np.ndarray:
    """Return -d ln P / d ln r of (2), the n of (4) that holds about each distance.

    1 of it is the prefactor's; the paper takes the rest, the integral's, for 0.5 everywhere.
    """
    step = 1e-3
    near, far = (
        received_power(distance_m * np.exp(sign * step), geophone, loss_spm) for sign in (-1, 1)
    )
    return np.asarray(np.log(near / far) / (2 * step))


def exponents() -> None:
    """Print how the exponent of (2) changes with distance."""
    r = np.array([2.0, 5.0, 10.0, 20.0, 50.0, 100.0])
    print("exponent of the integral in (2), rho 1e-3 s/m, f0 10 Hz, xi 0.7, at 2 to 100 m")
    for kind, reference in (("low-pass", ".08 .19 .34 .55 .84 .97"), ("high-pass", "1.1 to 4.2")):
        exponent = local_exponent(r, Geophone(10.0, 0.7, kind), 1e-3) - 1
        print(f"  {kind:10}" + " ".join(f"{x:.2f}" for x in exponent) + f"  ({reference})")


def estimators(trials: int, rng: np.random.Generator) -> bool:
    """Print mean and deviation of the estimators of theta; return whether they are as known."""
    print(f"ratios: K = 1000, {trials} trials: mean / theta, std of ln theta, theory")
    good = True
    for method, (mean, (low, high)) in KNOWN_RATIOS.items():
        log_errors = []
        for theta in (0.1, 1.0, 20.0):
            powers = rng.exponential(size=(2, trials, 1000))
            log_errors.append(
                ratios.estimate(powers[0], theta * powers[1], method, correlated=False).log_theta
                - np.log(theta)
            )
        over = [float(np.exp(f).mean()) for f in log_errors]
        sigma = [float(f.std()) for f in log_errors]
        slack = 0.001 + 3 * high / (2 * trials) ** 0.5
        passed = low - slack <= min(sigma) and max(sigma) <= high + slack
        good &= passed
        print(
            f"  {method:11}{min(over):.3f}-{max(over):.3f} ({mean})  "
            f"{min(sigma):.4f}-{max(sigma):.4f} ({low}-{high})  "
            f"{ratios.DEVIATIONS[method] / 1000**0.5:.4f}  {'pass' if passed else 'FAIL'}"
        )
    s = rng.exponential(size=(trials, 1000)) / rng.exponential(size=(trials, 1000))
    inverse = 1 / s.mean(axis=1)
    print(f"  1/mean(s)  {inverse.mean():.3f} (0.127)  {np.log(inverse).std():.2f} (0.62-0.66)")
    return good


def printed_17(nodes: np.ndarray, sensors: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Return the metric (17) as printed: without the reference."""
    r = ranges(nodes, sensors)
    table = r[:, 1:] / r[:, :1]
    metric = table @ measured / np.linalg.norm(table, axis=1)
    return np.asarray(metric / np.linalg.norm(measured))


def places(trials: int, rng: np.random.Generator) -> None:
    """Print the errors of places from ratios and from powers of one cycle."""
    low, high = SENSORS.min(axis=0) - MARGIN_M, SENSORS.max(axis=0) + MARGIN_M
    nodes = likelihood.lattice((low[0], low[1]), (high[0], high[1]), 0.5)
    x, y = (np.arange(a, b + 0.1, 0.5) for a, b in zip(low, high, strict=True))
    off: dict[str, list[float]] = {name: [] for name in KNOWN_PLACES}
    for _ in range(trials):
        position = rng.uniform(low, high)
        mean = LAW.power(ranges(position, SENSORS))
        p = rng.exponential(size=(6, 200)) * mean[:, None]
        theta = ratios.estimate(p[1:], p[:1], "likelihood", correlated=False).log_theta
        fit = likelihood.locate(nodes, SENSORS, theta, (1.5 / 200) ** 0.5)
        powers = mean * (1 + rng.normal(size=6) / 3)
        estimates = (
            nodes[printed_17(nodes, SENSORS, np.exp(theta)).argmax()],
            nodes[printed_17(nodes, SENSORS, np.exp(theta / 1.5)).argmax()],
            nodes[likelihood.correlation(nodes, SENSORS, theta).argmax()],
            np.array([fit.x, fit.y]),
            CyclePlace(powers, SENSORS, LAW, mu_known=True).surface(x, y).best,
            CyclePlace(powers, SENSORS, LAW).surface(x, y).best,
        )
        for name, one in zip(off, estimates, strict=True):
            off[name].append(float(np.hypot(*(one - position))))
    print(f"places: 6 sensors, K = 200, {trials} places: median and rms error (known median) [m]")
    for name, errors in off.items():
        rms = np.sqrt(np.mean(np.square(errors)))
        print(f"  {name:30}{np.median(errors):.2f}, rms {rms:.2f}  ({KNOWN_PLACES[name]})")


def ties() -> None:
    """Print how many nodes three sensors cannot tell apart."""
    sensors = np.array([(0.0, 0.0), (20.0, 0.0), (10.0, 20.0)])
    nodes = likelihood.lattice((-20, -20), (40, 40), 0.5)
    position = np.array([14.0, 8.0])
    r = ranges(position, sensors)
    theta = 1.5 * np.log(r[1:] / r[0])
    printed = printed_17(nodes, sensors, np.exp(theta))
    corrected = likelihood.correlation(nodes, sensors, theta)
    count = [int((m > m.max() - 1e-4).sum()) for m in (printed, corrected)]
    print(
        f"three sensors: nodes within 1e-4 of the maximum of (17): as printed {count[0]} (1183), "
        f"with the reference {count[1]} (about 48)"
    )


@dataclass(frozen=True)
class Pass:
    """A straight pass over both antennas, drawn at random."""

    times_s: np.ndarray
    place: np.ndarray
    velocity: np.ndarray

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Pass:
        """Go 90 m at 3 to 15 m/s, in any direction, by up to 12 m off the middle."""
        heading, speed = rng.uniform(0, 2 * np.pi), rng.uniform(3, 15)
        times = np.arange(int(np.clip(90 / speed, 6, 40))) + 0.5
        velocity = speed * np.array([np.cos(heading), np.sin(heading)])
        return cls(times, 15 + rng.uniform(-12, 12, 2), velocity)

    def at(self, times_s: np.ndarray) -> np.ndarray:
        """Return places."""
        return self.place + self.velocity * (times_s - self.times_s.mean())[..., None]

    def observed(self, rng: np.random.Generator) -> Observed:
        """Return powers of cycles of 1 s, within which the vehicle moves; they scatter by 1/3."""
        fine = self.times_s[:, None] + np.linspace(-0.475, 0.475, 20)
        mean = 500 * LAW.power(ranges(self.at(fine), ANTENNAS)).mean(axis=1)
        floors = np.full(mean.shape, 0.2)
        powers = (mean + floors) * rng.gamma(9, 1 / 9, mean.shape)
        return Observed(self.times_s, powers, floors, ANTENNAS, LAW, 1.0)

    def off_m(self, course: lines.Course) -> float:
        """Return the mean distance of a course across the true one [m]."""
        across = np.array([-self.velocity[1], self.velocity[0]]) / np.hypot(*self.velocity)
        return float(np.abs((course.at(self.times_s) - self.at(self.times_s)) @ across).mean())


def courses(passes: int, rng: np.random.Generator) -> bool:
    """Print how far courses are off; return whether the direct fit reaches its target."""
    names = ("direct fit", "(7) and (9)", "(7), Huber", "(7), Tukey")
    off: list[list[float]] = [[] for _ in names]
    speeds: list[float] = []
    doubtful, taken = 0, 0.0
    axis = np.arange(-20.0, 50.5, 1.0)
    for _ in range(passes):
        vehicle = Pass.drawn(rng)
        observed = vehicle.observed(rng)
        began = time.perf_counter()
        fit = fit_course(observed, Search.about(ANTENNAS))
        taken += time.perf_counter() - began
        assert fit is not None
        doubtful += any(lost < 2 for _, lost in fit.rivals)
        speeds.append(abs(fit.course.speed_mps - float(np.hypot(*vehicle.velocity))))
        fixes, _ = cycle_places(observed, axis, axis)
        valid = np.isfinite(fixes[:, 0])
        estimates = [fit.course] + [
            lines.through(vehicle.times_s[valid], fixes[valid], loss)
            for loss in ("squares", "huber", "tukey")
        ]
        for errors, course in zip(off, estimates, strict=True):
            errors.append(vehicle.off_m(course))
    print(f"courses: {passes} passes over 2 antennas of 3: error across, median / 90 % [m]")
    for name, errors in zip(names, off, strict=True):
        print(f"  {name:13}{np.median(errors):.2f} / {np.quantile(errors, 0.9):.2f}")
    passed = bool(np.median(off[0]) <= TARGET_M)
    print(
        f"  direct fit: speed off by {np.median(speeds):.2f} m/s, {doubtful} passes have a rival "
        f"within 2 of log-likelihood, {taken / passes:.2f} s a pass; "
        f"target <= {TARGET_M} m: {'pass' if passed else 'FAIL'}"
    )
    return passed


def curves(paths: int, rng: np.random.Generator) -> None:
    """Print how far curved paths are off: 84 m of an arc of 25 m radius at 6 m/s."""
    times = np.arange(0, 14, 0.5) + 0.25
    angle = 6 * (times - 7) / 25
    axis = np.arange(-30.0, 60.5, 2.0)
    off: dict[str, list[float]] = {"on powers": [], "on places": [], "straight course": []}
    for _ in range(paths):
        middle = np.array([15.0, -5.0]) + rng.uniform(-5, 5, 2)
        truth = middle + 25 * np.stack([np.sin(angle), np.cos(angle)], axis=1)
        mean = 500 * LAW.power(ranges(truth, ANTENNAS)) + 0.2
        powers = mean * rng.gamma(9, 1 / 9, mean.shape)
        observed = Observed(times, powers, np.full(mean.shape, 0.2), ANTENNAS, LAW)
        guess = track_places(times, *cycle_places(observed, axis, axis))
        fit = fit_course(observed, Search.about(ANTENNAS))
        assert fit is not None
        estimates = track(observed, guess).places, guess.places, fit.course.at(times)
        for errors, path in zip(off.values(), estimates, strict=True):
            errors.append(float(np.median(np.linalg.norm(path - truth, axis=1))))
    print(f"curves: {paths} arcs, cycles of 0.5 s: median error, median over paths [m]")
    print("  " + ", ".join(f"{name} {np.median(errors):.1f}" for name, errors in off.items()))


def late_by(vehicle: RoadVehicle, first_s: float) -> float:
    """Return how far its pass at the first station is from a time [s]."""
    times = [one.time_s for station, one in vehicle.passes if station == 0]
    return abs(times[0] - first_s) if times else float("inf")


def roads(pairs: int, rng: np.random.Generator) -> None:
    """Print how many of two vehicles, that meet or overtake, are found by three stations."""
    along, offsets = (0.0, 60.0, 150.0), (5.0, 6.0, 4.0)
    times = np.arange(0, 80, 0.5) + 0.25
    detected, off, ghosts = 0, [], 0
    for _ in range(pairs):
        velocity = rng.uniform(4, 20, 2) * rng.choice([-1, 1], 2)
        moment = 40 + rng.uniform(-6, 6, 2)
        powers = []
        for x, offset in zip(along, offsets, strict=True):
            late = times[:, None] - moment - (x - 75) / velocity
            mean = 0.02 + 50 * ((velocity * late) ** 2 + offset**2) ** -0.75 @ np.ones(2)
            powers.append(mean * rng.gamma(18, 1 / 18, len(times)))
        observed = RoadPowers(
            times,
            np.array(powers).T,
            np.full((len(times), 3), 0.02),
            np.array(along),
            np.array(offsets),
            1.5,
            0.5,
        )
        peaks = [station_peaks(times, power, power, 15.0, 4.0) for power in powers]
        left = [v for v in driven(observed, peaks, (1.5, 45.0)) if v.prominence_db >= 15]
        for v, t in zip(velocity, moment, strict=True):
            first = t - 75 / v
            near = [p for p in left if p.direction == np.sign(v) and late_by(p, first) < 1]
            if near:
                best = min(near, key=lambda p: late_by(p, first))
                left.remove(best)
                detected += 1
                off.append(abs(best.speed_mps / abs(v) - 1))
        ghosts += len(left)
    print(
        f"roads: {pairs} pairs of vehicles within 12 s, 3 stations over 150 m: {detected} of "
        f"{2 * pairs} found, {ghosts} others, speed off by {np.median(off):.1%} in the median, "
        f"{np.quantile(off, 0.9):.1%} at 90 %"
    )


def main() -> None:
    """Print everything; fail where a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=2000)
    parser.add_argument("--places", type=int, default=400)
    parser.add_argument("--passes", type=int, default=50)
    options = parser.parse_args()
    rng = np.random.default_rng(0)
    exponents()
    good = estimators(options.trials, rng)
    places(options.places, rng)
    ties()
    curves(options.passes // 2, rng)
    roads(options.passes, rng)
    if not all([good, courses(options.passes, rng)]):
        sys.exit(1)


if __name__ == "__main__":
    main()
