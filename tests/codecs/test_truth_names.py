"""Truth that names channels and stations: those of the recording, some of them, none."""

from __future__ import annotations

import pytest

from groundtrace_codecs.errors import SchemaError
from groundtrace_codecs.events import Label
from groundtrace_codecs.geometry import Geometry, Sensor, geometry_warnings
from groundtrace_codecs.signals import Channel, Stream
from groundtrace_codecs.truth import names_of, unmatched_names

STREAM = Stream("/s", tuple(Channel(f"G{i}", "ground_velocity", "m/s", "z") for i in (1, 2)), 500.0)
SITE = Geometry((Sensor("west", "G1", 0, 0), Sensor("east", "G2", 9, 0)))


def told(*labels: Label, geometry: Geometry | None = SITE) -> list[str]:
    return unmatched_names(labels, names_of([STREAM], geometry), "t.csv")


def test_names_that_are_there_are_not_told() -> None:
    assert not told(Label(1, "pick", channel="G1"), Label(2, "pass", channel="east"))
    assert not told(Label(1, "step"), Label(2, "step", label="left"))


def test_none_that_is_there_is_an_error_that_lists_both() -> None:
    with pytest.raises(SchemaError) as error:
        told(Label(1, "pick", channel="A1"), Label(2, "pick", channel="A2"))
    assert str(error.value) == (
        "t.csv: channel: expected channels of the recording (G1, G2), found A1, A2"
    )
    with pytest.raises(SchemaError, match=r"stations of the recording \(west, east\), found north"):
        told(Label(1, "pass", channel="north"))


def test_some_that_are_not_there_are_told() -> None:
    (line,) = told(Label(1, "pick", channel="G1"), Label(2, "pick", channel="A2"))
    assert line == "t.csv: 1 of 2 channels of the truth are none of the recording's: A2"


def test_where_the_stations_are_unknown_nothing_is_told_of_them() -> None:
    assert not told(Label(1, "pass", channel="north"), geometry=None)


def test_sensors_and_channels_without_each_other_are_told() -> None:
    assert not geometry_warnings(SITE, [STREAM])
    assert not geometry_warnings(Geometry(start=(0.0, 0.0)), [STREAM])
    other = Geometry((Sensor("west", "G1", 0, 0), Sensor("far", "G9", 9, 0)))
    assert geometry_warnings(other, [STREAM]) == [
        "1 of 2 sensors of the geometry have no channel in the recording: far (G9)",
        "1 of 2 seismic channels of the recording have no place in the geometry: G2",
    ]
    imu = Stream("/imu", (Channel("ax", "acceleration", "m/s2", "x"),), 100.0)
    assert not geometry_warnings(SITE, [STREAM, imu])
