"""
First breaks of a shot
======================

A hammer shot on a line of 24 geophones, each scaled to itself: first breaks as found, and as a
person picked them.
"""

from matplotlib import pyplot as plt

import groundtrace as gt

recording = gt.open(gt.recordings.get("shots"))
results = gt.replay(recording, "hammer-shots")
stream = recording[recording.streams[0].topic].read(0.0, 0.12)
truth = recording.truth

fig, ax = plt.subplots(figsize=(8, 6), layout="constrained")
for row, name in enumerate(stream.channels):
    values = stream.values[:, row]
    ax.plot(1e3 * stream.time_s, row + 0.8 * values / abs(values).max(), color="grey", lw=0.7)
    for table, mark, colour in ((results.picks, "|", "C0"), (truth, "x", "C3")):
        times = table.time_s[(table.channel == name) & (table.time_s < 0.12)]
        ax.plot(1e3 * times, [row] * len(times), mark, color=colour, ms=9)
ax.plot([], [], "|", color="C0", label="found")
ax.plot([], [], "x", color="C3", label="picked by hand")
ax.set(xlabel="time [ms]", yticks=range(len(stream.channels)), yticklabels=stream.channels)
ax.legend(loc="lower right")
