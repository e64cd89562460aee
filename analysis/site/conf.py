"""The pages, notebooks and reference of the repository as a site.

    pip install ".[test]" && python analysis/site/build.py DIR

Pages stay where they are and read as well on GitHub; notebooks are shown as they are stored, none is run.
It is built from a copy, and what it shows needs no network: mathematics is MathML, made here.
"""

import re
from importlib import import_module
from inspect import isclass, ismodule, isroutine
from pathlib import Path
from tomllib import loads
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.writers.html5 import HTML5Translator

HERE = Path(__file__).parent
_project = loads((HERE.parents[1] / "pyproject.toml").read_text())["project"]

project, release, author = _project["name"], _project["version"], _project["authors"][0]["name"]
copyright = author
root_doc = "analysis/site/index"
include_patterns = [
    "README.md", "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md", "CODE_OF_CONDUCT.md",
    "analysis/README.md",
    "analysis/docs/**.md", "analysis/site/**", "analysis/notebooks/*.ipynb", "analysis/scenes/*.ipynb",
    "analysis/results/README.md", "analysis/workflows/README.md", "analysis/packaging/README.md",
    "analysis/plugins/README.md",
]  # fmt: skip
extensions = ["myst_nb", "sphinx.ext.autodoc", "numpydoc"]

myst_heading_anchors = 4
myst_enable_extensions = ["dollarmath"]
myst_fence_as_directive = ["math"]  # as GitHub has it
nb_execution_mode = "off"  # they are stored with what they show
html_math_renderer = "mathml"
suppress_warnings = ["myst-nb.lexer"]  # notebooks name no language: all are in Python, which is the default

autodoc_typehints = "none"
autodoc_member_order = "groupwise"
numpydoc_show_class_members = False

html_theme = "furo"
html_title = project
html_extra_path = ["root"]
html_copy_source = False
html_static_path = ["static"]
templates_path = ["templates"]
html_css_files = ["site.css"]

PACKAGES = (
    "batches", "comparison", "mechanics.motion", "mechanics.multibody", "dynamics", "energies",
    "ligands", "mechanisms", "mechanisms.flexible", "mechanisms.impacts", "minimisers", "relaxation",
    "searching", "structure", "validation",
)  # fmt: skip
"""Of the reference, beside what ``import protochain`` has: a page each. A name is on its first page."""


def write_reference(folder: Path) -> None:
    """Write a page for each package, which autodoc fills from the docstrings."""
    folder.mkdir(exist_ok=True)
    shown: set[int] = set()
    for name in ("protochain", *(f"protochain.{package}" for package in PACKAGES)):
        module = import_module(name)
        own = {each: value for each in module.__all__ if id(value := getattr(module, each)) not in shown}
        shown |= {id(value) for value in own.values()}
        called = [each for each, value in own.items() if isroutine(value) or isclass(value)]
        lines = [name, "=" * len(name), "", f".. automodule:: {name}", ""]
        if called:
            lines[-1:] = [f"   :members: {', '.join(called)}", ""]
        for each in sorted(own.keys() - called):
            if not ismodule(own[each]):
                lines += [f".. autodata:: {name}.{each}", "   :no-value:", ""]
        page, text = folder / f"{name}.rst", "\n".join(lines)
        if not page.exists() or page.read_text() != text:  # else Sphinx would read it again
            page.write_text(text)


def as_mathml(translator: HTML5Translator, node: nodes.math | nodes.math_block) -> None:
    """Write mathematics as MathML, which browsers draw by themselves."""
    is_block = isinstance(node, nodes.math_block)
    made = convert(node.astext(), display="block" if is_block else "inline")
    translator.body.append(f'<div class="math">{made}</div>' if is_block else made)
    raise nodes.SkipNode


def plain_output(app: Sphinx, doctree: nodes.document) -> None:
    """Blocks of pages that name no language are what a terminal prints: no colours, as of Python."""
    if str(doctree.get("source", "")).endswith(".md"):
        for block in doctree.findall(nodes.literal_block):
            if block.get("language", "default") in ("default", "none", "python3"):
                block["language"] = "text"


ROLES = (
    ('role="heading"', 'role="heading" aria-level="2"'),  # A role of heading requires its level.
    ('role="list" class="citation-list"', 'class="citation-list"'),  # Its children are not items of a list.
    ('class="indextable', 'role="presentation" class="indextable'),  # A table for the layout of an index.
    ('class="output text_html"', 'tabindex="0" class="output text_html"'),  # They scroll if they are wide.
    ('class="table-wrapper', 'tabindex="0" class="table-wrapper'),
    ('<div class="math', '<div tabindex="0" class="math'),
)
OPTION = re.compile(r"(?<=[\s>\[(|])--?[A-Za-z][\w-]*")


def repair_page(app: Sphinx, name: str, template: str, context: dict[str, Any], doctree: Any) -> None:
    """Correct the roles that the theme gives, and keep options such as --reference on one line."""
    for key in ("body", "furo_navigation_tree"):
        text = context.get(key) or ""
        for wrong, right in ROLES:
            text = text.replace(wrong, right)
        context[key] = re.sub(r"<(pre|code)\b.*?</\1>", _mark_options, text, flags=re.S)


def _mark_options(code: re.Match[str]) -> str:
    return OPTION.sub(r'<span class="option">\g<0></span>', code[0])


def setup(app: Sphinx) -> None:
    """Write the reference, in the folder that is built from; mathematics; plain output; repairs."""
    app.connect("config-inited", lambda app, _: write_reference(Path(app.srcdir) / "analysis/site/reference"))
    app.connect("doctree-read", plain_output)
    app.add_html_math_renderer("mathml", (as_mathml, None), (as_mathml, None))
    app.connect("html-page-context", repair_page, priority=900)  # After the theme.
