"""
A vehicle passes
================

Velocity at six geophones beside a road while a simulated car goes by. Lines are the passes that
the replay found, with two standard deviations of their time.
"""

from matplotlib import pyplot as plt

import groundtrace as gt

recording = gt.open(gt.recordings.get("vehicle-pass"))
results = gt.replay(recording, "vehicle-passes")
stream = recording[recording.streams[0].topic].read(0.0, recording.duration_s)

fig, axes = plt.subplots(len(stream.channels), 1, figsize=(8, 6), sharex=True, layout="constrained")
for ax, name, values in zip(axes, stream.channels, stream.values.T, strict=True):
    ax.plot(stream.time_s, 1e6 * values, lw=0.4, color="grey")
    ax.set_ylabel(name)
    for row in results.passes.rows():
        if row["station"] == name:
            ax.axvline(row["time_s"], color="C3")
            wide = 2 * row["sigma_s"]
            ax.axvspan(row["time_s"] - wide, row["time_s"] + wide, alpha=0.3, color="C3")
axes[0].set_title("Ground velocity [um/s] and passes")
axes[-1].set_xlabel("time [s]")
