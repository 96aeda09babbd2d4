"""Plugins: listed without an import, loaded by name, refused in one line."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import EntryPoint

import pytest

from groundtrace import plugins
from groundtrace.errors import PluginError
from groundtrace.plugins import find, load


@pytest.fixture
def registered(monkeypatch):
    """Replace the registry by entry points of the test."""

    def register(**targets: str) -> None:
        points = {n: EntryPoint(n, v, "groundtrace.detectors") for n, v in targets.items()}
        monkeypatch.setattr(plugins, "_points", {"detectors": points}.__getitem__)

    return register


def test_our_own_detectors_are_registered():
    found = {p.name: p for p in plugins.plugins("detectors")}
    assert {"dp", "zc", "sta-lta", "toa-cv"} <= set(found)
    assert found["dp"].target == "groundtrace.detectors.dp:PeakDetector"
    assert found["dp"].distribution == "groundtrace"
    assert list(found) == sorted(found)


@pytest.mark.parametrize("group", ["detectors", "associators"])
def test_every_plugin_of_ours_loads(group):
    for plugin in plugins.plugins(group):
        assert load(group, plugin.name) is not None


def test_a_plugin_is_found_in_the_group_that_has_it():
    from groundtrace.detectors.coincidence import Coincidence

    assert find(("detectors", "associators"), "coincidence") == ("associators", Coincidence)


def test_an_unknown_name_is_refused_with_the_known_ones():
    with pytest.raises(PluginError, match=r"^use: expected one of .*dp.*, found 'dq'$"):
        find(("detectors", "associators"), "dq")
    with pytest.raises(PluginError, match=r"^detectors: expected one of .*dp.*, found 'dq'$"):
        load("detectors", "dq")


def test_a_plugin_that_does_not_import_is_refused_in_one_line(registered):
    registered(broken="no_such_module:Thing", absent="groundtrace.clock:Nothing")
    with pytest.raises(
        PluginError, match=r"^detectors: broken: expected no_such_module:Thing to import, found: "
    ):
        load("detectors", "broken")
    with pytest.raises(PluginError, match=r"^detectors: absent: expected .* to import, found: "):
        find(("detectors",), "absent")


def test_a_group_without_plugins_is_empty(registered):
    registered()
    assert plugins.plugins("detectors") == ()
    with pytest.raises(PluginError, match=r"^detectors: expected one of none, found 'x'$"):
        load("detectors", "x")


def test_listing_imports_no_plugin():
    code = (
        "import sys; from groundtrace.plugins import plugins; plugins('detectors');"
        "print(any(m.startswith(('groundtrace.detectors', 'scipy')) for m in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
