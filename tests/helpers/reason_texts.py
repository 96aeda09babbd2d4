"""What a reason's sentence claims, parsed out of it and held against the evidence.

Every clause of every text must be one that is known here: a new one needs its own check.
"""

# ruff: noqa: ARG002  (all checks of clauses are called alike)

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace.evaluation.matching import step_reach_s
from groundtrace.pipeline.plugins import stage_named
from groundtrace_codecs.signals import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable

    from groundtrace.explain.reasons import Reason, StepReasons
    from groundtrace.pipeline.results import Evidence, StageEvidence

NUMBER = r"(-?[\d.]+(?:e[+-]?\d+)?|-?inf)"
OFF = rf"{NUMBER} ms (late|early)"
UNIT = r"(?: (m/s2|rad/s|deg|s))?"
GATE = (
    rf"(\w+) {NUMBER}{UNIT} ([<>]) {NUMBER}{UNIT} \(margin {NUMBER}\)|"
    rf"(\w+) is no number, the threshold is {NUMBER}{UNIT}"
)
FILTERED = r"attenuated by the filter \(change the band and replay\)"
CHANNELS = ("G1", "G2", "G3", "G4")


@dataclass
class Claims:
    """The claims of one reason, and what they are about."""

    reasons: StepReasons
    reason: Reason
    time_ns: int

    @property
    def evidence(self) -> Evidence:
        return self.reasons.evidence

    @property
    def final(self) -> StageEvidence:
        return [p for p in self.evidence.stages if p.spec.emits == "step"][-1]

    @property
    def within_ns(self) -> int:
        return round(self.reasons.tolerance_s * NS_PER_S)

    def check(self) -> None:
        """Raise AssertionError at the first claim that is not so."""
        text = self.reason.text
        heads = (
            (r"no candidate within (\S+) ms: ", self.nothing_within),
            (r"no group of picks within (\S+) ms: ", self.nothing_within),
            (r"no channel was picked: ", self.nothing_picked),
            (r"picked on (\d+) of (\d+) channels needed(?:: |$)", self.too_few),
            (r"no walking detected: ", lambda: None),
            (rf"{FILTERED}: without it a candidate {OFF} passes every threshold "
             rf"\((\w+) {NUMBER}{UNIT}\); ", self.filtered),
            (rf"{FILTERED}: without it (\d+) channels pick it {OFF}; ", self.group_filtered),
        )  # fmt: skip
        while head := next((h for h in heads if re.match(h[0], text)), None):
            found = re.match(head[0], text)
            head[1](*found.groups())
            text = text[found.end() :]
        for clause in filter(None, text.split("; ")):
            self.clause(clause)

    def clause(self, clause: str) -> None:
        channel = next((c for c in CHANNELS if clause.startswith(f"{c} ")), "")
        clause = clause.removeprefix(f"{channel} ")
        part, number = self.final, 0
        if channel:
            part = next(p for p in self.evidence.stages if p.spec.emits == "pick")
            number = part.spec.channels.index(channel)
        for pattern, check in self.known():
            found = re.fullmatch(pattern, clause)
            if found:
                check(part, number, *found.groups())
                return
        raise AssertionError(f"no check for: {clause!r} of {self.reason.text!r}")

    def known(self) -> tuple[tuple[str, Callable[..., None]], ...]:
        return (
            (rf"found {OFF}, tolerance {NUMBER} ms", self.found),
            (rf"a candidate {OFF} is rejected: (.*)", self.rejected),
            (rf"a candidate {OFF} \(tolerance {NUMBER} ms\), which (.*) rejects too", self.beyond),
            (GATE, self.gate),
            (rf"vertical {NUMBER} and forward {NUMBER} of a usual step", self.of_usual),
            (rf"the signal is heard from {NUMBER} to {NUMBER} s, and (\w+) is told by "
             rf"{NUMBER} s or more",
             self.cut_short),
            (r"(\w+(?: and \w+)*) would fail too", self.also),
            (rf"merged with the step {NUMBER} ms earlier by the refractory gate \({NUMBER} ms\)",
             self.merged),
            (rf"its detection at {NUMBER} s answers step (\d+)", self.taken),
            (rf"the detection {OFF} answers step (\d+)", self.taken_off),
            (rf"the signal never rose above the floor: (\w+) reached {NUMBER}{UNIT}, "
             rf"floor {NUMBER}{UNIT}", self.below_floor),
            (rf"the signal never rose above the floor but for the candidate {OFF}: "
             rf"(\w+) reached {NUMBER}{UNIT}, floor {NUMBER}{UNIT}", self.below_floor_but),
            (rf"(\w+) reached {NUMBER}{UNIT} in a frame of \d+ ms there, above the floor of "
             rf"{NUMBER}{UNIT}, but without (.*)",
             self.above_floor),
            (rf"(\w+) reached {NUMBER}{UNIT}, not (.*)", self.not_sought),
            (rf"the nearest candidate comes {OFF}", self.nearest),
            (r"there is no candidate at all", self.none_at_all),
            (rf"is dead: the signal stands still for {NUMBER} of {NUMBER} ms", self.dead),
            (rf"is clipped for {NUMBER} ms of a frame", self.clipped),
            (rf"no signal from {NUMBER} to {NUMBER} s: ([\w ]+), (\d+) samples", self.gap),
            (rf"no signal from {NUMBER} to {NUMBER} s: missing, (\d+) samples, "
             r"straight lines in their place", self.filled),
            (rf"no signal: ([\w ]+) at {NUMBER} s", self.step_of_clock),
            (r"no signal was recorded", self.unrecorded),
            (rf"was picked \+?{NUMBER} ms from it, in another group", self.elsewhere),
            (rf"{NUMBER} dB over its noise as recorded, {NUMBER} dB after the filter: "
             r"it takes the recording to tell whether the filter took a step out "
             r"\(why --recording\)", self.levels),
            (rf"{NUMBER} dB over its noise as recorded, {NUMBER} dB after the filter", self.levels),
        )  # fmt: skip

    # -- what the sentences say ---------------------------------------------------------------

    def filtered(self, off_ms: str, _: str, name: str, value: str, unit: str | None) -> None:
        assert self.reason.cause == "filter"
        assert self.evidence.unfiltered.at_hand
        assert float(off_ms) <= self.reasons.tolerance_s * 1e3 + 0.5
        gates = {g.name: g.threshold for g in self.final.spec.gates}
        assert float(value) >= gates.get(name, -np.inf)

    def group_filtered(self, channels: str, off_ms: str, _: str) -> None:
        assert self.reason.cause == "filter"
        assert self.evidence.unfiltered.at_hand
        assert float(off_ms) <= self.reasons.tolerance_s * 1e3 + 0.5
        assert int(channels) >= self.final.spec.gates[0].threshold

    def off_ns(self, off_ms: str, way: str) -> float:
        return float(off_ms) * 1e6 * (1 if way == "late" else -1)

    def at(self, part: StageEvidence, off_ms: str, way: str) -> list[int]:
        """Return the candidates that are as late as a text says, to its last digit."""
        digits = len(off_ms.partition(".")[2])
        late = part.candidates.time_ns - self.time_ns
        near = np.abs(late - self.off_ns(off_ms, way)) <= 0.5 * 10 ** (6 - digits) + 1
        return np.flatnonzero(near).tolist()

    def rows(self, part: StageEvidence, channel: int | None = None) -> list[int]:
        near = part.between(self.time_ns - self.within_ns, self.time_ns + self.within_ns)
        return [r for r in near if channel is None or part.candidates.channel[r] == channel]

    def tolerance_is(self, tolerance_ms: str) -> None:
        assert abs(float(tolerance_ms) - self.reasons.tolerance_s * 1e3) < 1e-3

    def nothing_within(self, tolerance_ms: str) -> None:
        self.tolerance_is(tolerance_ms)
        self.no_candidate()

    def no_candidate(self) -> None:
        """No candidate may lie within the tolerance, nor one of its own within the reach."""
        assert not self.rows(self.final)
        truth = self.reasons.matching.truth_ns
        seconds = (truth - self.evidence.start_ns) / NS_PER_S
        at = np.array([(self.time_ns - self.evidence.start_ns) / NS_PER_S])
        reach = round(float(step_reach_s(seconds, at)[0]) * NS_PER_S)
        others = truth[truth != self.time_ns]
        said_nothing = self.reason.cause in ("gap", "dead")  # a rejected one says nothing there
        times, accepted = self.final.candidates.time_ns, self.final.accepted
        for time_ns in times[accepted] if said_nothing else times:
            own = abs(int(time_ns) - self.time_ns)
            assert own > reach or (np.abs(others - time_ns) < own).any()

    def nothing_picked(self) -> None:
        self.no_candidate()
        part = next(p for p in self.evidence.stages if p.spec.emits == "pick")
        assert not [r for r in self.rows(part) if part.accepted[r]]

    def too_few(self, picked: str, needed: str) -> None:
        assert int(picked) < int(needed)
        assert len(self.reason.channels) == len(CHANNELS) - int(picked)

    def found(self, part: StageEvidence, _: int, off_ms: str, way: str, tolerance_ms: str) -> None:
        self.tolerance_is(tolerance_ms)
        assert float(off_ms) > float(tolerance_ms)
        times = [part.candidates.time_ns[r] for r in self.at(part, off_ms, way) if part.accepted[r]]
        assert times
        right = self.reasons.matching.found_ns[self.reasons.matching.pairs[:, 1]]
        assert not np.isin(times, right).any()

    def rejected(self, part: StageEvidence, _: int, off_ms: str, way: str, gate: str) -> None:
        rows = [r for r in self.at(part, off_ms, way) if not part.accepted[r]]
        assert set(rows) & set(self.rows(part))
        self.clause(gate)

    def beyond(
        self, part: StageEvidence, _: int, off_ms: str, way: str, tolerance_ms: str, gate: str
    ) -> None:
        self.tolerance_is(tolerance_ms)
        assert float(off_ms) > float(tolerance_ms)
        assert [r for r in self.at(part, off_ms, way) if not part.accepted[r]]
        assert not self.rows(part)
        parsed = re.fullmatch(GATE, gate)
        assert parsed
        self.numbers(*parsed.groups())

    def gate(self, part: StageEvidence, channel: int, *numbers: str | None) -> None:
        self.numbers(*numbers)
        name = numbers[0] or numbers[7]
        index = [g.name for g in part.spec.gates].index(name)
        unit = numbers[2] if numbers[0] else numbers[9]
        assert (unit or "1") == part.spec.gates[index].unit
        only = channel if part.spec.emits == "pick" else None
        near = self.rows(part, only)
        assert any(not part.margin[r, index] >= 0 for r in near)

    def numbers(
        self,
        name: str | None,
        value: str | None = None,
        unit: str | None = None,
        sign: str | None = None,
        threshold: str | None = None,
        _: str | None = None,
        margin: str | None = None,
        *none: str | None,
    ) -> None:
        """A value, a sign, a threshold and a margin must fit each other."""
        if name is None:
            return
        a, b = float(value), float(threshold)
        assert a < b if sign == "<" else a > b
        rough = 0.006 * abs(float(margin)) + 6e-4 * max(abs(a), abs(b)) + 1e-9
        assert abs(abs(a - b) - abs(float(margin))) <= rough

    def of_usual(self, part: StageEvidence, _: int, vertical: str, forward: str) -> None:
        names = [column.name for column in part.spec.columns]
        shares = [names.index("vertical"), names.index("forward")]
        told = [float(vertical), float(forward)]
        near = [part.candidates.value[row, shares] for row in self.rows(part)]
        assert any(np.allclose(value, told, atol=0.006, rtol=1e-3) for value in near)

    def cut_short(
        self, part: StageEvidence, _: int, begin_s: str, end_s: str, gate: str, need_s: str
    ) -> None:
        start_ns, told = self.evidence.start_ns, (float(begin_s), float(end_s))
        assert told[1] - told[0] < float(need_s)
        assert gate in [g.name for g in part.spec.gates]
        gaps = [g for g in self.evidence.gaps if not g.bridged]
        ends_s = [0.0, *((g.end_ns - start_ns) / NS_PER_S for g in gaps)]
        starts_s = [(g.start_ns - start_ns) / NS_PER_S for g in gaps]
        assert min(abs(x - told[0]) for x in ends_s) < 1e-3
        assert min(abs(x - told[1]) for x in starts_s) < 1e-3

    def also(self, part: StageEvidence, _: int, names: str) -> None:
        gates = [g.name for g in part.spec.gates]
        for name in names.split(" and "):
            index = gates.index(name)
            assert any(not part.margin[r, index] >= 0 for r in self.rows(part))

    def merged(self, part: StageEvidence, _: int, since_ms: str, least_ms: str) -> None:
        assert float(since_ms) < float(least_ms)
        times = part.candidates.time_ns
        rough = 6e-3 * float(since_ms) * 1e6 + 1e3
        befores = [times[r] - float(since_ms) * 1e6 for r in self.rows(part)]
        accepted = times[part.accepted]
        assert any((np.abs(accepted - before) <= rough).any() for before in befores)

    def taken(self, part: StageEvidence, _: int, at_s: str, step: str) -> None:
        time_ns = self.evidence.start_ns + float(at_s) * NS_PER_S
        rows = [r for r in self.rows(part) if part.accepted[r]]
        assert any(abs(part.candidates.time_ns[r] - time_ns) <= 5.1e5 for r in rows)
        self.answers(int(step), time_ns)

    def taken_off(self, part: StageEvidence, _: int, off_ms: str, way: str, step: str) -> None:
        assert any(part.accepted[r] for r in self.at(part, off_ms, way))
        assert any(pair.step == int(step) for pair in self.reasons.pairs)

    def answers(self, step: int, time_ns: float) -> None:
        true_ns = int(self.reasons.matching.truth_ns[step - 1])
        assert true_ns != self.time_ns
        assert abs(true_ns - time_ns) <= self.within_ns + 1e6

    def floor(self, part: StageEvidence) -> float:
        stage = next(s for s in self.evidence.config.stage if s.key == part.spec.stage)
        floors = getattr(stage_named(stage.use), "floors", {})
        return float(floors.get(part.spec.trace[0].name, stage.parameters["floor"]))

    def top(
        self, part: StageEvidence, channel: int, name: str, reached: str, unit: str | None
    ) -> None:
        """The decision function reached that in a frame nearby, a filter's delay later at most."""
        first = part.spec.trace[0]
        assert (name, unit or "1") == (first.name, first.unit)
        late = part.frames.time_ns - self.time_ns
        near = (late >= -self.within_ns - 3e8) & (late <= self.within_ns + 1.1e9)
        values = part.frames.value[near, channel, 0].astype(np.float64)
        assert np.isclose(values, float(reached), rtol=6e-3, atol=1e-9).any()

    def below_floor(
        self, part: StageEvidence, channel: int, name: str, reached: str, unit: str | None,
        floor: str, _: str | None,
    ) -> None:  # fmt: skip
        self.top(part, channel, name, reached, unit)
        assert float(reached) <= float(floor)
        assert np.isclose(float(floor), self.floor(part), rtol=1e-2)
        assert not self.rows(part, channel)

    def below_floor_but(
        self, part: StageEvidence, channel: int, off_ms: str, way: str, name: str, reached: str,
        unit: str | None, floor: str, _: str | None,
    ) -> None:  # fmt: skip
        self.below_floor(part, channel, name, reached, unit, floor, _)
        own = [r for r in self.at(part, off_ms, way) if part.candidates.channel[r] == channel]
        assert any(part.candidates.value[r, 0] > self.floor(part) for r in own)

    def above_floor(
        self, part: StageEvidence, channel: int, name: str, reached: str, unit: str | None,
        floor: str, _: str | None, sought: str,
    ) -> None:  # fmt: skip
        self.top(part, channel, name, reached, unit)
        assert float(reached) > float(floor)
        assert np.isclose(float(floor), self.floor(part), rtol=1e-2)
        assert not self.rows(part, channel)
        assert self.reason.cause != "quiet" or part.spec.emits == "pick"

    def not_sought(
        self,
        part: StageEvidence,
        channel: int,
        name: str,
        reached: str,
        unit: str | None,
        sought: str,
    ) -> None:
        self.top(part, channel, name, reached, unit)
        assert not self.rows(part, channel)

    def nearest(self, part: StageEvidence, _: int, off_ms: str, way: str) -> None:
        nearest = np.abs(part.candidates.time_ns - self.time_ns).min()
        assert abs(nearest - float(off_ms) * 1e6) <= 5.1e5
        assert self.at(part, off_ms, way)

    def none_at_all(self, part: StageEvidence, _: int) -> None:
        assert not len(part.candidates)

    def dead(self, part: StageEvidence, _: int, still_ms: str, span_ms: str) -> None:
        asked_ms = 2e3 * self.reasons.tolerance_s
        assert float(still_ms) <= float(span_ms) + 1
        assert float(still_ms) + 1 >= 0.5 * min(float(span_ms), asked_ms)

    def clipped(self, part: StageEvidence, _: int, clipped_ms: str) -> None:
        assert 0 <= float(clipped_ms) <= 51
        index = [q.name for q in part.spec.trace].index("flat")
        near = np.abs(part.frames.time_ns - self.time_ns) <= self.within_ns + 5e7
        flats = part.frames.value[near][:, :, index].ravel() * 1e3
        assert (np.abs(flats[flats > 0] - float(clipped_ms)) <= 0.51).any()

    def gap(
        self, part: StageEvidence, _: int, start_s: str, end_s: str, reason: str, lost: str
    ) -> None:
        start_ns, end_ns = (self.evidence.start_ns + float(t) * NS_PER_S for t in (start_s, end_s))
        assert start_ns - 1e6 <= self.time_ns + self.within_ns
        assert end_ns + 1e6 >= self.time_ns - self.within_ns
        assert any(
            (g.reason, g.lost, g.bridged) == (reason, int(lost), False)
            and abs(g.start_ns - start_ns) < 1e6
            and g.topic in (part.spec.topic, "")
            for g in self.evidence.gaps
        )

    def filled(self, part: StageEvidence, _: int, start_s: str, end_s: str, lost: str) -> None:
        start, end = self.time_ns - self.within_ns, self.time_ns + self.within_ns
        topics = (part.spec.topic, "")
        near = [
            g
            for g in self.evidence.gaps
            if g.topic in topics and g.start_ns <= end and g.end_ns >= start
        ]
        assert all(g.bridged for g in near)
        near = [g for g in near if g.reason == "missing"]
        told_ns = [self.evidence.start_ns + float(t) * NS_PER_S for t in (start_s, end_s)]
        assert abs(min(g.start_ns for g in near) - told_ns[0]) < 1e6
        assert abs(max(g.end_ns for g in near) - told_ns[1]) < 1e6
        assert sum(g.lost for g in near) == int(lost)
        taken = sum(min(g.end_ns, end) - max(g.start_ns, start) for g in near)
        assert 2 * taken >= end - start

    def step_of_clock(self, part: StageEvidence, _: int, reason: str, at_s: str) -> None:
        at_ns = self.evidence.start_ns + float(at_s) * NS_PER_S
        assert abs(at_ns - self.time_ns) <= self.within_ns + 1e6
        assert any(g.reason == reason and not g.bridged for g in self.evidence.gaps)

    def unrecorded(self, part: StageEvidence, _: int) -> None:
        times = part.frames.time_ns
        overlapping = (times > self.time_ns - self.within_ns - 5e7) & (
            times <= self.time_ns + self.within_ns
        )
        assert not overlapping.any()

    def elsewhere(self, part: StageEvidence, channel: int, off_ms: str) -> None:
        rows = [r for r in self.rows(part, channel) if part.accepted[r]]
        late = [(int(part.candidates.time_ns[r]) - self.time_ns) / 1e6 for r in rows]
        assert any(abs(ms - float(off_ms)) <= 0.51 for ms in late)

    def levels(self, part: StageEvidence, _: int, recorded: str, filtered: str) -> None:
        assert float(recorded) >= 12 - 0.51
        assert float(recorded) - float(filtered) >= 6 - 1.01
