"""A clock that is set back while a recording is made: the order of the file tells."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np
import pytest
from command_runs import run

from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import load_pipeline
from groundtrace.pipeline.source import Source
from groundtrace_codecs.events import Gap, StepEvent
from groundtrace_codecs.importers.run import import_recording
from groundtrace_codecs.mcap.reader import set_backs
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S, Channel, SignalBlock, Stream
from groundtrace_codecs.writer import RecordingWriter

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

ACCELERATION = Stream(
    "/imu/waist",
    tuple(Channel(f"a{axis}", "acceleration", "m/s2", axis) for axis in "xyz"),
    100.0,
    placement="waist",
)
PRESSURE = Stream("/pressure", (Channel("p", "pressure", "Pa"),), 4.0)
FIRST_S, BACK_S, LENGTH_S = 100, 20, 30


def walk(stream: Stream, start_s: float, first: int, length_s: float = LENGTH_S) -> SignalBlock:
    """Samples that tell their place in the recording; acceleration is that of somebody walking."""
    count = round(length_s * stream.rate_hz)
    period_ns = NS_PER_S / stream.rate_hz
    place = np.arange(first, first + count)
    samples = np.repeat(place[:, None], len(stream.channels), axis=1).astype(np.float64)
    if stream is ACCELERATION:
        phase = 2 * np.pi * 1.8 * place / stream.rate_hz
        samples = np.zeros((count, 3))
        samples[:, 2] = 9.81 + 2.5 * np.sin(phase) + np.sin(2 * phase + 0.4)
        samples[:, 0] = 0.3 * np.random.default_rng(first).normal(size=count)
    anchor_ns = round(start_s * NS_PER_S - first * period_ns)
    return SignalBlock(stream, anchor_ns, first, samples)


def set_back(path: Path, streams: Sequence[Stream], length_s: float = LENGTH_S) -> Path:
    """Write 30 s, the clock set back by 20 s, and 30 s again, as a recorder would."""
    with RecordingWriter(path) as writer:
        for stream in streams:
            writer.add_stream(stream, "f64le")
        for part in range(2):
            start_s = FIRST_S + part * (length_s - BACK_S)
            runs = [walk(s, start_s, round(part * length_s * s.rate_hz), length_s) for s in streams]
            pieces = [
                run.slice(at, at + max(1, round(run.stream.rate_hz / 4)))
                for run in runs
                for at in range(0, len(run), max(1, round(run.stream.rate_hz / 4)))
            ]
            for piece in sorted(pieces, key=lambda piece: piece.last_ns):
                writer.write(piece)
    return path


def items(path: Path, **span: int) -> list[SignalBlock | Gap]:
    with Recording.open(path) as recording:
        return list(Source(recording, **span))


def test_a_clock_set_back_is_one_step_and_two_segments(tmp_path: Path) -> None:
    found = items(set_back(tmp_path / "back.mcap", [ACCELERATION]))
    (gap,) = [item for item in found if isinstance(item, Gap)]
    assert (gap.reason, gap.bridged, gap.start_ns) == ("clock step", False, 110 * NS_PER_S)
    at = found.index(gap)
    for part, start_s in ((found[:at], 100), (found[at + 1 :], 110)):
        times = np.concatenate([b.sample_times() for b in part if isinstance(b, SignalBlock)])
        assert times.tolist() == (start_s * NS_PER_S + np.arange(3000) * (NS_PER_S // 100)).tolist()


def test_all_steps_before_and_after_are_found(tmp_path: Path) -> None:
    def steps(path: Path) -> int:
        chain_ = build_pipeline(load_pipeline("waist-steps"))
        events = [e for item in items(path) for e in chain_.process(item)]
        return sum(isinstance(e, StepEvent) for e in [*events, *chain_.flush()])

    assert steps(set_back(tmp_path / "back.mcap", [ACCELERATION])) == pytest.approx(108, abs=2)


def test_streams_of_one_clock_go_on_together(tmp_path: Path) -> None:
    path = set_back(tmp_path / "both.mcap", [ACCELERATION, PRESSURE])
    with Recording.open(path) as recording:
        stamped = list(recording.blocks())
    log = [each.log_ns for each in stamped]
    assert log == sorted(log)
    for topic, rate_hz in (("/imu/waist", 100), ("/pressure", 4)):
        own = [each for each in stamped if each.block.topic == topic]
        later = [each for each in own if each.log_ns > 130.3 * NS_PER_S]
        assert sum(len(each.block) for each in later) == pytest.approx(29.7 * rate_hz, abs=1.5)
        # read 20 s after what the clock shows, to the interval of the fastest stream
        for each in later:
            shown = each.log_ns - 20 * NS_PER_S
            assert abs(each.block.last_ns - shown) <= 0.3 * NS_PER_S


def test_a_span_of_time_takes_what_the_clock_shows_in_both_segments(tmp_path: Path) -> None:
    path = set_back(tmp_path / "back.mcap", [ACCELERATION])
    found = items(path, start_ns=115 * NS_PER_S, stop_ns=120 * NS_PER_S)
    blocks = [item for item in found if isinstance(item, SignalBlock)]
    times = np.concatenate([block.sample_times() for block in blocks])
    assert len(times) == 2 * 500
    assert (times.min(), times.max()) == (115 * NS_PER_S, 120 * NS_PER_S - NS_PER_S // 100)
    assert [item.reason for item in found if isinstance(item, Gap)] == ["clock step"]


def test_first_and_last_sample_are_those_of_all_segments(tmp_path: Path) -> None:
    with Recording.open(set_back(tmp_path / "short.mcap", [ACCELERATION], 15)) as recording:
        assert recording.start_ns == 95 * NS_PER_S
        assert recording.end_ns == 115 * NS_PER_S - NS_PER_S // 100


def test_an_imu_whose_messages_hold_one_sample_each_is_read_in_its_order_too(
    tmp_path: Path,
) -> None:
    turning = tuple(Channel(f"g{axis}", "angular_velocity", "rad/s", axis) for axis in "xyz")
    imu = replace(ACCELERATION, channels=(*ACCELERATION.channels, *turning))
    path = set_back(tmp_path / "imu.mcap", [imu])
    gaps = [item.reason for item in items(path) if isinstance(item, Gap)]
    assert gaps == ["clock step"]


def test_chunks_that_lie_in_another_order_in_the_file_go_by_their_log_times(
    tmp_path: Path,
) -> None:
    first, last = walk(ACCELERATION, 100, 0, 20), walk(ACCELERATION, 120, 2000, 20)
    with RecordingWriter(tmp_path / "shuffled.mcap") as writer:
        writer.add_stream(ACCELERATION, "f64le")
        for block in (last, first):
            writer.write(block)
            writer.flush()
    found = items(tmp_path / "shuffled.mcap")
    assert not [item for item in found if isinstance(item, Gap)]
    assert sum(len(item) for item in found) == 4000


S = NS_PER_S


@pytest.mark.parametrize(
    ("times_s", "expected"),
    [
        ([*range(100, 131), *range(110, 141)], [(31, 21)]),
        # a second step, back over both
        ([*range(100, 131), *range(110, 141), *range(120, 151)], [(31, 21), (62, 42)]),
        ([*range(100, 131), 127, *range(131, 150)], []),  # one came late
        ([*range(100, 110), *range(120, 130), *range(110, 120), *range(130, 140)], []),  # a hole
        ([*range(200, 230), *range(100, 130)], []),  # nothing is shown twice: another order
        (list(range(100, 160)), []),
        ([100], []),
        ([], []),
    ],
)
def test_only_times_that_are_shown_twice_are_of_a_clock_set_back(
    times_s: list[int], expected: list[tuple[int, int]]
) -> None:
    found = set_backs(np.array(times_s, np.int64) * S)
    assert found == [(at, sum_s * S) for at, sum_s in expected]


MAP = """
format = "csv"
skip_rows = 1
time = {column = "t", unit = "s"}
[[stream]]
topic = "/acc"
columns = [{column = "z", quantity = "acceleration", axis = "z", unit = "m/s2"}]
"""


@pytest.mark.parametrize("jitter_s", [0.0, 0.002])
def test_a_table_whose_times_are_set_back_becomes_two_segments(
    tmp_path: Path, jitter_s: float
) -> None:
    rng = np.random.default_rng(1)
    times = np.concatenate([100 + np.arange(3000) / 100, 110 + np.arange(3000) / 100])
    times += rng.uniform(-jitter_s, jitter_s, len(times))
    rows = "\n".join(f"{t:.6f},{place}" for place, t in enumerate(times))
    (tmp_path / "back.csv").write_text(f"t,z\n{rows}\n")
    (tmp_path / "map.toml").write_text(MAP)
    out = tmp_path / "back.mcap"
    done = import_recording([tmp_path / "back.csv"], out, map_path=tmp_path / "map.toml")
    (text,) = done.warnings
    assert re.search(r"set back by (20.00|19.99)\d s at sample 3001: what follows", text)
    found = items(out)
    gaps = [item for item in found if isinstance(item, Gap) and not item.bridged]
    assert [gap.reason for gap in gaps] == ["clock step"]
    at = found.index(gaps[0])
    before, after = (
        [b for b in part if isinstance(b, SignalBlock)] for part in (found[:at], found[at + 1 :])
    )
    for part, low, high in ((before, 0, 2999), (after, 3000, 5999)):
        values = np.concatenate([b.values[:, 0] for b in part])
        assert len(values) == pytest.approx(3000, abs=10)  # a grid of the median interval
        assert low <= values.min() <= values.max() <= high


COPIES = {
    "cut": ["--to", "40"],
    "filter": ["--topic", "*"],
    "convert": ["--compression", "lz4"],
    "convert again": ["--block-ms", "700"],
    "merge": [],
    "doctor": ["--repair"],
    "annotate": ["--commit"],
}


@pytest.mark.parametrize("copy", COPIES)
def test_a_copy_keeps_the_order_in_which_both_segments_were_recorded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], copy: str
) -> None:
    path, out = set_back(tmp_path / "back.mcap", [ACCELERATION, PRESSURE]), tmp_path / "copy.mcap"
    command, options = copy.split()[0], COPIES[copy]
    if command == "annotate":
        run(capsys, "annotate", path, "--add", "missed@3", "--author", "me")
    into = () if command == "doctor" else ("-o",)
    ran = run(capsys, command, path, *options, *into, out)
    assert ran.code == 0, ran.err
    assert "set back" not in ran.err
    for topic in ("/imu/waist", "/pressure"):
        assert recorded(out, topic) == recorded(path, topic)
    assert [(g.reason, g.topic) for g in items(out) if isinstance(g, Gap)] == [
        (g.reason, g.topic) for g in items(path) if isinstance(g, Gap)
    ]


def recorded(path: Path, topic: str) -> list[tuple[int, list[float]]]:
    """Return times and values of a stream in the order in which they are read."""
    blocks = [x for x in items(path) if isinstance(x, SignalBlock) and x.topic == topic]
    times = chain(*(block.sample_times().tolist() for block in blocks))
    return list(zip(times, chain(*(b.values.tolist() for b in blocks)), strict=True))


def test_a_cut_takes_what_the_clock_shows_in_both_segments(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = set_back(tmp_path / "back.mcap", [ACCELERATION]), tmp_path / "copy.mcap"
    assert run(capsys, "cut", path, "-o", out, "--from", "15", "--to", "20").code == 0
    whole = [x for x in recorded(path, "/imu/waist") if 115 * S <= x[0] < 120 * S]
    assert len(whole) == 1000
    assert recorded(out, "/imu/waist") == whole
    assert [g.reason for g in items(out) if isinstance(g, Gap)] == ["clock step"]


def test_two_recordings_of_which_one_was_set_back_are_merged_in_its_order(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = set_back(tmp_path / "back.mcap", [ACCELERATION])
    with RecordingWriter(tmp_path / "other.mcap") as writer:
        writer.add_stream(PRESSURE, "f64le")
        writer.write(walk(PRESSURE, 90, 0, 80))
    given = (path, tmp_path / "other.mcap", "-o", tmp_path / "both.mcap", "--align", "none")
    assert run(capsys, "merge", *given).code == 0
    assert recorded(tmp_path / "both.mcap", "/imu/waist") == recorded(path, "/imu/waist")
