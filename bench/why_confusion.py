"""Which cause `why` names where one is planted: the confusion matrix of docs/accuracy/why.md.

    python bench/why_confusion.py [--rounds 5] [--half development|report|both] [--only CELL]

Recordings are simulated at waist, wrist, in rooms and on a line of geophones, each with one cause
planted at one step, pick or place; all else in it is clean. A plant counts where the replay without
it is right at that moment, the replay with it is not, and where a cause is a setting, such as a
threshold, another setting finds the step again; else it had no effect, and is drawn anew. The
recordings of even seeds served to mend reasons, those of odd seeds did not: both shares are
printed, with every recording that is off the diagonal. Exit status 1 where less than 95 % of
the latter are on it.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import zlib
from collections import Counter
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import planted as plants
from planted import Clean, Planted, Take

from groundtrace.evaluation.picks import ANSWER_S, RIGHT_S, pick_residuals
from groundtrace.explain.reasons import StepReasons, accepted_picks
from groundtrace.explain.sweep import in_processes
from groundtrace.explain.unfiltered import with_recording
from groundtrace.explain.why_picks import pick_account
from groundtrace.explain.why_places import PlaceExplainer
from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import load_pipeline, parse_pipeline, with_settings
from groundtrace.pipeline.engine import EventList, replay
from groundtrace.pipeline.results import Provenance, Results, evidence_of, step_times
from groundtrace.pipeline.source import Source
from groundtrace_codecs.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from groundtrace.explain.why_places import FixAccount, PlaceAccount
    from groundtrace.pipeline.results import Evidence, StageEvidence
    from groundtrace_codecs.events import Pick

    Plant = Callable[[Clean, np.random.Generator], Planted | None]

WANTED = 0.95
TOLERANCE_S = 0.12
#: A plant without effect is drawn again so often, in so many recordings.
DRAWS, RECORDINGS = 3, 16
#: Places of onsets as they were picked: an array method would mend wrong picks by the others.
ONSETS = b"""
name = "room-onsets"
application = "room"
[[stage]]
name = "picks"
use = "toa-cv"
[[stage]]
name = "steps"
use = "coincidence"
[[stage]]
use = "hyperbolic"
[[stage]]
use = "power-law"
"""
#: Arrivals of each channel of a line on its own: what gates say of them.
ARRIVALS = b"""
name = "line-arrivals"
application = "shots"
[[stage]]
name = "picks"
use = "sta-lta"
[stage.parameters]
ratio = 8.0
"""


@dataclass(frozen=True)
class Cell:
    """One cause on one kind of recording; ``asked`` is what ``why --kind`` takes."""

    scene: str
    asked: str
    cause: str
    pipeline: str
    base: Callable[[int], Take]
    plant: Plant
    settings: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Scene, question and cause."""
        return f"{self.scene}, {self.asked}, {self.cause}, {self.plant_name}"

    @property
    def plant_name(self) -> str:
        """Name of the function that plants."""
        inner = self.plant.func if isinstance(self.plant, partial) else self.plant
        return inner.__name__


@dataclass(frozen=True)
class Outcome:
    """What was planted and what was named; empty where no plant had an effect."""

    cell: Cell
    seed: int
    planted: str
    named: str
    text: str
    in_vain: int


PEAKS_OPEN = ("steps.height=0.05", "steps.swing=0", "steps.activity=0", "steps.refractory_s=0")
SCORE_OPEN = ("steps.score=0", "steps.apart=0")
RHYTHM_OPEN = ("steps.swing=0", "steps.share=0", "steps.dominance=0", "steps.rhythm=0")
#: Without a filter to speak of: the recordings have 100 Hz.
UNFILTERED = ("steps.cutoff_hz=40", "steps.refractory_s=0")


def _of_a_walker(scene: str, pipeline: str, placement: str, gates: tuple[str, ...]) -> list[Cell]:
    level = gates[0].removeprefix("steps.").partition("=")[0]
    base = partial(plants.walk, placement=placement)
    causes: list[tuple[str, Plant]] = [
        ("timing", plants.shifted_truth),
        ("timing", plants.late_recording),
        ("threshold", partial(plants.soft_step, opened=gates, gate=level)),
        ("dead", plants.held_value),
        ("clipped", partial(plants.small_range, gate=level)),
        ("gap", plants.hole),
        ("quiet", partial(plants.nobody, tight=gates)),
        ("taken", plants.doubled_truth),
    ]
    return [Cell(scene, "steps", cause, pipeline, base, plant) for cause, plant in causes]


