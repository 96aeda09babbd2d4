"""Waveforms that continue each other, decoded into one block."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from google.protobuf.message import DecodeError

from ..signals import NS_PER_S, SignalBlock, Stream
from .protobuf import message_class
from .waveform import apart, decode_waveform, fits, put_samples, to_block


class WaveformRun:
    """Messages of a stream that continue each other, to become one block.

    Parameters
    ----------
    stream
        Theirs.
    data
        The first message.
    place
        Named in errors.
    count
        As :func:`decode_waveform` takes it.

    Attributes
    ----------
    count
        How many samples the first message has, all channels together.

    Raises
    ------
    SchemaError
        As :func:`decode_waveform` and :func:`to_block`.
    """

    def __init__(
        self, stream: Stream, data: bytes | memoryview, place: str, count: int = 0
    ) -> None:
        wave = decode_waveform(data, place, count)
        self._first = to_block(stream, wave, place)
        self._others: list[bytes | memoryview] = []
        self._next = self._first.first + len(self._first)
        self._stored = wave.stored
        self._same = (*wave.samples.T.shape, stream.rate_hz, b"")
        self.count = wave.samples.size

    def take(self, data: bytes | memoryview) -> bool:
        """Take a message that continues the run as plainly as most do; else return False."""
        fields, packed = apart(data, self.count)
        if packed is None or self._first.times_ns is not None:
            return False
        try:
            message = message_class("WaveformBlock").FromString(fields)
        except DecodeError:
            return False
        first = self._first
        same = (message.channels, message.samples, message.sample_rate, message.sample_times_ns)
        if message.format != self._stored or same != self._same:
            return False
        if not fits(len(packed), self._stored, self.count):
            return False
        if message.first_sample != self._next:
            return False
        stamp = message.timestamp
        lag_ns = stamp.seconds * NS_PER_S + stamp.nanos - first.anchor_ns
        if lag_ns != round(self._next * first.stream.period_ns):
            return False
        self._others.append(packed)
        self._next += len(first)
        return True

    def block(self) -> SignalBlock:
        """Return the messages' samples."""
        if not self._others:
            return self._first
        part = self._first.samples.T
        channels, n = part.shape
        whole = np.empty((channels, n * (1 + len(self._others))), part.dtype)
        whole[:, :n] = part
        for number, data in enumerate(self._others, start=1):
            put_samples(data, self._stored, whole[:, number * n : (number + 1) * n])
        return replace(self._first, samples=whole.T)
