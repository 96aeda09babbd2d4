"""The page in a real browser: few loads, since drawing without a graphics card takes long."""

from __future__ import annotations

import io
import json
import os
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from conftest import skip_or_fail
from page_sessions import running, serving, showing, write_as_logged, write_walk
from PIL import Image

from groundtrace.annotate.store import Annotations, stored
from groundtrace.pipeline.config import parse_pipeline, with_settings
from groundtrace.pipeline.results import read_results
from groundtrace_codecs.recording import Recording
from groundtrace_viewers.rerun.blueprint import layout_of
from groundtrace_viewers.rerun.moments import moments_of_results
from groundtrace_viewers.web.annotate import replayed
from groundtrace_viewers.web.share import whole_page

if TYPE_CHECKING:
    from collections.abc import Iterator

    from playwright.sync_api import Browser, Page

#: Pictures for people to look at.
ARTEFACTS = Path(__file__).parents[3] / "artefacts"
FLAGS = ("--no-sandbox", "--disable-dev-shm-usage", "--enable-unsafe-swiftshader")
SIZE = {"width": 800, "height": 480}
PATIENCE_MS = 90_000


def chromium() -> str:
    """Return the browser's program: GROUNDTRACE_CHROMIUM, or the system's."""
    found = os.environ.get("GROUNDTRACE_CHROMIUM", "/usr/bin/chromium")
    if not Path(found).is_file():
        skip_or_fail("browser", f"{found} is absent; set GROUNDTRACE_CHROMIUM")
    return found


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    program = chromium()
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        skip_or_fail("browser", "playwright is not installed")
    with sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=program, args=list(FLAGS))
        yield running
        running.close()


@pytest.fixture
def page(browser: Browser) -> Iterator[Page]:
    """Return a page that fails the test where one of its scripts does."""
    context = browser.new_context(viewport=SIZE, accept_downloads=True)
    opened = context.new_page()
    opened.set_default_timeout(PATIENCE_MS)
    opened.add_init_script("console.debug = () => {}")  # the viewer says very much
    failures: list[str] = []
    opened.on("pageerror", lambda error: failures.append(str(error)))
    yield opened
    context.close()
    assert failures == []


def ready(page: Page) -> None:
    page.wait_for_selector("html[data-state]")
    assert page.text_content("#error") == ""
    assert page.get_attribute("html", "data-state") == "ready"


def picture(page: Page, name: str) -> np.ndarray:
    png = page.screenshot(timeout=PATIENCE_MS)
    ARTEFACTS.mkdir(exist_ok=True)
    (ARTEFACTS / f"{name}.png").write_bytes(png)
    with Image.open(io.BytesIO(png)) as image:
        return np.asarray(image.convert("RGB"), np.int16)[:, : SIZE["width"] - 330]


def drawn(page: Page, name: str) -> np.ndarray:
    """Wait until the viewer has drawn many colours, and return its part of the picture."""
    until_s = time.monotonic() + PATIENCE_MS / 1000  # a busy machine may draw only after 10 s
    while time.monotonic() < until_s:
        pixels = picture(page, name)
        if len(np.unique(pixels.reshape(-1, 3), axis=0)) > 1000:
            return pixels
        page.wait_for_timeout(500)
    raise AssertionError(f"the viewer drew nothing; see {ARTEFACTS / name}.png")


def until(page: Page, expression: str) -> None:
    """Wait until an expression is true; the page's policy forbids it to evaluate one again."""
    deadline = time.monotonic() + PATIENCE_MS / 1e3
    while not page.evaluate(expression):
        assert time.monotonic() < deadline, expression
        page.wait_for_timeout(100)


def cursor(page: Page) -> float:
    page.wait_for_timeout(100)
    return float(page.input_value("#time"))


def rows(page: Page, listed: str) -> list[str]:
    return page.locator(f"#{listed} li .kind").all_text_contents()