def _peaks() -> list[Cell]:
    """Return what only a detector with these gates, and a filter to be taken out, can be asked."""
    base = partial(plants.walk, placement="waist")
    close = partial(plants.close_steps, opened=("steps.refractory_s=0",))
    lonely = partial(plants.lonely_step, opened=("steps.activity=0",))
    shake = partial(plants.fast_shake, opened=UNFILTERED, tight=PEAKS_OPEN)
    of = partial(Cell, "waist, peaks", "steps")
    return [
        of("refractory", "waist-peaks", base, close),
        of("walking", "waist-peaks", base, lonely, ("steps.activity=0.6",)),
        of("filter", "waist-peaks", base, shake),
        of("shape", "waist-peaks", base, partial(plants.lift, tight=PEAKS_OPEN)),
    ]


def _rooms() -> list[Cell]:
    steps: list[tuple[str, Plant]] = [
        ("timing", plants.shifted_truth),
        ("timing", plants.late_recording),
        ("threshold", plants.soft_footfall),
        ("coincidence", plants.few_channels),
        ("refractory", plants.second_footfall),
        ("filter", plants.slow_heave),
        ("dead", plants.dead_channels),
        ("clipped", plants.overdriven_channels),
        ("gap", plants.hole),
        ("quiet", plants.no_footfall),
        ("taken", plants.doubled_truth),
    ]
    picks: list[tuple[str, Plant]] = [
        ("late", plants.late_arrival),
        ("early", plants.knock_before),
        ("clock", plants.late_clock),
        ("latency", plants.by_hand),
        ("threshold", plants.weak_arrival),
        ("refractory", plants.held_off),
        ("filter", plants.heaved_channel),
        ("dead", plants.dead_channel),
        ("clipped", plants.overdriven_channel),
        ("gap", plants.hole_at_arrival),
        ("quiet", plants.no_arrival),
        ("shape", plants.swelling_channel),
        ("false", plants.knock_elsewhere),
    ]
    fixes: list[tuple[str, Plant]] = [
        ("position", plants.displaced_sensor),
        ("swapped", plants.swapped_sensors),
        ("clock", plants.sensor_clock),
        ("late", plants.late_at_place),
        ("early", plants.early_at_place),
        ("clipped", plants.overdriven_at_place),
        ("dead", plants.dead_at_place),
        ("arrivals", plants.weak_at_place),
        ("gate", plants.narrow_gate),
        ("model", plants.wrong_velocity),
        ("together", plants.scattered_arrivals),
    ]
    return [
        *(Cell("room", "steps", cause, "room-steps", plants.room, plant) for cause, plant in steps),
        *(Cell("room", "picks", cause, "room-steps", plants.room, plant) for cause, plant in picks),
        *(
            Cell("room", "fixes", cause, "", plants.room_for_places, plant)
            for cause, plant in fixes
        ),
    ]


def _lines() -> list[Cell]:
    """Causes of single channels by a picker of single channels, others by first breaks."""
    alone: list[tuple[str, Plant]] = [
        ("late", plants.late_arrival),
        ("early", plants.knock_before),
        ("clock", plants.late_clock),
        ("threshold", plants.weak_arrival),
        ("refractory", plants.second_shot),
        ("clipped", plants.overdriven_channel),
    ]
    together: list[tuple[str, Plant]] = [
        ("latency", plants.by_hand),
        ("dead", plants.dead_channel),
        ("gap", plants.hole_at_arrival),
    ]
    return [
        Cell("line", "picks", cause, pipeline, plants.line, plant)
        for pipeline, causes in (("hammer-shots", together), ("line-arrivals", alone))
        for cause, plant in causes
    ]


def cells() -> list[Cell]:
    """Return every cause on every kind of recording."""
    return [
        *_of_a_walker("waist, peaks", "waist-peaks", "waist", PEAKS_OPEN),
        *_peaks(),
        *_of_a_walker("waist", "waist-steps", "waist", SCORE_OPEN),
        *_of_a_walker("wrist", "waist-steps", "wrist", RHYTHM_OPEN),
        *_rooms(),
        *_lines(),
    ]


def replayed(cell: Cell, take: Take, path: Path, settings: Sequence[str] = ()) -> Evidence:
    """Write a recording, replay it, and return what a results file would hold."""
    take.write(path)
    pipeline_text = {"": ONSETS, "line-arrivals": ARRIVALS}.get(cell.pipeline)
    pipeline = (
        load_pipeline(cell.pipeline)
        if pipeline_text is None
        else parse_pipeline(pipeline_text, "own")
    )
    config = with_settings(pipeline, [*cell.settings, *settings])
    with Recording.open(path) as recording:
        chain = build_pipeline(config, recording.geometry, recording.labels)
        sink = EventList()
        replay(Source(recording), chain, [sink])
        times = (recording.start_ns, recording.end_ns)
        origin = Provenance(path.name, "", *times, chain.recipe())
        events = tuple(sink.events)
        results = Results(path.name, origin, recording.labels, recording.geometry, events)
        return with_recording(evidence_of(results), "", [path])


