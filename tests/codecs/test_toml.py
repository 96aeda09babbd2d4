"""What is written as TOML reads back, and nothing in it is hidden from who edits it."""

from __future__ import annotations

import tomllib
from typing import Any

from hypothesis import example, given
from hypothesis import strategies as st

from groundtrace_codecs.toml import toml_value

TEXTS = st.text(st.characters(exclude_categories=["Cs"]))
PLAIN = st.one_of(
    st.booleans(), st.integers(-(2**63), 2**63 - 1), st.floats(allow_nan=False), TEXTS
)


@given(st.recursive(PLAIN, lambda inner: st.lists(inner) | st.dictionaries(TEXTS, inner)))
@example("a\x7f\x9b\u202eb\u2066\U000e0041\xad\\u202e\"'\n")
def test_any_value_reads_back_and_all_of_it_shows(value: Any) -> None:
    written = toml_value(value)
    assert tomllib.loads(f"value = {written}") == {"value": value}
    assert written.isprintable()
