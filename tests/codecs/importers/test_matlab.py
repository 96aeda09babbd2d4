"""MATLAB, HDF5 and NumPy files with damage, and the reader of MATLAB files against scipy's."""

from __future__ import annotations

import io
import random
import struct
import zlib
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from fuzz_targets import TARGETS, arrays, matlab_4, matlab_5
from scipy.io import loadmat, savemat

from groundtrace_codecs.errors import FormatError
from groundtrace_codecs.importers import tables
from groundtrace_codecs.importers.tables import MatlabImporter, Opaque, _load_mat

if TYPE_CHECKING:
    from pathlib import Path

ARCHIVES = ["MATLAB 4", "MATLAB 5", "MATLAB 5, packed", "HDF5", "NumPy"]
WORDS = [b"\xff\xff\xff\xff", bytes(4), b"\x7f\xff\xff\xff", b"\x01\x00\x00\x00"]


def edited(data: bytes, rng: random.Random) -> bytes:
    """Return bytes with one to three edits: a byte, a word, some lost, some put in, cut short."""
    changed = bytearray(data)
    for _ in range(rng.choice([1, 1, 2, 3])):
        at = rng.randrange(len(changed) + 1)
        kind = rng.randrange(5)
        if kind == 0:
            changed[at : at + 1] = rng.randbytes(1)
        elif kind == 1:
            changed[at : at + 4] = rng.choice(WORDS)
        elif kind == 2:
            del changed[at : at + rng.choice([1, 4, 9])]
        elif kind == 3:
            changed[at:at] = rng.randbytes(rng.choice([1, 4, 8]))
        else:
            del changed[at:]
    return bytes(changed)


@pytest.mark.parametrize("name", ARCHIVES)
def test_three_hundred_edits_are_read_or_refused_in_one_line_that_names_the_file(
    name: str, tmp_path: Path
) -> None:
    target, rng, refused = TARGETS[name], random.Random(1), 0
    seeds = target.seeds(tmp_path)
    for seed in seeds:
        for _ in range(300 // len(seeds)):
            try:
                target.check(edited(seed, rng), tmp_path)
            except target.errors as error:
                refused += 1
                assert "\n" not in str(error)  # noqa: PT017 (either outcome is right)
                assert str(error).startswith("x.")  # noqa: PT017
    assert refused > 50


@pytest.mark.parametrize("name", ["MATLAB 4", "MATLAB 5"])
def test_a_matlab_file_cut_anywhere_is_refused_or_lacks_its_last_variables(
    name: str, tmp_path: Path
) -> None:
    (whole,) = TARGETS[name].seeds(tmp_path)
    path = tmp_path / "cut.mat"
    for end in range(0, len(whole), 7):
        path.write_bytes(whole[:end])
        try:
            found = _load_mat(path)
        except FormatError as error:
            assert str(error).startswith("cut.mat: ")  # noqa: PT017
        else:
            assert len(found) < 5


def alike(ours: Any, theirs: Any) -> bool:
    """Tell whether scipy reads the same; it makes objects of structs."""
    if hasattr(theirs, "_fieldnames"):
        names = list(theirs._fieldnames)
        return sorted(ours) == sorted(names) and all(
            alike(ours[n], getattr(theirs, n)) for n in names
        )
    if isinstance(theirs, np.ndarray) and theirs.dtype == object:
        pairs = zip(ours.ravel(), theirs.ravel(), strict=True)
        return ours.shape == theirs.shape and all(alike(a, b) for a, b in pairs)
    if not np.size(theirs):
        return not len(ours)
    return np.shape(ours) == np.shape(theirs) and bool(np.all(np.asarray(ours) == theirs))


def variables() -> dict[str, Any]:
    cells = np.empty((2, 3), object)
    for i in range(6):
        cells.flat[i] = np.arange(i) if i % 2 else f"cell {i}"
    return {
        "nested": {"in": {"in": arrays(), "c": cells}},
        "cube": np.arange(24, dtype=np.int16).reshape(2, 3, 4),
        "u8": np.array([[1, 255]], np.uint8),
        "single": np.float32(2.5) * np.ones((4, 1), np.float32),
        "i64": np.array([2**62, -5]),
        "flags": np.array([True, False, True]),
        "z": np.array([1 + 2j, 3 - 1j]),
        "words": np.array(["ab", "cd", "ef"]),
        "umlaut": "Füße \u4e2d",
        "nothing": np.empty((0, 3)),
        "empty": "",
        "number": 7.25,
    }


@pytest.mark.parametrize("largest_in_memory", [1 << 20, 0])
@pytest.mark.parametrize("compressed", [False, True])
def test_every_kind_of_variable_is_read_as_scipy_reads_it(
    compressed: bool, largest_in_memory: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tables, "_SMALL_BYTES", largest_in_memory)
    path = tmp_path / "a.mat"
    savemat(path, variables(), do_compression=compressed)
    theirs = loadmat(path, squeeze_me=True, struct_as_record=False)
    found = _load_mat(path)
    assert sorted(found) == sorted(variables())
    for name, value in found.items():
        assert alike(value, theirs[name]), name


def test_a_file_of_level_4_is_read_as_scipy_reads_it_and_known_without_its_suffix(
    tmp_path: Path,
) -> None:
    path = tmp_path / "recorder.dat"
    path.write_bytes(matlab_4())
    theirs = loadmat(io.BytesIO(matlab_4()), squeeze_me=True)
    found = _load_mat(path)
    assert sorted(found) == ["acc", "start", "steps", "t"]
    for name, value in found.items():
        assert alike(value, theirs[name]), name
    assert MatlabImporter().sniff(path) == 0.7


def test_a_file_of_the_other_byte_order_is_read(tmp_path: Path) -> None:
    values = np.array([1.5, -2.0, 1e300])
    content = (
        struct.pack(">IIII", 6, 8, 6, 0)  # flags: double
        + struct.pack(">IIii", 5, 8, 3, 1)
        + struct.pack(">HH4s", 3, 1, b"acc\0")  # a name in the tag itself
        + struct.pack(">II", 9, 24)
        + values.astype(">f8").tobytes()
    )
    head = b"written elsewhere".ljust(124) + b"\x01\x00MI"
    (tmp_path / "a.mat").write_bytes(head + struct.pack(">II", 14, len(content)) + content)
    np.testing.assert_array_equal(_load_mat(tmp_path / "a.mat")["acc"], values)
    assert MatlabImporter().sniff(tmp_path / "a.mat") == 1.0


def test_a_sparse_array_beside_the_signal_is_left_as_what_it_is(tmp_path: Path) -> None:
    from scipy.sparse import csc_array

    savemat(tmp_path / "a.mat", {"s": csc_array(np.eye(3)), "x": np.arange(3.0)})
    found = _load_mat(tmp_path / "a.mat")
    assert found["s"] == Opaque("sparse array")
    assert found["x"].tolist() == [0.0, 1.0, 2.0]


def test_packed_zeros_without_end_are_not_unpacked(tmp_path: Path) -> None:
    head = matlab_5(compressed=False)[:128]
    packed = zlib.compress(struct.pack("<II", 14, 64) + bytes(50_000_000))
    (tmp_path / "a.mat").write_bytes(head + struct.pack("<II", 15, len(packed)) + packed)
    with pytest.raises(FormatError, match=r"byte .*: expected 64 bytes in compressed data"):
        _load_mat(tmp_path / "a.mat")
