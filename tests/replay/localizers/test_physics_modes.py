"""Waves of solids and plates: exact roots, limits and cut-offs."""

from __future__ import annotations

import numpy as np
import pytest
from thickness_modes import mode_hz

from groundtrace.errors import PipelineError
from groundtrace.localizers.wave_physics import (
    Plate,
    Solid,
    a0_mps,
    cutoffs,
    thin_a0_mps,
    thin_limit_hz,
)

#: The thesis's example in sections 1.1 to 1.3.
EXAMPLE = Solid.of_lame(7000e6, 10000e6, 2500.0)
CONCRETE = Solid.of_plate(Plate())


def test_the_thesis_example_has_the_velocities_of_its_equations():
    assert EXAMPLE.s_mps == pytest.approx(2000)
    assert EXAMPLE.poisson == pytest.approx(0.2059, abs=1e-4)
    assert EXAMPLE.p_mps == pytest.approx(3286.3, abs=0.1)  # printed: 4400
    assert EXAMPLE.plate_mps == pytest.approx(3174.0, abs=0.1)  # printed, rounded: 3200


@pytest.mark.parametrize(
    ("poisson", "squared"), [(0.0, 3 - np.sqrt(5)), (0.25, 2 - 2 / np.sqrt(3))]
)
def test_the_rayleigh_velocity_is_the_closed_form_where_there_is_one(poisson, squared):
    solid = Solid(1e9, 2000.0, poisson)
    assert solid.rayleigh_mps / solid.s_mps == pytest.approx(np.sqrt(squared), rel=1e-12)


def test_constants_come_back_from_velocities():
    again = Solid.of_velocities(CONCRETE.p_mps, CONCRETE.s_mps, CONCRETE.density_kgm3)
    assert again.young_pa == pytest.approx(24e9)
    assert again.poisson == pytest.approx(0.2)
    assert again.lame_pa == pytest.approx(CONCRETE.lame_pa)


@pytest.mark.parametrize(
    ("constants", "place"),
    [((0, 1, 0.2), "young_pa"), ((1, -1, 0.2), "density_kgm3"), ((1, 1, 0.5), "poisson")],
)
def test_a_solid_that_cannot_be_is_refused(constants, place):
    with pytest.raises(PipelineError, match=f"solid: {place}: expected"):
        Solid(*constants)


@pytest.mark.parametrize("poisson", [0.0, 0.2, 0.35, 0.45])
def test_a0_is_the_lowest_mode_of_a_discretised_plate(poisson):
    plate = Plate(poisson=poisson)
    frequency = np.array([30.0, 300, 2000, 5000, 8000, 10_000, 13_000, 20_000])
    solid = Solid.of_plate(plate)
    for hz, velocity in zip(frequency, a0_mps(plate, frequency), strict=True):
        lowest = mode_hz(solid, plate.thickness_m, 2 * np.pi * hz / velocity, symmetric=False)[0]
        assert lowest == pytest.approx(hz, rel=2e-6)


def test_a0_is_the_thin_plate_at_low_frequency_and_rayleigh_at_high():
    ends = np.array([0.01, 1.0, 1e6])
    ratio = a0_mps(Plate(), ends) / thin_a0_mps(Plate(), ends)
    np.testing.assert_allclose(ratio[:2], 1, rtol=2e-4)
    assert a0_mps(Plate(), ends)[2] == pytest.approx(CONCRETE.rayleigh_mps, rel=1e-9)
    assert thin_a0_mps(Plate(), ends)[2] > 10 * CONCRETE.rayleigh_mps


def test_the_plate_wave_is_that_of_the_slowest_s0_of_a_discretised_plate():
    k = 0.01
    assert 2 * np.pi * mode_hz(CONCRETE, 0.2, k, symmetric=True)[0] / k == pytest.approx(
        CONCRETE.plate_mps, rel=1e-6
    )
    assert CONCRETE.plate_mps == pytest.approx(np.sqrt(24e9 / (2500 * (1 - 0.2**2))))


def test_the_bending_constant_is_the_plate_wave_times_the_thickness():
    plate = Plate()
    assert plate.dispersion_m2s == pytest.approx(CONCRETE.plate_mps * 0.2 / (2 * np.sqrt(3)))


def test_a0_rises_all_the_way():
    frequency = np.geomspace(0.1, 2e5, 300)
    for poisson in (0.0, 0.3, 0.49):
        assert (np.diff(a0_mps(Plate(poisson=poisson), frequency)) > -1e-9).all()


def test_where_the_wave_is_six_thicknesses_long_the_thin_plate_is_nine_percent_too_fast():
    limit = np.array([thin_limit_hz(Plate())])
    assert thin_a0_mps(Plate(), limit)[0] / limit[0] == pytest.approx(6 * 0.2)
    assert limit[0] == pytest.approx(796.6, abs=0.1)
    assert thin_a0_mps(Plate(), limit) / a0_mps(Plate(), limit) == pytest.approx(1.087, abs=1e-3)


@pytest.mark.parametrize("poisson", [0.1, 0.2, 0.4])
def test_cutoffs_are_the_modes_of_a_discretised_plate_at_infinite_wavelength(poisson):
    plate = Plate(poisson=poisson)
    found = cutoffs(plate, 30_000.0)
    for family, symmetric in (("A", False), ("S", True)):
        modes = mode_hz(Solid.of_plate(plate), plate.thickness_m, 0.0, symmetric)[1:]
        mine = [c.frequency_hz for c in found if c.mode[0] == family]
        np.testing.assert_allclose(mine, modes[: len(mine)], rtol=1e-6)
        assert modes[len(mine)] > 30_000


def test_the_first_cutoffs_are_those_of_equation_1_5():
    found = cutoffs(Plate(), 10_100.0)
    assert [(c.mode, c.wave) for c in found] == [("A1", "S"), ("S1", "P"), ("S2", "S")]
    np.testing.assert_allclose([c.frequency_hz for c in found], [5000, 8165, 10_000], rtol=1e-4)
