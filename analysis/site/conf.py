"""The pages, notebooks and reference of the repository as a site.

    pip install ".[test]" && sphinx-build -W -c analysis/site . DIR

Pages stay where they are and read as well on GitHub; notebooks are shown as they are stored, none is run.
"""

from importlib import import_module
from inspect import isclass, ismodule, isroutine
from pathlib import Path
from tomllib import loads

HERE = Path(__file__).parent
_project = loads((HERE.parents[1] / "pyproject.toml").read_text())["project"]

project, release, author = _project["name"], _project["version"], _project["authors"][0]["name"]
copyright = author
root_doc = "analysis/site/index"
include_patterns = [
    "README.md", "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md", "analysis/README.md",
    "analysis/docs/**.md", "analysis/site/**", "analysis/notebooks/*.ipynb", "analysis/scenes/*.ipynb",
    "analysis/results/README.md", "analysis/workflows/README.md", "analysis/packaging/README.md",
    "analysis/plugins/README.md",
]  # fmt: skip
extensions = ["myst_nb", "sphinx.ext.autodoc", "numpydoc", "sphinx.ext.mathjax"]

myst_heading_anchors = 4
myst_enable_extensions = ["dollarmath"]
myst_fence_as_directive = ["math"]  # as GitHub has it
nb_execution_mode = "off"  # they are stored with what they show
suppress_warnings = ["myst-nb.lexer"]  # notebooks name no language: all are in Python, which is the default

autodoc_typehints = "none"
autodoc_member_order = "groupwise"
numpydoc_show_class_members = False

html_theme = "furo"
html_title = project
html_extra_path = ["root"]
html_copy_source = False

PACKAGES = (
    "batches", "comparison", "mechanics.motion", "mechanics.multibody", "dynamics", "energies",
    "ligands", "mechanisms", "mechanisms.flexible", "mechanisms.impacts", "minimisers", "relaxation",
    "results", "searching", "structure", "validation",
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


write_reference(HERE / "reference")
