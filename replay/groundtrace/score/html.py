"""The score as a page: one HTML file that needs nothing from anywhere else."""

from __future__ import annotations

from html import escape
from pathlib import PureWindowsPath
from typing import TYPE_CHECKING

from groundtrace_codecs.signals import NS_PER_S

from .html_parts import STYLE, folded, section, table, warned
from .html_sections import Scored, all_sections
from .report import answers_of
from .truth import ScoredTruth

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from groundtrace_codecs.labels import Label

    from ..results import Provenance, Results
    from .report import Score

POLICY = "default-src 'none'; style-src 'unsafe-inline'"


def score_page(
    result: Results,
    labels: Sequence[Label] | ScoredTruth,
    score: Score,
    tolerance_s: float = 0.12,
    stages: Collection[str] = (),
) -> str:
    """Return a score as an HTML page with figures.

    The page asks nothing of any server, runs no script and names no folder.

    Parameters
    ----------
    result
        What was scored.
    labels
        The truth, perhaps with remarks on it.
    score
        The result's score against it.
    tolerance_s
        The score's tolerance [s].
    stages
        Those chosen for the score.
    """
    origin = result.provenance
    remarks = labels.remarks if isinstance(labels, ScoredTruth) else ()
    truth = labels.labels if isinstance(labels, ScoredTruth) else labels
    said = answers_of(result.events, stages)
    scored = Scored(
        truth, said, result.geometry, origin.start_ns, origin.end_ns, tolerance_s, score
    )
    name = PureWindowsPath(origin.recording).name
    seconds = (origin.end_ns - origin.start_ns) / NS_PER_S
    subtitle = f"{seconds:.1f} s recorded, steps matched within {1e3 * tolerance_s:.0f} ms"
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>Score of {escape(name)}</title><style>{STYLE}</style></head>\n<body><main>"
        f'<header><p class="brand">groundtrace score</p><h1>{escape(name)}</h1>'
        f'<p class="sub">{escape(subtitle)}</p>{warned(result.warnings)}'
        + "".join(f"<p>Truth: {escape(remark)}.</p>" for remark in remarks)
        + "</header>\n"
        f"{all_sections(scored)}\n{_origin(origin)}</main></body></html>\n"
    )


def _origin(origin: Provenance) -> str:
    """Return where the result comes from: hash, versions, the whole recipe."""
    versions = ", ".join(f"{name} {number}" for name, number in origin.versions.items())
    rows = [
        ("recording", PureWindowsPath(origin.recording).name),
        ("SHA-256", origin.sha256),
        ("versions", versions),
    ]
    recipe = folded("Pipeline, with every parameter", f"<pre>{escape(origin.pipeline)}</pre>")
    return section("Origin", table("", ("", ""), rows) + recipe)
