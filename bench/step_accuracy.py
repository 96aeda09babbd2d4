"""Steps of real recordings through one named pipeline, with its defaults: the table of steps.md.

    python bench/step_accuracy.py --data FOLDER

The folder holds ``mobgap``, ``oxford-step`` and ``rieck-stepcounter`` as published; what is absent
is left out. Nothing is set but what the recordings say themselves.

Settings were chosen on these recordings (docs/accuracy.md).
"""

from __future__ import annotations

import argparse
import os
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy import ndimage, signal

from groundtrace.evaluation.matching import f1_of
from groundtrace.evaluation.steps import score_steps
from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import load_pipeline
from groundtrace.pipeline.engine import replay
from groundtrace.pipeline.source import Source
from groundtrace_codecs.events import Gap, StepEvent
from groundtrace_codecs.importers.run import import_recording
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S, SignalBlock, as_one
from groundtrace_recordings import map_path

#: A step is in a turn where the sensor turns faster than this, smoothed by this [rad/s, s].
TURN_RADPS, TURN_S = 0.6, 0.4
FORCE = {"acceleration", "acceleration_magnitude"}
PHONE = """format = "csv"
time = {column = 0, unit = "ns"}
[[stream]]
topic = "/acc/phone"
placement = "phone"
columns = [
  {column = 2, quantity = "acceleration", axis = "x", unit = "m/s2"},
  {column = 3, quantity = "acceleration", axis = "y", unit = "m/s2"},
  {column = 4, quantity = "acceleration", axis = "z", unit = "m/s2"},
]
"""


@dataclass(frozen=True)
class Walk:
    """A recording, read once."""

    items: tuple
    labels: tuple
    start_ns: int
    end_ns: int

    def steps(self, pipeline: str, placement: str = "", **parameters: object) -> np.ndarray:
        """Return the times of the steps that a named pipeline finds [ns].

        Where a placement is given, or parameters of its first stage, they are set.
        """
        config = load_pipeline(pipeline)
        topics = {item.topic for item in self.items if isinstance(item, SignalBlock)}
        placements = dict.fromkeys(topics, placement) if placement else {}
        first = replace(config.stage[0], parameters={**config.stage[0].parameters, **parameters})
        config = replace(config, placements=placements, stage=(first, *config.stage[1:]))
        sink = Steps()
        replay(self.items, build_pipeline(config), [sink])
        return np.array(sorted(sink.times), np.int64)

    def at(self, rate_hz: float) -> Walk:
        """Return the walk sampled more slowly, what would alias taken out before."""
        items: list[SignalBlock | Gap] = []
        for block in self.runs():
            stream = block.stream
            plain = tuple(replace(c, scale=1.0) for c in stream.channels)
            slower = replace(stream, rate_hz=rate_hz, channels=plain)
            if len(block) < stream.rate_hz:
                continue
            if items:
                items.append(Gap(stream.topic, items[-1].last_ns, block.start_ns, "missing", 1))
            picked = sampled(block.values, stream.rate_hz, rate_hz)
            items.append(SignalBlock(slower, block.start_ns, 0, picked))
        return replace(self, items=tuple(items))

    def runs(self) -> list[SignalBlock]:
        """Return the stretches without a gap that is not bridged."""
        stretches: list[list[SignalBlock]] = [[]]
        for item in self.items:
            if isinstance(item, SignalBlock):
                stretches[-1].append(item)
            elif not item.bridged:
                stretches.append([])
        return [as_one(parts) for parts in stretches if parts]

    def turning(self, times_ns: np.ndarray) -> np.ndarray:
        """Return at which times the sensor turns about the vertical, by its gyroscope."""
        turns = np.zeros(len(times_ns), bool)
        for block in self.runs():
            rate_hz = block.stream.rate_hz
            force, rate = (
                block.values[:, block.stream.columns_of({kind})]
                for kind in ("acceleration", "angular_velocity")
            )
            if rate.shape[1] < 3 or len(block) < rate_hz:
                continue
            mean = ndimage.gaussian_filter1d(force, rate_hz, axis=0, mode="nearest")
            about = (rate * mean).sum(axis=1) / np.sqrt((mean * mean).sum(axis=1))
            about = ndimage.gaussian_filter1d(about, TURN_S * rate_hz, mode="nearest")
            in_block = (times_ns >= block.start_ns) & (times_ns <= block.last_ns)
            turn_radps = np.interp(times_ns[in_block], block.sample_times(), np.abs(about))
            turns[in_block] = turn_radps > TURN_RADPS
        return turns


