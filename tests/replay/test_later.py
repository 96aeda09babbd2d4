"""A module that is imported later is imported when something of it is first asked for."""

from __future__ import annotations

import sys

import pytest

from groundtrace.later import Later


def test_nothing_is_imported_before_it_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "colorsys", raising=False)
    colours = Later("colorsys")
    assert "colorsys" not in sys.modules
    assert colours.rgb_to_hsv(1.0, 1.0, 1.0) == (0.0, 0.0, 1.0)
    assert colours.rgb_to_hsv is sys.modules["colorsys"].rgb_to_hsv


def test_what_a_module_does_not_have_is_said_to_lack() -> None:
    with pytest.raises(AttributeError, match="nothing_of_this_name"):
        _ = Later("colorsys").nothing_of_this_name
