"""Scores of detections against truth, with the level that chance alone would reach."""

from __future__ import annotations

from .matching import match
from .picks import PickScore, score_picks
from .report import Score, score_events
from .step_matching import StepMatch, match_steps, scored_spans
from .steps import StepScore, score_steps

__all__ = [
    "PickScore",
    "Score",
    "StepMatch",
    "StepScore",
    "match",
    "match_steps",
    "score_events",
    "score_picks",
    "score_steps",
    "scored_spans",
]