def clean_of(cell: Cell, take: Take, path: Path) -> Clean:
    """Replay a take without a plant.

    At the wrist a step is found at the arm's peak, 0.1 to 0.2 s after the foot's contact: there
    the truth is moved by the median of that, since it stands for a recording that is right.
    """
    evidence = replayed(cell, take, path)
    if cell.scene == "wrist":
        true_ns = np.array([x.time_ns for x in take.steps()])
        found_ns = step_times(evidence)
        if len(found_ns):
            late_ns = [found_ns[np.abs(found_ns - t).argmin()] - t for t in true_ns]
            later = int(np.median(late_ns))
            take.labels = [replace(x, time_ns=x.time_ns + later) for x in take.labels]
            evidence = replace(evidence, labels=tuple(sorted(take.labels)))
    matching = StepReasons(evidence, TOLERANCE_S).matching
    pairs = matching.pairs
    truth, detected = matching.truth_ns[pairs[:, 0]], matching.found_ns[pairs[:, 1]]
    return Clean(take, dict(zip(truth.tolist(), detected.tolist(), strict=True)), evidence)


def named_step(evidence: Evidence, planted: Planted) -> tuple[str, str]:
    """Return the cause named of a true step, and the text; ``right`` where it is found."""
    reasons = StepReasons(evidence, TOLERANCE_S)
    missed = reasons.matching.truth_ns[reasons.matching.missed].tolist()
    if planted.time_ns not in missed:
        return "right", ""
    reason = reasons.at(planted.time_ns)
    return reason.cause, reason.text


def named_pick(evidence: Evidence, planted: Planted) -> tuple[str, str]:
    """Return the cause named of a true arrival, or of a false pick."""
    at_s = (planted.time_ns - evidence.start_ns) / 1e9
    for bad in pick_account(evidence).bad:
        false = bad.state == "false"
        if false != (planted.expected == "false"):
            continue
        reach_s = 0.03 if false else 1e-6
        if bad.channel == planted.channel and abs(bad.time_s - at_s) <= reach_s:
            return bad.reason.cause, bad.reason.text
    return "right", ""


def located_by(cell: Cell) -> str:
    """Return the localizer that is asked: one that knows a velocity, where that is planted."""
    return "hyperbolic" if cell.cause == "model" else "power-law"


def named_place(
    evidence: Evidence, planted: Planted, stage: str, *, of_sensor: bool
) -> tuple[str, str]:
    """Return the cause named of a sensor, or of the place of a step."""
    account = PlaceExplainer(evidence, 1.0, stage).account()
    if of_sensor and account.sensors:
        return _of_sensors(account, planted.channel)
    at_s = (planted.time_ns - evidence.start_ns) / 1e9
    near = [fix for fix in account.bad if abs(fix.time_s - at_s) < 0.1]
    if of_sensor:
        causes = Counter(_cause(fix)[0] for fix in account.bad)
        return (causes.most_common(1)[0][0], "no sensor is named") if causes else ("right", "")
    if not near:
        return "right", ""
    cause, text, channel = _cause(near[0])
    if planted.channel and cause in ("late", "early") and channel != planted.channel:
        return f"{cause} elsewhere", text
    return cause, text


def _cause(fix: FixAccount) -> tuple[str, str, str]:
    cause = fix.cause
    return ("none", "", "") if cause is None else (cause.cause, cause.text, cause.channel)


def _of_sensors(account: PlaceAccount, channel: str) -> tuple[str, str]:
    """Return what is named of a sensor; what is wrongly named of another goes before."""
    of_channel = [s for s in account.sensors if s.channel == channel]
    text = "; ".join(f"{s.channel} {s.cause}: {s.text}" for s in account.sensors)
    if not of_channel:
        return "another sensor", text
    swapped = "swapped" in of_channel[0].text
    if len(account.sensors) > 1 + swapped:
        return "several sensors", text
    return "swapped" if swapped else of_channel[0].cause, text


def named(cell: Cell, evidence: Evidence, planted: Planted) -> tuple[str, str]:
    """Return what is named where the cause was planted."""
    if cell.asked == "steps":
        return named_step(evidence, planted)
    if cell.asked == "picks":
        return named_pick(evidence, planted)
    of_sensor = cell.cause in ("position", "swapped", "clock")
    return named_place(evidence, planted, located_by(cell), of_sensor=of_sensor)


