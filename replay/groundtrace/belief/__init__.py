"""Belief functions: frames, models of masses, rules that combine them, measures and decisions.

Masses are arrays of shape (..., 2^k), one row for each candidate, with floats or exact fractions.
:class:`Frame` says what the columns are.

Source: Dempster-Shafer thesis, chapters II and III; where a printed formula is wrong, the function
says how it is corrected.
"""

from .frame import Frame, check_masses
from .measures import (
    Criterion,
    belief,
    decision,
    over_ignorance,
    pignistic,
    plausibility,
    scores,
)
from .models import (
    appriou_1,
    appriou_2,
    bayesian,
    certain,
    dubois_prade_model,
    graded,
    ignorance,
    neighbour,
    simple_support,
    specialised,
    trapezoid,
)
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
    "appriou_1",
    "appriou_2",
    "bayesian",
    "belief",
    "certain",
    "check_masses",
    "conflict",
    "decision",
    "dempster",
    "discount",
    "disjunctive",
    "dubois_prade",
    "dubois_prade_model",
    "florea",
    "graded",
    "ignorance",
    "neighbour",
    "over_ignorance",
    "pignistic",
    "plausibility",
    "scores",
    "simple_support",
    "smets",
    "specialised",
    "trapezoid",
    "yager",
]
