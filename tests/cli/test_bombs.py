"""A file of some kB that unpacks to a gigabyte takes no more memory than another, and is said."""

from __future__ import annotations

import pickle
import sqlite3
import struct
import tracemalloc
import zipfile
import zlib
from contextlib import closing, suppress
from itertools import product
from typing import TYPE_CHECKING

import h5py
import numpy as np
import pytest
import zstandard
from mcap_files import record
from rosbags import rosbag1
from rosbags.typesys import Stores, get_typestore
from sweeps import swept

from groundtrace.cli.main import main
from groundtrace_codecs import Channel, Recording, SignalBlock, Stream, write_recording
from groundtrace_codecs.mcap.chunks import CHANNEL, CHUNK, DATA_END, FOOTER, HEADER, MAGIC, MESSAGE

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

#: The most that a command may hold for a file of a megabyte [bytes].
MOST_BYTES = 300e6


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def message(payload: bytes) -> bytes:
    return record(MESSAGE, struct.pack("<HIQQ", 1, 0, 5, 5) + payload)


def chunk(records: bytes) -> bytes:
    packed = zstandard.ZstdCompressor().compress(records)
    head = struct.pack("<QQQI", 5, 5, len(records), 0) + text("zstd")
    return record(CHUNK, head + struct.pack("<Q", len(packed)) + packed)


def recording(path: Path, chunks: list[bytes]) -> Path:
    channel = record(CHANNEL, struct.pack("<HH", 1, 0) + text("/a") + text("raw") + bytes(4))
    end = record(DATA_END, bytes(4)) + record(FOOTER, bytes(20)) + MAGIC
    whole = MAGIC + record(HEADER, text("") + text("")) + channel + b"".join(chunks) + end
    assert len(whole) < 1_000_000
    path.write_bytes(whole)
    return path


def one_large_message(path: Path) -> Path:
    return recording(path, [chunk(message(bytes(500_000_000)))])


def many_empty_messages(path: Path) -> Path:
    return recording(path, [chunk(message(b"") * 5_000_000)])


def many_chunks_of_one_time(path: Path) -> Path:
    return recording(path, 6 * [chunk(message(bytes(30_000_000)))])


def many_unreadable_messages(path: Path) -> Path:
    imu = [f"{name}_{axis}" for name in ("acc", "gyro") for axis in "xyz"]
    units = 3 * [("acceleration", "m/s2")] + 3 * [("angular_velocity", "rad/s")]
    channels = (Channel(name, *unit) for name, unit in zip(imu, units, strict=True))
    stream = Stream("/imu", tuple(channels), 100.0)
    block = SignalBlock(stream, 0, 0, np.ones((100, 6)))
    write_recording(path, [(stream, "f32le", [block])], force=True)
    whole = path.read_bytes()
    summary = struct.unpack_from("<Q", whole, len(whole) - len(MAGIC) - 20)[0]
    end = record(DATA_END, bytes(4)) + record(FOOTER, bytes(20)) + MAGIC
    chunks = 4 * [chunk(message(b"") * 250_000)]
    path.write_bytes(whole[: summary - len(record(DATA_END, bytes(4)))] + b"".join(chunks) + end)
    return path


def held(command: list[object]) -> int:
    """Run a command; return the most memory that it held at once [bytes]."""
    tracemalloc.start()
    try:
        with suppress(SystemExit):
            main([str(word) for word in command])
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


#: By what makes a recording: what is said of it.
FOUND = {
    one_large_message: "expected at most 33554432 uncompressed bytes of",
    many_empty_messages: "expected at most 33554432 uncompressed bytes of",
    many_chunks_of_one_time: "expected overlapping chunks of at most 134217728 bytes, found",
}


@pytest.mark.parametrize(
    ("make", "command"),
    swept(
        product(FOUND, ("info", "doctor", "cut")),
        (many_empty_messages, "doctor"),
        (many_chunks_of_one_time, "cut"),
    ),
)
def test_a_small_file_takes_little_memory_and_is_told(
    make: Callable[[Path], Path], command: str, tmp_path: Path, capsys
) -> None:
    small = make(tmp_path / "small.mcap")
    more = ("-o", tmp_path / "cut.mcap", "--from", "0", "--to", "1") if command == "cut" else ()
    assert held([command, small, *more]) < MOST_BYTES
    if command != "info" or make is not many_chunks_of_one_time:  # info reads no messages
        said = capsys.readouterr()
        assert FOUND[make] in " ".join((said.out + said.err).split())


def test_a_recording_of_unreadable_messages_is_opened_in_little_memory(tmp_path: Path) -> None:
    small = many_unreadable_messages(tmp_path / "small.mcap")
    tracemalloc.start()
    try:
        with Recording.open(small) as recording:
            assert sum(recording.file.message_counts.values()) > 1_000_000
        assert tracemalloc.get_traced_memory()[1] < MOST_BYTES / 3
    finally:
        tracemalloc.stop()


