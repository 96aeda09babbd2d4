"""``groundtrace recordings get``: by hash, from a server of this computer."""

from __future__ import annotations

import hashlib
import resource
import subprocess
import sys
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from command_runs import done, run

import groundtrace as gt
import groundtrace_recordings
from groundtrace_recordings.catalogue import OFFLINE, catalogue

TABLE = b"time,x,y,z\n" + b"".join(b"%.2f,0.1,0.2,9.8\n" % (i / 100) for i in range(500))
MAP = """format = "csv"
time = {column = "time", unit = "s"}
[[stream]]
topic = "/acc"
columns = [
  {column = "x", quantity = "acceleration", axis = "x", unit = "m/s2"},
  {column = "y", quantity = "acceleration", axis = "y", unit = "m/s2"},
  {column = "z", quantity = "acceleration", axis = "z", unit = "m/s2"},
]
"""


class Files(BaseHTTPRequestHandler):
    """Gives one table: whole, cut off, or not at all."""

    def do_GET(self) -> None:
        self.server.asked.append(self.path)  # type: ignore[attr-defined]
        missing = self.path.startswith("/missing")
        self.send_response(404 if missing else 200)
        self.send_header("Content-Length", str(len(TABLE)))
        self.end_headers()
        if not missing:
            self.wfile.write(TABLE[: 100 if self.path.startswith("/cut") else None])

    def log_message(self, *_: object) -> None:
        """Print nothing."""


