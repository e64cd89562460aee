"""Salt: what refuses it, and that runs, records and second preparations have it."""

import dataclasses
import json

import pandas as pd
import pytest
from fixtures.command_line import run as command
from fixtures.refusals import expect_refusal
from fixtures.samples import STRUCTURES, load
from fixtures.tolerances import NATIVE_ENERGY
from openmm import unit

import protochain as pc
from protochain.core import defaults
from protochain.core.errors import ProtochainError
from protochain.energies import NativeEnergy

SALTED = {"solvent": "gbn2", "salt": 0.15}
LABEL = "gbn2 with 0.15 mol/l salt"
FEW = {"max_evaluations": 3, "curvature": False}


def value(salt, x=None, **more):
    s = load("ala10.pdb")
    return pc.energy(s, **({"solvent": "gbn2"} | more), salt=salt, threads=1)(
        s.positions if x is None else x
    )[0]


@pytest.fixture(scope="module")
def run():
    s = load("ala10.pdb")
    return pc.minimise(pc.build_chain(s), pc.energy(s, **SALTED, threads=1), "lbfgs", **FEW)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"solvent": "vacuum", "salt": 0.15}, "salt 0.15 needs a solvent model; choose from hct, obc1"),
        ({"salt": -0.1}, "salt"),
        ({"salt": float("nan")}, "salt"),
        ({"salt": float("inf")}, "salt"),
        ({"salt": "much"}, "salt"),
        ({"salt": 150}, "salt 150: .* mol/l"),  # Of millimolar.
        ({"salt": 150.0 * unit.kelvin}, "salt"),
        ({"solvent": "igb5"}, "choose from vacuum, hct, obc1, obc2, gbn, gbn2"),
    ],
)
def test_what_has_no_meaning_is_refused_in_one_line(options, words):
    with pytest.raises(ProtochainError, match=words) as refusal:
        pc.energy(load("ala10.pdb"), **options)
    assert "\n" not in str(refusal.value)


def test_salt_of_a_system_is_refused():
    s = load("ala10.pdb")
    with expect_refusal("salt"):
        pc.energy(s, system=pc.energy(s).system, salt=0.15)


def test_salt_may_have_a_unit():
    assert value(150.0 * unit.millimolar) == value(0.15)


@pytest.mark.parametrize("solvent", ["hct", "obc1", "obc2", "gbn", "gbn2"])
def test_engines_agree(solvent):
    """OpenMM's CPU platform is in single precision."""
    s = load("ala10.pdb")
    native, by_openmm = (value(0.5, solvent=solvent, engine=engine) for engine in ("native", "openmm"))
    without = value(0.0, solvent=solvent, engine="native")
    assert by_openmm == pytest.approx(native, abs=1e-2)
    assert native < without - 0.1
    assert isinstance(pc.energy(s, solvent=solvent, salt=0.5), NativeEnergy)


def test_no_tree_sums_pairs_that_salt_screens():
    s = load("1ake.pdb.gz")
    e = pc.energy(s, salt=0.15, accuracy=1e-3, engine="native")
    assert e.opening is None
    assert "salt screens far pairs" in e.reason


def test_many_atoms_with_salt_have_the_cutoff_of_engines_without_a_tree(monkeypatch):
    for name, atoms in (("TREE_FROM", 50), ("FULL_UP_TO", 80)):
        monkeypatch.setattr(defaults, name, atoms)
    s = load("ala10.pdb")
    e = pc.energy(s, **SALTED, threads=1)
    assert f"cutoff {defaults.LONG_CUTOFF:g} nm" in e.reason
    exact = pc.energy(s, **SALTED, threads=1, cutoff=defaults.LONG_CUTOFF)
    assert e(s.positions)[0] == exact(s.positions)[0]


def test_records_and_files_name_the_salt(run, tmp_path):
    assert run.record()["solvent"] == LABEL
    run.save(tmp_path / "end.pdb")
    assert f"SOLVENT {LABEL}" in (tmp_path / "end.pdb").read_text()
    assert run.energy_function.settings["salt"] == 0.15


