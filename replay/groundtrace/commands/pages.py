"""The pages of the viewer's files that explain: markdown of what the commands print."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .why_steps import settings_text

if TYPE_CHECKING:
    from ..explain import Counts, Remedy
    from ..explain.account import Account, Moment
    from ..explain.candidates import Chain
    from ..explain.comparison import Comparison

READING_WHY = """
## How to read it

* Panels: each candidate's value at one gate, the threshold as a red line. **Green** passed, \
**red** fails at this gate first, **amber** fails here behind another gate.
* White ring: the candidate that explains the moment. White line: the moment.
* Lanes: the same verdicts gate by gate; `score` has steps hit, missed and false; `truth` is what \
the recording says.
"""
READING_COMPARE = """
## How to read it

* Lanes `A` and `B`: steps hit (green), missed (red) and false (magenta); `differs` marks where \
only one of them is right.
* Panels: the decision function of each stage, its threshold as a red line, accepted candidates \
as green triangles, rejected ones as grey crosses.
"""


def moment_page(found: Moment, title: str, remedy: Remedy | None) -> str:
    """Return the page about one moment.

    Parameters
    ----------
    found
        What there is at the moment.
    title
        Which true step it is, e.g. ``step 8``; empty for any other moment.
    remedy
        The smallest change that finds that step; None where there is none, or none is needed.
    """
    lines = [f"# {title or 'moment'} at {found.time_s:.3f} s", ""]
    if found.reason is None:
        lines.append("A step was accepted.")
    else:
        lines.append(f"**{found.reason.cause}**: {found.reason.text}")
    if found.pair is not None:
        lines += ["", f"The step found at {found.pair.found_s:.3f} s {found.pair.text}."]
    if remedy is not None:
        lines += ["", f"Smallest change: `{settings_text(remedy)}`", ""]
        lines += _counts_table((("now", remedy.before), ("then", remedy.after)))
    elif title and found.reason is not None:
        lines += [
            "",
            "No change of one or two parameters finds it without losing more than it mends.",
        ]
    stages = list(dict.fromkeys(link.stage for link in found.chain))
    for link in sorted(found.chain, key=lambda link: -stages.index(link.stage)):
        lines += ["", *_chain(link)]
    return "\n".join(lines) + "\n" + READING_WHY


def _counts_table(rows: tuple[tuple[str, Counts], ...]) -> list[str]:
    head = ["| | right | false | missed |", "|---|---|---|---|"]
    return head + [f"| {name} | {c.tp} | {c.fp} | {c.fn} |" for name, c in rows]


def _chain(link: Chain) -> list[str]:
    verdict = "accepted" if link.accepted else "rejected"
    head = f"**{link.stage} {link.channel} at {link.time_s:.3f} s: {verdict}**"
    rows = [
        f"| {r.gate} | {r.value:.4g} | {r.threshold:.4g} | {r.margin:+.3g} "
        f"| {'pass' if r.passed else '**fail**'} |"
        for r in link.readings
    ]
    return [head, "", "| gate | value | threshold | margin | |", "|---|---|---|---|---|", *rows]


def account_page(found: Account) -> str:
    """Return the page about a whole result."""
    lines = [f"# {found.recording}", "", *_counts_table((("", found.counts),)), ""]
    if found.shift is not None:
        s = found.shift
        lines += [
            f"One shift mends {s.mends} of {s.pairs} steps found at the wrong time: all "
            f"detections {s.late_ms:+.0f} ms from the truth; without that {s.right} are right.",
            "",
        ]
    lines += [f"* {n} missed by {cause}" for cause, n in found.causes.items()]
    if found.missed:
        lines += ["", "| missed | time [s] | why |", "|---|---|---|"]
        lines += [f"| {m.step} | {m.time_s:.3f} | {m.reason.text} |" for m in found.missed]
    return "\n".join(lines) + "\n" + READING_WHY


def comparison_page(found: Comparison) -> str:
    """Return the page about two results."""
    lines = [f"# {found.recording}", "", f"A = {found.a.name}, B = {found.b.name}", ""]
    if found.a.counts is not None and found.b.counts is not None:
        lines += _counts_table((("A", found.a.counts), ("B", found.b.counts)))
    lines += ["", "| parameter | A | B |", "|---|---|---|"]
    lines += [f"| {c.stage}.{c.parameter} | {c.a} | {c.b} |" for c in found.parameters]
    lines += ["", *(f"* {n} {verdict}" for verdict, n in found.verdicts.items())]
    if found.p_value is not None:
        lines.append(f"* McNemar's exact test: p = {found.p_value:.3g}")
    differing = [d for d in found.decisions if d.obstacle is not None]
    lines += ["", "| time [s] | | why |", "|---|---|---|"]
    lines += [
        f"| {d.time_s:.3f} | {d.verdict} | {d.obstacle.side}: {d.obstacle.text} |"
        for d in differing
        if d.obstacle is not None
    ]
    return "\n".join(lines) + "\n" + READING_COMPARE
