"""Waves of solids, plates and layers: exact roots, limits and cut-offs."""

from __future__ import annotations

import numpy as np
import pytest
from thickness_modes import mode_hz

from groundtrace.errors import PipelineError
from groundtrace.physics.lamb import (
    a0_mps,
    cutoffs,
    group_mps,
    s0_mps,
    thin_a0_mps,
    thin_limit_hz,
)
from groundtrace.physics.shear import Layered, sh_cutoff_hz, sh_mps
from groundtrace.physics.solid import Solid
from groundtrace.simulate.plate import Plate

#: The thesis's example in sections 1.1 to 1.3.
EXAMPLE = Solid.of_lame(7000e6, 10000e6, 2500.0)
CONCRETE = Solid.of_plate(Plate())
GROUND = Layered(Solid.of_velocities(350, 180, 1600), Solid.of_velocities(1550, 450, 2000), 3.0)


def test_the_thesis_example_has_the_velocities_of_its_equations():
    assert EXAMPLE.s_mps == pytest.approx(2000)
    assert EXAMPLE.poisson == pytest.approx(0.2059, abs=1e-4)
    assert EXAMPLE.viktorov_mps == pytest.approx(0.9127 * 2000, abs=0.5)
    assert EXAMPLE.p_mps == pytest.approx(3286.3, abs=0.1)  # printed: 4400
    assert EXAMPLE.plate_mps == pytest.approx(3174.0, abs=0.1)  # printed, rounded: 3200


@pytest.mark.parametrize(
    ("poisson", "squared"), [(0.0, 3 - np.sqrt(5)), (0.25, 2 - 2 / np.sqrt(3))]
)
def test_the_rayleigh_velocity_is_the_closed_form_where_there_is_one(poisson, squared):
    solid = Solid(1e9, 2000.0, poisson)
    assert solid.rayleigh_mps / solid.s_mps == pytest.approx(np.sqrt(squared), rel=1e-12)


def test_viktorov_is_within_half_a_percent():
    solids = [Solid(1e9, 2000.0, poisson) for poisson in np.linspace(0, 0.499, 100)]
    error = [solid.viktorov_mps / solid.rayleigh_mps - 1 for solid in solids]
    assert 0.0046 < np.abs(error).max() < 0.005


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
@pytest.mark.parametrize(("phase", "symmetric"), [(a0_mps, False), (s0_mps, True)])
def test_lamb_velocities_are_those_of_the_lowest_mode_of_a_discretised_plate(
    poisson, phase, symmetric
):
    plate = Plate(poisson=poisson)
    frequency = np.array([30.0, 300, 2000, 5000, 8000, 10_000, 13_000, 20_000])
    solid = Solid.of_plate(plate)
    for hz, velocity in zip(frequency, phase(plate, frequency), strict=True):
        lowest = mode_hz(solid, plate.thickness_m, 2 * np.pi * hz / velocity, symmetric)[0]
        assert lowest == pytest.approx(hz, rel=2e-6)


def test_a0_is_the_thin_plate_at_low_frequency_and_rayleigh_at_high():
    ends = np.array([0.01, 1.0, 1e6])
    ratio = a0_mps(Plate(), ends) / thin_a0_mps(Plate(), ends)
    np.testing.assert_allclose(ratio[:2], 1, rtol=2e-4)
    assert a0_mps(Plate(), ends)[2] == pytest.approx(CONCRETE.rayleigh_mps, rel=1e-9)
    assert thin_a0_mps(Plate(), ends)[2] > 10 * CONCRETE.rayleigh_mps


def test_s0_is_the_plate_wave_at_low_frequency_and_rayleigh_at_high():
    velocity = s0_mps(Plate(), np.array([1.0, 1e6]))
    np.testing.assert_allclose(velocity, [CONCRETE.plate_mps, CONCRETE.rayleigh_mps], rtol=1e-6)
    assert CONCRETE.plate_mps == pytest.approx(np.sqrt(24e9 / (2500 * (1 - 0.2**2))))


def test_the_bending_constant_is_the_plate_wave_times_the_thickness():
    plate = Plate()
    assert plate.dispersion_m2s == pytest.approx(CONCRETE.plate_mps * 0.2 / (2 * np.sqrt(3)))


def test_a0_rises_and_s0_falls_all_the_way():
    frequency = np.geomspace(0.1, 2e5, 300)
    for poisson in (0.0, 0.3, 0.49):
        assert (np.diff(a0_mps(Plate(poisson=poisson), frequency)) > -1e-9).all()
        assert (np.diff(s0_mps(Plate(poisson=poisson), frequency)) < 1e-9).all()


