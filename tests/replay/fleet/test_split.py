"""A recording replayed in spans is decided as in one go, wherever it is cut."""

from __future__ import annotations

import os
import platform
import signal
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from command_runs import done, run
from fleet_runs import Here, ran_fleet, use
from split_replays import (
    GROUND,
    START_NS,
    WAIST,
    assert_same_events,
    impacts,
    in_one_go,
    in_spans,
    shaken,
    written,
)
from sweeps import swept

import groundtrace.fleet.split as splitting
from groundtrace.api.replay import PlannedReplay
from groundtrace.errors import RecordingError
from groundtrace.fleet.engines import engine_of
from groundtrace.fleet.run import Task
from groundtrace.fleet.split import SpanTask, ahead, replayed
from groundtrace.pipeline.config import PipelineConfig
from groundtrace.pipeline.parameters import StageConfig
from groundtrace.pipeline.results import read_results
from groundtrace_codecs.events import Gap, Note, Presence
from groundtrace_codecs.signals import SignalBlock
from groundtrace_codecs.writer import write_recording

if TYPE_CHECKING:
    from collections.abc import Generator

    from groundtrace.pipeline.split import SpanReplay

Capture = pytest.CaptureFixture[str]
#: What is missing of the recordings [s]: nothing, or what ends runs near where they are cut.
MISSING = {"whole": (), "gaps": ((9.0, 9.6), (47.9, 48.2), (50.0, 50.03), (74.0, 99.0))}
PIPELINES = ("room-steps", "room-bearings", "room-footsteps", "room-two-walkers")


@pytest.mark.parametrize(
    ("pipeline", "missing", "count"),
    swept(
        product(PIPELINES, MISSING, (2, 7)),
        ("room-steps", "gaps", 2),
        ("room-bearings", "whole", 2),
        ("room-footsteps", "gaps", 7),
        ("room-two-walkers", "whole", 7),
    ),
)
def test_a_room_in_spans_is_decided_as_in_one_go(
    pipeline: str, missing: str, count: int, tmp_path: Path
) -> None:
    samples = impacts(3, 150.0)
    path = written(tmp_path / "room.mcap", GROUND, samples, MISSING[missing])
    whole, counts = in_one_go(path, pipeline)
    part, tally, split, _ = in_spans(path, pipeline, count)
    assert_same_events(whole, part)
    assert (tally.samples, tally.counts) == (counts.samples, counts.counts)
    assert (tally.first_ns, tally.last_ns) == (counts.first_ns, counts.last_ns)
    assert split.again <= (count if missing == "gaps" else 0)
    assert counts.counts["CandidateBlock"] > 500


@pytest.mark.parametrize("missing", [(), ((60.0, 60.7), (119.9, 120.1))], ids=["whole", "gaps"])
def test_a_walk_in_spans_is_decided_as_in_one_go(
    missing: tuple[tuple[float, float], ...], tmp_path: Path
) -> None:
    path = written(tmp_path / "walk.mcap", WAIST, shaken(1), missing)
    whole, _ = in_one_go(path, "waist-swing")
    part, _, split, _ = in_spans(path, "waist-swing", 4)
    assert_same_events(whole, part)
    assert any(isinstance(event, Gap) for event in whole) == bool(missing)
    assert split.again <= len(missing)


