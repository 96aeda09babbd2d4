"""
Candidates and their margins
============================

Every candidate of a replay keeps the value of every gate. Those right of both lines became steps.
"""

from matplotlib import pyplot as plt

import groundtrace as gt

results = gt.replay("lower-back", "waist-steps")
table = results.candidates[0]

fig, ax = plt.subplots(figsize=(8, 4), layout="constrained")
for accepted, label in ((True, "accepted"), (False, "rejected")):
    chosen = table.accepted == accepted
    ax.plot(table.score[chosen], table.apart[chosen], "o", alpha=0.6, label=label)
parameters = results.pipeline.parameters
ax.axvline(parameters["steps.score"], color="black", lw=1)
ax.axhline(parameters["steps.apart"], color="black", lw=1)
ax.set(xlabel="score", ylabel="apart [step times]", title="Two gates of 106 candidates")
ax.legend()
