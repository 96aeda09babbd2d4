"""Every example in ``--help``, the README and the docs is a command that there is."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from command_runs import done

from groundtrace.cli.main import ANALYSES, COMMANDS, SIMULATIONS, application, piped
from groundtrace.explain.redecide import parse_axis
from groundtrace.pipeline.config import checked_pipeline, named_pipelines
from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from cyclopts import App

ROOT = Path(__file__).parents[1]
#: What a recording is replayed through where its example names no pipeline, by how it is called.
FITTING = {
    "walk": "waist-steps",
    "lower-back": "waist-steps",
    "room": "room-footsteps",
    "cars": "vehicle-passes",
}
HELP = {
    f"{group}{name}": text.partition("Example: ")[2]
    for group, commands in (("", COMMANDS), ("simulate ", SIMULATIONS), ("analyze ", ANALYSES))
    for name, (_, text) in commands.items()
}
PAGES = (
    "README.md",
    "CONTRIBUTING.md",
    *(f"docs/{p.name}" for p in sorted(ROOT.glob("docs/*.md"))),
)
MAPS = {p.stem for p in (ROOT / "recordings/groundtrace_recordings/maps").glob("*.toml")}
#: Of the examples, those that need a walk and its results and are quick, in this order.
QUICK = ("replay", "info", "score", "why", "sweep", "export", "cut", "filter", "convert", "doctor")


def commands_of(page: str) -> list[str]:
    """Return the commands of a page's blocks, one by one, but for those shown to fail."""
    text = re.sub(r"\\\n\s*", " ", (ROOT / page).read_text("utf-8"))
    text = re.sub(r"^\$ .*\n(?:(?!\$ |```).*\n)*?\[exit \d+\]\n", "", text, flags=re.M)
    blocks = re.findall(r"^```(?:sh|console)?\n(.*?)^```", text, re.M | re.S)
    lines = "\n".join(blocks).splitlines()
    indented = re.findall(r"^ {4}(groundtrace .*)$", text, re.M)
    parts = [p for line in (*lines, *indented) for p in re.split(r" && | \| ", line)]
    found = [part.strip().removeprefix("$ ") for part in parts]
    return [part for part in found if part.startswith("groundtrace ")]


EXAMPLES = {
    **{f"--help of {name}": example for name, example in HELP.items()},
    **{f"{p}: {c}": c for p in PAGES for c in commands_of(p)},
}


@pytest.fixture(scope="module")
def app() -> App:
    return application()


def arguments_of(app: App, command: str) -> dict[str, Any]:
    """Return the arguments that a command line binds, by the name of the parameter."""
    words = shlex.split(command, comments=True)
    words = words[: words.index(">")] if ">" in words else words
    assert words[0] == "groundtrace"
    _, bound, _ = app.parse_args(piped(words[1:]), exit_on_error=False, print_error=False)
    return dict(bound.arguments)


def pipelines_of(given: dict[str, Any]) -> list[str]:
    """Return the shipped pipelines that a command takes a recording through."""
    asked = given.get("pipeline") or given.get("name") or ()
    names = [asked] if isinstance(asked, str) else list(asked)
    if names:
        return [name for name in names if not name.endswith(".toml")]
    paths = [given.get("recording"), *given.get("inputs", ())]
    called = next((p.name.partition(".")[0] for p in paths if isinstance(p, Path)), "")
    return [FITTING[called]] if called in FITTING else []


@pytest.mark.parametrize("where", EXAMPLES)
def test_options_pipelines_and_parameters_of_every_example_exist(where: str, app: App) -> None:
    given = arguments_of(app, EXAMPLES[where])
    names = pipelines_of(given)
    settings = given.get("set_") or []
    assert names or not (settings or given.get("grid")), "a setting of no known pipeline"
    for name in names:
        assert name in named_pipelines(), name
        config = checked_pipeline(name, settings)
        for axis in given.get("grid") or ():
            parse_axis(axis, config)
    map_ = given.get("map_")
    assert map_ is None or map_.suffix == ".toml" or map_.name in MAPS


def test_every_command_has_an_example_of_itself() -> None:
    for name, example in HELP.items():
        assert example.startswith(f"groundtrace {name} ") or name == example.split()[1], name


def test_examples_of_help_that_need_a_walk_run_in_order(
    capsys: pytest.CaptureFixture[str],
) -> None:
    done(capsys, "cut", path_of("waist-walk.mcap"), "--to", 25, "-o", "walk.mcap")
    Path("torn.mcap").write_bytes(Path("walk.mcap").read_bytes()[:-4000])
    for name in QUICK:
        done(capsys, *shlex.split(HELP[name])[1:])
    assert {"walk.rrd", "best.toml", "sweep.svg", "steps.csv", "turn.mcap", "mended.mcap"} <= {
        path.name for path in Path().iterdir()
    }


def test_ci_runs_the_two_commands_of_the_readme_in_their_order() -> None:
    readme = (ROOT / "README.md").read_text("utf-8")
    block = readme.partition("## Two commands")[2].partition("```sh\n")[2].partition("```")[0]
    two = [line.partition("#")[0].strip() for line in block.splitlines()]
    assert two == ["make demo", "make test"]
    ran = re.findall(r"\bmake (?:--\S+ )*(\w+)", (ROOT / ".ci" / "run").read_text("utf-8"))
    assert ran[0] == "demo"
    assert ran[-1] == "test"
