from __future__ import annotations

import numpy as np
from viewer_sessions import IMU, NAMES, room_session

from groundtrace_viewers.rerun.timeline import SENSOR_COLOURS, SensorColours, heat


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
