"""
Steps in a room
===============

Places of 20 simulated steps, located by the arrivals at nine geophones, with the true places and
the track.
"""

from matplotlib import pyplot as plt

import groundtrace as gt

results = gt.replay("room-walk", "room-footsteps")
truth = gt.open(gt.recordings.get("room-walk")).truth
steps = truth.kind == "step"
track = results.tracks

fig, ax = plt.subplots(figsize=(6, 5), layout="constrained")
for method in dict.fromkeys(results.fixes.method):
    chosen = results.fixes.method == method
    ax.plot(results.fixes.x_m[chosen], results.fixes.y_m[chosen], ".", label=method)
ax.plot(track.x_m, track.y_m, "-", lw=1, color="grey", label="track")
ax.plot(truth.x_m[steps], truth.y_m[steps], "x", color="black", label="true")
ax.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
ax.legend(fontsize=8)
