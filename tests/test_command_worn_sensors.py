"""Worn sensors that contradict themselves, by the commands: import, info and replay tell."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from command_runs import check_schema, done
from turning_sensors import RATE_HZ, turning_sensor

from groundtrace.commands import main
from groundtrace.results import read_results
from groundtrace_codecs.events import Note
from groundtrace_recordings import map_path

if TYPE_CHECKING:
    from pathlib import Path

MENDED = (
    'in the map, angular_velocity: axis = "x" becomes axis = "y"; axis = "y" becomes axis = "x"'
)


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def table(tmp_path: Path) -> Path:
    """Return a table of a sensor in order; :func:`map_of` says what its columns are."""
    samples = turning_sensor()
    time_s = np.arange(len(samples)) / RATE_HZ
    header = "t,gx,gy,gz,ax,ay,az,mx,my,mz"
    path = tmp_path / "walk.csv"
    np.savetxt(path, np.column_stack([time_s, samples]), "%.7g", ",", header=header, comments="")
    return path


def map_of(gyroscope: str, path: Path) -> Path:
    """Write a map whose gyroscope has its axes in this order."""
    columns = [
        *(
            (f"g{c}", "angular_velocity", axis, "rad/s")
            for c, axis in zip("xyz", gyroscope, strict=True)
        ),
        *((f"a{c}", "acceleration", c, "m/s2") for c in "xyz"),
        *((f"m{c}", "magnetic_field", c, "T") for c in "xyz"),
    ]
    lines = [
        f'  {{column = "{c}", quantity = "{q}", axis = "{a}", unit = "{u}"}},'
        for c, q, a, u in columns
    ]
    text = ['format = "csv"', 'time = {column = "t", unit = "s"}', "[[stream]]", 'topic = "/imu"']
    path.write_text("\n".join([*text, 'placement = "waist"', "columns = [", *lines, "]"]))
    return path


def test_exchanged_axes_are_told_by_import_info_and_replay(
    table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    swapped = map_of("yxz", tmp_path / "swapped.toml")
    document = done(capsys, "import", table, "--map", swapped, "-o", "w.mcap", "--json").document
    check_schema("import", document)
    (warning,) = document["warnings"]
    assert MENDED in warning
    document = done(capsys, "info", "w.mcap", "--json").document
    check_schema("info", document)
    (fault,) = document["faults"]
    assert (fault["kind"], fault["channel"]) == ("axes", "angular_velocity")
    assert fault["remedy"] == MENDED
    assert document["axes"][0]["text"].startswith("contradicted")
    done(capsys, "replay", "w.mcap", "--pipeline", "heading", "--no-viewer", "--out", "r.mcap")
    events = read_results(tmp_path / "r.mcap").events
    notes = [x for x in events if isinstance(x, Note) and x.source == "health"]
    assert [note.level for note in notes] == ["WARN"]
    assert MENDED in notes[0].text


def test_the_map_that_is_named_mends_it(
    table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    right = map_of("xyz", tmp_path / "right.toml")
    document = done(capsys, "import", table, "--map", right, "-o", "w.mcap", "--json").document
    assert document["warnings"] == []
    main(["info", "w.mcap"])
    said = capsys.readouterr().out
    assert (
        "axes: /imu against acceleration: the axes fit: 47 of 47 other axis maps fit worse" in said
    )
    assert "fault:" not in said


def test_a_strict_import_stops_at_axes_that_contradict_each_other(
    table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    swapped = map_of("yxz", tmp_path / "swapped.toml")
    with pytest.raises(SystemExit):
        main(["import", str(table), "--map", str(swapped), "-o", "w.mcap", "--strict"])
    assert "--strict: /imu angular_velocity: axes or signs contradict" in capsys.readouterr().err
    assert not (tmp_path / "w.mcap").exists()


def test_a_real_walk_is_in_order_and_told_where_its_map_exchanges_two_axes(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = data / "mobgap" / "HA" / "001" / "data.mat"
    shipped = map_path("mobgap-test11.toml").read_text()
    for name, gyroscope in (("right", "xyz"), ("wrong", "zyx")):
        text = shipped
        for place, axis in enumerate(gyroscope):
            column = f'LowerBack.Gyr[:,{place}]", quantity = "angular_velocity", axis = '
            text = text.replace(f'{column}"{"xyz"[place]}"', f'{column}"{axis}"')
        (tmp_path / f"{name}.toml").write_text(text)
        done(capsys, "import", source, "--map", f"{name}.toml", "-o", f"{name}.mcap", "--json")
    assert done(capsys, "info", "right.mcap", "--json").document["faults"] == []
    (fault,) = done(capsys, "info", "wrong.mcap", "--json").document["faults"]
    assert fault["remedy"] == (
        'in the map, angular_velocity: axis = "x" becomes axis = "z"; axis = "z" becomes axis = "x"'
    )


def test_a_real_gyroscope_at_its_limit_of_500_deg_per_s_is_told(
    data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = data / "llio-pyshoe" / "2017-12-15-18-03-05_LLIO.mat"
    map_ = map_path("llio-pyshoe.toml")
    done(capsys, "import", source, "--map", map_, "-o", "foot.mcap", "--json")
    faults = done(capsys, "info", "foot.mcap", "--json").document["faults"]
    assert {(f["kind"], f["channel"]) for f in faults} == {("clipped", "angular_velocity_y")}
    assert "near the full scale of 500 deg/s" in faults[0]["what"]
