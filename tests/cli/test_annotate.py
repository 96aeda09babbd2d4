"""``groundtrace annotate`` and what the other commands make of annotations."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest
from annotated_recordings import mark, recording_in
from command_runs import check_schema, done, run

from groundtrace.pipeline.results import read_results
from groundtrace_codecs.events import StepEvent
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.writer import write_recording
from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from pathlib import Path

Capture = pytest.CaptureFixture[str]


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def rec(tmp_path: Path) -> Path:
    return recording_in(tmp_path)


@pytest.fixture
def bare(tmp_path: Path) -> Path:
    """The bundled walk without its truth."""
    with Recording.open(path_of("waist-walk.mcap")) as walk:
        blocks = [stamped.block for stamped in walk.blocks()]
        sources = [(s, "f64le", [b for b in blocks if b.topic == s.topic]) for s in walk.streams]
        write_recording(tmp_path / "walk.mcap", sources)
    return tmp_path / "walk.mcap"


def test_marks_are_added_listed_edited_deleted_and_undone(rec: Path, capsys: Capture) -> None:
    assert done(capsys, "annotate", rec).out == "rec.mcap: no annotations\n"
    words = ("--label", "left", "--note", "soft\nleft foot")
    out = done(capsys, "annotate", rec, "--add", "missed@12.34", "--add", "false@3", *words).out
    assert out.splitlines()[0].endswith(": missed left at 12.340 s by annotator")
    first, second = (line.split()[1].strip(":") for line in out.splitlines())
    listed = done(capsys, "annotate", rec, "--list").out.splitlines()
    header = "id time [s] end [s] kind label channel author note"
    assert " ".join(listed[0].split()) == header
    assert listed[2].split() == f"{first} 12.340 missed left annotator soft left foot".split()
    edited = done(capsys, "annotate", rec, "--edit", second, "ignore@3-4.5", "--label", "").out
    assert edited == f"edited {second}: ignore at 3.000 to 4.500 s by annotator\n"
    assert done(capsys, "annotate", rec, "--delete", first).out.startswith(f"deleted {first}: ")
    assert done(capsys, "annotate", rec, "--undo").out == f"undone: delete {first}\n"
    assert "undone: nothing" in done(capsys, "annotate", rec, "--undo", "--author", "bea").out
    assert len(done(capsys, "annotate", rec).out.splitlines()) == 3


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (("--add", "missed"), "--add: expected KIND@SECONDS or KIND@FROM-TO, found 'missed'"),
        (("--add", "step@1.2.3"), "--add: expected KIND@SECONDS or KIND@FROM-TO, found"),
        (("--add", "stp@1"), "rec.mcap: annotation: kind: expected one of disturbed, false"),
        (("--add", "step@" + "9" * 400), "annotation: time: expected 0 to 19.990 s"),
        (("--add", "walking@5-4"), "end: expected one after the start"),
        (("--add", "pick@5"), "channel: expected one of az, found none"),
        (("--add", "step@5", "--author", " "), "author: expected a name, found nothing"),
        (("--delete", "none"), "rec.annotations.mcap: expected an annotation 'none', found none"),
        (("--note", "x"), "--note: expected --add or --edit with it, found neither"),
        (("--commit",), "--commit: expected it together with --out FILE, found --commit alone"),
        (("-o", "x.mcap"), "found --out alone"),
        (("--commit", "-o", "rec.mcap"), "expected a new file, found the one that is read"),
        (("--merge", "none.json"), "none.json: expected annotations, found: No such file"),
    ],
)
def test_what_cannot_be_done_is_said_in_one_line(
    rec: Path, capsys: Capture, arguments: tuple[str, ...], error: str
) -> None:
    assert error in run(capsys, "annotate", rec, *arguments).error
    assert not rec.with_name("rec.annotations.mcap").exists()


def test_serving_without_a_page_is_refused(
    rec: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("groundtrace.pipeline.plugins.plugins", lambda _: ())
    assert "--serve: expected an installed page" in run(capsys, "annotate", rec, "--serve").error


def test_serving_gives_the_page_the_recording_and_its_results(
    rec: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[tuple[object, ...]] = []
    monkeypatch.setattr("groundtrace.cli.annotate._server", lambda: lambda *a: calls.append(a))
    done(capsys, "annotate", rec, "--serve", "--author", "bea", "--no-browser", "--port", 99)
    results = rec.with_name("rec.results.mcap")
    results.touch()
    done(capsys, "annotate", rec, "--serve")
    done(capsys, "annotate", rec, "--serve", "--pipeline", "waist-peaks")
    assert calls == [
        (rec, None, "", "bea", 99, False),
        (rec, results, "", "annotator", 0, True),
        (rec, None, "waist-peaks", "annotator", 0, True),
    ]
    both = ("--serve", "--pipeline", "heading", "--results", results)
    found = run(capsys, "annotate", rec, *both).error
    assert "--pipeline: expected it or --results, found both" in found


def test_the_json_is_as_its_schema_says_and_can_be_merged(
    rec: Path, tmp_path: Path, capsys: Capture
) -> None:
    done(capsys, "annotate", rec, "--add", "step@5", "--label", "left", "--author", "ann")
    add = ("--add", "walking@1-9", "--add", "step@5.01", "--label", "right", "--author", "bea")
    added = done(capsys, "annotate", rec, *add, "--conflicts", "--json").document
    check_schema("annotate", added)
    assert [c["reason"] for c in added["conflicts"]] == ["foot"]
    other = recording_in(tmp_path / "other")
    (tmp_path / "all.json").write_text(json.dumps(added), "utf-8")
    merged = done(capsys, "annotate", other, "--merge", "all.json", "--json").document
    check_schema("annotate", merged)
    assert merged["annotations"] == added["annotations"]
    assert merged["merged"][0]["added"] == 3
    again = done(capsys, "annotate", other, "--merge", rec.with_name("rec.annotations.mcap")).out
    assert again == "merged rec.annotations.mcap: 0 added, 3 known, 0 conflicts\n"
    lines = done(capsys, "annotate", rec, "--conflicts").out.splitlines()
    assert lines[0] == "1 conflicts"
    assert lines[1].startswith("  foot: step left at 5.000 s by ann (")


def test_a_recording_without_truth_is_labelled_and_scored(bare: Path, capsys: Capture) -> None:
    done(capsys, "replay", bare, "--no-viewer")
    assert "found none" in run(capsys, "score", "walk.results.mcap").error
    found = read_results(bare.with_name("walk.results.mcap"))
    steps_ns = [e.time_ns for e in found.events if isinstance(e, StepEvent)]
    late = [s for t in steps_ns if (s := (t - found.provenance.start_ns) / 1e9) > 50]
    missed = (late[0] + late[1]) / 2
    marks = [f"--add=step@{t:.6f}" for t in late[1:]]
    marks += [f"--add=missed@{missed:.6f}", f"--add=walking@{late[0]:.6f}-59.99"]
    done(capsys, "annotate", bare, *marks, "--author", "ann")
    done(capsys, "annotate", bare, "--add", f"step@{late[1] + 0.02:.6f}", "--author", "bea")
    ran = done(capsys, "score", "walk.results.mcap", "--json")
    assert "1 more that another author gives within 50 ms count once" in ran.err
    figures = ran.document["steps"]
    assert (figures["truth"], figures["matched"]) == (len(late), len(late) - 1)
    only = done(capsys, "score", "walk.results.mcap", "--json", "--author", "bea").document
    assert only["steps"]["truth"] == 1
    assert "1 missed, 1 false" in done(capsys, "why", "walk.results.mcap").out
    error = run(capsys, "score", "walk.results.mcap", "--author", "x").error
    assert error == "walk.annotations.mcap: author: expected annotations by 'x', found none"


@pytest.mark.sweep
def test_a_copy_carries_its_annotations_to_replay_and_score(bare: Path, capsys: Capture) -> None:
    done(capsys, "annotate", bare, "--add", "missed@1.0", "--add", "note@2")
    out = done(capsys, "annotate", bare, "--commit", "-o", "copy.mcap").out
    assert out == "wrote copy.mcap: walk.mcap and, inside, its 2 annotations\n"
    counts = {"missed": 1, "note": 1}
    assert "see --force" in run(capsys, "annotate", bare, "--commit", "-o", "copy.mcap").error
    for name in ("walk.mcap", "copy.mcap"):
        assert done(capsys, "info", name, "--json").document["annotations"] == counts
        done(capsys, "replay", name, "--no-viewer")
    inside = read_results(bare.with_name("copy.results.mcap"))
    assert inside.annotations == read_results(bare.with_name("walk.results.mcap")).annotations
    assert [a.label.kind for a in inside.annotations] == ["missed", "note"]
    ran = done(capsys, "score", "copy.results.mcap", "--json")
    assert ran.document["steps"]["truth"] == 1
    assert "every step in it is marked as missed" in ran.err


def test_truth_of_the_recording_stays_unless_the_sidecar_is_named(
    tmp_path: Path, capsys: Capture
) -> None:
    rec = recording_in(tmp_path, labels=(mark(3.0), mark(4.0)))
    done(capsys, "annotate", rec, "--add", "step@5")
    done(capsys, "replay", rec, "--no-viewer", "--pipeline", "waist-peaks")
    own = done(capsys, "score", "rec.results.mcap", "--json").document["steps"]["truth"]
    named = ("--truth", "rec.annotations.mcap", "--json")
    said = done(capsys, "score", "rec.results.mcap", *named).document["steps"]["truth"]
    assert (own, said) == (2, 1)
    assert "--author: expected annotations as truth, found truth of its own" in (
        run(capsys, "score", "rec.results.mcap", "--author", "ann").error
    )


def test_a_sidecar_of_another_recording_is_said_by_replay_and_refused_by_score(
    tmp_path: Path, capsys: Capture
) -> None:
    rec = recording_in(tmp_path)
    done(capsys, "annotate", rec, "--add", "step@5")
    rec.unlink()
    recording_in(tmp_path, level=1.0)
    ran = done(capsys, "replay", rec, "--no-viewer", "--pipeline", "waist-peaks")
    assert "annotations are left out: rec.annotations.mcap: recording: expected rec.mcap" in ran.err
    assert "found annotations of rec.mcap" in run(capsys, "score", "rec.results.mcap").error
