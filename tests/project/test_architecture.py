"""The rules of CONTRIBUTING.md that a machine can check."""

import ast
import functools
import importlib
from graphlib import TopologicalSorter

import pytest
from fixtures.samples import ROOT

import protochain

PACKAGE = ROOT / "protochain"
MODULES = sorted(path for path in PACKAGE.rglob("*.py"))

CHAIN = {"core", "ligands", "structure", "energies", "mechanics"}
MAY_IMPORT = {
    "core": set(),
    "mechanics": {"core"},
    # The wing of mechanisms.
    "mechanisms": {"core", "mechanics"},
    # The wing of proteins.
    "ligands": {"core"},
    "structure": {"core", "ligands"},
    "results": {"core", "structure"},
    "energies": {"core", "structure"},
    "chains": CHAIN,
    "dynamics": {"chains", "results", *CHAIN},
    "validation": {"chains", *CHAIN},
    "minimisers": {"chains", "dynamics", "validation", "results", *CHAIN},
    "relaxation": {"chains", "validation", "minimisers", "results", *CHAIN},
    "comparison": {"chains", "validation", "minimisers", "relaxation", "results", *CHAIN},
    "batches": {"chains", "validation", "minimisers", "relaxation", "results", "comparison", *CHAIN},
    "searching": {
        "chains", "dynamics", "validation", "minimisers", "results", "comparison", "batches", *CHAIN,
    },
    "cli": {
        "chains", "dynamics", "validation", "minimisers", "relaxation", "results", "comparison", "batches",
        "searching", *CHAIN,
    },
}  # fmt: skip
"""What each room may import: the wings of proteins and of mechanisms stand on one core, and know nothing of
each other."""
MOST_ARROWS = 83
"""Between rooms; with more, nobody keeps the plan in mind."""
MOST_LINES = 74_087
"""Of the package. A capability arrives with something that goes; more takes a reason in the commit. The
files of restraints, MJCF and armature came with the rejected results. The bounds of KCM and the kinds of
terminal lines came later. Quality against a reference, caps, salt, poses, NEF and
energies by name followed."""
OPENMM_BELONGS_IN = {"structure", "energies", "minimisers/openmm_reference.py"}


