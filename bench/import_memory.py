"""Peak memory and time of importing large files of each kind: docs/big.md.

Run: python bench/import_memory.py [--gigabytes 2] [--only KIND ...] [--folder FOLDER]
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import zipfile
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
    import io
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


KINDS: dict[str, tuple[str, Callable[[Path, float], list[str]]]] = {
    "npz": ("a.npz", npz),
    "npz, deflated": ("a.npz", npz_packed),
    "csv": ("a.csv", csv),
    "hdf5": ("a.h5", hdf5),
    "miniSEED by channel": ("a.mseed", miniseed),
    "miniSEED in turns": ("a.mseed", miniseed_in_turns),
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
            said = subprocess.run(made, check=True, capture_output=True, text=True).stdout
            command = ["import", *said.splitlines(), "-o", str(Path(folder) / "out.mcap")]
            mb, seconds = peak([sys.executable, "-c", MAIN, *command])
            size = path.stat().st_size / 1e9
            print(f"| {kind} | {size:.2f} GB | {mb:.0f} MB | {seconds:.0f} s |")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
