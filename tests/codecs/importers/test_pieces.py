"""Columns that are read piece by piece give what they give when they are read as a whole."""

from __future__ import annotations

import tracemalloc
import warnings
from typing import TYPE_CHECKING

import h5py
import numpy as np
import pytest
from fuzz_targets import TARGETS
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.io import savemat
from seg2_files import write_shot

from groundtrace_codecs import Recording
from groundtrace_codecs.importers import phone_logs, seismic, stored
from groundtrace_codecs.importers.base import fit
from groundtrace_codecs.importers.map import sample_format
from groundtrace_codecs.importers.run import import_recording
from groundtrace_codecs.importers.stored import (
    Computed,
    Spool,
    StoredArray,
    median,
    picked,
    rows_in,
)

if TYPE_CHECKING:
    from pathlib import Path

COUNT = 3000
STREAM = """[[stream]]
topic = "/imu"
columns = [
  {column = "A", quantity = "acceleration", unit = "m/s2", axis = "x"},
  {column = "B", quantity = "acceleration", unit = "m/s2", axis = "y"},
  {column = "C", quantity = "acceleration", unit = "m/s2", axis = "z"},
]
"""


def even(rng: np.random.Generator) -> np.ndarray:
    return np.arange(COUNT) / 100.0


def with_holes(rng: np.random.Generator) -> np.ndarray:
    return np.delete(np.arange(COUNT + 60), np.r_[700:750, 2000:2010]) / 100.0


def jittering(rng: np.random.Generator) -> np.ndarray:
    return np.sort(np.arange(COUNT) / 100.0 + rng.normal(0, 2e-3, COUNT))


def of_an_odd_rate(rng: np.random.Generator) -> np.ndarray:
    return np.round(np.arange(COUNT) / 99.873 + rng.normal(0, 2e-5, COUNT), 6)


def set_back(rng: np.random.Generator) -> np.ndarray:
    return np.r_[np.arange(2000), np.arange(1000, 2000)] / 100.0


TIMES = [even, with_holes, jittering, of_an_odd_rate, set_back]


def content(path: Path) -> list[tuple[np.ndarray, np.ndarray]]:
    with Recording.open(path) as found:
        blocks = [block for _, block in found.blocks()]
    return [
        (
            np.concatenate([b.sample_times() for b in blocks]),
            np.concatenate([b.values for b in blocks]),
        )
    ]


