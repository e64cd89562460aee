"""What cannot be done is refused in one line that says what to give: guards without a test of their own."""

import functools
import gzip
import re
from pathlib import Path

import numpy as np
import pytest
from fixtures.command_line import refusal_as_said
from fixtures.samples import STRUCTURES, load

import protochain as pc
from protochain.ligands import smirnoff

X = np.zeros((4, 103, 3))


def ala():
    return load("ala10.pdb")


@functools.cache
def modes():
    return pc.normal_modes(ala(), pc.energy(ala(), solvent="vacuum"), k=2)


@pytest.mark.parametrize(
    ("act", "said"),
    [
        (lambda: pc.Restraint("distance", ("A:1:CA",), 0.1, 0.2), "give 2 or 4 places of a distance"),
        (lambda: pc.Restraint("dihedral", ("A:1:CA",) * 3, 0, 9), "give 1 or 4 places of a dihedral"),
        (lambda: pc.Restraint("distance", ("A:1", "A:2"), 3, 2), "give 2 3"),
        (lambda: pc.Restraint("distance", ("A:1", "A:2"), 2, 3, -1.0), "and a stiffness"),
        (lambda: next(modes().swing(2)), "mode 2: give a whole number from 0 to 1"),
        (lambda: next(modes().swing("low")), "mode 'low': give a whole number"),
        (lambda: modes().overlap(pc.from_sequence("AA")), "fewer than three residues match"),
        (lambda: pc.mutate(ala(), "A3G", move="resid 3"), "no option 'move': what is near moves"),
        (lambda: pc.load(STRUCTURES / "5awl.pdb", ligands="oops"), "'oops': give NAME=SMILES"),
        (lambda: pc.load(STRUCTURES / "5awl.pdb", ligands="A=CCO"), "no molecule kept .* has this name"),
        (lambda: pc.as_structure((ala().topology, X[0, :7])), "7 positions do not fit a topology of 103"),
    ],
)
def test_calls_are_refused(act, said):
    with pytest.raises(pc.ProtochainError, match=said) as refused:
        act()
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("mutate {ala}", "give one of mutations, as A:L45F, --scan SITES, or --sequence FASTA"),
        ("mutate {ala} A:A3G --scan A", "mutate: give one of mutations, as A:L45F, --scan SITES"),
        ("minimise {ala} --angle 0.1 --method lbfgs", "--angle: does not apply to 'lbfgs'; choose from "
         "kcm, kcm-2norm, "),
        ("simulate {ala} --thermostat none --friction 5", "--friction does not apply to thermostat none"),
        ("simulate {ala} --trajectory-length 5", "--trajectory-length applies to thermostat hmc only"),
        ("simulate {ala} --hydrogen-mass 100",
         "--hydrogen-mass 100 amu: give a mass above 0 and at most about 4"),
        ("search {ala} --temperatures 300-500", "--temperatures does not apply to csa"),
        ("search {ala} --pilot 5", "--pilot applies to tempering only"),
        ("mutate {ala} A:A3G --workers 2", "--workers applies to scans only"),
        ("validate {ala} --changes c.csv", "--changes requires --reference"),
        ("relax {ala} {own} -o d --ligand-out p.sdf", "--ligand-out of several structures requires"),
        ("relax {ala} {own} -o d --report r.html", "--report applies to one structure. Several have"),
        ("relax {ala} {own} -o d --timings", "--timings applies to one structure only"),
        ("relax {ala} --workers 2", "--workers requires several inputs, not "),
        ("simulate {ala} --pull-speed 0.1", "--pull-speed requires --pull"),
        ("minimise {ala} --forcefield {text}", "text.xml: not a force-field XML file"),
        ("minimise {ala} --forcefield {smirnoff}", "SMIRNOFF|no OpenMM"),
        ("minimise {ala} --ligands {text}", "give NAME=SMILES, NAME=FILE, or a file of"),
        ("minimise {ala} --ligands {empty}", "has 0 molecules; give a file with one"),
        ("minimise {ala} --ligands {atoms}", "has no atoms; give a file with one molecule"),
        ("minimise {ala} --ligands {flat}", "has no coordinates in space; dock it first"),
    ],
)  # fmt: skip
def test_commands_are_refused(command, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    chem = pytest.importorskip("rdkit.Chem")
    blank = "\n  none\n\n  0  0  0  0  0  0  0  0  0  0999 V2000\nM  END\n$$$$\n"
    flat = chem.MolToMolBlock(chem.MolFromSmiles("CCO"))
    made = {"text.xml": "atoms", "empty.sdf": "", "atoms.sdf": blank, "flat.sdf": flat}
    for name, text in made.items():
        (tmp_path / name).write_text(text)
    files = {name.split(".")[0]: name for name in made}
    before = {*tmp_path.iterdir()}
    words = command.format(
        ala=STRUCTURES / "ala10.pdb", own=STRUCTURES / "5awl.pdb", smirnoff=smirnoff.SAGE_2_2, **files
    )
    assert re.search(said, refusal_as_said(*words.split()))
    assert {*tmp_path.iterdir()} == before


@pytest.mark.parametrize("call", ["compare", "simulate", "normal_modes", "search"])
def test_an_option_of_another_call_is_refused_with_the_call_that_has_it(call):
    with pytest.raises(pc.ProtochainError, match=rf"^{call} has no option 'altloc'; pc.load\(file, altloc="):
        getattr(pc, call)(ala(), altloc="A")


def cut(path, name="cut.pdb.gz"):
    Path(name).write_bytes(gzip.compress((STRUCTURES / path).read_bytes())[:-40])
    return name


def in_columns(name="columns.npz"):
    np.savez(name, positions=np.asfortranarray(np.ones((2, 103, 3))), unit="nm")
    return name


@pytest.mark.parametrize(
    ("patched", "act", "said"),
    [
        ({}, lambda: pc.load(cut("ala10.pdb")), "cut.pdb.gz: not a whole gzip file .*; download it again"),
        ({"structure.formats.files._BYTES": 99}, lambda: pc.load(STRUCTURES / "ala10.pdb"), "larger than"),
        (
            {"structure.write._PDB_SERIALS": 50}, lambda: pc.save(ala(), "a.pdb"),
            "a.pdb: 103 atoms do not fit a PDB file; write .cif instead",
        ),
        (
            {"structure.preparation.protonate._PER_CHAIN": 0},
            lambda: pc.load(STRUCTURES / "ala10.pdb", ph="auto"),
            "ph auto: 10 residues are too many for PROPKA",
        ),
        (
            {}, lambda: [*pc.relax_frames(ala(), in_columns(), solvent="vacuum")],
            "columns.npz: positions is not in C order; write it again by numpy.savez",
        ),
        (
            {"batches.ensembles._MOST": 3}, lambda: pc.cluster_frames(ala(), X),
            "4 frames; give 1 to 3, as every tenth by ::10",
        ),
    ],
)  # fmt: skip
def test_files_are_refused(patched, act, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, value in patched.items():
        monkeypatch.setattr(f"protochain.{name}", value)
    with pytest.raises(pc.ProtochainError, match=said):
        act()
