"""Many files that are one event each, their times, and truth from before the first sample."""

from __future__ import annotations

import wave
from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy.io import savemat
from test_audio import with_bext

from groundtrace_codecs.errors import SchemaError
from groundtrace_codecs.importers.run import ImportReport, import_recording
from groundtrace_codecs.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from groundtrace_codecs.events import Label

MAP = """format = "{form}"
time = {{column = "t"{unit}}}
[[stream]]
topic = "/seismic"
columns = [{{column = "g", quantity = "ground_velocity", unit = "mm/s", axis = "u"}}]
"""


def drop(
    path: Path, number: int, *, rows: int = 50, start_s: float = 0.0, rate_hz: float = 1000.0
) -> Path:
    t = start_s + np.arange(rows) / rate_hz
    g = number + np.arange(rows) / 1000
    path.write_text("t,g\n" + "".join(f"{a:.6f},{b:.3f}\n" for a, b in zip(t, g, strict=True)))
    return path


def imported(
    folder: Path, paths: Sequence[Path], *, form: str = "csv", more: str = "", truth: str = ""
) -> tuple[ImportReport, list[tuple[int, np.ndarray]], list[Label]]:
    """Import files by the map; return the report, start and values of each run, and labels."""
    (folder / "map.toml").write_text(more + MAP.format(form=form, unit=""))
    table = folder / "truth.csv"
    if truth:
        table.write_text(truth)
    report = import_recording(
        paths,
        folder / "out.mcap",
        map_path=folder / "map.toml",
        truth=table if truth else None,
        force=True,
    )
    with Recording.open(folder / "out.mcap") as opened:
        runs: list[tuple[int, np.ndarray]] = []
        last = None
        for _, block in opened.blocks():
            values = block.values[:, 0] * 1e3
            if last is not None and block.start_ns - last <= 1.5 * block.stream.period_ns:
                runs[-1] = (runs[-1][0], np.concatenate([runs[-1][1], values]))
            else:
                runs.append((block.start_ns, values))
            last = block.last_ns
        return report, runs, list(opened.labels)


def test_39_tables_of_one_drop_each_lie_a_second_apart_with_the_truth_of_each(
    tmp_path: Path,
) -> None:
    folder = tmp_path / "drops"
    folder.mkdir()
    for i in range(39):
        drop(folder / f"drop{i}.csv", i)
    rows = "".join(f"0.010,impact,drop{i}.csv\n" for i in range(39))
    report, runs, labels = imported(folder, [folder], truth=f"time_s,kind,file\n{rows}")
    assert len(report.files) == 39
    assert report.warnings == ("map.toml: left out: not known to csv",) or not report.warnings
    assert report.remarks == (
        "39 files: laid end to end, 1 s apart: the times of drop0.csv and drop1.csv overlap",
    )
    assert [start for start, _ in runs] == [i * 1_050_000_000 for i in range(39)]
    for i, (_, values) in enumerate(runs):
        np.testing.assert_allclose(values, i + np.arange(50) / 1000, atol=1e-9)
    assert [x.time_ns for x in labels] == [i * 1_050_000_000 + 10_000_000 for i in range(39)]


def test_truth_of_a_file_that_is_not_there_names_the_nearest(tmp_path: Path) -> None:
    paths = [drop(tmp_path / f"drop{i}.csv", i) for i in range(2)]
    with pytest.raises(SchemaError, match=r"file: expected one of drop0.csv, drop1.csv, found "):
        imported(tmp_path, paths, truth="time_s,kind,file\n0,impact,drop7.csv\n")


def test_truth_in_each_file_moves_with_it(tmp_path: Path) -> None:
    paths = []
    for i in range(3):
        path = tmp_path / f"{i}.mat"
        savemat(path, {"t": np.arange(20) / 100, "g": np.full(20, float(i)), "hit": 0.05})
        paths.append(path)
    (tmp_path / "m.toml").write_text(
        MAP.format(form="mat", unit="") + '[[truth]]\nkind = "impact"\ntime = "hit"\n'
    )
    import_recording(paths, tmp_path / "o.mcap", map_path=tmp_path / "m.toml")
    with Recording.open(tmp_path / "o.mcap") as opened:
        assert [x.time_ns for x in opened.labels] == [50_000_000, 1_250_000_000, 2_450_000_000]


def test_tables_on_one_clock_keep_their_own_times_whatever_their_order(tmp_path: Path) -> None:
    later = drop(tmp_path / "a.csv", 1, start_s=1_700_000_060.0)
    sooner = drop(tmp_path / "b.csv", 2, start_s=1_700_000_000.0)
    report, runs, _ = imported(tmp_path, [later, sooner])
    assert report.remarks == ("2 files: each keeps its own time",)
    assert [start for start, _ in runs] == [1_700_000_000_000_000_000, 1_700_000_060_000_000_000]
    assert [values[0] for _, values in runs] == [pytest.approx(2.0), pytest.approx(1.0)]


def test_parts_of_one_recording_go_on_without_a_gap_where_the_map_says_so(tmp_path: Path) -> None:
    paths = [drop(tmp_path / f"{i}.csv", i) for i in range(3)]
    report, runs, _ = imported(tmp_path, paths, more='files = "continuous"\n')
    assert "without a gap" in report.remarks[0]
    ((start, values),) = runs
    assert (start, len(values)) == (0, 150)