@pytest.mark.sweep
def test_vehicles_are_heard_in_spans_and_their_passes_found_in_one_go(tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    samples = rng.normal(size=(300_000, 9))
    for at in rng.uniform(0, 290_000, 25).astype(int):  # some are on where spans meet
        swell = np.hanning(rng.integers(2000, 9000))[:, None]
        part = samples[at : at + len(swell)]
        part += 6 * swell[: len(part)] * rng.normal(size=part.shape)
    path = written(tmp_path / "road.mcap", GROUND, (samples * 100).astype(np.int32))
    whole, _ = in_one_go(path, "vehicle-passes")
    part, _, split, said = in_spans(path, "vehicle-passes", 2)
    assert_same_events(whole, part)
    assert split.again == 0
    assert "through presence; in one go" in said[0]
    assert sum(isinstance(event, Presence) for event in whole) > 20


def test_stages_in_one_go_may_stand_between_those_in_spans(tmp_path: Path) -> None:
    path = written(tmp_path / "room.mcap", GROUND, impacts(4, 120.0))
    uses = ("toa-cv", "coincidence", "gcc-phat", "sta-lta", "power-law", "bearings", "disagreement")
    config = PipelineConfig(
        "mixed", stage=tuple(StageConfig(use) for use in (*uses[:4], "bearings"))
    )
    whole, _ = in_one_go(path, config)
    part, *_ = in_spans(path, config, 5)
    assert_same_events(whole, part)


def test_samples_come_with_the_joined_events(tmp_path: Path) -> None:
    path = written(tmp_path / "room.mcap", GROUND, impacts(3, 150.0), MISSING["gaps"])
    whole, _ = in_one_go(path, "room-steps")
    part, *_ = in_spans(path, "room-steps", 6, signal=True)
    assert_same_events(whole, part)


def test_a_step_that_waits_for_the_next_one_over_a_quiet_time_is_not_lost(tmp_path: Path) -> None:
    path = written(tmp_path / "room.mcap", GROUND, impacts(5, 160.0, (30.0, 130.0)))
    whole, _ = in_one_go(path, "room-steps")
    part, _, split, said = in_spans(path, "room-steps", 6)
    assert_same_events(whole, part)
    assert split.again > 0
    assert any("is replayed again from earlier on: " in line for line in said)


def test_samples_that_are_no_numbers_are_held_as_in_one_go(tmp_path: Path) -> None:
    samples = impacts(3, 150.0).astype(np.float64)
    samples[40_000:90_000, 2] = np.nan
    samples[120_000, :] = np.inf
    path = written(tmp_path / "room.mcap", GROUND, samples)
    whole, _ = in_one_go(path, "room-steps")
    part, *_ = in_spans(path, "room-steps", 5)
    assert_same_events(whole, part)
    assert any(isinstance(e, Note) and "not finite" in e.text for e in whole)


def test_a_clock_that_drifts_is_followed_as_in_one_go(tmp_path: Path) -> None:
    samples = impacts(3, 150.0)
    blocks = [
        SignalBlock(GROUND, START_NS + 3 * at * 1000, at, samples[at : at + 50])
        for at in range(0, len(samples), 50)
    ]
    write_recording(tmp_path / "room.mcap", [(GROUND, "i32le", blocks)])
    whole, _ = in_one_go(tmp_path / "room.mcap", "room-steps")
    part, _, split, _ = in_spans(tmp_path / "room.mcap", "room-steps", 4)
    assert_same_events(whole, part)
    assert split.again > 0, "the run's times were moved before"


def test_what_cannot_be_split_is_replayed_in_one_go_and_said(tmp_path: Path) -> None:
    path = written(tmp_path / "walk.mcap", WAIST, shaken(1))
    whole, _ = in_one_go(path, "waist-steps")
    part, _, _, said = in_spans(path, "waist-steps", 4)
    assert_same_events(whole, part)
    line = "walk.mcap is replayed in one go: steps depends on all that comes before"
    assert said == [line]
    short = written(tmp_path / "short.mcap", GROUND, impacts(3, 100.0)[:20_000])
    _, _, _, said = in_spans(short, "room-steps", None)  # type: ignore[arg-type]
    assert said == ["short.mcap is replayed in one go: it is shorter than two warm-ups of 22 s"]


@pytest.mark.sweep
def test_a_stage_that_learns_takes_what_spans_measured_and_no_signal(
    room: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, _ = in_one_go(room, "room-footsteps")
    monkeypatch.setattr(PlannedReplay, "signal", lambda _: pytest.fail("the signal is read again"))
    part, _, _, said = in_spans(room, "room-footsteps", 3)
    assert_same_events(whole, part)
    assert said[0].endswith("the signal of arrivals, times-amplitudes measured in spans")


def test_a_fleet_with_more_workers_than_recordings_replays_long_ones_in_spans(
    room: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.setattr(splitting, "WARM_UPS", 2)
    written(Path("short.mcap"), GROUND, impacts(3, 150.0)[:20_000])
    use(monkeypatch, engine := Here())
    arguments = ("room.mcap", "short.mcap", "--pipeline", "room-footsteps")
    whole = ran_fleet(capsys, *arguments, "--out", "a.parquet", "--workers", 2)
    assert [type(task) for task in engine.given] == [Task, Task], "no worker has nothing to do"
    use(monkeypatch, engine := Here())
    part = ran_fleet(capsys, *arguments, "--out", "b.parquet", "--workers", 3)
    assert [type(task) for task in engine.given] == [SpanTask] * 3 + [Task]
    assert (part["digest"], part["rows"], part["errors"]) == (whole["digest"], 2, 0)
    known = ran_fleet(
        capsys, *arguments, "--out", "b.parquet", "--workers", 3, "--resume", "--force"
    )
    assert (known["known"], known["digest"]) == (2, whole["digest"])


def test_one_worker_is_told_why_its_recording_is_replayed_in_one_go(room: Path) -> None:
    _, _, _, said = in_spans(room, "room-steps", None, workers=1)  # type: ignore[arg-type]
    why = "for one worker it is shorter than two spans of 438 s"
    assert said == [f"room.mcap is replayed in one go: {why}"]


@pytest.fixture
def room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return written(Path("room.mcap"), GROUND, impacts(3, 150.0))


def dying(task: SpanTask) -> SpanReplay | splitting.Refusal:
    """Replay a span; the first time that of the second begins, the process is killed."""
    marker = Path(task.folder, "killed")
    if task.span.first is not None and not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return replayed(task)


def dead(task: SpanTask) -> None:
    """End the process."""
    del task
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.sweep
def test_a_worker_that_dies_costs_time_alone(room: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole, _ = in_one_go(room, "room-steps")
    monkeypatch.setattr(splitting, "replayed", dying)
    part, *_ = in_spans(room, "room-steps", 2, engine_of("local", 2))
    assert Path("killed").exists()
    assert_same_events(whole, part)
    monkeypatch.setattr(splitting, "replayed", dead)
    with pytest.raises(RecordingError) as told:
        in_spans(room, "room-steps", 2, engine_of("local", 1))
    said = "expected a worker that ends, found it killed twice, or overdue"
    assert str(told.value) == f"room.mcap: {said}"


def test_a_recording_that_a_worker_does_not_see_is_told(room: Path) -> None:
    with pytest.raises(RecordingError) as told:
        in_spans(room, "room-steps", 2, Here(), place="elsewhere/room.mcap")
    host = platform.node()
    assert str(told.value) == f"room.mcap: expected a file, found none visible on worker {host}"
    Path("other").mkdir()
    other = written(Path("other/room.mcap"), GROUND, impacts(3, 150.0)[:90_000])
    with pytest.raises(
        RecordingError, match=r"room\.mcap: expected \d+ bytes, found \d+ on worker"
    ):
        in_spans(room, "room-steps", 2, Here(), place=other)


def test_workers_read_a_url(room: Path) -> None:
    fsspec = pytest.importorskip("fsspec", reason="fsspec is not installed: groundtrace[fleet]")
    memory = fsspec.filesystem("memory")
    memory.pipe("/room.mcap", room.read_bytes())
    whole, _ = in_one_go(room, "room-steps")
    part, *_ = in_spans(room, "room-steps", 3, place="memory://room.mcap")
    assert_same_events(whole, part)
    memory.store.clear()


@pytest.mark.parametrize(
    ("cluster", "package", "extra"), [("dask", "distributed", "fleet"), ("ray", "ray", "ray")]
)
def test_a_cluster_joins_what_one_go_decides(
    cluster: str, package: str, extra: str, room: Path, capsys: Capture
) -> None:
    pytest.importorskip(package, reason=f"{package} is not installed: groundtrace[{extra}]")
    name = ("--pipeline", "room-steps", "--no-viewer")
    done(capsys, "replay", room, *name, "--out", "a.results.mcap")
    engine = ("--engine", cluster, "--workers", 2)
    said = done(capsys, "replay", room, *name, "--out", "b.results.mcap", *engine, "--quiet")
    one, other = (read_results(Path(f"{name}.results.mcap")) for name in "ab")
    assert_same_events(one.events, other.events)
    assert one.provenance.sha256 == other.provenance.sha256
    assert "3 spans" in said.err or "2 spans" in said.err, said.err


def test_the_command_says_what_it_does_and_refuses_what_it_cannot(
    room: Path, capsys: Capture
) -> None:
    name = ("--pipeline", "room-bearings", "--engine", "local", "--workers", 2)
    said = done(capsys, "replay", room, *name, "--quiet")
    assert "no timeline is written with --engine: --rrd FILE writes one" in said.err
    assert "in one go, since they depend on all before: track" in said.err
    assert not Path("room.rrd").exists()
    for option in (("--from", 3), ("--strict",), ("--at-miss", 1), ("--follow",)):
        error = run(capsys, "replay", room, *name, *option).error
        assert error.startswith("--engine: expected no --from, --to,")
    assert run(capsys, "replay", room, "--workers", 2).error.startswith("--workers: expected it")
    error = run(capsys, "replay", room, "--engine", "none").error
    assert error.startswith("--engine: expected local, dask,")


def test_what_is_taken_ahead_comes_in_order_and_is_closed() -> None:
    closed = []

    def numbers(*, fails: bool = False) -> Generator[int]:
        try:
            yield from range(5)
            if fails:
                raise ValueError("at the end")
        finally:
            closed.append(True)

    assert list(ahead(numbers(), 2)) == list(range(5))
    with pytest.raises(ValueError, match="at the end"):
        list(ahead(numbers(fails=True), 2))
    some = ahead(numbers(), 1)
    assert next(some) == 0
    assert next(some) == 1
    some.close()
    assert len(closed) == 3


def test_a_recording_that_was_replaced_is_opened_anew(room: Path) -> None:
    before, *_ = in_spans(room, "room-steps", 3)
    size = room.stat().st_size
    written(Path("other.mcap"), GROUND, impacts(4, 150.0))
    whole, _ = in_one_go(Path("other.mcap"), "room-steps")
    Path("other.mcap").replace(room)
    part, *_ = in_spans(room, "room-steps", 3)
    assert room.stat().st_size != size
    assert_same_events(whole, part)
    assert len(part) != len(before)
