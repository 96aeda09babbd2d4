"""Seismic files through ObsPy, and hand picks that go with them."""

from __future__ import annotations

import io
import sys
import warnings
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from seg2_files import write_shot

from groundtrace_codecs.errors import FormatError, MissingReaderError, SchemaError
from groundtrace_codecs.events import Label
from groundtrace_codecs.geometry import Geometry, Sensor
from groundtrace_codecs.importers.run import choose
from groundtrace_codecs.importers.seismic import SeismicImporter
from groundtrace_codecs.truth import picks_of, read_sgt, read_truth

if TYPE_CHECKING:
    from pathlib import Path

    from groundtrace_codecs.importers.base import Imported

START_NS = 1_359_817_680_000_000_000  # 2013-02-02T15:08:00Z
NEAR = ["0.00", "4.00", "8.00"]
FAR = ["8.00", "12.00", "16.00"]


def counts(seed: int = 0, n: int = 50) -> np.ndarray[tuple[int, int], np.dtype[np.int32]]:
    drawn = np.random.default_rng(seed).integers(-(2**20), 2**20, (n, 3))
    return drawn.astype("<i4")


def impacts(found: Imported) -> tuple[Label, ...]:
    """The impacts among labels, each of which has a trigger at its time and place."""
    triggers = [replace(x, kind="impact") for x in found.labels if x.kind == "trigger"]
    own = tuple(x for x in found.labels if x.kind == "impact")
    assert list(own) == triggers
    return own


def test_shots_keep_the_times_of_their_headers(tmp_path: Path) -> None:
    later = write_shot(tmp_path / "1.dat", counts(1), receivers=NEAR, source="10.0", second=9)
    sooner = write_shot(tmp_path / "2.dat", counts(2, 40), receivers=NEAR, source="-5.0", second=2)
    found = SeismicImporter().read([later, sooner], None)
    ((stream, name, blocks),) = found.sources
    first, second = blocks
    assert (stream.topic, stream.rate_hz, name) == ("/seismic", 1000.0, "i32le")
    assert (first.first, len(first), second.first, len(second)) == (0, 40, 7000, 50)
    np.testing.assert_array_equal(first.samples, counts(2, 40))
    np.testing.assert_array_equal(second.samples, counts(1))
    start = START_NS + 2_000_000_000
    assert found.start_ns == first.start_ns == start
    assert impacts(found) == (
        Label(start, "impact", x_m=-5.0, y_m=0.0, label="2"),
        Label(start + 7_000_000_000, "impact", x_m=10.0, y_m=0.0, label="1"),
    )
    assert found.remarks == ("2 shots: each keeps its own time",)


def test_shots_of_one_second_lie_end_to_end_in_the_order_of_their_files(tmp_path: Path) -> None:
    paths = [
        write_shot(tmp_path / f"{i}.dat", counts(i, n), receivers=NEAR, second=2)
        for i, n in ((1, 40), (2, 50), (3, 50))
    ]
    found = SeismicImporter().read(paths, None)
    ((_, _, blocks),) = found.sources
    assert [(b.first, len(b)) for b in blocks] == [(0, 40), (1040, 50), (2090, 50)]
    start = START_NS + 2_000_000_000
    assert [x.time_ns - start for x in impacts(found)] == [0, 1_040_000_000, 2_090_000_000]
    assert found.remarks == ("3 shots: laid end to end, 1 s apart: the times of 1 and 2 overlap",)


def test_headers_place_receivers_and_sources(tmp_path: Path) -> None:
    path = write_shot(tmp_path / "7.dat", counts(), receivers=["0 1 -2", "4 1", "8"], source="1 2")
    found = SeismicImporter().read([path], None)
    assert found.geometry is not None
    assert found.geometry.sensors == (
        Sensor("G01", "G01", 0.0, 1.0, -2.0),
        Sensor("G02", "G02", 4.0, 1.0, 0.0),
        Sensor("G03", "G03", 8.0, 0.0, 0.0),
    )
    assert found.geometry.sources == (("7", 1.0, 2.0),)
    assert found.sources[0][0].channels[1].position_m == (4.0, 1.0, 0.0)


def test_feet_become_metres(tmp_path: Path) -> None:
    path = write_shot(
        tmp_path / "7.dat", counts(), receivers=["0", "10", "20"], file_fields={"UNITS": "FEET"}
    )
    found = SeismicImporter().read([path], None)
    assert found.geometry is not None
    assert found.geometry.sensors[2].x == pytest.approx(6.096)


