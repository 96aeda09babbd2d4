"""``groundtrace figure``: a moment drawn for print."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_runs import done, run
from PIL import Image

from groundtrace_recordings import path_of

RESULTS = "walk.results.mcap"


@pytest.fixture
def missed(capsys: pytest.CaptureFixture[str]) -> None:
    """Results of a walk with missed steps, in the present folder."""
    walk = path_of("waist-walk.mcap")
    setting = ("--set", "steps.score=0.8")
    done(capsys, "replay", walk, "--to", 25, "--no-viewer", "--out", RESULTS, *setting)


@pytest.mark.usefixtures("missed")
def test_a_missed_step_is_drawn_as_picture_and_as_drawing_the_same_each_time(
    capsys: pytest.CaptureFixture[str],
) -> None:
    for name, begins in (("a.png", b"\x89PNG"), ("a.svg", b"<?xml"), ("a.pdf", b"%PDF")):
        ran = done(capsys, "figure", RESULTS, "--step", 1, "-o", name)
        assert ran.out.startswith(f"wrote {name}: step 1 at ")
        assert ran.out.endswith(": no step (threshold)\n")
        first = Path(name).read_bytes()
        assert first.startswith(begins)
        done(capsys, "figure", RESULTS, "--step", 1, "-o", name)
        assert Path(name).read_bytes() == first
    with Image.open("a.png") as picture:
        assert picture.width == 1800
    assert "missed step" in Path("a.svg").read_text("utf-8")
    done(capsys, "figure", RESULTS, "--at", 5, "-o", "b.png", "--dpi", 100)
    with Image.open("b.png") as picture:
        assert picture.width == 900


@pytest.mark.usefixtures("missed")
def test_what_is_no_figure_of_the_recording_stays(capsys: pytest.CaptureFixture[str]) -> None:
    Path("a.png").write_bytes(b"\x89PNG of a person")
    error = run(capsys, "figure", RESULTS, "--step", 1, "-o", "a.png").error
    assert error.startswith("a.png: expected a new file")
    done(capsys, "figure", RESULTS, "--step", 1, "-o", "a.png", "--force")


@pytest.mark.usefixtures("missed")
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--step", 1, "-o", "a.jpg"), "a.jpg: expected a name that ends in .png, .svg, .pdf"),
        (("-o", "a.png"), "figure: expected --step or --at, found neither"),
        (("--step", 1, "--at", 3, "-o", "a.png"), "figure: expected --step or --at, found both"),
        (("--step", 99, "-o", "a.png"), "--step: "),
    ],
)
def test_what_cannot_be_drawn_is_one_line(
    capsys: pytest.CaptureFixture[str], arguments: tuple[object, ...], said: str
) -> None:
    assert said in run(capsys, "figure", RESULTS, *arguments).error
    assert not Path("a.png").exists()
