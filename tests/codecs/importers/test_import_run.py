"""Whole imports: choosing the importer, adding geometry and truth, writing the recording."""

from __future__ import annotations

import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from seg2_files import write_shot

from groundtrace_codecs.errors import CodecError, FormatError, SchemaError
from groundtrace_codecs.importers import run
from groundtrace_codecs.importers.run import choose, import_recording, importers
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.truth import read_truth

if TYPE_CHECKING:
    from collections.abc import Iterable

ROOT = Path(__file__).parents[3]
MAPS = ROOT / "recordings" / "groundtrace_recordings" / "maps"
REFRAPY = "refrapy-seg2/field_example_0"
MAP = """
format = "csv"
time = {column = "t"}
start = 1700000000.5
[[stream]]
topic = "/seismic"
columns = [
  {column = "G1", quantity = "ground_velocity", axis = "z", unit = "mm/s"},
  {column = "G2", quantity = "ground_velocity", axis = "z", unit = "mm/s"},
]
"""
GEOMETRY = """
unit = "m"
[[sensor]]
name = "left"
channel = "G1"
x = 1.0
y = 2.0
[[sensor]]
name = "right"
channel = "G2"
x = 3.0
y = 2.0
"""


@pytest.fixture(autouse=True)
def _declared_importers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take the importers pyproject.toml declares, installed or not."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    declared = project["entry-points"][run.GROUP]
    points = [EntryPoint(name, value, run.GROUP) for name, value in declared.items()]
    monkeypatch.setattr(run, "entry_points", lambda **_: points)


@pytest.fixture
def table(tmp_path: Path) -> Path:
    path = tmp_path / "table.csv"
    rows = "".join(f"{i / 100},{i % 7},{-(i % 5)}\n" for i in range(500))
    path.write_text("t,G1,G2\n" + rows)
    (tmp_path / "map.toml").write_text(MAP)
    (tmp_path / "site.toml").write_text(GEOMETRY)
    (tmp_path / "truth.csv").write_text("time_s,kind,x_m,y_m\n1.25,impact,2,2\n")
    return path


def total(recording: Recording, topics: Iterable[str] | None = None) -> int:
    chosen = None if topics is None else set(topics)
    return sum(len(found.block) for found in recording.blocks(chosen))


def test_a_table_becomes_a_recording_with_geometry_and_truth(table: Path) -> None:
    folder = table.parent
    report = import_recording(
        [table],
        folder / "out.mcap",
        map_path=folder / "map.toml",
        geometry=folder / "site.toml",
        truth=folder / "truth.csv",
    )
    assert report.importer == "csv"
    assert report.samples == {"/seismic": 500}
    assert (report.duration_s, report.sensors, report.labels) == (4.99, 2, {"impact": 1})
    with Recording.open(folder / "out.mcap") as recording:
        (stream,) = recording.streams
        assert recording.start_ns == report.start_ns == 1_700_000_000_500_000_000
        assert [c.position_m for c in stream.channels] == [(1.0, 2.0, 0.0), (3.0, 2.0, 0.0)]
        assert recording.labels[0].time_ns == report.start_ns + 1_250_000_000
        values = np.concatenate([found.block.values for found in recording.blocks()])
    np.testing.assert_allclose(values[:, 0], np.arange(500) % 7 * 1e-3)


def test_a_recordings_labels_are_truth_for_another(table: Path) -> None:
    folder = table.parent
    out = folder / "out.mcap"
    import_recording([table], out, map_path=folder / "map.toml", truth=folder / "truth.csv")
    labels = read_truth(out, start_ns=0, geometry=None, labels=())
    assert [x.kind for x in labels] == ["impact"]


def test_the_map_names_the_importer_and_a_wrong_suffix_does_not_matter(table: Path) -> None:
    renamed = table.rename(table.with_suffix(".log"))
    report = import_recording(
        [renamed], table.parent / "o.mcap", map_path=table.parent / "map.toml"
    )
    assert report.importer == "csv"


def test_a_sensor_on_an_unknown_channel_is_refused_and_nothing_is_left(table: Path) -> None:
    folder = table.parent
    (folder / "site.toml").write_text(GEOMETRY.replace('"G2"', '"G9"'))
    with pytest.raises(SchemaError, match=r"site.toml: sensor right: expected a channel of G1, G2"):
        import_recording(
            [table],
            folder / "out.mcap",
            map_path=folder / "map.toml",
            geometry=folder / "site.toml",
        )
    assert not (folder / "out.mcap").exists()


def test_an_existing_recording_is_kept_unless_forced(table: Path) -> None:
    folder = table.parent
    out = folder / "out.mcap"
    import_recording([table], out, map_path=folder / "map.toml")
    with pytest.raises(CodecError):
        import_recording([table], out, map_path=folder / "map.toml")
    import_recording([table], out, map_path=folder / "map.toml", force=True)


def test_a_folder_stands_for_its_shots_in_natural_order(tmp_path: Path) -> None:
    folder = tmp_path / "line"
    folder.mkdir()
    samples = np.zeros((100, 2), "<i4")
    for i in (2, 10):
        write_shot(folder / f"{i}.dat", samples, receivers=["0", "5"], source=f"{i}.0")
    (folder / "README.md").write_text("notes")
    report = import_recording([folder], tmp_path / "out.mcap")
    assert report.files == ("2.dat", "10.dat")
    assert report.warnings == ("README.md: left out: not known to obspy",)
    assert report.labels == {"impact": 2, "trigger": 2}
    with Recording.open(tmp_path / "out.mcap") as recording:
        impacts = [x for x in recording.labels if x.kind == "impact"]
        assert [label.label for label in impacts] == ["2", "10"]
        assert total(recording) == 200


