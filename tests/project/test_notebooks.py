"""The notebooks: built on public names (as the benchmarks), run to their last assertion; what they show."""

import ast
import importlib.util
import json
import re

import pytest
from fixtures.public_names import BENCH, PACKAGES
from fixtures.samples import ROOT
from fixtures.texts import cells, program
from fixtures.waiting import HANG

from bench.scenes import SCENES, run

LONG = sorted((ROOT / "analysis" / "notebooks").glob("*.ipynb"))
OF_SCENES = sorted((ROOT / "analysis" / "scenes").glob("*.ipynb"))
ALONE = {"helix"}
"""Notebooks among those of scenes that are about proteins."""
NOTEBOOKS = [*LONG, *OF_SCENES]
BENCHMARKS = sorted((ROOT / "analysis" / "benchmarks").glob("*.py"))
PUBLIC = {package.__name__: set(package.__all__) for package in (*PACKAGES, *BENCH)}
PUBLIC["bench.files"] = {"damage", "fate", "file_kinds", "judge"}
DRAWING = {
    "bench.studies", "bench.studies.omissions", "bench.studies.precision.curves",
    "bench.studies.stability.page", "protochain.comparison.plots", "protochain.core.figure",
    "protochain.core.palette", "protochain.relaxation.record", "protochain.results.figures",
    "protochain.results.viewer", "protochain.structure.write",
}  # fmt: skip
"""Modules whose public names benchmarks also use, to draw figures from tables."""
OURS = {"protochain", "bench"}
FULL, QUICK = "QUICK = False", "QUICK = True"
"""Line of the notebooks of scenes, and the one that the tests put in its place."""

MOST_BYTES = 300_000

STORED = 1e-4
"""Relative, of the energies that a notebook shows, which have few digits."""

QUICKEST = {"01-first-steps"}
"""What the fast tests run; scenes run by themselves, too (``test_scenes.py``)."""

where = importlib.util.spec_from_file_location("remake", ROOT / "analysis" / "remake.py")
remake = importlib.util.module_from_spec(where)
where.loader.exec_module(remake)

every_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def test_all_ten_are_there():
    assert [path.name[:3] for path in LONG] == [f"{k:02}-" for k in range(1, 11)]


def test_every_scene_has_one():
    """Each runs its scene, in full unless the tests ask for the quick one."""
    assert {path.stem for path in OF_SCENES} == set(SCENES) | ALONE
    for path in OF_SCENES:
        code = cells(path, "code")
        assert FULL in code[0].splitlines()
        assert path.stem in ALONE or f'run("{path.stem}", quick=QUICK)' in code[0]


@every_notebook
def test_it_is_committed_plain(path):
    """As one command writes it, with what cells show, and a stamp of what they were."""
    text = path.read_text(encoding="utf-8")
    notebook = json.loads(text)
    assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)
    assert notebook["metadata"].pop(remake.STAMP)["code"]
    assert notebook["metadata"] == {"kernelspec": {"display_name": "Python 3", "name": "python3"}}
    assert [cell["id"] for cell in notebook["cells"]] == [
        f"cell-{k:02d}" for k in range(1, len(notebook["cells"]) + 1)
    ]
    count = 0
    for cell in notebook["cells"]:
        assert cell["metadata"] == {}
        if cell["cell_type"] == "code":
            count += 1
            assert cell["execution_count"] == count
            assert all(output["output_type"] != "error" for output in cell["outputs"])
    assert len(text.encode()) < MOST_BYTES
    assert '"image/png"' in text or path in LONG
    assert any(cell.get("outputs") for cell in notebook["cells"])
    assert not re.search(r"/(?:home|work|tmp|root|usr)/", re.sub(r'"image/png": "[^"]*"', "", text))


@every_notebook
def test_what_it_shows_is_of_its_code_and_of_its_scene(path):
    """Of the code of both; whether what they stand on gives other numbers now, the slow test below says."""
    assert remake.is_current(json.loads(path.read_text(encoding="utf-8")), path.stem), (
        f"run: python analysis/remake.py {path.stem}"
    )


def test_a_stamp_changes_with_code_and_not_with_words():
    notebook = json.loads((ROOT / "analysis" / "scenes" / "loops.ipynb").read_text(encoding="utf-8"))
    stamp = remake.digest(notebook, "loops")
    first = next(cell for cell in notebook["cells"] if cell["cell_type"] == "code")
    first["source"] = ["# A remark.\n", *first["source"]]
    notebook["cells"][0]["source"] = ["# Other words\n"]
    assert remake.digest(notebook, "loops") == stamp != remake.digest(notebook, "serial")
    first["source"] = [*first["source"], "\nloops = None"]
    assert remake.digest(notebook, "loops") != stamp
    one, two, three = "def f():\n    'Words.'\n    return 1\n", "def f(): return 1  # so", "def f(): return 2"
    assert remake.code_of(one) == remake.code_of(two) != remake.code_of(three)


@pytest.mark.slow
@pytest.mark.parametrize("name", [p.stem for p in OF_SCENES if p.stem not in ALONE], ids=lambda name: name)
def test_its_checks_have_the_values_that_it_shows(name):
    """Run anew, in full: each is off by as much as its bound allows, now and then."""
    path = ROOT / "analysis" / "scenes" / f"{name}.ipynb"
    stored = json.loads(path.read_text(encoding="utf-8"))["metadata"][remake.STAMP]["checks"]
    now = {check.name: check.value for check in run(name).checks}
    assert now.keys() == {check for check, *_ in stored}
    for check, value, bound, kind in stored:
        room = 2.0 * bound * (abs(value) if kind == "relative" else 1.0)
        assert now[check] == pytest.approx(value, rel=1e-12, abs=room), check


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
            ours = {alias.name for alias in node.names if alias.name.split(".")[0] in OURS}
            assert ours <= PUBLIC.keys()
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in OURS:
            names = {alias.name for alias in node.names}
            if path in BENCHMARKS and node.module in DRAWING:
                assert not any(name.startswith("_") for name in names)
                continue
            assert node.module in PUBLIC
            assert names <= PUBLIC[node.module]
        if isinstance(node, ast.Attribute) and ast.unparse(node) != "os._exit":
            assert not re.match(r"_(?!_)", node.attr), node.attr
            assert getattr(node.value, "id", "") != "pc" or node.attr in PUBLIC["protochain"], node.attr


def energies(notebook):
    """Negative numbers from -100 with decimals in the texts of a notebook: seconds are not among them."""
    texts = [
        output.get("text", "") + output.get("data", {}).get("text/plain", "")
        for cell in notebook.cells
        for output in cell.get("outputs", ())
        if output.get("name") != "stderr"  # progress, which is not stored
    ]
    return [float(number) for text in texts for number in re.findall(r"-\d{3,}\.\d+", text)]


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
    stored = energies(notebook)
    if path in OF_SCENES:
        first = next(cell for cell in notebook.cells if cell.cell_type == "code")
        first.source = first.source.replace(FULL, QUICK)
    nbclient.NotebookClient(
        notebook, timeout=HANG, kernel_name="python3", resources={"metadata": {"path": str(path.parent)}}
    ).execute()
    assert sorted(path.parent.iterdir()) == before, "it leaves files behind"
    if path in LONG:
        assert energies(notebook) == pytest.approx(stored, rel=STORED), f"run: remake.py {path.stem}"
