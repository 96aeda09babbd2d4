"""The documentation's site: ``make docs`` builds it without the network, warnings are errors."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import groundtrace
from groundtrace.cli.main import application

if TYPE_CHECKING:
    from sphinx.application import Sphinx

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
    "capture_repr": ("_repr_html_", "__repr__"),
}
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 120
nb_execution_in_temp = True
myst_heading_anchors = 4
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


def write_commands(app: Sphinx) -> None:
    """Write the reference of all commands and options, as the command line knows them."""
    text = application().generate_docs().replace("# groundtrace\n", "# Commands and options\n", 1)
    target = Path(app.srcdir) / "commands.md"
    if not target.exists() or target.read_text("utf-8") != text:
        target.write_text(text, "utf-8")


def setup(app: Sphinx) -> None:
    """Let the page of commands be written before pages are read."""
    app.connect("builder-inited", write_commands)
