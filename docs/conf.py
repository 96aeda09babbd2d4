"""The documentation's site: ``make docs`` builds it without the network, warnings are errors."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from docutils import nodes
from latex2mathml.converter import convert

import groundtrace
from groundtrace.cli.main import application
from groundtrace.pipeline.config import load_pipeline, named_pipelines
from groundtrace.pipeline.parameters import describe
from groundtrace.pipeline.plugins import plugins, stage_named
from groundtrace_codecs.events import EVENTS

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from sphinx.application import Sphinx
    from sphinx.writers.html5 import HTML5Translator

project = "groundtrace"
author = "The groundtrace developers"
release = version = groundtrace.__version__
extensions = [
    "myst_nb",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx_copybutton",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = ["json", "gallery", "figures/*.ipynb", "figures/*.py"]
#: Twelve scripts, run here, a page each.
sphinx_gallery_conf = {
    "examples_dirs": "gallery",
    "gallery_dirs": "figures",
    "download_all_examples": False,
    "show_memory": False,
    "show_signature": False,
    "abort_on_example_error": True,
    "plot_gallery": True,
    "write_computation_times": False,  # their page loads scripts from elsewhere
    "capture_repr": ("_repr_html_",),  # tables, and not what drawing returns
}
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 120
nb_execution_in_temp = True
# widgets are not part of a page: their scripts would be asked of servers of others
nb_ipywidgets_js: dict[str, dict[str, str]] = {}
myst_heading_anchors = 4
myst_enable_extensions = ["dollarmath"]
html_math_renderer = "mathml"  # browsers draw it themselves, without a script
myst_url_schemes = ["http", "https", "mailto"]
numpydoc_show_class_members = False
autodoc_typehints = "none"
autodoc_member_order = "bysource"
copybutton_prompt_text = "$ "
copybutton_only_copy_prompt_lines = True
html_theme = "pydata_sphinx_theme"
html_title = "groundtrace"
html_show_sourcelink = False
html_theme_options = {"show_prev_next": False, "navigation_with_keys": False}
html_static_path: list[str] = []


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    cells = [[str(cell).replace("|", "\\|").replace("\n", " ") for cell in line] for line in lines]
    return "\n".join(f"| {' | '.join(line)} |" for line in cells) + "\n\n"


def code(value: object) -> str:
    """Return a value as one types it; nothing of an empty one."""
    text = str(value).lower() if isinstance(value, bool) else str(value)
    return f"`{text}`" if text else ""


def commands() -> str:
    """Return the reference of all commands and options, as the command line knows them."""
    return application().generate_docs().replace("# groundtrace\n", "# Commands and options\n", 1)


def stages() -> str:
    """Return the shipped pipelines, and every stage with its method, source and parameters."""
    text = "# Pipelines, stages and parameters\n\n## Pipelines\n\n"
    shipped = [
        (
            code(each.name),
            " > ".join(f"[{s.key}](#{s.use})" for s in each.stage),
            each.description,
        )
        for each in map(load_pipeline, named_pipelines())
    ]
    text += table(("pipeline", "stages", "for"), shipped)
    text += (
        "## Stages\n\nA change of a parameter that decides needs no signal: `sweep` and `why` take "
        "the stored values of gates. One that measures needs a new replay.\n\n"
    )
    shown = set()
    for name in sorted(each.name for each in plugins("stages")):
        stage = stage_named(name)
        given = ", ".join(
            f"[{EVENTS[kind].plural}](events.md#{kind.__name__.lower()})" for kind in stage.gives
        )
        says = (stage.__doc__ or "").splitlines()[0].replace("``", "`")
        text += f"### {name}\n\n{says} Gives {given}.\n\n"
        if stage.__module__ not in shown:
            text += f"```{{eval-rst}}\n.. automodule:: {stage.__module__}\n   :no-index:\n```\n\n"
        shown.add(stage.__module__)
        parameters = [
            (code(i.name), code(i.default), i.unit, code(i.allowed), i.part + "s", i.doc)
            for i in describe(stage.Parameters)
        ]
        if parameters:
            text += table(
                ("parameter", "default", "unit", "allowed", "what it does", ""), parameters
            )
    return text


def events() -> str:
    """Return the kinds of events with their fields, as their classes state them."""
    text = "# Event types\n\nEach is one message of a results file, of the type `groundtrace.NAME` "
    text += "(protobuf), on the topic named here. Times are int64 nanoseconds.\n\n"
    kinds = [
        (f"[{cls.__name__}](#{cls.__name__.lower()})", kind.plural, code(kind.topic), kind.truth)
        for cls, kind in EVENTS.items()
    ]
    text += table(("event", "in exports and `--json`", "topic", "scored against"), kinds)
    for cls in EVENTS:
        text += f"## {cls.__name__}\n\n```{{eval-rst}}\n"
        text += f".. autoclass:: {cls.__module__}.{cls.__name__}\n   :no-index:\n```\n\n"
    return text


def kind_of(schema: Any) -> str:
    """Return the type of a property in words; of a definition its name."""
    if not isinstance(schema, dict):
        return ""
    if "$ref" in schema:
        return str(schema["$ref"]).rpartition("/")[2]
    for each in ("oneOf", "anyOf"):
        if each in schema:
            return " or ".join(kind_of(one) for one in schema[each])
    if "enum" in schema or "const" in schema:
        return ", ".join(code(json.dumps(one)) for one in schema.get("enum", [schema.get("const")]))
    kinds = schema.get("type", "")
    kinds = " or ".join(kinds) if isinstance(kinds, list) else kinds
    items = kind_of(schema.get("items"))
    return f"{kinds} of {items}" if items else str(kinds)


def fields(part: dict[str, Any]) -> str:
    """Return a table of the keys of an object; nothing where its keys are not named."""
    rows = [
        (
            code(key),
            kind_of(value),
            "yes" if key in part.get("required", ()) else "",
            "" if value is True else value.get("description", ""),
        )
        for key, value in part.get("properties", {}).items()
    ]
    return table(("key", "type", "always", ""), rows) if rows else ""


def schemas() -> str:
    """Return what the documents of ``--json`` hold, as their schemas state it."""
    text = "# JSON documents\n\nWhat `--json` of each command prints, by its schema.\n\n"
    for path in sorted((Path(__file__).parent / "json").glob("*.schema.json")):
        document = json.loads(path.read_text("utf-8"))
        title = document["title"].removeprefix("groundtrace ").removesuffix(" --json")
        text += f"## {title}\n\n{document['description']}\n\n"
        text += f"Schema: {{download}}`{path.name} <json/{path.name}>`\n\n" + fields(document)
        for name, part in document.get("$defs", {}).items():
            if keys := fields(part):
                text += f"**{name}** {part.get('description', '')}".strip() + f"\n\n{keys}"
    return text


#: Pages of the reference, made from what they are about.
PAGES = {"commands": commands, "stages": stages, "events": events, "schemas": schemas}


def write_pages(app: Sphinx) -> None:
    """Write the generated pages of the reference beside the others."""
    for name, made in PAGES.items():
        (Path(app.srcdir) / f"{name}.md").write_text(made(), "utf-8")


def inline_formula(page: HTML5Translator, node: nodes.math) -> None:
    """Write a formula in a line."""
    page.body.append(convert(node.astext()))
    raise nodes.SkipNode


def formula(page: HTML5Translator, node: nodes.math_block) -> None:
    """Write a formula of its own."""
    page.body.append(f'<div class="math">{convert(node.astext(), display="block")}</div>')
    raise nodes.SkipNode


def setup(app: Sphinx) -> None:
    """Let generated pages be written before pages are read, and formulas as MathML."""
    app.add_html_math_renderer("mathml", (inline_formula, None), (formula, None))
    app.connect("builder-inited", write_pages)
