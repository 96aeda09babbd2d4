"""``groundtrace merge``: clocks given, found and refused, and that nothing of any file is lost."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from command_runs import assert_same_decisions, check_schema, done, run

from groundtrace.cli.main import main
from groundtrace.simulate.gait import WalkOptions
from groundtrace.simulate.recording import write
from groundtrace.simulate.room import simulate_room
from groundtrace.simulate.room_plan import RoomOptions
from groundtrace.simulate.walk import ClockError, Walked, simulate_same_walk
from groundtrace_codecs.events import Label
from groundtrace_codecs.geometry import Geometry, Sensor
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S, Channel, SignalBlock, Stream
from groundtrace_codecs.writer import RecordingWriter

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

Capture = pytest.CaptureFixture[str]
START_NS = 1_700_000_000 * NS_PER_S
AHEAD_S, DRIFT_PPM = 12.345, 35.0
RESULTS = "room.results.mcap"
#: What of room-footsteps finds steps: places take long, and no step depends on them.
FLOOR = """
name = "floor"
[[stage]]
name = "picks"
use = "toa-cv"
[[stage]]
name = "steps"
use = "coincidence"
"""
ACC = tuple(Channel(f"acc_{a}", "acceleration", "m/s2", a) for a in "xyz")
GYRO = tuple(Channel(f"gyro_{a}", "angular_velocity", "rad/s", a) for a in "xyz")


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="module")
def same_walk(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A walk of half a minute as a room and as a waist whose clock is wrong have it."""
    folder = tmp_path_factory.mktemp("walk")
    room = simulate_room(RoomOptions(seed=3, steps=45, rate_hz=2000, channels=4))
    write(room, folder / "room.mcap")
    with Recording.open(folder / "room.mcap") as opened:
        steps = tuple(x for x in opened.labels if x.kind == "step")
        walked = Walked("room.mcap", steps, opened.start_ns, opened.end_ns)
    clock = ClockError(AHEAD_S, DRIFT_PPM)
    write(simulate_same_walk(walked, WalkOptions(seed=4), clock), folder / "imu.mcap")
    (folder / "floor.toml").write_text(FLOOR, "utf-8")
    floor = ["--pipeline", str(folder / "floor.toml"), "--out", str(folder / RESULTS)]
    main(["replay", str(folder / "room.mcap"), "--no-viewer", *floor])
    return folder / "room.mcap", folder / "imu.mcap"


def streamed(
    path: str,
    stream: Stream,
    samples: NDArray[np.float64],
    *,
    start_ns: int = START_NS,
    labels: Sequence[Label] = (),
    geometry: Geometry | None = None,
) -> Path:
    """Write a recording of one stream with a note and an attachment."""
    with RecordingWriter(path) as writer:
        if geometry is not None:
            writer.set_geometry(geometry)
        writer.add_stream(stream, "f64le")
        times = None
        if stream.irregular:
            index = np.arange(len(samples))
            times = start_ns + np.rint(index * stream.period_ns + 1e6 * (index % 3)).astype(int)
        writer.write(SignalBlock(stream, start_ns, 0, samples, times))
        writer.add_labels(labels)
        writer.add_metadata("by", {"who": path})
        writer.add_attachment("note.txt", "text/plain", path.encode())
    return Path(path)


def imu(path: str, topic: str = "/imu/waist", seconds: float = 5.0, **options: object) -> Path:
    samples = np.tile((0.0, 0.0, 9.81, 0.0, 0.0, 0.0), (round(100 * seconds), 1))
    return streamed(path, Stream(topic, (*ACC, *GYRO), 100.0, "waist"), samples, **options)  # type: ignore[arg-type]


def step_labels(times_s: Sequence[float], ahead_s: float = 0.0) -> tuple[Label, ...]:
    return tuple(Label(START_NS + round((t + ahead_s) * NS_PER_S), "step") for t in times_s)


def sample_times(path: Path, topic: str) -> NDArray[np.int64]:
    with Recording.open(path) as opened:
        return np.concatenate([b.sample_times() for _, b in opened.blocks([topic])])


def test_the_clock_of_a_waist_is_found_by_the_steps_of_a_room(
    same_walk: tuple[Path, Path], capsys: Capture
) -> None:
    room, waist = same_walk
    ran = done(capsys, "merge", room, waist, "-o", "both.mcap", "--json")
    assert f"room.mcap: 45 steps, by {RESULTS}" in ran.err
    assert "imu.mcap: 46 steps, by a replay with waist-steps" in ran.err
    found = ran.document
    check_schema("merge", found)
    clock = found["clocks"][1]
    assert (clock["matched"], clock["of"], clock["ambiguous"]) == (45, 45, False)
    # half of it is what waist-steps calls the moment of a step: 30 ms after contact
    assert clock["ahead_s"] == pytest.approx(AHEAD_S, abs=0.03)
    assert abs(clock["second"]["from_best_s"]) == pytest.approx(0.55, abs=0.05)
    info = done(capsys, "info", "both.mcap")
    assert f"time: clock of imu.mcap: {clock['ahead_s']:.6f} s" in info.out
    assert "(steps, 45 of 45)" in info.out


