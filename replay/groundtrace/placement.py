"""Where on the body a sensor is worn, guessed from how it moves while its wearer walks.

A sure guess stands in for a placement that nobody states (:mod:`.suitability`); one that is stated
counts, whatever is guessed. Each question has one measure and one threshold, argued from how bodies
walk:

- *Foot?* From 0 to some 4 m/s and back in half a second is 15 m/s2 for most of it, where the
  body's mass bobs by 3 m/s2. It turns by more than a right angle in that time, at 3 rad/s and more,
  and stands for a third of a stride: what swings like a pendulum is slower than 0.15 of its peak
  for 0.1 of the time.
- *Swinging?* Thigh and arm swing by 15 to 25 degrees about their joint once a stride, so that the
  felt vertical swings as well, and turn by more than 1 rad/s; trunk and a hand that holds something
  nod by some degrees.
- *Wrist or pocket?* A hand at the end of a swinging arm feels mostly the swing, once a stride; a
  thigh feels mostly the contacts of both feet, near the hip, once a step.
- *Hand or trunk?* What is read is held with its face up; what is strapped on has its face to the
  side. That is habit and not physics: it counts for less.

Where a question has several measures, the geometric mean of them as parts of their thresholds
counts. At a threshold the two answers are alike; at twice the threshold one of them has 0.94 (of
the habit, 0.67 at most). The confidence is the product along the questions. Method and numbers are
ours.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

Site = Literal["foot", "trunk", "wrist", "pocket", "hand"]
#: Names in words.
WORDS = {
    "foot": "foot",
    "trunk": "waist or trunk",
    "wrist": "swinging wrist",
    "pocket": "pocket or bag",
    "hand": "held in the hand",
}
#: What a stated placement may turn out to be: a phone is carried in many ways, and who carries
#: something does not swing the arm.
MAY_BE: dict[str, frozenset[Site]] = {
    "waist": frozenset({"trunk", "hand"}),
    "trunk": frozenset({"trunk", "hand"}),
    "foot": frozenset({"foot"}),
    "wrist": frozenset({"wrist", "pocket", "hand", "trunk"}),
    "phone": frozenset({"trunk", "wrist", "pocket", "hand"}),
}
#: The placement that each place stands for.
PLACEMENTS: dict[Site, str] = {
    "foot": "foot",
    "trunk": "trunk",
    "wrist": "wrist",
    "pocket": "phone",
    "hand": "phone",
}
#: A guess less sure than this contradicts nobody. Without a gyroscope, neither does it stand in for
#: a placement that nobody states: an upper arm and a pouch on the breast (oxford-step, 0.64 and
#: 0.53) then pass for the waist, which they are not timed like; the lower backs of mobgap have 0.71
#: and 0.90 without theirs. Chosen on these; reported on back-steps (bench/unstated_placement.py).
SURE = 0.7
#: With a gyroscope a guess stands in where it is likelier than all others together.
LIKELIER = 0.5
#: Thresholds: spread of the force's length [m/s2], root mean square of the angular velocity of a
#: foot and of a swinging limb [rad/s], part of the time that a foot does not turn, of the felt
#: vertical's angle [deg], part of the movement that comes once a stride, and how far up the face
#: looks [cosine].
SWING_MPS2, FOOT_RADPS, LIMB_RADPS, RESTS = 5.0, 2.0, 1.0, 0.15
TILT_DEG, ONCE, FACE = 15.0, 0.5, 0.7


@dataclass(frozen=True, slots=True)
class Measures:
    """What a guess was decided by, medians over the windows of walking.

    Attributes
    ----------
    walked_s
        Length of the walking looked at [s].
    swing_mps2
        Standard deviation of the length of the specific force [m/s2].
    turning_radps
        Root mean square of the angular velocity [rad/s]; None without a gyroscope.
    rests
        Part of the time in which it hardly turns; None without a gyroscope.
    tilt_deg
        Root mean square angle of the felt vertical from its mean [deg].
    once
        Part of the movement that comes once a stride, of that which comes once or twice.
    face
        Cosine of the angle between the sensor's z axis and the vertical, 0 to 1.
    """

    walked_s: float
    swing_mps2: float
    turning_radps: float | None
    rests: float | None
    tilt_deg: float
    once: float
    face: float


@dataclass(frozen=True, slots=True)
class PlacementGuess:
    """Where a sensor may be worn.

    Attributes
    ----------
    site
        The likeliest place.
    confidence
        How likely, 0.2 to 1, as far as the thresholds go.
    measures
        What it was decided by.
    """

    site: Site
    confidence: float
    measures: Measures

    def contradicts(self, stated: str) -> bool:
        """Return whether the guess is sure of something else than a recording states."""
        known = MAY_BE.get(stated)
        return known is not None and self.site not in known and self.confidence >= SURE

    @property
    def sure(self) -> bool:
        """Whether it may stand in for a placement that nobody states."""
        least = SURE if self.measures.turning_radps is None else LIKELIER
        return self.confidence >= least

    @property
    def placement(self) -> str:
        """The placement that a stream would state."""
        return PLACEMENTS[self.site]

    @property
    def words(self) -> str:
        """The place in words."""
        return WORDS[self.site]

    @property
    def text(self) -> str:
        """The guess and what it was decided by, in one line."""
        m = self.measures
        turning = ""
        if m.turning_radps is not None:
            turning = f", turning {m.turning_radps:.2f} rad/s, rests {m.rests:.2f}"
        return (
            f"{WORDS[self.site]} ({self.confidence:.2f}): {m.walked_s:g} s like walking, "
            f"swing {m.swing_mps2:.1f} m/s2{turning}, tilt {m.tilt_deg:.0f} deg, "
            f"once a stride {m.once:.2f}, face up {m.face:.2f}"
        )


def guessed(measures: Measures) -> PlacementGuess:
    """Return the likeliest place."""
    if measures.turning_radps is None or measures.rests is None:
        is_foot = _passed(measures.swing_mps2 / SWING_MPS2)
        swings = _passed(measures.tilt_deg / TILT_DEG)
    else:
        turns = measures.turning_radps / FOOT_RADPS
        is_foot = _passed(measures.swing_mps2 / SWING_MPS2, turns, measures.rests / RESTS)
        swings = _passed(measures.turning_radps / LIMB_RADPS, measures.tilt_deg / TILT_DEG)
    wrist = _passed(measures.once / ONCE)
    hand = _passed(measures.face / FACE, power=2)
    likely: dict[Site, float] = {
        "foot": is_foot,
        "wrist": (1 - is_foot) * swings * wrist,
        "pocket": (1 - is_foot) * swings * (1 - wrist),
        "hand": (1 - is_foot) * (1 - swings) * hand,
        "trunk": (1 - is_foot) * (1 - swings) * (1 - hand),
    }
    site = max(get_args(Site), key=lambda name: likely[name])
    return PlacementGuess(site, likely[site], measures)


def _passed(*ratios: float, power: int = 4) -> float:
    """Return how likely a threshold is passed by values, as parts of it: 0.5 at the threshold."""
    ratio = math.prod(max(r, 1e-9) for r in ratios) ** (1 / len(ratios))
    return 1 / (1 + ratio**-power)
