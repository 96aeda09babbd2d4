"""The bundled recordings: found, small, and what simulators and sources give today."""

from __future__ import annotations

import shlex
from dataclasses import replace
from importlib.resources import files
from typing import TYPE_CHECKING

import excerpts
import numpy as np
import pytest

import groundtrace_recordings
from groundtrace.api.inspection import SOURCE
from groundtrace.simulate.gait import WalkOptions
from groundtrace.simulate.recording import write
from groundtrace.simulate.road import VehicleOptions
from groundtrace.simulate.room import simulate_room
from groundtrace.simulate.room_plan import RoomOptions
from groundtrace.simulate.vehicle import simulate_vehicle
from groundtrace.simulate.walk import simulate_walk
from groundtrace_codecs.recording import Recording

if TYPE_CHECKING:
    from pathlib import Path

    from groundtrace_codecs.events import Label

SIMULATED = {
    "room-walk.mcap": simulate_room,
    "vehicle-pass.mcap": simulate_vehicle,
    "waist-walk.mcap": simulate_walk,
}

#: One count of each stream whose channels do not say it as their scale.
RESOLUTION = {"/imu/waist": 0.0024, "/mag/waist": 1e-8, "/baro/waist": 0.1}


def samples(blocks) -> np.ndarray:
    return np.concatenate([block.values for block in blocks])


def messages_of(path: Path) -> list[tuple[str, int, bytes]]:
    """Return every message of a file: topic, log time, bytes."""
    with Recording.open(path) as recording:
        file = recording.file
        return [
            (file.channels[m.channel_id].topic, m.log_time, bytes(m.data))
            for m in file.as_recorded()
        ]


def truth_of(path: Path) -> tuple[Label, ...]:
    with Recording.open(path) as recording:
        return recording.labels


def test_the_recordings_are_found_and_small():
    real = [f"{name}.mcap" for name in excerpts.descriptions()]
    assert list(groundtrace_recordings.bundled()) == sorted([*SIMULATED, *real])
    for name, path in groundtrace_recordings.bundled().items():
        assert groundtrace_recordings.path_of(name) == path
        assert 10_000 < path.stat().st_size < 4_000_000


def test_maps_are_found_by_name():
    for name, path in groundtrace_recordings.maps().items():
        assert groundtrace_recordings.map_path(name) == path


def test_an_unknown_name_says_which_there_are():
    with pytest.raises(groundtrace_recordings.UnknownFileError, match=r"room-walk\.mcap"):
        groundtrace_recordings.path_of("nothing.mcap")
    with pytest.raises(groundtrace_recordings.UnknownFileError, match="expected a bundled map"):
        groundtrace_recordings.map_path("nothing.toml")


@pytest.mark.parametrize("name", SIMULATED)
def test_a_bundled_recording_holds_what_its_simulator_gives(name):
    simulation = SIMULATED[name]()
    with Recording.open(groundtrace_recordings.path_of(name)) as recording:
        assert recording.damage == ()
        assert recording.labels == simulation.labels
        assert recording.geometry == simulation.geometry
        assert len(recording.streams) == len(simulation.sources)
        for stream, _, blocks in simulation.sources:
            stored = [s.block for s in recording.blocks([stream.topic])]
            assert stored[0].start_ns == next(iter(blocks)).start_ns
            assert stored[0].stream.rate_hz == pytest.approx(stream.rate_hz)
            apart = np.abs(samples(stored) - samples(blocks)) / RESOLUTION.get(
                stream.topic, stream.scales
            )
            # Another processor may round another way: one count, and seldom.
            assert apart.max() < 1.01
            assert np.mean(apart > 1e-6) < 1e-4
        assert recording.metadata["simulation"] == simulation.metadata["simulation"]


@pytest.mark.parametrize("name", SIMULATED)
def test_writing_again_gives_the_same_bytes(name, tmp_path):
    for copy in ("a.mcap", "b.mcap"):
        write(SIMULATED[name](), tmp_path / copy)
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_the_readme_says_the_commands_and_their_seeds():
    text = files(groundtrace_recordings).joinpath("README.md").read_text(encoding="utf-8")
    commands = [shlex.split(part) for part in text.split("`") if part.startswith("groundtrace sim")]
    assert commands == [
        ["groundtrace", "simulate", kind, "-o", name, "--seed", str(options.seed)]
        for kind, name, options in (
            ("room", "room-walk.mcap", RoomOptions()),
            ("vehicle", "vehicle-pass.mcap", VehicleOptions()),
            ("walk", "waist-walk.mcap", WalkOptions()),
        )
    ]


@pytest.mark.parametrize("name", excerpts.descriptions())
def test_an_excerpt_says_where_it_is_from(name):
    described = excerpts.descriptions()[name]
    folder = groundtrace_recordings.path_of(f"{name}.mcap").parent
    with Recording.open(folder / f"{name}.mcap") as recording:
        told = recording.metadata[SOURCE]
        assert recording.damage == ()
    assert told == {key: described[key] for key in excerpts.TOLD}
    assert f"`{name}.mcap`" in (folder / "README.md").read_text("utf-8")
    assert f"## {name}.mcap" in (folder / "THIRD_PARTY.md").read_text("utf-8")


@pytest.mark.sweep
@pytest.mark.parametrize("name", excerpts.descriptions())
def test_an_excerpt_is_made_again_from_its_source(name, tmp_path, data):
    made = excerpts.make(name, excerpts.descriptions()[name], data, tmp_path)
    kept = groundtrace_recordings.path_of(made.name)
    # headings are arc tangents, whose last bit depends on the processor
    signals = [[m for m in messages_of(path) if m[0] != "/truth"] for path in (made, kept)]
    assert signals[0] == signals[1]
    truths = [truth_of(path) for path in (made, kept)]
    assert [replace(x, value=None) for x in truths[0]] == [
        replace(x, value=None) for x in truths[1]
    ]
    values = [np.array([x.value for x in truth], float) for truth in truths]
    np.testing.assert_allclose(*values, rtol=1e-12, atol=1e-12)
