"""Integers in planes are those that were given, and waveforms in both forms are read alike."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from groundtrace_codecs.errors import SchemaError
from groundtrace_codecs.schemas.protobuf import message_class
from groundtrace_codecs.schemas.waveform import (
    WaveformRun,
    decode_waveform,
    encode_waveform,
    from_planes,
    to_planes,
)
from groundtrace_codecs.signals import Channel, SignalBlock, Stream

if TYPE_CHECKING:
    from numpy.typing import NDArray

STREAM = Stream("/s", tuple(Channel(f"G{i}", "seismic", "count") for i in (1, 2)), 1000.0)
KINDS = [np.dtype("<i2"), np.dtype("<i4")]
SHAPES = hnp.array_shapes(min_dims=2, max_dims=2, max_side=9)


@given(values=st.sampled_from(KINDS).flatmap(lambda kind: hnp.arrays(kind, SHAPES)))
def test_integers_come_back_whatever_they_are(values: NDArray[np.signedinteger]) -> None:
    data = to_planes(values)
    assert len(data) <= values.nbytes
    assert len(data) % values.size == 0
    wide = np.full((values.shape[0], values.shape[1] + 2), 7, values.dtype)
    from_planes(data, wide[:, 1:-1])
    assert np.array_equal(wide[:, 1:-1], values)
    assert (wide[:, [0, -1]] == 7).all()


@pytest.mark.parametrize("kind", KINDS)
def test_the_ends_of_their_range_come_back(kind: np.dtype[np.signedinteger]) -> None:
    ends = np.iinfo(kind)
    values = np.array([[ends.min, ends.min + 1, -129, -128], [127, 128, ends.max - 1, ends.max]])
    back = np.empty(values.shape, kind)
    from_planes(to_planes(values.astype(kind)), back)
    assert np.array_equal(back, values)


def test_the_lowest_digits_of_all_samples_come_first() -> None:
    assert to_planes(np.array([[1, -1], [256, -128]], "<i2")) == bytes([1, 255, 0, 128, 0, 0, 1, 0])


def test_upper_planes_without_digits_are_left_out() -> None:
    small = np.array([[1, -1], [127, -128]], "<i4")
    assert to_planes(small) == bytes([1, 255, 127, 128])
    assert len(to_planes(small << 8)) == 2 * small.size
    assert to_planes(0 * small) == bytes(small.size)


def test_noise_is_smaller_in_planes_than_as_it_lies_in_memory() -> None:
    noise = np.random.default_rng(1).normal(0, 20, (4, 20_000)).astype("<i2")
    assert len(zstandard.compress(to_planes(noise))) < 0.85 * len(zstandard.compress(noise))


def plain(block: SignalBlock) -> bytes:
    """A message as others write it: samples as they lie in memory."""
    message = message_class("WaveformBlock").FromString(encode_waveform(block))
    message.format = {"i16planes": "i16le", "i32planes": "i32le"}[message.format]
    message.data = np.ascontiguousarray(block.samples.T).tobytes()
    encoded: bytes = message.SerializeToString()
    return encoded


@pytest.mark.parametrize("kind", KINDS)
def test_both_forms_are_read_alike_and_each_continues_its_own(
    kind: np.dtype[np.signedinteger],
) -> None:
    samples = np.random.default_rng(2).integers(-30_000, 30_000, (90, 2)).astype(kind)
    samples[30:60] >>= 9  # fewer planes than the others
    blocks = [SignalBlock(STREAM, 0, i, samples[i : i + 30]) for i in (0, 30, 60)]
    forms = [[encode_waveform(b) for b in blocks], [plain(b) for b in blocks]]
    for one, other in (forms, forms[::-1]):
        run = WaveformRun(STREAM, memoryview(one[0]), "here")
        assert run.take(memoryview(one[1]))
        assert not run.take(memoryview(other[2]))
        assert run.take(memoryview(one[2]))
        assert np.array_equal(run.block().samples, samples)
        assert np.array_equal(decode_waveform(one[1]).samples, samples[30:60])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("size", [0, 1, 59, 61, 1000])
def test_bytes_that_are_no_planes_are_refused(kind: np.dtype[np.signedinteger], size: int) -> None:
    block = SignalBlock(STREAM, 0, 0, np.ones((30, 2), kind))
    message = message_class("WaveformBlock").FromString(encode_waveform(block))
    message.data = bytes(size)
    encoded = message.SerializeToString()
    with pytest.raises(SchemaError, match=f"here: data: expected 60 or 120.* found {size}"):
        decode_waveform(encoded, "here", 60)
    run = WaveformRun(STREAM, encode_waveform(block), "here")
    message.first_sample, message.timestamp.nanos = 30, 30_000_000
    assert not run.take(message.SerializeToString())
    message.data = bytes(60)
    assert run.take(message.SerializeToString())
