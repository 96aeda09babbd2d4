"""``groundtrace export`` to miniSEED and QuakeML: ObsPy reads what was recorded and picked."""

from __future__ import annotations

import io
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from command_runs import done, run

from groundtrace.export.seismic import encoding_of, seed_codes
from groundtrace.pipeline.results import read_results
from groundtrace_codecs.events import Pick
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import Channel, SignalBlock, Stream
from groundtrace_codecs.writer import write_recording
from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

pytest.importorskip("obspy", reason="ObsPy is not installed")

Capture = pytest.CaptureFixture[str]
START_NS = 1_700_000_000_123_456_789
ROOM = path_of("room-walk.mcap")


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def traces_of(path: str) -> dict[str, list[Any]]:
    """Return ObsPy's traces by id, in order of time."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # ObsPy's own, of its imports
        from obspy import read

        found: dict[str, list[Any]] = {}
        for trace in read(io.BytesIO(Path(path).read_bytes())):
            found.setdefault(trace.id, []).append(trace)
    return {name: sorted(ts, key=lambda t: int(t.stats.starttime.ns)) for name, ts in found.items()}


def recording(
    path: Path, sample_format: str, rate_hz: float, parts: list[tuple[int, NDArray[Any]]]
) -> Stream:
    """Write contiguous parts of a stream, each at its first index."""
    count = parts[0][1].shape[1]
    channels = tuple(Channel(f"G{i + 1}", "seismic", "count", "z") for i in range(count))
    stream = Stream("/seismic", channels, rate_hz)
    blocks = [SignalBlock(stream, START_NS, first, samples) for first, samples in parts]
    write_recording(path, [(stream, sample_format, blocks)])
    return stream


@pytest.mark.parametrize(
    ("sample_format", "dtype"),
    [("i16le", np.int16), ("i32le", np.int32), ("f32le", np.float32), ("f64le", np.float64)],
)
@pytest.mark.parametrize("rate_hz", [100.0, 4000 / 3, 20_000.0])
def test_every_sample_comes_back_and_a_gap_ends_a_trace(
    sample_format: str, dtype: type[Any], rate_hz: float, capsys: Capture
) -> None:
    random = np.random.default_rng(5)
    lengths, gap = (1500, 2500), 37
    top = np.iinfo(dtype).max if np.issubdtype(dtype, np.integer) else 2**40
    values = random.uniform(-float(top), float(top), (sum(lengths), 2)).astype(dtype)
    parts = [(0, values[: lengths[0]]), (lengths[0] + gap, values[lengths[0] :])]
    recording(Path("r.mcap"), sample_format, rate_hz, parts)
    done(capsys, "export", "r.mcap", "-o", "r.mseed")
    found = traces_of("r.mseed")
    assert [name.split(".")[1] for name in found] == ["G1", "G2"]
    for column, traces in enumerate(found.values()):
        for trace, (first, samples) in zip(traces, parts, strict=True):
            np.testing.assert_array_equal(trace.data, samples[:, column])
            expected_ns = START_NS + round(first * 1e9 / rate_hz)
            assert abs(int(trace.stats.starttime.ns) - expected_ns) <= 500
            # the format holds rates as float32 at best
            assert trace.stats.sampling_rate == pytest.approx(rate_hz, rel=1e-6)


def test_quiet_integers_are_packed_and_wild_ones_are_not() -> None:
    assert encoding_of(np.array([3, -4, 5], np.int16)) == "STEIM2"
    assert encoding_of(np.array([0, 2**29 - 1], np.int32)) == "STEIM2"
    assert encoding_of(np.array([-(2**31), 2**31 - 1], np.int32)) == "INT32"


def test_a_long_recording_is_one_trace_for_each_channel(capsys: Capture) -> None:
    samples = np.cumsum(np.random.default_rng(1).integers(-9, 10, (20_000, 2)), 0).astype(np.int32)
    recording(Path("long.mcap"), "i32le", 100.0, [(0, samples)])
    done(capsys, "export", "long.mcap", "-o", "long.mseed")
    for column, (trace,) in enumerate(traces_of("long.mseed").values()):
        np.testing.assert_array_equal(trace.data, samples[:, column])


def test_a_room_comes_back_by_import_as_it_was(capsys: Capture) -> None:
    done(capsys, "cut", ROOM, "-o", "room.mcap", "--to", 2)
    ran = done(capsys, "export", "room.mcap", "-o", "room.mseed")
    assert "XX.G1..JHZ is G1 of /seismic: ground_velocity, one is 5e-07 m/s" in ran.out
    done(capsys, "import", "room.mseed", "-o", "back.mcap")
    both = []
    for name in ("room.mcap", "back.mcap"):
        with Recording.open(name) as opened:
            blocks = [b for _, b in opened.blocks(["/seismic"])]
        times = np.concatenate([b.sample_times() for b in blocks])
        both.append((times, np.concatenate([b.samples for b in blocks])))
    np.testing.assert_array_equal(both[0][0], both[1][0])
    np.testing.assert_array_equal(both[0][1], both[1][1])


def test_streams_without_a_rate_are_left_out_and_told(capsys: Capture) -> None:
    phone = Stream("/phone", (Channel("m", "acceleration", "m/s2"),), 50.0, irregular=True)
    times = START_NS + np.cumsum(np.full(90, 20_000_000))
    block = SignalBlock(phone, START_NS, 0, np.ones((90, 1)), times)
    write_recording("phone.mcap", [(phone, "f64le", [block])])
    found = run(capsys, "export", "phone.mcap", "-o", "p.mseed").error
    assert found == "phone.mcap: expected a stream with a rate, found none"
    wave = Stream("/seismic", (Channel("G1", "seismic", "count"),), 100.0)
    second = SignalBlock(wave, START_NS, 0, np.ones((90, 1), np.int16))
    write_recording("both.mcap", [(phone, "f64le", [block]), (wave, "i16le", [second])])
    ran = done(capsys, "export", "both.mcap", "-o", "b.mseed")
    assert "/phone is left out: its samples have times of their own" in ran.out


def test_no_two_channels_share_a_code() -> None:
    axes = tuple(Channel(f"acc_{a}", "acceleration", "m/s2", a) for a in "xyz")
    names = ("IU.ANMO.00.BHZ", "Geophone 1", "Geophone-1", "TOOLONGNAME")
    seismic = tuple(Channel(name, "seismic", "count") for name in names)
    streams = [Stream("/imu/waist", axes, 100.0), Stream("/other/waist", axes, 100.0)]
    codes = seed_codes([*streams, Stream("/seismic", seismic, 500.0)])
    texts = [str(code) for code in codes.values()]
    assert len(set(texts)) == len(texts) == 10
    assert texts[0] == "XX.WAIST..EN1"
    assert texts[3] == "XX.WAIST.01.EN1"
    assert texts[6:] == ["IU.ANMO.00.BHZ", "XX.HONE1..DH0", "XX.HONE1.01.DH0", "XX.GNAME..DH0"]


def test_quakeml_holds_the_picks_of_a_replay(capsys: Capture) -> None:
    from obspy import read_events

    done(capsys, "cut", ROOM, "-o", "room.mcap", "--to", 3)
    done(capsys, "replay", "room.mcap", "--no-viewer", "--out", "room.results.mcap")
    done(capsys, "export", "room.results.mcap", "-o", "p.xml", "--stage", "picks")
    done(capsys, "export", "room.mcap", "-o", "room.mseed")
    events = read_results(Path("room.results.mcap")).events
    picks = [e for e in events if isinstance(e, Pick) and e.stage == "picks"]
    picks.sort(key=lambda p: p.time_ns)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # ObsPy's own, of its imports
        (event,) = read_events(io.BytesIO(Path("p.xml").read_bytes()))
    assert len(event.picks) == len(picks) > 10
    for found, pick in zip(event.picks, picks, strict=True):
        assert abs(int(found.time.ns) - pick.time_ns) <= 500
        assert found.waveform_id.station_code == pick.channel
        assert found.time_errors.uncertainty == pick.uncertainty_s
    codes = {found.waveform_id.get_seed_string() for found in event.picks}
    assert codes <= traces_of("room.mseed").keys()
