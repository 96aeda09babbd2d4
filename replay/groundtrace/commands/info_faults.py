"""Faults of signals as ``groundtrace info`` prints them."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..api.inspection import FaultInfo

#: So many channels with one kind of fault are told one by one.
MOST_LINES = 4


def print_faults(faults: Sequence[FaultInfo]) -> None:
    """Print one line for each fault, of many channels alike the first few."""
    kinds = dict.fromkeys((fault.topic, fault.kind) for fault in faults)
    for kind in kinds:
        alike = [fault for fault in faults if (fault.topic, fault.kind) == kind]
        shown = alike if len(alike) <= MOST_LINES else alike[: MOST_LINES - 1]
        for fault in shown:
            where = " ".join(filter(None, (fault.topic, fault.channel)))
            print(
                f"fault: {where}: {fault.what}, first at {fault.start_s:.3f} s: "
                f"{fault.effect}; {fault.remedy}"
            )
        rest = alike[len(shown) :]
        if rest:
            names = ", ".join(fault.channel for fault in rest)
            print(f"fault: {kind[0]}: {kind[1]} on {len(rest)} more channels: {names}")
