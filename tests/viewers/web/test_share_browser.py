"""What was shared, in a real browser: served as a folder, and as one file by a double click."""

from __future__ import annotations

import base64
import socket
import struct
import subprocess
import sys
import time
from contextlib import contextmanager
from functools import partial
from importlib.resources import files
from typing import TYPE_CHECKING

import pytest
from command_runs import done
from share_sessions import STRICT, Walk, shared_walk
from test_page_browser import browser, drawn, page, ready, rows  # noqa: F401

from groundtrace.annotate.store import stored

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from playwright.sync_api import Page, Route

Capture = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Walk:
    return shared_walk(tmp_path_factory.mktemp("walk"))


@contextmanager
def served(folder: Path) -> Iterator[str]:
    """Serve a folder with what Python brings."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    options = ("--bind", "127.0.0.1", "--directory", str(folder))
    process = subprocess.Popen(
        [sys.executable, "-m", "http.server", str(port), *options],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        for _ in range(100):
            try:
                socket.create_connection(("127.0.0.1", port), 1).close()
                break
            except OSError:
                time.sleep(0.1)
        yield f"http://127.0.0.1:{port}/"
    finally:
        process.terminate()
        process.wait(10)


def only(allowed: str, refused: list[str], route: Route) -> None:
    """Let requests through to one place, and no others."""
    if route.request.url.startswith((allowed, "blob:", "data:")):
        route.continue_()
    else:
        refused.append(route.request.url)
        route.abort()


def messages(rrd: bytes) -> list[bytes]:
    """Return the messages of a file of the viewer, each with its kind and length."""
    found, at = [], 12
    while at + 16 <= len(rrd) and (
        end := at + 16 + struct.unpack_from("<Q", rrd, at + 8)[0]
    ) <= len(rrd):
        found.append(rrd[at:end])
        at = end
    return found


def told_of(page: Page, walk: Walk, expression: str) -> list[bytes]:  # noqa: F811
    """Return what the page's script makes of a file of the viewer, ``bytes``."""
    code = files("groundtrace_viewers.web").joinpath("page", "viewer.js").read_text("utf-8")
    rrd = walk.rrd.read_bytes()
    page.goto("about:blank")
    page.add_script_tag(type="module", content=f"{code}\nwindow.made = (bytes) => {expression};")
    page.wait_for_function("window.made !== undefined")
    told = page.evaluate(
        """(text) => {
          const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
          const letters = (piece) => piece.reduce((all, b) => all + String.fromCharCode(b), "");
          return window.made(bytes).map((piece) => btoa(letters(piece)));
        }""",
        base64.b64encode(rrd).decode(),
    )
    return [base64.b64decode(piece) for piece in told]


def test_a_recording_in_pieces_has_all_its_messages(page: Page, walk: Walk) -> None:  # noqa: F811
    rrd = walk.rrd.read_bytes()
    pieces = told_of(page, walk, "pieces(bytes)")
    assert len(pieces) > 2
    assert all(piece[:12] == rrd[:12] for piece in pieces)
    assert [m for piece in pieces for m in messages(piece)] == messages(rrd)
    assert len(rrd) - sum(map(len, messages(rrd))) < 64


def test_a_recording_is_poured_without_its_layout(page: Page, walk: Walk) -> None:  # noqa: F811
    whole = messages(walk.rrd.read_bytes())
    (poured,) = told_of(page, walk, "[without_layout(bytes)]")
    kept = messages(poured)
    left_out = [m for m in whole if m not in kept]
    assert [m for m in whole if m in kept] == kept
    # kinds: 2 holds data, 3 shows a layout; data begin with a store: a recording, 1, a layout, 2
    assert {(m[0], m[19]) for m in left_out} == {(2, 2), (3, 2)}
    assert not {(m[0], m[19]) for m in kept} & {(2, 2), (3, 2)}
    assert sum(m[0] == 2 for m in kept) > 30


