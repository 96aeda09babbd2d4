"""Causes planted in simulated recordings are named: a part of the bench of docs/accuracy/why.md."""

from __future__ import annotations

import pytest
from why_confusion import Cell, cells, outcome

#: So many recordings of each scene, every one with another cause.
RECORDINGS = 6


@pytest.mark.parametrize("scene", ["waist, peaks", "wrist", "room", "line"])
def test_what_is_planted_is_named(scene: str) -> None:
    """Of the seeds that served to mend reasons; the bench reports on others."""
    own = [n for n, c in enumerate(cells()) if c.scene == scene and c.asked != "fixes"]
    told = [outcome((number, 0)) for number in own[:: len(own) // RECORDINGS][:RECORDINGS]]
    assert len(told) == RECORDINGS
    assert all(o.named for o in told), "a plant had no effect"
    assert not [(o.cell.name, o.named, o.text) for o in told if o.named != o.planted]


#: Plants of development that were called something else before the reason was mended.
MENDED = (
    ("room, picks, quiet, no_arrival", 2),  # shape: a frame of a candidate outside the span
    ("line, picks, clipped, overdriven_channel", 4),  # threshold: a candidate of the hum
    ("room, picks, filter, heaved_channel", 6),  # late: what the filter left of it
    ("room, picks, filter, heaved_channel", 14),  # quiet: a candidate by chance beside it
    ("room, steps, refractory, second_footfall", 20),  # coincidence: the others are held off
    ("room, fixes, model, wrong_velocity", 0),  # ambiguous: no place fits by that velocity
)


@pytest.mark.parametrize(("name", "seed"), MENDED)
def test_what_was_called_something_else_is_named(name: str, seed: int) -> None:
    (number,) = [n for n, cell in enumerate(cells()) if cell.name == name]
    told = outcome((number, seed))
    assert (told.named, told.planted) == (told.cell.cause, told.cell.cause), told.text


def test_every_cause_of_a_step_is_planted_somewhere() -> None:
    from groundtrace.explain.reasons import CAUSES

    planted = {cell.cause for cell in cells() if cell.asked == "steps"}
    assert set(CAUSES) - planted == {"dropped", "undecided"}


def test_cells_have_names_of_their_own() -> None:
    names = [cell.name for cell in cells()]
    assert len(set(names)) == len(names)
    assert isinstance(cells()[0], Cell)
