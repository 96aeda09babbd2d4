"""What the code is made of: files, lines, who imports whom, and what the command line loads.

    python bench/structure.py            figures, and every circle of imports
    python bench/structure.py --single   also the files that one other file alone imports

Imports are read from the source, those inside functions and for type checking too. A name taken
from a package counts as an import of the module that the package takes it from. ``-X importtime``
tells what ``groundtrace --help`` loads; times are of a third run, its files are in memory then.
"""

from __future__ import annotations

import argparse
import ast
import statistics
import subprocess
import sys
import tomllib
from functools import cache
from pathlib import Path
from typing import NamedTuple

from groundtrace_codecs.events import EVENTS

ROOT = Path(__file__).parents[1]
FOLDERS = ("codecs", "replay", "viewers", "recordings")
#: By module: the modules it imports.
Graph = dict[str, set[str]]


class Module(NamedTuple):
    """A Python file."""

    name: str
    path: Path
    tree: ast.Module
    lines: int

    @property
    def is_package(self) -> bool:
        """Whether it is the front of a package."""
        return self.path.name == "__init__.py"


def modules() -> dict[str, Module]:
    """Return the files of all packages by the names of their modules."""
    module_map = {}
    for path in sorted(p for folder in FOLDERS for p in (ROOT / folder).rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts[1:]
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        text = path.read_text("utf-8")
        module_map[name] = Module(name, path, ast.parse(text), len(text.splitlines()))
    return module_map


def imports(module: Module, module_map: dict[str, Module], *, types: bool) -> set[str]:
    """Return what a module imports of ours; without ``types`` what it imports at run time."""
    skipped: set[ast.AST] = set()
    if not types:
        for node in ast.walk(module.tree):
            if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
                skipped.update(inner for part in node.body for inner in ast.walk(part))
    imported = set()
    for node in ast.walk(module.tree):
        if node in skipped:
            continue
        if isinstance(node, ast.Import):
            imported.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = _base(module, node)
            imported.update(_source(base, alias.name, module_map) for alias in node.names)
    # a package may import its files when they are first asked for, as kernels does
    packages = {name.rpartition(".")[2]: name for name in imported if name in module_map}
    for node in ast.walk(module.tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            package = packages.get(node.value.id)
            if package and module_map[package].is_package:
                imported.add(f"{package}.{node.attr}")
    return {name for name in imported if name in module_map} - {module.name}


def _base(module: Module, node: ast.ImportFrom) -> str:
    if not node.level:
        return node.module or ""
    parts = module.name.split(".")
    parts = parts[: len(parts) - node.level + module.is_package]
    return ".".join([*parts, *([node.module] if node.module else [])])


def _source(base: str, name: str, module_map: dict[str, Module]) -> str:
    """Return the module that a name of a module comes of."""
    if f"{base}.{name}" in module_map:
        return f"{base}.{name}"
    front = module_map.get(base)
    if front is None or not front.is_package:
        return base
    for node in ast.walk(front.tree):
        if isinstance(node, ast.ImportFrom) and node.level and name in {a.name for a in node.names}:
            return _source(_base(front, node), name, module_map)
    return base


def circles(graph: Graph) -> list[list[str]]:
    """Return the groups of modules that import each other, directly or not (Tarjan)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    groups = []

    def visit(name: str) -> None:
        index[name] = low[name] = len(index)
        stack.append(name)
        for other in sorted(graph[name]):
            if other not in index:
                visit(other)
            if other in stack:
                low[name] = min(low[name], low[other])
        if low[name] == index[name]:
            group = stack[stack.index(name) :]
            del stack[stack.index(name) :]
            if len(group) > 1:
                groups.append(sorted(group))

    sys.setrecursionlimit(10_000)
    for name in sorted(graph):
        if name not in index:
            visit(name)
    return groups


def folder_layers(graph: Graph, module_map: dict[str, Module]) -> list[list[str]]:
    """Return the folders by layer: each imports only of layers before its own.

    Files beside folders, as ``groundtrace_codecs.events``, lie between layers and are none.
    """
    places = {name: _place(module) for name, module in module_map.items()}
    needs: dict[str, set[str]] = {folder: set() for folder in places.values()}
    for name, others in graph.items():
        if not module_map[name].is_package:  # what a front takes from its folders counts for these
            needs[places[name]] |= {places[other] for other in others} - {places[name]}

    @cache
    def depth(folder: str) -> int:
        return max(map(depth, needs[folder]), default=0) + ("/" in folder)

    layers: dict[int, list[str]] = {}
    for folder in sorted(needs):
        if "/" in folder:
            layers.setdefault(depth(folder), []).append(folder)
    return [layers[number] for number in sorted(layers)]


def _place(module: Module) -> str:
    """Return the folder of a file; the name of a file that lies beside folders."""
    parts = module.path.relative_to(ROOT).parts[1:-1]
    return "/".join(parts) if len(parts) > 1 else module.name


def entry_points() -> list[str]:
    """Return the groups of entry points that the project declares."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    return sorted(project["entry-points"])


def event_places(module_map: dict[str, Module]) -> dict[str, list[str]]:
    """Return by kind of event the files whose code names its class, besides those that make it."""
    files: dict[str, list[str]] = {kind.cls.__name__: [] for kind in EVENTS.values()}
    for name, module in module_map.items():
        words = {node.id for node in ast.walk(module.tree) if isinstance(node, ast.Name)}
        called = {
            node.func.id
            for node in ast.walk(module.tree)
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
        }
        for kind in files:
            if kind in words and kind not in called:
                files[kind].append(name)
    return files


def loaded() -> tuple[int, int, float]:
    """Return how many modules ``groundtrace --help`` loads, how many of ours, and how long [s]."""
    command = [Path(sys.executable).with_name("groundtrace"), "--help"]
    for _ in range(3):
        run = [sys.executable, "-X", "importtime", *command]
        ran = subprocess.run(run, capture_output=True, text=True, check=True)
    rows = [line.removeprefix("import time:").split("|") for line in ran.stderr.splitlines()[1:]]
    own_us = [(int(self_us), name.strip()) for self_us, _, name in rows]
    ours = [name for _, name in own_us if name.startswith("groundtrace")]
    return len(own_us), len(ours), sum(us for us, _ in own_us) / 1e6


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--single", action="store_true")
    options = parser.parse_args()
    module_map = modules()
    fronts = sum(module.is_package for module in module_map.values())
    lines = sum(module.lines for module in module_map.values())
    print(f"{len(module_map)} Python files, {fronts} of them fronts of packages; {lines} lines")
    lengths = [module.lines for module in module_map.values() if not module.is_package]
    print(f"{statistics.median(lengths):.0f} lines has the median file")
    for words, types in (("at run time", False), ("counting types", True)):
        graph = {
            name: imports(module, module_map, types=types) for name, module in module_map.items()
        }
        groups = circles(graph)
        print(f"{len(groups)} circles of imports {words}, {sum(map(len, groups))} modules in them")
        for group in groups:
            print("   " + ", ".join(group))
    importers: dict[str, list[str]] = {name: [] for name in module_map}
    for name, others in graph.items():
        for other in others:
            importers[other].append(name)
    single = {n: i[0] for n, i in importers.items() if len(i) == 1 and not module_map[n].is_package}
    print(f"{len(single)} modules that one other alone imports")
    if options.single:
        for name, other in sorted(single.items()):
            print(f"   {name} ({module_map[name].lines} lines) by {other}")
    layers = folder_layers(graph, module_map)
    print(f"{len(layers)} layers of folders: " + " < ".join(", ".join(names) for names in layers))
    groups = entry_points()
    print(f"{len(groups)} groups of entry points: " + ", ".join(groups))
    named = {name: len(where) for name, where in event_places(module_map).items()}
    most = max(named, key=lambda name: named[name])
    print(
        f"a kind of event is named in {statistics.median(named.values()):.0f} files "
        f"(median of {len(named)}), {most} in {named[most]}"
    )
    count, ours, seconds = loaded()
    print(f"groundtrace --help loads {count} modules, {ours} of ours, in {seconds:.2f} s")


if __name__ == "__main__":
    main()
