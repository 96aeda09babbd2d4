"""Butterworth filters: scipy's coefficients and scipy's steady state."""

from __future__ import annotations

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy import signal

from groundtrace.dsp.filters import butterworth, steady_state

ORDERS = st.integers(1, 6)
RATES = st.sampled_from([6.0, 50.0, 59.4, 100.0, 500.0, 1000.0, 4000.0, 20_000.0])
PARTS = st.floats(0.001, 0.499)


@given(order=ORDERS, rate_hz=RATES, part=PARTS, highpass=st.booleans())
def test_a_filter_of_one_corner_is_that_of_scipy(order, rate_hz, part, highpass):
    edge = part * rate_hz
    found = butterworth(order, (edge,), rate_hz, highpass=highpass)
    kind = "highpass" if highpass else "lowpass"
    told = signal.butter(order, edge, kind, fs=rate_hz, output="sos")
    np.testing.assert_allclose(found, told, rtol=1e-12, atol=0)


@given(order=ORDERS, rate_hz=RATES, parts=st.tuples(PARTS, PARTS))
def test_a_bandpass_is_that_of_scipy(order, rate_hz, parts):
    low, high = sorted(part * rate_hz for part in parts)
    assume(high > 1.01 * low)
    found = butterworth(order, (low, high), rate_hz)
    told = signal.butter(order, (low, high), "bandpass", fs=rate_hz, output="sos")
    np.testing.assert_allclose(found, told, rtol=1e-12, atol=0)


@given(order=st.integers(1, 4), parts=st.tuples(PARTS, PARTS))
def test_the_steady_state_is_that_of_scipy(order, parts):
    low, high = sorted(parts)
    assume(high > 1.01 * low)
    for sos in (butterworth(order, (low, high), 1.0), butterworth(order, (high,), 1.0)):
        np.testing.assert_allclose(
            steady_state(sos), signal.sosfilt_zi(sos), rtol=1e-12, atol=1e-300
        )


def test_what_holds_the_steady_state_passes_a_constant_on_unchanged():
    sos = butterworth(3, (0.1,), 1.0)
    filtered, _ = signal.sosfilt(sos, np.full(50, 7.0), zi=7.0 * steady_state(sos))
    np.testing.assert_allclose(filtered, 7.0)