class Steps:
    """A sink that keeps the times of steps."""

    def __init__(self) -> None:
        self.times: list[int] = []

    def write(self, item: object) -> None:
        if isinstance(item, StepEvent):
            self.times.append(item.time_ns)


def sampled(values: np.ndarray, own_hz: float, rate_hz: float) -> np.ndarray:
    """Return samples, shape (n, channels), at a lower rate; what would alias is taken out."""
    edge = min(0.99, 1.1 * rate_hz / own_hz)
    slow = signal.sosfiltfilt(signal.cheby2(8, 40, edge, output="sos"), values, axis=0)
    at = np.arange(int(len(values) * rate_hz / own_hz)) * own_hz / rate_hz
    return np.column_stack([np.interp(at, np.arange(len(slow)), c) for c in slow.T])


def read(source: Path, columns: Path | str, truth: Path | None = None) -> Walk:
    """Import a recording, by a map or its text, and read its accelerometer."""
    text = columns if isinstance(columns, str) else columns.read_text()
    with tempfile.TemporaryDirectory() as folder:
        path, map_file = Path(folder) / "walk.mcap", Path(folder) / "map.toml"
        map_file.write_text(text.replace('"a.u."', '"count"'))  # a field that no step looks at
        import_recording([source], path, map_path=map_file, truth=truth)
        with Recording.open(path) as opened:
            topic = next(s.topic for s in opened.streams if s.columns_of(FORCE))
            items = tuple(Source(opened, topics=[topic]))
            return Walk(items, opened.labels, opened.start_ns, opened.end_ns)


def lower_back(folder: Path, pipeline: str) -> None:
    """Initial contacts inside walking bouts, at the recorded rate and below."""
    print("lower back (mobgap): F1 of initial contacts inside bouts, chance in brackets")
    for path in sorted(folder.glob("*/*/data.mat")):
        walk = read(path, map_path("mobgap-test11.toml"))
        for rate_hz in (None, 30.0, 10.0, 6.0):
            step_ns = (walk if rate_hz is None else walk.at(rate_hz)).steps(pipeline)
            ends = (walk.labels, step_ns, walk.start_ns, walk.end_ns)
            wide, narrow = (score_steps(*ends, tolerance) for tolerance in (0.25, 0.12))
            print(
                f"  {path.parent.parent.name}/{path.parent.name} "
                f"{'100 Hz' if rate_hz is None else f'{rate_hz:g} Hz':>6}: "
                f"{wide.f1:.3f} at 0.25 s ({wide.chance_f1_metronome:.2f}), "
                f"{narrow.f1:.3f} at 0.12 s ({narrow.chance_f1_metronome:.2f}), "
                f"{narrow.detected} of {narrow.truth}, latency {narrow.latency_ms.median:+.0f} ms"
            )


def references(folder: Path, pipeline: str) -> None:
    """What the two references of the same walks say of each other and of the steps found."""
    print("lower back (mobgap), insoles / optical: F1 at 0.25 s and 0.12 s, latency")
    map_text = map_path("mobgap-test11.toml").read_text()
    for path in sorted(folder.glob("*/*/data.mat")):
        for test in ("Test11.Trial1", "Test5.Trial1", "Test5.Trial2"):
            plain = map_text.replace("Test11.Trial1", test)
            insoles, optical = (
                read(path, plain.replace("INDIP", name)) for name in ("INDIP", "Stereophoto")
            )
            step_ns = insoles.steps(pipeline)
            print(
                f"  {path.parent.parent.name} {test:13}: {_both(insoles, step_ns)} / "
                f"{_both(optical, step_ns)}; optical by insoles "
                f"{_both(insoles, _contacts(optical))}"
            )


