"""The damage set: how much of each file is read, and that none of it is wrong."""

from __future__ import annotations

from collections import Counter

import pytest
from mcap_damage_set import MESSAGES, damage_set
from mcap_files import opened, read, rows_of

#: Damage that costs the half of the file behind it, one chunk, or more messages than none.
HALF = {
    "cut inside a chunk",
    "cut after a chunk, before its index",
    "zeros after a cut",
    "without chunks, cut",
}
ONE_CHUNK = {
    "a bit of a chunk flipped",
    "a page of a chunk zeroed",
    "a chunk's first page zeroed, no summary",
}


@pytest.mark.parametrize(("kind", "compression"), damage_set(), ids=str)
def test_nothing_readable_is_lost_and_nothing_wrong_is_read(kind: str, compression: str) -> None:
    broken, sound = damage_set()[kind, compression]
    with opened(broken) as file:
        found = read(file)
        damage = file.damage
    assert not Counter(found) - Counter(rows_of(sound))
    lost = MESSAGES - len(found)
    if kind == "only the magic":
        assert not found
    elif kind in HALF:
        assert 0.4 * MESSAGES < len(found) < 0.6 * MESSAGES
    elif kind in ONE_CHUNK:
        assert 0 < lost < 100
        assert sum(d.messages or 0 for d in damage) == lost
    else:
        assert lost == 0
    assert bool(damage) == (kind not in {"sound", "without chunks"})
