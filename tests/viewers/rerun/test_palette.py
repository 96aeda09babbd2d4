from __future__ import annotations

import numpy as np
from viewer_sessions import IMU, NAMES, SEISMIC, room_session

from groundtrace_viewers.rerun.timeline import (
    AXIS_COLOURS,
    FALSE,
    FIX_COLOURS,
    HEADING_COLOURS,
    LEFT,
    MISSED,
    RIGHT,
    SENSOR_COLOUR_NAMES,
    SENSOR_COLOURS,
    STEP_COLOURS,
    TRUTH,
    TYPE_COLOURS,
    SensorColours,
    heat,
)
from groundtrace_viewers.rerun.wrong_decisions import VERDICT_COLOURS


def lightness(packed: np.ndarray) -> np.ndarray:
    r, g, b = ((packed.astype(np.int64) >> s) & 0xFF for s in (24, 16, 8))
    return 0.2126 * r + 0.7152 * g + 0.0722 * b


def test_hotter_is_lighter() -> None:
    assert np.all(np.diff(lightness(heat(np.linspace(0.0, 1.0, 64)))) > 0)


def test_levels_outside_are_clipped() -> None:
    np.testing.assert_array_equal(heat(np.array([-5.0, 9.0])), heat(np.array([0.0, 1.0])))


def test_sensors_have_colours_of_their_own_that_show_on_black() -> None:
    assert len(set(SENSOR_COLOURS)) == len(SENSOR_COLOURS)
    assert lightness(np.array(SENSOR_COLOURS)).min() > 90


def test_a_sensor_keeps_its_colour_whoever_asks() -> None:
    colours = SensorColours(room_session())
    assert [colours.of(n) for n in reversed(NAMES)] == list(reversed(SENSOR_COLOURS[:4]))


def test_axes_of_all_worn_quantities_share_their_colours() -> None:
    colours = SensorColours(room_session())
    shades = [colours.of_channel(c) for c in IMU.channels[:9]]
    assert shades[:3] == shades[3:6] == shades[6:9]


def test_a_title_says_which_curve_is_which() -> None:
    colours = SensorColours(room_session())
    assert colours.key(IMU.channels[:3]) == "x sand, y teal, z steel"
    assert colours.key(SEISMIC.channels) == "G1 orange, G2 sky, G3 green, G4 yellow"
    assert colours.key(SEISMIC.channels[:1]) == colours.key([*SEISMIC.channels] * 2) == ""
    assert len(SENSOR_COLOUR_NAMES) == len(set(SENSOR_COLOUR_NAMES)) == len(SENSOR_COLOURS)


def test_the_axes_have_no_colour_that_says_right_wrong_left_or_right() -> None:
    said = {*STEP_COLOURS.values(), *VERDICT_COLOURS.values()}
    assert said.isdisjoint(AXIS_COLOURS.values())


def test_nothing_but_what_is_false_is_pink() -> None:
    others = (*FIX_COLOURS, *HEADING_COLOURS.values(), *TYPE_COLOURS.values())
    reds, greens, blues = (np.array([(c >> s) & 0xFF for c in others]) for s in (24, 16, 8))
    pink = (reds - greens > 60) & (blues - greens > 30)
    assert not pink.any()
    assert {MISSED, FALSE, LEFT, RIGHT, TRUTH}.isdisjoint(others)
