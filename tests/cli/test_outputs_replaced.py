"""What groundtrace derived from a recording is replaced by the same command; all else stays."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from command_runs import done, run
from sweeps import swept

import groundtrace as gt
from groundtrace.pipeline.results import previous_results, read_results
from groundtrace_codecs.recording import Recording
from groundtrace_recordings import path_of

Capture = pytest.CaptureFixture[str]
RESULTS, PREVIOUS, TIMELINE = "walk.results.mcap", "walk.previous.results.mcap", "walk.rrd"
REFUSED = "expected a new file, found an existing one; see --force"


@pytest.fixture(scope="module")
def cut(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Cut two short walks, once."""
    from groundtrace.cli.main import main

    folder = tmp_path_factory.mktemp("cut")
    for name, to in (("walk.mcap", "6"), ("other.mcap", "5")):
        main(["cut", str(path_of("waist-walk.mcap")), "--to", to, "-o", str(folder / name)])
    return folder / "walk.mcap", folder / "other.mcap"


@pytest.fixture(autouse=True)
def _two_walks(cut: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for path in cut:
        shutil.copy(path, path.name)


def setting(results: str) -> str:
    """Return the score threshold that results were made with."""
    return next(
        line.split("#")[0].strip()
        for line in read_results(Path(results)).provenance.pipeline.splitlines()
        if line.startswith("score ")
    )


def test_change_replay_look_again_needs_no_force_and_compares_with_what_was_replaced(
    capsys: Capture,
) -> None:
    for score in (0.3, 0.9, 0.8):
        done(capsys, "replay", "walk.mcap", "--set", f"steps.score={score}")
    assert sorted(p.name for p in Path().glob("walk.*")) == sorted(
        ["walk.mcap", RESULTS, PREVIOUS, TIMELINE]
    )
    assert [setting(PREVIOUS), setting(RESULTS)] == ["score = 0.9", "score = 0.8"]
    alone = done(capsys, "compare", RESULTS)
    assert alone.out == done(capsys, "compare", PREVIOUS, RESULTS).out
    assert "steps.score: A 0.9, B 0.8" in alone.out


def test_nothing_was_replaced_by_a_first_replay(capsys: Capture) -> None:
    done(capsys, "replay", "walk.mcap", "--no-viewer")
    said = run(capsys, "compare", RESULTS).error
    assert said.startswith(f"{PREVIOUS}: expected the results that {RESULTS} replaced, found no ")


def test_outputs_of_another_recording_stay(capsys: Capture) -> None:
    done(capsys, "replay", "other.mcap", "--out", RESULTS)
    assert run(capsys, "replay", "walk.mcap").error == f"{RESULTS}: {REFUSED}"
    Path(RESULTS).unlink()
    assert run(capsys, "replay", "walk.mcap").error == f"{TIMELINE}: {REFUSED}"
    # the same name is not enough: results are known by the bytes of their recording
    done(capsys, "replay", "walk.mcap", "--force")
    shutil.copy("other.mcap", "walk.mcap")
    assert run(capsys, "replay", "walk.mcap").error == f"{RESULTS}: {REFUSED}"
    done(capsys, "replay", "walk.mcap", "--force")
    assert not Path(PREVIOUS).exists()  # what was replaced was of another recording


@pytest.mark.parametrize("what", ["recording", "annotated", "geometry", "note"])
def test_sources_stay(what: str, capsys: Capture) -> None:
    kept = Path("kept.mcap")
    done(capsys, "replay", "walk.mcap", "--no-viewer")
    if what == "recording":
        shutil.copy("walk.mcap", kept)
    elif what == "annotated":
        done(capsys, "annotate", "walk.mcap", "--add", "missed@2", "--author", "A")
        done(capsys, "annotate", "walk.mcap", "--commit", "-o", kept)
    else:
        kept.write_text(
            "[[sensor]]\nname = 'groundtrace'\n" if what == "geometry" else "groundtrace"
        )
    before = kept.read_bytes()
    for option in ("--out", "--rrd"):
        said = run(capsys, "replay", "walk.mcap", option, kept, *_elsewhere(option)).error
        assert said == f"{kept}: {REFUSED}"
    assert run(capsys, "score", RESULTS, "--html", kept).error == f"{kept}: {REFUSED}"
    assert run(capsys, "why", RESULTS, "--at", 2, "--rrd", kept).error == f"{kept}: {REFUSED}"
    assert kept.read_bytes() == before


def _elsewhere(option: str) -> tuple[str, ...]:
    return ("--no-viewer",) if option == "--out" else ()


def test_what_would_be_kept_does_not_replace_a_file_of_the_user(capsys: Capture) -> None:
    done(capsys, "replay", "walk.mcap", "--no-viewer")
    Path(PREVIOUS).write_text("mine", "utf-8")
    assert run(capsys, "replay", "walk.mcap", "--no-viewer").error == f"{PREVIOUS}: {REFUSED}"
    assert Path(PREVIOUS).read_text("utf-8") == "mine"


def test_pages_and_timelines_of_results_are_replaced_too(capsys: Capture) -> None:
    done(capsys, "replay", "walk.mcap", "--no-viewer")
    done(capsys, "replay", "other.mcap", "--no-viewer")
    commands: tuple[tuple[object, ...], ...] = (
        ("score", RESULTS, "--html", "page.html"),
        ("why", RESULTS, "--at", 2, "--rrd", "why.rrd"),
        ("compare", RESULTS, RESULTS, "--rrd", "both.rrd"),
    )
    for command in commands:
        done(capsys, *command)
        done(capsys, *command)
        others = ["other.results.mcap" if word == RESULTS else word for word in command]
        assert run(capsys, *others).error == f"{command[-1]}: {REFUSED}"


def test_python_replaces_and_keeps_as_the_command_does() -> None:
    for score in (0.3, 0.9):
        gt.replay("walk.mcap", "waist-steps", set={"steps.score": score}, out=RESULTS)
    assert [setting(PREVIOUS), setting(RESULTS)] == ["score = 0.3", "score = 0.9"]
    with pytest.raises(gt.Error, match="expected a new file"):
        gt.replay("other.mcap", "waist-steps", out=RESULTS)


@pytest.mark.parametrize(
    ("name", "kept"),
    [
        ("a.results.mcap", "a.previous.results.mcap"),
        ("a.mcap", "a.previous.mcap"),
        ("a.b.results.mcap", "a.b.previous.results.mcap"),
        ("a", "a.previous"),
    ],
)
def test_what_is_kept_is_named_as_what_replaced_it(name: str, kept: str) -> None:
    assert previous_results(Path("folder") / name) == Path("folder") / kept


@pytest.mark.parametrize(
    ("out", "option"),
    swept([("shared", ()), ("s.zip", ("--zip",)), ("s.html", ("--single-file",))], ("shared", ())),
)
def test_what_was_shared_of_the_same_recording_is_replaced(
    out: str, option: tuple[str, ...], capsys: Capture
) -> None:
    done(capsys, "replay", "walk.mcap", "--no-viewer")
    done(capsys, "replay", "other.mcap", "--no-viewer")
    for score in (0.3, 0.9):
        done(capsys, "replay", "walk.mcap", "--no-viewer", "--set", f"steps.score={score}")
        done(capsys, "share", RESULTS, "-o", out, *option)
    error = run(capsys, "share", "other.results.mcap", "-o", out, *option).error
    assert error == f"{out}: expected a new place, found an existing one; see --force"


def test_figures_of_a_sweep_are_replaced_and_pipelines_that_people_edit_stay(
    capsys: Capture,
) -> None:
    done(capsys, "replay", "walk.mcap", "--no-viewer")
    done(capsys, "replay", "other.mcap", "--no-viewer")
    sweep = ("sweep", RESULTS, "--grid", "steps.score=0.1:0.4:4", "--figure", "s.svg")
    done(capsys, *sweep, "--write", "best.toml")
    done(capsys, *sweep)
    assert run(capsys, *sweep, "--write", "best.toml").error == f"best.toml: {REFUSED}"
    other = ("sweep", "other.results.mcap", *sweep[2:])
    assert run(capsys, *other).error == f"s.svg: {REFUSED}"


@pytest.mark.sweep
def test_maps_of_a_layout_that_was_edited_are_replaced(capsys: Capture) -> None:
    with Recording.open(path_of("room-walk.mcap")) as room:
        assert room.geometry is not None
        text = room.geometry.to_toml()
    for name in ("room.toml", "room.toml", "hall.toml"):
        Path(name).write_text(text, "utf-8")
        text += "\n"
        analyze = ("analyze", "room", name, "--lattice", 8, "--draws", 2, "--png", "room.png")
        ran = run(capsys, *analyze, "--rrd", "maps.rrd")
        assert ran.code == (0 if name == "room.toml" else 1), ran.err


def test_folders_of_outputs_are_made(capsys: Capture) -> None:
    done(capsys, "replay", "walk.mcap", "--out", "new/deep/walk.results.mcap")
    assert Path("new/deep/walk.rrd").is_file()
    done(capsys, "export", "new/deep/walk.results.mcap", "-o", "tables/all")
    assert Path("tables/all").is_dir()
    done(capsys, "share", "new/deep/walk.results.mcap", "-o", "for/bea")
    assert Path("for/bea/index.html").is_file()


def test_a_bundled_recording_is_meant_by_its_name_where_no_file_has_it(capsys: Capture) -> None:
    assert done(capsys, "info", "waist-walk").out.startswith("waist-walk.mcap: 59.990 s")
    done(capsys, "replay", "waist-walk", "--no-viewer", "--to", 5)
    assert Path("waist-walk.results.mcap").is_file()
    done(capsys, "cut", "waist-walk", "-o", "part.mcap", "--to", 3)
    shutil.copy("walk.mcap", "waist-walk")
    assert not done(capsys, "info", "waist-walk").out.startswith("waist-walk.mcap")
    assert "found no such file" in run(capsys, "info", "a-walk").error
