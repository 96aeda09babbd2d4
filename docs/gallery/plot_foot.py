"""
A loop on foot
==============

An IMU on the foot, integrated between the times at which the foot stands. The loop ends 8 cm from
where it began.
"""

from matplotlib import pyplot as plt

import groundtrace as gt

track = gt.replay("foot", "foot-inertial").tracks
smoothed = track.stage == "track.smoothed"
x, y = track.x_m[smoothed], track.y_m[smoothed]

fig, ax = plt.subplots(figsize=(7, 5), layout="constrained")
ax.plot(x, y, "-")
ax.plot(x[0], y[0], "o", label="begin")
ax.plot(x[-1], y[-1], "s", label="end")
ax.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
ax.legend()