def tried(cell: Cell, clean: Clean, planted: Planted, path: Path) -> tuple[str, str] | None:
    """Return what is named, or None where the plant is not what hides the step."""
    expected = planted.expected or cell.cause
    evidence = replayed(cell, planted.take, path, planted.settings)
    verdict = named(cell, evidence, planted)
    if expected == "right":
        return verdict
    if verdict[0] == "right" or not _right_without(cell, clean, planted, path):
        return None
    if not _acts(evidence, planted):
        return None
    for settings, wanted in ((planted.opened, True), (planted.tight, False)):
        if settings is not None:
            again = replayed(cell, planted.take, path, [*planted.settings, *settings])
            if _is_found(cell, again, planted) != wanted:
                return None
    return verdict


def _state(evidence: Evidence, planted: Planted) -> str:
    """Return what became of the pick of an arrival, by the score alone."""
    answers = pick_residuals(evidence.labels, _picks(evidence))
    states = answers.states()
    return next(
        state
        for label, state in zip(answers.truth, states, strict=True)
        if label.channel == planted.channel and label.time_ns == planted.time_ns
    )


def _acts(evidence: Evidence, planted: Planted) -> bool:
    """Whether the pick became what the plant wants, by the score and the candidates alone."""
    if planted.state == "early":
        return _picked_before(evidence, planted)
    if planted.state == "unseen":
        seen = any(_has_candidate(part, planted) for part in evidence.stages)
        return _is_above_floor(evidence, planted) and not seen
    return not planted.state or _state(evidence, planted) == planted.state


def _is_above_floor(evidence: Evidence, planted: Planted) -> bool:
    """Whether the decision function is above the floor in the frame of an arrival."""
    part = next(part for part in evidence.stages if part.spec.trace)
    frame = int(np.searchsorted(part.frames.time_ns, planted.time_ns, side="right")) - 1
    channel = part.spec.channels.index(planted.channel)
    return bool(part.frames.value[frame, channel, 0] > evidence.config.stage[0].parameters["floor"])


def _has_candidate(part: StageEvidence, planted: Planted) -> bool:
    """Whether a stage has a candidate within 50 ms of an arrival on its channel."""
    reach_ns = round(ANSWER_S * 1e9)
    rows = part.between(planted.time_ns - reach_ns, planted.time_ns + reach_ns)
    names = [part.spec.channels[c] for c in part.candidates.channel[rows]]
    return part.spec.emits == "pick" and planted.channel in names


def _picked_before(evidence: Evidence, planted: Planted) -> bool:
    """Whether something 2 to 50 ms before an arrival is picked on its channel."""
    early_s = [
        (planted.time_ns - pick.time_ns) / 1e9
        for pick in _picks(evidence)
        if pick.channel == planted.channel
    ]
    return any(RIGHT_S < x <= ANSWER_S for x in early_s)


def _picks(evidence: Evidence) -> list[Pick]:
    """Return the picks of the last stage that picks."""
    parts = [part for part in evidence.stages if part.spec.emits == "pick"]
    return [
        x for part in parts if part.spec.stage == parts[-1].spec.stage for x in accepted_picks(part)
    ]


def _is_found(cell: Cell, evidence: Evidence, planted: Planted) -> bool:
    """Whether a step is found, or an arrival picked in time.

    What a filter takes out of a slow rise is picked later without it: there any pick will do.
    """
    if cell.asked == "picks" and cell.cause == "filter":
        return _state(evidence, planted) != "missed"
    ask = named_step if cell.asked == "steps" else named_pick
    return ask(evidence, planted)[0] == "right"


def _right_without(cell: Cell, clean: Clean, planted: Planted, path: Path) -> bool:
    """Whether the same is right in the recording without the plant."""
    if cell.asked == "steps":
        if not planted.settings:
            return True  # it is one of the steps that are found
        again = replayed(cell, clean.take, path, planted.settings)
        matching = StepReasons(again, TOLERANCE_S).matching
        found_ns = matching.truth_ns[matching.pairs[:, 0]].tolist()
        return (planted.origin_ns or planted.time_ns) in found_ns
    if cell.asked == "picks":
        return named_pick(clean.evidence, planted)[0] == "right"
    if cell.cause == "model":
        return named_place(clean.evidence, planted, located_by(cell), of_sensor=False)[0] == "right"
    return True  # only recordings whose every place is right are planted in


