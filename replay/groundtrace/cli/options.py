"""Options that several commands have, each with what ``--help`` says of it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter, validators

#: Of a switch that has no opposite, or a list that cannot be emptied.
FLAG = Parameter(negative="")
OUT = Parameter(name=["--out", "-o"])
POSITIVE = Parameter(validator=validators.Number(gt=0, lt=math.inf))
NOT_NEGATIVE = Parameter(validator=validators.Number(gte=0, lt=math.inf))
AT_LEAST_ONE = Parameter(validator=validators.Number(gte=1))

Force = Annotated[bool, Parameter(negative="", help="Overwrite an existing file.")]
ForceOutput = Annotated[bool, Parameter(negative="", help="Overwrite an existing output.")]
ForceOutputs = Annotated[bool, Parameter(negative="", help="Overwrite existing outputs.")]
ForceOthers = Annotated[
    bool,
    Parameter(negative="", help="Overwrite files that are no outputs of the same recording, too."),
]
Json = Annotated[bool, Parameter(negative="", help="Print one JSON document.")]
Quiet = Annotated[bool, Parameter(negative="", help="Show no progress bar.")]
Spawn = Annotated[bool, Parameter(negative="", help="Open the viewer with the same.")]
Results = Annotated[Path, Parameter(help="Results MCAP that groundtrace replay wrote.")]
Texts = Annotated[list[str] | None, FLAG]
Tolerance = Annotated[
    float, POSITIVE, Parameter(help="Largest distance between a step and its detection [s].")
]
Truth = Annotated[
    Path | None,
    Parameter(help="Truth instead of the recording's own: CSV, .sgt hand picks, or MCAP."),
]
