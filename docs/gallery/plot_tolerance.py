"""
A score against its tolerance
=============================

A wide tolerance raises any score. So the score of a metronome that ticks at the rate of the walk
is drawn beside it.
"""

import numpy as np
from matplotlib import pyplot as plt

import groundtrace as gt

results = gt.replay("lower-back", "waist-steps")
tolerances = np.arange(0.02, 0.31, 0.02)
scores = [results.score(float(each)) for each in tolerances]

fig, ax = plt.subplots(figsize=(8, 4), layout="constrained")
ax.plot(1e3 * tolerances, [score.f1 for score in scores], "o-", label="waist-steps")
for name in scores[0].chance:
    ax.plot(1e3 * tolerances, [score.chance[name] for score in scores], "--", label=name)
ax.set(xlabel="tolerance [ms]", ylabel="F1", ylim=(0, 1))
ax.legend(loc="lower right")
