"""What is taken of a file, and where a result goes: chains, models, one file of many, standard output."""

import json
import re

import gemmi
import numpy as np
import pytest
from fixtures.refusals import expect_refusal
from fixtures.samples import STRUCTURES, load

import protochain as pc
from protochain.batches import BatchSettings, find_jobs
from protochain.batches.table import Tables
from protochain.batches.task import Task

ATOMS = [line for line in (STRUCTURES / "ala10.pdb").read_text().splitlines(True) if line[:4] == "ATOM"]


@pytest.fixture
def three(tmp_path):
    """Three models, numbered 2, 3 and 7."""
    text = "".join(f"MODEL {n:8d}\n{''.join(ATOMS)}ENDMDL\n" for n in (2, 3, 7))
    (tmp_path / "three.pdb").write_text(text + "END\n")
    return tmp_path / "three.pdb"


@pytest.mark.parametrize("given", [" B ,", ("B",)])
def test_chains_can_be_chosen(given):
    whole, one = load("3i40.pdb"), pc.load(STRUCTURES / "3i40.pdb", chains=given)
    assert set(one.residue_chain) == {"B"} and one.n_residues == 30 < whole.n_residues
    assert one.left_out["chains"] == 1 and one.left_out["waters"] < whole.left_out["waters"]
    assert pc.Setup(chains=given).load(STRUCTURES / "3i40.pdb").n_atoms == one.n_atoms
    assert pc.as_structure(gemmi.read_structure(str(STRUCTURES / "3i40.pdb")), chains=given).n_residues == 30


def test_a_chain_that_is_not_there_is_refused_with_those_that_are(protochain):
    with pytest.raises(pc.ProtochainError, match=r"3i40\.pdb: has no chain C; its chains are A, B"):
        pc.load(STRUCTURES / "3i40.pdb", chains="A,C")
    status, _, err = protochain("info", STRUCTURES / "3i40.pdb", "--chains", "A,b")
    assert status == 2 and "has no chain b; its chains are A, B" in err
    status, out, _ = protochain("info", STRUCTURES / "3i40.pdb", "--chains", "A", "--json")
    assert status == 0 and json.loads(out)["n_residues"] == 21


def test_what_a_file_has_is_printed_as_the_record_has_it(protochain):
    facts = json.loads(protochain("info", STRUCTURES / "3i40.pdb", "--energy", "--json")[1])
    lines = protochain("info", STRUCTURES / "3i40.pdb", "--energy", "--verbose")[1].splitlines()
    names = {"loops": "ring closures", "hinges": "kinds of hinges"}
    assert len(facts["loops"]) == 3 and facts["overlaps"] == [] and facts["left_out"]["waters"] > 9
    for name, value in facts.items():
        key = names.get(name, name.removeprefix("n_").replace("_", " "))
        if isinstance(value, list):
            at = lines.index(f"{key}: {len(value)}")
            printed = [line.removeprefix("  ") for line in lines[at + 1 : at + 1 + len(value)]]
            assert printed == value or name == "repairs"  # These name Python's arguments in the record.
        elif isinstance(value, dict):
            told = ", ".join(f"{count} {name}" for name, count in value.items())
            assert f"{key}: {told or 'nothing'}" in lines
        elif isinstance(value, float):
            assert any(re.fullmatch(rf"{key}: \d+\.\d\d", line) for line in lines)
        else:
            assert f"{key}: {value}" in lines


@pytest.mark.parametrize(
    ("given", "kept"),
    [("4", 4), (4, 4), ("1-5", "1-5"), (" 1 - 3, 7 ", "1-3,7"), ("all", "all"), (None, None)],
)
def test_models_are_a_number_a_range_or_all(given, kept):
    assert pc.Setup(model=given).model == kept


@pytest.mark.parametrize("given", ["one", "5-1", "1-", "-3", "1,,2", "1-2-3", "1-9999999", "1.5"])
def test_models_that_make_no_sense_are_refused(given):
    with expect_refusal("model", match="'.*'"):
        pc.Setup(model=given)


def test_several_models_are_several_files_or_one(protochain, three, tmp_path):
    run = ("minimise", three, "--solvent", "vacuum", "--max-evaluations", 4, "--json", "--method", "lbfgs")
    status, out, _ = protochain(*run, "--model", "2-3", "-o", "out.pdb.gz")
    records = json.loads(out)["models"]
    assert status == 3 and [each["output"] for each in records] == ["out.2.pdb.gz", "out.3.pdb.gz"]
    one = gemmi.read_structure("out.3.pdb.gz")
    assert len(one) == 1
    _, out, _ = protochain(*run, "--model", "7,2", "-o", "both.pdb", "--one-file")
    assert [each["output"] for each in json.loads(out)["models"]] == ["both.pdb"] * 2
    joined = gemmi.read_structure("both.pdb")
    assert [model.num for model in joined] == [7, 2] and {path.name for path in tmp_path.iterdir()} == {
        "three.pdb", "out.2.pdb.gz", "out.3.pdb.gz", "both.pdb",
    }  # fmt: skip
    for model in joined:
        assert [at.atom.pos.tolist() for at in model.all()] == [at.atom.pos.tolist() for at in one[0].all()]
    text = (tmp_path / "both.pdb").read_text()
    assert "MODEL 2: PROTOCHAIN" in text and "MODEL 7: PROTOCHAIN" in text and text.count("\nENDMDL") == 2
    _, out, _ = protochain(*run, "--model", "all", "-o", "all.cif", "--one-file")
    assert [model.num for model in gemmi.read_structure("all.cif")] == [2, 3, 7]
    assert [pc.load("all.cif", model=n).n_atoms for n in (2, 7)] == [load("ala10.pdb").n_atoms] * 2