def test_a_result_has_its_salt_until_another_is_named(run):
    assert pc.energy(run) is run.energy_function
    assert pc.energy(run, salt=0.0)(run.x)[0] == pytest.approx(value(0.0, run.x), rel=NATIVE_ENERGY)
    assert pc.energy(run, solvent="vacuum").solvent == "vacuum"
    terms = pc.energy_terms(run)["total"].iloc[0]
    assert terms == pytest.approx(value(0.15, run.x), abs=1e-8)
    assert pc.energy_terms(run, salt=0.3)["total"].iloc[0] == pytest.approx(value(0.3, run.x), abs=1e-8)


def test_second_preparations_have_the_salt(run):
    """Frames, mutants, and structures with another sequence are prepared anew."""
    s, setup = load("ala10.pdb"), pc.Setup(**SALTED, threads=1)
    (frame,) = pc.frame_energies(s, s.positions[None], **SALTED, workers=1).to_dict("records")
    assert frame["energy_kj_mol"] == pytest.approx(value(0.15), abs=1e-6)
    mutant = dataclasses.replace(setup, sequence="AAAAGAAAAA").prepare(STRUCTURES / "ala10.pdb")
    assert mutant.energy.solvent == LABEL
    short = {"threads": 1, "max_iterations": 2, "max_outer_iterations": 1}
    for source, options, label in (
        (s, SALTED, LABEL),
        (run, {}, LABEL),
        (run, {"solvent": "vacuum"}, "vacuum"),
    ):
        mutation = pc.mutate(source, "A:A5G", **options, **short)
        assert {side.energy_function.solvent for side in (mutation.wild, mutation.mutant)} == {label}


def test_commands_have_the_salt(tmp_path, capsys):
    options = (STRUCTURES / "ala10.pdb", "--solvent", "gbn2", "--salt", 0.15, "--threads", 1)
    command("energy", *options, "--json")
    terms = json.loads(capsys.readouterr().out)
    assert (terms["solvent"], terms["rows"][0]["total"]) == (LABEL, pytest.approx(value(0.15), abs=1e-8))
    command("scan", options[0], "psi A:5=-40", *options[1:], "-o", tmp_path / "s.csv")
    (curve,) = pd.read_csv(tmp_path / "s.csv").to_dict("records")
    c = pc.build_chain(load("ala10.pdb"))
    turned = pc.pose(c, c.set({"psi A:5": -40.0})).x
    assert curve["energy_kj_mol"] == pytest.approx(value(0.15, turned), abs=1e-4)
    command(
        "batch", *options, "-o", tmp_path / "b", "--methods", "lbfgs", "--max-evaluations", 3, "--workers", 1
    )
    assert pd.read_csv(tmp_path / "b" / "summary.csv")["solvent"].tolist() == [LABEL]
    command("minimise", *options, "-o", tmp_path / "m.pdb", "--method", "lbfgs", "--max-evaluations", 3)
    assert f"SOLVENT {LABEL}" in (tmp_path / "m.pdb").read_text()


def test_sides_of_an_interface_are_screened():
    s = pc.load(STRUCTURES / "3i40.pdb", disulfide="none")
    scores = [pc.score_interface(s, "A", "B", solvent="obc2", salt=salt).scores for salt in (0.0, 0.3)]
    table = pc.energy_terms(s, between="A,B", solvent="obc2", salt=0.3)
    assert scores[1]["energy_kj_mol"] == pytest.approx(table.loc["sum", "total"], abs=1e-8)
    assert scores[1]["energy_kj_mol"] != pytest.approx(scores[0]["energy_kj_mol"], abs=1e-2)


def test_methods_of_a_comparison_have_one_salted_energy():
    s = load("ala10.pdb")
    energy = pc.energy(s, **SALTED, threads=1)
    comparison = pc.compare(s, ("lbfgs", "openmm"), energy, max_evaluations=20, repeats=1, curvature=False)
    assert {record["solvent"] for record in comparison.records()} == {LABEL}
    for solution in comparison.solutions:
        assert solution.energy == pytest.approx(value(0.15, solution.x), abs=1e-6)
