"""Whether a recording and a pipeline suit each other, checked before the replay.

- A pipeline is refused if none of its stages finds a signal that it wants, or what it states as its
  needs is not there; those that fit are listed.
- Where a stage asks for the placement of a sensor and nobody states it, it is guessed from the
  first minutes of walking. A sure guess is written into the pipeline, and so into the results,
  where a later measurement reads it. An unsure one leaves the stages their defaults.
- A geometry and a recording that name different sensors are reported.
- So is the meaning assumed for a message of unknown type.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from groundtrace_codecs.events import Note
from groundtrace_codecs.geometry import geometry_warnings
from groundtrace_codecs.signals import SEISMIC_QUANTITIES, SignalBlock

from ..errors import PipelineError
from ..pipeline.chain import Pipeline, build_pipeline
from ..pipeline.config import PipelineConfig, PipelineNeeds, load_pipeline, named_pipelines
from ..pipeline.parameters import StageConfig
from ..pipeline.plugins import stage_named
from ..pipeline.stage import allows

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from groundtrace_codecs.geometry import Geometry
    from groundtrace_codecs.recording import Recording
    from groundtrace_codecs.signals import Stream

    from ..inertial.placement import PlacementGuess
    from ..pipeline.source import Readable
    from ..pipeline.stage import Stage

#: The pipeline without stages, which fits everything.
SIGNALS = "signals"
#: Who says it in a replay.
GEOMETRY, PLACEMENT, RECORDING = "geometry", "placement", "recording"


@dataclass(frozen=True, slots=True)
class Prepared:
    """A pipeline made ready for a recording.

    Attributes
    ----------
    chain
        The pipeline; placements that were guessed are in its configuration.
    asked
        The configuration that was asked for, without those.
    notes
        What to say before the first sample.
    looked_at
        Topics whose placement was looked at: nothing more needs to be said of it.
    """

    chain: Pipeline
    asked: PipelineConfig
    notes: tuple[Note, ...]
    looked_at: tuple[str, ...]


def prepared(config: PipelineConfig, recording: Recording) -> Prepared:
    """Return a pipeline made ready for a recording.

    Raises
    ------
    PipelineError, PluginError
        Where it cannot be built, or none of its stages finds a signal that it wants.
    """
    # what is wrong with the pipeline itself is said first
    build_pipeline(config, recording.geometry, recording.labels)
    refuse_unsuitable(config, recording.streams, recording.geometry, recording.name)
    placed, lines, looked_at = with_placements(config, recording)
    lines += _worn_elsewhere(config, recording)
    chain = build_pipeline(placed, recording.geometry, recording.labels)
    texts = [(GEOMETRY, text) for text in geometry_warnings(recording.geometry, recording.streams)]
    texts += [(PLACEMENT, text) for text in lines]
    texts += [(RECORDING, text) for text in recording.assumed]
    notes = tuple(Note(recording.start_ns, text, "WARN", source) for source, text in texts)
    return Prepared(chain, config, notes, looked_at)


def refuse_unsuitable(
    config: PipelineConfig, streams: Sequence[Stream], geometry: Geometry | None, name: str
) -> None:
    """Refuse a pipeline that does not fit what a recording has, whose file is ``name``.

    Raises
    ------
    PipelineError
        Naming what it needs, what there is, and the shipped pipelines that fit.
    """
    missing = _unmet(config, streams, geometry)
    wanted = _wanted(config)
    if not missing and (not wanted or any(_has_signal(each, streams) for each in wanted)):
        return
    fitting = ", ".join(fitting_pipelines(streams, geometry)) or SIGNALS
    raise PipelineError(
        f"{config.name} needs {missing or ' or '.join(_words(wanted))}; "
        f"{name} has {_what_there_is(streams, geometry)}. Fitting: {fitting}."
        + (_ON_A_FLOOR if config.needs.seismic_channels and _floors(streams) else "")
    )


#: Said where a floor's acceleration goes by the name of a worn sensor's.
_ON_A_FLOOR = " Of a sensor on a floor the quantity is ground_acceleration: say so in its map."


def _floors(streams: Sequence[Stream]) -> bool:
    """Return whether a sensor on a floor is said to measure a body's acceleration."""
    return any("floor" in s.placement and s.columns_of({"acceleration"}) for s in streams)


