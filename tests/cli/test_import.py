"""``groundtrace import``: units that cannot be true, ``--strict``, StationXML to the map."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import numpy as np
import pytest
from command_runs import done, run

from groundtrace_codecs.events import Fix
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.writer import RecordingWriter

Capture = pytest.CaptureFixture[str]


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def table(quantity: str, unit: str, axes: str, size: float) -> tuple[object, ...]:
    """Write 3 s of values of a size, labelled with a unit; return how they are imported."""
    t = np.arange(300) / 100
    wave = [size * (1 + 0.01 * np.sin(9 * t)), 0.01 * size * np.cos(7 * t), 0 * t][: len(axes) or 1]
    rows = "".join(
        f"{a:.2f},{','.join(f'{v:.9f}' for v in row)}\n" for a, *row in zip(t, *wave, strict=True)
    )
    names = [f"v{i}" for i in range(len(wave))]
    Path("t.csv").write_text(f"t,{','.join(names)}\n{rows}", "utf-8")
    columns = ", ".join(
        f'{{column = "{name}", quantity = "{quantity}", unit = "{unit}", axis = "{axis}"}}'
        for name, axis in zip(names, axes or [""], strict=True)
    )
    text = 'format = "csv"\ntime = {column = "t"}\n[[stream]]\ntopic = "/s"\n'
    Path("m.toml").write_text(f"{text}columns = [{columns}]\n", "utf-8")
    return ("import", "t.csv", "--map", "m.toml", "-o", "out.mcap")


def test_a_damaged_matlab_file_is_one_line_that_says_where(capsys: Capture) -> None:
    from scipy.io import savemat

    columns = '{column = "acc", quantity = "acceleration", unit = "m/s2", axis = "x"}'
    text = f'format = "mat"\nrate_hz = 100.0\n[[stream]]\ntopic = "/s"\ncolumns = [{columns}]\n'
    Path("m.toml").write_text(text, "utf-8")
    savemat("a.mat", {"acc": np.arange(50.0)}, do_compression=True)
    data = bytearray(Path("a.mat").read_bytes())
    data[150] ^= 0xFF
    Path("a.mat").write_bytes(data)
    error = run(capsys, "import", "a.mat", "--map", "m.toml", "-o", "out.mcap").error
    assert error.startswith("a.mat: byte ")
    assert "expected compressed data, found " in error
    assert not Path("out.mcap").exists()


def test_a_format_that_a_map_spells_wrong_is_told_in_the_map(capsys: Capture) -> None:
    arguments = table("acceleration", "m/s2", "xyz", 9.8)
    Path("m.toml").write_text(Path("m.toml").read_text("utf-8").replace('"csv"', '"cvs"'), "utf-8")
    error = run(capsys, *arguments).error
    assert error.startswith("m.toml: format: expected one of audio, csv")
    assert error.endswith("found 'cvs'; did you mean csv?")


UNITS = [
    ("angular_velocity", "rad/s", "xyz", 250.0, "was deg/s called rad/s?"),
    ("acceleration", "m/s2", "xyz", 1.0, "was g called m/s2?"),
    ("magnetic_field", "T", "xyz", 48.0, "was uT called T?"),
    ("pressure", "Pa", "", 1013.0, "was hPa called Pa?"),
]


@pytest.mark.parametrize(("quantity", "unit", "axes", "size", "fix"), UNITS)
def test_a_unit_that_cannot_be_true_is_a_warning_that_says_what_fits(
    quantity: str, unit: str, axes: str, size: float, fix: str, capsys: Capture
) -> None:
    arguments = table(quantity, unit, axes, size)
    (line,) = done(capsys, *arguments).err.splitlines()
    assert line.startswith(f"warning: /s: {quantity} in {unit}: ")
    assert line.endswith(fix)
    assert line.removeprefix("warning: ") in done(capsys, "info", "out.mcap").out
    assert run(capsys, *arguments, "--force", "--strict").error == line.replace(
        "warning: ", "--strict: "
    )


@pytest.mark.parametrize(("quantity", "unit", "axes", "size", "fix"), UNITS)
def test_the_fix_it_suggests_ends_the_warning(
    quantity: str, unit: str, axes: str, size: float, fix: str, capsys: Capture
) -> None:
    right = fix.split()[1]
    ran = done(capsys, *table(quantity, right, axes, size), "--strict")
    assert ran.err == ""


def test_strict_refuses_before_anything_is_written(capsys: Capture) -> None:
    arguments = table("acceleration", "m/s2", "xyz", 9.81)
    lines = Path("t.csv").read_text("utf-8").splitlines()
    Path("t.csv").write_text("\n".join([*lines[:50], lines[20], *lines[50:]]) + "\n", "utf-8")
    (warning,) = done(capsys, *arguments).err.splitlines()
    before = Path("out.mcap").read_bytes()
    said = run(capsys, *arguments, "--force", "--strict").error
    assert said == f"--strict: {warning.removeprefix('warning: ')}"
    assert Path("out.mcap").read_bytes() == before
    assert {p.name for p in Path().iterdir()} == {"t.csv", "m.toml", "out.mcap"}


def test_places_of_station_xml_are_where_the_map_is(capsys: Capture) -> None:
    obspy = pytest.importorskip("obspy", reason="ObsPy is not installed")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # ObsPy's own, of its imports
        obspy.read_inventory().select(network="BW").write("bw.xml", format="STATIONXML")
        obspy.read().write("a.mseed", format="MSEED")
    ran = done(capsys, "import", "a.mseed", "--stationxml", "bw.xml", "-o", "a.mcap")
    assert "places are metres east, north and up of 47.737167, 12.795714 at 860 m" in ran.out
    with Recording.open("a.mcap") as opened, RecordingWriter("placed.mcap") as writer:
        assert opened.geometry is not None
        writer.set_geometry(opened.geometry)
        writer.add_stream(opened.streams[0], "f64le")
        for _, block in opened.blocks():
            writer.write(block)
        # a thousandth of a degree of latitude, by the ellipsoid's meridian there
        place = Fix(opened.start_ns, 0.0, 111.18, (1.0, 0.0, 1.0), 0.0, "so-tdoa", 4, "places")
        writer.add_event(place)
    done(capsys, "export", "placed.mcap", "-o", "fix.geojson")
    (feature,) = json.loads(Path("fix.geojson").read_text("utf-8"))["features"]
    assert feature["geometry"]["coordinates"][:2] == pytest.approx([12.795714, 47.738167], abs=2e-6)
