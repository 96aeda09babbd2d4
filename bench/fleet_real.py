"""Import all real recordings into one folder, for a fleet.

    python bench/fleet_real.py recordings --data FOLDER
    groundtrace fleet recordings -o real.parquet
    groundtrace fleet-report real.parquet -o real.html

What cannot be imported is told, and left out.
"""

from __future__ import annotations

import argparse
import os
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from step_accuracy import PHONE

from groundtrace_codecs.errors import CodecError
from groundtrace_codecs.importers.run import import_recording
from groundtrace_recordings import map_path

if TYPE_CHECKING:
    from collections.abc import Iterator

#: Data set, its files, and the map that says what they are.
TABLES = (
    ("mobgap", "*/*/data.mat", "mobgap-test11.toml"),
    ("oxford-step/validation", "user*.csv", "oxford-step-validation.toml"),
    ("rieck-stepcounter", "*/*.csv", "rieck-stepcounter.toml"),
    ("llio-pyshoe", "*_LLIO.mat", "llio-pyshoe.toml"),
    ("xio-gait", "*.csv", "xio-gait.toml"),
    ("broad", "*.hdf5", "broad-hdf5.toml"),
    ("broad", "*.mat", "broad-mat.toml"),
)


@dataclass(frozen=True)
class Job:
    """A recording to import."""

    name: str
    source: Path
    columns: Path | None = None
    truth: Path | None = None


def jobs(data: Path, phone: Path) -> Iterator[Job]:
    """Return everything that is there."""
    for folder, pattern, name in TABLES:
        for path in sorted((data / folder).glob(pattern)):
            inner = "-".join(path.relative_to(data).with_suffix("").parts)
            yield Job(inner, path, map_path(name))
    for path in sorted(data.glob("oxford-step/optimisation/*/accelerometer.csv")):
        yield Job(f"oxford-step-{path.parent.name}", path, phone)
    for path in sorted(data.glob("indoor-location-20/*/*/path_data_files/*.txt")):
        yield Job(f"indoor-{path.parts[-3]}-{path.stem}", path)
    for path in sorted(data.glob("refrapy-seg2/*/data")):
        (truth,) = path.parent.glob("picks/*.sgt")
        yield Job(path.parent.name, path, None, truth)


def main() -> None:
    """Import them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    default = os.environ.get("GROUNDTRACE_DATA", "../shared/data")
    parser.add_argument("--data", type=Path, default=Path(default))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    count = 0
    with tempfile.TemporaryDirectory() as folder:
        phone = Path(folder) / "phone.toml"
        phone.write_text(PHONE)
        for job in jobs(options.data, phone):
            out = options.out / f"{job.name}.mcap"
            try:
                import_recording(
                    [job.source], out, map_path=job.columns, truth=job.truth, force=True
                )
            except CodecError as error:
                print(error)
                continue
            count += 1
    for path in sorted(options.data.glob("robot-localization/*.mcap")):
        shutil.copy(path, options.out)
        count += 1
    print(f"{count} recordings in {options.out}")


if __name__ == "__main__":
    main()
