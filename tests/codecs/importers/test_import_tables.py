"""Text tables, MATLAB files and NumPy archives through a map."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy.io import savemat

from groundtrace_codecs.errors import FormatError, SchemaError
from groundtrace_codecs.importers.base import fit
from groundtrace_codecs.importers.map import load_map
from groundtrace_codecs.importers.tables import DelimitedImporter, MatlabImporter, NumpyImporter

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

    from groundtrace_codecs.importers.base import Imported
    from groundtrace_codecs.signals import SignalBlock, Stream

G0 = 9.80665


def imported(
    folder: Path, table: str, columns: str, *, time: str = 'time = {column = "t"}', more: str = ""
) -> Imported:
    (folder / "table.csv").write_text(table, encoding="utf-8")
    return DelimitedImporter().read([folder / "table.csv"], a_map(folder, columns, time, more))


def a_map(folder: Path, columns: str, time: str, more: str = "", format_: str = "csv") -> Any:
    stream = f'[[stream]]\ntopic = "/s"\ncolumns = [{columns}]\n'
    path = folder / "map.toml"
    path.write_text(f'format = "{format_}"\n{time}\n{more}\n{stream}', encoding="utf-8")
    return load_map(path)


def one(found: Imported) -> tuple[Stream, str, list[SignalBlock]]:
    ((stream, name, blocks),) = found.sources
    return stream, name, list(blocks)


AX = '{column = "ax", quantity = "acceleration", axis = "x", unit = "g"}'
COUNT = '{column = 1, quantity = "seismic", unit = "count"}'


def test_columns_are_found_by_name_and_come_in_si(tmp_path: Path) -> None:
    found = imported(tmp_path, "t,note,ax\n0.00,a,1\n0.01,b,0.5\n0.02,,-1\n", AX)
    stream, name, (block,) = one(found)
    assert (stream.rate_hz, stream.irregular, name) == (100.0, False, "f32le")
    assert stream.channels[0].name == "ax"
    np.testing.assert_allclose(block.values[:, 0], [G0, G0 / 2, -G0])
    assert block.sample_times().tolist() == [0, 10_000_000, 20_000_000]


def test_a_header_with_lines_in_its_cells_is_refused_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(
        SchemaError, match=r"^table.csv: ax: expected one column of t, a b, found"
    ) as e:
        imported(tmp_path, 't,"a\nb"\n0,1\n1,2\n', AX)
    assert "\n" not in str(e.value)


@pytest.mark.filterwarnings("error")
def test_a_number_beyond_single_precision_is_kept(tmp_path: Path) -> None:
    found = imported(tmp_path, "0,7\n1,1e300\n", COUNT, time="time = {column = 0}")
    _, name, (block,) = one(found)
    assert (name, block.samples[1, 0]) == ("f64le", 1e300)


def test_columns_are_found_by_index_without_a_header(tmp_path: Path) -> None:
    found = imported(tmp_path, "0,7\n1,8\n", COUNT, time="time = {column = 0}")
    _, name, (block,) = one(found)
    assert (name, block.samples[:, 0].tolist()) == ("i16le", [7, 8])


def test_european_tables_with_preamble_and_comments_are_read(tmp_path: Path) -> None:
    text = "Made by hand;;\n; \nt [ms];ax\n# pause\n0,0;1,5\n\n40,0;2,5\n"
    more = 'delimiter = ";"\ndecimal = ","\nskip_rows = 3'
    time = 'time = {column = "t [ms]", unit = "ms"}'
    stream, _, (block,) = one(imported(tmp_path, text, AX, time=time, more=more))
    assert stream.rate_hz == 25.0
    np.testing.assert_allclose(block.values[:, 0], [1.5 * G0, 2.5 * G0])


def test_an_empty_cell_is_nan(tmp_path: Path) -> None:
    _, name, (block,) = one(imported(tmp_path, "t,ax\n0,1\n1,\n2,3\n", AX))
    assert name == "f32le"
    assert np.isnan(block.samples[:, 0]).tolist() == [False, True, False]


def test_quoted_cells_may_hold_the_delimiter(tmp_path: Path) -> None:
    _, _, (block,) = one(imported(tmp_path, 't,ax,h\n0,1,"{1, 2}"\n1,2,\n', AX))
    assert len(block) == 2


def test_tabs_separate_the_cells_of_tsv(tmp_path: Path) -> None:
    path = tmp_path / "table.tsv"
    path.write_text("t\tax\n0\t1\n1\t2\n")
    found = DelimitedImporter().read([path], a_map(tmp_path, AX, 'time = {column = "t"}'))
    assert len(one(found)[2][0]) == 2


def test_a_rate_stands_in_for_a_time_column(tmp_path: Path) -> None:
    more = 'start = "2020-12-10T14:09:03.815+01:00"'
    found = imported(tmp_path, "1,5\n1,6\n", COUNT, time="rate_hz = 50.0", more=more)
    stream, _, (block,) = one(found)
    assert stream.rate_hz == 50.0
    assert found.start_ns == block.start_ns == 1_607_605_743_815_000_000


def test_unix_times_keep_every_digit(tmp_path: Path) -> None:
    text = "t,ax\n1700000000.123456789,1\n1700000000.133456789,2\n1700000000.143456789,2\n"
    found = imported(tmp_path, text, AX)
    assert found.start_ns == 1_700_000_000_123_456_789
    assert one(found)[2][0].last_ns == 1_700_000_000_143_456_789


def test_iso_times_are_read(tmp_path: Path) -> None:
    text = "t,ax\n2020-01-01T00:00:00Z,1\n2020-01-01T00:00:00.5Z,2\n"
    found = imported(tmp_path, text, AX, time='time = {column = "t", unit = "iso"}')
    assert (found.start_ns, one(found)[0].rate_hz) == (1_577_836_800_000_000_000, 2.0)


def test_times_before_zero_are_shifted_with_a_warning(tmp_path: Path) -> None:
    found = imported(tmp_path, "t,ax\n-0.5,1\n0.5,2\n", AX)
    assert found.start_ns == 0
    assert "before the clock's zero" in found.warnings[0]


def test_missing_rows_are_a_jump_and_not_a_smear(tmp_path: Path) -> None:
    rows = "".join(f"{i / 25},{i}\n" for i in range(20) if i not in (7, 8))
    stream, _, blocks = one(imported(tmp_path, "t,ax\n" + rows, AX))
    assert stream.rate_hz == 25.0
    assert [(b.first, len(b)) for b in blocks] == [(0, 7), (9, 11)]


def test_jittering_times_stay_with_their_samples(tmp_path: Path) -> None:
    times = np.cumsum(np.random.default_rng(1).uniform(0.005, 0.015, 50))
    rows = "".join(f"{t:.9f},1\n" for t in times)
    stream, _, (block,) = one(imported(tmp_path, "t,ax\n" + rows, AX))
    assert stream.irregular
    np.testing.assert_array_equal(block.sample_times(), np.rint(times * 1e9).astype(np.int64))


def test_times_rounded_to_milliseconds_still_show_their_grid() -> None:
    times = np.rint(np.arange(3000) / 285.7142857 * 1e3).astype(np.int64) * 1_000_000
    timing = fit(times)
    assert timing.index is not None
    assert timing.rate_hz == pytest.approx(285.7142857, rel=1e-6)
    assert np.abs(timing[:] - times).max() <= 600_000


#: How a device rounds: n / d to whole numbers.
ROUNDINGS: dict[str, Callable[[int, int], int]] = {
    "down": lambda n, d: n // d,
    "to the nearest": lambda n, d: (2 * n + d) // (2 * d),
    "up": lambda n, d: -(-n // d),
}


def in_whole_ms(places: NDArray[np.int64], rate_hz: int, rounding: str) -> NDArray[np.int64]:
    """Return the times [ns] of places on a grid that begins at 0.37 ms, rounded to whole ms."""
    parts = [37 * rate_hz + 100_000 * k for k in places.tolist()]
    rounded = ROUNDINGS[rounding]
    return np.array([rounded(n, 100 * rate_hz) for n in parts], np.int64) * 1_000_000


@pytest.mark.parametrize("rounding", ROUNDINGS)
@pytest.mark.parametrize("rate_hz", [1000, 500, 490, 400, 333, 256, 240, 120, 60, 7])
def test_the_rate_behind_whole_milliseconds_is_found_and_only_true_gaps_are_gaps(
    rate_hz: int, rounding: str
) -> None:
    rng = np.random.default_rng(rate_hz)
    lost = np.zeros(4000, np.bool_)
    for at in rng.integers(10, 3900, 25):
        lost[at : at + int(rng.choice([1, 1, 2, 7, 50]))] = True
    for places in (np.arange(4000), np.flatnonzero(~lost)):
        timing = fit(in_whole_ms(places, rate_hz, rounding))
        assert timing.rate_hz == pytest.approx(rate_hz, rel=1e-6)
        assert timing.index is not None
        np.testing.assert_array_equal(timing.index[:], places - places[0])


@pytest.mark.parametrize("rate_hz", [800, 700, 600])
def test_milliseconds_of_more_than_half_a_period_show_the_rate_of_a_stream_without_losses(
    rate_hz: int,
) -> None:
    timing = fit(in_whole_ms(np.arange(4000), rate_hz, "down"))
    assert timing.rate_hz == pytest.approx(rate_hz, rel=1e-4)
    assert timing.index is not None
    np.testing.assert_array_equal(timing.index[:], np.arange(4000))


def test_times_that_go_back_are_kept_and_told(tmp_path: Path) -> None:
    found = imported(tmp_path, "t,ax\n0,1\n0.04,2\n0.08,3\n0.04,4\n0.08,5\n0.12,6\n", AX)
    _, _, blocks = one(found)
    assert [(b.first, len(b)) for b in blocks] == [(0, 3), (1, 3)]
    assert "1 samples are not later than the one before" in found.warnings[0]


def test_samples_stamped_by_the_packet_can_be_laid_evenly(tmp_path: Path) -> None:
    text = "t,ax\n0,1\n0,2\n0.02,3\n0.02,4\n0.03,5\n"
    found = imported(tmp_path, text, AX, time='time = {column = "t", even = true}')
    stream, _, (block,) = one(found)
    assert stream.rate_hz == pytest.approx(4 / 0.03)
    assert block.last_ns == 30_000_000


def test_three_axes_of_acceleration_and_rotation_carry_plain_si(tmp_path: Path) -> None:
    parts = [("acceleration", "g", i) for i in range(3)]
    parts += [("angular_velocity", "deg/s", i + 3) for i in range(3)]
    columns = ",".join(
        f'{{column = {i}, quantity = "{q}", unit = "{u}", axis = "{"xyz"[i % 3]}"}}'
        for q, u, i in parts
    )
    found = imported(tmp_path, "1,0,0,180,0,0\n1,0,0,0,0,0\n", columns, time="rate_hz = 100.0")
    stream, name, (block,) = one(found)
    assert (name, set(stream.scales.tolist())) == ("f64le", {1.0})
    np.testing.assert_allclose(block.samples[0], [G0, 0, 0, np.pi, 0, 0])
    assert stream.channels[3].name == "angular_velocity_x"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,ay\n0,1\n", "table.csv: ax: expected one column of t, ay, found none"),
        ("t,ax,ax\n0,1,1\n", "table.csv: ax: expected one column of t, ax, ax"),
        ("t,ax\n0,1\n1,one\n", "table.csv: line 3: ax: expected a number, found 'one'"),
        ("t,ax\n0,1\nx,1\n", "table.csv: line 3: t: expected a time in s, found 'x'"),
        ("t,ax\n0,1\n,1\n", "table.csv: line 3: t: expected a time in s, found ''"),
        ("t,ax\n0,1\n1e30,1\n", "table.csv: line 3: t: expected a time in s, found '1e30'"),
        ("t,ax\n0,1\n1\n", "table.csv: line 3: expected a cell for column ax, found 1 cells"),
        ("t,ax\n", "table.csv: expected rows of numbers, found none"),
        ("", "table.csv: expected rows of numbers, found none"),
        ("t,ax\n0,1\n0,1\n", "table.csv: /s: t: expected times that go on"),
    ],
)
def test_a_table_that_does_not_fit_is_refused_in_one_line(
    tmp_path: Path, text: str, message: str
) -> None:
    with pytest.raises((SchemaError, FormatError), match=message) as caught:
        imported(tmp_path, text, AX)
    assert "\n" not in str(caught.value)


def test_arbitrary_units_and_axes_of_the_earth_are_taken(tmp_path: Path) -> None:
    columns = ", ".join(
        f'{{column = "{c}", quantity = "{q}", unit = "{u}", axis = "{a}"}}'
        for c, q, u, a in [
            ("be", "magnetic_field", "a.u.", "e"),
            ("bn", "magnetic_field", "a.u.", "north"),
            ("bu", "magnetic_field", "au", "u"),
            ("vu", "ground_velocity", "a.u.", "up"),
        ]
    )
    stream, _, (block,) = one(imported(tmp_path, "t,be,bn,bu,vu\n0,1,2,3,4\n1,1,2,3,4\n", columns))
    assert [(c.name, c.unit, c.axis, c.scale) for c in stream.channels] == [
        ("be", "a.u.", "x", 1.0),
        ("bn", "a.u.", "y", 1.0),
        ("bu", "a.u.", "z", 1.0),
        ("vu", "a.u.", "z", 1.0),
    ]
    assert block.values[0].tolist() == [1.0, 2.0, 3.0, 4.0]


def test_a_column_that_is_not_there_names_the_nearest(tmp_path: Path) -> None:
    with pytest.raises(SchemaError, match=r"ax: expected one column of t, a_x, .*did you mean a_x"):
        imported(tmp_path, "t,a_x\n0,1\n1,2\n", AX)


def test_tables_need_a_map(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("1\n")
    for importer in (DelimitedImporter(), MatlabImporter(), NumpyImporter()):
        with pytest.raises(SchemaError, match=r"a.csv: expected --map"):
            importer.read([path], None)


def test_a_growing_count_and_a_total_become_labels(tmp_path: Path) -> None:
    more = (
        '[[truth]]\nkind = "step"\nincrements_of = "n"\n[[truth]]\nkind = "count"\ntotal_of = "m"'
    )
    text = "t,ax,n,m\n0,1,0,5\n1,1,1,\n2,1,1,\n3,1,3,\n"
    found = imported(tmp_path, text, AX, more=more)
    steps = [x.time_ns for x in found.labels if x.kind == "step"]
    (count,) = [x for x in found.labels if x.kind == "count"]
    assert steps == [1_000_000_000, 3_000_000_000, 3_000_000_000]
    assert (count.time_ns, count.end_ns, count.value) == (0, 4_000_000_000, 5.0)


BOUTS = """
[[truth]]
kind = "walking"
time = "d.wb[*].Start"
end = "d.wb[*].End"
[[truth]]
kind = "step"
time = "d.wb[*].IC"
label = "d.wb[*].LR"
missing = "ignore"
alternating = true
min_interval_s = 0.1
margin_s = 0.12
"""
ACC = '{column = "d.acc[:,0]", quantity = "acceleration", axis = "x", unit = "g"}'


def bouts(folder: Path, *contacts: tuple[list[float], str], more: str = BOUTS) -> Imported:
    feet = {"L": "Left", "R": "Right"}
    wb = np.array(
        [
            {"Start": ic[0], "End": ic[-1], "IC": ic, "LR": np.array([feet[f] for f in lr], object)}
            for ic, lr in contacts
        ],
        object,
    )
    path = folder / "data.mat"
    savemat(path, {"d": {"acc": np.ones((900, 3)), "wb": wb, "t0": 1000.5}})
    time = 'rate_hz = 100.0\nstart = {column = "d.t0"}'
    return MatlabImporter().read([path], a_map(folder, ACC, time, more, "mat"))


def spans(found: Imported, kind: str) -> list[tuple[float, float]]:
    return [
        ((x.time_ns - found.start_ns) / 1e9, ((x.end_ns or 0) - found.start_ns) / 1e9)
        for x in found.labels
        if x.kind == kind
    ]


def steps(found: Imported) -> list[tuple[float, str]]:
    return [((x.time_ns - found.start_ns) / 1e9, x.label) for x in found.labels if x.kind == "step"]


def test_a_matlab_file_gives_streams_and_reference_events(tmp_path: Path) -> None:
    found = bouts(tmp_path, ([1.0, 1.5, 2.0], "LRL"), ([5.0, 5.5], "RL"))
    stream, _, (block,) = one(found)
    assert found.start_ns == 1_000_500_000_000
    assert (len(block), stream.rate_hz) == (900, 100.0)
    assert spans(found, "walking") == [(1.0, 2.0), (5.0, 5.5)]
    assert steps(found) == [
        (1.0, "left"),
        (1.5, "right"),
        (2.0, "left"),
        (5.0, "right"),
        (5.5, "left"),
    ]
    assert spans(found, "ignore") == []
    assert found.warnings == ()


def test_around_a_contact_without_a_time_nothing_is_scored(tmp_path: Path) -> None:
    found = bouts(tmp_path, ([1.0, np.nan, 2.0, 2.5], "LRLR"), ([5.0, 5.5], "RL"))
    assert spans(found, "ignore") == [(1.12, 1.88)]
    assert len(steps(found)) == 5
    assert found.warnings == ("ignore 1.120 to 1.880 s: no time for a contact in the reference",)


def test_two_contacts_of_one_foot_in_a_row_prove_one_missing(tmp_path: Path) -> None:
    found = bouts(tmp_path, ([1.0, 1.5, 2.5], "LRR"), ([5.0, 5.5], "RL"))
    assert spans(found, "ignore") == [(1.62, 2.38)]


def test_two_contacts_at_once_become_one_with_a_warning(tmp_path: Path) -> None:
    found = bouts(tmp_path, ([1.0, 1.01, 2.0], "RLR"), ([5.0, 5.5, 5.5], "RLL"))
    assert steps(found) == [(1.0, ""), (2.0, "right"), (5.0, "right"), (5.5, "left")]
    assert spans(found, "ignore") == []
    assert found.warnings == (
        "step at 1.000 s: two in the reference, 10 ms apart: taken as one",
        "step at 5.500 s: two in the reference, 0 ms apart: taken as one",
    )


def test_a_missing_time_is_an_error_unless_the_map_expects_it(tmp_path: Path) -> None:
    more = BOUTS.replace('missing = "ignore"\n', "")
    with pytest.raises(SchemaError, match=r"data.mat: d.wb\[\*\].IC: expected times, found NaN"):
        bouts(tmp_path, ([1.0, np.nan, 2.0], "LRL"), ([5.0, 5.5], "RL"), more=more)


def test_a_newer_or_broken_matlab_file_is_refused(tmp_path: Path) -> None:
    map_ = a_map(tmp_path, ACC, "rate_hz = 100.0", format_="mat")
    new, broken = tmp_path / "new.mat", tmp_path / "broken.mat"
    new.write_bytes(b"MATLAB 7.3 MAT-file, Platform".ljust(124) + b"\x00\x02IM" + bytes(400))
    broken.write_bytes(b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + b"\x0e" * 40)
    with pytest.raises(FormatError, match=r"new.mat: header: expected MATLAB 4 to 7.2, found 7.3"):
        MatlabImporter().read([new], map_)
    with pytest.raises(FormatError, match=r"broken.mat: byte 136: expected at most 4 bytes"):
        MatlabImporter().read([broken], map_)


def test_numpy_archives_give_streams_and_events_by_sample(tmp_path: Path) -> None:
    path = tmp_path / "walk.npz"
    np.savez(path, imu=np.arange(20.0).reshape(10, 2), t=np.arange(10) / 10, s=np.array([2, 5]))
    columns = '{column = "imu[:,1]", quantity = "angular_velocity", axis = "z", unit = "rad/s"}'
    more = '[[truth]]\nkind = "step"\ntime = "s"\nunit = "sample"'
    map_ = a_map(tmp_path, columns, 'time = {column = "t"}', more, "npz")
    found = NumpyImporter().read([path], map_)
    stream, _, (block,) = one(found)
    assert stream.rate_hz == 10.0
    assert block.values[:, 0].tolist() == np.arange(1.0, 20.0, 2).tolist()
    assert steps(found) == [(0.2, ""), (0.5, "")]


def test_one_array_is_called_data_and_pickles_are_refused(tmp_path: Path) -> None:
    columns = '{column = "data", quantity = "seismic", unit = "count"}'
    map_ = a_map(tmp_path, columns, "rate_hz = 10.0", format_="npz")
    good, evil, torn = tmp_path / "a.npy", tmp_path / "b.npy", tmp_path / "c.npz"
    np.save(good, np.arange(5))
    np.save(evil, np.array([{}], object), allow_pickle=True)
    torn.write_bytes(b"PK\x03\x04 torn")
    assert one(NumpyImporter().read([good], map_))[1] == "i16le"
    for path in (evil, torn):
        with pytest.raises(FormatError, match=f"{path.name}: expected a NumPy archive without"):
            NumpyImporter().read([path], map_)


def test_importers_know_their_files(tmp_path: Path) -> None:
    mat, npz, csv = tmp_path / "a.mat", tmp_path / "a.npz", tmp_path / "a.csv"
    savemat(mat, {"a": 1})
    np.savez(npz, a=1)
    csv.write_text("1,2\n")
    scores = [
        [importer.sniff(path) for path in (mat, npz, csv)]
        for importer in (MatlabImporter(), NumpyImporter(), DelimitedImporter())
    ]
    assert scores == [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.5]]
