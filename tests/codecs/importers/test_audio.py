"""Sound files of recorders, written with soundfile."""

from __future__ import annotations

import struct
import sys
from typing import TYPE_CHECKING

import numpy as np
import pytest
import soundfile
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sweeps import examples

from groundtrace_codecs.errors import CodecError, FormatError, MissingReaderError, SchemaError
from groundtrace_codecs.importers.audio import AudioImporter
from groundtrace_codecs.importers.map import load_map
from groundtrace_codecs.importers.run import choose, import_recording
from groundtrace_codecs.recording import Recording

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from groundtrace_codecs.importers.base import Imported

RATE_HZ = 8000
BITS = {"PCM_16": 16, "PCM_24": 24, "PCM_32": 32}


def samples(bits: int, count: int = 20_000, channels: int = 3) -> NDArray[np.int64]:
    limit = 2 ** (bits - 1)
    found = np.random.default_rng(bits).integers(-limit, limit, (count, channels))
    found[:2, 0] = -limit, limit - 1
    return found


def sound(path: Path, values: NDArray[np.int64], subtype: str = "PCM_24") -> Path:
    """Write integers of the subtype's width, which soundfile takes at the top of 32 bits."""
    data = (values << (32 - BITS[subtype])).astype(np.int32)
    soundfile.write(path, data, RATE_HZ, subtype=subtype)
    return path


def stored(out: Path, topic: str = "/seismic") -> NDArray[np.float64]:
    with Recording.open(out) as opened:
        return np.concatenate([b.samples for _, b in opened.blocks({topic})])


@pytest.mark.parametrize(
    ("suffix", "subtype"),  # libsndfile writes no FLAC of 32 bits
    [(s, p) for s in ("wav", "flac", "rf64", "w64") for p in BITS if (s, p) != ("flac", "PCM_32")],
)
def test_every_sample_is_the_converters_integer(tmp_path: Path, suffix: str, subtype: str) -> None:
    values = samples(BITS[subtype])
    path = sound(tmp_path / f"x.{suffix}", values, subtype)
    assert choose([path]).name == "audio"
    report = import_recording([path], tmp_path / "out.mcap")
    assert report.samples == {"/seismic": 20_000}
    assert report.warnings == (
        f"x.{suffix}: samples are counts: a map gives the unit of the channels",
    )
    assert np.array_equal(stored(tmp_path / "out.mcap"), values)
    with Recording.open(tmp_path / "out.mcap") as opened:
        (stream,) = opened.streams
    assert (stream.rate_hz, [c.unit for c in stream.channels]) == (8000.0, ["count"] * 3)


@pytest.mark.parametrize(("subtype", "dtype"), [("FLOAT", np.float32), ("DOUBLE", np.float64)])
def test_floating_samples_keep_every_bit(tmp_path: Path, subtype: str, dtype: type) -> None:
    values = np.random.default_rng(1).normal(size=(5000, 2)).astype(dtype)
    soundfile.write(tmp_path / "x.wav", values, RATE_HZ, subtype=subtype)
    import_recording([tmp_path / "x.wav"], tmp_path / "out.mcap")
    assert np.array_equal(stored(tmp_path / "out.mcap"), values)


def the_map(folder: Path, columns: str, more: str = "") -> Path:
    path = folder / "map.toml"
    path.write_text(
        f'format = "audio"\n{more}\n[[stream]]\ntopic = "/seismic"\ncolumns = [{columns}]\n'
    )
    return path


def test_a_map_gives_names_units_and_start(tmp_path: Path) -> None:
    values = samples(24)
    path = sound(tmp_path / "x.wav", values)
    columns = (
        '{column = 2, quantity = "ground_velocity", unit = "mm/s", axis = "z", scale = 1e-5, '
        'name = "G1"}'
    )
    map_ = the_map(tmp_path, columns, "start = 2024-05-01T12:00:00Z")
    report = import_recording([path], tmp_path / "out.mcap", map_path=map_)
    assert (report.importer, report.warnings) == ("audio", ())
    assert report.start_ns == 1_714_564_800_000_000_000
    with Recording.open(tmp_path / "out.mcap") as opened:
        channel = opened.streams[0].channels[0]
        block = next(b for _, b in opened.blocks())
    assert (channel.name, channel.unit, channel.axis) == ("G1", "m/s", "z")
    assert block.values[0, 0] == pytest.approx(values[0, 2] * 1e-8, rel=1e-12)


def test_a_map_that_does_not_fit_the_file_is_refused(tmp_path: Path) -> None:
    path = sound(tmp_path / "x.wav", samples(24, 100))
    beyond = the_map(tmp_path, '{column = 3, quantity = "seismic", unit = "count"}')
    with pytest.raises(SchemaError, match=r"channels 0 to 2 of x\.wav, found 3"):
        AudioImporter().read([path], load_map(beyond))
    rated = the_map(
        tmp_path, '{column = 0, quantity = "seismic", unit = "count"}', "rate_hz = 48000.0"
    )
    with pytest.raises(SchemaError, match="expected the rate of the file"):
        load_map(rated)


