"""The page that says what is shown and how to read it."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from groundtrace.sinks import Session
    from groundtrace_codecs.signals import Stream

PAGE = "/about"

_READING = """\
## How to read it

* Time runs from the recording's first sample. Plots share one time axis: drag to pan, scroll to \
zoom, double-click to see everything. Click in a plot or on a line of the log to move the cursor; \
the waveform at the cursor follows it.
* Envelopes are the largest |x| of each bucket, so that no impact is lost: per 10 ms; in \
recordings longer than a minute per 50 ms, with 10 ms and the whole recording in the tabs beside. \
Spectrograms: time to the right, frequency upwards, lighter is louder.
* Samples of fast signals that are not everywhere are where the lane `full-rate` says; there the \
decision functions and the spectrogram of 3 ms are too. Elsewhere those plots are empty: \
everything is in the recording, and `groundtrace replay --full-rate FROM-TO` shows another part.
* One colour per sensor, in every plot but the section, and on the map. A sensor lights up when \
a wave arrives; at a step its name says how long after the first arrival, and is grey where it has \
none. Triangles on the map are shot points.
* Lines across the room part regions with the same order of distances to the sensors. At a step \
those are lit whose signs differ least from the measured ones; the page Signs says which signs do.
* At stations of three axes: rays on the map point where a step's wave came from, with one sigma \
to either side. Hodograms: motion from the station's arrival on, from above (x–y, with the bearing \
in white) and from the side (r–z: away from the source, and up), one scale for both.
* A yellow line joins two places of one step that localizers disagree about.
* Places found are points on the map, of the last three seconds, a colour for each stage; the key \
is above the site. The line about the newest is its one-sigma ellipse.
* Tracks are lines that grow: filtered as the fixes came (light green, with the walker now and its \
one-sigma ellipse), and smoothed by what came later (orange); of several tracks each has its own \
colours, and of several walkers each true path.
* Detector: the decision function of every channel, the threshold in red, accepted candidates as \
green triangles, rejected ones as grey crosses. The plot of a ratio is cut at four thresholds, \
since its peaks reach thousands; candidates beyond lie at its upper edge. Below the samples around \
the cursor is the same at every sample, 0.1 s before to 0.1 s after each step, found or missed. \
Rejected candidates below half the threshold are in the results alone.
* Walkers: the detector's plot has its filtered signal at every sample, with accepted peaks as \
green triangles, their valleys as blue ones, and rejected ones as red crosses. Masses: what each \
sensor, and both combined, believe of each candidate; the three add up to one.
* Headings are drawn with the full turn that is nearest to the truth, or without jumps where there \
is none. The shade is where a stage finds the field disturbed; the truth's own spans are a lane.
* The way of a walker: truth, waypoints, satellite fixes in metres from the first, tracks. Up is \
north where the arrow says so; elsewhere a track's direction is free, and the truth is turned and \
shifted onto the last track, as the key then says: distances between the two are then no errors.
* Spectrogram at steps: 0.5 s before to 0.5 s after each, down to 45 dB below the loudest.
* Section (shots): every trace is scaled to its own maximum within the shot and swings about the \
number of its channel. Green dots are picks, violet crosses hand picks or computed arrivals. \
The next tab has true amplitudes.
* Picks come from the last stage that picks; those of stages before it are its candidates.
* Lanes: what each stage decided, and for a rejected candidate the first gate that failed; \
`places` has what stages that say where rejected, and where they disagree. \
`truth` lanes come from the recording's labels. `score`: a step that was hit, missed or false, \
within 0.12 s; the log has a line for every missed (ERROR) and false (WARN) one.
* A curve that ends abruptly ends at a gap.
"""

_VEHICLES = """\
## How to read it

* Time runs from the recording's first sample. Plots share one time axis: drag to pan, scroll to \
zoom, double-click to see everything. Click in a plot or on a line of the log to move the cursor.
* One colour per sensor, in every plot and on the map. Truth is violet everywhere.
* Map: the road is grey, its signs point forward. The image is the log-likelihood of the vehicle's \
place in the cycle: the lightest is likeliest, clear what is less likely by 9 or more. Crosses are \
places of single cycles in the last 12 s, a colour for each stage (key above), the lines about the \
newest one-sigma ellipses. Dashed: courses through all cycles of a vehicle (key below); they are \
known when it has gone, and drawn at the times they are of. The last stage's is green and broader, \
with the vehicle now and its ellipse. Green dots: lines crossed, at the map's side when and how \
fast.
* Power: over the noise floor, one value a cycle and channel, the threshold in red.
* θ of A2 / A1 is (r of A2 / r of A1)ⁿ by the ratio of powers, in dB, 0 where both distances are \
alike; a colour for each estimator, the bar is one theoretical standard deviation to either side. \
Estimators of a cycle stand 0.06 s beside each other. Violet: what true distances give by the law.
* Way along the road: dots are passes of stations in the sensors' colours, grey crosses those that \
no vehicle has, red ones those that were missed. A line is a vehicle; its steepness is its speed.
* Lanes: `truth` and `passes` by direction along the road, each vehicle from its first station to \
its last, with its speed; `presence`: when any channel hears a vehicle, or which gate says that \
what is loud is none; `places`: the cycles that gave no place, and why; one lane for each stage of \
courses; `score`: passes that were hit, missed or false, within a second.
* Spectrograms: time to the right, frequency upwards, lighter is louder.
* A curve that ends abruptly ends at a gap.
"""


def _names(stream: Stream) -> str:
    names = [c.name for c in stream.channels]
    return ", ".join(names) if len(names) <= 10 else f"{names[0]} … {names[-1]} ({len(names)})"


def about(session: Session) -> str:
    """Return the page as markdown."""
    rows = "\n".join(
        f"| `{s.topic}` | {_names(s)} | {s.rate_hz:g} Hz"
        f"{' (irregular)' if s.irregular else ''} "
        f"| {', '.join(dict.fromkeys(c.unit for c in s.channels))} |"
        for s in session.streams
    )
    reading = _VEHICLES if session.application == "vehicle" else _READING
    duration_s = (session.end_ns - session.start_ns) / 1e9
    return (
        f"# {session.name}\n\n{duration_s:.1f} s, {len(session.labels)} labels.\n\n"
        f"| stream | channels | rate | unit |\n|---|---|---|---|\n{rows}\n\n"
        f"{reading}\n## Pipeline\n\n```toml\n{session.pipeline.strip()}\n```\n"
    )
