"""Whole replay of a room recorded at 20 kHz, from a zstd file to decisions, against its peers.

Each row is timed in turn with all others, in one process, several times; medians are compared. The
peers work on the same samples: scipy's ``sosfilt`` alone (band-pass of order 4 per edge, blocks of
2000, float64), plain numpy and scipy in blocks, ObsPy's script (read miniSEED, demean, band-pass,
recursive STA/LTA, onsets, and the spectrogram of 60 samples every 30), decompression alone. The
replay's picker filters with order 2 per edge, half as many sections as the peers.

Columns: CPU time of the process on one core, and how many times faster than ``sosfilt`` and than
the two scripts of ObsPy.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy import signal
from timing import alone, interleaved, on_one_core

from groundtrace.dsp.spectral import WindowPower
from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import load_pipeline
from groundtrace.pipeline.engine import ReplaySession, replay
from groundtrace.pipeline.results import Provenance, ResultsSink
from groundtrace.pipeline.source import Source
from groundtrace.simulate.recording import write
from groundtrace.simulate.room import simulate_room
from groundtrace.simulate.room_plan import RoomOptions
from groundtrace_codecs.mcap.chunks import ChunkReader, Definitions
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import SignalBlock

if TYPE_CHECKING:
    from collections.abc import Callable

    from groundtrace.pipeline.engine import Sink
    from groundtrace_codecs.events import Event

CHANNELS, RATE_HZ, BLOCK = 16, 20_000.0, 2000
WINDOW, HOP = 60, 30
SOSFILT, SCRIPT = "sosfilt alone, blocks of 2000", "ObsPy, no spectrogram"
WHOLE_SCRIPT = "ObsPy, with spectrogram"


class PowerSink:
    """Computes the power of all channels in windows of 60 samples, and keeps none of it."""

    def __init__(self) -> None:
        taper = np.hamming(WINDOW)
        self._power = WindowPower(taper, WINDOW, kind=np.float32)
        self._tail: np.ndarray | None = None
        self.largest = 0.0

    def open(self, session: ReplaySession) -> None:
        """Begin."""

    def write(self, item: SignalBlock | Event) -> None:
        """Take a block."""
        if not isinstance(item, SignalBlock):
            return
        samples = item.samples.T
        tail = samples[:, :0].copy() if self._tail is None else self._tail
        before = tail.shape[1]
        count = max(0, (before + samples.shape[1] - WINDOW) // HOP + 1)
        power = self._power(samples, -before, HOP, count, tail)
        self.largest = max(self.largest, float(power[:, :, 1].max(initial=0.0)))
        left = count * HOP - before
        self._tail = (
            samples[:, left:].copy()
            if left >= 0
            else np.concatenate([tail[:, left:], samples], axis=1)
        )

    def close(self) -> None:
        """End."""


def samples_of(path: Path) -> np.ndarray:
    """Samples of the recording, (channels, n), as stored."""
    with Recording.open(path) as recording:
        blocks = [item for item in Source(recording) if isinstance(item, SignalBlock)]
    return np.concatenate([block.samples.T for block in blocks], axis=1)


def band_pass(order: int = 4) -> np.ndarray:
    """The sections of the peers' filter."""
    return np.asarray(signal.butter(order, [20, 2000], "bandpass", fs=RATE_HZ, output="sos"))


def sosfilt_only(samples: np.ndarray, sos: np.ndarray) -> None:
    """The peer: a band-pass in blocks."""
    zi = np.zeros((len(sos), CHANNELS, 2))
    for start in range(0, samples.shape[1], BLOCK):
        _, zi = signal.sosfilt(sos, samples[:, start : start + BLOCK], axis=1, zi=zi)


def numpy_blocks(samples: np.ndarray, *, power: bool) -> None:
    """Band-pass, two averages, threshold; optionally the power of windows."""
    sos = band_pass()
    zi = np.zeros((len(sos), CHANNELS, 2))
    short, long = np.zeros((CHANNELS, 1)), np.zeros((CHANNELS, 1))
    taper, over = np.hamming(WINDOW), 0
    for start in range(0, samples.shape[1], BLOCK):
        part = samples[:, start : start + BLOCK].astype(np.float64)
        band, zi = signal.sosfilt(sos, part, axis=1, zi=zi)
        squared = band * band
        sta, short = signal.lfilter([0.2], [1, -0.8], squared, axis=1, zi=short)
        lta, long = signal.lfilter([1e-3], [1, -0.999], squared, axis=1, zi=long)
        over += int((sta > 5 * lta).sum())
        if power:
            windows = np.lib.stride_tricks.sliding_window_view(part, WINDOW, axis=1)[:, ::HOP]
            np.abs(np.fft.rfft(windows * taper)) ** 2


def obspy_script(path: Path, *, spectrogram: bool) -> None:
    """What is commonly written: read, filter, STA/LTA, onsets; optionally spectrograms."""
    from matplotlib import mlab
    from obspy import read
    from obspy.signal.trigger import recursive_sta_lta, trigger_onset

    stream = read(path)
    stream.detrend("demean")
    stream.filter("bandpass", freqmin=20, freqmax=2000, corners=4)
    for trace in stream:
        ratio = recursive_sta_lta(trace.data, 40, 2000)
        trigger_onset(ratio, 5, 2)
        if spectrogram:
            mlab.specgram(trace.data, NFFT=WINDOW, Fs=RATE_HZ, noverlap=WINDOW - HOP)