def test_files_of_one_recorder_follow_each_other(tmp_path: Path) -> None:
    values = samples(24)
    paths = [
        sound(tmp_path / "a.wav", values[:7000]),
        sound(tmp_path / "b.wav", values[7000:]),
    ]
    report = import_recording(paths, tmp_path / "out.mcap")
    said = "2 files: each taken to go on where the one before ends"
    assert any(w.startswith(said) for w in report.warnings)
    assert np.array_equal(stored(tmp_path / "out.mcap"), values)
    other = sound(tmp_path / "c.wav", values[:, :2])
    with pytest.raises(SchemaError, match=r"c\.wav: channels: expected 3 as in a\.wav, found 2"):
        AudioImporter().read([paths[0], other], None)


def with_bext(path: Path, date: bytes, time: bytes, reference: int) -> None:
    """Put a ``bext`` chunk before the samples, as field recorders do."""
    content = bytes(320) + date + time + struct.pack("<Q", reference) + bytes(256)
    data = path.read_bytes()
    chunk = b"bext" + struct.pack("<I", len(content)) + content
    size = struct.unpack("<I", data[4:8])[0] + len(chunk)
    path.write_bytes(data[:4] + struct.pack("<I", size) + data[8:12] + chunk + data[12:])


@pytest.mark.parametrize(
    ("reference", "after_ns"),
    [(RATE_HZ * 3600 + 1, 3600 * 10**9 + 125_000), (0, 13 * 3600 * 10**9 + 5 * 10**9)],
)
def test_a_broadcast_wav_starts_when_its_recorder_said(
    tmp_path: Path, reference: int, after_ns: int
) -> None:
    path = sound(tmp_path / "x.wav", samples(24, 100))
    with_bext(path, b"2024-05-01", b"13:00:05", reference)
    found = AudioImporter().read([path], None)
    assert found.start_ns == 1_714_521_600_000_000_000 + after_ns
    assert "x.wav: the recorder's clock is taken as UTC" in found.warnings


def test_a_wav_cut_short_gives_what_it_has_and_says_so(tmp_path: Path) -> None:
    values = samples(24)
    path = sound(tmp_path / "x.wav", values)
    path.write_bytes(path.read_bytes()[: -9 * 5000])
    report = import_recording([path], tmp_path / "out.mcap")
    assert any("cut short: 45000 bytes" in w for w in report.warnings)
    assert np.array_equal(stored(tmp_path / "out.mcap"), values[:15_000])


def test_a_flac_cut_short_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    path = sound(tmp_path / "x.flac", samples(24))
    path.write_bytes(path.read_bytes()[:100_000])
    with pytest.raises(FormatError, match=r"^x\.flac: expected [^\n]+$"):
        import_recording([path], tmp_path / "out.mcap")
    assert not list(tmp_path.glob("out*"))


def test_lossy_sound_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.ogg"
    soundfile.write(path, np.zeros((8000, 1)), RATE_HZ, format="OGG", subtype="VORBIS")
    with pytest.raises(FormatError, match=r"expected one of .*, found VORBIS"):
        AudioImporter().read([path], None)


def read(path: Path) -> Imported:
    return AudioImporter().read([path], None)


def test_a_long_file_is_read_in_parts(tmp_path: Path) -> None:
    path = sound(tmp_path / "x.wav", samples(16, 200_000, 1), "PCM_16")
    ((_, form, blocks),) = read(path).sources
    assert form == "i16le"
    assert [len(b) for b in blocks] == [65_536, 65_536, 65_536, 3_392]


def test_without_soundfile_the_error_names_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = sound(tmp_path / "x.wav", samples(24, 10))
    monkeypatch.setitem(sys.modules, "soundfile", None)
    with pytest.raises(MissingReaderError, match=r"pip install 'groundtrace\[audio\]'"):
        read(path)


@pytest.mark.parametrize(
    ("date", "count"),
    [(b"9999-05-01", 0), (b"2261-12-31", 8000 * 40_000_000), (b"2024-05-01", 2**63)],
)
def test_a_start_beyond_all_clocks_is_refused(tmp_path: Path, date: bytes, count: int) -> None:
    path = sound(tmp_path / "x.wav", samples(24, 100))
    with_bext(path, date, b"13:00:05", count)
    with pytest.raises(CodecError, match="bext"):
        read(path)


@settings(max_examples=examples(80), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    head=st.sampled_from([b"", b"fLaC", b"RIFF\x40\0\0\0WAVEfmt ", b"RF64\xff\xff\xff\xffWAVE"]),
    body=st.binary(max_size=200),
)
def test_any_bytes_give_the_importers_own_error(tmp_path: Path, head: bytes, body: bytes) -> None:
    path = tmp_path / "any.wav"
    path.write_bytes(head + body)
    AudioImporter().sniff(path)
    with pytest.raises(CodecError):
        read(path)


@settings(max_examples=examples(60), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(place=st.integers(0, 400), value=st.integers(0, 255))
def test_a_changed_byte_gives_samples_or_the_importers_own_error(
    tmp_path: Path, place: int, value: int
) -> None:
    path = sound(tmp_path / "x.wav", samples(24, 100))
    with_bext(path, b"2024-05-01", b"13:00:05", 0)
    data = bytearray(path.read_bytes())
    data[place] = value
    path.write_bytes(data)
    try:
        ((_, _, blocks),) = read(path).sources
        assert sum(len(b) for b in blocks) > 0
    except CodecError as error:
        assert "\n" not in str(error)  # noqa: PT017 (either outcome is right)
