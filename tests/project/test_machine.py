"""Nothing depends on what a machine has or does: OpenMM chooses no platform, and no test watches a clock."""

import ast
import re

import pytest
from fixtures.samples import ROOT
from fixtures.texts import program

SOURCES = [
    *(path for folder in ("protochain", "tests", "analysis") for path in (ROOT / folder).rglob("*.py")),
    *(path for kind in ("*.ipynb", "*.md") for path in (ROOT / "analysis").rglob(kind)),
    ROOT / "README.md",
]
PLATFORM = {"Context": 2, "Simulation": 3, "PDBFixer": 5, "addHydrogens": 3, "addMembrane": 9}
"""What makes contexts, with the place of its platform. (``PDBFixer`` makes them in ``addMissingAtoms`` and
``addMissingHydrogens``, with its own platform; its ``addMembrane`` cannot be given any.)"""
OF_MODELS = {"addHydrogens", "addMembrane"}
"""Methods, whatever the name of their object."""

TOOLS = {"waiting.py", "mutants.py", "kernels.py"}
TESTS = sorted(path for path in (ROOT / "tests").rglob("*.py") if path.name not in TOOLS)
CLOCK = re.compile(r"\b(?:alarm|setitimer|sleep|time|monotonic|perf_counter|Timer|wait_for_timeout)\(")
"""Calls, also in the programs that tests write. (``waiting.py`` has them, and tools that are no tests.)"""


def without_platform(tree):
    """Calls that leave the platform to OpenMM, which chooses the fastest, whether it works or not."""
    origin = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            origin |= {each.asname or each.name.split(".")[0]: each.name for each in node.names}
        elif isinstance(node, ast.ImportFrom):
            origin |= {each.asname or each.name: f"{node.module}.{each.name}" for each in node.names}
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Name | ast.Attribute):
            continue
        called = ast.unparse(node.func)
        first = called.split(".")[0]
        source = origin.get(first, "") + called.removeprefix(first)
        name = source.split(".")[-1]
        if name in PLATFORM and (name in OF_MODELS or source.startswith(("openmm.", "pdbfixer."))):
            given = [each.value for each in node.keywords if each.arg == "platform"]
            given += node.args[PLATFORM[name] : PLATFORM[name] + 1]
            if not given or ast.unparse(given[0]) == "None":
                yield f"line {node.lineno}: {ast.unparse(node)}"


def test_no_platform_is_openmms_choice():
    texts = {path: path.read_text(encoding="utf-8") for path in SOURCES}
    may = [path for path, text in texts.items() if any(f"{name}(" in text for name in PLATFORM)]
    found = {str(path.relative_to(ROOT)): list(without_platform(program(path))) for path in may}
    assert {path: calls for path, calls in found.items() if calls} == {}
    assert len(found) > 20


@pytest.mark.parametrize(
    ("code", "found"),
    [
        ("import openmm; openmm.Context(system, integrator)", 1),
        ("import openmm as mm; mm.Context(system, integrator, None)", 1),
        ("import openmm; openmm.Context(system, integrator, platform, {})", 0),
        ("from openmm.app import Simulation as S; S(topology, system, integrator)", 1),
        ("from openmm import app; app.Simulation(topology, system, integrator, platform=platform)", 0),
        ("modeller.addHydrogens(pH=7.0)", 1),
        ("app.Modeller(topology, x).addHydrogens(pH=7.0, platform=platform)", 0),
        ("import pdbfixer; pdbfixer.PDBFixer(pdbfile=file).addMissingHydrogens()", 1),
        ("from pdbfixer import PDBFixer; PDBFixer(pdbfile=file, platform=platform).addMembrane()", 1),
        ("from protochain.dynamics.result import Simulation; Simulation(trace)", 0),
        ("import multiprocessing; multiprocessing.Context()", 0),
    ],
)
def test_a_call_without_a_platform_is_found(code, found):
    assert len(list(without_platform(ast.parse(code)))) == found


def limits(tree):
    """Limits of time that are numbers: they run out on a busy machine. ``HANG`` of waiting.py does not."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            given = [each.value for each in node.keywords if each.arg == "timeout"]
            if isinstance(node.func, ast.Attribute) and node.func.attr in ("wait", "join", "communicate"):
                given += [each for each in node.args if isinstance(each, ast.Constant)]
            if any(ast.unparse(each) != "HANG" for each in given):
                yield f"line {node.lineno}: {ast.unparse(node)}"


def test_no_test_watches_a_clock():
    found = {}
    for path in TESTS:
        text = path.read_text(encoding="utf-8")
        found[path.name] = [*CLOCK.findall(text), *limits(ast.parse(text))]
    assert {name: calls for name, calls in found.items() if calls} == {}


@pytest.mark.parametrize(
    ("code", "found"),
    [
        ("process.wait(timeout=60)", 1), ("process.wait(timeout=HANG)", 0), ("thread.join(5.0)", 1),
        ("event.wait(HANG)", 0), ("subprocess.run(command, timeout=20)", 1), ("', '.join(names)", 0),
    ],
)  # fmt: skip
def test_a_limit_of_time_is_found(code, found):
    assert len(list(limits(ast.parse(code)))) == found
