"""``groundtrace simulate vehicle``: every option through the command line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from command_runs import done, run

from groundtrace_codecs.geometry import Geometry
from groundtrace_codecs.recording import Recording

ROAD_TOML = """
unit = "ft"
road = [[-300, 30], [300, 30], [300, 600]]

[[sensor]]
name = "P"
channel = "P"
x = 0.0
y = 0.0

[[sensor]]
name = "Q"
channel = "Q"
x = 100.0
y = 0.0
"""


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("road.toml").write_text(ROAD_TOML, "utf-8")


@pytest.mark.parametrize(
    ("options", "channels", "said"),
    [
        ("", 6, {"simulator": "vehicle", "layout": "antennas"}),
        ("--layout stations --stations 2 --spacing-m 40", 2, {"spacing_m": "40.0"}),
        ("--components 3 --layout stations", 9, {"components": "3"}),
        ("--rate-hz 100", 6, {"rate_hz": "100.0"}),
        ("--geometry road.toml", 2, {}),
        ("--passes 3 --overlap", 6, {"passes": "3", "overlap": "True"}),
        ("--speed-mps 25 --end-speed-mps 5", 6, {"end_speed_mps": "5.0"}),
        ("--offset-m -8 --heading-deg 30 --radius-m -80", 6, {"radius_m": "-80.0"}),
        ("--velocity-mps 180 --exponent 2 --loss-spm 1e-4", 6, {"loss_spm": "0.0001"}),
        ("--coherence-m 4 --level-spread-db 2", 6, {"coherence_m": "4.0"}),
        ("--band-hz 8-20 --engine-hz 11", 6, {"band_hz": "(8.0, 20.0)", "engine_hz": "11.0"}),
        ("--snr 30 --wind 2 --gain-spread 0.1", 6, {"wind": "2.0", "gain_spread": "0.1"}),
        ("--geophone-hz 4.5 --walkers 1 --impacts 2", 6, {"walkers": "1", "impacts": "2"}),
    ],
)
def test_every_option_makes_a_recording_that_says_it(options, channels, said, capsys):
    ran = done(capsys, "simulate", "vehicle", "-o", "r.mcap", "--duration-s", "6", *options.split())
    assert "pass" in ran.out
    with Recording.open(Path("r.mcap")) as recording:
        assert recording.damage == ()
        (stream,) = recording.streams
        assert len(stream.channels) == channels
        assert said.items() <= recording.metadata["simulation"].items()
        assert [s.channel for s in recording.geometry.sensors] == [c.name for c in stream.channels]
        samples = np.concatenate([part.block.samples for part in recording.blocks()])
        assert len(samples) == round(6 * stream.rate_hz)
        assert samples.std(axis=0).min() > 1


def test_corners_of_a_road_are_waypoints(capsys):
    command = ("simulate", "vehicle", "-o", "r.mcap", "--duration-s", "6")
    done(capsys, *command, "--waypoints", "-50,-5 20,10 60,10")
    with Recording.open(Path("r.mcap")) as recording:
        assert recording.geometry.road == ((-50.0, -5.0), (20.0, 10.0), (60.0, 10.0))


def test_a_geometry_has_its_road_in_its_own_unit_and_keeps_it(capsys):
    site = Geometry.from_toml(Path("road.toml"))
    assert site.road[1] == pytest.approx((91.44, 9.144))
    Path("again.toml").write_text(site.to_toml(), "utf-8")
    assert Geometry.from_toml(Path("again.toml")) == site
    done(capsys, "simulate", "vehicle", "-o", "r.mcap", "--geometry", "road.toml")
    with Recording.open(Path("r.mcap")) as recording:
        passes = [x for x in recording.labels if x.kind == "pass"]
        assert {p.channel for p in passes} == {"P", "Q"}
        assert {round(p.y_m, 3) for p in passes} == {9.144}
        assert Geometry.from_json(recording.geometry.to_json()).road == recording.geometry.road


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ("--geometry none.toml", "none.toml: expected a geometry, found no such file"),
        ("--speed-mps 50", "simulate vehicle: speed_mps: expected 2 to 30, found 50.0"),
        ("--stations 3", "simulate vehicle: stations: expected none beside the layout antennas"),
        ("--overlap", "simulate vehicle: overlap: expected 2 passes or more, found 1"),
        ("--components 2", "simulate vehicle: components: expected 1 or 3, found 2"),
        ("--band-hz 10-90", "simulate vehicle: band_hz: expected 1 to 64 Hz, found 10-90"),
        ("--waypoints -50,-5,", "--waypoints: expected it as -100,5 20,5, found '-50,-5,'"),
        ("--band-hz low", "--band-hz: expected it as 10-40, found 'low'"),
        ("--rate-hz 12", "simulate vehicle: rate_hz: expected 50 to 1000, found 12.0"),
        ("--passes 2 --end-speed-mps 5", "simulate vehicle: end_speed_mps: expected none beside"),
        ("--waypoints 3,4 --offset-m 2", "simulate vehicle: waypoints: expected 2 places or more"),
        ("--wind nan", "simulate vehicle: wind: expected 0 to 1000, found nan"),
        ("--duration-s inf", "simulate vehicle: duration_s: expected 2 to 86400, found inf"),
    ],
)
def test_impossible_options_are_refused_in_one_line(options, said, capsys):
    ran = run(capsys, "simulate", "vehicle", "-o", "r.mcap", *options.split())
    assert ran.error.startswith(said)
    assert not Path("r.mcap").exists()


def test_an_unknown_layout_is_wrong_usage(capsys):
    assert run(capsys, "simulate", "vehicle", "-o", "r.mcap", "--layout", "ring").code == 2
