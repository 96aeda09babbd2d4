"""Every parser of ours on mutated bytes: it reads them or raises its own error, in 2 s and 500 MB.

Each target runs in a process of its own under atheris, which mutates the seeds towards code not yet
reached; of the decoder it is asked besides that no message comes that was not in the file. The
table is that of docs/notebook/damage.md; each finding is kept with its input in --out.

Run: python bench/fuzz.py [--inputs 100000] [--only TARGET] [--out FOLDER]
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fuzz_targets import Target

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

#: Longest time [s] and largest memory [MB] that any input may take.
MAX_S, MAX_MB = 2.0, 500
#: An input that hangs ends its process after this time [s].
HANG_S = 30


class Watch:
    """Runs a target on inputs, counts what comes of them and keeps what must not be."""

    def __init__(self, name: str, target: Target, inputs: int, folder: Path, out: Path) -> None:
        self.name, self.target, self.inputs = name, target, inputs
        self.folder, self.out = folder, out
        self.outcomes: Counter[str] = Counter()
        self.findings: Counter[str] = Counter()
        self.slowest_s = 0.0

    def __call__(self, data: bytes) -> None:
        """Take one input; after the last one the counts are written and the process ends."""
        (self.folder / "last").write_bytes(data)
        began = time.process_time()
        try:
            self.target.check(data, self.folder)
            self.outcomes["read"] += 1
        except self.target.errors as error:
            self.outcomes["refused"] += 1
            if "\n" in str(error):
                self._keep("an error of more than one line", data)
        except Exception as error:
            at = traceback.extract_tb(error.__traceback__)[-1]
            ours = [f for f in traceback.extract_tb(error.__traceback__) if "groundtrace" in f[0]]
            where = " < ".join(f"{Path(f[0]).name}:{f[1]}" for f in (*ours[:-3:-1], at))
            self._keep(f"{type(error).__name__}: {str(error)[:80]} at {where}", data)
        taken_s = time.process_time() - began
        self.slowest_s = max(self.slowest_s, taken_s)
        if taken_s > MAX_S:
            self._keep(f"{taken_s:.1f} s", data)
        if sum(self.outcomes.values()) + sum(self.findings.values()) >= self.inputs:
            self.end()

    def _keep(self, what: str, data: bytes) -> None:
        if what not in self.findings:
            (self.out / f"{self.name}-{len(self.findings)}").write_bytes(data)
        self.findings[what] += 1

    def end(self) -> None:
        """Write what was counted, and end the process: the fuzzer itself never returns."""
        counts = {
            "inputs": self.inputs,
            "read": self.outcomes["read"],
            "refused": self.outcomes["refused"],
            "findings": dict(self.findings),
            "slowest_s": self.slowest_s,
            "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        }
        (self.folder / "counts.json").write_text(json.dumps(counts), encoding="utf-8")
        os._exit(0)


def fuzz(name: str, inputs: int, folder: Path, out: Path) -> None:
    """Fuzz one target; does not return."""
    import atheris

    with atheris.instrument_imports(include=["groundtrace", "groundtrace_codecs"]):
        from fuzz_targets import TARGETS
    target = TARGETS[name]
    seeds = folder / "seeds"
    seeds.mkdir()
    made = target.seeds(folder)
    for number, seed in enumerate(made):
        (seeds / str(number)).write_bytes(seed)
    # a warning of numpy on bytes from outside is a sum that overflows: it must not come either
    warnings.simplefilter("error", RuntimeWarning)
    watch = Watch(name, target, inputs, folder, out)
    longest = max(map(len, made)) * 5 // 4
    limits = [f"-timeout={HANG_S}", f"-rss_limit_mb={MAX_MB}", f"-max_len={longest}"]
    limits.append(f"-artifact_prefix={out}/")  # what it keeps of its own goes there, too
    atheris.Setup([sys.argv[0], *limits, "-seed=1", str(seeds)], watch)
    atheris.Fuzz()


def in_a_process(name: str, inputs: int, out: Path) -> dict[str, Any]:
    """Fuzz one target in a process of its own; return its counts."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, __file__, "--target", name, "--inputs", str(inputs)]
        command += ["--out", str(out), "--folder", folder]
        ran = subprocess.run(command, capture_output=True, text=True, check=False)
        counts = Path(folder) / "counts.json"
        if counts.exists():
            report: dict[str, Any] = json.loads(counts.read_text(encoding="utf-8"))
            return report
        last = Path(folder) / "last"
        if last.exists():
            (out / f"{name}-killed").write_bytes(last.read_bytes())
        stderr_tail = " ".join(ran.stderr.split()[-40:])
        return {"inputs": 0, "findings": {f"ended with {ran.returncode}: {stderr_tail}": 1}}


def main() -> None:
    """Fuzz all targets in turn, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=100_000, help="of all targets together")
    parser.add_argument("--only", default="", help="one target; it gets all inputs")
    parser.add_argument("--out", type=Path, default=Path("build/fuzz"), help="keeps the findings")
    parser.add_argument("--target", default="", help=argparse.SUPPRESS)
    parser.add_argument("--folder", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    if given.target:
        fuzz(given.target, given.inputs, given.folder, given.out)
    from fuzz_targets import TARGETS

    chosen = {n: t for n, t in TARGETS.items() if given.only in ("", n)}
    shares = sum(t.share for t in chosen.values())
    print("| target | inputs | read | own errors | findings | slowest | peak |")
    print("|---|---|---|---|---|---|---|", flush=True)
    wrong: list[str] = []
    for name, target in chosen.items():
        report = in_a_process(name, -int(-given.inputs * target.share // shares), given.out)
        wrong += [f"{name}: {n} x {what}" for what, n in report["findings"].items()]
        cells = (report["inputs"], report.get("read", 0), report.get("refused", 0))
        limits = f"{report.get('slowest_s', 0):.2f} s | {report.get('peak_mb', 0):.0f} MB"
        print(f"| {name} | {' | '.join(map(str, cells))} | {len(report['findings'])} | {limits} |")
        sys.stdout.flush()
    print("\n".join(["", *wrong]))
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