ARCHIVE_MAP = """format = "{form}"
rate_hz = 1e6
[[stream]]
topic = "/s"
columns = [{{column = "{column}", quantity = "seismic", unit = "count"}}]
"""
#: An array that a header or a data set claims: 8 TB.
CLAIMED = 10**12


def npy(shape: tuple[int, ...], content: bytes) -> bytes:
    head = str({"descr": "<f8", "fortran_order": False, "shape": shape}).encode()
    head = head.ljust(117) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head + content


def zipped(path: Path, name: str, content: bytes, method: int = zipfile.ZIP_DEFLATED) -> Path:
    with zipfile.ZipFile(path, "w", method) as archive:
        archive.writestr(name, content)
    assert path.stat().st_size < 1_100_000
    return path


def npz_of_zeros(path: Path) -> Path:
    return zipped(path / "a.npz", "data.npy", npy((20_000_000,), bytes(160_000_000)))


def npz_by_another_method(path: Path) -> Path:
    return zipped(path / "a.npz", "data.npy", npy((8,), bytes(64)), zipfile.ZIP_LZMA)


def npz_that_lies(path: Path) -> Path:
    found = bytearray(npz_of_zeros(path).read_bytes())
    at = found.index(b"PK\x01\x02")
    found[at + 24 : at + 28] = struct.pack("<I", 4_000_000_000)
    (path / "a.npz").write_bytes(found)
    return path / "a.npz"


def npy_that_claims(path: Path) -> Path:
    (path / "a.npy").write_bytes(npy((CLAIMED,), bytes(800)))
    return path / "a.npy"


def npy_of_objects(path: Path) -> Path:
    np.save(path / "a.npy", np.array([Planted(), 2], object), allow_pickle=True)
    return path / "a.npy"


class Planted:
    """What runs code where it is unpickled."""

    def __reduce__(self) -> tuple[Callable[..., object], tuple[str, ...]]:
        return pytest.exit, ("a pickle was run",)


def phone_table_of_zeros(path: Path) -> Path:
    head = b"time,seconds_elapsed,z,y,x\n"
    return zipped(path / "a.zip", "Gyroscope.csv", head + b"0,0,0,0,0\n" * 10_000_000)


def hdf5_that_claims(path: Path) -> Path:
    with h5py.File(path / "a.h5", "w") as file:
        file.create_dataset("data", (CLAIMED,), "f8", chunks=(1024,), compression="gzip")
    return path / "a.h5"


def hdf5_in_one_chunk(path: Path) -> Path:
    with h5py.File(path / "a.h5", "w") as file:
        file.create_dataset("data", data=np.zeros(20_000_000), chunks=(20_000_000,), compression=9)
    return path / "a.h5"


def hdf5_elsewhere(path: Path) -> Path:
    with h5py.File(path / "b.h5", "w") as file:
        file["data"] = np.arange(1000.0)
    with h5py.File(path / "a.h5", "w") as file:
        file["data"] = h5py.ExternalLink("b.h5", "data")
    return path / "a.h5"


def hdf5_of_raw_bytes_elsewhere(path: Path) -> Path:
    with h5py.File(path / "a.h5", "w") as file:
        file.create_dataset("data", (100,), "u1", external=[("/etc/passwd", 0, 100)])
    return path / "a.h5"


def hdf5_virtual(path: Path) -> Path:
    layout = h5py.VirtualLayout((100,), "f8")
    layout[:] = h5py.VirtualSource("b.h5", "data", (100,))
    with h5py.File(path / "a.h5", "w") as file:
        file.create_virtual_dataset("data", layout)
    return path / "a.h5"


def hdf5_of_one_text_many_times(path: Path) -> Path:
    with h5py.File(path / "a.h5", "w") as file:
        file["data"] = ["x" * 50_000] * 1000
    return path / "a.h5"


def matlab(path: Path, type_: int, inside: bytes) -> Path:
    packed = zlib.compress(struct.pack("<II", type_, len(inside)) + inside, 9)
    (path / "a.mat").write_bytes(
        b"MATLAB 5.0".ljust(124) + b"\x00\x01IM" + struct.pack("<II", 15, len(packed)) + packed
    )
    return path / "a.mat"


def array_of(class_: int, count: int, content: bytes) -> bytes:
    head = struct.pack("<4I", 6, 8, class_, 0) + struct.pack("<IIii", 5, 8, count, 1)
    return head + struct.pack("<HH4s", 1, 4, b"data") + content


def matlab_of_zeros(path: Path) -> Path:
    zeros = struct.pack("<II", 9, 160_000_000) + bytes(160_000_000)
    return matlab(path, 14, array_of(6, 20_000_000, zeros))


def matlab_of_small_numbers(path: Path) -> Path:
    zeros = struct.pack("<II", 2, 15_000_000) + bytes(15_000_000)
    return matlab(path, 14, array_of(6, 15_000_000, zeros))


