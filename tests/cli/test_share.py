"""``groundtrace share``: what is in the folder, what is not, and what is refused."""

from __future__ import annotations

import getpass
import json
import shutil
import socket
import tempfile
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from command_runs import done, run
from share_sessions import Walk, quietly, shared_walk, small_viewer

from groundtrace.annotate.agreement import from_json
from groundtrace_viewers.web import share
from groundtrace_viewers.web import share as sharing
from groundtrace_viewers.web.summary import sources_of

if TYPE_CHECKING:
    from collections.abc import Iterator

Capture = pytest.CaptureFixture[str]
CONTENT = {
    *("README.txt", "index.html", "summary.html", "report.html", "pipeline.toml"),
    *("walk.annotations.json", "walk.annotations.mcap", "page/style.css"),
    *("re_viewer.js", "re_viewer_bg.wasm", "favicon.ico"),
    *("replay.rrd", "layout.rrd", "moments.json", "page.json", "opening.png"),
}


@pytest.fixture(scope="module")
def replayed(tmp_path_factory: pytest.TempPathFactory) -> Walk:
    return shared_walk(tmp_path_factory.mktemp("secret-place"))


@pytest.fixture
def walk(replayed: Walk, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Walk:
    """The walk in a folder of its own, and a viewer of small files."""
    viewer = small_viewer(tmp_path / "viewer")
    monkeypatch.setattr(sharing, "viewer_folder", lambda: viewer)
    monkeypatch.setattr(share, "viewer_folder", lambda: viewer)
    monkeypatch.chdir(tmp_path)
    place = tmp_path / "secret-place"
    shutil.copytree(replayed.recording.parent, place)
    here = (place / path.name for path in replayed[:3])
    return Walk(*here, replayed.missed)


def files(folder: Path) -> dict[str, bytes]:
    found = (path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in found}


def unpacked(rrd: Path) -> Iterator[bytes]:
    """Yield what a viewer's file says, whose own bytes are packed."""
    import rerun as rr

    reader = rr.chunk.RrdReader(str(rrd))
    stores = [*reader.recordings(), *reader.blueprints()]
    for store in stores:
        for chunk in reader.stream(store=store):
            yield chunk.to_record_batch().serialize().to_pybytes()
            yield repr(chunk.to_record_batch().schema).encode()


def test_a_folder_has_everything_and_says_how_to_open_it(walk: Walk, capsys: Capture) -> None:
    said = done(capsys, "share", walk.results, "-o", "out").out
    found = files(Path("out"))
    assert set(found) == CONTENT
    size = sum(map(len, found.values()))
    assert f"shared: out, {len(found)} files, {size / 1e6:.1f} MB" in said
    assert "python -I -m http.server 8000 --bind 127.0.0.1 --directory out" in said
    assert b'name = "waist-steps"' in found["pipeline.toml"]
    assert (
        found["walk.annotations.mcap"]
        == walk.recording.with_suffix(".annotations.mcap").read_bytes()
    )
    moments = json.loads(found["moments.json"])
    assert [m["kind"] for m in moments["misses"]].count("missed") == walk.missed > 0
    key, (mark,) = from_json(found["walk.annotations.json"], int(moments["start_ns"]))
    assert (key.sha256, mark.label.note) == (moments["sha256"], "<b>slow</b>")
    config = json.loads(found["page.json"])
    assert [m["id"] for m in config["marks"]] == [mark.id]
    summary = found["summary.html"].decode()
    for text in ("Wrong decisions: 1", "&lt;b&gt;slow", "by chance", "SHA-256", "100 Hz", "<svg"):
        assert text in summary
    assert not [path for path in Path().iterdir() if path.name.startswith(".")]


def test_nothing_shared_says_who_shared_it_or_where(
    walk: Walk, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("USER", "LOGNAME", "LNAME", "USERNAME"):
        monkeypatch.setenv(name, "zoe.private")
    monkeypatch.setenv("COMPUTERNAME", "host-of-zoe")
    monkeypatch.setattr(socket, "gethostname", lambda: "host-of-zoe")
    monkeypatch.setenv("HOME", str(Path("home-of-zoe").resolve()))
    assert getpass.getuser() == "zoe.private"
    # each has a character that the base64 of the one page has not: none is there by chance
    secrets = ("zoe.private", "-of-zoe", "secret-place", str(walk.results.parent.parent))
    secrets += (f"{tempfile.gettempdir()}/groundtrace-",)
    aside = Path("rec")
    aside.mkdir()
    for path in walk.recording.parent.glob("walk*"):
        if path != walk.results:
            path.rename(aside / path.name)
    given = ("--recording", aside.resolve() / "walk.mcap")
    done(capsys, "share", walk.results.resolve(), "-o", "out", *given)
    done(capsys, "share", walk.results.resolve(), "-o", "out.html", "--single-file", *given)
    found = files(Path("out")) | {"out.html": Path("out.html").read_bytes()}
    for name, content in found.items():
        parts = [content]
        if name.endswith(".rrd"):
            parts += unpacked(Path("out", name))
        for secret in secrets:
            assert not [part for part in parts if secret.encode() in part], (name, secret)


def test_an_archive_holds_the_folder(walk: Walk, capsys: Capture) -> None:
    said = done(capsys, "share", walk.results, "-o", "for-bea.zip", "--zip").out
    assert said.startswith("shared: for-bea.zip, ")
    with zipfile.ZipFile("for-bea.zip") as archive:
        assert {info.filename for info in archive.infolist()} == {f"for-bea/{n}" for n in CONTENT}
        assert archive.testzip() is None
        assert {info.date_time[0] for info in archive.infolist()} == {1980}
    assert {path.name for path in Path().iterdir()} == {"for-bea.zip", "viewer", "secret-place"}


def test_one_page_holds_summary_score_marks_and_pipeline(walk: Walk, capsys: Capture) -> None:
    said = done(capsys, "share", walk.results, "-o", "walk.html", "--single-file").out
    assert "open it by a double click" in said
    html = Path("walk.html").read_text("utf-8")
    for name in ("page.json", "moments.json", "layout.rrd", "replay.rrd", "re_viewer_bg.wasm"):
        assert f'data-asset="{name}"' in html
    for title in ("Summary", "Score"):
        assert f'<iframe title="{title}" srcdoc="' in html
    assert 'download="pipeline.toml"' in html
    assert 'download="walk.annotations.json"' in html
    assert 'href="index.html"' not in html
    assert '<img id="opening" src="data:image/png;base64,' in html


@pytest.mark.sweep
def test_a_light_share_is_smaller_replayed_or_filtered(walk: Walk, capsys: Capture) -> None:
    from groundtrace_recordings import path_of

    room = ("room.results.mcap", "room.rrd")
    part = ("--from", "2", "--to", "4", "--out", room[0], "--rrd", room[1])
    done(capsys, "replay", path_of("room-walk.mcap"), *part)
    sizes = {}
    for name, options in {
        "full": ("--rrd", room[1]),
        "light": ("--light",),
        "filtered": ("--rrd", room[1], "--light"),
    }.items():
        done(capsys, "share", room[0], "-o", name, *options)
        sizes[name] = (Path(name) / "replay.rrd").stat().st_size
    assert sizes["light"] < sizes["filtered"] < sizes["full"] / 2
    assert "2.00 to 4.00 s of it" in Path("light/summary.html").read_text("utf-8")
    assert "without their samples" in Path("light/summary.html").read_text("utf-8")


def test_without_its_recording_the_timeline_that_is_there_is_shared(
    walk: Walk, capsys: Capture
) -> None:
    walk.recording.unlink()
    ran = done(capsys, "share", walk.results, "-o", "out")
    assert "walk.mcap is not there: its timeline walk.rrd is taken as it is" in ran.err
    assert not Path("out/opening.png").exists(), "there is no signal to draw"
    assert "opening.png" not in Path("out/index.html").read_text("utf-8")
    assert Path("out/replay.rrd").read_bytes() == walk.rrd.read_bytes()
    assert "&lt;b&gt;slow" in Path("out/summary.html").read_text("utf-8")
    walk.rrd.unlink()
    error = run(capsys, "share", walk.results, "-o", "other").error
    assert error.startswith("walk.results.mcap: expected its recording walk.mcap beside it, --reco")
    assert not Path("other").exists()
    assert {path.name for path in Path().iterdir()} == {"out", "viewer", "secret-place"}


def test_what_belongs_to_another_recording_is_refused(walk: Walk, capsys: Capture) -> None:
    other = Path("other.mcap")
    other.write_bytes(b"other bytes")
    error = run(capsys, "share", walk.results, "-o", "out", "--recording", other).error
    assert (
        error == "other.mcap: expected the recording that walk.results.mcap is of, found other "
        "bytes"
    )
    error = run(capsys, "share", walk.results, "-o", "out", "--rrd", other).error
    assert error.startswith("other.mcap: expected a viewer's file, found: ")
    walk.recording.write_bytes(b"other bytes")
    ran = done(capsys, "share", walk.results, "-o", "out")
    assert "walk.mcap: not the recording that walk.results.mcap is of" in ran.err


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (("-o", "there"), "there: expected a new place, found an existing one; see --force"),
        (
            ("-o", "there", "--force"),
            "there: expected a folder that groundtrace share wrote, found",
        ),
        (("-o", "secret-place", "--force"), "secret-place: expected a new place, found the one"),
        (("-o", "out", "--zip"), "out: expected a name that ends in .zip, found out"),
        (("-o", "out", "--single-file"), "out: expected a name that ends in .html, found out"),
        (("-o", "o.zip", "--zip", "--single-file"), "--zip: expected it without --single-file"),
        (("-o", "there.zip", "--zip", "--force"), "there.zip: expected a file, found a folder"),
        (("-o", "file", "--force"), "file: expected a folder, found a file"),
        (("-o", "out", "--rrd", "none.rrd"), "none.rrd: expected a viewer's file, found no such"),
    ],
)
def test_what_cannot_be_written_is_refused_before_anything_is(
    walk: Walk, capsys: Capture, arguments: tuple[str, ...], error: str
) -> None:
    for name in ("there", "there.zip"):
        Path(name).mkdir()
        Path(name, "precious").write_text("stays")
    Path("file").write_text("stays")
    before = files(Path())
    assert run(capsys, "share", walk.results, *arguments).error.startswith(error)
    assert files(Path()) == before


