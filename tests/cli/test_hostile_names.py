"""What a recording of somebody else is called does nothing to a terminal or a spreadsheet."""

from __future__ import annotations

import csv
import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from command_runs import done, run

from groundtrace_codecs.events import Label
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import Channel, SignalBlock, Stream
from groundtrace_codecs.truth import read_truth_csv
from groundtrace_codecs.writer import write_recording
from groundtrace_recordings import path_of

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


@pytest.mark.sweep
def test_no_page_turns_a_name_round(named: str, capsys: Capture) -> None:
    done(capsys, "replay", named, "--no-viewer", "--out", "a.mcap", "--pipeline", "waist-peaks")
    done(capsys, "score", "a.mcap", "--html", "score.html")
    fleet = ("fleet", named, "--pipeline", "waist-peaks", "--workers", "1", "-o", "fleet.parquet")
    done(capsys, *fleet)
    done(capsys, "fleet-report", "fleet.parquet", "-o", "fleet.html")
    for page in ("score.html", "fleet.html"):
        text = Path(page).read_text("utf-8")
        assert r"\u202egpj\u2066" in text
        assert not HARMFUL.search(text), page


@pytest.mark.parametrize("words", [(HOSTILE,), ("info", f"--{HOSTILE}"), ("info", "a", HOSTILE)])
def test_what_is_no_command_or_option_is_named_harmlessly(
    words: tuple[str, ...], capsys: Capture
) -> None:
    ran = run(capsys, *words)
    assert ran.code == 2
    assert r"\u202egpj" in ran.out + ran.err
    assert not HARMFUL.search(ran.out + ran.err)


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


def test_names_of_channels_that_are_formulas_come_back_by_a_guessed_map(
    capsys: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    names = ["=A1", "+1+2", "-B2", "@SUM(1)", "'=quoted", "plain", "\u202egpj\u2066\x7f\x9b"]
    stream = Stream("/s", tuple(Channel(name, "seismic", "count") for name in names), 100.0)
    samples = np.arange(300 * len(names)).reshape(-1, len(names)).astype("<i4")
    write_recording("a.mcap", [(stream, "i32le", [SignalBlock(stream, 10**18, 0, samples)])])
    done(capsys, "export", "a.mcap", "-o", "a.csv", "--kind", "signals")
    header = (tmp_path / "a.csv").read_text(encoding="utf-8").splitlines()[0].split(",")
    assert not [cell for cell in header if cell.startswith(tuple("=+-@"))]
    done(capsys, "import", "a.csv", "--guess", "-o", "map.toml")
    done(capsys, "import", "a.csv", "--map", "map.toml", "-o", "b.mcap")
    written = Path("map.toml").read_text("utf-8")
    assert not HARMFUL.search(written), "who checks the map reads what the import reads"
    columns = {c["column"] for c in tomllib.loads(written)["stream"][0]["columns"]}
    assert {f"{name}_count" for name in names} <= columns
    with Recording.open("b.mcap") as back:
        found = np.concatenate([stamped.block.samples for stamped in back.blocks()])
    np.testing.assert_array_equal(found[:, -len(names) :], samples)