def matlab_of_cells(path: Path) -> Path:
    return matlab(path, 14, array_of(1, 3_000_000, struct.pack("<II", 14, 0) * 3_000_000))


def table_of_one_line(path: Path) -> Path:
    with (path / "a.csv").open("wb") as file:
        file.write(b"data\n1\n")
        file.truncate(1_000_000_000)
    return path / "a.csv"


def table_of_columns(path: Path) -> Path:
    (path / "a.csv").write_text(",".join(["data"] * 1_000_000) + "\n1\n2\n")
    return path / "a.csv"


def pickle_called_seismic(path: Path) -> Path:
    (path / "a.mseed").write_bytes(pickle.dumps(Planted()))
    return path / "a.mseed"


def bag_of_zeros(path: Path) -> Path:
    writer = rosbag1.Writer(path / "a.bag")
    writer.set_compression(rosbag1.Writer.CompressionFormat.BZ2)
    with writer as bag:
        store = get_typestore(Stores.ROS1_NOETIC)
        topic = bag.add_connection("/imu", "sensor_msgs/msg/Imu", typestore=store)
        bag.write(topic, 1, bytes(60_000_000))
    return path / "a.bag"


def bag_without_end(path: Path) -> Path:
    with closing(sqlite3.connect(path / "a.db3")) as bag, bag:
        bag.execute("CREATE TABLE messages_of(id INTEGER)")
        bag.execute("CREATE VIEW messages AS SELECT 1 AS id, zeroblob(900000000) AS data")
        bag.execute("CREATE TABLE topics(id INTEGER, name TEXT, type TEXT)")
    return path / "a.db3"


@pytest.mark.parametrize(
    ("make", "found"),
    [
        (npz_by_another_method, "a.npz: data: expected data that are stored or deflated, found"),
        (npz_that_lies, "a.npz: data: expected at most 160"),
        (npy_that_claims, "a.npy: expected 8000000000000 bytes of shape (1000000000000,), found"),
        (npy_of_objects, "a.npy: expected a NumPy archive without pickled objects, found some"),
        (
            phone_table_of_zeros,
            "a.zip: Gyroscope.csv: expected at most 33554432 uncompressed",
        ),
        (hdf5_that_claims, "a.h5: /data: expected at most 33554432 uncompressed bytes of 0"),
        (hdf5_in_one_chunk, "a.h5: /data: expected chunks of at most 134217728 bytes, found"),
        (hdf5_elsewhere, "a.h5: data: expected data in the file itself, found a link to another"),
        (hdf5_of_raw_bytes_elsewhere, "a.h5: /data: expected data in the file itself, found"),
        (hdf5_virtual, "a.h5: /data: expected data in the file itself, found data of other files"),
        (hdf5_of_one_text_many_times, "a.h5: /data: expected at most 33554432 bytes of texts"),
        (matlab_of_cells, "a.mat: expected at most 33554432 uncompressed bytes of"),
        (table_of_one_line, "a.csv: line 3: expected less than 1048576 characters, found more"),
        (table_of_columns, "a.csv: line 1: expected less than 1048576 characters, found more"),
        (pickle_called_seismic, "a.mseed: expected a seismic file ObsPy can read, found another"),
        (bag_of_zeros, "expected at most 33554432 uncompressed bytes of"),
        (bag_without_end, "a.db3: messages: expected a table of values, found a view of computed"),
    ],
)
def test_a_small_file_of_another_tool_takes_little_memory_and_is_told(
    make: Callable[[Path], Path], found: str, tmp_path: Path, capsys
) -> None:
    small = make(tmp_path)
    out = tmp_path / "out.mcap"
    form = {".npy": "npz", ".npz": "npz", ".h5": "hdf5", ".mat": "mat", ".csv": "csv"}
    command: list[object] = ["import", small, "-o", out]
    if small.suffix in form:
        text = ARCHIVE_MAP.format(form=form[small.suffix], column="data")
        (tmp_path / "map.toml").write_text(text)
        command += ["--map", tmp_path / "map.toml"]
    assert held(command) < MOST_BYTES
    said = " ".join(capsys.readouterr().err.split())
    assert not out.exists()
    assert found in said


@pytest.mark.parametrize(
    ("make", "form"),
    swept(
        [(npz_of_zeros, "npz"), (matlab_of_zeros, "mat"), (matlab_of_small_numbers, "mat")],
        (matlab_of_small_numbers, "mat"),
    ),
)
def test_what_can_be_so_long_is_imported_in_little_memory(
    make: Callable[[Path], Path], form: str, tmp_path: Path
) -> None:
    small, out, map_ = make(tmp_path), tmp_path / "out.mcap", tmp_path / "map.toml"
    map_.write_text(ARCHIVE_MAP.format(form=form, column="data"))
    assert held(["import", small, "-o", out, "--map", map_]) < MOST_BYTES / 3
    assert out.exists()
