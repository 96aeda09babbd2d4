"""Moments that are worth every sample: steps, and steps that were missed or are false.

They are found while the replay goes on, from the truth and what has been detected some seconds
behind the signal, so that memory does not grow with the recording.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from .full_rate import REACH_NS
from .lanes import Lane
from .palette import SPAN
from .verdict import verdicts

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from groundtrace.sinks import Session

    from .details import Details
    from .full_rate import Plan
    from .signals import SignalLog
    from .timeline import Timeline
    from .traces import Traces

#: Steps are matched to the truth with so much of both around them [ns].
MARGIN_NS = NS_PER_S
#: How often moments are looked for [ns], while nobody watches.
EVERY_NS = 2 * NS_PER_S
#: Moments this close to each other are one [ns].
SAME_NS = NS_PER_S // 20
#: Close-ups at the beginning may take this part of what all may: the rest is spread over time.
AT_ONCE = 0.25
LANE = "/state/8-full-rate"


class Moments:
    """Finds the moments of a session as its steps come.

    Parameters
    ----------
    plan
        What is shown at full rate.
    session
        Gives the truth.
    lag_ns
        Steps may come this long after their signal [ns].
    """

    def __init__(self, plan: Plan, session: Session, lag_ns: int) -> None:
        self._plan = plan
        self._lag_ns = lag_ns
        self._every_ns = min(EVERY_NS, lag_ns)
        steps = sorted(x for x in session.labels if x.kind == "step")
        self._true, self._true_ns = steps, [x.time_ns for x in steps]
        spans = tuple(x for x in session.labels if x.kind in ("walking", "ignore"))
        self._session = replace(session, labels=spans)
        self._steps: list[int] = []
        self._late: list[int] = []
        self._reached_ns = (session.shown_ns or (session.start_ns, 0))[0]
        self._passed = 0
        self._judged = False

    def judge(self) -> None:
        """Say that a stage detects steps, which can be missed."""
        self._judged = bool(self._true)

    def step(self, time_ns: int) -> None:
        """Take a detected step."""
        if time_ns < self._reached_ns:
            self._late.append(time_ns)
        else:
            self._steps.append(time_ns)

    def passed(self, last_ns: int) -> list[int]:
        """Return the true steps that the signal has come past since this was asked before."""
        first, self._passed = self._passed, bisect_right(self._true_ns, last_ns)
        return self._true_ns[first : self._passed]

    def ready(self, last_ns: int | None) -> list[int]:
        """Return the moments that can be told now that the signal came so far; None is the end."""
        if last_ns is None:
            until = max([self._reached_ns, *self._steps, *self._true_ns[: self._passed][-1:]]) + 1
        else:
            until = last_ns - self._lag_ns
            if until - self._reached_ns < self._every_ns:
                return []
        found = self._between(self._reached_ns, until)
        late = self._late if self._chosen("step") else []
        self._reached_ns, self._late = until, []
        self._steps = [t for t in self._steps if t >= until - MARGIN_NS]
        return _apart(sorted([*late, *found]))

    def _between(self, start_ns: int, end_ns: int) -> list[int]:
        """Return the moments of a half-open span."""
        if not self._judged:
            steps = self._steps if self._chosen("step") else []
            return [t for t in steps if start_ns <= t < end_ns]
        reach = start_ns - MARGIN_NS, end_ns + MARGIN_NS
        first, last = bisect_left(self._true_ns, reach[0]), bisect_left(self._true_ns, reach[1])
        labels = (*self._session.labels, *self._true[first:last])
        near = [t for t in self._steps if reach[0] <= t < reach[1]]
        found = verdicts(replace(self._session, labels=labels), near, reach)
        judged = [one.time_ns for one in found if self._chosen(one.verdict)]
        steps = near if self._chosen("step") else []
        return [t for t in (*judged, *steps) if start_ns <= t < end_ns]

    def _chosen(self, what: str) -> bool:
        """Whether something is a moment; without a judgement events stand for misses."""
        mode = self._plan.mode
        if what == "step":
            return mode in ("all", "span", "events") or (mode == "misses" and not self._judged)
        return what == "missed" or (what == "false" and mode == "misses")


def _apart(moments: Iterable[int]) -> list[int]:
    """Return moments without those that follow another at once."""
    kept: list[int] = []
    for time_ns in moments:
        if not kept or time_ns - kept[-1] >= SAME_NS:
            kept.append(time_ns)
    return kept


class CloseUps:
    """Shows every sample around moments.

    Parameters
    ----------
    timeline
        Where to.
    plan
        What is shown at full rate.
    session
        What is replayed.
    lag_ns
        Steps may come this long after their signal [ns].

    Attributes
    ----------
    shown, left_out
        Number of moments that have their samples, and that would have taken too much.
    """

    def __init__(self, timeline: Timeline, plan: Plan, session: Session, lag_ns: int) -> None:
        self.moments = Moments(plan, session, lag_ns)
        self.shown = self.left_out = 0
        self._plan = plan
        self._lane = Lane(timeline, LANE, {"every sample": SPAN})
        self._span_ns = session.shown_ns or (session.start_ns, session.end_ns + 1)
        self._shown_to_ns = self._span_ns[0]
        self._spent_bytes = 0.0

    def show(
        self,
        last_ns: int | None,
        signals: Mapping[str, SignalLog],
        traces: Traces,
        details: Details,
    ) -> None:
        """Show what can be told now that the signal came so far; None is the end."""
        if self._plan.mode == "none":
            return
        if last_ns is not None:
            for time_ns in self.moments.passed(last_ns):
                details.expect(time_ns)
        for time_ns in self.moments.ready(last_ns):
            if not self._plan.close_ups or self._show_around(time_ns, signals, traces):
                details.near(time_ns)
        self._lane.flush(None if last_ns is None else self._shown_to_ns - 2 * REACH_NS)

    def words(self) -> str:
        """Return what is shown at full rate."""
        plan = self._plan
        if not plan.close_ups:
            return plan.shown
        count = f"{self.shown} of {self.shown + self.left_out}" if self.left_out else self.shown
        return f"every sample around {count} {plan.subject}"

    def _show_around(self, time_ns: int, signals: Mapping[str, SignalLog], traces: Traces) -> bool:
        """Show the samples around a moment, unless they would take too much."""
        start_ns = max(time_ns - REACH_NS, self._shown_to_ns)
        end_ns = min(time_ns + REACH_NS, self._span_ns[1])
        cost = max(0, end_ns - start_ns) / NS_PER_S * self._plan.second_bytes
        if self._spent_bytes + cost > self._allowed(time_ns):
            self.left_out += 1
            return False
        self.shown += 1
        if start_ns < end_ns:
            self._spent_bytes += cost
            self._shown_to_ns = end_ns
            self._lane.add(start_ns, "every sample", end_ns)
            for topic, log in signals.items():
                log.close_up(traces.between(topic, start_ns, end_ns))
        return True

    def _allowed(self, time_ns: int) -> float:
        """Return what close-ups up to a time may take: the recording's end gets its part."""
        if self._plan.mode == "events":
            return np.inf
        start_ns, end_ns = self._span_ns
        elapsed = (time_ns - start_ns) / max(1, end_ns - start_ns)
        return self._plan.budget_bytes * max(AT_ONCE, min(1.0, elapsed))