def test_what_is_done_is_written_when_a_later_model_cannot_be_used(protochain, three, tmp_path):
    text = three.read_text()
    (tmp_path / "bad.pdb").write_text(text[: text.index("MODEL        7")] + "MODEL        7\n" + "".join(
        line for line in ATOMS if line[12:16] == " CA "
    ) + "ENDMDL\nEND\n")  # fmt: skip
    run = ("minimise", "bad.pdb", "--solvent", "vacuum", "--max-evaluations", 2, "--model", "all")
    status, _, err = protochain(*run, "-o", "done.pdb", "--one-file")
    assert status == 2 and "only C-alpha atoms" in err
    assert [model.num for model in gemmi.read_structure("done.pdb")] == [2, 3]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--model", "2-4", "-o", "o.pdb"], "three.pdb: has no model 4; its models are 2, 3, 7"),
        (["--model", "2-3", "--trace", "t.csv"], "applies to a single model only"),
        (["--model", "2-3", "--report", "r.html"], "applies to a single model only"),
        (["--one-file"], "one-file requires several models, as by --model all"),
        (["--model", "3", "--one-file"], "one-file requires several models, as by --model all"),
        (["-o", "-", "--json"], "both go to standard output"),
        (["-o", "-", "--model", "all"], "give --one-file"),
        (["-o", "x.html", "--report", "x.html"], "unknown suffix '.html'"),
    ],
)
def test_contradictions_are_refused_in_one_line(arguments, said, protochain, three, tmp_path):
    status, out, err = protochain("minimise", three, *arguments)
    assert (status, out, err.count("\n")) == (2, "", 1) and said in err
    assert [path.name for path in tmp_path.iterdir()] == ["three.pdb"]


def test_a_structure_on_standard_output_is_alone_there(protochain, three):
    run = ("minimise", three, "--solvent", "vacuum", "--max-evaluations", 4, "--method", "lbfgs")
    status, out, err = protochain(*run, "-o", "-")
    s = gemmi.read_pdb_string(out)
    assert status == 3 and s[0].count_atom_sites() == load("ala10.pdb").n_atoms
    assert out.startswith("REMARK   3 PROTOCHAIN") and out.endswith("END" + 77 * " " + "\n")
    assert "budget" in err and "written: standard output" in err
    _, out, _ = protochain(*run, "-o", "-", "--model", "2-3", "--one-file")
    assert len(gemmi.read_pdb_string(out)) == 2
    _, out, _ = protochain("minimise", STRUCTURES / "1ubq.cif", "--chains", "A", "--max-evaluations", 5,
                           "--solvent", "vacuum", "--method", "lbfgs", "-o", "-")  # fmt: skip
    assert len(gemmi.make_structure_from_block(gemmi.cif.read_string(out).sole_block())[0]) == 1
    status, out, err = protochain("build", "GPW", "-o", "-")
    assert status == 0 and gemmi.read_pdb_string(out)[0].count_atom_sites() > 40 and "3 residues" in err


def test_a_report_of_one_run_is_one_page_that_works_offline(protochain, tmp_path):
    status, out, _ = protochain(
        "minimise",
        STRUCTURES / "ala10.pdb",
        "--method",
        "lbfgs",
        "--report",
        "page.html",
        "-o",
        "x.pdb",
        "--json",
    )
    record = json.loads(out)
    page = (tmp_path / "page.html").read_text()
    assert status == 0 and sorted(path.name for path in tmp_path.iterdir()) == ["page.html", "x.pdb"]
    assert f"{record['energy_end_reference_kj_mol']:.3f}" in page and record["report"] == "page.html"
    assert "<title>ala10 by lbfgs</title>" in page and "http-equiv" in page and 'src="http' not in page
    assert page.count('src="data:image/') == 5 and "comparison" not in page.split("<style>")[0]


def test_a_batch_restrains_and_starts_as_single_runs_do(tmp_path):
    path, settings = STRUCTURES / "ala10.pdb", BatchSettings(("lbfgs",), max_evaluations=60)
    settings = settings.changed(solvent="vacuum")
    energy = pc.energy(load("ala10.pdb"), solvent="vacuum")
    rows = {}
    for name, own in (("held", {"restraints": "1e5"}), ("many", {"n_starts": 3, "spread": np.radians(30)})):
        jobs = find_jobs([path], settings.changed(**own))
        tables = Tables(tmp_path / name, resume=False)
        tables.select_finished(jobs)
        tables.append(Task(jobs[0], tmp_path / name).run(1))
        tables.close()
        rows[name] = tables.read().iloc[0]
    alone = pc.minimise(load("ala10.pdb"), energy, "lbfgs", max_evaluations=60, restraints=1e5)
    assert rows["held"]["ca_rmsd_angstrom"] == pytest.approx(alone.ca_rmsd_angstrom, rel=1e-6)
    assert rows["held"]["restraint_kj_mol_nm2"] == "100000.0" and alone.ca_rmsd_angstrom < 0.5
    many = pc.explore(load("ala10.pdb"), energy, "lbfgs", 3, spread=np.radians(30), max_evaluations=60)
    assert (rows["many"]["n_starts"], rows["held"]["n_starts"]) == (3, 1)
    assert rows["many"]["energy_end_reference_kj_mol"] == pytest.approx(many.best.end.energy, rel=1e-6)
    assert rows["many"]["evaluations"] == sum(each.n_evaluations for each in many.solutions)
    assert rows["many"]["energy_median_kj_mol"] == pytest.approx(many.summary()["energy_median_kj_mol"])