def fitting_pipelines(streams: Sequence[Stream], geometry: Geometry | None) -> list[str]:
    """Return the shipped pipelines whose needs a recording meets; no stage is loaded for that."""
    named = {key: load_pipeline(key) for key in named_pipelines()}
    return [key for key, config in named.items() if _fits(config, streams, geometry)]


def _fits(config: PipelineConfig, streams: Sequence[Stream], geometry: Geometry | None) -> bool:
    there = {c.quantity for s in streams for c in s.channels}
    if not all(there.intersection(each) for each in config.needs.signals):
        return False
    return config.needs != PipelineNeeds() and not _unmet(config, streams, geometry)


def _unmet(config: PipelineConfig, streams: Sequence[Stream], geometry: Geometry | None) -> str:
    """Return what of a pipeline's ``needs`` is not there, in words; nothing where all is."""
    needs = config.needs
    worn = [s.placement for s in streams if needs.placement and _taken_in(config, s)]
    if worn and not any(needs.placement in (placement or needs.placement) for placement in worn):
        return f"a sensor on the {needs.placement}"
    channels, placed = _seismic(streams, geometry)
    if (placed if needs.positions else channels) >= needs.seismic_channels:
        return ""
    least = f"{needs.seismic_channels} or more seismic channels"
    return least + (" with positions" if needs.positions else "")


def _taken_in(config: PipelineConfig, stream: Stream) -> bool:
    """Whether a stream has a signal that the pipeline states to need, and a stage may hear it."""
    needed = any(stream.columns_of(set(each)) for each in config.needs.signals)
    return needed and any(allows(stage.topics, stream.topic) for stage in config.stage)


def _seismic(streams: Sequence[Stream], geometry: Geometry | None) -> tuple[int, int]:
    """Return how many seismic channels there are, and how many of them have positions."""
    names = [s.channels[i].name for s in streams for i in s.columns_of(SEISMIC_QUANTITIES)]
    places = {} if geometry is None else {sensor.channel for sensor in geometry.sensors}
    return len(names), sum(name in places for name in names)


def _what_there_is(streams: Sequence[Stream], geometry: Geometry | None) -> str:
    """Return the quantities of a recording in words, and where its sensors are."""
    quantities = dict.fromkeys(c.quantity for s in streams for c in s.channels)
    phrases = [each.replace("_", " ") for each in quantities if each not in SEISMIC_QUANTITIES]
    channels, placed = _seismic(streams, geometry)
    if channels:
        plural = "" if channels == 1 else "s"
        phrases.append(f"{channels} seismic channel{plural}, {placed or 'none'} with positions")
    worn = " and ".join(dict.fromkeys(s.placement for s in streams if s.placement))
    return (", ".join(phrases) or "no signals") + (f" (worn: {worn})" if worn else "")


#: What one stage wants: the stage, and sets of quantities of each of which it needs one.
_Wanted = tuple[StageConfig, tuple[frozenset[str], ...]]


def _wanted(config: PipelineConfig) -> list[_Wanted]:
    """Return what those stages want that hear signals."""
    wanted: list[_Wanted] = []
    for stage in config.stage:
        kind = stage_named(stage.use)
        quantities = _quantities(kind)
        if quantities:
            wanted.append((stage, quantities))
    return wanted


def _quantities(kind: type[Stage]) -> tuple[frozenset[str], ...]:
    """Return the sets of quantities of each of which a stage needs a channel."""
    needs = [need for need in kind.takes if need.kind is SignalBlock and need.required]
    return tuple(need.quantities for need in needs if need.quantities)


def _has_signal(wanted: _Wanted, streams: Sequence[Stream]) -> bool:
    stage, quantities = wanted
    stage_streams = [s for s in streams if allows(stage.topics, s.topic)]
    return all(any(s.columns_of(each) for s in stage_streams) for each in quantities)