def test_the_time_zero_of_a_shot_respects_its_delay(tmp_path: Path) -> None:
    early = write_shot(
        tmp_path / "1.dat", counts(), receivers=NEAR, trace_fields={"DELAY": "-0.010"}
    )
    found = SeismicImporter().read([early], None)
    assert found.labels[0].time_ns == START_NS + 10_000_000


def test_a_late_record_leaves_room_for_its_time_zero(tmp_path: Path) -> None:
    paths = [
        write_shot(
            tmp_path / f"{i}.dat",
            counts(),
            receivers=NEAR,
            second=i,
            trace_fields={"DELAY": "0.500"},
        )
        for i in range(2)
    ]
    found = SeismicImporter().read(paths, None)
    assert [(x.time_ns - START_NS) / 1e9 for x in impacts(found)] == [-0.5, 0.5]
    ((_, _, blocks),) = found.sources
    assert [(b.start_ns - START_NS) / 1e9 for b in blocks] == [0.0, 1.0]


def test_a_descaling_factor_makes_volts_and_none_leaves_counts(tmp_path: Path) -> None:
    plain = write_shot(tmp_path / "1.dat", counts(), receivers=NEAR)
    scaled = write_shot(
        tmp_path / "2.dat", counts(), receivers=NEAR, trace_fields={"DESCALING_FACTOR": "2.0E-4"}
    )
    ((without, _, _),) = SeismicImporter().read([plain], None).sources
    ((with_, name, (block,)),) = SeismicImporter().read([scaled], None).sources
    assert {(c.quantity, c.unit) for c in without.channels} == {("seismic", "count")}
    assert {(c.quantity, c.unit) for c in with_.channels} == {("voltage", "V")}
    assert name == "i32le"
    np.testing.assert_allclose(block.values, counts() * 2e-7)
    with pytest.raises(SchemaError, match="scales_v: expected in every shot or in none"):
        SeismicImporter().read([plain, scaled], None)


def test_a_changed_gain_keeps_the_volts(tmp_path: Path) -> None:
    paths = [
        write_shot(
            tmp_path / f"{i}.dat",
            counts(),
            receivers=NEAR,
            second=i,
            trace_fields={"DESCALING_FACTOR": f},
        )
        for i, f in enumerate(("1.0", "0.3"))
    ]
    ((_, _, (first, second)),) = SeismicImporter().read(paths, None).sources
    np.testing.assert_allclose(first.values, counts() * 1e-3)
    np.testing.assert_allclose(second.values, counts() * 0.3e-3)


def test_a_moved_spread_is_a_stream_of_its_own_and_places_keep_their_names(tmp_path: Path) -> None:
    paths = [
        write_shot(tmp_path / f"{i}.dat", counts(i), receivers=spread, second=i, source=str(i))
        for i, spread in enumerate((NEAR, FAR, FAR))
    ]
    found = SeismicImporter().read(paths, None)
    names = {s.topic: [c.name for c in s.channels] for s, _, _ in found.sources}
    assert names == {"/seismic/1": ["G01", "G02", "G03"], "/seismic/2": ["G03", "G04", "G05"]}
    starts = [[b.start_ns - START_NS for b in blocks] for _, _, blocks in found.sources]
    assert starts == [[0], [1_000_000_000, 2_000_000_000]]
    assert found.geometry is not None
    assert [s.x for s in found.geometry.sensors] == [0.0, 4.0, 8.0, 12.0, 16.0]
    assert found.warnings == ("the spread was moved: 2 streams, receivers named by place",)


def test_shots_without_positions_are_named_by_channel(tmp_path: Path) -> None:
    path = write_shot(tmp_path / "1.dat", counts(), source=None)
    found = SeismicImporter().read([path], None)
    assert found.geometry is None
    assert [c.name for c in found.sources[0][0].channels] == ["G01", "G02", "G03"]
    assert found.labels[0].x_m is None


def test_shots_of_another_rate_are_refused(tmp_path: Path) -> None:
    a = write_shot(tmp_path / "1.dat", counts(), receivers=NEAR)
    b = write_shot(tmp_path / "2.dat", counts(), receivers=NEAR, rate_hz=500.0)
    with pytest.raises(SchemaError, match="2: sampling rate: expected 1000 Hz as in 1, found 500"):
        SeismicImporter().read([a, b], None)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"DELAY": "nan"}, "1.dat: DELAY: expected a number, found 'nan'"),
        ({"RECEIVER_LOCATION": "1 2 3 4"}, "1.dat: RECEIVER_LOCATION: expected one to three"),
        ({"SOURCE_LOCATION": "here"}, "1.dat: SOURCE_LOCATION: expected one to three"),
    ],
)
def test_a_header_that_makes_no_sense_is_refused(
    tmp_path: Path, fields: dict[str, str], message: str
) -> None:
    path = write_shot(tmp_path / "1.dat", counts(), source=None, trace_fields=fields)
    with pytest.raises(FormatError, match=message):
        SeismicImporter().read([path], None)


