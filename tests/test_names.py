"""Variables, attributes and functions are named after what they hold or do."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
#: They say how something came about, or how it is meant, not what it is.
EMPTY_NAMES = frozenset(
    {"alike", "due", "felt", "found", "heard", "held", "kept", "known", "lacking", "own", "place"}
    | {"said", "told", "turned", "usual", "whole"}
)
#: Keys of documents and parameters of stages: they are said to users, and do not change unseen.
PUBLISHED = {
    "cli/fleet.py": {"known"},
    "fleet/run.py": {"known"},
    "evaluation/positions.py": {"found"},
    "evaluation/tracks.py": {"own"},
    "evaluation/vehicles.py": {"found"},
    "localizers/intersection.py": {"own"},
    "vehicles/likelihood.py": {"heard"},
}


def names(module: ast.Module) -> Iterator[tuple[str, int]]:
    """Yield the variables, parameters, attributes and functions of a module, and their lines."""
    for node in ast.walk(module):
        match node:
            case ast.Name(id=name, ctx=ast.Store()) | ast.Attribute(attr=name, ctx=ast.Store()):
                yield name, node.lineno
            case ast.arg(arg=name) | ast.FunctionDef(name=name):
                yield name, node.lineno
            case ast.MatchAs(name=str() as name) | ast.ExceptHandler(name=str() as name):
                yield name, node.lineno


@pytest.mark.parametrize("package", ["codecs", "recordings", "replay", "viewers"])
def test_names_say_what_is_named(package: str) -> None:
    empty = []
    for path in sorted((ROOT / package).rglob("*.py")):
        file = "/".join(path.parts[-2:])
        published = PUBLISHED.get(file, set())
        module = ast.parse(path.read_text("utf-8"))
        empty += [
            f"{path.relative_to(ROOT)}:{line}: {name}"
            for name, line in names(module)
            if name.strip("_") in EMPTY_NAMES - published
        ]
    assert not empty, "\n".join(empty)