@pytest.mark.sweep
def test_what_was_shared_before_is_replaced_whole(
    walk: Walk, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    options = ("-o", "out", "--rrd", walk.rrd, "--force")
    quietly("share", walk.results, *options)
    Path("out/left.txt").write_text("of before")

    def broken(*_: object) -> str:
        raise OSError(28, "No space left on device", "out")

    with monkeypatch.context() as broke:
        broke.setattr(sharing, "folder_page", broken)
        assert "No space left" in run(capsys, "share", walk.results, *options).error
    assert set(files(Path("out"))) == {*CONTENT, "left.txt"}
    done(capsys, "share", walk.results, *options)
    assert set(files(Path("out"))) == CONTENT
    assert {path.name for path in Path().iterdir()} == {"out", "viewer", "secret-place"}


def test_a_recording_without_truth_is_shared_without_a_score(walk: Walk, capsys: Capture) -> None:
    from groundtrace_codecs.recording import Recording
    from groundtrace_codecs.writer import write_recording

    with Recording.open(walk.recording) as opened:
        blocks = [stamped.block for stamped in opened.blocks()]
        sources = [(s, "f64le", [b for b in blocks if b.topic == s.topic]) for s in opened.streams]
        write_recording(Path("bare.mcap"), sources)
    done(capsys, "replay", "bare.mcap")
    done(capsys, "share", "bare.results.mcap", "-o", "out")
    assert sources_of(Path("bare.results.mcap"), None).matching is None
    summary = Path("out/summary.html").read_text("utf-8")
    assert "nothing is scored" in summary
    assert "From step to step" in summary
    assert not Path("out/report.html").exists()
    assert "report.html" not in summary