def test_both_pipelines_decide_on_one_timeline_as_they_did_on_two(
    same_walk: tuple[Path, Path], capsys: Capture
) -> None:
    room, waist = same_walk
    given = ("--offset", f"imu={AHEAD_S}", "--drift", f"imu={DRIFT_PPM}")
    done(capsys, "merge", room, waist, "-o", "both.mcap", *given)
    floor = ("--pipeline", room.with_name("floor.toml"), "--out", "both.r.mcap")
    done(capsys, "replay", "both.mcap", "--no-viewer", *floor)
    assert_same_decisions(room.with_name(RESULTS), Path("both.r.mcap"))
    done(
        capsys, "replay", "both.mcap", "--no-viewer", "--pipeline", "waist-steps", "--out", "w.mcap"
    )
    score = done(capsys, "score", "w.mcap", "--tolerance", "0.05", "--json").document["steps"]
    assert score["truth"] == 45
    assert score["f1"] > 0.97


def test_true_steps_give_offset_and_drift_of_a_simulated_walk(
    same_walk: tuple[Path, Path], capsys: Capture
) -> None:
    truth = ("--steps", "room=truth", "--steps", "imu.mcap=truth")
    found = done(capsys, "merge", *same_walk, "-o", "both.mcap", *truth, "--json").document
    assert found["clocks"][1]["ahead_s"] == pytest.approx(AHEAD_S, abs=1e-4)
    assert found["clocks"][1]["drift_ppm"] == pytest.approx(DRIFT_PPM, abs=0.1)
    # the steps and the one span of walking
    (doubled,) = found["conflicts"]
    assert doubled.startswith("imu: 46 of ")
    assert doubled.endswith(" labels say what an earlier file says: kept on /truth/imu")
    with Recording.open("both.mcap") as opened:
        assert sum(x.kind == "step" for x in opened.labels) == 45


def test_a_metronome_is_refused_unless_forced_or_given(capsys: Capture) -> None:
    times_s = [2 + 0.5 * k for k in range(30)]
    imu("a.mcap", seconds=20.0, labels=step_labels(times_s))
    later_ns = START_NS + 3 * NS_PER_S
    imu("b.mcap", "/imu/foot", 20.0, labels=step_labels(times_s, 3.0), start_ns=later_ns)
    command = (
        "merge",
        "a.mcap",
        "b.mcap",
        "-o",
        "ab.mcap",
        "--steps",
        "a=truth",
        "--steps",
        "b=truth",
    )
    refused = run(capsys, *command)
    assert refused.code == 1
    assert "b.mcap: clock: expected steps that fit in one way only, found 30 of 30" in refused.err
    assert "--offset b.mcap=SECONDS, or --force" in refused.err
    assert not Path("ab.mcap").exists()
    forced = done(capsys, *command, "--force")
    assert "warning: b.mcap: clock is ambiguous" in forced.err
    done(capsys, "merge", "a.mcap", "b.mcap", "-o", "given.mcap", "--offset", "b=3")
    assert np.array_equal(
        sample_times(Path("given.mcap"), "/imu/foot"), sample_times(Path("a.mcap"), "/imu/waist")
    )


def test_nothing_of_any_file_is_lost_and_what_two_say_is_told_apart(capsys: Capture) -> None:
    site = Geometry(sensors=(Sensor("G1", "G1", 0.0, 0.0),))
    other = Geometry(sensors=(Sensor("G2", "G2", 1.0, 0.0),))
    imu("a.mcap", geometry=site, labels=step_labels([1.0, 2.0]))
    imu("b.mcap", "/imu/foot", geometry=other, labels=step_labels([2.05, 5.0]))
    ran = done(capsys, "merge", "a.mcap", "b.mcap", "-o", "ab.mcap", "--align", "none")
    assert "b: 1 of 2 labels say what an earlier file says: kept on /truth/b" in ran.err
    assert "b: another geometry: kept as attachment b/site.json" in ran.err
    with Recording.open("ab.mcap") as opened:
        assert opened.geometry == site
        assert [(x.time_ns - START_NS) / NS_PER_S for x in opened.labels] == [1.0, 2.0, 5.0]
        names = {ref.name for ref in opened.file.attachments}
        assert names == {"site.json", "b/site.json", "note.txt", "b/note.txt"}
        assert opened.metadata["by"] == {"who": "a.mcap"}
        assert opened.metadata["by/b"] == {"who": "b.mcap"}
        counts = opened.topic_counts
    assert counts["/imu/waist"] == counts["/imu/foot"] == 500
    assert counts["/truth/b"] == counts["/tf_static/b"] == 1


