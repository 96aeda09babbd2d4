"""What the viewer has no glyph for is replaced on the way to it, and nowhere else."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from share_sessions import quietly
from viewer_sessions import read_back

import groundtrace_viewers
from groundtrace.annotate.store import stored
from groundtrace.simulate.gait import WalkOptions
from groundtrace.simulate.recording import write
from groundtrace.simulate.walk import simulate_walk
from groundtrace_viewers.rerun.legible import legible, legible_path

if TYPE_CHECKING:
    from shared_viewer import SharedViewer

#: A note in each script, and how much of it the viewer can draw.
NOTES = {
    "latin": ("pied gauche, Łódź, Ñandú", "pied gauche, Łódź, Ñandú"),
    "cyrillic": ("левая нога", "левая нога"),
    "greek": ("αριστερό", "αριστερό"),
    "hebrew": ("שלום", "????"),
    "arabic": ("قدم", "???"),
    "devanagari": ("पैर", "???"),
    "thai": ("เท้า", "????"),
    "japanese": ("東側の足 ok", "???? ok"),
    "chinese": ("左脚", "??"),
    "korean": ("왼발", "??"),
    "emoji": ("door \U0001f6aa", "door ?"),
    "private": ("a\ue000b", "a?b"),
    "combining": ("a\u0301 a\u20e3", "a\u0301 a?"),
    "control": ("a\x07b", "a?b"),
    "bidi": ("a\u202eb\u2066c", "a?b?c"),
    "code": ("★ `★ é` ``東 ` ★``", "★ `? é` ``? ` ?``"),
}


@pytest.mark.parametrize("script", NOTES)
def test_a_text_keeps_what_the_viewer_can_draw(script: str) -> None:
    note, shown = NOTES[script]
    assert legible(note) == shown
    assert legible(shown) == shown


def test_names_of_entities_stay_apart_and_plain_ones_stay() -> None:
    assert legible_path("/signal/東") != legible_path("/signal/西")
    assert legible_path("/signal/G1\\ b") == "/signal/G1\\ b"
    assert legible_path("/signal/é") == "/signal/é"


def test_nothing_but_this_module_hands_anything_to_rerun() -> None:
    for path in Path(groundtrace_viewers.__file__).parent.rglob("*.py"):
        if path.name == "legible.py":
            continue
        tree = ast.parse(path.read_text("utf-8"))
        called = [n.func for n in ast.walk(tree) if isinstance(n, ast.Call)]
        names = [f for f in called if isinstance(f, ast.Attribute)]
        assert not [f.attr for f in names if f.attr in ("send_columns", "send_recording_name")]
        sent = [f for f in names if f.attr in ("log", "send_blueprint")]
        to = {f.value.attr if isinstance(f.value, ast.Attribute) else "" for f in sent}
        to |= {f.value.id for f in sent if isinstance(f.value, ast.Name)}
        assert not to & {"rr", "recording", "_recording"}, path
        assert "default_blueprint" not in path.read_text("utf-8"), path


@pytest.fixture(scope="module")
def noted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the timeline of a walk with an unfortunate name and a note in each script."""
    folder = tmp_path_factory.mktemp("notes")
    recording = folder / "東 \U0001f6aa.mcap"
    write(simulate_walk(WalkOptions(seed=3, duration_s=8.0)), recording)
    for i, (note, _) in enumerate(NOTES.values()):
        if "\x07" not in note:
            at = f"note@{3 + i / 50:.2f}"
            quietly("annotate", recording, "--add", at, "--note", note, "--author", "足")
    rrd = folder / "walk.rrd"
    quietly("replay", recording, "--rrd", rrd)
    assert NOTES["japanese"][0] in {a.label.note for a in stored(recording).content.annotations}
    return rrd


def test_notes_are_legible_in_the_timeline(noted: Path) -> None:
    _, texts = read_back(noted, "/log/annotations", "TextLog:text")
    assert any("???? ok" in text for (text,) in texts)
    for note, _ in NOTES.values():
        assert note == legible(note) or not any(note in text for (text,) in texts)


def test_the_viewer_lives_with_a_note_of_each_script_under_its_cursor(
    noted: Path, viewer: SharedViewer
) -> None:
    state, picture = viewer.show(noted, 3.4)
    assert {v.name: v.reports for v in state.views if v.reports} == {}
    assert picture.std() > 0
    assert viewer.client.get_state().recordings
