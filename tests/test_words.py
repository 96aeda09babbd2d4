"""Phrases that were replaced by plain ones do not come back: docs, code, help, errors."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDERS = ("docs", "codecs", "replay", "viewers", "recordings")
SUFFIXES = {".md", ".py", ".toml", ".json", ".jinja", ".js"}
PHRASES = """
--resume goes on after anything
1 files by mat, 1 settings, 1 notes
A replay of hours that was stopped goes on with --resume
And when places are off
Decisions come at most 12.1 s after the step
Have a recording of another tool? Say what its columns are in a map
Leave out what is done already
Made-up feet whose places are known
Make no viewer's file but the one of --rrd
No recording of a real vehicle was at hand
Say what a recording holds
Say what of a damaged recording can be read
Score a result against the truth, with the level of chance beside it
Take no notice of known places of impacts
Take the last action of --author back
Tell what a layout of sensors can do
The rhythm is followed
Try so many random settings of those ranges
Turn files of another tool into a recording
Two levels of chance stand beside each score, because a generous tolerance flatters anything
What can be read of a torn file is read, and what could not be is counted
What it reaches / does not reach
What was chosen on what
Who annotates. Not the name of the system's user, which is not kept
a floor that calibrates itself
a viewer's file of every gate's values
are named likewise
at its loudest 3.1 dB over the noise
by the steps in both
come onto one clock
finds that step and gives just these figures
has the last word
how sure that is
how well a layout of sensors will locate
is on the safe side
name no folder, user or machine
no single change does it
nobody seems to walk
on the disk before the page says so
rooms that nobody tuned for
say what cannot be told
says of each figure whether it became better
says what the recording cannot tell
single places lie on a curve
stands still inside its signal
taken in by annotate --merge
the filter takes it out
the gate that hid a vehicle
the gate that set it apart
there is no moment to time
tries all 323 combinations at once, without the signal
turn the order of arrivals round
were not searched
what is not reached
where one more would help most
where they differ is listed
whether chance explains as much
which station hears one
wrong signs, regions that are mistaken for others
"""


def plain(text: str) -> str:
    """Return a text without line breaks, marks of comments and strings, and backticks."""
    joined = re.sub(r'"\s*\n\s*f?"', "", text)
    return re.sub(r"[\s#`]+", " ", joined).lower()


def test_no_phrase_of_the_list_remains() -> None:
    phrases = [plain(line) for line in PHRASES.strip().splitlines()]
    assert len(phrases) > 50
    pages = [ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
    pages += [p for f in FOLDERS for p in (ROOT / f).rglob("*") if p.suffix in SUFFIXES]
    found = []
    for page in pages:
        text = plain(page.read_text("utf-8"))
        found += [f"{page.relative_to(ROOT)}: {each}" for each in phrases if each in text]
    assert not found, "\n".join(found)


def test_a_phrase_is_found_over_lines_and_strings() -> None:
    assert "how sure that is" in plain('"how sure "\n    "that is"')
    assert "the law" in plain("The\n# law")
