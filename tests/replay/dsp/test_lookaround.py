"""A signal looked at with its surroundings: the same, however it comes."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from replay_blocks import cuts_of, parts_of

from groundtrace.dsp.filters import CentredWindow, level

SIGNALS = st.lists(st.integers(-3, 3), max_size=60)


def maxima_of(x: list[int]) -> list[int]:
    return [i for i in range(1, len(x) - 1) if x[i - 1] < x[i] >= x[i + 1]]


@given(x=SIGNALS, cuts=cuts_of(60), before=st.integers(1, 9), after=st.integers(1, 9))
def test_every_maximum_is_seen_once_with_its_surroundings(x, cuts, before, after) -> None:
    signal, values = CentredWindow(1, before, after), np.array([x], float)
    seen, surroundings = [], []
    parts = parts_of(values, [min(c, len(x)) for c in cuts])
    done = 0
    for part in [*parts, None]:
        if part is None:
            columns = signal.flush()
        else:
            columns = signal.add(np.arange(done, done + part.shape[1]), part)
            done += part.shape[1]
        for peak in signal.maxima(columns):
            seen.append(int(signal.times[peak]))
            near = signal.around(int(peak), min(before, after))
            surroundings.append(signal.values[0, near].tolist())
    reach = min(before, after)
    assert seen == maxima_of(x)
    assert surroundings == [x[max(0, i - reach) : i + reach + 1] for i in seen]


def test_nothing_is_kept_that_no_sample_looks_back_to() -> None:
    signal = CentredWindow(1, 3, 5)
    for start in range(0, 1000, 10):
        signal.add(np.arange(start, start + 10), np.zeros((1, 10)))
    assert signal.values.shape[1] <= 3 + 5 + 10


def test_a_level_is_the_root_of_the_mean_square() -> None:
    assert level(np.array([3.0, -4.0, 0.0, 0.0])) == 2.5
