"""The notebooks: committed plain, built on public names (as the benchmarks), run to their last assertion."""

import ast
import json
import re

import pytest
from fixtures.public_names import PACKAGES
from fixtures.samples import ROOT

from protochain.scenes import SCENES

LONG = sorted((ROOT / "analysis" / "notebooks").glob("*.ipynb"))
OF_SCENES = sorted((ROOT / "analysis" / "scenes").glob("*.ipynb"))
ALONE = {"helix"}
"""Notebooks beside those of scenes that are no scene of ``protochain scene``: they are about proteins."""
NOTEBOOKS = [*LONG, *OF_SCENES]
BENCHMARKS = sorted((ROOT / "analysis" / "benchmarks").glob("*.py"))
PUBLIC = {package.__name__: set(package.__all__) for package in PACKAGES}
LONGEST = 180
"""Seconds for a cell; each notebook takes less than a minute where nothing else runs."""

FULL, QUICK = "QUICK = False", "QUICK = True"
"""Line of the notebooks of scenes, and the one that the tests put in its place."""

QUICKEST = {"01-first-steps", "04-stability", "serial", "impact"}
"""Two of each kind that the fast tests run; scenes run by themselves, too (``test_scenes.py``)."""

every_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def cells(path, kind):
    """Sources of the cells of a kind."""
    found = json.loads(path.read_text(encoding="utf-8"))["cells"]
    return ["".join(cell["source"]) for cell in found if cell["cell_type"] == kind]


def program(path):
    """All code, as Python reads it: without IPython's magics."""
    if path.suffix == ".py":
        return ast.parse(path.read_text(encoding="utf-8"))
    lines = "\n".join(cells(path, "code")).splitlines()
    return ast.parse("\n".join(line for line in lines if not line.startswith("%")))


def test_all_eight_are_there():
    assert [path.name[:3] for path in LONG] == [f"{k:02}-" for k in range(1, 9)]


def test_every_scene_has_one():
    """Each runs its scene, in full unless the tests ask for the quick one."""
    assert {path.stem for path in OF_SCENES} == set(SCENES) | ALONE
    for path in OF_SCENES:
        code = cells(path, "code")
        assert FULL in code[0].splitlines()
        assert path.stem in ALONE or f'run("{path.stem}", quick=QUICK)' in code[0]


@every_notebook
def test_it_is_committed_plain(path):
    notebook = json.loads(path.read_text(encoding="utf-8"))
    assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)
    assert notebook["metadata"] == {"kernelspec": {"display_name": "Python 3", "name": "python3"}}
    assert [cell["id"] for cell in notebook["cells"]] == [
        f"cell-{k:02d}" for k in range(1, len(notebook["cells"]) + 1)
    ]
    for cell in notebook["cells"]:
        assert cell["metadata"] == {}
        if cell["cell_type"] == "code":
            assert cell["outputs"] == [] and cell["execution_count"] is None


@every_notebook
def test_it_asks_first_and_says_last_what_was_found(path):
    notebook = json.loads(path.read_text(encoding="utf-8"))
    kinds = [cell["cell_type"] for cell in notebook["cells"]]
    assert kinds[0] == kinds[-1] == "markdown" and kinds[-2] == "code"
    text = cells(path, "markdown")
    assert text[0].startswith("# ")
    assert text[-1].startswith("## What was found\n\n") and len(text[-1]) > 300
    assert "assert " in cells(path, "code")[-1]


@pytest.mark.parametrize("path", [*NOTEBOOKS, *BENCHMARKS], ids=lambda path: path.name)
def test_it_uses_public_names_only(path):
    for node in ast.walk(program(path)):
        if isinstance(node, ast.Import):
            ours = {alias.name for alias in node.names if alias.name.split(".")[0] == "protochain"}
            assert ours <= PUBLIC.keys()
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "protochain":
            assert node.module in PUBLIC
            assert {alias.name for alias in node.names} <= PUBLIC[node.module]
        if isinstance(node, ast.Attribute) and ast.unparse(node) != "os._exit":
            assert not re.match(r"_(?!_)", node.attr), node.attr
            assert getattr(node.value, "id", "") != "pc" or node.attr in PUBLIC["protochain"], node.attr


@pytest.mark.parametrize(
    "path",
    [pytest.param(p, marks=() if p.stem in QUICKEST else pytest.mark.slow, id=p.stem) for p in NOTEBOOKS],
)
def test_it_runs(path, tmp_path, monkeypatch):
    nbformat = pytest.importorskip("nbformat")
    nbclient = pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path))
    before = sorted(path.parent.iterdir())
    notebook = nbformat.read(path, as_version=4)
    if path in OF_SCENES:
        first = next(cell for cell in notebook.cells if cell.cell_type == "code")
        first.source = first.source.replace(FULL, QUICK)
    nbclient.NotebookClient(
        notebook, timeout=LONGEST, kernel_name="python3", resources={"metadata": {"path": str(path.parent)}}
    ).execute()
    assert sorted(path.parent.iterdir()) == before, "it leaves files behind"
