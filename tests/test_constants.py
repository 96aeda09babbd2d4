"""Constants of algorithms carry where they are from."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import groundtrace

#: Folders of algorithms. Those that draw, ask or convert have sizes and names, not constants.
FOLDERS = (
    *("annotate", "api", "detectors", "dsp", "evaluation", "explain", "fleet", "inertial"),
    *("kernels", "layout", "localizers", "pipeline", "simulate", "trackers", "vehicles"),
)

#: Files that draw: their numbers are sizes on paper or screen.
DRAWN = (
    *("evaluation/drawing.py", "evaluation/figures.py", "evaluation/score_page.py"),
    *("explain/sweep_plots.py", "fleet/report.py", "layout/report.py"),
)

#: What tells where a constant is from, and something must follow it.
SOURCE = re.compile(r"\b(source: |bench: |chosen by )\S", re.IGNORECASE)

#: Numbers that steer nothing: numbers of formats and the seeds of random draws.
UNSTEERING = re.compile(r"(^|_)(VERSION|FORMAT|SEED)$")

#: Functions that make numbers of numbers; others make records, whose fields have names.
CALCULATES = re.compile(r"(np|math)\.|(round|float|int|frozenset)$")

Assignment = ast.Assign | ast.AnnAssign


def constants(module: ast.Module) -> Iterator[tuple[str, Assignment]]:
    """Yield the module's UPPER_CASE names that are bound to numbers, and where."""
    for statement in module.body:
        if isinstance(statement, Assignment) and statement.value is not None:
            target = statement.targets[0] if isinstance(statement, ast.Assign) else statement.target
            name = ast.unparse(target)
            if name.isupper() and not UNSTEERING.search(name) and is_number(statement.value):
                yield name, statement


def is_number(value: ast.expr) -> bool:
    """Return whether an expression is made of numbers: alone, calculated, or in a collection."""
    match value:
        case ast.Constant(value=bool() | str() | bytes() | None):
            return False
        case ast.Constant():
            return True
        case ast.UnaryOp(operand=operand):
            return is_number(operand)
        case ast.BinOp(left=left, right=right):
            return is_number(left) or is_number(right)
        case ast.Tuple(elts=parts) | ast.List(elts=parts) | ast.Set(elts=parts):
            return any(is_number(part) for part in parts)
        case ast.Dict(values=parts):
            return any(is_number(part) for part in parts)
        case ast.ListComp(elt=part) | ast.Starred(value=part) | ast.Lambda(body=part):
            return is_number(part)
        case ast.Call(func=function, args=arguments) if CALCULATES.match(ast.unparse(function)):
            return any(is_number(argument) for argument in arguments)
    return False


def comments_of(statement: Assignment, lines: list[str]) -> str:
    """Return the comments beside a constant, and those above it or the constants it follows."""
    beside = lines[statement.lineno - 1 : statement.end_lineno]
    row = statement.lineno - 2
    while row >= 0 and lines[row].strip() and not lines[row].startswith("#"):
        row -= 1
    above = []
    while row >= 0 and lines[row].startswith("#"):
        above.insert(0, lines[row])
        row -= 1
    return " ".join(line.partition("#")[2].lstrip(":").strip() for line in (*above, *beside))


def without_source(folder: Path, names: tuple[str, ...]) -> list[str]:
    """Return the constants in folders that say no source, as FILE:LINE: NAME."""
    found = []
    for path in sorted(path for name in names for path in (folder / name).rglob("*.py")):
        if (file := path.relative_to(folder).as_posix()) not in DRAWN:
            text = path.read_text(encoding="utf-8")
            for name, statement in constants(ast.parse(text)):
                if not SOURCE.search(comments_of(statement, text.splitlines())):
                    found.append(f"{file}:{statement.lineno}: {name}")
    return found


def test_every_constant_of_an_algorithm_says_where_it_is_from():
    found = without_source(Path(groundtrace.__file__).parent, FOLDERS)
    assert not found, (
        "expected 'source: ...', 'bench: ...' or 'chosen by ...' in a comment above or beside each "
        "constant, found none at\n" + "\n".join(found)
    )


def test_a_constant_without_a_source_is_found_by_file_and_line(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "b.py").write_text(
        '"""A module."""\n\n#: A length [m].\nLENGTH_M = 2.0\n\n'
        "#: A part. Chosen by judgement: a half is plain.\nPART, OTHER = 0.5, 0.25\n"
        "_THIRD = 1 / 3\n\n"
        "_FOURTH = (1, 2)  # source: definition\nFORMAT = 3\nNAME = 'x'\nlower = 4\n"
        "#: source:\nLAST: int = 5\n"
    )
    assert without_source(tmp_path, ("a",)) == ["a/b.py:4: LENGTH_M", "a/b.py:15: LAST"]
