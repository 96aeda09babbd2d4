"""A person walking, as sensors they wear see it.

A :class:`.gait.Plan` says when which foot touches the floor and where the body goes;
:mod:`.gait_shapes` how the waist moves within a step of each type; :mod:`.body` how that reaches
the place where the sensor is worn. What a sensor measures follows from the motion: its
accelerometer feels the acceleration plus gravity in its own axes, its gyroscope the rotation
between samples, its magnetometer the field of :mod:`.magnetic` there.
"""

from __future__ import annotations

import numpy as np

from .gait import plan
from .magnetic import disturbances
from .person import person
from .routes import route_plan
from .simulation import Simulation, described
from .walk_options import WalkOptions
from .walk_sensors import Walker
from .walk_truth import walk_labels


def simulate_walk(options: WalkOptions | None = None) -> Simulation:
    """Simulate a walk with worn sensors.

    The truth: ``step`` per initial contact with place and foot, or with ``types`` its type and
    the foot as note; ``trailing`` for the second contact of each side step then; ``heading``
    [rad], where the body faces; ``walking`` and ``disturbed`` spans (value: largest added field
    [T]), ``idle`` spans, and ``waypoint`` where the person starts, turns and stops.

    Raises
    ------
    SimulationError
        Where an option is out of its range.
    """
    walker = _walker((options or WalkOptions()).resolved())
    return Simulation(
        sources=[(s.stream, "f64le", s) for s in walker.samples()],
        geometry=None,
        labels=walk_labels(walker),
        metadata=described("walk", walker.options),
    )


def _walker(options: WalkOptions) -> Walker:
    """Return who walks where, for options with their path chosen."""
    who = person(options)
    if options.standard and options.duration_s is not None:
        duration_s = options.duration_s
        walk = plan(duration_s, np.random.default_rng([options.seed, 1]))
    else:
        walk, duration_s = route_plan(options, who)
    return Walker(options, walk, who, duration_s, disturbances(options, walk, duration_s))
