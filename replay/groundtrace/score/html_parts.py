"""Pieces of the score's page: style, sections, tiles, tables, figures. All text is escaped."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..warned import Warned
    from .step_words import Confusion

#: Colours after Okabe and Ito (2008), told apart by colour-blind people, on light and dark.
STYLE = """
:root{--paper:#fff;--card:#f6f7f9;--ink:#1b2028;--soft:#5c6673;--rule:#dfe3e8;--result:#0072b2;
--hit:#00916a;--missed:#d1480f;--false:#b8377f;--chance:#8a94a0;--random:#b9802f;--scored:#e9f1f7}
@media(prefers-color-scheme:dark){:root{--paper:#14171c;--card:#1c2027;--ink:#e7eaee;
--soft:#9aa5b1;--rule:#313843;--result:#56b4e9;--hit:#2fc296;--missed:#ff7a45;--false:#e57fb8;
--chance:#8a94a0;--random:#e0aa5c;--scored:#1f2a36}}
*{box-sizing:border-box}
body{margin:0;background:var(--paper);color:var(--ink);
font:15px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,"Helvetica Neue",Arial,sans-serif}
main{max-width:1240px;margin:0 auto;padding:36px 32px 64px}
header{border-bottom:2px solid var(--ink);padding-bottom:14px}
h1{font-size:30px;line-height:1.2;margin:2px 0;overflow-wrap:anywhere}
.brand{margin:0;color:var(--result);font-weight:600;letter-spacing:.04em}
.sub{margin:0;color:var(--soft)}
section{margin-top:34px}
h2{font-size:21px;margin:0 0 14px}
.tiles{display:grid;grid-template-columns:repeat(auto-fit,minmax(165px,1fr));gap:12px;margin:0}
.tiles div{background:var(--card);border:1px solid var(--rule);border-radius:8px;padding:12px 14px}
.tiles dt{color:var(--soft);font-size:13px}
.tiles dd{margin:0;font-size:25px;font-weight:600;font-variant-numeric:tabular-nums}
.tiles dd small{display:block;font-size:12.5px;font-weight:400;color:var(--soft)}
.pair{display:grid;grid-template-columns:repeat(auto-fill,minmax(min(480px,100%),1fr));gap:0 28px}
.row{display:flex;flex-wrap:wrap;gap:0 56px}
figure{margin:20px 0 0}
figcaption{color:var(--soft);font-size:13.5px;margin-top:4px}
.figure-title,caption{font-weight:600;margin:0 0 6px;text-align:left}
caption{white-space:nowrap}
.key{display:inline-block;width:14px;height:10px;border-radius:2px;margin:0 6px 0 0}
.keys{display:block}.keys span{margin-right:16px;white-space:nowrap}
svg{display:block;width:100%;height:auto;font-family:inherit}
svg text{fill:var(--soft);font-size:12px}
svg text.note{fill:var(--ink);paint-order:stroke;stroke:var(--paper);stroke-width:4px}
svg text.label{fill:var(--ink);font-size:13px}
svg text.mid{text-anchor:middle}
svg text.end{text-anchor:end}
.grid{stroke:var(--rule)}.zero{stroke:var(--soft)}.mark{stroke:var(--ink);stroke-dasharray:5 4}
.scored{fill:var(--scored)}.bar{fill:var(--result)}
.line{fill:none;stroke-width:2.2;stroke-linejoin:round}
.line.result{stroke:var(--result)}.line.metronome{stroke:var(--chance);stroke-dasharray:7 4}
.line.random{stroke:var(--random);stroke-dasharray:2 4;stroke-linecap:round}
.line.truth{stroke:var(--hit);stroke-width:1.2}.line.outline{stroke:var(--soft);stroke-width:1.2}
.line.median{stroke:var(--ink)}
.dot.result{fill:var(--result)}.dot.fix{fill:var(--random)}.dot.metronome{fill:var(--chance)}
.dot.random{fill:var(--random)}.dot.truth{fill:var(--hit)}.dot.missed{fill:var(--missed)}
.dot.false{fill:var(--false)}.dot.bias{fill:none;stroke:var(--missed);stroke-width:2.5}
.ring{fill:none;stroke:var(--soft);stroke-dasharray:4 3}.sensor{fill:var(--soft)}
.stroke{stroke-width:1.6}.stroke.hit{stroke:var(--hit)}
.stroke.missed{stroke:var(--missed);stroke-width:4}.stroke.false{stroke:var(--false);stroke-width:4}
.key.result{background:var(--result)}.key.metronome{background:var(--chance)}
.key.random,.key.fix{background:var(--random)}.key.hit,.key.truth{background:var(--hit)}
.key.missed,.key.bias{background:var(--missed)}.key.false{background:var(--false)}
.key.median{background:var(--ink);height:3px;vertical-align:middle}.key.sensor{background:var(--soft)}
.scroll{overflow-x:auto;margin-top:20px}
table{border-collapse:collapse;font-variant-numeric:tabular-nums}
th,td{padding:5px 18px 5px 0;text-align:left;border-bottom:1px solid var(--rule);vertical-align:top}
th{color:var(--soft);font-weight:500;font-size:13.5px}
td{overflow-wrap:anywhere}
details{margin-top:16px}summary{cursor:pointer;color:var(--result)}
pre{background:var(--card);border:1px solid var(--rule);border-radius:8px;padding:14px;
overflow-x:auto;font-size:13px}
.warned{margin:10px 0 0;padding:0;list-style:none;color:var(--missed)}
@media print{main{padding:0}section{break-inside:avoid}}
"""


def warned(warnings: Sequence[Warned]) -> str:
    """Return what a replay warned of as a list for the head of a page; empty where of nothing."""
    items = "".join(f"<li>Warning: {escape(each.line)}</li>" for each in warnings)
    return f'<ul class="warned">{items}</ul>' if items else ""


def section(title: str, content: str) -> str:
    """Return a section; ``content`` is HTML."""
    return f"<section><h2>{escape(title)}</h2>{content}</section>\n"


def tiles(items: Sequence[tuple[str, str, str]]) -> str:
    """Return tiles of (name, figure, remark)."""
    cells = "".join(
        f"<div><dt>{escape(name)}</dt><dd>{escape(value)}<small>{escape(remark)}</small></dd></div>"
        for name, value, remark in items
    )
    return f'<dl class="tiles">{cells}</dl>'


def figure(title: str, svg: str, caption: str = "", **keys: str) -> str:
    """Return a figure; ``keys`` name what each colour stands for."""
    named = "".join(
        f'<span><i class="key {style}"></i>{escape(name)}</span>' for style, name in keys.items()
    )
    legend = f'<span class="keys">{named}</span>' if named else ""
    heading = f'<p class="figure-title">{escape(title)}</p>' if title else ""
    return f"<figure>{heading}{svg}<figcaption>{legend}{escape(caption)}</figcaption></figure>"


def table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table."""
    caption = f"<caption>{escape(title)}</caption>" if title else ""
    head = "".join(f'<th scope="col">{escape(cell)}</th>' for cell in header)
    named = f"<thead><tr>{head}</tr></thead>" if any(header) else ""
    body = "".join(
        f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows
    )
    return f'<div class="scroll"><table>{caption}{named}<tbody>{body}</tbody></table></div>'


def folded(title: str, content: str) -> str:
    """Return HTML that shows when its title is clicked."""
    return f"<details><summary>{escape(title)}</summary>{content}</details>"


def confusion_table(title: str, c: Confusion) -> str:
    """Return a confusion matrix: rows are truth, columns detections."""
    rows = [(word, *map(str, counts)) for word, counts in zip(c.words, c.counts, strict=True)]
    header = ("truth \\ found", *c.words)
    said = f"{title}: {c.agreed} of {c.compared} agree ({c.accuracy:.1%})"
    return table(said, header, rows)


def shown(value: float | None, unit: str, digits: int = 2, *, sign: bool = False) -> str:
    """Return a number with its unit, or a dash."""
    if value is None:
        return "\N{EN DASH}"
    return f"{value:{'+' if sign else ''}.{digits}f} {unit}"
