"""The rhythm of a signal."""

from __future__ import annotations

import numpy as np

from groundtrace.dsp.periodicity import Rhythm, Scale


def test_a_rhythm_does_not_depend_on_how_many_windows_come_at_once():
    signal = np.sin(np.arange(2000) * 0.28)[None, :] + np.random.default_rng(1).normal(0, 0.3, 2000)
    whole, parts = (Rhythm((Scale(4.0, 2), Scale(8.0, 2)), 6.0) for _ in range(2))
    expected = np.concatenate([whole(signal), whole.flush()], axis=1)
    found = [parts(signal[:, at : at + 7]) for at in range(0, 2000, 7)]
    np.testing.assert_array_equal(np.concatenate([*found, parts.flush()], axis=1), expected)
