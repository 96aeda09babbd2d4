"""Peak memory and time of importing large files of each kind: docs/notebook/memory.md.

Run: python bench/import_memory.py [--gigabytes 2] [--only KIND ...] [--folder FOLDER]

Files of seismometers hold --gigabytes; those of worn sensors, which sample at 500 Hz, half an hour
for each.
"""

from __future__ import annotations

import argparse
import io
import shutil
import struct
import subprocess
import sys
import tempfile
import zipfile
import zlib
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from big_memory import MAIN, peak

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

CHANNELS, RATE_HZ = 16, 20_000
#: Rows made at once.
ROWS = 1 << 17
MAP = """format = "{form}"
time = {{column = "t"}}
[[stream]]
topic = "/seismic"
columns = [{columns}]
"""


def blocks(rows: int, channels: int = CHANNELS) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield times [s], shape (n,), and counts of a digitiser, shape (n, channels)."""
    rng = np.random.default_rng(1)
    for start in range(0, rows, ROWS):
        index = np.arange(start, min(start + ROWS, rows))
        yield index / RATE_HZ, np.rint(rng.normal(0, 300, (len(index), channels)))


def the_map(path: Path, form: str, column: str) -> list[str]:
    """Write the map of a file beside it; return the arguments that import the two."""
    columns = ", ".join(
        f'{{column = "{column.format(i)}", name = "G{i}", quantity = "seismic", unit = "count"}}'
        for i in range(CHANNELS)
    )
    map_ = path.with_name(f"{path.name}.toml")
    map_.write_text(MAP.format(form=form, columns=columns), encoding="utf-8")
    return [str(path), "--map", str(map_)]


def npy(file: object, shape: tuple[int, ...], parts: Iterator[np.ndarray]) -> None:
    """Write an array of doubles part by part, as NumPy stores one."""
    head = {"descr": "<f8", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(file, head)
    for part in parts:
        file.write(part.astype("<f8").tobytes())  # type: ignore[attr-defined]


def npz(path: Path, size: float, method: int = zipfile.ZIP_STORED) -> list[str]:
    """Write times and samples as two arrays."""
    rows = int(size / 8 / (1 + CHANNELS))
    with zipfile.ZipFile(path, "w", method, compresslevel=1) as archive:
        for name, shape, which in (("t", (rows,), 0), ("x", (rows, CHANNELS), 1)):
            with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                npy(file, shape, (block[which] for block in blocks(rows)))
    return the_map(path, "npz", "x[:,{}]")


def npz_packed(path: Path, size: float) -> list[str]:
    """Write the same, deflated."""
    return npz(path, size, zipfile.ZIP_DEFLATED)


def csv(path: Path, size: float) -> list[str]:
    """Write a header, and rows of a time with six digits and whole numbers."""
    names = ",".join(["t", *(f"x{i}" for i in range(CHANNELS))])
    with path.open("w", encoding="ascii") as file:
        file.write(names + "\n")
        for times, samples in blocks(int(size / 75)):
            rows = [",".join(map(str, row)) for row in samples.astype(int).tolist()]
            pairs = zip(times.tolist(), rows, strict=True)
            file.writelines(f"{time:.6f},{row}\n" for time, row in pairs)
    return the_map(path, "csv", "x{}")


def hdf5(path: Path, size: float) -> list[str]:
    """Write two data sets in chunks, packed."""
    import h5py

    rows, at = int(size / 8 / (1 + CHANNELS)), 0
    with h5py.File(path, "w") as file:
        t = file.create_dataset("t", (rows,), "f8", chunks=True, compression=1)
        x = file.create_dataset("x", (rows, CHANNELS), "f8", chunks=True, compression=1)
        for times, samples in blocks(rows):
            t[at : at + len(times)], x[at : at + len(times)] = times, samples
            at += len(times)
    return the_map(path, "hdf5", "x[:,{}]")


def miniseed(path: Path, size: float, *, by_channel: bool = True) -> list[str]:
    """Write records of Steim 2, channel after channel."""
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from obspy import Trace, UTCDateTime
    rows = int(size / 1.55 / CHANNELS)
    with path.open("wb") as file:
        for turn in range(CHANNELS if by_channel else 1):
            at = 0
            for _, samples in blocks(rows, 1 if by_channel else CHANNELS):
                for i, column in enumerate(samples.T.astype(np.int32), turn):
                    start = UTCDateTime(2026, 1, 1) + at / RATE_HZ
                    head = {"station": "A", "channel": f"Z{i:02d}", "starttime": start}
                    out = io.BytesIO()
                    trace = Trace(column, {**head, "sampling_rate": RATE_HZ})
                    trace.write(out, format="MSEED", encoding="STEIM2", reclen=4096)
                    file.write(out.getvalue())
                at += len(samples)
    return [str(path)]


def miniseed_in_turns(path: Path, size: float) -> list[str]:
    """Write records of all channels in turns, as a digitiser does."""
    return miniseed(path, size, by_channel=False)


def matlab(path: Path, size: float, *, packed: bool = False) -> list[str]:
    """Write times and samples as two variables of level 5 (MAT-File Format, R2024b, part 1)."""
    rows = int(size / 8 / (1 + CHANNELS))
    with path.open("wb") as file:
        file.write(b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\x01IM")
        for name, width in (("t", 1), ("x", CHANNELS)):
            head = struct.pack("<IIIIIIii", 6, 8, 6, 0, 5, 8, rows, width)
            head += struct.pack("<HH4sII", 1, 1, name.encode(), 9, 8 * rows * width)
            tag = struct.pack("<II", 14, len(head) + 8 * rows * width)
            begin, pack = file.tell(), zlib.compressobj(1)
            file.write(bytes(8) if packed else tag + head)
            if packed:
                file.write(pack.compress(tag + head))
            for turn in range(width):  # column after column
                for times, samples in blocks(rows, 1):
                    part = (times if name == "t" else samples[:, 0] + turn).tobytes()
                    file.write(pack.compress(part) if packed else part)
            if packed:
                file.write(pack.flush())
                end = file.tell()
                file.seek(begin)
                file.write(struct.pack("<II", 15, end - begin - 8))
                file.seek(end)
    return the_map(path, "mat", "x[:,{}]")


def matlab_packed(path: Path, size: float) -> list[str]:
    """Write the same, compressed."""
    return matlab(path, size, packed=True)


def seg2(path: Path, size: float) -> list[str]:
    """Write one shot of 16 long traces of doubles."""
    rows = int(size / 8 / CHANNELS)
    text = f"SAMPLE_INTERVAL {1 / RATE_HZ:.9f}".encode() + b"\0"
    text = (struct.pack("<H", len(text) + 2) + text).ljust(64, b"\0")
    first, step = 32 + 4 * CHANNELS, 32 + len(text) + 8 * rows
    with path.open("wb") as file:
        file.write(struct.pack("<HHHHBccBcc", 0x3A55, 1, 4 * CHANNELS, CHANNELS, 1, b"\0", b"\0",
                               1, b"\n", b"\0").ljust(32, b"\0"))  # fmt: skip
        file.write(struct.pack(f"<{CHANNELS}I", *(first + i * step for i in range(CHANNELS))))
        for _ in range(CHANNELS):
            head = struct.pack("<HHIIB", 0x4422, 32 + len(text), 8 * rows, rows, 5)
            file.write(head.ljust(32, b"\0") + text)
            file.writelines(samples.tobytes() for _, samples in blocks(rows, 1))
    return [str(path)]


def seg2_shots(path: Path, size: float) -> list[str]:
    """Write a folder of shots of one second."""
    path.mkdir()
    first_shot = path / "0001.sg2"
    seg2(first_shot, 8 * CHANNELS * RATE_HZ)
    for number in range(2, int(size / first_shot.stat().st_size)):
        shutil.copyfile(first_shot, path / f"{number:04d}.sg2")
    return [str(path)]


def sac(path: Path, size: float) -> list[str]:
    """Write a folder of 16 files, one a channel."""
    from obspy import Trace

    rows = int(size / 4 / CHANNELS)
    path.mkdir()
    for i in range(CHANNELS):
        head = {"station": "A", "channel": f"Z{i:02d}", "sampling_rate": RATE_HZ}
        out = io.BytesIO()
        Trace(np.zeros(1, np.float32), head).write(out, format="SAC")
        start = bytearray(out.getvalue()[:632])
        start[316:320] = struct.pack("<i", rows)
        with (path / f"{i:02d}.sac").open("wb") as file:
            file.write(start)
            file.writelines(x.astype("<f4").tobytes() for _, x in blocks(rows, 1))
    return [str(path)]


def segy(path: Path, size: float) -> list[str]:
    """Write traces of 32 000 samples, as floats of IEEE."""
    from obspy import Stream, Trace, UTCDateTime

    start = {"starttime": UTCDateTime(2026, 1, 1), "sampling_rate": RATE_HZ}
    out = io.BytesIO()
    trace = Trace(np.zeros(32_000, np.float32), start)
    Stream([trace]).write(out, format="SEGY", data_encoding=5)
    rng = np.random.default_rng(1)
    with path.open("wb") as file:
        file.write(out.getvalue()[:3600])
        for _ in range(int(size / 128_240)):
            file.write(out.getvalue()[3600:3840])
            file.write(rng.normal(0, 300, 32_000).astype(">f4").tobytes())
    return [str(path)]


def gse2(path: Path, size: float) -> list[str]:
    """Write traces of a minute of one channel, compressed, one after the other."""
    from obspy import Trace, UTCDateTime

    with path.open("wb") as file:
        for minute, (_, samples) in enumerate(blocks(int(size / 4), 1)):
            start = UTCDateTime(2026, 1, 1) + minute * ROWS / RATE_HZ
            head = {"station": "A", "channel": "Z", "sampling_rate": RATE_HZ, "starttime": start}
            part = path.with_name("part")
            Trace(samples[:, 0].astype(np.int32), head).write(str(part), format="GSE2")
            file.write(part.read_bytes())
            part.unlink()
    return [str(path)]


def wav(path: Path, size: float) -> list[str]:
    """Write 16 bits."""
    import wave

    with wave.open(str(path), "wb") as file:
        file.setparams((CHANNELS, 2, RATE_HZ, 0, "NONE", ""))
        for _, samples in blocks(int(size / 2 / CHANNELS)):
            file.writeframes(samples.astype("<i2").tobytes())
    return [str(path)]


#: Rate of worn sensors, and their samples for each gigabyte asked for: half an hour.
WORN_HZ = 500
WORN = 1800 * WORN_HZ
START_NS = 1_767_603_600_000_000_000


def worn(size: float) -> Iterator[tuple[int, tuple[float, ...]]]:
    """Yield the number of each sample and three values."""
    rng = np.random.default_rng(1)
    for start in range(0, int(size / 1e9 * WORN), ROWS):
        rows = rng.normal(0, 9, (ROWS, 3)).round(5).tolist()
        yield from enumerate(map(tuple, rows), start)


def sensor_logger(path: Path, size: float) -> list[str]:
    """Write a folder of tables of three sensors."""
    path.mkdir()
    for name in ("TotalAcceleration", "Gyroscope", "Magnetometer"):
        with (path / f"{name}.csv").open("w", encoding="ascii") as file:
            file.write("time,seconds_elapsed,z,y,x\n")
            for k, (x, y, z) in worn(size):
                time_ns = START_NS + k * 10**9 // WORN_HZ
                file.write(f"{time_ns},{k / WORN_HZ:.4f},{z},{y},{x}\n")
    return [str(path)]


def phyphox(path: Path, size: float) -> list[str]:
    """Write a table of the acceleration."""
    with path.open("w", encoding="ascii") as file:
        cells = ",".join(f'"Acceleration {axis} (m/s^2)"' for axis in "xyz")
        file.write(f'"Time (s)",{cells}\n')
        file.writelines(f"{k / WORN_HZ:.4f},{x},{y},{z}\n" for k, (x, y, z) in worn(size))
    return [str(path)]


def indoor(path: Path, size: float) -> list[str]:
    """Write a trace of three sensors, which is of whole milliseconds."""
    kinds = ("TYPE_ACCELEROMETER", "TYPE_GYROSCOPE", "TYPE_MAGNETIC_FIELD")
    with path.open("w", encoding="ascii") as file:
        file.write("#\tstartTime:1767603600000\n")
        for k, (x, y, z) in worn(size):
            when = START_NS // 10**6 + k * 1000 // WORN_HZ
            file.writelines(f"{when}\t{kind}\t{x}\t{y}\t{z}\t3\n" for kind in kinds)
    return [str(path)]


def xsens(path: Path, size: float) -> list[str]:
    """Write a folder of the files of two sensors."""
    path.mkdir()
    names = [f"{word}_{axis}" for word in ("Acc", "Gyr", "Mag") for axis in "XYZ"]
    for device in ("00B42D4F", "00B42D50"):
        with (path / f"MT_{device}.txt").open("w", encoding="ascii") as file:
            file.write(f"// Update Rate: {WORN_HZ}.0Hz\n")
            file.write("\t".join(["PacketCounter", *names]) + "\n")
            for k, values in worn(size):
                cells = "\t".join(map(str, values))
                file.write(f"{k % 65536}\t{cells}\t{cells}\t{cells}\n")
    return [str(path)]


def bag(path: Path, size: float, version: int = 1) -> list[str]:
    """Write the messages of an Imu."""
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)
    types = store.types
    kind, head = types["sensor_msgs/msg/Imu"], types["std_msgs/msg/Header"]
    moment, vector = types["builtin_interfaces/msg/Time"], types["geometry_msgs/msg/Vector3"]
    turn = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    number, none = {"seq": 0} if version == 1 else {}, np.zeros(9)
    pack = store.serialize_ros1 if version == 1 else store.serialize_cdr
    with rosbag1.Writer(path) if version == 1 else rosbag2.Writer(path, version=9) as file:
        topic = file.add_connection("/imu", kind.__msgtype__, typestore=store)
        for k, values in worn(size):
            time_ns = START_NS + k * 10**9 // WORN_HZ
            stamp = moment(*divmod(time_ns, 10**9))
            three = vector(*values)
            header = head(**number, stamp=stamp, frame_id="")
            message = kind(header, turn, none, three, none, three, none)
            file.write(topic, time_ns, pack(message, kind.__msgtype__))
    return [str(path)]


def bag2(path: Path, size: float) -> list[str]:
    """Write the same as a folder of SQLite."""
    return bag(path, size, 2)


KINDS: dict[str, tuple[str, Callable[[Path, float], list[str]]]] = {
    "npz": ("a.npz", npz),
    "npz, deflated": ("a.npz", npz_packed),
    "csv": ("a.csv", csv),
    "hdf5": ("a.h5", hdf5),
    "miniSEED by channel": ("a.mseed", miniseed),
    "miniSEED in turns": ("a.mseed", miniseed_in_turns),
    "MATLAB 5": ("a.mat", matlab),
    "MATLAB 5, packed": ("a.mat", matlab_packed),
    "SEG-2, one long": ("a.sg2", seg2),
    "SEG-2, shots of 1 s": ("a", seg2_shots),
    "SAC": ("a", sac),
    "SEG-Y": ("a.sgy", segy),
    "GSE2": ("a.gse2", gse2),
    "WAV": ("a.wav", wav),
    "Sensor Logger": ("a", sensor_logger),
    "phyphox": ("a.csv", phyphox),
    "indoor-location": ("a.txt", indoor),
    "Xsens": ("a", xsens),
    "ROS 1 bag": ("a.bag", bag),
    "ROS 2 bag, db3": ("a", bag2),
}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--gigabytes", type=float, default=2.0, help="of numbers, or of the file")
    parser.add_argument("--only", nargs="+", default=list(KINDS), choices=KINDS)
    parser.add_argument("--folder", type=Path, help="for twice as much; a temporary one without it")
    parser.add_argument("--make", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.make:
        print("\n".join(KINDS[given.only[0]][1](given.make, given.gigabytes * 1e9)))
        return
    print("| | file | peak | time |\n|---|---|---|---|")
    for kind in given.only:
        name, _ = KINDS[kind]
        with tempfile.TemporaryDirectory(dir=given.folder) as folder:
            path = Path(folder) / name
            # in a process of its own: a child's peak is never below what its parent held
            made = [sys.executable, __file__, "--only", kind, "--make", str(path)]
            made += ["--gigabytes", str(given.gigabytes)]
            output = subprocess.run(made, check=True, capture_output=True, text=True).stdout
            command = ["import", *output.splitlines(), "-o", str(Path(folder) / "out.mcap")]
            mb, seconds = peak([sys.executable, "-c", MAIN, *command])
            files = path.rglob("*") if path.is_dir() else [path]
            size = sum(file.stat().st_size for file in files) / 1e9
            print(f"| {kind} | {size:.2f} GB | {mb:.0f} MB | {seconds:.0f} s |")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
