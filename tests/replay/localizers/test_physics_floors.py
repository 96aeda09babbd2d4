"""The tables of common floors, and that the page of the documentation shows them."""

from __future__ import annotations

from pathlib import Path

import pytest
from floor_tables import FLOORS, GROUNDS, main, velocity_table

PAGE = Path(__file__).parents[3] / "docs" / "waves.md"


@pytest.fixture
def printed(capsys) -> str:
    main()
    return capsys.readouterr().out


def test_the_page_shows_what_the_bench_prints(printed):
    tables = [part for part in printed.split("\n\n") if part.startswith("|")]
    assert len(tables) == 3
    page = PAGE.read_text("utf-8")
    for table in tables:
        assert table.strip() in page


def test_every_floor_and_ground_has_a_row_of_the_same_length():
    head, _, *rows = velocity_table().splitlines()
    assert [row.split(" | ")[0].strip("| ") for row in rows] == [*FLOORS, *GROUNDS]
    assert {row.count("|") for row in rows} == {head.count("|")}


def test_the_thesis_concrete_has_its_velocities():
    row = next(r for r in velocity_table().splitlines() if r.startswith("| concrete 0.20 m"))
    cells = row.strip("|").split("|")
    assert [int(cell) for cell in cells[1:5]] == [3266, 2000, 1822, 3162]
    assert int(cells[9]) == 5000
