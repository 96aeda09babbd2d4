"""``groundtrace analyze room``: what it prints, writes and refuses."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from command_runs import check_schema, done, run
from PIL import Image

from groundtrace_codecs.geometry import Geometry

QUICK = ("--lattice", 5, "--draws", 3)
CORNERS = ((0, 0), (6, 0), (6, 4), (0, 4), (2, 1))


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def write(sensors: int = 5, head: str = "outline = [[0, 0], [6, 0], [6, 4], [0, 4]]\n") -> Path:
    parts = [
        f'[[sensor]]\nname = "S{i}"\nchannel = "c{i}"\nx = {x}.0\ny = {y}.0\n'
        for i, (x, y) in enumerate(CORNERS[:sensors])
    ]
    path = Path("room.toml")
    path.write_text(head + "\n".join(parts), encoding="utf-8")
    return path


def test_the_document_is_as_its_schema_says_and_the_outputs_are_written(
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = write()
    ran = done(
        capsys, "analyze", "room", path, *QUICK, "--json", "--png", "a.png", "--rrd", "a.rrd"
    )
    check_schema("analyze", ran.document)
    assert [s["name"] for s in ran.document["sensors"]] == ["S0", "S1", "S2", "S3", "S4"]
    assert {a["change"] for a in ran.document["advice"]} == {"add", "move"}
    assert len(ran.document["x_m"]) == len(ran.document["errors"][0]["rmse_m"]) == 15
    assert "no theta_s in the medium: 1e-05 s assumed" in ran.document["remarks"]
    with Image.open("a.png") as picture:
        assert picture.width > 1500
    assert Path("a.rrd").read_bytes()[:3] == b"RRF"


def test_people_read_findings_and_what_each_sensor_contributes(
    capsys: pytest.CaptureFixture[str],
) -> None:
    ran = done(capsys, "analyze", "room", write(), *QUICK, "--theta-s", 1e-5, "--sigma-ms", 0.3)
    assert "arrivals ± 0.3 ms each, theta 1e-05 s" in ran.out
    assert "power law: mean" in ran.out
    assert "mean error without each sensor, rise [m]" in ran.out
    assert ran.err == ""


def test_three_sensors_without_an_outline_are_as_the_schema_says(
    capsys: pytest.CaptureFixture[str],
) -> None:
    ran = done(capsys, "analyze", "room", write(3, ""), *QUICK, "--json")
    check_schema("analyze", ran.document)
    assert all(s["contribution_m"] is None for s in ran.document["sensors"])
    assert "no outline: the sensors' rectangle" in ran.err


@pytest.mark.parametrize(
    ("sensors", "head", "said"),
    [
        (2, "", "room.toml: sensor: expected at least 3 at different places, found 2"),
        (5, 'unit = "ell"\n', "room.toml: unit: expected one of"),
        (5, 'unit = "unknown"\n', "room.toml: unit: expected a known unit of length"),
        (5, "outline = [[0, 0], [1, 1]]\n", "room.toml: outline: expected corners around an area"),
        (5, "medium = {theta_s = -1.0}\n", "room.toml: medium: theta_s: expected a positive"),
    ],
)
def test_bad_input_is_one_clear_line(
    sensors: int, head: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(capsys, "analyze", "room", write(sensors, head)).error.startswith(said)


def test_files_that_are_there_are_kept(capsys: pytest.CaptureFixture[str]) -> None:
    path = write()
    Path("a.png").write_text("mine")
    assert "expected a new file" in run(capsys, "analyze", "room", path, "--png", "a.png").error
    assert run(capsys, "analyze", "room", "none.toml").error == (
        "none.toml: expected a geometry, found no such file"
    )
    assert Geometry.from_toml(path).sensors


def test_the_command_line_starts_without_matplotlib() -> None:
    code = (
        "import sys; from groundtrace.cli.main import main\n"
        "try: main(['analyze', 'room', '--help'])\nexcept SystemExit: pass\n"
        "print('matplotlib' in sys.modules, 'rerun' in sys.modules)"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout.splitlines()[-1] == "False False"


def test_the_layout_of_a_recording_is_taken_from_it(capsys: pytest.CaptureFixture[str]) -> None:
    ran = done(capsys, "analyze", "room", "room-walk", *QUICK)
    assert "room-walk: 9 sensors" in ran.out
    ran = run(capsys, "analyze", "room", "lower-back", *QUICK)
    assert ran.code == 1
    assert "lower-back: expected a recording with a geometry, found none" in ran.err
