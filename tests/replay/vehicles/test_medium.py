"""The law of power (4), and the geophone (3)."""

from __future__ import annotations

import numpy as np
import pytest

from groundtrace.vehicles.medium import Geophone, Kind, PowerLaw, loss_per_m


@pytest.mark.parametrize("kind", ["low-pass", "high-pass"])
def test_a_geophone_resonates_at_its_natural_frequency(kind: Kind) -> None:
    response = Geophone(10.0, 0.7, kind).response(np.array([10.0]))
    assert abs(response[0]) == pytest.approx(1 / 1.4)
    assert abs(np.angle(response[0])) == pytest.approx(np.pi / 2)


def test_on_top_of_a_sensor_power_is_that_at_half_a_metre() -> None:
    law = PowerLaw(2.0, 1.5)
    assert law.power(np.array([0.0, 0.5])) == pytest.approx([2 * 0.5**-1.5] * 2)
    assert law.slope(np.array([0.1])) == 0
    assert law.slope(np.array([3.0])) == pytest.approx(-0.5)


def test_loss_takes_from_power_what_it_takes_from_the_square_of_an_amplitude() -> None:
    r, loss_spm = np.array([2.0, 20.0, 100.0]), 1e-3
    amplitude = r**-0.5 * np.exp(-np.pi * loss_spm * 20.0 * r)  # (1) at 20 Hz
    law = PowerLaw(1.0, 1.0, loss_per_m(loss_spm, 20.0))
    assert law.power(r) == pytest.approx(amplitude**2, rel=1e-9)
