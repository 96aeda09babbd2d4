"""The committed descriptors, and decoders that any bytes either suit or make raise."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from google.protobuf import descriptor_pb2
from hypothesis import example, given, settings
from hypothesis import strategies as st
from sweeps import examples

import groundtrace_codecs.schemas as schemas
from groundtrace_codecs.errors import CodecError, SchemaError
from groundtrace_codecs.events import EVENTS, GateSpec, Quantity, StageSpec
from groundtrace_codecs.schemas.event_messages import (
    decode_candidates,
    decode_label,
    decode_trace,
    decoder_of,
)
from groundtrace_codecs.schemas.protobuf import (
    field_names,
    get_time,
    message_class,
    schema_bytes,
    set_time,
)
from groundtrace_codecs.schemas.waveform import decode_waveform, to_format

SPEC = StageSpec(
    "detect", "zc", "/imu", ("acc",), (Quantity("p", "1"),), (GateSpec("g", "1", "g", 1.0),), ()
)
FOLDER = Path(schemas.__file__).parent


def test_the_committed_descriptors_are_those_of_the_proto(tmp_path: Path) -> None:
    protoc = pytest.importorskip("grpc_tools.protoc", reason="grpcio-tools is not installed")
    bundled = Path(protoc.__file__).parent / "_proto"
    compiled = tmp_path / "compiled.desc"
    arguments = ["protoc", f"-I{FOLDER}", f"-I{bundled}", "--include_imports"]
    assert protoc.main([*arguments, f"--descriptor_set_out={compiled}", "groundtrace.proto"]) == 0
    expected = descriptor_pb2.FileDescriptorSet.FromString(compiled.read_bytes())
    committed = (FOLDER / "groundtrace.desc").read_bytes()
    assert descriptor_pb2.FileDescriptorSet.FromString(committed) == expected


def test_the_registered_schema_holds_every_dependency() -> None:
    files = descriptor_pb2.FileDescriptorSet.FromString(schema_bytes()).file
    assert {f.name for f in files} == {"groundtrace.proto", "google/protobuf/timestamp.proto"}
    assert field_names(schema_bytes(), "groundtrace.Note") == (
        "timestamp",
        "text",
        "level",
        "source",
    )
    assert field_names(b"\xff", "groundtrace.Note") == ()


@given(time_ns=st.integers(-(2**63), 2**63 - 1))
def test_times_survive_a_timestamp(time_ns: int) -> None:
    message = message_class("Note")()
    set_time(message.timestamp, time_ns)
    assert get_time(message.timestamp, "here") == time_ns


def fields() -> st.SearchStrategy[bytes]:
    """Bytes that look like protobuf fields, so that more than the parser is reached."""
    varint = st.tuples(st.integers(1, 10), st.integers(0, 127)).map(
        lambda p: bytes([p[0] << 3, p[1]])
    )
    blob = st.tuples(st.integers(1, 10), st.binary(max_size=24)).map(
        lambda p: bytes([p[0] << 3 | 2, len(p[1])]) + p[1]
    )
    return st.lists(varint | blob, max_size=9).map(b"".join)


@settings(max_examples=examples(500), deadline=None)
@given(data=st.binary(max_size=80) | fields())
@example(data=b"")
def test_any_bytes_decode_or_raise_a_schema_error(data: bytes) -> None:
    for decode in (
        decode_waveform,
        decode_label,
        lambda d: decode_candidates(d, SPEC),
        lambda d: decode_trace(d, SPEC),
        *(partial(decoder_of(cls), "here") for cls in EVENTS),
    ):
        try:
            decoded = decode(data)
        except SchemaError:
            continue
        assert decoded is not None


def waveform(**changes: object) -> bytes:
    content = {
        "sample_rate": 100.0,
        "channels": 2,
        "samples": 3,
        "format": "i16le",
        "data": np.arange(6, dtype="<i2").tobytes(),
    }
    encoded: bytes = message_class("WaveformBlock")(**(content | changes)).SerializeToString()
    return encoded


def test_samples_are_a_view_of_the_planar_bytes() -> None:
    wave = decode_waveform(waveform())
    assert wave.samples.tolist() == [[0, 3], [1, 4], [2, 5]]
    assert wave.samples.base is not None


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"format": "u8"}, "format: expected one of i16le, i32le, f32le, f64le, i16planes, i32pl"),
        ({"samples": 4}, "data: expected 16 bytes for 2 channels of 4 samples, found 12"),
        ({"samples": 0, "data": b""}, "expected at least 1 channel and 1 sample, found 2 and 0"),
        ({"sample_rate": float("nan")}, "sample_rate: expected a positive number, found nan"),
        ({"sample_times_ns": bytes(8)}, "sample_times_ns: expected 24 bytes, found 8"),
        ({"first_sample": 1 << 63}, "first_sample: expected less than 2^63"),
    ],
)
def test_a_waveform_error_says_what_is_wrong(changes: dict[str, object], expected: str) -> None:
    with pytest.raises(SchemaError) as raised:
        decode_waveform(waveform(**changes), "file: /seismic")
    assert str(raised.value).startswith(f"file: /seismic: {expected}")


@pytest.mark.parametrize(
    ("values", "sample_format"),
    [
        (np.array([40000], np.int32), "i16le"),
        (np.array([0.5]), "i32le"),
        (np.array([np.nan]), "i16le"),
        (np.array([1e300]), "f32le"),
        (np.array([(1 << 24) + 1], np.int32), "f32le"),
        (np.array([(1 << 53) + 1], np.int64), "f64le"),
        (np.array([3e9]), "i32le"),
    ],
)
def test_a_format_refuses_samples_it_would_change(values: np.ndarray, sample_format: str) -> None:
    with pytest.raises(CodecError, match=f"expected samples that fit {sample_format}, found"):
        to_format(values[:, None], sample_format, "/seismic")


@pytest.mark.parametrize(
    ("values", "sample_format"),
    [
        (np.array([-8388608, 8388607], np.int32), "i32le"),
        (np.array([-8388608, 8388607], np.int32), "f32le"),
        (np.array([1.0, -7.0]), "i16le"),
        (np.array([np.nan, np.inf, 0.5]), "f32le"),
        (np.array([1, 2], np.int64), "f64le"),
    ],
)
def test_a_format_keeps_samples_that_fit(values: np.ndarray, sample_format: str) -> None:
    stored = to_format(values[:, None], sample_format, "/seismic")
    assert np.array_equal(stored[:, 0].astype(float), values.astype(float), equal_nan=True)
