"""Every command's results against its schema: what is printed, the rows of tables, the names in folders."""

import csv
import json
from collections import Counter

import jsonschema
import pytest
from fixtures.command_line import COMMANDS, run
from fixtures.samples import STRUCTURES

import protochain as pc
from protochain.cli.contracts import CONTRACTS
from protochain.cli.schema import digest, schema_of, versions
from protochain.core.storage import json_text

pytestmark = pytest.mark.usefixtures("interruptible")


def refused(constant):
    raise AssertionError(f"{constant} is no JSON")


def valid(command, values, of=None):
    """Check values, or those of a table or folder, against the schema of a command."""
    whole = schema_of(command)
    part = whole if of is None else {**whole["$defs"][of], "$schema": whole["$schema"]}
    jsonschema.Draft202012Validator.check_schema(whole)
    jsonschema.Draft202012Validator(part).validate(values)
    return values


def rows(path):
    """Rows of a table as a reader takes them: an empty cell is nothing, and numbers are numbers."""
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def typed(command, of, path):
    """Rows of a table, each cell as its schema says; text that is no such number stays text, and fails."""
    items = schema_of(command)["$defs"][of]["items"]
    properties = {}
    for each in items.get("anyOf", [items]):
        properties |= each["properties"]
        others = each["additionalProperties"]

    def value(name, cell):
        if cell == "":
            return None
        kinds = properties.get(name, others)["type"]
        if "boolean" in kinds:
            return {"True": True, "False": False}.get(cell, cell)
        if "string" in kinds:
            return cell
        try:
            return json.loads(cell, parse_constant=refused)
        except ValueError:
            return cell

    found = [{name: value(name, cell) for name, cell in each.items()} for each in rows(path)]
    assert found, f"{path} has no row"
    return found


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Structures to work on: a peptide, the same moved, and frames of it."""
    folder = tmp_path_factory.mktemp("made")
    peptide = pc.from_sequence("GAVSDK")
    pc.save(peptide, folder / "peptide.pdb")
    moved = peptide.with_positions(peptide.positions + 0.01)
    pc.save(moved, folder / "moved.pdb")
    pc.save([peptide, moved], folder / "models.pdb")
    return folder


@pytest.fixture
def told(made, tmp_path, monkeypatch, capsys):
    """What a command prints with --json, in a folder of its own with the structures."""
    monkeypatch.chdir(tmp_path)
    for each in made.iterdir():
        (tmp_path / each.name).write_bytes(each.read_bytes())

    def call(command, *arguments):
        run(command, *arguments, "--json")
        return valid(command, json.loads(capsys.readouterr().out, parse_constant=refused))

    return call


def tables(command, folder, **named):
    """Check all tables of a folder, and the names in it; or the tables given by option."""
    known = schema_of(command)["$defs"]
    if folder is not None:
        there = [path for path in folder.rglob("*") if path.is_file() and not path.name.startswith(".")]
        valid(command, [path.relative_to(folder).as_posix() for path in there], "folder")
        named = {path.name: path for path in there if path.name in known}
    for name, path in named.items():
        valid(command, typed(command, name, path), name)
    return named


def test_every_command_with_json_has_a_schema_and_its_version():
    with_json = {name for name, each in COMMANDS.items() if any(p.name == "as_json" for p in each.params)}
    assert {*CONTRACTS} == with_json - {"minimize"} == {*versions()}


def test_a_change_of_results_has_a_new_version():
    """If this fails, results have changed: say so in CHANGELOG.md, and run ``python tests/schemas.py``."""
    assert {command: digest(command) for command in CONTRACTS} == {
        command: its for command, (_, its) in versions().items()
    }


def test_versions_are_counted_and_none_is_taken_back():
    from schemas import FILE

    lines = [line.split() for line in FILE.read_text(encoding="utf-8").splitlines()]
    seen = Counter()
    for command, version, _ in lines:
        seen[command] += 1
        assert int(version) == seen[command]


def test_what_is_not_finite_is_null():
    values = {"a": [float("nan"), {"b": (float("inf"), 1.5)}], "c": -float("inf")}
    assert json.loads(json_text(values), parse_constant=refused) == {
        "a": [None, {"b": [None, 1.5]}],
        "c": None,
    }


def test_schema_prints_what_is_there(capsys):
    run("schema", "info")
    assert json.loads(capsys.readouterr().out) == schema_of("info")
    run("schema")
    assert {line.split()[0] for line in capsys.readouterr().out.splitlines()} == {*CONTRACTS}


def test_minimise(told, tmp_path):
    one = told("minimise", "peptide.pdb", "--trace", "trace.csv", "--report", "report.html")
    assert one["n_residues"] == 6
    tables("minimise", None, **{"--trace": tmp_path / "trace.csv"})
    starts = told("minimise", "peptide.pdb", "--starts", "2", "--method", "lbfgs", "--max-evaluations", "40")
    assert len(starts["starts"]) == 2
    several = told("minimise", "models.pdb", "--model", "all", "--max-evaluations", "20")
    assert [each["model"] for each in several["models"]] == [1, 2]


def test_relax(told, tmp_path):
    assert told("relax", "peptide.pdb")["method"] == "relax"
    folder = told("relax", "peptide.pdb", "moved.pdb", "--workers", "1")
    assert folder["n_structures"] == 2
    assert {"relaxed.csv", "traces.csv", "statistics.csv"} <= {*tables("relax", tmp_path / "relaxed")}
    frames = told("relax", "models.pdb", "--frames", "all", "--workers", "1", "-o", "frames.pdb")
    assert frames["written"] == 2
    tables("relax", None, **{"--trajectory": tmp_path / "frames.csv"})


def test_relax_with_a_ligand_and_an_interface(told, tmp_path):
    lines = (tmp_path / "peptide.pdb").read_text().splitlines()
    x, y, z = max(10.0 * pc.load("peptide.pdb").positions, key=lambda place: place[0])
    for k, (name, off) in enumerate({"C1": 3.0, "C2": 4.5, "O1": 5.9}.items()):
        place = f"{x + off:8.3f}{y:8.3f}{z:8.3f}"
        lines.insert(
            -1, f"HETATM{900 + k:5d}  {name:<3} LIG B   1    {place}  1.00  0.00           {name[0]}"
        )
    (tmp_path / "complex.pdb").write_text("\n".join(lines) + "\n")
    given = ["complex.pdb", "--ligand", "LIG=CCO"]
    found = told("relax", *given, "--ligand-out", "out.sdf", "--posebusters", "--interface", "A:B")
    assert found["ligands"][0]["name"] == "LIG" and found["interface_contacts_end"] is not None
    assert told("validate", *given)["results"][0]["ligands"][0]["contacts"] > 0
    told("relax", *given, "peptide.pdb", "--interface", "A:B", "--workers", "1", "-o", "folder")
    tables("relax", tmp_path / "folder")


def test_compare(told, tmp_path):
    found = told(
        "compare", "peptide.pdb", "--methods", "lbfgs,cartesian", "--reference", "moved.pdb", "-o", "folder"
    )
    assert [each["method"] for each in found["results"]] == ["lbfgs", "cartesian"]
    assert len(tables("compare", tmp_path / "folder")) == len(CONTRACTS["compare"].tables)
    assert json.loads((tmp_path / "folder" / "summary.json").read_text()) == {
        name: value for name, value in found.items() if name != "output"
    }


def test_batch(told, tmp_path):
    assert told("batch", "peptide.pdb", "--dry-run")["structures"][0]["methods"] == ["cartesian"]
    (tmp_path / "bad.pdb").write_text("END\n")
    told("batch", "peptide.pdb", "bad.pdb", "--methods", "lbfgs,relax", "--workers", "1", "-o", "folder")
    assert len(tables("batch", tmp_path / "folder")) == 3


@pytest.mark.parametrize(
    "more", [[], ["--pull", "A:1:N-A:5:C", "--thermostat", "none"], ["--thermostat", "hmc"]]
)
def test_simulate(told, tmp_path, more):
    found = told("simulate", "peptide.pdb", "--steps", "60", "--every", "20", "-o", "folder", *more)
    assert found["steps"] == 60
    tables("simulate", tmp_path / "folder")


def test_modes(told, tmp_path):
    assert told("modes", "peptide.pdb", "--modes", "4", "--to", "moved.pdb", "-o", "folder")["n_modes"] == 4
    assert len(tables("modes", tmp_path / "folder")) == 2


@pytest.mark.parametrize(("method", "evaluations"), [("hopping", 2000), ("tempering", 6_000)])
def test_search(told, tmp_path, method, evaluations):
    given = ["--method", method, "--walkers", "1", "--replicas", "2", "--workers", "1", "-o", "folder"]
    assert told("search", "GAVS", *given, "--evaluations", evaluations)["method"] == method
    assert len(tables("search", tmp_path / "folder")) == (1 if method == "hopping" else 3)


def test_mutate(told, tmp_path):
    assert told("mutate", "peptide.pdb", "A:V3G", "-o", "g.pdb")["mutations"] == "A:V3G"
    table = tmp_path / "scan.csv"
    told("mutate", "peptide.pdb", "--scan", "A:3", "--workers", "1", "-o", table)
    assert len(tables("mutate", None, **{"--scan": table})) == 1


def test_scan(told, tmp_path):
    given = ["scan", "peptide.pdb", "phi A:3=-60,60", "-o", tmp_path / "scan.csv"]
    for more in ([], ["--relax", "--solvent", "vacuum"]):
        assert told(*given, *more)["n_points"] == 2
        assert len(tables("scan", None, **{"--output": tmp_path / "scan.csv"})) == 1


def test_validate(told, tmp_path):
    options = {f"--{name}": tmp_path / f"{name}.csv" for name in ("csv", "residues", "changes")}
    (tmp_path / "bad.pdb").write_text("END\n")
    given = [word for pair in options.items() for word in pair]
    found = told("validate", "peptide.pdb", "bad.pdb", "--reference", "moved.pdb", *given)
    assert [set(each) == {"file", "message"} for each in found["results"]] == [False, True]
    tables("validate", None, **options)
    told("validate", "models.pdb", "--frames", "all", "--workers", "1", "--csv", "frames.csv")
    tables("validate", None, **{"--trajectory": tmp_path / "frames.csv"})


def test_validate_of_nucleotides(told):
    assert told("validate", STRUCTURES / "1ysa.pdb")["results"][0]["nucleotides"]


def test_score(told, tmp_path):
    options = {f"--{name}": tmp_path / f"{name}.csv" for name in ("csv", "residues")}
    given = [word for pair in options.items() for word in pair]
    found = told("score", STRUCTURES / "3i40.pdb", "peptide.pdb", *given)
    assert [set(each) == {"file", "message"} for each in found["results"]] == [False, True]
    tables("score", None, **options)


@pytest.mark.parametrize(
    "more", [["--by", "term"], ["--by", "residue"], ["--by", "pair"], ["--between", "A:1,A:3"]]
)
def test_energy(told, tmp_path, more):
    told("energy", "peptide.pdb", *more, "-o", "table.csv")
    tables("energy", None, **{"--output": tmp_path / "table.csv"})


def test_energy_of_frames(told, tmp_path):
    for number, more in enumerate(([], ["--between", "A:1,A:3"])):
        table = tmp_path / f"frames{number}.csv"
        told("energy", "models.pdb", "--frames", "all", "--workers", "1", "-o", table, *more)
        tables("energy", None, **{"--trajectory": table})


def test_rmsd(told, tmp_path):
    (tmp_path / "bad.pdb").write_text("END\n")
    found = told("rmsd", "peptide.pdb", "models.pdb", "bad.pdb", "-o", "table.csv")
    assert len(found["results"]) == 3
    tables("rmsd", None, **{"--output": tmp_path / "table.csv"})
    told("rmsd", "peptide.pdb", "models.pdb", "--frames", "all", "--workers", "1", "-o", "frames.csv")
    tables("rmsd", None, **{"--trajectory": tmp_path / "frames.csv"})


def test_info(told):
    assert told("info", "peptide.pdb")["n_residues"] == 6
