"""The notebooks of the documentation: they run, ask nobody, and what they draw is to be seen."""

from __future__ import annotations

import ast
import json
import socket
from pathlib import Path

import pytest
from matplotlib import colors
from matplotlib import pyplot as plt
from matplotlib.figure import Figure

DOCS = Path(__file__).parents[1] / "docs"
NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))
#: Least contrast of text and its ground. Source: WCAG 2.2, 1.4.3.
CONTRAST = 4.5


def refused(*_: object, **__: object) -> None:
    """Stand for a connection."""
    raise AssertionError("a notebook asks the network")


def luminance(colour: object) -> float:
    """Return the relative luminance of a colour (WCAG 2.2)."""
    parts = [
        c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in colors.to_rgb(colour)
    ]
    return 0.2126 * parts[0] + 0.7152 * parts[1] + 0.0722 * parts[2]


def contrast(one: object, other: object) -> float:
    """Return the contrast of two colours, 1 to 21 (WCAG 2.2)."""
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def run_cells(notebook: Path) -> list[object]:
    """Run the cells as a kernel does; return what their last lines show."""
    shown, names = [], {}
    for cell in json.loads(notebook.read_text("utf-8"))["cells"]:
        if cell["cell_type"] != "code":
            continue
        assert cell["outputs"] == [], "a notebook is kept without what it printed"
        body = ast.parse("".join(cell["source"])).body
        last = body.pop() if isinstance(body[-1], ast.Expr) else None
        exec(compile(ast.Module(body, []), notebook.name, "exec"), names)
        if last is not None:
            shown.append(eval(compile(ast.Expression(last.value), notebook.name, "eval"), names))
    return shown


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_offline_and_all_that_it_draws_is_seen(
    notebook: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(socket.socket, "connect", refused)
    monkeypatch.setattr(socket, "getaddrinfo", refused)
    plt.switch_backend("Agg")
    with plt.rc_context():
        shown = run_cells(notebook)
        drawn = [plt.figure(number) for number in plt.get_fignums()]
        plt.close("all")
    assert any(hasattr(each, "_repr_html_") for each in shown)
    drawn += [each for each in shown if isinstance(each, Figure) and each not in drawn]
    assert drawn
    for figure in drawn:
        for axes in figure.axes:
            ground = axes.get_facecolor()
            texts = [axes.xaxis.label, *axes.get_xticklabels(), axes.title]
            legend = axes.get_legend()
            texts += [] if legend is None else legend.get_texts()
            assert min(contrast(text.get_color(), ground) for text in texts) >= CONTRAST
            for line in axes.lines:
                assert contrast(line.get_color(), ground) >= 2, line.get_label()
