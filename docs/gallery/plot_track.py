"""
A walk through a building
=========================

The track of a phone in the hand by steps, step lengths and headings, from the first waypoint on,
and the 20 waypoints that the walker marked.
"""

from matplotlib import pyplot as plt

import groundtrace as gt

results = gt.replay("phone-indoor", "pedestrian-waypoints")
truth = gt.open(gt.recordings.get("phone-indoor")).truth
way = truth.kind == "waypoint"

fig, ax = plt.subplots(figsize=(9, 3), layout="constrained")
smoothed = results.tracks.stage == "track.smoothed"
ax.plot(results.tracks.x_m[smoothed], results.tracks.y_m[smoothed], "-", label="track")
ax.plot(truth.x_m[way], truth.y_m[way], "x", color="black", label="waypoints")
ax.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
ax.legend()
