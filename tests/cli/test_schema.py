"""Results of commands against their schemas, where they are not among the records, which are checked too."""

import json
from collections import Counter

import jsonschema
import pytest
from fixtures.command_line import COMMANDS, run
from fixtures.samples import STRUCTURES
from fixtures.schemas import refused, tables, valid

import protochain as pc
from protochain.cli.contracts import CONTRACTS
from protochain.cli.schema import digest, schema_of, versions

pytestmark = pytest.mark.usefixtures("interruptible")


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


def test_every_command_with_json_has_a_schema_and_its_version():
    with_json = {name for name, each in COMMANDS.items() if any(p.name == "as_json" for p in each.params)}
    assert {*CONTRACTS} == with_json - {"minimize"} == {*versions()}
    for command in CONTRACTS:
        jsonschema.Draft202012Validator.check_schema(schema_of(command))


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


def test_schema_prints_what_is_there(capsys):
    run("schema", "info")
    assert json.loads(capsys.readouterr().out) == schema_of("info")
    run("schema")
    assert {line.split()[0] for line in capsys.readouterr().out.splitlines()} == {*CONTRACTS}


def test_relax_with_a_ligand_and_an_interface(told, tmp_path):
    lines = (tmp_path / "peptide.pdb").read_text().splitlines()
    x, y, z = max(10.0 * pc.load("peptide.pdb").positions, key=lambda place: place[0])
    for k, (name, off) in enumerate({"C1": 3.0, "C2": 4.5, "O1": 5.9}.items()):
        place = f"{x + off:8.3f}{y:8.3f}{z:8.3f}"
        lines.insert(
            -1, f"HETATM{900 + k:5d}  {name:<3} LIG B   1    {place}  1.00  0.00           {name[0]}"
        )
    (tmp_path / "complex.pdb").write_text("\n".join(lines) + "\n")
    given = ["complex.pdb", "--ligands", "LIG=CCO"]
    found = told("relax", *given, "--ligand-out", "out.sdf", "--posebusters", "--interface", "A:B")
    assert found["ligands"][0]["name"] == "LIG" and found["interface_contacts_end"] is not None
    assert told("validate", *given)["results"][0]["ligands"][0]["contacts"] > 0
    told("relax", *given, "peptide.pdb", "--interface", "A:B", "--workers", "1", "-o", "folder")
    tables("relax", tmp_path / "folder")


def test_batch(told, tmp_path):
    assert told("batch", "peptide.pdb", "--dry-run")["structures"][0]["methods"] == ["cartesian"]
    (tmp_path / "bad.pdb").write_text("END\n")
    told("batch", "peptide.pdb", "bad.pdb", "--methods", "lbfgs,relax", "--workers", "1", "-o", "folder")
    assert len(tables("batch", tmp_path / "folder")) == 2


def test_modes(told, tmp_path):
    assert told("modes", "peptide.pdb", "--modes", "4", "--to", "moved.pdb", "-o", "folder")["n_modes"] == 4
    assert len(tables("modes", tmp_path / "folder")) == 2


def test_validate(told, tmp_path):
    options = {f"--{name}": tmp_path / f"{name}.csv" for name in ("csv", "residues", "changes")}
    (tmp_path / "bad.pdb").write_text("END\n")
    given = [word for pair in options.items() for word in pair]
    found = told("validate", "peptide.pdb", "bad.pdb", "--reference", "moved.pdb", *given)
    assert [set(each) == {"file", "message"} for each in found["results"]] == [False, True]
    tables("validate", None, **options)
    told("validate", "models.pdb", "--frames", "all", "--workers", "1", "--csv", "frames.csv")
    tables("validate", None, **{"--trajectory": tmp_path / "frames.csv"})


def test_score(told, tmp_path):
    options = {f"--{name}": tmp_path / f"{name}.csv" for name in ("csv", "residues")}
    given = [word for pair in options.items() for word in pair]
    found = told("score", STRUCTURES / "3i40.pdb", "peptide.pdb", *given)
    assert [set(each) == {"file", "message"} for each in found["results"]] == [False, True]
    tables("score", None, **options)
    of_frames = ["--frames", "all", "--workers", "1", "--reference", STRUCTURES / "3i40.pdb"]
    told("score", STRUCTURES / "3i40.pdb", *of_frames, "--csv", tmp_path / "f.csv")
    tables("score", None, **{"--trajectory": tmp_path / "f.csv"})


def test_ensemble(told, tmp_path):
    options = {f"--{name}": tmp_path / f"{name}.csv" for name in ("csv", "residues")}
    told("ensemble", "models.pdb", *[word for pair in options.items() for word in pair])
    tables("ensemble", None, **options)


def test_energy_of_frames(told, tmp_path):
    for number, more in enumerate(([], ["--between", "A:1,A:3"])):
        table = tmp_path / f"frames{number}.csv"
        told("energy", "models.pdb", "--frames", "all", "--workers", "1", "-o", table, *more)
        tables("energy", None, **{"--trajectory": table})
