"""
A heading beside a magnet
=========================

The error of a heading against optical markers. A magnet lies on the sensor in the shaded span;
the dashed lines are where the replay saw it come and go.
"""

import numpy as np
from matplotlib import pyplot as plt

import groundtrace as gt

results = gt.replay("magnet", "heading")
truth = gt.open(gt.recordings.get("magnet")).truth
true = truth.kind == "heading"
there = np.interp(
    truth.time_s[true], results.headings.time_s, np.unwrap(results.headings.heading_rad)
)
error = np.angle(np.exp(1j * (there - truth.value[true])))

fig, ax = plt.subplots(figsize=(8, 4), layout="constrained")
ax.plot(truth.time_s[true], np.degrees(error))
for begin, end in zip(truth.time_s, truth.end_s, strict=True):
    if end > begin:
        ax.axvspan(begin, end, alpha=0.2, color="C1")
for found in (*results.disturbances.time_s, *results.disturbances.end_s):
    ax.axvline(found, ls="--", color="C3", lw=1)
ax.set(xlabel="time [s]", ylabel="error of the heading [deg]")
