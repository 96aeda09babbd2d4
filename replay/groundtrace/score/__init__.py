"""Scores of detections against truth, with the level that chance alone would reach."""

from __future__ import annotations

from .assignment import assign
from .consistency import Consistency, ConsistencyScore, consistency, normalised_squares
from .disturbances import DisturbanceScore, score_disturbances
from .headings import HeadingScore, score_headings
from .matching import match
from .passes import PassScore, score_passes
from .picks import PickScore, score_picks
from .positions import PositionScore, score_positions
from .report import Score, score_events
from .set_distances import Gospa, gospa, ospa
from .step_matching import StepMatch, match_steps, scored_spans
from .step_timing import TimeShift, TimingPair, timing_pairs
from .step_words import Confusion
from .steps import StepScore, score_steps
from .tracks import TrackScore, score_tracks
from .ways import WayScore, score_ways

__all__ = [
    "Confusion",
    "Consistency",
    "ConsistencyScore",
    "DisturbanceScore",
    "Gospa",
    "HeadingScore",
    "PassScore",
    "PickScore",
    "PositionScore",
    "Score",
    "StepMatch",
    "StepScore",
    "TimeShift",
    "TimingPair",
    "TrackScore",
    "WayScore",
    "assign",
    "consistency",
    "gospa",
    "match",
    "match_steps",
    "normalised_squares",
    "ospa",
    "score_disturbances",
    "score_events",
    "score_headings",
    "score_passes",
    "score_picks",
    "score_positions",
    "score_steps",
    "score_tracks",
    "score_ways",
    "scored_spans",
    "timing_pairs",
]
