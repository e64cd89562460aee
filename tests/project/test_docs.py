"""What the pages and docstrings say is there: links, names, options, parameters, figures, the reference."""

import ast
import importlib.util
import inspect
import re
import tomllib
from enum import Enum

import pytest
import yaml
from fixtures.command_line import COMMANDS
from fixtures.public_names import PUBLIC
from fixtures.samples import ROOT
from fixtures.texts import DOCS, blocks
from numpydoc.validate import validate

import protochain as pc

PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "analysis").rglob("*.md")])
SYNOPSIS, THEORY = DOCS / "commands.md", DOCS / "theory.md"
OPTIONAL = {"ES01", "EX01", "SA01"}
"""Sections that numpydoc asks for and short docstrings do without: extended summary, examples, see also."""
DOCUMENTED = {
    f"{value.__module__}.{value.__qualname__}"
    for value in PUBLIC.values()
    if (inspect.isfunction(value) or inspect.isclass(value))
    and not (getattr(value, "_is_protocol", False) or (inspect.isclass(value) and issubclass(value, Enum)))
}
"""Public functions and classes, by where they are defined, but enumerations and protocols."""


def page_name(path):
    return str(path.relative_to(ROOT))


def section(path, heading):
    """The text under a heading of the second level."""
    return re.search(rf"^## {heading}\n(.*?)(?=^## |\Z)", path.read_text(), re.MULTILINE | re.DOTALL)[1]


def anchors(path):
    """What GitHub makes of the headings of a page."""
    prose = re.sub(r"^```.*?^```$", "", path.read_text(), flags=re.MULTILINE | re.DOTALL)
    headings = re.findall(r"^#+ (.*)$", prose, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


def is_there(page, link):
    name, _, anchor = link.partition("#")
    target = page.parent / name if name else page
    return target.exists() and (not anchor or anchor in anchors(target))


@pytest.mark.parametrize("page", PAGES, ids=page_name)
def test_links_and_pictures_are_there(page):
    links = [link for link in re.findall(r"\]\(([^)\s]+)\)", page.read_text()) if "://" not in link]
    assert [link for link in links if not is_there(page, link)] == []


@pytest.mark.parametrize("page", PAGES, ids=page_name)
def test_tests_and_benchmarks_that_are_named_are_there(page):
    named = re.findall(r"\b(?:tests|analysis/benchmarks)/[a-z_/]+\.(?:py|csv)\b", page.read_text())
    assert [name for name in named if not (ROOT / name).exists()] == []


@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "python")], ids=page_name)
def test_python_examples_compile_and_name_what_there_is(page):
    for block in blocks(page, "python"):
        compile(block, page_name(page), "exec")
        for node in ast.walk(ast.parse(block)):
            if isinstance(node, ast.Attribute) and getattr(node.value, "id", "") == "pc":
                assert node.attr in pc.__all__, f"{page_name(page)}: pc.{node.attr}"


def options_of(command):
    return {name for option in COMMANDS[command].params for name in (*option.opts, *option.secondary_opts)}


def calls(block):
    """Commands of each line and the options written there; lines that are indented go on with the last."""
    commands, above = [], []
    for line in block.splitlines():
        called = re.match(r"protochain (\w+)", line)
        if called:
            commands = [called[1]]
            above += commands
        elif "of these also" in line:
            commands = above
        elif not line.startswith(" "):
            commands = []
        for command in commands:
            yield command, re.findall(r"(?<![\w-])--?[a-z][a-z-]*", line.partition(" #")[0])


def test_the_synopsis_has_every_command_and_its_options_exist():
    written = [call for block in blocks(SYNOPSIS, "") for call in calls(block)]
    shown = {command for command, _ in written}
    assert {name for name, command in COMMANDS.items() if not command.hidden} <= shown <= {*COMMANDS}
    for command, options in written:
        assert set(options) <= options_of(command), command


def test_names_in_the_theory_exist():
    parts = "articulate|chain|mechanics|multibody|dynamics|minimisers|energies|structure|comparison"
    names = set(re.findall(rf"`((?:{parts})\.[\w.]+)`", THEORY.read_text()))
    assert len(names) > 40
    assert sorted(name for name in names if not resolves(f"protochain.{name}")) == []


def resolves(name):
    """Whether a dotted name is a module, or can be looked up from one."""
    try:
        found(name)
    except (ImportError, AttributeError):
        return False
    return True


def found(name):
    head, _, last = name.rpartition(".")
    try:
        return importlib.import_module(name)
    except ImportError:
        if not head:
            raise
        return getattr(found(head), last)


def test_docstrings_keep_the_rules_of_numpydoc():
    found = {name: validate(name)["errors"] for name in DOCUMENTED}
    assert [(name, e) for name, errors in found.items() for e in errors if e[0] not in OPTIONAL] == []


def test_every_public_name_says_what_it_is():
    for name, value in PUBLIC.items():
        if isinstance(value, type) or inspect.isfunction(value):
            first = (inspect.getdoc(value) or "").split("\n")[0]
            assert first.endswith("."), f"{name}: {first!r}"


def test_citation_is_of_this_version():
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert (cited["title"], cited["version"]) == (project["name"], project["version"])
    assert cited["license"] == project["license"]
    assert cited["authors"] == project["authors"]
    for work in cited["references"]:
        assert {"type", "title", "authors", "journal", "volume", "start", "year"} == {*work} - {"doi"}


def test_publications_of_programs_have_their_doi():
    """At least 20 programs, all dependencies with a publication among them."""
    page = (DOCS / "programs.md").read_text()
    rows = re.findall(
        r"^\| ([^|]+?) \| ([^|]+) \| \[([^]]+)\]\(https://doi\.org/([^)]+)\) \|$", page, re.MULTILINE
    )
    assert all(shown == target and re.fullmatch(r"10\.\d{4,}/\S+", target) for _, _, shown, target in rows)
    assert len({target for *_, target in rows}) == len(rows) >= 20
    used = "gemmi matplotlib MDAnalysis mdtraj numba numpy openmm pandas PeptideBuilder scipy tmtools"
    named = " ".join(name for name, *_ in rows).lower()
    assert [name for name in used.lower().split() if name not in named] == []
