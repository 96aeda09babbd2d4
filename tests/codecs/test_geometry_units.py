"""Units of length in a geometry TOML, and the way back to TOML."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from groundtrace_codecs.errors import SchemaError
from groundtrace_codecs.geometry import Geometry, Medium, Sensor, tangent_plane

if TYPE_CHECKING:
    from pathlib import Path

TEXT = """
outline = [[0, 0], [200, 0], [200, 100]]
start = [10, 20]
source = [["hammer", 50, 60.5]]
[[sensor]]
name = "front"
channel = "G1"
x = 100
y = 50.0
clock_offset_s = 0.004
[medium]
velocity_mps = 1500.0
"""


def read(folder: Path, text: str) -> Geometry:
    path = folder / "g.toml"
    path.write_text(text, "utf-8")
    return Geometry.from_toml(path)


@pytest.mark.parametrize(
    ("unit", "metres"), [("m", 1.0), ("cm", 0.01), ("mm", 0.001), ("ft", 0.3048), ("in", 0.0254)]
)
def test_places_in_a_known_unit_become_metres(tmp_path: Path, unit: str, metres: float) -> None:
    found = read(tmp_path, f'unit = "{unit}"' + TEXT)
    assert (found.unit, found.length_unit) == ("m", "m")
    assert found.outline[1] == pytest.approx((200 * metres, 0))
    assert found.start == pytest.approx((10 * metres, 20 * metres))
    assert found.sources[0][1:] == pytest.approx((50 * metres, 60.5 * metres))
    (sensor,) = found.sensors
    assert (sensor.x, sensor.y) == pytest.approx((100 * metres, 50 * metres))
    assert sensor.clock_offset_s == 0.004
    assert found.medium.velocity_mps == 1500.0


def test_places_in_an_unknown_unit_stay_as_they_are(tmp_path: Path) -> None:
    found = read(tmp_path, 'unit = "unknown"' + TEXT)
    assert (found.unit, found.length_unit) == ("unknown", "units")
    assert found.outline[1] == (200, 0)
    assert Geometry.from_json(found.to_json()) == found


def test_an_origin_stays_in_degrees_and_metres_whatever_the_unit(tmp_path: Path) -> None:
    found = read(tmp_path, 'unit = "ft"\norigin = [49.46, 11.11, 310.0]' + TEXT)
    assert found.origin == (49.46, 11.11, 310.0)
    again = tmp_path / "again.toml"
    again.write_text(found.to_toml(), encoding="utf-8")
    assert Geometry.from_toml(again) == Geometry.from_json(found.to_json()) == found


def test_a_plane_touches_the_earth_at_the_origin_or_at_the_first_fix() -> None:
    here = (math.radians(49.46), math.radians(11.11))
    north = (here[0] + 1e-6, here[1])
    known = tangent_plane(Geometry(start=(5.0, 6.0), origin=(49.46, 11.11, 0.0)))
    assert known.map_position(*here) == (0.0, 0.0)
    heard = tangent_plane(Geometry(start=(5.0, 6.0)))
    assert heard.map_position(*here) == (5.0, 6.0)
    assert heard.map_position(*north) == pytest.approx((5.0, 6.0 + 6.37), abs=0.03)
    assert tangent_plane(None).map_position(*here) == (0.0, 0.0)


def test_a_unit_that_is_none_of_length_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SchemaError, match=r"^g.toml: unit: expected one of m, cm, .*, found 'kg'$"):
        read(tmp_path, 'unit = "kg"' + TEXT)


@pytest.mark.parametrize("unit", ["m", "unknown"])
def test_a_geometry_written_as_toml_is_read_as_the_same(tmp_path: Path, unit: str) -> None:
    medium = Medium(velocity_mps=1225.0, arrival_scale=2.4e-4, arrival_exponent=4 / 3)
    sensors = (Sensor('a "b"\n', "G1", 0.1, -2.0, clock_offset_s=-1e-3), Sensor("c", "G2", 3, 4))
    site = Geometry(sensors, ((0.0, 0.0), (1.0, 0.0)), (0.5, 0.5), (("s", 1.0, 2.0),), medium, unit)
    assert read(tmp_path, site.to_toml()) == site
    walked = replace(site, paths=(((0.0, 0.0), (1.0, 2.0)), ((1.0, 0.5), (2.0, 0.5))))
    assert read(tmp_path, walked.to_toml()) == walked
    bare = replace(site, outline=(), start=None, sources=(), medium=Medium())
    assert read(tmp_path, bare.to_toml()) == bare
