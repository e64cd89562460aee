"""The rules of CONTRIBUTING.md that a machine can check."""

import ast
import importlib
import inspect
from graphlib import TopologicalSorter

import pytest
from conftest import ROOT

import protochain

PACKAGE = ROOT / "protochain"
MODULES = sorted(path for path in PACKAGE.rglob("*.py"))

LAYERS = [
    {
        "units",
        "errors",
        "checks",
        "arrays",
        "residues",
        "interrupts",
        "markup",
        "storage",
        "defaults",
        "compilation",
        "ahead",
        "processors",
        "subprocesses",
    },
    {"multibody", "structure", "energies"},
    {"motion"},
    {"mechanisms"},
    {"chain", "hinges", "articulate", "contacts", "frame", "setup"},
    {"dynamics"},
    {"validation"},
    {"minimisers"},
    {"relaxation"},
    {"lab"},
    {"analysis"},
    {"batches", "scenes"},
    {"cli"},
]
OPEN = (
    "analysis",
    "batches",
    "dynamics",
    "energies",
    "lab",
    "mechanisms",
    "minimisers",
    "motion",
    "multibody",
    "relaxation",
    "scenes",
    "structure",
    "validation",
)
PACKAGES = (protochain, *(importlib.import_module(f"protochain.{name}") for name in OPEN))
PUBLIC = {
    f"{package.__name__}.{name}": getattr(package, name)
    for package in PACKAGES
    for name in package.__all__
    if not inspect.ismodule(getattr(package, name))
}
OPENMM_BELONGS_IN = {"structure", "energies", "minimisers/openmm_reference.py"}


def imports(path):
    """Absolute names imported by a module, except under TYPE_CHECKING."""
    found = set()

    def walk(node):
        if isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING":
            return
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            found.update(f"{node.module}.{alias.name}" for alias in node.names)
        for child in ast.iter_child_nodes(node):
            walk(child)

    walk(ast.parse(path.read_text()))
    return found


def layer(part):
    return next(i for i, names in enumerate(LAYERS) if part in names)


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_point_one_way(path):
    own = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
    if own == "__init__":
        return
    for name in imports(path):
        if not name.startswith("protochain."):
            continue
        other = name.split(".")[1]
        assert other == own or layer(other) <= layer(own), f"{own} imports {other}"
        if own == "scenes":
            below = {"analysis", "lab", "mechanisms", "motion", "multibody"}
            assert other in {own, *below} or layer(other) == 0, "scenes know nothing of proteins"
        if own == "lab":
            assert other == own or layer(other) == 0, "the laboratory knows neither proteins nor mechanics"
        if own == "multibody":
            assert other == own or layer(other) == 0, "multibody knows nothing of proteins or energies"
        if own == "motion":
            assert other in ("motion", "multibody") or layer(other) == 0, "motion knows trees only"
        if own == "mechanisms":
            known = ("mechanisms", "motion", "multibody")
            assert other in known or layer(other) == 0, "mechanisms know nothing of proteins or energies"
        assert not (own == "energies" and other == "multibody")
        assert not (own == "structure" and other in ("multibody", "energies"))


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_openmm_is_imported_only_where_it_belongs(path):
    inside = str(path.relative_to(PACKAGE))
    if any(inside.startswith(place) for place in OPENMM_BELONGS_IN):
        return
    assert not {name for name in imports(path) if name.split(".")[0] == "openmm"}


def test_kernels_are_compiled_with_one_set_of_settings():
    """They are global in numba: kernels compiled before a module made them would round otherwise."""
    takes_njit = {path.name for path in MODULES if "numba.njit" in imports(path)}
    assert takes_njit == {"compilation.py"}


def test_python_is_started_in_one_place():
    """Elsewhere it might forget to leave out the folder that it is started in."""
    starts = {path.name for path in MODULES if "sys.executable" in path.read_text()}
    assert starts == {"subprocesses.py", "ahead.py"}  # The latter looks whether it is a Python.


def test_no_modules_import_one_another_in_a_circle():
    """Imports within functions count too; a circle is a CycleError that names its modules."""
    dotted = {".".join(path.relative_to(ROOT).with_suffix("").parts): path for path in MODULES}
    paths = {name.removesuffix(".__init__"): path for name, path in dotted.items()}
    graph = {
        module: {name if name in paths else name.rpartition(".")[0] for name in imports(path)} & paths.keys()
        for module, path in paths.items()
    }
    assert graph["protochain.chain"] >= {"protochain.hinges", "protochain.multibody"}
    TopologicalSorter(graph).prepare()


def test_every_public_name_is_there_and_is_what_it_says():
    for name in protochain.__all__:
        assert getattr(protochain, name) is not None
    for name in ("minimise", "minimize", "energy", "pose", "compare"):
        assert callable(getattr(protochain, name))
    # A subpackage of the same name would shadow the function once it is imported.
    for sub in ("energies", "minimisers", "analysis", "structure"):
        importlib.import_module(f"protochain.{sub}")
    assert callable(protochain.energy) and callable(protochain.minimise)
    with pytest.raises(AttributeError, match="nonsense"):
        protochain.nonsense  # noqa: B018
