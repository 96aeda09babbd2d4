"""``groundtrace cut``, ``filter`` and ``convert``: what copies hold, and what is refused."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from annotated_recordings import recording_in
from command_runs import (
    assert_decided_alike,
    assert_same_decisions,
    check_schema,
    decided_by,
    decisions,
    done,
    run,
)

from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import load_pipeline
from groundtrace.pipeline.engine import EventList, replay
from groundtrace.pipeline.source import Source
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S
from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from collections.abc import Sequence

Capture = pytest.CaptureFixture[str]
ROOM, WALK = path_of("room-walk.mcap"), path_of("waist-walk.mcap")


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def replayed(capsys: Capture, recording: Path, name: str, *options: object) -> Path:
    done(capsys, "replay", recording, "--no-viewer", "--out", name, *options)
    return Path(name)


def rerun_check(path: Path) -> list[str]:
    """Return what Rerun says of each channel; CI=1 keeps it from calling home."""
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    program = Path(sys.executable).with_name("rerun")
    ran = subprocess.run(
        [program, "mcap", "check", path],
        env={**os.environ, "CI": "1"},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    lines = [line for line in ran.stdout.splitlines() if " /" in line]
    return [line.split()[0] for line in lines]


@pytest.mark.parametrize(
    ("source", "pipeline", "span"),
    [
        (ROOM, "room-footsteps", (2.0123, 4.5)),
        (WALK, "waist-steps", (10.017, 20.0)),
    ],
)
def test_a_cut_is_decided_as_by_stages_that_see_its_span_alone(
    source: Path, pipeline: str, span: tuple[float, float], capsys: Capture
) -> None:
    done(capsys, "cut", source, "-o", "part.mcap", "--from", span[0], "--to", span[1])
    part = replayed(capsys, Path("part.mcap"), "part.results.mcap")
    kept = EventList()
    with Recording.open(source) as recording:
        start_ns, stop_ns = (recording.start_ns + round(s * NS_PER_S) for s in span)
        chain = build_pipeline(load_pipeline(pipeline), recording.geometry)
        replay(Source(recording, start_ns=start_ns, stop_ns=stop_ns), chain, [kept])
    assert_decided_alike(decided_by(kept.events), decisions(part), "the span and its cut")


@pytest.mark.parametrize(
    "options",
    [("--compression", "lz4", "--chunk-kb", 32), ("--block-ms", 230, "--compression", "none")],
)
def test_a_converted_recording_is_decided_alike(options: Sequence[object], capsys: Capture) -> None:
    done(capsys, "cut", ROOM, "-o", "room.mcap", "--to", 3)
    done(capsys, "convert", "room.mcap", "-o", "copy.mcap", *options)
    assert_same_decisions(
        replayed(capsys, Path("room.mcap"), "whole.results.mcap"),
        replayed(capsys, Path("copy.mcap"), "copy.results.mcap"),
    )


def test_rerun_finds_nothing_wrong_with_copies(capsys: Capture) -> None:
    done(capsys, "cut", ROOM, "-o", "cut.mcap", "--from", 1.00012, "--to", 2.71)
    done(capsys, "filter", WALK, "-o", "filter.mcap", "--topic", "/imu/*", "/truth")
    done(capsys, "convert", ROOM, "-o", "convert.mcap", "--block-ms", 20, "--chunk-kb", 64)
    for name, channels in (("cut", 4), ("filter", 2), ("convert", 4)):
        assert rerun_check(Path(f"{name}.mcap")) == ["ok"] * channels


def test_the_json_of_each_command_is_as_its_schema_says(capsys: Capture) -> None:
    cut = done(capsys, "cut", ROOM, "-o", "a.mcap", "--to", 1, "--json").document
    filtered = done(
        capsys, "filter", ROOM, "-o", "b.mcap", "--without", "/seismic*", "--json"
    ).document
    converted = done(capsys, "convert", ROOM, "-o", "c.mcap", "--json").document
    for document in (cut, filtered, converted):
        check_schema("copy", document)
    assert cut["messages"]["/seismic"] == 20
    assert cut["left"]["/seismic"] == 240
    assert filtered["messages"].keys() == {"/tf_static", "/truth"}
    assert converted["left"] == {}


def test_nothing_is_overwritten_without_force_and_the_source_never(capsys: Capture) -> None:
    Path("there.mcap").write_bytes(b"mine")
    for command in (("cut", "--to", 1), ("filter", "--topic", "/truth"), ("convert",)):
        name, *options = command
        refused = run(capsys, name, ROOM, "-o", "there.mcap", *options).error
        assert refused == "there.mcap: expected a new file, found an existing one; see --force"
        assert Path("there.mcap").read_bytes() == b"mine"
    before = ROOM.read_bytes()
    same = run(capsys, "convert", ROOM, "-o", ROOM, "--force").error
    assert same.endswith("expected a new file, found the one that is read")
    done(capsys, "convert", ROOM, "-o", "there.mcap", "--force")
    assert ROOM.read_bytes() == before


def test_results_are_not_cut(capsys: Capture) -> None:
    results = replayed(capsys, WALK, "walk.results.mcap", "--to", 3)
    found = run(capsys, "cut", results, "-o", "part.mcap", "--to", 1).error
    assert found.startswith("walk.results.mcap: expected a recording, found results")


def test_a_span_outside_of_the_recording_is_refused(capsys: Capture) -> None:
    late = run(capsys, "cut", ROOM, "-o", "part.mcap", "--from", 30).error
    assert late.endswith("expected a span of 0 to 13.000 s, found 30 s to the end")
    none = run(capsys, "cut", ROOM, "-o", "part.mcap", "--from", 3, "--to", 3).error
    assert none.endswith("expected a span of 0 to 13.000 s, found 3 s to 3 s")
    assert not list(Path().iterdir())


def test_filter_asks_what_for(capsys: Capture) -> None:
    found = run(capsys, "filter", WALK, "-o", "x.mcap").error
    assert found == "filter: expected --topic or --without, found neither"
    unknown = run(capsys, "filter", WALK, "-o", "x.mcap", "--topic", "/camera").error
    assert "expected a topic like '/camera', found /baro/waist, " in unknown


def test_damage_is_counted_and_left_out(capsys: Capture) -> None:
    data = bytearray(ROOM.read_bytes())
    data[600_000] ^= 1
    Path("hurt.mcap").write_bytes(data)
    ran = done(capsys, "convert", "hurt.mcap", "-o", "copy.mcap", "--json", losses=True)
    assert ran.err.startswith("warning: hurt.mcap: damage, ")
    lost = ran.document["lost"]
    assert len(ran.document["damage"]) == 1
    whole = done(capsys, "convert", ROOM, "-o", "whole.mcap", "--json").document
    assert 0 < lost == sum(whole["messages"].values()) - sum(ran.document["messages"].values())
    with Recording.open("copy.mcap", strict=True) as recording:
        assert sum(len(block) for _, block in recording.blocks()) < 260_000


def test_annotations_beside_are_told_of(tmp_path: Path, capsys: Capture) -> None:
    recording = recording_in(tmp_path)
    done(capsys, "annotate", recording, "--add", "step@3.5")
    ran = done(capsys, "cut", recording, "-o", "part.mcap", "--to", 5)
    assert ran.err.startswith("annotations beside rec.mcap are not in the copy")
    done(capsys, "annotate", recording, "--commit", "-o", "inside.mcap")
    done(capsys, "cut", "inside.mcap", "-o", "part.mcap", "--to", 5, "--force")
    with Recording.open("part.mcap") as opened:
        assert [a.label.kind for a in opened.annotations] == ["step"]