@pytest.mark.parametrize("irregular", [False, True])
@pytest.mark.parametrize("channels", [(*ACC, *GYRO), ACC])
def test_a_merge_is_undone_to_the_nanosecond(
    channels: tuple[Channel, ...], irregular: bool, capsys: Capture
) -> None:
    stream = Stream("/foot", channels, 200.0, irregular=irregular)
    samples = np.random.default_rng(1).standard_normal((900, len(channels)))
    imu("a.mcap")
    streamed("b.mcap", stream, samples, labels=step_labels([3.0]))
    clocks = ("--offset", "b=-7.25", "--drift", "b=-80", "--offset", "/foot=0.05")
    done(capsys, "merge", "a.mcap", "b.mcap", "-o", "ab.mcap", *clocks)
    before, there = sample_times(Path("b.mcap"), "/foot"), sample_times(Path("ab.mcap"), "/foot")
    since_ns = before - START_NS
    gained = -80e-6 / (1 - 80e-6)
    # the topic's clock is ahead of the file's, whose clock is behind that of the first file
    expected = since_ns + 7.2e9 - (since_ns - 0.05e9) * gained
    assert np.abs(there - START_NS - expected).max() <= 2
    done(capsys, "merge", "ab.mcap", "--undo", "-o", "back.mcap")
    assert np.abs(sample_times(Path("back.mcap"), "/foot") - before).max() <= 1
    with Recording.open("back.mcap") as opened, Recording.open("b.mcap") as first:
        assert [x.time_ns for x in opened.labels] == [x.time_ns for x in first.labels]
        assert "groundtrace.merge" not in opened.metadata
        values = np.concatenate([b.values for _, b in opened.blocks(["/foot"])])
    assert np.array_equal(values, samples)


def test_impacts_at_start_and_end_align_two_recordings(capsys: Capture) -> None:
    rng = np.random.default_rng(2)
    struck_s = np.array([1.1, 1.9, 3.4, 55.2, 56.9, 57.6])
    for name, topic, rate_hz, ahead_s in (
        ("a", "/seismic", 1000.0, 0.0),
        ("b", "/acc", 200.0, 4.2),
    ):
        seismic = topic == "/seismic"
        channels = (Channel("G1", "ground_velocity", "m/s"),) if seismic else ACC
        times_s = np.arange(round(60 * rate_hz)) / rate_hz
        signal = 0.05 * rng.standard_normal((len(times_s), len(channels)))
        for at_s in struck_s:
            after_s = np.maximum(times_s - at_s, 0.0)
            ring = np.exp(-after_s / 0.03) * np.sin(2 * np.pi * 40 * after_s)
            signal[:, -1] += 20 * ring
        signal[:, -1] += 0 if seismic else 9.81
        start_ns = START_NS + round(ahead_s * NS_PER_S)
        streamed(f"{name}.mcap", Stream(topic, channels, rate_hz), signal, start_ns=start_ns)
    command = ("merge", "a.mcap", "b.mcap", "-o", "ab.mcap", "--align", "impacts", "--json")
    clock = done(capsys, *command).document["clocks"][1]
    assert (clock["how"], clock["matched"]) == ("impacts", 6)
    assert clock["ahead_s"] == pytest.approx(4.2, abs=0.006)


def test_what_cannot_be_merged_is_one_line(capsys: Capture) -> None:
    imu("a.mcap")
    imu("b.mcap")
    command = ("merge", "a.mcap", "b.mcap", "-o", "ab.mcap", "--align", "none")
    taken = run(capsys, *command).error
    assert taken == (
        "b: /imu/waist: expected a topic that no other file has, found it in a too; try "
        "--rename b:/imu/waist=/imu/waist/b or --prefix b=/b"
    )
    done(capsys, *command, "--rename", "b:/imu/waist=/imu/foot")
    done(capsys, "merge", "a.mcap", "b.mcap", "-o", "c.mcap", "--align", "none", "--prefix", "b=/b")
    with Recording.open("c.mcap") as opened:
        assert [s.topic for s in opened.streams] == ["/imu/waist", "/b/imu/waist"]
    for options, expected in (
        (("--offset", "c=1"), "--offset: expected one of a, b, /imu/waist, found 'c' in 'c=1'"),
        (("--offset", "b=soon"), "--offset: expected a number, found 'soon' in 'b=soon'"),
        (("--offset", "a=1"), "--offset: expected a file but the first"),
        (("--drift", "b=1"), "--drift: expected --offset b.mcap=SECONDS with it"),
        (("--rename", "b:/x=/y"), "--rename: expected a topic of /imu/waist, found '/x'"),
        (("--steps", "b"), "--steps: expected FILE=VALUE, found 'b'"),
    ):
        renamed = () if options[0] == "--rename" else ("--prefix", "b=/b")
        found = run(capsys, *command, "--force", *renamed, *options).error
        assert found.startswith(expected), found
    few = run(capsys, "merge", "a.mcap", "b.mcap", "-o", "d.mcap", "--prefix", "b=/b")
    assert "b.mcap: clock: expected 5 steps or more that agree, found 0 in a.mcap" in few.err
    late = run(capsys, *command, "--force", "--prefix", "b=/b", "--offset", "b=2e9").error
    assert "expected times >= 0 on the common clock" in late
    assert run(capsys, "merge", "a.mcap", "--undo", "-o", "e.mcap").error == (
        "a.mcap: expected a merged file, found another recording"
    )
