"""A simulated recording: streams that are generated as they are read, and the truth about them."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING

from groundtrace_codecs.events import SIMULATOR

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from _typeshed import DataclassInstance

    from groundtrace_codecs.events import Label
    from groundtrace_codecs.geometry import Geometry
    from groundtrace_codecs.signals import SignalBlock, Stream

#: Time of the first sample: 2026-01-05 09:00 UTC, the same for all so that a seed fixes every byte.
#: Chosen by judgement: any time would do.
START_NS = 1_767_603_600_000_000_000

#: Author of every label of a simulator.
AUTHOR = SIMULATOR


@dataclass(slots=True)
class Simulation:
    """What a simulator gives.

    Attributes
    ----------
    sources
        Per stream its description, its sample format (``i16le``, ``f64le``) and its blocks, which
        may be read any number of times and are the same each time.
    geometry
        Of the site, or None.
    labels
        The truth, in order of time.
    metadata
        Metadata records by name: ``simulation`` says which simulator, seed and options, as text.
    """

    sources: list[tuple[Stream, str, Iterable[SignalBlock]]]
    geometry: Geometry | None
    labels: tuple[Label, ...]
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)


def described(simulator: str, options: DataclassInstance) -> dict[str, dict[str, str]]:
    """Return the metadata that says how a simulation was made.

    Options left open (None), off (False) or empty are omitted.
    """
    chosen = {
        k: str(v) for k, v in asdict(options).items() if v not in (None, ()) and v is not False
    }
    return {"simulation": {"simulator": simulator} | chosen}


def write(simulation: Simulation, path: Path, force: bool = False) -> None:
    """Write ``simulation`` as a recording.

    Raises
    ------
    CodecError
        Where ``path`` exists and ``force`` is False, or cannot be written.
    """
    from groundtrace_codecs.writer import write_recording

    write_recording(
        path,
        simulation.sources,
        geometry=simulation.geometry,
        labels=simulation.labels,
        metadata=simulation.metadata,
        force=force,
    )