def test_files_of_slightly_other_rates_keep_the_times_of_every_sample(tmp_path: Path) -> None:
    paths = [
        drop(tmp_path / f"{i}.csv", i, rows=200, rate_hz=rate_hz)
        for i, rate_hz in enumerate((1000.0, 1001.0))
    ]
    imported(tmp_path, paths)
    with Recording.open(tmp_path / "out.mcap") as opened:
        (stream,) = opened.streams
        times = np.concatenate([b.sample_times() for _, b in opened.blocks()])
    assert stream.irregular
    np.testing.assert_allclose(times[200:] - times[200], np.arange(200) / 1001 * 1e9, atol=1000)


def test_a_file_of_quite_another_rate_is_refused(tmp_path: Path) -> None:
    paths = [
        drop(tmp_path / "a.csv", 1),
        drop(tmp_path / "b.csv", 1, rate_hz=100.0),
    ]
    with pytest.raises(SchemaError, match=r"b.csv: /seismic: expected about 1000 Hz as in a.csv"):
        imported(tmp_path, paths)


def sound(path: Path, value: int, frames: int = 800) -> Path:
    with wave.open(str(path), "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(8000)
        file.writeframes(np.full(frames, value, "<i2").tobytes())
    return path


def starts(out: Path) -> list[int]:
    """Return where runs begin [ns]."""
    with Recording.open(out) as opened:
        times = np.concatenate([b.sample_times() for _, b in opened.blocks()])
    return [int(times[0]), *times[1:][np.diff(times) > 1_000_000].tolist()]


def test_sound_files_keep_the_times_of_their_recorder(tmp_path: Path) -> None:
    paths = [sound(tmp_path / f"{i}.wav", i + 1) for i in range(2)]
    for path, seconds in zip(paths, (60, 30), strict=True):
        with_bext(path, b"2024-05-01", b"00:00:00", seconds * 8000)
    report = import_recording(paths, tmp_path / "out.mcap")
    assert report.remarks == ("2 files: each keeps its own time",)
    first, second = starts(tmp_path / "out.mcap")
    assert second - first == 30_000_000_000


def test_sound_files_of_events_lie_a_second_apart_where_the_map_says_so(tmp_path: Path) -> None:
    paths = [sound(tmp_path / f"{i}.wav", i + 1) for i in range(3)]
    (tmp_path / "m.toml").write_text(
        'format = "audio"\nfiles = "events"\n[[stream]]\ntopic = "/s"\n'
        'columns = [{column = 0, quantity = "seismic", unit = "count"}]\n'
    )
    report = import_recording(paths, tmp_path / "out.mcap", map_path=tmp_path / "m.toml")
    assert not report.warnings
    assert starts(tmp_path / "out.mcap") == [0, 1_100_000_000, 2_200_000_000]


def test_truth_up_to_a_second_early_is_kept_with_a_note_and_the_clock_makes_room(
    tmp_path: Path,
) -> None:
    path = drop(tmp_path / "a.csv", 1)
    truth = "time_s,kind\n-0.3,step\n-0.1,step\n0.02,step\n"
    report, runs, labels = imported(tmp_path, [path], truth=truth)
    assert report.warnings == (
        "truth: 2 of 3 lie before the first sample, by up to 0.300 s: kept, and all times are "
        "0.300 s later",
    )
    assert runs[0][0] == report.start_ns == 300_000_000
    assert [x.time_ns for x in labels] == [0, 200_000_000, 320_000_000]


def test_early_truth_on_the_calendar_moves_nothing_and_one_of_another_day_is_doubted(
    tmp_path: Path,
) -> None:
    path = drop(tmp_path / "a.csv", 1, start_s=1_700_000_000.0)
    report, runs, _ = imported(tmp_path, [path], truth="time_s,kind\n-0.3,step\n")
    assert report.warnings == ("truth: 1 of 1 lie before the first sample, by up to 0.300 s: kept",)
    assert runs[0][0] == 1_700_000_000_000_000_000
    report, _, _ = imported(tmp_path, [path], truth="time_s,kind\n-90,step\n")
    assert report.warnings[0].endswith("is it the truth of another recording?")


def test_early_truth_in_the_file_itself_is_taken_alike_and_an_earlier_one_refused(
    tmp_path: Path,
) -> None:
    (tmp_path / "m.toml").write_text(
        MAP.format(form="mat", unit="") + '[[truth]]\nkind = "impact"\ntime = "hit"\n'
    )
    path = tmp_path / "a.mat"
    for hit in (-0.25, -1.5):
        savemat(path, {"t": np.arange(20) / 100, "g": np.arange(20.0), "hit": hit})
        if hit < -1:
            with pytest.raises(SchemaError, match="no impact more than 1 s before the first"):
                import_recording([path], tmp_path / "p.mcap", map_path=tmp_path / "m.toml")
            continue
        report = import_recording([path], tmp_path / "o.mcap", map_path=tmp_path / "m.toml")
        assert "1 of 1 lie before the first sample, by up to 0.250 s" in report.warnings[0]
