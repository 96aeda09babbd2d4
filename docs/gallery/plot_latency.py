"""
A detector that is early
========================

The error of each step that was found, on a phone in the hand. The middle of the errors is a
constant offset, and no gate can mend it.
"""

import numpy as np
from matplotlib import pyplot as plt

import groundtrace as gt

results = gt.replay("phone-hand", "waist-steps")
truth = gt.open(gt.recordings.get("phone-hand")).truth
true_s = truth.time_s[truth.kind == "step"]
nearest = true_s[np.abs(true_s[:, None] - results.steps.time_s).argmin(axis=0)]
error_ms = 1e3 * (results.steps.time_s - nearest)

fig, ax = plt.subplots(figsize=(8, 4), layout="constrained")
ax.hist(error_ms, bins=np.arange(-300, 301, 20))
ax.axvline(0, color="black", lw=1)
ax.axvline(np.median(error_ms), color="C3", label=f"median {np.median(error_ms):.0f} ms")
ax.set(xlabel="step found minus step true [ms]", ylabel="steps")
ax.legend()