def _words(wanted: Iterable[_Wanted]) -> list[str]:
    """Return what stages want in words, each once."""
    phrases = []
    for stage, quantities in wanted:
        text = " and ".join(_plain(each) for each in quantities)
        phrases.append(text + (f" on {' or '.join(stage.topics)}" if stage.topics else ""))
    return list(dict.fromkeys(phrases))


def _plain(quantities: frozenset[str]) -> str:
    """Return quantities of which one is enough in words."""
    seismic = ["seismic channels"] if quantities >= SEISMIC_QUANTITIES else []
    others = quantities - SEISMIC_QUANTITIES if seismic else quantities
    return " or ".join([*seismic, *(each.replace("_", " ") for each in sorted(others))])


def with_placements(
    config: PipelineConfig, recording: Readable
) -> tuple[PipelineConfig, list[str], tuple[str, ...]]:
    """Let a pipeline know where sensors are worn whose recording does not say so.

    The whole recording is looked at from its first sample, whatever part of it is replayed, until
    more would not change the guess: the result does not depend on blocks, parts or pace.

    Returns
    -------
    The pipeline; a line for each such sensor that a stage asks for; their topics.
    """
    asking = [stage for stage in config.stage if _asks(stage)]
    unstated = {
        s.topic: stage.key
        for s in recording.streams
        for stage in reversed(asking)
        if not s.placement and _has_signal(_wanted_by(stage), (s,))
    }
    fresh = [topic for topic in unstated if topic not in config.placements]
    guesses = _guesses(recording, fresh)
    placements = dict(config.placements)
    lines = []
    for topic, key in unstated.items():
        if topic in guesses:
            placements[topic], text = _taken(guesses[topic])
        else:
            stated = placements[topic]
            text = f"taken for {stated} as the pipeline says" if stated else "nor does the pipeline"
        lines.append(
            f"placement of {topic} not stated: {text}; --set {key}.placement=PLACE or placement in "
            f"the map states it"
        )
    return replace(config, placements=placements), lines, tuple(unstated)


def _worn_elsewhere(config: PipelineConfig, recording: Readable) -> list[str]:
    """Return a line for each sensor that nobody states, unless it is surely worn as is needed."""
    placement = config.needs.placement
    streams = recording.streams if placement else ()
    unstated = [s.topic for s in streams if not s.placement and _taken_in(config, s)]
    lines = []
    for topic, guess in _guesses(recording, unstated).items():
        taken, words = _taken(guess)
        if taken != placement:
            words = words.removesuffix(_DEFAULT)
            lines.append(
                f"placement of {topic} not stated: {words}; {config.name} is for a sensor on the "
                f"{placement}: its results may be wrong; placement in the map states it"
            )
    return lines


def _asks(stage: StageConfig) -> bool:
    """Return whether a stage takes a placement and is told none."""
    kind = stage_named(stage.use)
    fields: Mapping[str, Any] = kind.Parameters.__dataclass_fields__
    return "placement" in fields and not stage.parameters.get("placement")


def _wanted_by(stage: StageConfig) -> _Wanted:
    kind = stage_named(stage.use)
    return stage, _quantities(kind)


def _guesses(recording: Readable, topics: Sequence[str]) -> dict[str, PlacementGuess | None]:
    """Return where the sensors of some topics may be worn; None where that cannot be told."""
    if not topics:
        return {}
    # what filters is not imported before there is something to filter
    from ..inertial.placement import guessed_placements

    return guessed_placements(recording, topics)


#: What becomes of stages that ask for a placement that is not known.
_DEFAULT = ", default timing"


def _taken(guess: PlacementGuess | None) -> tuple[str, str]:
    """Return the placement that a guess stands for, empty where it is not sure, and words."""
    if guess is None:
        return "", f"too little walking on three axes of acceleration to guess it{_DEFAULT}"
    words = f"{guess.words} ({guess.confidence:.2f})"
    if not guess.sure:
        return "", f"a guess, {words}, is not sure{_DEFAULT}"
    return guess.placement, f"taken for {words}"