def test_given_sensors_replace_those_of_the_headers_and_shot_points_stay(tmp_path: Path) -> None:
    shot = write_shot(tmp_path / "1.dat", np.zeros((50, 2), "<i4"), receivers=["0", "5"])
    moved = GEOMETRY.replace('"G1"', '"G01"').replace('"G2"', '"G02"')
    (tmp_path / "site.toml").write_text(moved)
    import_recording([shot], tmp_path / "out.mcap", geometry=tmp_path / "site.toml")
    with Recording.open(tmp_path / "out.mcap") as recording:
        assert recording.geometry is not None
        assert [s.name for s in recording.geometry.sensors] == ["left", "right"]
        assert recording.geometry.sources == (("1", -5.0, 0.0),)
        assert recording.streams[0].channels[1].position_m == (3.0, 2.0, 0.0)


def test_a_gap_between_shots_survives_in_the_recording(tmp_path: Path) -> None:
    samples = np.arange(400, dtype="<i4").reshape(200, 2)
    paths = [write_shot(tmp_path / f"{i}.dat", samples, receivers=["0", "5"]) for i in (1, 2)]
    import_recording(paths, tmp_path / "out.mcap")
    with Recording.open(tmp_path / "out.mcap") as recording:
        blocks = [found.block for found in recording.blocks()]
    times = np.concatenate([b.sample_times() for b in blocks])
    steps = np.diff(times)
    assert np.flatnonzero(steps != 1_000_000).tolist() == [199]
    assert steps[199] == 1_001_000_000


def test_files_nobody_knows_are_refused_with_the_formats_known(tmp_path: Path) -> None:
    path = tmp_path / "a.xyz"
    path.write_bytes(b"?")
    with pytest.raises(FormatError, match=r"a.xyz: expected a format of audio, csv, getsens"):
        choose([path])
    with pytest.raises(FormatError, match=r"--format: expected one of audio, csv, .*, found 'wav'"):
        choose([path], "wav")
    with pytest.raises(FormatError, match=r"none.xyz: expected a file or folder, found none"):
        import_recording([tmp_path / "none.xyz"], tmp_path / "out.mcap")


def test_an_importer_that_does_not_load_warns_and_is_left_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    points = [EntryPoint("bad", "groundtrace_codecs.nowhere:None", run.GROUP)]
    monkeypatch.setattr(run, "entry_points", lambda **_: points)
    with pytest.warns(UserWarning, match="importer bad: not loaded"):
        assert importers() == {}


@pytest.mark.parametrize(
    ("subject", "rows", "labels"),
    [
        ("HA", 13759, {"ignore": 1, "step": 62, "walking": 6}),
        ("MS", 22728, {"ignore": 9, "step": 91, "walking": 6}),
    ],
)
def test_mobgap_recordings_import_with_their_contacts(
    data: Path, tmp_path: Path, subject: str, rows: int, labels: dict[str, int]
) -> None:
    source = data / "mobgap" / subject / "001" / "data.mat"
    out = tmp_path / "out.mcap"
    report = import_recording([source], out, map_path=MAPS / "mobgap-test11.toml")
    assert report.samples == {"/imu/waist": rows, "/mag/waist": rows, "/baro/waist": rows}
    assert report.labels == labels
    with Recording.open(out) as recording:
        imu = next(s for s in recording.streams if s.topic == "/imu/waist")
        assert (imu.rate_hz, imu.placement) == (100.0, "waist")
        assert total(recording, ["/imu/waist"]) == rows
        first = next(recording.blocks({"/imu/waist"})).block.values[0]
    assert np.linalg.norm(first[:3]) == pytest.approx(9.8, abs=0.3)


@pytest.mark.parametrize(("example", "shots", "picks"), [(1, 5, 120), (2, 9, 207)])
def test_refrapy_shots_import_with_every_hand_pick(
    data: Path, tmp_path: Path, example: int, shots: int, picks: int
) -> None:
    folder = data / f"{REFRAPY}{example}"
    (sgt,) = (folder / "picks").glob("*.sgt")
    out = tmp_path / "out.mcap"
    report = import_recording([folder / "data"], out, truth=sgt)
    assert report.labels == {"impact": shots, "trigger": shots, "pick": picks}
    with Recording.open(out) as recording:
        assert sum(label.kind == "pick" for label in recording.labels) == picks
        channels = {c.name for s in recording.streams for c in s.channels}
        assert {label.channel for label in recording.labels} - {""} <= channels


def test_other_walks_import_with_their_maps(data: Path, tmp_path: Path) -> None:
    cases = [
        ("oxford-step/validation/user1_hand_1506421989895.csv", "oxford-step-validation", 19405),
        ("rieck-stepcounter/l2-25hz-bw4/normal-walking1.csv", "rieck-stepcounter", 1802),
        ("xio-gait/short_walk.csv", "xio-gait", 16539),
    ]
    labels = [{"step": 326}, {"count": 1}, {}]
    for (source, name, rows), kinds in zip(cases, labels, strict=True):
        out = tmp_path / f"{name}.mcap"
        report = import_recording([data / source], out, map_path=MAPS / f"{name}.toml")
        assert (sum(report.samples.values()), report.labels) == (rows, kinds)
        with Recording.open(out) as recording:
            assert total(recording) == rows
