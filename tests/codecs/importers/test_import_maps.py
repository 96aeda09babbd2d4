from __future__ import annotations

from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from groundtrace_codecs.errors import SchemaError
from groundtrace_codecs.importers.base import TimeMap
from groundtrace_codecs.importers.map import column, evaluate, load_map

STREAM = """
[[stream]]
topic = "/imu/waist"
placement = "waist"
columns = [{column = "ax", quantity = "acceleration", axis = "x", unit = "g", scale = 1.0}]
"""
MAP = 'format = "csv"\ntime = {column = "time_s", unit = "s"}\n' + STREAM


def written(folder: Path, text: str) -> Path:
    path = folder / "map.toml"
    path.write_text(text)
    return path


def test_the_map_of_the_documentation_loads(tmp_path: Path) -> None:
    map_ = load_map(written(tmp_path, 'delimiter = ","\nskip_rows = 1\n' + MAP))
    assert map_.time == TimeMap("time_s", "s")
    assert map_.stream[0].columns[0].axis == "x"
    assert map_.file == "map.toml"


def test_a_start_may_be_a_toml_time(tmp_path: Path) -> None:
    map_ = load_map(written(tmp_path, "start = 2020-12-10T14:09:03.815+01:00\n" + MAP))
    assert map_.start == "2020-12-10T14:09:03.815000+01:00"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("format = ", "map.toml: expected TOML"),
        ("colour = 1\n" + MAP, "map.toml: colour: expected a known key, found an unknown one"),
        (MAP + "gain = 2\n", r"map.toml: stream\[0\].gain: expected a known key"),
        (STREAM, "map.toml: format: expected a value, found none"),
        ("skip_rows = 'one'\n" + MAP, "map.toml: skip_rows: expected int, found str"),
        ("skip_rows = -1\n" + MAP, "map.toml: skip_rows: expected 0 or more, found -1"),
        ("delimiter = ';;'\n" + MAP, "map.toml: delimiter: expected one character"),
        (
            MAP.replace('"g"', '"m/ss2"'),
            r"columns\[0\].unit: expected a unit of acceleration, .* 'm/ss2'; did you mean m/s2\?",
        ),
        (MAP.replace('"g"', '"stone"'), r"columns\[0\].unit: expected a unit of .* 'stone'$"),
        (MAP.replace('"g"', '"hPa"'), r"columns\[0\].unit: expected a unit of acceleration"),
        (MAP.replace('"acceleration"', '"speed"'), r"columns\[0\].quantity: expected one of"),
        (MAP.replace('"acceleration"', '"acelleration"'), r"'acelleration'; did you mean accel"),
        (
            MAP.replace('"x"', '"nort"'),
            r"axis: expected x, y, z or w of the sensor, or e, n or u .*, found 'nort'; did you "
            r"mean north\?",
        ),
        ("delimeter = 'x'\n" + MAP, r"delimeter: expected a known key, .*; did you mean delimiter"),
        (MAP.replace("axis", "axes"), r"axes: expected a known key, .*; did you mean axis\?"),
        (MAP.replace('unit = "s"', 'unitt = "s"'), r"time.unitt: .*; did you mean unit\?"),
        (MAP + "[[truth]]\nkind = 'steps'\n", r"found 'steps'; did you mean step\?"),
        ('format = "csv"\n' + STREAM, r"stream\[0\]: expected one of time and rate_hz, found nei"),
        ("rate_hz = 1.0\n" + MAP, r"stream\[0\]: expected one of time and rate_hz, found both"),
        ('format = "csv"\nrate_hz = 0.0\n' + STREAM, r"stream\[0\].rate_hz: expected a positive"),
        (MAP + STREAM, r"stream\[0\].topic: expected a name of its own"),
        ('format = "csv"\nstream = []\n', "map.toml: stream: expected at least one, found none"),
        (MAP + "[[truth]]\nkind = 'jump'\n", r"truth\[0\].kind: expected one of count"),
        (MAP + "[[truth]]\nkind = 'step'\n", r"truth\[0\]: expected one of time, increments_of"),
        (MAP + "[[truth]]\nkind = 'step'\ntotal_of = 'n'\n", r"truth\[0\].kind: expected count"),
        (MAP + "[[truth]]\nkind = 'walking'\ntime = 't'\n", r"truth\[0\].end: expected a path"),
    ],
)
def test_a_wrong_map_is_refused_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(SchemaError, match=message) as caught:
        load_map(written(tmp_path, text))
    assert "\n" not in str(caught.value)


def test_every_map_that_ships_loads() -> None:
    maps = sorted(Path(str(files("groundtrace_recordings"))).glob("maps/*.toml"))
    assert maps
    for path in maps:
        assert load_map(path).stream


ROOT = {
    "data": {
        "acc": np.arange(6.0).reshape(3, 2),
        "bouts": np.array([{"start": 1.0, "name": "a"}, {"start": 2.0, "name": "b"}], object),
        "one": {"start": 3.0},
    }
}


def test_a_path_leads_to_columns_and_elements() -> None:
    assert column(ROOT, "data.acc[:,1]", "f").tolist() == [1.0, 3.0, 5.0]
    assert column(ROOT, "data.acc[2,0]", "f").tolist() == [4.0]
    assert column(ROOT, "data.bouts[*].start", "f").tolist() == [1.0, 2.0]
    assert evaluate(ROOT, "data.bouts[1].name", "f") == ["b"]


def test_a_single_struct_counts_as_an_array_of_one() -> None:
    assert evaluate(ROOT, "data.one[*].start", "f") == [3.0]


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("data.gyr", "f: data.gyr: expected one of acc, bouts, one, found none"),
        ("data.acc.x", "f: data.acc.x: expected one of no names, found none"),
        ("data.acc[:,7]", r"f: data.acc\[:,7\]: expected an index inside the array"),
        ("data.acc[x]", r"f: data.acc\[x\]: expected \[\*\], \[i\] or \[:,j\], found \[x\]"),
        ("data!", "f: data!: expected a name or .index. at '!', found neither"),
        ("data.acc", r"f: data.acc: expected one column of numbers, found shape \(3, 2\)"),
        ("data.bouts[*].name", r"f: data.bouts\[\*\].name: expected numbers, found"),
        ("data.bouts", "f: data.bouts: expected numbers, found"),
    ],
)
def test_a_path_that_leads_nowhere_says_where_it_ends(path: str, message: str) -> None:
    with pytest.raises(SchemaError, match=message):
        column(ROOT, path, "f")
