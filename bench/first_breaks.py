"""First breaks of shots on a line: errors, claimed uncertainty, and the simplest rivals.

Hand picks of the two lines of refrapy-seg2 (``--data``), and arrivals of simulated lines drawn from
seeds 1001 on, on which nothing was chosen. Rivals: Akaike's criterion of variances over each whole
trace (plain AIC), over the first 0.15 s, and up to the trace's largest sample. Errors are those of
all arrivals of truth; an arrival without a pick counts as missed, and as 1 s off.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import tempfile
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import load_pipeline
from groundtrace.pipeline.engine import EventList, replay
from groundtrace.pipeline.source import Source
from groundtrace.simulate.line import LineOptions, simulate_line
from groundtrace.simulate.recording import write
from groundtrace_codecs import Recording
from groundtrace_codecs.events import Label, Note, Pick
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

LINES = ("field_example_01", "field_example_02")
EDGE = 3


@dataclass(frozen=True)
class Errors:
    """Of all arrivals: error [s] and claimed uncertainty [s], and the rivals' errors.

    ``told`` has of each shot how late its trigger was said to be, at least, and is [s].
    """

    error_s: np.ndarray
    sigma_s: np.ndarray
    rivals: dict[str, np.ndarray]
    told: tuple[tuple[float, float], ...] = ()

    @classmethod
    def joined(cls, parts: list[Errors]) -> Errors:
        """Put several recordings together."""
        names = parts[0].rivals
        return cls(
            np.concatenate([p.error_s for p in parts]),
            np.concatenate([p.sigma_s for p in parts]),
            {name: np.concatenate([p.rivals[name] for p in parts]) for name in names},
            tuple(t for p in parts for t in p.told),
        )


def least_aic(x: np.ndarray) -> float:
    """Return where k ln var(x[:k]) + (n - k) ln var(x[k:]) is least, in plain numpy."""
    n = len(x)
    if n < 2 * EDGE + 3 or not np.ptp(x):
        return float("nan")
    x = x - x[0]
    k = np.arange(EDGE + 1, n - EDGE)
    one, two = np.cumsum(x), np.cumsum(x * x)
    before = two[k - 1] / k - (one[k - 1] / k) ** 2
    after = (two[-1] - two[k - 1]) / (n - k) - ((one[-1] - one[k - 1]) / (n - k)) ** 2
    least = 1e-12 * max(float(before.max()), float(after.max()), 1e-300)
    criterion = k * np.log(np.maximum(before, least)) + (n - k) * np.log(np.maximum(after, least))
    return float(k[np.argmin(criterion)])


def rivals(trace: np.ndarray, rate_hz: float) -> dict[str, float]:
    """Return the onsets of the rivals [s after the first sample]."""
    peak = int(np.abs(trace - np.median(trace)).argmax()) + 1
    ends = {"plain AIC": len(trace), "AIC, 0.15 s": round(0.15 * rate_hz), "AIC to peak": peak}
    return {name: least_aic(trace[:end]) / rate_hz for name, end in ends.items()}


def errors_of(path: Path, settings: tuple[str, ...] = ()) -> Errors:
    """Replay a recording, and compare its picks and those of rivals with the truth."""
    from groundtrace.pipeline.config import with_settings

    with Recording.open(path) as recording:
        config = with_settings(load_pipeline("hammer-shots"), settings)
        chain, sink = build_pipeline(config, recording.geometry, recording.labels), EventList()
        replay(Source(recording), chain, [sink])
        runs = _runs([b for b in Source(recording, block_s=60.0) if isinstance(b, SignalBlock)])
        picks = [e for e in sink.events if isinstance(e, Pick)]
        notes = [
            e for e in sink.events if isinstance(e, Note) and "the trigger comes at least" in e.text
        ]
        comparisons = [_of_label(x, picks, runs) for x in recording.labels if x.kind == "pick"]
        trigger_delays = _told(recording.labels, notes)
    error, sigma, others = zip(*comparisons, strict=True)
    names = others[0]
    return Errors(
        np.array(error),
        np.array(sigma),
        {name: np.array([o[name] for o in others]) for name in names},
        trigger_delays,
    )


def _told(labels: tuple[Label, ...], notes: list[Note]) -> tuple[tuple[float, float], ...]:
    shots = {x.label: x.time_ns for x in labels if x.kind == "impact"}
    claimed_s = {
        n.time_ns: float(n.text.split("at least ")[1].split(" ms")[0]) / 1e3 for n in notes
    }
    triggers = [x for x in labels if x.kind == "trigger"]
    return tuple(
        (claimed_s.get(x.time_ns, 0.0), (x.time_ns - shots[x.label]) / NS_PER_S) for x in triggers
    )


def _runs(blocks: list[SignalBlock]) -> list[SignalBlock]:
    """Return the records, each in one block."""
    from groundtrace.pipeline.source import joined

    return [b for b in joined([*blocks]) if isinstance(b, SignalBlock)]


def _of_label(
    label: Label, picks: list[Pick], runs: list[SignalBlock]
) -> tuple[float, float, dict[str, float]]:
    run = next(
        b
        for b in runs
        if b.start_ns <= label.time_ns <= b.end_ns
        and label.channel in [c.name for c in b.stream.channels]
    )
    channel_picks = [
        p for p in picks if p.channel == label.channel and run.start_ns <= p.time_ns <= run.end_ns
    ]
    error, sigma = 1.0, float("nan")
    if channel_picks:
        error, sigma = (
            (channel_picks[0].time_ns - label.time_ns) / NS_PER_S,
            channel_picks[0].uncertainty_s,
        )
    column = [c.name for c in run.stream.channels].index(label.channel)
    at_s = (label.time_ns - run.start_ns) / NS_PER_S
    onsets = rivals(run.values[:, column], run.stream.rate_hz)
    return error, sigma, {name: s - at_s if s == s else 1.0 for name, s in onsets.items()}


def line(name: str, folder: Path, data: Path) -> Path:
    """Import a line and its hand picks."""
    from groundtrace.cli.main import main as command

    out = folder / f"{name}.mcap"
    line_folder = data / "refrapy-seg2" / name
    truth = line_folder / "picks" / f"{name}.sgt"
    with contextlib.suppress(SystemExit), contextlib.redirect_stdout(io.StringIO()):
        command(["import", str(line_folder / "data"), "-o", str(out), "--truth", str(truth)])
    return out


def simulated(seed: int, folder: Path) -> Errors | None:
    """Draw a line from a seed, and compare; None where nobody would read an arrival off it."""
    out = folder / f"{seed}.mcap"
    simulation = simulate_line(LineOptions(seed=seed, random=True))
    if not any(x.kind == "pick" for x in simulation.labels):
        return None
    write(simulation, out, force=True)
    errors = errors_of(out)
    out.unlink()
    return errors


def row(name: str, error_s: np.ndarray, sigma_s: np.ndarray | None = None) -> str:
    """One line of the table."""
    ms = error_s * 1e3
    median, most = np.median(np.abs(ms)), np.percentile(np.abs(ms), 95)
    text = f"{name:28} {len(ms):6} {median:7.2f} {most:8.1f} {np.sum(ms < -20):6}"
    if sigma_s is None:
        return text
    picked = np.isfinite(sigma_s)
    z = np.abs(error_s[picked] / sigma_s[picked])
    inside = f"{np.mean(z < 1):7.0%} {np.mean(z < 1.645):6.0%}"
    return f"{text} {np.sum(~picked):7} {inside} {np.median(sigma_s[picked]) * 1e3:8.2f}"


def show(name: str, errors: Errors) -> None:
    """Print a line of the table, and one for each rival."""
    print(row(name, errors.error_s, errors.sigma_s), flush=True)
    sure = errors.sigma_s < 0.005
    print(row("  claimed within 5 ms", errors.error_s[sure], errors.sigma_s[sure]))
    for rival, error in errors.rivals.items():
        print(row(f"  {rival}", error), flush=True)


#: What may be chosen: windows before and after, correlation time [s], cost of slowness.
WINDOWS = (
    ((0.01, 0.02), (0.005, 0.01)),
    ((0.01, 0.02, 0.04), (0.005, 0.01, 0.02)),
    ((0.02, 0.04, 0.08, 9.0), (0.01, 0.02, 0.04, 0.08)),
)
CORRELATIONS_S, SLOWNESSES = (0.0, 0.001, 0.0025), (100, 400)


def crossed(paths: dict[str, Path]) -> None:
    """Choose windows, correlation, slowness and the claim's width on a line; report the other."""
    from groundtrace.detectors import first_breaks as module

    tried: dict[tuple[object, ...], dict[str, Errors]] = {}
    for windows, correlation_s, slowness in product(WINDOWS, CORRELATIONS_S, SLOWNESSES):
        module.BEFORE_S, module.AFTER_S = windows
        module.CORRELATION_S = correlation_s
        setting = (f"first-breaks.slowness={slowness}",)
        key = (windows, correlation_s, slowness)
        tried[key] = {name: errors_of(path, setting) for name, path in paths.items()}
    for chosen_on in paths:
        best = min(tried, key=lambda key: _worth(tried[key][chosen_on]))
        best_errors = tried[best][chosen_on]
        wide = float(np.nanquantile(np.abs(best_errors.error_s / best_errors.sigma_s), 0.68))
        print(f"chosen on {chosen_on}: {best}, claims times {wide:.2f}")
        for name, errors in tried[best].items():
            print(row(f"  {name}", errors.error_s, errors.sigma_s * wide))


