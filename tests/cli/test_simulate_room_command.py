"""``groundtrace simulate room``: every option through the command line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from command_runs import done, run

from groundtrace_codecs.recording import Recording

L_TOML = """
unit = "m"
outline = [[0, 0], [8, 0], [8, 3], [3.5, 3], [3.5, 7], [0, 7]]
medium = {thickness_m = 0.15}

[[sensor]]
name = "A"
channel = "A"
x = 7.5
y = 0.5

[[sensor]]
name = "B"
channel = "B"
x = 0.5
y = 6.5

[[sensor]]
name = "C"
channel = "C"
x = 1.0
y = 1.0
"""


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("l.toml").write_text(L_TOML, "utf-8")


def simulated(capsys: pytest.CaptureFixture[str], options: str) -> None:
    assert "pick" in done(capsys, "simulate", "room", "-o", "r.mcap", *options.split()).out


SHORT = "--steps 4 --rate-hz 2000"


@pytest.mark.parametrize(
    ("options", "channels", "said"),
    [
        ("--geometry l.toml", 3, {"channels": "3"}),
        ("--side-m 6x4 --channels 5", 5, {"side_m": "(6.0, 4.0)"}),
        ("--side-m 7", 9, {"side_m": "(7.0, 7.0)"}),
        ("--thickness-m 0.15 --loss-s 2e-5", 9, {"thickness_m": "0.15", "loss_s": "2e-05"}),
        ("--dispersion-m2s 120", 9, {"dispersion_m2s": "120.0"}),
        ("--shoe bare", 9, {"shoe": "bare"}),
        ("--shoe mixed", 9, {"shoe": "mixed"}),
        ("--walls 0.4 --resonances", 9, {"walls": "0.4", "resonances": "True"}),
        ("--path there-and-back", 9, {"path": "there-and-back"}),
        ("--path circle --snr 30", 9, {"path": "circle", "snr": "30.0"}),
        ("--walkers 2", 9, {"walkers": "2"}),
        ("--impacts", 9, {"impacts": "True"}),
        (
            "--clock-offset-ms G2=5 --clock-offset-ms G3=-1.5 --clock-spread-ms 1",
            9,
            {"clock_offset_s": "(('G2', 0.005), ('G3', -0.0015))", "clock_spread_s": "0.001"},
        ),
        ("--dead G3 --dead G4 --clipped G5", 9, {"dead": "('G3', 'G4')", "clipped": "('G5',)"}),
        ("--triaxial --channels 4", 12, {"triaxial": "True", "channels": "4"}),
        ("--random --seed 3", None, {"random": "True", "seed": "3"}),
        ("--random --geometry l.toml --impacts", 3, {"thickness_m": "0.15"}),
    ],
)
def test_every_option_makes_a_recording_that_says_it(options, channels, said, capsys):
    simulated(capsys, f"{SHORT} {options}")
    with Recording.open(Path("r.mcap")) as recording:
        assert recording.damage == ()
        (stream,) = recording.streams
        names = [c.name for c in stream.channels]
        assert channels is None or len(names) == channels
        assert said.items() <= recording.metadata["simulation"].items()
        assert [s.channel for s in recording.geometry.sensors] == names
        struck = [x for x in recording.labels if x.kind in ("step", "impact")]
        assert len(struck) == (8 if "walkers" in options else 4)
        samples = np.concatenate([part.block.samples for part in recording.blocks()])
        assert samples.any(axis=0).sum() == len(names) - options.count("--dead")


def test_stations_are_stored_with_their_axes(capsys):
    simulated(capsys, f"{SHORT} --triaxial --geometry l.toml")
    with Recording.open(Path("r.mcap")) as recording:
        sensors = [(s.name, s.channel, s.axis) for s in recording.geometry.sensors]
        assert sensors[:3] == [("A", "Ax", "x"), ("A", "Ay", "y"), ("A", "Az", "z")]
        assert [c.axis for c in recording.streams[0].channels] == list("xyz" * 3)


def test_two_walkers_are_told_apart_in_the_stored_truth(capsys):
    simulated(capsys, f"{SHORT} --path crossing")
    with Recording.open(Path("r.mcap")) as recording:
        targets = {(x.kind, x.target) for x in recording.labels}
    assert targets == {(kind, who) for kind in ("step", "pick", "walking") for who in "12"}


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ("--geometry none.toml", "none.toml: expected a geometry, found no such file"),
        ("--side-m 6by4", "--side-m: expected a side as 6 or 6x4, found '6by4'"),
        ("--side-m 1x4", "simulate room: side_m: expected 2 to 30, found 1.0"),
        ("--walls 1", "simulate room: walls: expected 0 to 0.9, found 1.0"),
        ("--clock-offset-ms G2", "--clock-offset-ms: expected a sensor and its offset in ms as"),
        ("--clock-offset-ms G2=nan", "simulate room: clock offset of G2: expected -0.1 to 0.1 s"),
        ("--dead G20", "simulate room: dead: expected one of G1, G2, G3, G4, G5, G6, G7, G8, G9"),
        ("--impacts --path u", "simulate room: impacts: expected none beside a path or walkers"),
        ("--channels 40", "simulate room: channels: expected 3 to 16, found 40"),
    ],
)
def test_impossible_options_are_refused_in_one_line(options, said, capsys):
    ran = run(capsys, "simulate", "room", "-o", "r.mcap", *options.split())
    assert ran.error.startswith(said)
    assert not Path("r.mcap").exists()


@pytest.mark.parametrize("options", ["--path zigzag", "--shoe boot"])
def test_an_unknown_word_is_wrong_usage(options, capsys):
    ran = run(capsys, "simulate", "room", "-o", "r.mcap", *options.split())
    assert ran.code == 2
    assert options.split()[1] in ran.err
