"""What lost packets do to tracks of feet: how far straight lines are off, and where tracks end.

    python bench/lost_samples.py --data FOLDER

The folder holds ``llio-pyshoe`` and ``xio-gait`` as published, here sampled at 100 Hz. First how
far the integral over a line is off where no sample is lost: the root mean square over all spans of
a length, in T^2 / 12 times the larger of the line's bends at both ends. Then samples are left out
in bursts of two in the mean, three times at random, and replaced by straight lines as a replay
does, told and untold; ends of tracks are compared with what they claim, as in foot_accuracy.py.
:data:`groundtrace.inertial.strapdown.LINE_SIGMA` was chosen in these tables.
"""

from __future__ import annotations

import argparse
import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from foot_accuracy import CHI2_90, Said, at, end_of, read, recordings

from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import load_pipeline
from groundtrace.pipeline.engine import replay
from groundtrace_codecs.events import Gap

if TYPE_CHECKING:
    from collections.abc import Iterator

    from foot_accuracy import End

    from groundtrace_codecs.events import Label
    from groundtrace_codecs.signals import SignalBlock

    Array = np.ndarray

RATE_HZ = 100.0
#: Normalised square that 68 % of errors in a plane stay below.
CHI2_68 = 2.279
SPANS = (2, 3, 4, 6, 8, 10)
SHARES = (0.0, 0.02, 0.05, 0.15, 0.3)
SEEDS = range(3)
#: Samples of a burst: in the mean, and at most, so that all are bridged.
BURST, LONGEST = 2.0, 9
#: The first samples are never lost: a track begins where a foot stands.
BEGIN = 300


def off_line(block: SignalBlock, quantity: str, span: int) -> tuple[Array, Array]:
    """Return how far lines over a span are off, and the bends' measure, shape (n,) each."""
    x = block.values[BEGIN:, block.stream.columns_of({quantity})]
    side = max(1, span // 2)
    i = np.arange(side, len(x) - span - side)
    sums = np.concatenate([np.zeros((1, 3)), np.cumsum((x[1:] + x[:-1]) / 2, axis=0)])
    off = sums[i + span] - sums[i] - (x[i] + x[i + span]) / 2 * span
    slope = (x[i + span] - x[i]) / span
    before = (x[i] - x[i - side]) / side - slope
    after = (x[i + span + side] - x[i + span]) / side - slope
    bend = span**2 / 12 * np.maximum(np.abs(before), np.abs(after))
    return (off**2).sum(axis=1), (bend**2).sum(axis=1)


def lost_of(count: int, share: float, rng: np.random.Generator) -> Array:
    """Return which of so many samples are lost, shape (n,)."""
    lost, i = np.zeros(count, bool), BEGIN
    while i < count - 2:
        if rng.random() < share / BURST:
            length = min(int(rng.geometric(1 / BURST)), LONGEST)
            lost[i : i + length] = True
            i += length
        i += 1
    lost[-2:] = False
    return lost


def replayed(block: SignalBlock, lost: Array, *, tell: bool) -> Iterator[SignalBlock | Gap]:
    """Yield a block with straight lines over lost samples, each after its gap if it is told."""
    here, x = np.flatnonzero(~lost), block.values
    filled = [np.interp(np.arange(len(x)), here, column[here]) for column in x.T]
    channels = tuple(replace(channel, scale=1.0) for channel in block.stream.channels)
    stream = replace(block.stream, channels=channels)
    block = replace(block, stream=stream, samples=np.column_stack(filled))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], lost, [False]]).astype(int)))
    done = 0
    for start, end in edges.reshape(-1, 2).tolist():
        span = block.slice(start, end)
        yield block.slice(done, start)
        if tell:
            yield Gap(block.topic, span.start_ns, span.end_ns, "missing", end - start, bridged=True)
        yield span
        done = end
    yield block.slice(done, len(block))


def end(block: SignalBlock, labels: tuple[Label, ...], lost: Array, *, tell: bool) -> End:
    """Return where the track of a recording with losses ends."""
    sink = Said()
    pipeline = build_pipeline(load_pipeline("foot-inertial"))
    replay(replayed(block, lost, tell=tell), pipeline, [sink])
    return end_of(labels, sink.points)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--data", type=Path, default=Path(os.environ.get("GROUNDTRACE_DATA", "../shared/data"))
    )
    options = parser.parse_args()
    read_ones = [read(path, columns) for path, columns in recordings(options.data)]
    cases = [(at(block, RATE_HZ), labels) for block, labels in read_ones]
    print("root mean square of what a line is off, in T^2 / 12 times the larger bend at its ends")
    print(f"{'intervals':20}" + "".join(f"{span:7}" for span in SPANS))
    for quantity in ("angular_velocity", "acceleration"):
        ratios = []
        for span in SPANS:
            parts = [off_line(block, quantity, span) for block, _ in cases]
            off, bend = (np.concatenate(column).mean() for column in zip(*parts, strict=True))
            ratios.append(np.sqrt(off / bend))
        print(f"{quantity:20}" + "".join(f"{ratio:7.2f}" for ratio in ratios))
    print("\nlost  told   end off: median, 90 of 100, most   claimed   within 68 %, 90 %")
    for share in SHARES:
        for tell in (True, False):
            ends = []
            for seed in SEEDS:
                rng = np.random.default_rng(seed)
                ends += [
                    end(b, labels, lost_of(len(b), share, rng), tell=tell) for b, labels in cases
                ]
            off = np.array([one.off_m for one in ends])
            square = np.array([one.square for one in ends])
            claimed = np.median([one.claimed_m for one in ends])
            print(
                f"{share:4.0%}  {'yes' if tell else 'no':4} {np.median(off):9.2f} m "
                f"{np.percentile(off, 90):7.2f} m {off.max():7.1f} m {claimed:9.2f} m "
                f"{np.mean(square <= CHI2_68):9.2f} {np.mean(square <= CHI2_90):6.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
