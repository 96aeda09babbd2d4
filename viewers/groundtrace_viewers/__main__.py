"""``python -P -m groundtrace_viewers REPLAY.rrd PICTURE.png --at 3.62`` draws a moment of a replay.

Without ``-P`` Python would look for modules in the working folder.
"""

from __future__ import annotations

import sys

from .rerun.capture import main

sys.exit(main(sys.argv[1:]))