def _worth(errors: Errors) -> float:
    """Return what is made least: the median and a tenth of what 95 % are within [ms]."""
    ms = np.abs(errors.error_s) * 1e3
    return float(np.median(ms) + 0.1 * np.percentile(ms, 95))


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path)
    parser.add_argument("--lines", type=int, default=200)
    parser.add_argument("--first", type=int, default=1001)
    parser.add_argument("--cross", action="store_true", help="choose on one line, report the other")
    given = parser.parse_args()
    header = ("", "truth", "median", "95 %", "early", "missed", "68 %", "90 %", "claimed")
    print("{:28} {:>6} {:>7} {:>8} {:>6} {:>7} {:>7} {:>6} {:>8}".format(*header))
    with tempfile.TemporaryDirectory() as folder:
        paths = {name: line(name, Path(folder), given.data) for name in LINES if given.data}
        if given.cross:
            crossed(paths)
            return
        for name, path in paths.items():
            show(name, errors_of(path))
        seeds = range(given.first, given.first + given.lines)
        parts = [p for p in (simulated(seed, Path(folder)) for seed in seeds) if p is not None]
        if parts:
            every = Errors.joined(parts)
            show(f"{len(parts)} simulated lines", every)
            claimed_s, late = np.array(every.told).T
            confirmed, wrong = late[claimed_s > 0] > 0, claimed_s > late + 1e-6
            print(
                f"triggers: {np.sum(late > 0)} of {len(late)} late, {confirmed.sum()} of them told"
            )
            print(
                f"told and not late: {(~confirmed).sum()}; "
                f"said to be later than they are: {wrong.sum()}"
            )
            print(f"by {1e3 * np.max(claimed_s - late):.1f} ms at most")


if __name__ == "__main__":
    main()