@functools.cache
def imports(path):
    """Absolute names imported by a module, for types alone or not."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            found.update(f"{node.module}.{alias.name}" for alias in node.names)
    return found


def part_of(path):
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def parts_imported(path):
    """Parts of the package that a module imports, its own left out."""
    parts = {name.split(".")[1] for name in imports(path) if name.startswith("protochain.")}
    return parts - {part_of(path)}


def test_imports_point_one_way():
    for path in MODULES:
        if part_of(path) not in ("__init__", "__main__"):
            assert parts_imported(path) <= MAY_IMPORT[part_of(path)], path


def test_the_plan_is_simple():
    """Rooms are below one another in one order, and few import each other."""
    TopologicalSorter({room: seen - {room} for room, seen in MAY_IMPORT.items()}).prepare()
    assert len({(part_of(path), other) for path in MODULES for other in parts_imported(path)}) <= MOST_ARROWS


def test_the_package_keeps_its_budget():
    assert sum(len(path.read_text().splitlines()) for path in MODULES) <= MOST_LINES


def test_motion_stands_on_bodies_that_do_not_know_of_it():
    for path in (PACKAGE / "mechanics" / "multibody").rglob("*.py"):
        assert not any(name.startswith("protochain.mechanics.motion") for name in imports(path))


def test_openmm_is_imported_only_where_it_belongs():
    for path in MODULES:
        if not path.relative_to(PACKAGE).as_posix().startswith(tuple(OPENMM_BELONGS_IN)):
            assert not {name for name in imports(path) if name.split(".")[0] == "openmm"}, path


def test_kernels_are_compiled_with_one_set_of_settings():
    """They are global in numba: kernels compiled before a module made them would round otherwise."""
    takes_njit = {path.name for path in MODULES if "numba.njit" in imports(path)}
    assert takes_njit == {"compilation.py"}


def test_python_is_started_in_one_place():
    """Elsewhere it might forget to leave out the folder that it is started in."""
    starts = {path.name for path in MODULES if "sys.executable" in path.read_text()}
    assert starts == {"processors.py", "compile_helpers.py"}  # The latter looks whether it is a Python.


MESSAGES = {"message", "messages", "repairs", "changes", "parts"}
"""Attributes, parameters and keys that hold what is said to people, or are told by it."""
READ = {
    "startswith", "endswith", "removeprefix", "removesuffix", "partition", "rpartition", "replace", "find",
    "index", "count", "split", "rsplit", "match", "fullmatch", "search", "sub", "findall", "finditer",
}  # fmt: skip
"""Methods, of texts and of patterns, that look into a text; ``split()`` alone only joins lines."""


@functools.cache
def refusals():
    """Names of the exceptions of the package, all of whose texts are its own."""
    bases = {
        node.name: {getattr(base, "id", "") for base in node.bases}
        for path in MODULES
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.ClassDef)
    }
    found = {"ProtochainError"}
    while more := {name for name, of in bases.items() if of & found} - found:
        found |= more
    return found


class Sentences:
    """Which expressions of a module are sentences that another wrote, and where it looks into them.

    Sentences are the texts of our exceptions, ``message`` and the like as attributes, parameters and keys,
    what is made of them alone, and what functions of the module are given of that.
    """

    def __init__(self, source, ours):
        self.tree = ast.parse(source)
        self.parameters = {
            node.name: [each.arg for each in node.args.args if each.arg not in ("self", "cls")]
            for node in ast.walk(self.tree)
            if isinstance(node, ast.FunctionDef)
        }
        self.of_function = {name: {*given} & MESSAGES for name, given in self.parameters.items()}
        self.ours, self.found = ours, set()
        before = None
        while before != self.of_function:
            before = {name: {*given} for name, given in self.of_function.items()}
            self.walk(self.tree, set())

    def walk(self, node, known):
        if isinstance(node, ast.FunctionDef | ast.Lambda):
            name = getattr(node, "name", "")
            known = {*known, *self.of_function.get(name, ())}
        elif isinstance(node, ast.ExceptHandler) and node.name:
            if self.ours & {each.id for each in ast.walk(node.type) if isinstance(each, ast.Name)}:
                known = {*known, node.name}
        elif isinstance(node, ast.ListComp | ast.SetComp | ast.GeneratorExp | ast.DictComp):
            known = {*known}
            for each in node.generators:
                self.name(each.target, each.iter, known)
        elif isinstance(node, ast.Assign):
            for target in node.targets:
                self.name(target, node.value, known)
        elif isinstance(node, ast.For | ast.NamedExpr):
            self.name(node.target, getattr(node, "iter", None) or node.value, known)
        elif isinstance(node, ast.Call):
            self.call(node, known)
        elif isinstance(node, ast.Compare):
            for operator, right in zip(node.ops, node.comparators, strict=True):
                if isinstance(operator, ast.In | ast.NotIn) and self.said(right, known):
                    self.found.add(ast.unparse(node))
        for child in ast.iter_child_nodes(node):
            self.walk(child, known)

    def name(self, target, value, known):
        if isinstance(target, ast.Name) and self.said(value, known):
            known.add(target.id)

    def call(self, node, known):
        name = getattr(node.func, "attr", getattr(node.func, "id", ""))
        if isinstance(node.func, ast.Attribute) and name in READ:
            text = self.said(node.func.value, known) and (node.args or name != "split")
            if text or any(self.said(each, known) for each in node.args):
                self.found.add(ast.unparse(node))
        for parameter, value in zip(self.parameters.get(name, ()), node.args, strict=False):
            if self.said(value, known):
                self.of_function[name].add(parameter)

    def said(self, node, known):
        """Whether an expression is such a sentence, or several."""
        if isinstance(node, ast.Name):
            return node.id in known
        if isinstance(node, ast.Attribute):
            return node.attr in MESSAGES
        if isinstance(node, ast.Subscript):
            key = getattr(node.slice, "value", None)
            return key in MESSAGES if isinstance(key, str) else self.said(node.value, known)
        if isinstance(node, ast.Call):
            name = getattr(node.func, "attr", getattr(node.func, "id", ""))
            if name in ("describe", "describe_residue", "told"):
                return True
            if name in ("str", "join", "sorted", "list", "tuple"):
                return any(self.said(each, known) for each in node.args)
            text = getattr(node.func, "value", None)
            return name in ("lower", "upper", "strip") and text is not None and self.said(text, known)
        if isinstance(node, ast.JoinedStr):
            return all(
                self.said(each.value, known) for each in node.values if isinstance(each, ast.FormattedValue)
            ) and not any(isinstance(each, ast.Constant) for each in node.values)
        if isinstance(node, ast.IfExp):
            return self.said(node.body, known) or self.said(node.orelse, known)
        if isinstance(node, ast.ListComp | ast.GeneratorExp):
            inner = {*known}
            for each in node.generators:
                self.name(each.target, each.iter, inner)
            return self.said(node.elt, inner)
        return False


def test_no_module_reads_what_another_says_to_people():
    """What a module needs to know of another is in values; sentences may change."""
    for path in MODULES:
        assert not Sentences(path.read_text(), refusals()).found, path


@pytest.mark.parametrize(
    "source",
    [
        "told = [line for line in self.structure.repairs if 'hydrogens added' in line]",
        "try: f()\nexcept MechanicsError as error:\n    if _REMEDY in str(error): g()",
        "try: f()\nexcept ProtochainError as error:\n    fail(as_options(str(error)))\n"
        "def as_options(message): return _SPREAD.sub('', message)",
        "def summarised(repairs):\n    for line in repairs:\n        groups[_group(line)].append(line)\n"
        "def _group(line):\n    return 0 if _GAP.fullmatch(line) else 1",
        "if row['message'].startswith('refused'): g()",
        "for line in structure.changes:\n    print(with_options(line))\n"
        "def with_options(line): return re.sub('a', 'b', line)",
        "said = str(solution.message)\nwhere, what = said.split(': ')",
        "return structure.describe(atom).removeprefix('atom ')",
    ],
)
def test_readers_of_sentences_are_found(source):
    assert Sentences(source, refusals() | {"MechanicsError"}).found


def test_no_modules_import_one_another_in_a_circle():
    """Imports within functions count too; a circle is a CycleError that names its modules."""
    dotted = {".".join(path.relative_to(ROOT).with_suffix("").parts): path for path in MODULES}
    paths = {name.removesuffix(".__init__"): path for name, path in dotted.items()}
    graph = {
        module: {name if name in paths else name.rpartition(".")[0] for name in imports(path)} & paths.keys()
        for module, path in paths.items()
    }
    assert graph["protochain.chains.chain"] >= {"protochain.chains.hinges", "protochain.mechanics.multibody"}
    TopologicalSorter(graph).prepare()


def test_tests_lie_in_folders_as_in_the_package_and_share_only_fixtures():
    tests = ROOT / "tests"
    parts = {path.name for path in PACKAGE.iterdir() if path.is_dir()}
    parts |= {"project", "records", "scenes", "studies", "tasks"}
    for path in tests.rglob("*.py"):
        assert not any(name.startswith(("test_", "conftest")) for name in imports(path)), path
        if path.name.startswith("test_"):
            folder = path.relative_to(tests).parts[:-1]
            of = path.stem.removeprefix("test_")
            assert (PACKAGE / f"{of}.py").exists() if not folder else folder[0] in parts, path


def test_every_public_name_is_there_and_is_what_it_says():
    for name in protochain.__all__:
        assert getattr(protochain, name) is not None
    for name in ("minimise", "minimize", "energy", "pose", "compare"):
        assert callable(getattr(protochain, name))
    # A subpackage of the same name would shadow the function once it is imported.
    for sub in ("energies", "minimisers", "comparison", "structure"):
        importlib.import_module(f"protochain.{sub}")
    assert callable(protochain.energy) and callable(protochain.minimise)
    with pytest.raises(AttributeError, match="nonsense"):
        protochain.nonsense  # noqa: B018