def test_where_the_wave_is_six_thicknesses_long_the_thin_plate_is_nine_percent_too_fast():
    limit = np.array([thin_limit_hz(Plate())])
    assert thin_a0_mps(Plate(), limit)[0] / limit[0] == pytest.approx(6 * 0.2)
    assert limit[0] == pytest.approx(796.6, abs=0.1)
    assert thin_a0_mps(Plate(), limit) / a0_mps(Plate(), limit) == pytest.approx(1.087, abs=1e-3)


def test_group_velocity_is_twice_the_phase_velocity_of_bending_and_the_same_of_s0():
    frequency = np.array([1.0, 2.0])
    thin = group_mps(thin_a0_mps, Plate(), frequency)
    np.testing.assert_allclose(thin, 2 * np.sqrt(Plate().dispersion_m2s * 2 * np.pi * frequency))
    exact = group_mps(a0_mps, Plate(), frequency)
    np.testing.assert_allclose(exact / a0_mps(Plate(), frequency), 2, rtol=1e-3)
    np.testing.assert_allclose(group_mps(s0_mps, Plate(), frequency), CONCRETE.plate_mps, rtol=1e-4)


@pytest.mark.parametrize(("phase", "symmetric"), [(a0_mps, False), (s0_mps, True)])
def test_group_velocity_is_the_slope_of_the_modes_of_a_discretised_plate(phase, symmetric):
    frequency = np.array([500.0, 3000.0, 7000.0])
    k = 2 * np.pi * frequency / phase(Plate(), frequency)
    slopes = [
        np.pi * np.ptp([mode_hz(CONCRETE, 0.2, q, symmetric)[0] for q in (0.999 * x, 1.001 * x)])
        for x in k
    ]
    np.testing.assert_allclose(
        group_mps(phase, Plate(), frequency), slopes / (0.001 * k), rtol=1e-4
    )


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


def test_sh_modes_begin_at_their_cutoff_and_end_as_shear_waves():
    assert sh_cutoff_hz(Plate(), 1) == pytest.approx(5000)
    frequency = np.array([4999.0, 5001.0, 1e7])
    np.testing.assert_array_equal(sh_mps(Plate(), frequency), CONCRETE.s_mps)
    below, above, far = sh_mps(Plate(), frequency, mode=1)
    assert np.isnan(below)
    assert above > 20 * CONCRETE.s_mps
    assert far == pytest.approx(CONCRETE.s_mps, rel=1e-6)


@pytest.mark.parametrize("mode", [0, 1, 2])
def test_love_waves_leave_no_stress_between_layer_and_ground(mode):
    cutoff = GROUND.love_cutoff_hz(mode)
    frequency = cutoff + np.geomspace(0.5, 200, 40)
    velocity = GROUND.love_mps(frequency, mode)
    k, slow, fast = 2 * np.pi * frequency / velocity, 180.0, 450.0
    down = k * np.sqrt((velocity / slow) ** 2 - 1)
    out = k * np.sqrt(1 - (velocity / fast) ** 2)
    above = GROUND.layer.shear_pa * down * np.sin(down * 3.0)
    below = GROUND.ground.shear_pa * out * np.cos(down * 3.0)
    np.testing.assert_allclose(above, below, atol=1e-8 * GROUND.ground.shear_pa * k.max())
    assert ((down * 3.0 / np.pi).astype(int) == mode).all()  # so many nodes in the layer


def test_love_waves_fall_from_the_ground_velocity_to_the_layer_velocity():
    frequency = np.array([0.01, 10.0, 50.0, 1e5])
    velocity = GROUND.love_mps(frequency)
    assert (np.diff(velocity) < 0).all()
    assert velocity[0] == pytest.approx(450, rel=1e-4)
    assert velocity[-1] == pytest.approx(180, rel=1e-4)
    cutoff = GROUND.love_cutoff_hz(1)
    below, above = GROUND.love_mps(cutoff * np.array([0.999, 1.001]), mode=1)
    assert np.isnan(below)
    assert above == pytest.approx(450, rel=1e-3)


def test_a_fast_layer_guides_no_love_wave():
    with pytest.raises(PipelineError, match="expected a layer slower than 180 m/s, found 450"):
        Layered(GROUND.ground, GROUND.layer, 3.0)