@pytest.mark.sweep
def test_a_walk_is_annotated_by_keyboard(page: Page, tmp_path: Path) -> None:
    recording = write_walk(tmp_path / "walk.mcap")
    with serving(recording, "--author", "ada") as served:
        page.goto(served.url)
        ready(page)
        until(page, "!document.getElementById('duration').textContent.includes('live')")
        until(page, "Number(document.getElementById('time').value) > 0")
        before = drawn(page, "walk")
        page.fill("#time", "1")  # where the replay left the cursor depends on how fast it was
        page.locator("#time").press("Enter")
        first = cursor(page)
        page.keyboard.press("ArrowDown")
        second = cursor(page)
        assert second > first
        page.keyboard.press("ArrowRight")
        assert cursor(page) == pytest.approx(second + 0.05)
        page.mouse.click(300, 300)  # the viewer's canvas has the focus now, and keys of its own
        page.keyboard.press("m")
        page.wait_for_selector("#marks li[data-kind=missed]")
        page.keyboard.press("n")
        page.keyboard.type("<img src=x onerror=alert(1)> m f s")
        page.keyboard.press("Enter")
        page.wait_for_selector("#marks li[data-kind=note]")
        page.keyboard.press("s")
        page.wait_for_selector("#marks li[data-kind=step]")
        page.keyboard.press("u")
        page.wait_for_selector("#marks li[data-kind=step]", state="detached")
        assert sorted(rows(page, "marks")) == ["missed", "note"]
        after = drawn(page, "walk-annotated")
        assert (np.abs(after - before).max(axis=2) > 40).any()
        here = cursor(page)
        until(page, f"Math.abs(parseFloat(location.hash.slice(3)) - {here}) < 0.01")
        page.reload()
        ready(page)
        assert cursor(page) == pytest.approx(here, abs=1e-5)  # the address leads back
        page.wait_for_timeout(3000)  # data that come in do not move it on
        assert cursor(page) == pytest.approx(here, abs=1e-5)
        page.evaluate("location.hash = '#t=1.5'")
        until(page, "document.getElementById('time').value === '1.500000'")
        page.locator("#viewer").focus()
        page.keyboard.press("Tab")  # the viewer lets the focus go
        assert page.evaluate("document.activeElement.id") == "help-button"
        assert sorted(rows(page, "marks")) == ["missed", "note"]
        assert page.locator("#marks img").count() == 0
    kept = {a.label.kind: a.label for a in stored(recording).content.annotations}
    assert {kind: label.author for kind, label in kept.items()} == {"missed": "ada", "note": "ada"}
    assert kept["note"].note == "<img src=x onerror=alert(1)> m f s"


@pytest.mark.sweep
def test_a_page_of_one_file_keeps_marks_itself_and_gives_them_away(
    page: Page, tmp_path: Path
) -> None:
    recording = write_walk(tmp_path / "walk.mcap")
    rrd, results = replayed(recording, None, "", tmp_path)
    with Recording.open(recording) as opened:
        moments = moments_of_results(results, opened.streams)
    assets = {
        "page.json": b'{"annotations": "browser"}',
        "moments.json": moments.json(),
        "layout.rrd": layout_of(rrd),
        "replay.rrd": rrd.read_bytes(),
    }
    single = tmp_path / "walk.html"
    single.write_text(whole_page(assets), "utf-8")
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.goto(single.as_uri())
    ready(page)
    drawn(page, "one-file")
    page.keyboard.press("Home")
    page.keyboard.press("b")
    page.keyboard.press("PageDown")
    page.keyboard.press("b")
    page.wait_for_selector("#marks li[data-kind=span]")
    marked_s = cursor(page)
    with page.expect_download() as download:
        page.get_by_role("button", name="download").click()
    taken = tmp_path / download.value.suggested_filename
    download.value.save_as(taken)
    assert taken.name == "walk.annotations.json"
    assert json.loads(taken.read_bytes())["recording"]["sha256"] == moments.sha256
    with Annotations.open(recording, "ada") as store:
        (merged,) = store.merge(taken).added
    ends = (merged.label.time_ns, merged.label.end_ns or 0)
    start_s, end_s = ((time_ns - int(moments.start_ns)) / 1e9 for time_ns in ends)
    assert (merged.label.kind, start_s) == ("span", 0.0)
    assert end_s == pytest.approx(marked_s, abs=1e-6)
    assert {url.partition(":")[0] for url in asked} <= {"file", "blob", "data"}


