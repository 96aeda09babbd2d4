"""The command line. Commands are imported when called, so that ``--help`` needs nothing heavy."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from cyclopts import App, CycloptsError

if TYPE_CHECKING:
    from collections.abc import Sequence

#: Roots of the errors that are said in one line; anything else is a bug and keeps its traceback.
KNOWN_ERRORS = (
    ("groundtrace.errors", "GroundtraceError"),
    ("groundtrace_codecs.errors", "CodecError"),
    ("groundtrace_viewers.errors", "ViewerError"),
)


def application() -> App:
    """Return the command line's application."""
    from .. import __version__

    app = App(
        name="groundtrace",
        version=__version__,
        help="Replay field recordings of footsteps and vehicles, "
        "and see why every detector decided as it did.",
    )
    here = "groundtrace.commands"
    app.command(f"{here}.importing:import_", name="import")
    app.command(f"{here}.info:info")
    app.command(f"{here}.replaying:replay")
    app.command(f"{here}.scoring:score")
    simulate = App(name="simulate", help="Make a recording with known truth.")
    simulate.command(f"{here}.simulating:room")
    simulate.command(f"{here}.simulating:walk")
    app.command(simulate)
    app.command(f"{here}.listing:plugins")
    app.command(f"{here}.listing:pipelines")
    return app


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line; exit with 0 (done), 1 (known error) or 2 (wrong usage)."""
    try:
        application()(arguments, exit_on_error=False)
    except CycloptsError:
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)
    except Exception as error:
        if not _is_known(error):
            raise
        print(f"groundtrace: {error}", file=sys.stderr)
        sys.exit(1)


def _is_known(error: Exception) -> bool:
    loaded = ((sys.modules.get(module), name) for module, name in KNOWN_ERRORS)
    return any(m is not None and isinstance(error, getattr(m, name)) for m, name in loaded)