def test_bytes_that_are_no_seismic_file_are_refused(tmp_path: Path) -> None:
    torn = write_shot(tmp_path / "1.dat", counts(), receivers=NEAR)
    torn.write_bytes(torn.read_bytes()[:150])
    empty = tmp_path / "a.mseed"
    empty.write_bytes(b"")
    for path in (torn, empty):
        with pytest.raises(FormatError, match=rf"{path.name}: (trace 1: )?expected"):
            SeismicImporter().read([path], None)


def test_without_obspy_one_line_says_how_to_get_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_shot(tmp_path / "1.dat", counts(), receivers=NEAR)
    monkeypatch.setitem(sys.modules, "obspy", None)
    with pytest.raises(MissingReaderError, match=r"1.dat: .*pip install 'groundtrace\[seismic\]'"):
        SeismicImporter().read([path], None)


def obspy_file(path: Path, format_: str, *, gap: bool = False) -> Path:
    """Write two channels with ObsPy itself; with a gap, each in two segments."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from obspy import Stream, Trace, UTCDateTime

        start = UTCDateTime(2020, 1, 1, 0, 0, 0, 250_000)
        traces = []
        for code, sign in (("EHZ", 1), ("EHN", -1)):
            for begin in (0, 150) if gap else (0,):
                data = sign * np.arange(begin, begin + 100, dtype=np.int32)
                head = {"network": "XX", "station": "ABC", "channel": code, "sampling_rate": 100}
                traces.append(Trace(data, head | {"starttime": start + begin / 100}))
        if format_ == "SEGY":
            for trace in traces:
                trace.data = trace.data.astype(np.float32)
        if format_ == "SAC":
            traces = traces[:1]
        Stream(traces).write(str(path), format=format_)
    return path


def test_miniseed_gives_one_stream_of_traces_that_go_together(tmp_path: Path) -> None:
    path = obspy_file(tmp_path / "a.mseed", "MSEED")
    found = SeismicImporter().read([path], None)
    ((stream, name, (block,)),) = found.sources
    assert SeismicImporter().sniff(path) == 0.9
    axes = {c.name: c.axis for c in stream.channels}
    assert axes == {"XX.ABC..EHZ": "z", "XX.ABC..EHN": "y"}
    assert (stream.rate_hz, name, len(block)) == (100.0, "i16le", 100)
    assert found.start_ns == block.start_ns == 1_577_836_800_250_000_000


def test_a_gap_in_miniseed_is_a_jump(tmp_path: Path) -> None:
    found = SeismicImporter().read([obspy_file(tmp_path / "a.mseed", "MSEED", gap=True)], None)
    ((_, _, blocks),) = found.sources
    assert [(b.first, len(b)) for b in blocks] == [(0, 100), (150, 100)]
    assert sorted(list(blocks)[1].samples[0].tolist()) == [-150, 150]


def test_sac_is_read(tmp_path: Path) -> None:
    found = SeismicImporter().read([obspy_file(tmp_path / "a.sac", "SAC")], None)
    assert found.sources[0][0].channels[0].name == "XX.ABC..EHZ"
    assert found.start_ns == 1_577_836_800_250_000_000


def test_segy_is_read_with_a_warning_about_its_start(tmp_path: Path) -> None:
    found = SeismicImporter().read([obspy_file(tmp_path / "a.sgy", "SEGY")], None)
    assert [c.name for c in found.sources[0][0].channels] == ["G01", "G02"]
    assert found.warnings == ("SEGY: the start time has whole seconds only",)


def test_formats_do_not_mix_with_shots_and_maps_are_refused(tmp_path: Path) -> None:
    shot = write_shot(tmp_path / "1.dat", counts(), receivers=NEAR)
    other = obspy_file(tmp_path / "a.mseed", "MSEED")
    with pytest.raises(
        SchemaError, match=r"1.dat: expected shots of one format, found MSEED, SEG2"
    ):
        SeismicImporter().read([shot, other], None)


PICKS = """3 # shot/geophone points
#x y
-5.00 600.0
0.00 601.0
4.00 602.5
2 # measurements
#s g t
1 2 0.010
1 3 0.0205
"""


def line(folder: Path) -> tuple[Geometry, tuple[Label, ...]]:
    path = write_shot(folder / "1.dat", counts(), receivers=NEAR, source="-5.0")
    found = SeismicImporter().read([path], None)
    assert found.geometry is not None
    return found.geometry, found.labels


def test_hand_picks_find_their_shot_and_channel_by_place(tmp_path: Path) -> None:
    geometry, labels = line(tmp_path)
    (tmp_path / "a.sgt").write_text(PICKS)
    picks = read_truth(tmp_path / "a.sgt", start_ns=START_NS, geometry=geometry, labels=labels)
    assert picks == (
        Label(START_NS + 10_000_000, "pick", channel="G01", label="1"),
        Label(START_NS + 20_500_000, "pick", channel="G02", label="1"),
    )


def test_points_of_three_coordinates_are_compared_in_the_plan(tmp_path: Path) -> None:
    path = tmp_path / "a.sgt"
    path.write_text("2\n#x y z\n1 2 9\n3 4 9\n1\n#s g err t\n1 2 0.1 0.5\n")
    geometry = Geometry(sensors=(Sensor("A", "A", 3.0, 5.0), Sensor("B", "B", 3.0, 4.0)))
    impacts = [Label(7, "impact", x_m=1.0, y_m=2.0, label="s")]
    assert picks_of(read_sgt(path), geometry, impacts) == (
        Label(500_000_007, "pick", channel="B", label="s"),
    )


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("3 #", "x #", "a.sgt: line 1: expected a count of rows, found 'x # shot"),
        ("#x y\n", "#x z\n", "a.sgt: line 2: expected columns x y, found '#x z'"),
        ("601.0", "high", "a.sgt: line 4: expected 2 numbers, found '0.00 high'"),
        ("0.010", "", "a.sgt: line 8: expected 3 numbers, found '1 2'"),
        ("1 3 0.0205\n", "", "a.sgt: end: expected a row of numbers, found none"),
        ("1 3 ", "1 4 ", "a.sgt: measurements: expected points 1 to 3, found 4"),
        ("1 3 ", "0 3 ", "a.sgt: measurements: expected points 1 to 3, found 0"),
        ("-5.00", "-6.00", "a.sgt: shot 1: expected one in the recording at -6 m, found 0"),
        ("4.00 6", "5.00 6", "a.sgt: geophone 3: expected one in the recording at 5 m, found 0"),
    ],
)
def test_picks_that_do_not_fit_are_refused_in_one_line(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    geometry, labels = line(tmp_path)
    path = tmp_path / "a.sgt"
    path.write_text(PICKS.replace(old, new, 1))
    with pytest.raises(SchemaError, match=message):
        read_truth(path, start_ns=START_NS, geometry=geometry, labels=labels)


def miniseed(path: Path, n: int = 3000) -> bytearray:
    from obspy import Trace

    trace = Trace(np.arange(n, dtype="i4"))
    trace.stats.update({"network": "XX", "station": "ABC", "channel": "EHZ", "sampling_rate": 100})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        trace.write(str(path), format="MSEED", reclen=512, encoding="INT32")
    return bytearray(path.read_bytes())


def test_an_empty_record_of_miniseed_keeps_the_others(tmp_path: Path) -> None:
    path = tmp_path / "a.mseed"
    data = miniseed(path)
    data[3 * 512 + 30 : 3 * 512 + 32] = bytes(2)  # its number of samples
    path.write_bytes(data)
    found = SeismicImporter().read([path], None)
    ((_, _, blocks),) = found.sources
    samples = np.concatenate([b.samples[:, 0] for b in blocks])
    lost = set(range(3000)) - set(samples.tolist())
    assert 0 < len(lost) <= 126
    assert found.warnings == ("a.mseed: 1 of 3 traces hold no samples: left out",)


def test_a_record_of_miniseed_that_is_none_is_told(tmp_path: Path) -> None:
    path = tmp_path / "a.mseed"
    data = miniseed(path)
    data[3 * 512 : 4 * 512] = bytes(512)
    path.write_bytes(data)
    found = SeismicImporter().read([path], None)
    assert any("Not a SEED record" in line for line in found.warnings)


def full_seed(data: bytes) -> bytes:
    """Return miniSEED behind a volume header, as full SEED has it."""
    volume = b"000001V 010009502.3092024,122,00:00:00.0000~2038,001,00:00:00.0000~"
    return volume.ljust(512) + data


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("form", ["SAC", "SEGY", "SU"])
def test_a_trace_is_known_by_its_content_under_any_name(
    form: str, order: str, tmp_path: Path
) -> None:
    from obspy import Trace

    values = np.arange(300, dtype="f4")
    trace = Trace(values)
    trace.stats.sampling_rate = 100
    path = tmp_path / "recorder.out"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        trace.write(str(path), format=form, byteorder=order)
    importer = choose([path])
    assert importer.name == "obspy"
    ((_, _, blocks),) = importer.read([path], None).sources
    np.testing.assert_array_equal(np.concatenate([b.samples[:, 0] for b in blocks]), values)


def test_seed_with_a_volume_header_is_known_by_its_content(tmp_path: Path) -> None:
    path = tmp_path / "station.dat"
    path.write_bytes(full_seed(bytes(miniseed(tmp_path / "a.mseed"))))
    ((_, _, blocks),) = choose([path]).read([path], None).sources
    assert sum(len(b) for b in blocks) == 3000


def test_text_and_other_binary_files_are_not_taken_for_traces(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    rng = np.random.default_rng(3)
    for k in range(200):
        path.write_bytes(rng.bytes(4096 + k))
        assert SeismicImporter().sniff(path) == 0
    path.write_bytes(bytes(8192))
    assert SeismicImporter().sniff(path) == 0


def drifting_miniseed(path: Path, encoding: str, *, by_channel: bool) -> Path:
    """Write records of three channels, one short: a clock 200 ppm off, and a gap."""
    import obspy

    rng = np.random.default_rng(5)
    kind = {"INT32": np.int32, "STEIM2": np.int32, "FLOAT32": np.float32}[encoding]
    records = []
    for channel, count in (("EHZ", 40), ("EHN", 40), ("EHE", 33)):
        for k in range(count):
            late = 100 * 3.0 if k >= 20 else 0.0
            start = obspy.UTCDateTime(2026, 1, 1) + k * 1.0 * 1.0002 + late
            data = rng.integers(-500, 500, 100).astype(kind)
            head = {"station": "A", "channel": channel, "sampling_rate": 100.0, "starttime": start}
            out = io.BytesIO()
            obspy.Trace(data, head).write(out, format="MSEED", reclen=512, encoding=encoding)
            records.append((k, out.getvalue()))
    ordered = records if by_channel else sorted(records, key=lambda record: record[0])
    path.write_bytes(b"".join(data for _, data in ordered))
    return path


def read_in_parts(path: Path, size: int, monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    monkeypatch.setattr("groundtrace_codecs.importers.seismic._PIECE_BYTES", size)
    found = SeismicImporter().read([path], None)
    return [
        (stream, form, [(b.anchor_ns, b.first, b.samples.tolist()) for b in blocks])
        for stream, form, blocks in found.sources
    ]


@pytest.mark.parametrize("encoding", ["INT32", "STEIM2", "FLOAT32"])
@pytest.mark.parametrize("by_channel", [True, False])
def test_miniseed_read_in_parts_is_what_it_is_as_a_whole(
    encoding: str, by_channel: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = drifting_miniseed(tmp_path / "a.mseed", encoding, by_channel=by_channel)
    whole = read_in_parts(path, 1 << 22, monkeypatch)
    assert len(whole) == 2  # the short channel is a stream of its own
    assert [len(blocks) for _, _, blocks in whole] == [2, 2]
    for size in (513, 3000, 8192):
        assert read_in_parts(path, size, monkeypatch) == whole


def test_a_record_that_claims_more_samples_than_bytes_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.mseed"
    data = miniseed(path)
    data[512 + 30 : 512 + 32] = b"\xff\xff"
    path.write_bytes(data)
    with pytest.raises(FormatError, match=r"a.mseed: byte 512: expected at most 11. samples in a"):
        SeismicImporter().read([path], None)


def test_a_time_that_is_none_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.mseed"
    data = miniseed(path, 100)
    data[32:36] = (1).to_bytes(2, "big") + (-32768).to_bytes(2, "big", signed=True)
    data[32:34] = (-32768).to_bytes(2, "big", signed=True)
    path.write_bytes(data)
    with pytest.raises(FormatError, match=r"a.mseed: XX.ABC..EHZ: expected times within 146 years"):
        SeismicImporter().read([path], None)
