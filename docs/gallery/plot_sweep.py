"""
Missed against false steps
==========================

A sweep decides stored candidates again for every setting, without the signal. Each point is one
threshold.
"""

import numpy as np
from matplotlib import pyplot as plt

import groundtrace as gt

results = gt.replay("lower-back", "waist-steps")
thresholds = [float(each) for each in np.linspace(0.05, 0.95, 19)]
counts = [gt.sweep(results, {"steps.score": [each]}).document["best"] for each in thresholds]
print(gt.sweep(results, {"steps.score": thresholds}).best)

fig, ax = plt.subplots(figsize=(8, 4), layout="constrained")
ax.plot(thresholds, [each["fn"] for each in counts], "o-", label="missed")
ax.plot(thresholds, [each["fp"] for each in counts], "s-", label="false")
ax.set(xlabel="threshold of score", ylabel="steps")
ax.legend()
