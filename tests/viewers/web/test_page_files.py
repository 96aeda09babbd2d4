from __future__ import annotations

import json
import re
import tempfile
from pathlib import Path

import numpy as np
import pytest
from viewer_sessions import write_walker

from groundtrace_viewers.errors import ViewerError
from groundtrace_viewers.rerun import process
from groundtrace_viewers.rerun.blueprint import layout_of
from groundtrace_viewers.rerun.moments import STEPPED
from groundtrace_viewers.rerun.process import VIEWER_FILES, viewer_folder
from groundtrace_viewers.web.server import (
    FOLDER,
    MODULES,
    POLICY,
    joined_script,
    page_file,
    replay_page,
)

DOCUMENTATION = Path(__file__).parents[3] / "docs" / "keys.md"


def names(pattern: str, text: str) -> list[str]:
    return re.findall(pattern, text, re.MULTILINE)


def test_every_file_of_the_page_is_known() -> None:
    assert {p.name for p in FOLDER.iterdir()} == {*MODULES, "style.css", "shared.css"}


def test_a_module_stands_after_what_it_imports() -> None:
    for index, module in enumerate(MODULES):
        imported = names(r'from "\./(\w+\.js)"', page_file(module).decode())
        assert set(imported) <= set(MODULES[:index])


def test_modules_join_into_one_script_without_names_twice() -> None:
    script = joined_script()
    assert not names(r"^(import|export) ", script)
    defined = names(r"^(?:async )?(?:function|class|const|let) (\w+)", script)
    assert len(defined) == len(set(defined))


def test_keys_step_through_what_a_page_may_open_at() -> None:
    (kinds,) = names(r"^export const STEPS = new Set\((.*)\);", page_file("jumps.js").decode())
    assert set(json.loads(kinds)) == STEPPED


def test_the_page_refers_to_nothing_but_its_own_files_and_puts_text_in_as_text() -> None:
    texts = [page_file(name).decode() for name in (*MODULES, "style.css", "shared.css")]
    for text in (*texts, replay_page()):
        assert not names(r"https?://", text)
        assert not names(r"innerHTML|insertAdjacentHTML|document\.write|\beval\(", text)
    assert not names(r"<script>|style=\"|onclick=", replay_page())


#: Of words, and what they stand on. Of what cannot be pressed the contrast is no matter.
WORDS = ("text", "faint", "accent", "step", "missed", "false", "pick", "fix", "mark", "strong")
GROUNDS = ("ground", "panel", "raised", "here")


def luminance(colour: str) -> float:
    """Return the relative luminance of ``#rrggbb`` (WCAG 2.1)."""
    parts = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return float(linear @ (0.2126, 0.7152, 0.0722))


@pytest.mark.parametrize("theme", [0, 1], ids=["dark", "light"])
def test_all_words_of_the_panel_can_be_read_on_all_its_grounds(theme: int) -> None:
    blocks = names(r":root \{([^}]*)\}", page_file("style.css").decode())
    colours = dict(re.findall(r"--(\w+): (#[0-9a-f]{6});", blocks[theme]))
    for word in WORDS:
        for ground in GROUNDS:
            low, high = sorted((luminance(colours[word]), luminance(colours[ground])))
            assert (high + 0.05) / (low + 0.05) >= 4.5, f"{word} on {ground}"


def test_a_page_without_a_server_brings_its_policy() -> None:
    (policy,) = names(
        r'http-equiv="Content-Security-Policy" content="([^"]+)"', replay_page(policy=POLICY)
    )
    assert policy == POLICY


def test_the_viewers_files_are_taken_once(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    made: list[int] = []

    def files() -> dict[str, bytes]:
        made.append(1)
        return dict.fromkeys(VIEWER_FILES, b"content")

    monkeypatch.setattr(process, "cache_folder", lambda: tmp_path / "a" / "b")
    monkeypatch.setattr(process, "_files", files)
    assert viewer_folder() == viewer_folder() == tmp_path / "a" / "b"
    assert made == [1]
    assert {p.name for p in (tmp_path / "a" / "b").iterdir()} == set(VIEWER_FILES)


def test_a_home_that_cannot_be_written_to_is_no_obstacle(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "home").write_text("a file, not a folder")
    monkeypatch.setattr(process, "cache_folder", lambda: tmp_path / "home" / "cache")
    monkeypatch.setattr(process, "_files", lambda: dict.fromkeys(VIEWER_FILES, b"x"))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    folder = viewer_folder()
    assert folder.parent == tmp_path
    assert (folder / "re_viewer.js").read_bytes() == b"x"


def test_the_layout_of_a_replay_is_told_from_its_data(tmp_path: Path) -> None:
    import rerun as rr

    rrd = write_walker(tmp_path / "walker.rrd")
    (tmp_path / "layout.rrd").write_bytes(layout_of(rrd))
    reader, whole = (rr.chunk.RrdReader(str(tmp_path / n)) for n in ("layout.rrd", "walker.rrd"))
    (layout,) = reader.blueprints()
    assert layout.application_id == whole.recordings()[0].application_id
    assert not [c for c in reader.stream(store=layout) if c.entity_path.startswith("/signals")]


def test_what_is_no_replay_has_no_layout(tmp_path: Path) -> None:
    (tmp_path / "bad.rrd").write_bytes(b"no")
    for name in ("bad.rrd", "absent.rrd"):
        with pytest.raises(ViewerError, match=rf"{name}: expected a viewer's file, found"):
            layout_of(tmp_path / name)


def test_the_documentation_lists_every_key() -> None:
    table = page_file("main.js").decode()
    keys = {key for keys in names(r"^ +\[\[(\".+?\")\], ", table) for key in keys.split('", "')}
    written = {"ArrowRight": "→", "ArrowLeft": "←", "ArrowDown": "↓", "ArrowUp": "↑"}
    written |= {"PageDown": "PgDn", "PageUp": "PgUp", "Escape": "Esc", "Delete": "Del"}
    documented = set(names(r"`([^`\n]+)`", DOCUMENTATION.read_text("utf-8")))
    parts = {part for key in keys for part in key.strip('"').split("+") if part} or {"+"}
    assert len(keys) > 25
    assert {written.get(p, p if len(p) > 1 else p.upper()) for p in parts} <= documented
