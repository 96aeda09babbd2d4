"""Lines of the log about interruptions."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from groundtrace_codecs.events import Gap
from groundtrace_codecs.signals import NS_PER_S
from groundtrace_viewers.rerun import decisions
from groundtrace_viewers.rerun.decisions import LossView


class Lines(list):
    def add(self, _: str, time_ns: int, text: str, level: str) -> None:
        self.append((time_ns / NS_PER_S, text, level))


@pytest.fixture
def view(monkeypatch: pytest.MonkeyPatch) -> LossView:
    def lane(*_: object) -> SimpleNamespace:
        return SimpleNamespace(add=lambda *_: None, flush=lambda *_: None)

    monkeypatch.setattr(decisions, "Lane", lane)
    timeline = SimpleNamespace(seconds=lambda time_ns: f"{time_ns / NS_PER_S:.2f} s")
    return LossView(SimpleNamespace(timeline=timeline, lines=Lines()))


def gap(start_s: float, lost: int, topic: str = "/imu", *, bridged: bool = True) -> Gap:
    start_ns = round(start_s * NS_PER_S)
    return Gap(topic, start_ns, start_ns + lost * 10_000_000, "missing", lost, bridged)


def test_filled_gaps_of_ten_seconds_are_one_line_and_others_one_each(view: LossView) -> None:
    for each in (gap(1.0, 1), gap(5.4, 2), gap(5.5, 40, bridged=False), gap(10.9, 3), gap(11.0, 1)):
        view.gap(each)
    view.gap(gap(12.5, 5, "/mag"))
    view.flush(round(12.9 * NS_PER_S))
    told = [
        (5.5, "5.50 s  missing /imu: 40 lost, 400.0 ms, state reset", "WARN"),
        (1.0, "1.00 s  missing /imu: 6 lost in 3 gaps within 9.9 s, filled, state kept", "INFO"),
    ]
    assert view._lines == told
    view.gap(Gap("/imu", 13 * NS_PER_S, 13 * NS_PER_S, "clock step", 0, bridged=True))
    step = (13.0, "13.00 s  clock step /imu: 0 lost, 0.0 ms, state kept", "WARN")
    assert view._lines.pop() == step
    view.flush()
    assert view._lines[2:] == [
        (11.0, "11.00 s  missing /imu: 1 lost, 10.0 ms, filled, state kept", "INFO"),
        (12.5, "12.50 s  missing /mag: 5 lost, 50.0 ms, filled, state kept", "INFO"),
    ]
