"""What a recording of somebody else is called does nothing to a terminal or a spreadsheet."""

from __future__ import annotations

import csv
import json
import re
from typing import TYPE_CHECKING

import pytest
from command_runs import done, run

from groundtrace_codecs.events import Label
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.truth import read_truth_csv
from groundtrace_codecs.writer import write_recording
from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from pathlib import Path

Capture = pytest.CaptureFixture[str]
#: It clears the screen, names the window, reverses the line, and is a formula.
HOSTILE = "=A1\x1b[2J\x1b]0;x\x07\u202egpj\u2066\x9b5A"
HARMFUL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069]")


@pytest.fixture
def named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """The bundled walk, with hostile names wherever a name can be; its file's name."""
    monkeypatch.chdir(tmp_path)
    with Recording.open(path_of("waist-walk.mcap")) as walk:
        blocks = [stamped.block for stamped in walk.blocks()]
        sources = [(s, "f64le", [b for b in blocks if b.topic == s.topic]) for s in walk.streams]
        labels = [*walk.labels, Label(walk.start_ns + 10**9, "note", label=HOSTILE)]
        metadata = {HOSTILE: {HOSTILE: HOSTILE}}
        name = f"{HOSTILE}.mcap".replace("/", "")
        write_recording(name, sources, labels=labels, metadata=metadata)
    return name


def test_no_command_prints_what_moves_the_cursor(named: str, capsys: Capture) -> None:
    texts = [
        done(capsys, *words)
        for words in (
            ("info", named),
            ("info", named, "--json"),
            ("replay", named, "--no-viewer", "--out", "a.mcap", "--pipeline", "waist-peaks"),
            ("replay", named, "--no-viewer", "--out", "b.mcap", "--json"),
            ("score", "a.mcap"),
            ("score", "a.mcap", "--json"),
            ("why", "a.mcap"),
            ("why", "a.mcap", "--json"),
            ("compare", "a.mcap", "b.mcap"),
            ("annotate", named, "--add", "note@1", "--note", HOSTILE),
            ("annotate", named, "--list"),
            ("annotate", named, "--list", "--json"),
            ("export", "a.mcap", "-o", "tables"),
            ("doctor", named),
            ("cut", named, "-o", "cut.mcap", "--from", "1", "--to", "2"),
        )
    ]
    texts += [run(capsys, "info", named + HOSTILE), run(capsys, "score", named)]
    for text in texts:
        assert not HARMFUL.search(text.out + text.err), (text.out + text.err)[:500]
    assert json.loads(texts[1].out)["recording"] == named


def test_no_cell_is_a_formula_and_the_text_comes_back(
    named: str, capsys: Capture, tmp_path: Path
) -> None:
    done(capsys, "replay", named, "--no-viewer", "--out", "a.mcap", "--pipeline", "waist-peaks")
    done(capsys, "export", "a.mcap", "-o", "truth.csv", "--kind", "truth")
    with (tmp_path / "truth.csv").open(encoding="utf-8", newline="") as file:
        cells = [cell for row in csv.reader(file) for cell in row]
    formulas = [c for c in cells if re.match(r"[=+\-@\t\r](?![0-9.]+$)", c)]
    assert formulas == []
    assert any("=A1" in cell for cell in cells)
    assert HOSTILE in {label.label for label in read_truth_csv(tmp_path / "truth.csv", 0)}