def write_miniseed(samples: np.ndarray, path: Path) -> None:
    """The same samples as a file for ObsPy."""
    from obspy import Stream, Trace

    traces = []
    for index, channel in enumerate(samples):
        header = {"station": f"G{index}", "sampling_rate": RATE_HZ}
        traces.append(Trace(channel.astype(np.int32), header))
    Stream(traces).write(path, format="MSEED", encoding="STEIM2")


def decompress_only(path: Path) -> None:
    """Every chunk, decompressed and checked."""
    with Recording.open(path) as recording:
        reader = ChunkReader(recording.file._source, Definitions())
        for chunk in recording.file._chunks:
            reader.records(chunk)


def read_only(path: Path) -> None:
    """Every block, as stages get it."""
    with Recording.open(path) as recording:
        for _ in Source(recording):
            pass


def whole_replay(path: Path, *sinks: Sink, pipeline: str = "room-steps") -> None:
    """From the compressed file to decisions with evidence."""
    with Recording.open(path) as recording:
        chain = build_pipeline(load_pipeline(pipeline), recording.geometry)
        times = (recording.start_ns, recording.end_ns)
        site = (recording.streams, recording.geometry, ())  # labels are read apart
        session = ReplaySession(path.name, "room", *times, *site, chain.recipe())
        for sink in sinks:
            sink.open(session)
        replay(Source(recording), chain, sinks)
        for sink in sinks:
            sink.close()


def with_results(path: Path) -> None:
    """The replay, and its results file."""
    origin = Provenance(path.name, "", 0, 0, "")
    whole_replay(path, ResultsSink(path.with_suffix(".results"), origin, force=True))


def with_timeline(path: Path) -> None:
    """The replay, and the viewer's file."""
    from groundtrace_viewers import RerunSink

    rrd = path.with_suffix(".rrd")
    rrd.unlink(missing_ok=True)
    whole_replay(path, RerunSink(rrd))


def print_table(medians: dict[str, float], seconds: float) -> None:
    """Each case's time, and as a ratio to its peers'."""
    print(f"{'one core, CPU time':34}{'ms per s':>9}{'s per s':>9}", end="")
    print(f"{'x sosfilt':>11}{'x ObsPy':>9}{'x ObsPy with spectrogram':>26}")
    for name, middle in medians.items():
        ratios = [medians[peer] / middle for peer in (SOSFILT, SCRIPT, WHOLE_SCRIPT)]
        print(f"{name:34}{1e3 * middle / seconds:9.2f}{seconds / middle:9.0f}", end="")
        print(f"{ratios[0]:11.2f}{ratios[1]:9.2f}{ratios[2]:26.2f}")


def one_core_cases(path: Path, samples: np.ndarray) -> dict[str, Callable[[], None]]:
    """What is timed on one core, by its row's name."""
    seed = path.with_suffix(".mseed")
    write_miniseed(samples, seed)
    floats = samples.astype(np.float64)
    return {
        SOSFILT: lambda: sosfilt_only(floats, band_pass()),
        "the same, order 2 as the picker": lambda: sosfilt_only(floats, band_pass(2)),
        "numpy in blocks": lambda: numpy_blocks(samples, power=False),
        "numpy in blocks, and 60/30 power": lambda: numpy_blocks(samples, power=True),
        SCRIPT: lambda: obspy_script(seed, spectrogram=False),
        WHOLE_SCRIPT: lambda: obspy_script(seed, spectrogram=True),
        "decompression alone": lambda: decompress_only(path),
        "reading alone": lambda: read_only(path),
        "replay to decisions": lambda: whole_replay(path),
        "replay, and 60/30 power": lambda: whole_replay(path, PowerSink()),
        "replay, and results file": lambda: with_results(path),
        "replay, and .rrd": lambda: with_timeline(path),
        "room-footsteps, with places": lambda: whole_replay(path, pipeline="room-footsteps"),
    }


def room(path: Path, seconds: float) -> Path:
    """Write a simulated room, and return where."""
    options = RoomOptions(duration_s=seconds, channels=CHANNELS, rate_hz=RATE_HZ)
    write(simulate_room(options), path)
    return path


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--runs", type=int, default=5)
    options = parser.parse_args()
    alone()
    on_one_core()
    with tempfile.TemporaryDirectory() as folder:
        path = room(Path(folder) / "room.mcap", options.seconds)
        samples = samples_of(path)
        print(f"{CHANNELS} channels x {RATE_HZ:g} Hz, {options.seconds:g} s, zstd, warm, medians")
        print_table(interleaved(one_core_cases(path, samples), options.runs), options.seconds)
        size = path.with_suffix(".rrd").stat().st_size / samples.size
        print(f"the .rrd has {size:.2f} bytes per sample")


if __name__ == "__main__":
    main()
