from __future__ import annotations

import numpy as np
import pytest

from groundtrace_viewers.rerun.samples import KEEP_NS, Excerpts

MS = 1_000_000


def ramp(first_ms: int, last_ms: int) -> tuple[np.ndarray, np.ndarray]:
    ms = np.arange(first_ms, last_ms)
    return ms * MS, ms[:, np.newaxis].astype(np.float64)


@pytest.mark.parametrize("size", [1, 7, 100, 1000])
def test_what_lies_around_a_moment_is_kept_however_blocks_are_cut(size: int) -> None:
    excerpts = Excerpts(0.1, 0.2)
    for start in range(0, 1000, size):
        excerpts.push(*ramp(start, min(start + size, 1000)))
        if start <= 500 < start + size:
            excerpts.expect(500 * MS)
    piece = excerpts.around(500 * MS)
    assert piece is not None
    np.testing.assert_array_equal(piece[0], np.arange(400, 700) * MS)
    np.testing.assert_array_equal(piece[1][:, 0], np.arange(400, 700))


def test_a_moment_lasts_until_it_is_asked_for() -> None:
    excerpts = Excerpts(0.1, 0.1)
    excerpts.push(*ramp(0, 1000))
    excerpts.expect(500 * MS)
    for start in range(1000, 20_000, 1000):
        excerpts.push(*ramp(start, start + 1000))
    assert KEEP_NS < 19_000 * MS
    piece = excerpts.around(520 * MS)
    assert piece is not None
    assert (piece[0][0], piece[0][-1]) == (420 * MS, 619 * MS)


def test_nothing_is_known_of_a_moment_nobody_expected() -> None:
    excerpts = Excerpts(0.1, 0.1)
    excerpts.push(*ramp(0, 1000))
    excerpts.expect(100 * MS)
    assert excerpts.around(700 * MS) is None
    assert excerpts.around(100 * MS) is None, "what lies before is forgotten"
