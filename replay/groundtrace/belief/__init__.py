"""Belief functions: frames, models of masses, rules that combine them, measures and decisions.

Masses are arrays of shape (..., 2^k), one row for each candidate, with floats or exact fractions.
:class:`Frame` says what the columns are.

Source: Dempster-Shafer thesis, chapters II and III; where a printed formula is wrong, the function
says how it is corrected.
"""

from .frame import Frame
from .measures import (
    Criterion,
    belief,
    decision,
    over_ignorance,
    pignistic,
    plausibility,
    scores,
)
from .models import graded, specialised, trapezoid
from .rules import (
    RULES,
    Rule,
    conflict,
    dempster,
    discount,
    disjunctive,
    dubois_prade,
    florea,
    smets,
    yager,
)

__all__ = [
    "RULES",
    "Criterion",
    "Frame",
    "Rule",
    "belief",
    "conflict",
    "decision",
    "dempster",
    "discount",
    "disjunctive",
    "dubois_prade",
    "florea",
    "graded",
    "over_ignorance",
    "pignistic",
    "plausibility",
    "scores",
    "smets",
    "specialised",
    "trapezoid",
    "yager",
]