@pytest.mark.sweep
def test_the_viewer_in_the_page_lives_with_notes_it_has_no_glyphs_for(
    page: Page,  # noqa: F811
    tmp_path: Path,
    capsys: Capture,
) -> None:
    walk = shared_walk(tmp_path)
    notes = ("東側の足", "שלום קדם", "قدم", "पैर เท้า 왼발", "\U0001f6aa \ue000 \u202e \u20e3")
    for i, note in enumerate(notes):
        done(capsys, "annotate", walk.recording, "--add", f"note@{3 + i / 50:.2f}", "--note", note)
    replay = ("replay", walk.recording, "--out", walk.results, "--rrd", walk.rrd, "--force")
    done(capsys, *replay, "--set", STRICT)
    done(capsys, "share", walk.results, "-o", tmp_path / "out", "--rrd", walk.rrd)
    with served(tmp_path / "out") as url:
        page.goto(url)
        ready(page)
        page.locator("#marks li").first.click()
        drawn(page, "shared-notes")
        assert rows(page, "marks").count("note") == len(notes) + 1
        assert notes[0] in page.locator("#marks").inner_text()
        page.keyboard.press("x")
        page.wait_for_selector("#events li.here[data-kind=missed]")


@pytest.mark.sweep
def test_a_folder_shows_the_replay_over_a_plain_server_without_a_network(
    page: Page,  # noqa: F811
    walk: Walk,
    tmp_path: Path,
    capsys: Capture,
) -> None:
    done(capsys, "share", walk.results, "-o", tmp_path / "out", "--rrd", walk.rrd)
    refused: list[str] = []
    with served(tmp_path / "out") as url:
        page.route("**/*", partial(only, url, refused))
        page.goto(url)
        ready(page)
        drawn(page, "shared-folder")
        listed = rows(page, "events")
        assert listed.count("missed") == walk.missed > 0
        page.keyboard.press("x")
        page.wait_for_selector("#events li.here[data-kind=missed]")
        assert rows(page, "marks") == ["note"]
        page.fill("#author", "bea")
        page.keyboard.press("Escape")
        page.keyboard.press("m")
        page.wait_for_selector("#marks li[data-kind=missed]")
        with page.expect_download() as download:
            page.get_by_role("button", name="download").click()
        download.value.save_as(tmp_path / "marks.json")
        page.get_by_role("link", name="Summary").click()
        page.wait_for_selector("h1:text('walk.mcap')")
        assert page.locator("svg").count() >= 2
    assert refused == []
    merged = done(capsys, "annotate", walk.recording, "--merge", tmp_path / "marks.json").out
    kept = {a.label.kind: a.label for a in stored(walk.recording).content.annotations}
    assert set(kept) == {"note", "missed"}, "the shared one came back as it was"
    assert (kept["note"].note, kept["missed"].author) == ("<b>slow</b>", "bea")
    assert merged == "merged marks.json: 1 added, 1 known, 0 conflicts\n"


def test_one_file_opens_by_a_double_click_with_all_inside(
    page: Page,  # noqa: F811
    walk: Walk,
    tmp_path: Path,
    capsys: Capture,
) -> None:
    options = ("--single-file", "--light", "--rrd", walk.rrd)
    done(capsys, "share", walk.results, "-o", tmp_path / "walk.html", *options)
    refused: list[str] = []
    page.route("**/*", partial(only, (tmp_path / "walk.html").as_uri(), refused))
    said: list[str] = []
    page.on("console", lambda message: said.append(message.text))
    page.goto((tmp_path / "walk.html").as_uri())
    ready(page)
    drawn(page, "shared-file")
    assert rows(page, "events").count("missed") == walk.missed
    page.get_by_role("button", name="Summary").click()
    summary = page.frame_locator("iframe[title=Summary]")
    summary.locator("h1:text('walk.mcap')").wait_for()
    assert summary.locator("body").evaluate("b => getComputedStyle(b).marginTop") == "0px"
    with page.expect_download() as download:
        page.get_by_role("button", name="Close").first.click()
        page.get_by_role("link", name="pipeline.toml").click()
    download.value.save_as(tmp_path / "pipeline.toml")
    assert 'name = "waist-steps"' in (tmp_path / "pipeline.toml").read_text()
    assert refused == []
    refusals = [line for line in said if "Content Security Policy" in line]
    assert all("rerun.io" in line for line in refusals), refusals  # the viewer reports to nobody