def _contacts(walk: Walk) -> np.ndarray:
    return np.array([x.time_ns for x in walk.labels if x.kind == "step"], np.int64)


def _both(walk: Walk, step_ns: np.ndarray) -> str:
    ends = (walk.labels, step_ns, walk.start_ns, walk.end_ns)
    wide, narrow = (score_steps(*ends, tolerance) for tolerance in (0.25, 0.12))
    return f"{wide.f1:.3f} {narrow.f1:.3f} {wide.latency_ms.median:+.0f} ms"


def carried(folder: Path, pipeline: str) -> None:
    """Counts of phones carried in six ways, and F1 against the counted instants."""
    print("phone (oxford-step validation): count, F1 at 0.25 s")
    errors = []
    for path in sorted((folder / "validation").glob("*.csv")):
        walk = read(path, map_path("oxford-step-validation.toml"))
        step_ns = walk.steps(pipeline)
        true = _contacts(walk)
        origin = walk.start_ns
        f1 = f1_of((true - origin) / NS_PER_S, (step_ns - origin) / NS_PER_S, 0.25)
        errors.append(abs(len(step_ns) / len(true) - 1))
        print(f"  {path.stem.split('_')[1]:12} {len(step_ns)} of {len(true)}, F1 {f1:.3f}")
    if errors:
        print(f"  mean count error {100 * np.mean(errors):.2f} %")


def optimised(folder: Path, pipeline: str) -> None:
    """Counts of the recordings with foot switches."""
    print("phone (oxford-step optimisation): count")
    table = folder / "optimisation" / "stats.csv"
    rows = [x.split(",") for x in table.read_text().splitlines()[1:]] if table.is_file() else []
    with tempfile.TemporaryDirectory() as scratch:
        phone = Path(scratch) / "phone.toml"
        phone.write_text(PHONE)
        for name, true in ((row[0].strip(), int(row[-1])) for row in rows):
            path = table.parent / name / "accelerometer.csv"
            if path.is_file():
                print(f"  {name:36} {len(read(path, phone).steps(pipeline))} of {true}")


def on_wrist(folder: Path, pipeline: str) -> None:
    """Counts while walking, and false steps while not."""
    print("wrist (rieck-stepcounter, 25 Hz magnitude in counts): count")
    by_kind: dict[str, list[tuple[int, int]]] = {}
    seconds = 0.0
    for path in sorted(folder.glob("l2-25hz-bw4/*.csv")):
        walk = read(path, map_path("rieck-stepcounter.toml"))
        true = next((round(x.value) for x in walk.labels if x.kind == "count"), 0)
        kind = path.stem.rstrip("0123456789")
        by_kind.setdefault(kind, []).append((len(walk.steps(pipeline)), true))
        seconds += 0 if "walking" in kind else (walk.end_ns - walk.start_ns) / NS_PER_S
    for kind, pairs in by_kind.items():
        print(f"  {kind:16} {', '.join(f'{n} of {true}' for n, true in pairs)}")
    walking = np.array([p for kind, pairs in by_kind.items() if "walking" in kind for p in pairs])
    idle = [p for kind, pairs in by_kind.items() if "walking" not in kind for p in pairs]
    if len(walking) and idle:
        false = sum(max(0, n - true) for n, true in idle)
        print(
            f"  walking {walking[:, 0].sum()} of {walking[:, 1].sum()} "
            f"({100 * (walking[:, 0].sum() / walking[:, 1].sum() - 1):+.1f} %); "
            f"false {false} in {seconds / 60:.0f} min"
        )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pipeline", default="waist-steps")
    parser.add_argument(
        "--data", type=Path, default=Path(os.environ.get("GROUNDTRACE_DATA", "../shared/data"))
    )
    options = parser.parse_args()
    lower_back(options.data / "mobgap", options.pipeline)
    references(options.data / "mobgap", options.pipeline)
    carried(options.data / "oxford-step", options.pipeline)
    optimised(options.data / "oxford-step", options.pipeline)
    on_wrist(options.data / "rieck-stepcounter", options.pipeline)


if __name__ == "__main__":
    main()
