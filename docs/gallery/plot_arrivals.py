"""
Arrivals of one step
====================

One step at nine geophones, 50 ms of it. Triangles are the arrivals, by comparing waveforms; the
wave comes later where the sensor is farther off.
"""

from matplotlib import pyplot as plt

import groundtrace as gt

recording = gt.open(gt.recordings.get("room-walk"))
results = gt.replay(recording, "room-footsteps")
begin = float(results.steps.time_s[5]) - 0.01
picks = results.picks
stream = recording[recording.streams[0].topic].read(begin, begin + 0.05)

fig, ax = plt.subplots(figsize=(8, 5), layout="constrained")
for row, name in enumerate(stream.channels):
    values = stream.values[:, row]
    ax.plot(1e3 * (stream.time_s - begin), row + 0.45 * values / abs(values).max(), lw=0.8)
    times = picks.time_s[(picks.channel == name) & (picks.stage == "arrivals")]
    near = times[(times >= begin) & (times < begin + 0.05)]
    ax.plot(1e3 * (near - begin), [row] * len(near), "v", color="black")
ax.set(xlabel="time [ms]", yticks=range(len(stream.channels)), yticklabels=stream.channels)
