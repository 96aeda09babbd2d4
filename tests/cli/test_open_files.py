"""No file is replaced or renamed while we have it open: Windows refuses that."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from command_runs import run
from sweeps import swept
from test_full_disk import OUTPUTS, Capture, _in_place, inputs

if TYPE_CHECKING:
    from collections.abc import Callable

assert inputs
assert _in_place
FILES = Path("/proc/self/fd")


def open_files() -> set[str]:
    """The files that this process has open."""
    found = set()
    for number in FILES.iterdir():
        try:
            found.add(str(number.readlink()))
        except OSError:  # that of the listing itself
            continue
    return found


def as_windows(move: Callable[..., Any]) -> Callable[..., Any]:
    """Refuse what Windows refuses: a move of, or over, a file that is open."""

    def moved(source: Any, target: Any, *more: Any, **named: Any) -> Any:
        for path in (source, target):
            whole = str(Path(path).resolve())
            if any(name == whole or name.startswith(f"{whole}/") for name in open_files()):
                raise PermissionError(13, f"{path} is open", str(path))
        return move(source, target, *more, **named)

    return moved


def test_the_stand_in_refuses_to_move_over_what_is_open(tmp_path: Path) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    here.write_text("new")
    with there.open("w"), pytest.raises(PermissionError, match="there is open"):
        as_windows(os.replace)(here, there)
    as_windows(os.replace)(here, there)
    assert there.read_text() == "new"


#: Outputs that are tried every day: of each way in which one takes the place of another, one.
EVERYDAY = (
    "why.rrd",
    "replay.mcap",
    "sweep.svg",
    "labels.txt",
    "bag",
    "signals.csv",
    "fleet.html",
    "converted.mcap",
)


@pytest.mark.parametrize("out", swept((o for o in OUTPUTS if o != "fleet.parquet"), *EVERYDAY))
@pytest.mark.usefixtures("_in_place")
@pytest.mark.skipif(not FILES.exists(), reason="this system does not list its open files")
def test_an_output_is_replaced_when_nothing_has_it_open(
    out: str, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    Path(out).write_text("mine", "utf-8")
    for module, names in ((os, ("replace", "rename")), (Path, ("replace", "rename"))):
        for name in names:
            monkeypatch.setattr(module, name, as_windows(getattr(module, name)))
    ran = run(capsys, *OUTPUTS[out], out, "--force")
    assert ran.code in (0, 3), ran.err
    assert Path(out).is_dir() or Path(out).read_bytes() != b"mine"


@pytest.mark.usefixtures("_in_place")
def test_a_table_that_another_program_has_open_is_named_as_such(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    Path("steps.csv").write_text("mine", "utf-8")
    monkeypatch.setattr(os, "replace", as_windows(os.replace))
    monkeypatch.setattr(Path, "replace", as_windows(Path.replace))
    with Path("steps.csv").open("r+"):
        ran = run(capsys, *OUTPUTS["steps.csv"], "steps.csv", "--force")
    assert ran.code == 1
    assert "steps.csv: expected a file that can be written or replaced, found: Perm" in ran.err
    assert "is it open in another program" in ran.err
    assert "room to write" not in ran.err
    assert Path("steps.csv").read_text("utf-8") == "mine"
