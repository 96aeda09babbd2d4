"""Plugins: listed without an import, loaded by name, refused in one line."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import EntryPoint

import pytest

from groundtrace.errors import PluginError
from groundtrace.pipeline import plugins
from groundtrace.pipeline.plugins import load, stage_named


@pytest.fixture
def registered(monkeypatch):
    """Replace the registry by entry points of the test."""

    def register(**targets: str) -> None:
        points = {n: EntryPoint(n, v, "groundtrace.stages") for n, v in targets.items()}
        monkeypatch.setattr(plugins, "_points", {"stages": points}.__getitem__)

    return register


def test_our_own_stages_are_registered():
    found = {p.name: p for p in plugins.plugins("stages")}
    assert {"dp", "zc", "sta-lta", "toa-cv"} <= set(found)
    assert found["dp"].target == "groundtrace.detectors.peaks:PeakDetector"
    assert found["dp"].distribution == "groundtrace"
    assert list(found) == sorted(found)


@pytest.mark.parametrize("group", ["stages", "exporters"])
def test_every_plugin_of_ours_loads(group):
    for plugin in plugins.plugins(group):
        assert load(group, plugin.name) is not None


def test_a_stage_is_found_by_its_name():
    from groundtrace.detectors.coincidence import Coincidence

    assert stage_named("coincidence") is Coincidence


def test_an_unknown_name_is_refused_with_the_known_ones():
    with pytest.raises(PluginError, match=r"^use: expected one of .*dp.*, found 'dq'$"):
        stage_named("dq")
    with pytest.raises(PluginError, match=r"^stages: expected one of .*dp.*, found 'dq'$"):
        load("stages", "dq")


def test_a_plugin_that_does_not_import_is_refused_in_one_line(registered):
    registered(broken="no_such_module:Thing", absent="groundtrace.pipeline.engine:Nothing")
    with pytest.raises(
        PluginError, match=r"^stages: broken: expected no_such_module:Thing to import, found: "
    ):
        load("stages", "broken")
    with pytest.raises(PluginError, match=r"^stages: absent: expected .* to import, found: "):
        stage_named("absent")


def test_a_group_without_plugins_is_empty(registered):
    registered()
    assert plugins.plugins("stages") == ()
    with pytest.raises(PluginError, match=r"^stages: expected one of none, found 'x'$"):
        load("stages", "x")


def test_listing_imports_no_plugin():
    code = (
        "import sys; from groundtrace.pipeline.plugins import plugins; plugins('stages');"
        "print(any(m.startswith(('groundtrace.detectors', 'scipy')) for m in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_there_are_five_groups():
    assert plugins.GROUPS == ("stages", "importers", "exporters", "sinks", "views")