@pytest.fixture
def asked(tmp_path, monkeypatch):
    """A catalogue of recordings on a server of this computer; what it was asked for."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), Files)
    server.asked = []  # type: ignore[attr-defined]
    threading.Thread(target=server.serve_forever, daemon=True).start()
    good, bad = hashlib.sha256(TABLE).hexdigest(), "0" * 64
    place = tmp_path / "shipped"
    (place / "maps").mkdir(parents=True)
    (place / "maps" / "table.toml").write_text(MAP)
    text = ""
    for name, path, sha256 in (
        ("there", "walk.csv", good),
        ("wrong", "walk.csv", bad),
        ("missing", "missing/walk.csv", good),
        ("cut", "cut/walk.csv", good),
    ):
        url = f"http://127.0.0.1:{server.server_port}/{path}"
        text += (
            f'[{name}]\ntitle = "a table"\nlicence = "MIT"\nauthors = "nobody"\ncitation = ""\n'
            f'tuned_on = false\nmap = "table"\n'
            f'files = [{{url = "{url}", sha256 = "{sha256}", bytes = {len(TABLE)}}}]\n'
        )
    (place / "catalogue.toml").write_text(text)
    monkeypatch.setattr(groundtrace_recordings, "folder", lambda: place)
    monkeypatch.setattr(groundtrace_recordings.catalogue, "folder", lambda: place)
    monkeypatch.setenv("GROUNDTRACE_RECORDINGS", str(tmp_path / "kept"))
    yield server.asked  # type: ignore[attr-defined]
    server.shutdown()
    server.server_close()


def test_a_recording_is_fetched_once_and_then_known_by_its_name(asked, capsys, tmp_path):
    assert run(capsys, "info", "there").error.endswith("groundtrace recordings get there")
    assert asked == []
    ran = done(capsys, "recordings", "get", "there")
    assert ran.err == "fetching there from 127.0.0.1: 0.0 MB\n"
    assert Path(ran.out.strip()) == tmp_path / "kept" / "there.mcap"
    done(capsys, "recordings", "get", "there", "--offline")
    assert asked == ["/walk.csv"]
    assert done(capsys, "info", "there", "--json").document["streams"][0]["samples"] == 500


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("wrong", "/walk.csv: expected SHA-256 0000"),
        ("missing", "/missing/walk.csv: expected 8511 bytes, found HTTP status 404"),
        ("cut", "/cut/walk.csv: expected 8511 bytes, found "),
    ],
)
def test_what_is_not_as_the_catalogue_says_is_one_line_and_leaves_nothing(
    asked, capsys, tmp_path, name, said
):
    ran = run(capsys, "recordings", "get", name)
    assert ran.code == 1
    assert ran.err.count("\n") == 2
    error = ran.err.splitlines()[1]
    assert said in error
    assert [p.name for p in tmp_path.glob("kept/**/*") if p.is_file()] == [".lock"]
    if name == "wrong":
        assert hashlib.sha256(TABLE).hexdigest() in error


def test_a_full_disk_is_one_line_and_leaves_nothing(asked, capsys, tmp_path):
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(TABLE) // 2, before[1]))
    try:
        ran = run(capsys, "recordings", "get", "there")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert ran.code == 1
    assert "expected room to write" in ran.err.splitlines()[-1]
    assert [p.name for p in tmp_path.glob("kept/**/*") if p.is_file()] == [".lock"]
    done(capsys, "recordings", "get", "there")
    assert asked == ["/walk.csv"] * 2


def test_the_licence_of_what_others_published_is_printed_in_full(capsys):
    for name in ("lower-back", "mobgap-ha001"):
        said = done(capsys, "recordings", "show", name, "--licence").out
        assert "Version 2.0, January 2004" in said
        assert "END OF TERMS AND CONDITIONS" in said
    assert "--licence" in done(capsys, "recordings", "show", "shots").out
    assert run(capsys, "recordings", "list", "--licence").code == 2


def test_nothing_is_fetched_offline(asked, capsys, monkeypatch):
    assert "found --offline" in run(capsys, "recordings", "get", "there", "--offline").error
    monkeypatch.setenv(OFFLINE, "1")
    assert "found GROUNDTRACE_OFFLINE=1" in run(capsys, "recordings", "get", "there").error
    assert asked == []


def test_what_looks_for_recordings_fetches_none(asked, capsys):
    done(capsys, "recordings", "get", "there")
    done(capsys, "replay", "there", "--no-viewer", "--out", "r.results.mcap")
    results = gt.load("r.results.mcap")
    assert results.places[-1] == gt.recordings.here["there"]
    assert "to fetch" in gt.recordings._repr_html_()
    done(capsys, "export", "there", "-o", "there.csv", "--kind", "signals")
    assert asked == ["/walk.csv"]


def test_two_at_once_fetch_once(asked, tmp_path):
    code = (
        "import groundtrace_recordings as r, groundtrace_recordings.catalogue as c, pathlib;"
        f"r.folder = c.folder = lambda: pathlib.Path({str(tmp_path / 'shipped')!r});"
        "print(c.fetch(c.catalogue()['there']))"
    )
    both = [
        subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) for _ in range(2)
    ]
    paths = {each.communicate()[0].decode().strip() for each in both}
    assert [each.returncode for each in both] == [0, 0]
    assert paths == {str(tmp_path / "kept" / "there.mcap")}
    assert asked == ["/walk.csv"]


def test_the_catalogue_names_commits_and_maps_that_there_are():
    for name, each in catalogue().items():
        assert not (set(name) & set("/. "))
        assert name not in {Path(n).stem for n in groundtrace_recordings.bundled()}
        assert each.map == "" or f"{each.map}.toml" in groundtrace_recordings.maps()
        assert each.excerpt == "" or f"{each.excerpt}.mcap" in groundtrace_recordings.bundled()
        assert each.truth_file in {"", *(file.name for file in each.files)}
        for file in each.files:
            assert len(file.sha256) == 64
            assert len(file.url.split("/")[5]) == 40, "a commit, not a branch"


def test_the_catalogue_is_that_of_the_sources_at_hand(data):
    here = {hashlib.sha256(p.read_bytes()).hexdigest(): p for p in data.rglob("*") if p.is_file()}
    for each in catalogue().values():
        for file in each.files:
            if file.sha256 in here:
                assert here[file.sha256].stat().st_size == file.bytes
    assert sum(f.sha256 in here for e in catalogue().values() for f in e.files) >= 16
