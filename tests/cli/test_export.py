"""``groundtrace export``: what is written reads back as what was decided."""

from __future__ import annotations

import csv
import shutil
import sys
from dataclasses import fields
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from command_runs import check_schema, done, run
from exported_sessions import of_kind, room_and_walk

from groundtrace.errors import PluginError
from groundtrace.export.base import exporters, tables_of_events
from groundtrace.pipeline.plugins import load, plugins
from groundtrace.pipeline.results import read_results
from groundtrace_codecs.events import CandidateBlock

if TYPE_CHECKING:
    from collections.abc import Iterator


Capture = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def replayed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return room_and_walk(tmp_path_factory.mktemp("exports"))


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(
    replayed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(replayed, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def event_of(kind: type, row: dict[str, str], start_ns: int) -> object:
    """Return the event that a row of a table says."""
    found: dict[str, Any] = {}
    for field in fields(kind):
        if field.name == "covariance":
            names = ("covariance_xx_m2", "covariance_xy_m2", "covariance_yy_m2")
            found[field.name] = tuple(float(row[n] or "nan") for n in names)
        elif field.name == "time_ns":
            found[field.name] = start_ns + int(Decimal(row["time_s"]) * 1_000_000_000)
            assert found[field.name] == int(row["time_ns"])
        elif field.type == "float":
            found[field.name] = float(row[field.name] or "nan")
        elif field.type == "bool":
            found[field.name] = row[field.name] == "true"
        else:
            found[field.name] = int(row[field.name]) if field.type == "int" else row[field.name]
    return kind(**found)


@pytest.mark.parametrize("name", ["room", "walk"])
def test_a_folder_of_csv_reads_back_as_the_events(name: str, capsys: Capture) -> None:
    ran = done(capsys, "export", f"{name}.results.mcap", "-o", "tables", "--json")
    check_schema("export", ran.document)
    results = read_results(Path(f"{name}.results.mcap"))
    expected = {"steps", "tracks", *({"picks", "fixes"} if name == "room" else {"headings"})}
    assert expected <= ran.document["counts"].keys()
    for kind in expected:
        rows = rows_of(Path("tables", f"{kind}.csv"))
        read = [
            event_of(tables_of_events()[kind], row, results.provenance.start_ns) for row in rows
        ]
        # repr: NaN equals itself there
        assert list(map(repr, read)) == list(map(repr, of_kind(results, kind)))
    assert rows_of(Path("tables", "steps.csv"))[0]["time_utc"].startswith("2026-01-05T09:00:0")


def test_candidates_keep_values_gates_and_verdicts(capsys: Capture) -> None:
    done(capsys, "export", "room.results.mcap", "-o", "c", "--kind", "candidates")
    events = read_results(Path("room.results.mcap")).events
    blocks = [e for e in events if isinstance(e, CandidateBlock) and e.spec.stage == "picks"]
    rows = rows_of(Path("c", "candidates-picks-seismic.csv"))
    assert [int(r["time_ns"]) for r in rows] == [int(t) for b in blocks for t in b.time_ns]
    assert [r["accepted"] == "true" for r in rows] == [bool(x) for b in blocks for x in b.accepted]
    gate = blocks[0].spec.gates[0].name
    margins = np.array([r[f"margin_{gate}"] for r in rows], np.float32)
    np.testing.assert_array_equal(margins, np.concatenate([b.margin[:, 0] for b in blocks]))


def test_parquet_holds_what_csv_holds(capsys: Capture) -> None:
    from pyarrow import parquet

    done(capsys, "export", "room.results.mcap", "-o", "csv")
    done(capsys, "export", "room.results.mcap", "-o", "pq", "--format", "parquet")
    names = {p.stem for p in Path("csv").iterdir()}
    assert names == {p.stem for p in Path("pq").iterdir()}
    assert {"picks", "fixes", "candidates-picks-seismic"} < names
    table = parquet.read_table("pq/fixes.parquet")
    rows = rows_of(Path("csv/fixes.csv"))
    assert table.column_names == list(rows[0])
    assert str(table.schema.field("time_utc").type) == "timestamp[ns, tz=UTC]"
    assert table["time_utc"].cast("int64").to_pylist() == [int(r["time_ns"]) for r in rows]
    assert table["x_m"].to_pylist() == [float(r["x_m"]) for r in rows]


def test_exported_truth_is_truth_again(capsys: Capture) -> None:
    done(capsys, "export", "room.results.mcap", "-o", "t.csv", "--kind", "truth")
    own = done(capsys, "score", "room.results.mcap", "--json").document
    again = done(capsys, "score", "room.results.mcap", "--truth", "t.csv", "--json").document
    assert again == own


def test_signals_in_csv_are_the_values_in_their_units(capsys: Capture) -> None:
    from groundtrace_codecs.recording import Recording

    done(capsys, "export", "walk.mcap", "-o", "s", "--kind", "signals")
    rows = rows_of(Path("s/signals-imu-waist.csv"))
    with Recording.open("walk.mcap") as recording:
        blocks = [b for _, b in recording.blocks(["/imu/waist"])]
    values = np.concatenate([b.values for b in blocks])
    found = np.array([[float(r[n]) for n in list(r)[3:]] for r in rows])
    np.testing.assert_array_equal(found, values)
    assert list(rows[0])[3] == "acc_x_m_per_s2"


def test_audacity_labels_are_start_end_text(capsys: Capture) -> None:
    done(capsys, "export", "room.results.mcap", "-o", "l.txt", "--kind", "steps", "truth")
    lines = [line.split("\t") for line in Path("l.txt").read_text("utf-8").splitlines()]
    results = read_results(Path("room.results.mcap"))
    assert len(lines) == len(of_kind(results, "steps")) + len(results.labels)
    assert all(len(cells) == 3 and float(cells[0]) <= float(cells[1]) for cells in lines)
    begun = [float(cells[0]) for cells in lines]
    assert begun == sorted(begun)


def test_misses_are_exported_with_their_causes(capsys: Capture) -> None:
    options = ("--set", "steps.height=3.5", "--pipeline", "waist-peaks", "--no-viewer")
    done(capsys, "replay", "walk.mcap", *options, "--out", "hard.results.mcap")
    done(capsys, "export", "hard.results.mcap", "-o", "m.csv", "--kind", "misses")
    told = done(capsys, "why", "hard.results.mcap", "--json").document
    rows = rows_of(Path("m.csv"))
    missed = [r for r in rows if r["verdict"] == "missed"]
    assert [float(r["time_s"]) for r in missed] == [m["time_s"] for m in told["missed"]] != []
    assert [r["cause"] for r in missed] == [m["reason"]["cause"] for m in told["missed"]]


REFUSALS = {
    ("room.results.mcap", "-o", "x.foo"): "expected a name that ends in one of .txt, .csv, ",
    ("room.results.mcap", "-o", "x.csv", "--format", "xls"): "--format: expected one of audacity, ",
    ("room.results.mcap", "-o", "x.csv"): "--kind: expected one of steps, picks, ",
    ("room.results.mcap", "-o", "x.csv", "--kind", "walks"): "--kind: csv: expected one of steps, ",
    ("room.results.mcap", "-o", "x.gpx"): "expected a geographic reference: satellite fixes ",
    ("room.results.mcap", "-o", "x.gpx", "--origin", "north"): "--origin: expected LATITUDE,",
    ("room.results.mcap", "-o", "x.csv", "--stage", "no"): "--stage: expected one of picks, ",
    ("walk.results.mcap", "-o", "x.qml"): "quakeml: expected something of picks, found steps, ",
    ("nowhere.mcap", "-o", "x.csv"): "nowhere.mcap: expected a recording, found no ",
    ("walk.mcap", "-o", "x.csv", "--kind", "signals"): "signals: expected one table for one file",
    ("walk.mcap", "-o", "x.csv", "--kind", "misses"): "misses: expected results with true steps",
    ("walk.mcap", "-o", "walk.mcap", "--format", "miniseed", "--force"): "found the one that is ",
}


@pytest.mark.parametrize("arguments", REFUSALS)
def test_what_cannot_be_is_said_in_one_line_and_leaves_nothing(
    arguments: tuple[str, ...], capsys: Capture
) -> None:
    before = {p.name: p.read_bytes() for p in Path().iterdir()}
    assert REFUSALS[arguments] in run(capsys, "export", *arguments).error
    assert {p.name: p.read_bytes() for p in Path().iterdir()} == before


def test_outputs_are_replaced_only_with_force_and_folders_only_of_tables(capsys: Capture) -> None:
    command = ("export", "room.results.mcap", "-o")
    done(capsys, *command, "tables")
    assert "see --force" in run(capsys, *command, "tables").error
    done(capsys, *command, "tables", "--kind", "steps", "--force")
    assert [p.name for p in Path("tables").iterdir()] == ["steps.csv"]
    Path("tables/mine.doc").write_text("mine")
    found = run(capsys, *command, "tables", "--force").error
    assert found.endswith("found mine.doc in it: it stays")
    assert Path("tables/mine.doc").read_text() == "mine"


def test_without_obspy_the_command_that_installs_it_is_named(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "obspy.core", None)
    found = run(capsys, "export", "room.results.mcap", "-o", "p.qml").error
    assert "expected the package obspy, found none" in found
    assert found.endswith("install it with: pip install 'groundtrace[seismic]'")


def descriptions() -> Iterator[tuple[str, str]]:
    for name, exporter in exporters()[0].items():
        yield name, exporter.description


def test_every_registered_exporter_loads_and_says_what_it_is() -> None:
    assert dict(descriptions()).keys() == {p.name for p in plugins("exporters")}
    assert all(text for _, text in descriptions())


def test_an_exporter_that_does_not_load_is_told_of_and_left_out(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(group: str, name: str) -> Any:
        if name == "gpx":
            raise PluginError("exporters: gpx: expected it to import, found: broken")
        return load(group, name)

    monkeypatch.setattr("groundtrace.export.base.load", broken)
    ran = done(capsys, "export", "room.results.mcap", "-o", "s.csv", "--kind", "steps")
    assert ran.err == "warning: exporters: gpx: expected it to import, found: broken\n"
