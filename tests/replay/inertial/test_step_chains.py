"""The patterns of both chains, on strips made by hand after figures 2 and 3 of the document."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from groundtrace.inertial.body_motion import Swing
from groundtrace.inertial.step_type import (
    CONTACT,
    PHASE,
    FrontalShape,
    LateralShape,
    Shape,
    StepTypeParameters,
    StepTypes,
    common_share,
    corrected_lead,
    frontal,
    lateral,
    smoothing,
    strip_of,
)
from groundtrace.pipeline.gates import Candidates, decide


def walking(lead: float, sharp: float = 0.3) -> np.ndarray:
    """A walk ahead or back; its frontal maximum leads the vertical one at 0.1."""
    turn = 2 * np.pi * (PHASE - 0.1)
    skew = np.sign(lead) * sharp  # the slope towards the vertical maximum is the steeper one
    ahead = np.cos(turn + 2 * np.pi * lead) + skew * np.sin(2 * (turn + 2 * np.pi * lead))
    return np.stack([ahead, 0.3 * np.sin(turn / 2), 1.5 * np.cos(turn)])


def sideways(side: int, strides: int = 3) -> np.ndarray:
    """Side steps, +1 to the right: pushed off before each even contact, braked just after it."""
    right = np.zeros(len(PHASE))
    for lead in 2 * np.arange(strides) - 2 * (strides // 2):
        for at, sign in ((lead - 0.5, 1), (lead + 0.25, -1)):
            right += side * sign * np.exp(-0.5 * ((PHASE - at) / 0.18) ** 2)
    up = 0.3 * np.cos(2 * np.pi * (PHASE - 0.2))
    return np.stack([0.05 * up, 2 * right, up])


@pytest.mark.parametrize("lead", [0.25, 0.15, -0.15, -0.25])
def test_the_order_of_the_maxima_is_measured_in_steps(lead: float) -> None:
    found = frontal(walking(lead, 0.0), None)
    assert found.lead == pytest.approx(lead, abs=1 / 32)
    assert found.window == pytest.approx(0.5, abs=2 / 32)


def test_the_density_is_the_triangle_s_area_by_its_base_and_the_vertical_range() -> None:
    # a triangle of height 2 has the density 1, as a part of the vertical range of 3
    assert frontal(walking(0.25, 0.0), None).density == pytest.approx(1 / 3, abs=0.02)


def test_slopes_tell_forward_from_backward_as_the_order_does() -> None:
    assert frontal(walking(0.25), None).slopes > 0.1
    assert frontal(walking(-0.25), None).slopes < -0.1


def test_a_step_without_a_frontal_maximum_leads_as_its_swing_does() -> None:
    strip = walking(0.25)
    strip[0] = -PHASE
    found = frontal(strip, Swing(1j, 0j, 1.0))
    assert (found.lead, found.density) == (0.25, 0.0)


@pytest.mark.parametrize("strides", [1, 3])
@pytest.mark.parametrize("side", [1, -1])
def test_the_steeper_slope_tells_the_side_also_of_a_single_step(side: int, strides: int) -> None:
    found = lateral(sideways(side, strides))
    assert side * found.slopes > 0.1
    assert found.inside > 0
    assert found.share > 2
    assert found.lobe > 0.06


@pytest.mark.parametrize("side", [1, -1])
def test_the_contact_that_closes_the_feet_is_on_the_gentle_side(side: int) -> None:
    strip = np.roll(sideways(side), -32, axis=1)  # looked at from one contact later
    assert lateral(strip).inside < -0.1


def test_a_strip_is_the_signal_on_a_grid_of_steps() -> None:
    times = np.arange(-400, 400) / 100
    values = np.stack([times, 0 * times, np.cos(2 * np.pi * times / 0.7)])
    strip = strip_of(times, values, 0.7)
    assert strip.shape == (3, len(PHASE))
    assert PHASE[CONTACT] == 0
    np.testing.assert_allclose(strip[0, 20:-20], 0.7 * PHASE[20:-20], atol=1e-9)
    tops = signal.argrelmax(strip[2, CONTACT - 48 : CONTACT + 49])[0]
    assert tops.tolist() == [16, 48, 80]


def test_the_low_pass_is_the_document_s() -> None:
    b, a = signal.sos2tf(smoothing(4.0, 30.0))
    expected_b = [0.037158, 0.111475, 0.111475, 0.037158]
    np.testing.assert_allclose(b[:4], expected_b, atol=1e-6)
    np.testing.assert_allclose(a[:4], [1, -1.359577, 0.832722, -0.175879], atol=1e-6)
    np.testing.assert_allclose((b[4:], a[4:]), 0, atol=1e-12)
    # not 4 samples, as "its 4 coefficients" would have it
    _, delay = signal.group_delay((b, a), w=[0.5, 4.0], fs=30.0)
    assert np.sort(delay) == pytest.approx([2.27, 3.36], abs=0.02)
    assert np.isfinite(smoothing(4.0, 6.0)).all()  # above what 6 Hz can hold


def pattern(lead: float, slopes: float = 0.0) -> FrontalShape:
    return FrontalShape(0.4, lead, 0.3, slopes, 4.0)


FORWARD, BACKWARD = pattern(0.25), pattern(-0.2)


@pytest.mark.parametrize(
    ("before", "own", "after", "expected"),
    [
        ((FORWARD, FORWARD), pattern(-0.1), (), 0.25),  # the odd one out at the end of a walk
        ((), pattern(-0.1), (FORWARD, FORWARD), 0.25),
        ((FORWARD, FORWARD), pattern(-0.2, -0.8), (), -0.2),  # its slopes confirm it
        ((FORWARD, FORWARD), pattern(-0.5, -0.8), (), 0.25),  # half a step away: a neighbour's
        ((FORWARD, BACKWARD), pattern(-0.1), (), -0.1),  # they disagree
        ((FORWARD,), pattern(-0.1), (), -0.1),  # one is too few
        ((BACKWARD, BACKWARD), pattern(0.2), (FORWARD, FORWARD), -0.2),
    ],
)
def test_a_step_ordered_otherwise_than_two_neighbours_is_put_right(
    before: tuple[FrontalShape, ...],
    own: FrontalShape,
    after: tuple[FrontalShape, ...],
    expected: float,
) -> None:
    assert corrected_lead(before, own, after) == expected


def types_of(lead: float, range_mps2: float, **parameters: float) -> tuple[list[bool], list[str]]:
    """Verdicts on the four types of five equal steps, the middle one, and what rejects backward."""
    worker = StepTypes(StepTypeParameters(**parameters))
    shapes = [
        Shape(k * 500_000_000, 0.5, FrontalShape(0.4, lead, 0.3, 0.0, range_mps2), aside(0.5), 0.0)
        for k in range(5)
    ]
    rows = np.array(worker.rows(shapes[:2], shapes[2], shapes[3:]), np.float32)
    block = Candidates(np.full(4, shapes[2].time_ns), np.arange(4, dtype=np.int32), rows)
    found, _ = decide(block, StepTypes.columns, StepTypes.gates, worker.parameters)
    failed = np.flatnonzero(found.margin[1] < 0)
    return found.accepted.tolist(), [StepTypes.gates[k].name for k in failed]


def test_a_step_that_swings_too_much_for_one_back_goes_ahead_whatever_its_order() -> None:
    ahead, back = [True, False, False, False], [False, True, False, False]
    assert types_of(0.2, 4.0)[0] == types_of(0.2, 9.0)[0] == ahead
    assert types_of(-0.2, 4.0) == (back, [])
    assert types_of(-0.2, 9.0) == (ahead, ["vertical"])
    assert types_of(-0.2, 9.0, vertical=10.0) == (back, [])
    # what has no pattern of either goes nowhere
    assert types_of(-0.2, 9.0, window=0.5)[0] == [False] * 4


def aside(share: float) -> LateralShape:
    return LateralShape(share, 0.1, 0.5, 0.2)


def test_one_step_among_others_does_not_go_aside_by_itself() -> None:
    low, high = aside(0.6), aside(3.0)
    assert common_share([low, low], high, [low, low]) == 0.6
    assert common_share([high, high], low, [high]) == 3.0
    # at the ends of a walk the next two decide, of fewer than three steps none
    assert common_share([], high, [low, low]) == 0.6
    assert common_share([low], high, []) == 3.0


def test_a_turn_does_not_look_like_side_steps() -> None:
    strip = walking(0.25)
    straight = lateral(strip).share
    strip[1] += 1.5 * np.exp(-0.5 * ((PHASE - 0.5) / 1.5) ** 2)
    assert lateral(strip).share < straight + 0.25