@pytest.mark.parametrize("times", TIMES)
@pytest.mark.parametrize("form", ["csv", "npz", "hdf5", "mat", "counter"])
def test_the_size_of_a_piece_changes_no_sample(
    form: str, times: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(3)
    t = times(rng)  # type: ignore[operator]
    x = np.round(rng.normal(0, 9, (len(t), 3)), 4)
    file, text = tmp_path / f"a.{form}", STREAM
    if form in ("csv", "counter"):
        head, rows = "n,t,A,B,C", np.c_[np.arange(len(t)) % 256, t, x]
        np.savetxt(file, rows, "%.9g", ",", header=head, comments="")
        form, more = "csv", "" if form == "csv" else 'counter = {column = "n", modulus = 256}\n'
        text = f'format = "csv"\ntime = {{column = "t"}}\n{more}{text}'
    else:
        if form == "npz":
            np.savez_compressed(file, t=t, x=x)
            file = file.rename(tmp_path / "b.npz") if file.exists() else file
        elif form == "mat":
            savemat(file, {"t": t, "x": x}, do_compression=True)
        else:
            with h5py.File(file, "w") as made:
                made.create_dataset("t", data=t)
                made.create_dataset("x", data=x, chunks=(64, 2), compression=1)
        for i, name in enumerate("ABC"):
            text = text.replace(f'"{name}"', f'"x[:,{i}]"')
        text = f'format = "{form}"\ntime = {{column = "t"}}\n{text}'
    (tmp_path / "map.toml").write_text(text)
    monkeypatch.setattr("groundtrace_codecs.importers.tables._SMALL_BYTES", 0)
    found = []
    for size in (1 << 20, 501, 64):
        monkeypatch.setattr(stored, "PIECE", size)
        out = tmp_path / f"{size}.mcap"
        import_recording([file], out, map_path=tmp_path / "map.toml")
        found += content(out)
    for when, values in found[1:]:
        assert np.abs(when - found[0][0]).max() <= 1  # sums of other order: half a nanosecond
        np.testing.assert_array_equal(values, found[0][1])


WHOLE = st.integers(-(2**61), 2**61)


@given(values=st.lists(st.one_of(st.integers(-3, 3), WHOLE), min_size=1), cut=st.integers(1, 9))
def test_the_median_of_pieces_is_that_of_all(values: list[int], cut: int) -> None:
    whole = np.array(values, np.int64)
    parts = [whole[i : i + cut] for i in range(0, len(whole), cut)]
    expected = float(np.mean(np.sort(whole)[[(len(whole) - 1) // 2, len(whole) // 2]]))
    assert median(lambda: parts) == expected


@given(
    array=arrays(np.int32, st.tuples(*[st.integers(1, 5)] * 3)),
    fortran=st.booleans(),
    taken=st.tuples(*[st.integers(0, 4)] * 3),
    axis=st.integers(0, 2),
)
def test_an_axis_of_a_stored_array_is_that_of_the_array(
    array: np.ndarray, fortran: bool, taken: tuple[int, ...], axis: int
) -> None:
    content = array.tobytes("F" if fortran else "C")
    kept = rows_in(
        "f", lambda at, n: content[at : at + n], array.shape, array.dtype, fortran=fortran
    )
    index = tuple(
        slice(None) if i == axis else at % n
        for i, (at, n) in enumerate(zip(taken, array.shape, strict=True))
    )
    np.testing.assert_array_equal(np.asarray(kept), array)
    column = kept.at(index).column()
    assert column is not None
    np.testing.assert_array_equal(column[:], array[index])
    np.testing.assert_array_equal(column[1:3], array[index][1:3])
    assert isinstance(kept, StoredArray)


def test_a_spool_gives_the_rows_that_were_put_in() -> None:
    spool, rows = Spool(np.float64, (2,)), np.arange(40.0).reshape(20, 2)
    spool.write(rows[:7])
    assert spool[5:9].tolist() == rows[5:7].tolist()
    spool.write(rows[7:])
    np.testing.assert_array_equal(spool[3:11], rows[3:11])
    assert len(spool) == 20


@pytest.mark.parametrize(
    ("values", "name"),
    [
        ([1.0, -2.0], "i16le"),
        ([40_000.0], "i32le"),
        ([0.5, 2.0**30], "f32le"),
        ([0.1], "f64le"),
        ([float("nan"), 3.0], "f32le"),
        ([], "f32le"),
    ],
)
def test_the_smallest_format_that_keeps_all_is_taken(values: list[float], name: str) -> None:
    found, samples = sample_format(np.array(values, np.float64).reshape(-1, 1))
    assert found == name
    np.testing.assert_array_equal(samples[:], np.array(values).reshape(-1, 1))


def test_one_column_of_a_wide_table_takes_the_memory_of_one_column() -> None:
    rows, columns = 100_000, 20
    spool = Spool(np.int64, (columns,))
    spool.write(np.arange(rows * columns).reshape(rows, columns))
    column = Computed(rows, lambda piece: spool[piece][:, 3])
    tracemalloc.start()
    found = column[:]
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    np.testing.assert_array_equal(found, np.arange(rows) * columns + 3)
    assert peak < columns / 2 * found.nbytes


def test_a_grid_is_found_over_many_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stored, "PIECE", 100)
    times_ns = np.round(np.arange(5000) * 1e9 / 256).astype(np.int64)
    timing = fit(times_ns)
    assert timing.rate_hz == 256
    np.testing.assert_array_equal(timing[:], times_ns)


#: Files of each importer, by target of fuzzing: a name that its importer knows.
NAMES = {
    "Sensor Logger": "Gyroscope.csv", "Sensor Logger, zip": "x.zip", "phyphox": "x.csv",
    "indoor location": "x.txt", "Xsens text": "x.txt", "ROS 1 bag": "x.bag", "ROS 2 bag": "x.db3",
    "SAC": "x.sac", "SEG-2": "x.sg2", "miniSEED": "x.mseed",
}  # fmt: skip


@pytest.mark.parametrize("target", NAMES)
def test_an_import_in_pieces_is_that_of_the_whole(
    target: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for seed in TARGETS[target].seeds(tmp_path):
        file, found = tmp_path / NAMES[target], []
        file.write_bytes(seed)
        for size in (1 << 20, 4, 1):
            monkeypatch.setattr(stored, "PIECE", size)
            monkeypatch.setattr(phone_logs, "PIECE", size)
            monkeypatch.setattr(seismic, "_SEG2_SAMPLES", 4 * size)
            out = tmp_path / f"{target}-{size}.mcap"
            found.append((import_recording([file], out, force=True), recorded(out)))
        for report, rows in found[1:]:
            assert report.warnings == found[0][0].warnings
            assert report.samples == found[0][0].samples
            assert rows == found[0][1]


def recorded(path: Path) -> dict[str, list[tuple[int, list[float]]]]:
    rows: dict[str, list[tuple[int, list[float]]]] = {}
    with Recording.open(path) as found:
        for _, block in found.blocks():
            pairs = zip(block.sample_times().tolist(), block.values.tolist(), strict=True)
            rows.setdefault(block.topic, []).extend(pairs)
    return rows


@pytest.mark.parametrize(("form", "more"), [("SEGY", {"data_encoding": 1}), ("SU", {})])
@pytest.mark.parametrize("columns", [1, 40])
def test_traces_read_one_after_the_other_are_those_that_obspy_reads_at_once(
    form: str, more: dict[str, int], columns: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from obspy import Stream, Trace, UTCDateTime, read

        start = {"starttime": UTCDateTime(2026, 1, 1), "sampling_rate": 500.0}
        drawn = np.random.default_rng(1).integers(-999, 999, (columns, 50)).astype(np.float32)
        traces = [Trace(row, dict(start)) for row in drawn]
        Stream(traces).write(str(tmp_path / "a.dat"), format=form, **more)
        theirs = np.stack([trace.data for trace in read(str(tmp_path / "a.dat"))], axis=1)
    monkeypatch.setattr(stored, "_BLOCK_BYTES", 900)
    import_recording([tmp_path / "a.dat"], tmp_path / "a.mcap")
    ((_, values),) = content(tmp_path / "a.mcap")
    np.testing.assert_array_equal(values, theirs)


@pytest.mark.parametrize("kind", ["<i2", "<i4", "<f4", "<f8"])
def test_a_seg2_trace_read_in_pieces_is_that_which_obspy_reads_at_once(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = np.random.default_rng(1).integers(-999, 999, (50, 3)).astype(kind)
    path = write_shot(tmp_path / "1.dat", drawn)
    monkeypatch.setattr(seismic, "_SEG2_SAMPLES", 8)
    found, _ = seismic._read(path, Spool(np.uint8))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from obspy import read

        theirs = read(str(path))
    for ours, trace in zip(found, theirs, strict=True):
        np.testing.assert_array_equal(ours.data[:], trace.data)
        assert ours.start_ns == trace.stats.starttime.ns
        assert ours.header == trace.stats.seg2


def test_texts_of_seismic_traces_are_read_trace_by_trace(tmp_path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from obspy import Trace, UTCDateTime, read

        for form in ("GSE2", "SLIST", "TSPAIR"):
            parts = []
            for minute in range(3):
                head = {
                    "station": "A",
                    "channel": "Z",
                    "starttime": UTCDateTime(2026, 1, 1, 0, minute),
                }
                data = np.arange(200, dtype=np.int32) * (minute + 1)
                Trace(data, head).write(str(tmp_path / "part"), format=form)
                parts.append((tmp_path / "part").read_bytes())
            path = tmp_path / f"a.{form}"
            path.write_bytes(b"".join(parts))
            with path.open("rb") as file:
                assert list(seismic._sections(file)) == parts
            found, _ = seismic._read(path, Spool(np.uint8))
            for ours, trace in zip(found, read(str(path)), strict=True):
                np.testing.assert_array_equal(ours.data[:], trace.data)
                assert ours.start_ns == trace.stats.starttime.ns


@given(order=st.permutations(range(40)), cut=st.integers(1, 50))
def test_rows_in_any_order_are_found(order: list[int], cut: int) -> None:
    rows, values = np.array(order), np.arange(80.0).reshape(40, 2)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stored, "PIECE", 6)
        found = picked(values, rows)
        np.testing.assert_array_equal(found[:cut], values[rows[:cut]])
        np.testing.assert_array_equal(found[cut:], values[rows[cut:]])


def test_a_number_that_is_none_is_read_without_a_warning(tmp_path: Path) -> None:
    (seed,) = TARGETS["SAC"].seeds(tmp_path)
    path = tmp_path / "a.sac"
    path.write_bytes(seed[:632] + bytes.fromhex("0100a07f") + seed[636:])  # a NaN that signals
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        import_recording([path], tmp_path / "a.mcap")
    ((_, values),) = content(tmp_path / "a.mcap")
    assert np.isnan(values[0, 0])
    assert np.isfinite(values[1:]).all()