def _is_clean(clean: Clean) -> bool:
    """Whether all places and all picks of a recording are right, and no sensor is blamed."""
    account = PlaceExplainer(clean.evidence, 1.0, "power-law").account()
    return not (account.bad or account.sensors or pick_account(clean.evidence).bad)


def outcome(task: tuple[int, int]) -> Outcome:
    """Plant one cell's cause in a recording of one seed."""
    number, seed = task
    cell = cells()[number]
    rng = np.random.default_rng([seed, zlib.crc32(cell.name.encode())])
    in_vain = 0
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "planted.mcap"
        for _ in range(RECORDINGS):
            # of one parity, so that the halves share no recording
            clean = clean_of(cell, cell.base(2 * int(rng.integers(1, 10_000)) + seed % 2), path)
            if cell.asked == "fixes" and not _is_clean(clean):
                continue
            for _ in range(DRAWS):
                planted = cell.plant(clean, rng)
                verdict = None if planted is None else tried(cell, clean, planted, path)
                if planted is not None and verdict is not None:
                    return Outcome(cell, seed, planted.expected or cell.cause, *verdict, in_vain)
                in_vain += planted is not None
    return Outcome(cell, seed, cell.cause, "", "", in_vain)


def matrix(outcomes: Sequence[Outcome], *, markdown: bool) -> None:
    """Print causes planted against causes named, question by question."""
    for asked in ("steps", "picks", "fixes"):
        selected = [o for o in outcomes if o.cell.asked == asked and o.named]
        counts = Counter((o.planted, o.named) for o in selected)
        rows = list(dict.fromkeys(o.planted for o in selected))
        columns = [*rows, *sorted({o.named for o in selected} - set(rows))]
        print(f"\n{asked}: planted (rows) and named (columns)\n")
        cells_ = [["planted", *columns, "right"]]
        for row in rows:
            line = [counts[row, column] for column in columns]
            planted = [o for o in selected if o.planted == row]
            cells_.append([row, *(str(n) if n else "" for n in line), share_of(planted)])
        _table(cells_, markdown=markdown)


def share_of(outcomes: Sequence[Outcome]) -> str:
    """Return how many are named as they were planted."""
    return f"{sum(o.named == o.planted for o in outcomes)} of {len(outcomes)}"


def _table(rows: list[list[str]], *, markdown: bool) -> None:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    for number, row in enumerate(rows):
        line = [text.ljust(width) for text, width in zip(row, widths, strict=True)]
        print("| " + " | ".join(line) + " |" if markdown else "  ".join(line).rstrip())
        if markdown and number == 0:
            print("|" + "|".join("-" * (width + 2) for width in widths) + "|")


def told(half: str, outcomes: Sequence[Outcome], *, markdown: bool) -> float:
    """Print one half's matrix, what is off its diagonal, and its share; return that."""
    judged = [o for o in outcomes if o.named]
    right = sum(o.named == o.planted for o in judged)
    print(f"\n{half}: {right} of {len(judged)} named right ({100 * right / len(judged):.1f} %)")
    misses = [o for o in judged if o.planted != "right"]
    print(f"of those, without timing errors inside the tolerance: {share_of(misses)}")
    scenes = dict.fromkeys(o.cell.scene.partition(",")[0] for o in judged)
    for scene in scenes:
        selected = [o for o in judged if o.cell.scene.partition(",")[0] == scene]
        print(f"  {scene}: {share_of(selected)}")
    print(f"{sum(o.in_vain for o in outcomes)} plants had no effect and were drawn again")
    for o in outcomes:
        if not o.named:
            print(f"  no plant had an effect: {o.cell.name}, seed {o.seed}, {o.in_vain} drawn")
    matrix(judged, markdown=markdown)
    for o in judged:
        if o.named != o.planted:
            print(f"  {o.cell.name}, seed {o.seed}: {o.planted} was called {o.named}: {o.text}")
    return right / len(judged)


def main() -> int:
    """Print the matrices of the halves."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5, help="recordings of each cell and half")
    parser.add_argument("--half", choices=("development", "report", "both"), default="both")
    parser.add_argument("--only", default="", help="cells whose name contains this")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--markdown", action="store_true")
    options = parser.parse_args()
    shares = {}
    for half, parity in (("development", 0), ("report", 1)):
        if options.half not in (half, "both"):
            continue
        tasks = [
            (number, 2 * k + parity)
            for number, cell in enumerate(cells())
            if options.only in cell.name
            for k in range(options.rounds)
        ]
        outcomes = in_processes(outcome, tasks, options.jobs, lambda: None)
        shares[half] = told(half, outcomes, markdown=options.markdown)
    return int(shares.get("report", 1.0) < WANTED)


if __name__ == "__main__":
    sys.exit(main())
