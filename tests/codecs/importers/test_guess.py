"""Guessed maps of text tables."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sweeps import examples

from groundtrace_codecs.errors import CodecError, FormatError
from groundtrace_codecs.importers.guess import Guess, guess_map
from groundtrace_codecs.importers.map import load_map
from groundtrace_codecs.importers.tables import DelimitedImporter

if TYPE_CHECKING:
    from pathlib import Path

    from groundtrace_codecs.importers.base import ColumnMap, Imported, ImportMap

G0 = 9.80665


def table(header: str, delimiter: str = ",", count: int = 200, gravity: float = 9.8) -> str:
    """Return rows for a header: a time in units of 10 ms, then what its words ask for."""
    random = np.random.default_rng(3)
    names = header.split(delimiter)
    lines = [header]
    for k in range(count):
        cells = []
        for name in names:
            low = name.lower()
            noise = float(random.normal(0, 0.02))
            if "time" in low or low == "t":
                cells.append(f"{k * 10}")
            elif low[-1:] == "z" or "z " in low or "_z" in low:
                cells.append(f"{gravity * (1 + noise):.5f}")
            else:
                cells.append(f"{noise:.5f}")
        lines.append(delimiter.join(cells))
    return "\n".join(lines) + "\n"


def guessed(folder: Path, text: str, name: str = "t.csv") -> tuple[Guess, ImportMap, Imported]:
    (folder / name).write_text(text, encoding="utf-8")
    found = guess_map(folder / name)
    (folder / "t.toml").write_text(found.toml, encoding="utf-8")
    map_ = load_map(folder / "t.toml")
    return found, map_, DelimitedImporter().read([folder / name], map_)


def columns(map_: ImportMap) -> dict[str, list[ColumnMap]]:
    return {s.topic: list(s.columns) for s in map_.stream}


@pytest.mark.parametrize(
    "names",
    [
        "ax,ay,az",
        "AccX,AccY,AccZ",
        "acc_x,acc_y,acc_z",
        "Accelerometer X,Accelerometer Y,Accelerometer Z",
    ],
)
@pytest.mark.parametrize(("gravity", "unit"), [(9.8, "m/s2"), (1.0, "g"), (1000.0, "mg")])
def test_accelerations_are_known_by_words_and_their_unit_by_gravity(
    tmp_path: Path, names: str, gravity: float, unit: str
) -> None:
    found, map_, imported = guessed(tmp_path, table(f"time_ms,{names}", gravity=gravity))
    assert [c.unit for c in columns(map_)["/acc"]] == [unit] * 3
    assert [c.axis for c in columns(map_)["/acc"]] == ["x", "y", "z"]
    ((stream, _, blocks),) = imported.sources
    assert stream.rate_hz == 100.0
    assert np.median(next(iter(blocks)).values[:, 2]) == pytest.approx(G0, rel=0.03)
    assert {r.about: r.sureness for r in found.remarks}["/acc"] == "likely"


def test_units_in_the_header_are_taken_at_their_word(tmp_path: Path) -> None:
    head = "time (s);Acc_X [g];Acc_Y [g];Acc_Z [g];Gyr_X [dps];Gyr_Y [dps];Gyr_Z [dps]"
    found, map_, _ = guessed(tmp_path, table(head, ";"))
    assert [c.unit for c in columns(map_)["/imu"]] == ["g"] * 3 + ["deg/s"] * 3
    assert {r.about: r.sureness for r in found.remarks}["/imu"] == "sure"
    assert (map_.delimiter, map_.time and map_.time.unit) == (";", "s")


def test_several_sensors_get_topics_of_their_own(tmp_path: Path) -> None:
    sides = [f"{side}_acc_{a}" for side in ("left", "right") for a in "xyz"]
    _, map_, _ = guessed(tmp_path, table(",".join(["time", *sides])))
    assert sorted(columns(map_)) == ["/acc/left", "/acc/right"]


@pytest.mark.parametrize(
    ("first", "step", "unit"),
    [
        (1_714_521_600.0, 0.01, "s"),
        (1_714_521_600_000, 10, "ms"),
        (1_714_521_600_000_000, 10_000, "us"),
        (1_714_521_600_000_000_000, 10_000_000, "ns"),
        (0, 0.01, "s"),
        (0, 10, "ms"),
        (0, 10_000, "us"),
        (0, 10_000_000, "ns"),
    ],
)
def test_the_unit_of_times_is_known_by_their_size_or_step(
    tmp_path: Path, first: float, step: float, unit: str
) -> None:
    rows = [f"{first + k * step},0,0,9.8" for k in range(100)]
    found, map_, _ = guessed(tmp_path, "\n".join(["when,ax,ay,az", *rows]))
    assert map_.time is not None
    assert (map_.time.column, map_.time.unit) == ("when", unit)
    sureness = {r.about: r.sureness for r in found.remarks}["time"]
    assert sureness == ("likely" if first else "unsure")


def test_iso_times_decimal_commas_and_preambles_are_seen(tmp_path: Path) -> None:
    rows = [f"2024-05-01T12:00:{k / 10:09.6f};0,5;0,1;9,8" for k in range(50)]
    text = "\n".join(["Made by hand", "Device;7", "", "Zeit;ax;ay;az", *rows])
    _, map_, imported = guessed(tmp_path, text)
    assert (map_.delimiter, map_.decimal, map_.skip_rows) == (";", ",", 3)
    assert map_.time is not None
    assert map_.time.unit == "iso"
    assert imported.start_ns == 1_714_564_800_000_000_000
    assert imported.sources[0][0].rate_hz == pytest.approx(10.0)


def test_without_a_time_the_rate_is_a_placeholder_and_said_so(tmp_path: Path) -> None:
    found, map_, _ = guessed(tmp_path, table("ax,ay,az"))
    assert (map_.time, map_.rate_hz) == (None, 100.0)
    assert found.remarks[1].sureness == "unsure"


def test_without_a_header_three_columns_as_long_as_gravity_are_found(tmp_path: Path) -> None:
    text = table("time,a,b,z").partition("\n")[2]
    found, map_, _ = guessed(tmp_path, text)
    assert [c.column for c in columns(map_)["/acc"]] == [1, 2, 3]
    assert {r.about: r.sureness for r in found.remarks}["/acc"] == "unsure"


def test_numbers_nothing_is_known_of_are_counts(tmp_path: Path) -> None:
    rows = [
        f"{k / 1000:.3f}\t{(k * 7919) % 401 - 200}\t{(k * 104729) % 301 - 150}" for k in range(99)
    ]
    _, map_, _ = guessed(tmp_path, "\n".join(["t\tch1\tch2", *rows]), "t.tsv")
    assert [(c.quantity, c.unit) for c in columns(map_)["/seismic"]] == [("seismic", "count")] * 2


def test_degrees_are_guessed_where_radians_would_be_too_fast(tmp_path: Path) -> None:
    rows = [f"{k * 10},{300 * np.sin(k / 9):.3f},0,0" for k in range(200)]
    _, map_, _ = guessed(tmp_path, "\n".join(["time_ms,gx,gy,gz", *rows]))
    assert [c.unit for c in columns(map_)["/gyro"]] == ["deg/s"] * 3


@pytest.mark.parametrize("text", ["", "a,b\nc,d\n", "\0\0\0", "1\n2\n"])
def test_what_is_no_table_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(FormatError, match=r"^t\.csv: expected rows of numbers"):
        guess_map(tmp_path / "t.csv")


def test_the_command_writes_the_map_beside_the_table_and_imports_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from groundtrace.cli.main import main

    path = tmp_path / "t.csv"
    path.write_text(table("time_ms,ax,ay,az"))
    main(["import", str(path), "--guess"])
    said = capsys.readouterr().out
    assert "time: time_ms in ms, 100 Hz (sure: the header says ms)" in said
    assert sorted(p.name for p in tmp_path.iterdir()) == ["t.csv", "t.csv.map.toml"]


_TEXT = st.text('0123456789.,;\t\n -+eEabxyz"#_', max_size=150).map(str.encode)


@settings(max_examples=examples(200), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.sampled_from([b"", b"t,ax,ay,az\n0,1,2,3\n1,2,3,4\n2,3,4,5\n"]),
    st.binary(max_size=80) | _TEXT,
)
def test_any_bytes_give_a_map_that_loads_or_the_importers_own_error(
    tmp_path: Path, head: bytes, body: bytes
) -> None:
    (tmp_path / "t.csv").write_bytes(head + body)
    try:
        found = guess_map(tmp_path / "t.csv")
    except CodecError as error:
        assert "\n" not in str(error)  # noqa: PT017 (either outcome is right)
        return
    (tmp_path / "t.toml").write_text(found.toml, encoding="utf-8")
    load_map(tmp_path / "t.toml")


def test_a_flag_beside_the_axes_is_no_axis_and_rows_may_end_in_a_separator(
    tmp_path: Path,
) -> None:
    random = np.random.default_rng(1)
    rows = [
        f"{k * 5_000_000},3,{a:.5f},{b:.5f},{9.7 + c:.5f}"
        for k, (a, b, c) in enumerate(random.normal(0, 0.3, (200, 3)))
    ]
    _, map_, _ = guessed(tmp_path, "\n".join(rows) + "\n")
    assert [c.column for c in columns(map_)["/acc"]] == [2, 3, 4]
    lines = table("t\tax\tay\taz", "\t").splitlines()
    ended = "\n".join([lines[0], *(line + "\t" for line in lines[1:])]) + "\n"
    _, map_, _ = guessed(tmp_path, ended)
    assert [c.column for c in columns(map_)["/acc"]] == ["ax", "ay", "az"]


def test_a_magnitude_is_one_column(tmp_path: Path) -> None:
    rows = "".join(f"{k * 0.04:.2f},{18_000 + k % 900},99\n" for k in range(200))
    _, map_, _ = guessed(tmp_path, f"Timestamp,Magnitude,Steps\n{rows}")
    (column,) = columns(map_)["/acc_magnitude"]
    assert (column.quantity, column.unit) == ("acceleration_magnitude", "count")


def test_a_file_that_says_itself_what_it_holds_needs_no_map(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from groundtrace.cli.main import main

    path = tmp_path / "a.txt"
    path.write_text("// Update Rate: 100.0Hz\nPacketCounter\tAcc_X\tAcc_Y\tAcc_Z\n1\t0\t0\t9.8\n")
    with pytest.raises(SystemExit):
        main(["import", str(path), "--guess"])
    assert "found one that the importer xsens reads by itself" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def test_a_name_with_line_breaks_is_told_in_one_line(tmp_path: Path) -> None:
    text = table('time (ms),"acc\nx",acc y,acc z').replace("0.0", "0.0.", 1)
    (tmp_path / "t.csv").write_text(text, encoding="utf-8")
    with pytest.raises(CodecError) as caught:
        guessed(tmp_path, text)
    assert "acc x: expected a number" in str(caught.value)
    assert "\n" not in str(caught.value)