@pytest.mark.sweep
def test_a_page_goes_on_with_a_recording_that_is_written(page: Page, tmp_path: Path) -> None:
    whole = write_as_logged(write_walk(tmp_path / "walk12.mcap"), tmp_path / "whole.mcap")
    growing = tmp_path / "walk.mcap"
    growing.write_bytes(whole[: len(whole) // 2])
    asked = ("replay", "walk.mcap", "--follow", "--web", "--pipeline", "waist-steps")
    with running(tmp_path, *asked, ends_with=130) as (_, url):
        page.goto(url)
        ready(page)
        drawn(page, "live")
        assert (page.text_content("#duration") or "").endswith(" s, live")
        early = rows(page, "events")
        assert page.is_hidden("#marking")
        with growing.open("ab") as rest:
            rest.write(whole[len(whole) // 2 :])
        while "live" in (page.text_content("#duration") or ""):
            page.wait_for_timeout(200)
        assert len(rows(page, "events")) > len(early)
        assert page.text_content("#duration") == "of 12.0 s"


#: What axe-core calls what keeps people out.
GRAVE = {"serious", "critical"}


def faults(page: Page) -> list[str]:
    """Return what axe-core finds that keeps people out, and where."""
    from axe_playwright_python.sync_playwright import Axe

    found = Axe().run(page).response
    assert len(found["passes"]) > 20, "it looked at the page"
    return [
        f"{one['id']}: {[node['target'] for node in one['nodes']]}"
        for one in found["violations"]
        if one["impact"] in GRAVE
    ]


def test_a_wrong_decision_is_told_to_all_and_a_change_of_it_is_a_pipeline(
    page: Page, tmp_path: Path
) -> None:
    recording = write_walk(tmp_path / "walk.mcap")
    wrong = ("--set", "steps.score=0.98", "--out", str(tmp_path / "walk.results.mcap"))
    with showing(recording, "--pipeline", "waist-steps", *wrong) as served:
        page.goto(served.url)
        ready(page)
        assert (page.text_content("#decision-what") or "").startswith("missed, ")
        page.set_viewport_size({"width": 1280, "height": 720})
        assert faults(page) == []
        page.emulate_media(color_scheme="light")
        assert faults(page) == []
        page.set_viewport_size({"width": 400, "height": 800})
        assert faults(page) == []
        assert page.evaluate("document.documentElement.scrollWidth") <= 400
        picture(page, "page-400")

        page.locator("#viewer").focus()
        reached = []
        for _ in range(60):  # out of the viewer, through the panel, and out of the page
            page.keyboard.press("Tab")
            reached.append(page.evaluate("document.activeElement.id"))
        order = ["help-button", "time", "decision-copy", "tuning-which", "tuning-value"]
        order += ["tuning-copy", "tuning-save", "author", "note", "marks", "filter", "events"]
        places = [reached.index(name) for name in order]
        assert places == sorted(places)

        page.keyboard.press("m")
        until(page, "/missed/.test(document.getElementById('said').textContent)")
        page.keyboard.press("Shift+ArrowDown")
        until(page, "/^missed at/.test(document.getElementById('said').textContent)")

        page.select_option("#tuning-which", label="steps.score")
        page.locator("#tuning-value").press("Home")
        setting = (page.text_content("#tuning-setting") or "").removeprefix("--set ")
        counts = page.text_content("#tuning-counts") or ""
        with page.expect_download() as download:
            page.locator("#tuning-save").click()
        taken = tmp_path / download.value.suggested_filename
        download.value.save_as(taken)
    results = read_results(tmp_path / "walk.results.mcap")
    config = parse_pipeline(results.provenance.pipeline.encode(), "results")
    asked = with_settings(config, [setting])
    assert parse_pipeline(taken.read_bytes(), taken.name).stage == asked.stage
    assert "→" in counts, "other values make other steps right"
