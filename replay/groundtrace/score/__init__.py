"""Scores of detections against truth, with the level that chance alone would reach."""

from __future__ import annotations

from .matching import match
from .picks import PickScore, score_picks
from .report import Score, score_events
from .steps import StepScore, score_steps

__all__ = ["PickScore", "Score", "StepScore", "match", "score_events", "score_picks", "score_steps"]
