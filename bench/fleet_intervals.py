"""How many intervals of a fleet's report hold the true change, where people recur.

    python bench/fleet_intervals.py --runs 1000

Fleets are drawn by laws of which the truth is known: people differ in what a change does to them,
the recordings of one are alike, and some have many more than others. The figure is the recall of
all steps together; on average nothing changed. Each interval claims to hold nine of ten. Rivals:
the same of recordings as if each were of another person, groups drawn with replacement, with the
plain and the expanded percentile interval, and Student's t of the people's mean changes, which is
the interval of another figure: each person counts once, whatever the number of their steps.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from groundtrace.explain.reasons import ENDS, RatioOfSums, interval_of_change

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Pair = tuple[RatioOfSums, RatioOfSums, NDArray[np.intp]]

#: How a person's own change is drawn, with mean 0 and deviation 1.
LAWS: dict[str, Callable[[np.random.Generator, int], Array]] = {
    "normal": lambda rng, n: rng.normal(size=n),
    "skewed": lambda rng, n: rng.exponential(size=n) - 1,
    "heavy tails": lambda rng, n: rng.standard_t(3, n) / np.sqrt(3),
}
PEOPLE = (6, 8, 12, 20, 40)
#: Deviation of people's changes of recall, and of recordings beside it.
OF_PEOPLE, OF_RECORDINGS = 0.03, 0.02
STEPS = 100
DRAWS = 2000


def fleet(rng: np.random.Generator, law: str, people: int) -> Pair:
    """Return recall before and after, and whose each recording is; on average nothing changed."""
    of = np.repeat(np.arange(people), rng.integers(1, 11, people))
    person_changes = OF_PEOPLE * LAWS[law](rng, people)
    before = np.clip(rng.normal(0.8, 0.05, people)[of] + rng.normal(0, 0.02, len(of)), 0, 1)
    after = before + person_changes[of] + rng.normal(0, OF_RECORDINGS, len(of))
    steps = np.full(len(of), float(STEPS))
    return RatioOfSums(before * steps, steps), RatioOfSums(after * steps, steps), of


def ours(before: RatioOfSums, after: RatioOfSums, of: NDArray[np.intp]) -> tuple[float, float]:
    """Return the interval of the report, of whole groups."""
    return by_recording(before.by_group(of), after.by_group(of), of)


def by_recording(
    before: RatioOfSums, after: RatioOfSums, _: NDArray[np.intp]
) -> tuple[float, float]:
    """Return the interval of the report without groups."""
    interval = interval_of_change(before, after)
    assert interval is not None
    return interval.low, interval.high


def _draws(before: RatioOfSums, after: RatioOfSums, of: NDArray[np.intp]) -> tuple[Array, int]:
    """Return the change of each draw of whole groups, and how many groups there are."""
    first, last = before.by_group(of), after.by_group(of)
    n = len(first.top)
    times = np.random.default_rng(0).multinomial(n, np.full(n, 1 / n), DRAWS)
    changes = times @ last.top / (times @ last.bottom) - times @ first.top / (times @ first.bottom)
    return changes, n


def percentile(
    before: RatioOfSums, after: RatioOfSums, of: NDArray[np.intp]
) -> tuple[float, float]:
    """Return the plain percentile interval, with whole groups drawn."""
    low, high = np.percentile(_draws(before, after, of)[0], ENDS)
    return float(low), float(high)


def expanded(before: RatioOfSums, after: RatioOfSums, of: NDArray[np.intp]) -> tuple[float, float]:
    """Return the expanded percentile interval (Hesterberg 2015, The American Statistician 69)."""
    changes, n = _draws(before, after, of)
    tail = 100 * norm.cdf(np.sqrt(n / (n - 1)) * student.ppf(ENDS[0] / 100, n - 1))
    low, high = np.percentile(changes, [tail, 100 - tail])
    return float(low), float(high)


def of_means(before: RatioOfSums, after: RatioOfSums, of: NDArray[np.intp]) -> tuple[float, float]:
    """Return Student's interval of the mean over people, each of whom counts once."""
    first, last = before.by_group(of), after.by_group(of)
    changes = last.top / last.bottom - first.top / first.bottom
    n = len(changes)
    half = student.ppf(ENDS[1] / 100, n - 1) * changes.std(ddof=1) / np.sqrt(n)
    return float(changes.mean() - half), float(changes.mean() + half)


WAYS = {
    "groups left out in turn (the report)": ours,
    "groups drawn, expanded percentile": expanded,
    "groups drawn, percentile": percentile,
    "Student's t of groups' mean changes": of_means,
    "recordings (the report without groups)": by_recording,
}


def main() -> None:
    """Print how many intervals hold the truth."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=1000)
    options = parser.parse_args()
    print(f"intervals that hold the true change, of {options.runs}; they claim 90 %")
    print(f"{'':48}{'law':14}" + "".join(f"{people:>10}" for people in PEOPLE) + "  people")
    for law in LAWS:
        coverage: dict[tuple[str, int], list[bool]] = {(w, n): [] for w in WAYS for n in PEOPLE}
        wide: dict[tuple[str, int], list[float]] = {key: [] for key in coverage}
        for people in PEOPLE:
            rng = np.random.default_rng(people)
            for _ in range(options.runs):
                before, after, of = fleet(rng, law, people)
                for way, interval in WAYS.items():
                    low, high = interval(before, after, of)
                    coverage[way, people].append(low <= 0 <= high)
                    wide[way, people].append(high - low)
        for way in WAYS:
            cells = [f"{np.mean(coverage[way, people]):10.1%}" for people in PEOPLE]
            print(f"{way:48}{law:14}" + "".join(cells))
        for way in WAYS:
            cells = [f"{np.median(wide[way, people]):10.4f}" for people in PEOPLE]
            print(f"{'width: ' + way:48}{law:14}" + "".join(cells))


if __name__ == "__main__":
    main()
