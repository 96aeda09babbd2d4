"""Worn sensors that contradict themselves, by the commands: import, info and replay tell."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from command_runs import check_schema, done
from pyarrow.parquet import read_table
from sweeps import swept
from turning_sensors import RATE_HZ, turning_sensor

from groundtrace.cli.main import main
from groundtrace.pipeline.results import read_results
from groundtrace_codecs.events import Note
from groundtrace_recordings import map_path

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    #: What is wrong, done to samples of gyroscope, acceleration and field, shape (n, 9).
    Change = Callable[[np.ndarray], None]

MENDED = (
    'in the map, angular_velocity: axis = "x" becomes axis = "y"; axis = "y" becomes axis = "x"'
)


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def table(tmp_path: Path) -> Path:
    """Return a table of a sensor in order; :func:`map_of` says what its columns are."""
    return written(turning_sensor(), tmp_path)


def written(samples: np.ndarray, tmp_path: Path) -> Path:
    """Write a table of gyroscope, acceleration and field, shape (n, 9)."""
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


GYRO, FORCE, FIELD = (slice(k, k + 3) for k in (0, 3, 6))


def scaled(columns: slice, by: object) -> Change:
    def change(samples: np.ndarray) -> None:
        samples[:, columns] = samples[:, columns] @ np.diag(np.broadcast_to(by, 3))

    return change


def exchanged(columns: slice) -> Change:
    def change(samples: np.ndarray) -> None:
        samples[:, columns] = samples[:, columns][:, [1, 0, 2]]

    return change


def at_rails(samples: np.ndarray) -> None:
    """Shake it into the rails of an amplifier, which differ by side and wander."""
    random = np.random.default_rng(2)
    time_s = np.arange(len(samples)) / RATE_HZ
    heights = np.repeat(random.uniform(10, 25, len(samples) // 200 + 1), 200)[: len(samples)]
    wander = np.repeat(random.uniform(0.98, 1.02, len(samples) // 50 + 1), 50)[: len(samples)]
    shaken = samples[:, 3] + heights * np.sin(2 * np.pi * 1.5 * time_s) * (time_s % 2 < 0.67)
    noise = random.normal(0, 0.01, len(samples))
    samples[:, 3] = np.clip(shaken, -12 * wander + noise, 15 * wander + noise)


def at_500_deg_per_s(samples: np.ndarray) -> None:
    """Swing it so fast that its gyroscope comes to its limit of 500 deg/s now and then."""
    time_s = np.arange(len(samples)) / RATE_HZ
    swing = 12 * np.sin(2 * np.pi * 2.5 * time_s) * (time_s % 4 < 0.8)
    limit = np.radians(500)
    samples[:, 1] = 1.01 * np.clip(samples[:, 1] + swing, -limit, limit) + 0.03


WRONG: dict[str, tuple[Change, str]] = {
    "axes of the gyroscope": (exchanged(GYRO), "/imu angular_velocity: axes or signs contradict"),
    "sign of the gyroscope": (scaled(GYRO, -1), "each axis gets scale = -1"),
    "sign of an axis": (scaled(GYRO, [1, -1, 1]), 'angular_velocity: axis = "y" gets scale = -1'),
    "axes of the acceleration": (exchanged(FORCE), "/imu acceleration: axes or signs contradict"),
    "field in other axes": (exchanged(FIELD), "/imu magnetic_field: axes or signs contradict"),
    "field zero": (scaled(FIELD, 0), "/imu magnetic_field: zero in all of 10000 samples"),
    "deg/s called rad/s": (scaled(GYRO, np.degrees(1)), "rad/s"),
    "rad/s called deg/s": (scaled(GYRO, np.radians(1)), 'unit = "rad/s" where it is "deg/s"'),
    "g called m/s2": (scaled(FORCE, 1 / 9.80665), "was g called m/s2?"),
    "accelerometer at rails": (at_rails, "/imu ax: clipped at about"),
    "gyroscope at its limit": (at_500_deg_per_s, "near the full scale of 500 deg/s"),
}


@pytest.mark.parametrize(
    "wrong", swept(WRONG, "axes of the gyroscope", "deg/s called rad/s", "accelerometer at rails")
)
def test_what_is_wrong_is_one_line_of_import_info_and_replay(
    wrong: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    change, said = WRONG[wrong]
    samples = turning_sensor(100.0)
    change(samples)
    table, right = written(samples, tmp_path), map_of("xyz", tmp_path / "right.toml")
    document = done(capsys, "import", table, "--map", right, "-o", "w.mcap", "--json").document
    (warning,) = document["warnings"]
    assert said in warning
    document = done(capsys, "info", "w.mcap", "--json").document
    told = [f"{f['topic']} {f['channel']}: {f['what']}; {f['remedy']}" for f in document["faults"]]
    (fault,) = [*told, *document["unit_warnings"]]
    assert said in fault
    ran = done(capsys, "replay", "w.mcap", "--pipeline", "heading", "--no-viewer", "--json")
    (text,) = [x["text"] for x in ran.document["warnings"] if x["source"] == "health"]
    assert text == warning


@pytest.mark.sweep
def test_score_why_share_and_fleets_carry_it_in_their_heads(
    table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    swapped = map_of("yxz", tmp_path / "swapped.toml")
    done(capsys, "import", table, "--map", swapped, "-o", "w.mcap", "--json")
    done(capsys, "replay", "w.mcap", "--pipeline", "waist-steps", "--no-viewer", "--json")
    (tmp_path / "truth.csv").write_text("time_s,kind\n10,step\n11,step\n")
    for command in ("score", "why"):
        ran = done(capsys, command, "w.results.mcap", "--truth", "truth.csv")
        (first, *_) = (ran.err + ran.out).splitlines()
        assert first.startswith("warning: /imu angular_velocity: axes or signs contradict")
        assert first.endswith(MENDED)
    assert "axes or signs contradict" in done(capsys, "share", "w.results.mcap", "-o", "s").out
    assert "axes or signs contradict" in (tmp_path / "s" / "summary.html").read_text("utf-8")
    done(capsys, "fleet", "w.mcap", "--pipeline", "waist-steps", "-o", "f.parquet")
    (warned,) = read_table("f.parquet", columns=["warnings"])["warnings"].to_pylist()
    assert "axes or signs contradict" in warned
    done(capsys, "fleet-report", "f.parquet", "-o", "f.html")
    assert "axes or signs contradict" in (tmp_path / "f.html").read_text("utf-8")


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


def test_a_real_foot_that_spins_is_not_told_to_have_another_unit(
    data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source, map_ = (
        data / "llio-pyshoe" / "SensorConnectData_42_LLIO.mat",
        map_path("llio-pyshoe.toml"),
    )
    ran = done(capsys, "import", source, "--map", map_, "-o", "foot.mcap", "--json")
    assert ran.document["warnings"] == []
