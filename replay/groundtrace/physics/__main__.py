"""``python -m groundtrace.physics``: print the tables of docs/waves.md."""

from __future__ import annotations

from ..simulate.plate import Plate
from .floors import perceived_table, thinness_table, velocity_table


def main() -> None:
    """Print the velocities of common floors, and what becomes of them on the default one."""
    print("Velocities [m/s]\n")
    print(velocity_table())
    for title, table in (
        ("A0 [m/s]", thinness_table),
        ("Perceived velocity [m/s]", perceived_table),
    ):
        print(f"\n{title}, concrete 0.20 m\n")
        print(table(Plate()))


if __name__ == "__main__":
    main()
