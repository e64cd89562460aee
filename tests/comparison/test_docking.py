"""DockQ of complexes against DockQ 2.1.3, chains under any names, and ligands with symmetry."""

import json
import sys
from functools import cache
from pathlib import Path

import gemmi
import numpy as np
import pandas as pd
import pytest
from fixtures.command_line import refusal, run
from fixtures.tolerances import DOCKQ
from scipy.spatial.transform import Rotation

import protochain as pc
from protochain.comparison.deviation import rmsd_table
from protochain.comparison.docking import QUALITY, Pairing, docking

ROOT = Path(__file__).parents[2]
STRUCTURES = ROOT / "structures"
CHAI = ROOT.parent / "shared" / "complexes" / "models" / "chai1_6bj9_model_0.cif"

MODELS = {
    "shifted": ("3i40", {"B": (1.0, 0.0)}, 0.0),
    "turned": ("3i40", {"B": (0.0, 15.0)}, 0.0),
    "noisy": ("3i40", {}, 0.5),
    "far": ("3i40", {"A": (6.0, 40.0)}, 0.3),
    "protein-dna": ("1ysa", {"D": (2.0, 5.0)}, 0.3),
    "swapped": ("1ysa", {"C": (1.0, 10.0)}, 0.2),
    "permuted": ("1ysa", {"A": (1.5, 8.0), "D": (0.5, 20.0)}, 0.6),
    "truncated": ("1ysa", {"D": (1.0, 6.0)}, 0.25),
    "mutilated": ("1ysa", {"D": (1.5, 0.0)}, 0.25),
    "chai": ("boltz", {}, 0.0),
}
"""Native, moved chains (angstrom, degrees), and noise (angstrom) of models. The last is public: 6BJ9 by
Chai-1, with 6BJ9 by Boltz-1 as native."""
BY_DOCKQ = """
shifted A:B A:B 0.9569 0.9697 0.4583 0.9994
turned A:B A:B 0.7669 0.6970 1.0475 2.3055
noisy A:B X:Y 0.8766 0.8636 0.8084 0.8054
far A:B A:B 0.2615 0.0909 3.7982 7.5526
protein-dna A:B A:B 0.9640 1.0000 0.5123 0.5058
protein-dna A:C A:C 0.9624 1.0000 0.5255 0.5109
protein-dna A:D A:D 0.6500 0.4737 1.2857 2.8337
protein-dna B:C B:C 0.9640 1.0000 0.5117 0.5254
protein-dna B:D B:D 0.8235 1.0000 1.3285 2.6741
protein-dna C:D C:D 0.8208 0.9412 1.2357 2.4120
swapped A:B A:B 0.9830 1.0000 0.3415 0.3371
swapped A:C A:D 0.6214 0.5000 1.2101 4.7988
swapped A:D A:C 0.9847 1.0000 0.3230 0.3514
swapped B:C B:D 0.7613 0.8889 1.1960 4.4646
swapped B:D B:C 0.9836 1.0000 0.3351 0.3595
swapped C:D D:C 0.6925 0.4706 1.0215 2.4397
permuted A:B D:C 0.7295 0.8750 1.7296 3.0775
permuted A:C D:A 0.7879 0.9167 1.3334 3.0119
permuted A:D D:B 0.3081 0.0000 2.8101 5.5326
permuted B:C C:A 0.8521 0.8889 1.0235 1.0509
permuted B:D C:B 0.4609 0.6154 3.4561 6.8118
permuted C:D A:B 0.5959 0.8824 3.1592 5.2826
truncated A:B A:B 0.9742 1.0000 0.4270 0.4215
truncated A:C A:C 0.9730 1.0000 0.4380 0.4257
truncated A:D A:D 0.6860 0.4211 0.9369 2.5491
truncated B:C B:C 0.9742 1.0000 0.4264 0.4379
truncated B:D B:D 0.7763 0.6923 0.9679 2.3224
truncated C:D C:D 0.8727 1.0000 1.0631 1.9015
mutilated A:B A:B 0.9742 1.0000 0.4270 0.4215
mutilated A:C A:C 0.9730 1.0000 0.4380 0.4257
mutilated A:D A:D 0.8445 0.7895 0.8015 1.5910
mutilated B:C B:C 0.9742 1.0000 0.4264 0.4379
mutilated B:D B:D 0.9118 1.0000 0.8239 1.5693
mutilated C:D C:D 0.8627 0.8431 0.8040 1.5405
chai A:B B:A 0.6478 0.7801 2.7410 2.2823
"""
"""Model, chains of the native and of the model, and DockQ, fnat, iRMS and LRMS by DockQ 2.1.3:
``python tests/comparison/test_docking.py FOLDER``, then ``DockQ MODEL.pdb NATIVE.pdb --json MODEL.json``."""
BY_DOCKQ_ROWS = [line.split() for line in BY_DOCKQ.splitlines() if line]
RENAMED = {
    "swapped": {"C": "D", "D": "C"},
    "permuted": dict(zip("ABCD", "DCAB", strict=True)),
    "noisy": {"A": "X", "B": "Y"},
}


def native_of(name):
    """Polymers of a sample, at their first alternate locations."""
    files = {"boltz": STRUCTURES / "6bj9_model_0.cif.gz", "chai": CHAI}
    structure = gemmi.read_structure(str(files.get(name, STRUCTURES / f"{name}.pdb")))
    structure.setup_entities()
    structure.remove_alternative_conformations()
    structure.remove_ligands_and_waters()
    structure.remove_hydrogens()
    return structure


def model_of(name):
    """A model made from a native with a fixed seed, or the model that is a file."""
    native, moves, noise = MODELS[name]
    if name == "chai":
        return native_of(name)
    structure, rng = native_of(native), np.random.default_rng(7)
    for chain in structure[0]:
        shift, angle = moves.get(chain.name, (0.0, 0.0))
        atoms = [atom for residue in chain for atom in residue]
        x = np.array([atom.pos.tolist() for atom in atoms])
        axis = np.array([1.0, 2.0, -1.0]) / np.sqrt(6.0)
        centre = x.mean(axis=0)
        moved = Rotation.from_rotvec(np.radians(angle) * axis).apply(x - centre) + centre + shift * axis
        moved += rng.normal(0.0, noise, x.shape)
        for atom, place in zip(atoms, moved, strict=True):
            atom.pos = gemmi.Position(*place)
        for residue in chain if name == "truncated" else ():
            residue.seqid.num += 100
        if name == "truncated" and chain.name == "D":
            for _ in range(10):
                del chain[0]
        for residue in chain if name == "mutilated" else ():
            for k in reversed(range(len(residue))):
                if residue[k].name in ("CG", "OG", "CD", "CE"):
                    del residue[k]
        chain.name = RENAMED.get(name, {}).get(chain.name, chain.name)
    if name in RENAMED:
        chains = [chain.clone() for chain in structure[0]]
        for chain in chains:
            structure[0].remove_chain(chain.name)
        for chain in reversed(chains):
            structure[0].add_chain(chain)
    return structure


@cache
def written(folder, name):
    path = folder / f"{name}.pdb"
    (model_of(name) if name in MODELS else native_of(name)).write_pdb(str(path))
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("models")


@pytest.mark.parametrize("name", [*[*MODELS][:-1], pytest.param("chai", marks=pytest.mark.slow)])
def test_interfaces_equal_dockq(name, folder):
    if name == "chai" and not CHAI.exists():
        pytest.skip("needs ../shared/complexes")
    native = MODELS[name][0]
    quality = pc.complex_quality(written(folder, native), written(folder, name))
    expected = {
        pair: (model, *map(float, values)) for of, pair, model, *values in BY_DOCKQ_ROWS if of == name
    }
    rows = {}
    for row in quality["interfaces"].itertuples(index=False):
        pairs = [text.split(":") for text in (row.interface, row.model_interface)]
        order = sorted(range(2), key=pairs[0].__getitem__)
        first, second = (":".join(pair[k] for k in order) for pair in pairs)
        rows[first] = (second, *row[2:])
    assert rows.keys() == expected.keys()
    for pair, (chains, *values) in expected.items():
        assert rows[pair][0] == chains
        assert rows[pair][1:] == pytest.approx(values, abs=DOCKQ)


def test_equal_chains_may_be_swapped(folder):
    """The same place of every atom under exchanged names, and a far ligand that has the other's name."""
    structure = native_of("1ysa")
    for name in ("A", "B", "C"):
        structure[0].remove_chain(name)
    other = structure[0][0].clone()
    other.name = "E"
    for residue in other:
        for atom in residue:
            x, y, z = atom.pos.tolist()
            atom.pos = gemmi.Position(9.0 - x, -y, z + 1.0)
    structure[0].add_chain(other)
    structure.write_pdb(str(folder / "pair.pdb"))
    structure[0]["D"].name, structure[0]["E"].name = "F", "D"
    structure[0]["F"].name = "E"
    structure.write_pdb(str(folder / "exchanged.pdb"))
    quality = pc.complex_quality(folder / "pair.pdb", folder / "exchanged.pdb")
    assert quality["chain_mapping"] == "D:E,E:D"
    assert {key: quality[key] for key in QUALITY} == pytest.approx({
        "dockq": 1.0, "fnat": 1.0, "irms_angstrom": 0.0, "lrms_angstrom": 0.0, "lddt": 1.0,
        "lddt_pli": None, "ligand_rmsd_angstrom": None,
    }, abs=1e-4)  # fmt: skip


@pytest.fixture(scope="module")
def bound():
    """Trp-cage with mycophenolate at its side."""
    s = pc.load(STRUCTURES / "1l2y.pdb", ligands=[("", str(STRUCTURES / "1MEH_MOA.sdf"))])
    x, atoms = s.positions.copy(), s.ligands[0].atoms
    tip = x[~s.kept][x[~s.kept][:, 0].argmax()]
    x[atoms] += tip + np.array([0.15, 0.0, 0.0]) - x[atoms][x[atoms][:, 0].argmin()]
    return s.with_positions(x)


def test_a_ligand_that_moves_has_its_rmsd(bound):
    """The shift, also if all is turned. Exchanged oxygens of the carboxylate are no difference."""
    atoms = bound.ligands[0].atoms
    molecule = bound.ligands[0].ligand.molecule
    twins = [molecule.names.index(name) for name in ("O5", "O6")]
    x = bound.positions.copy()
    x[atoms[twins]] = x[atoms[twins[::-1]]]
    exchanged = pc.complex_quality(bound, bound.with_positions(x))
    assert (exchanged["ligand_rmsd_angstrom"], exchanged["lddt_pli"]) == pytest.approx((0.0, 1.0), abs=1e-6)
    x[atoms] += [0.0, 0.06, 0.08]
    x = Rotation.from_rotvec([0.3, -1.0, 0.5]).apply(x) + 1.0
    moved = pc.complex_quality(bound, bound.with_positions(x))
    assert moved["ligands"]["ligand_rmsd_angstrom"].tolist() == pytest.approx([1.0], abs=1e-6)
    assert 0.4 < moved["lddt_pli"] < 1.0
    assert moved["dockq"] is None
    row = docking(Pairing.of(bound, bound.with_positions(x)), "A", "ligand")
    assert row["ligand_rmsd_angstrom"] == pytest.approx(1.0, abs=1e-6)
    assert row["ca_rmsd_1_angstrom"] < 1e-6
    assert row["ca_rmsd_2_angstrom"] is None


def test_a_ligand_with_too_many_orders_is_reported(bound, monkeypatch):
    monkeypatch.setattr("protochain.comparison.docking._MOST_ORDERS", 1)
    with pytest.warns(UserWarning, match="B:LIG1: too symmetric"):
        pc.complex_quality(bound, bound)


def test_a_far_ligand_does_not_remove_the_lddt_of_another(bound):
    """It has no contact, and the mean is of ligands that have one. Tables without ligands have columns."""
    sdf = str(STRUCTURES / "1MEH_MOA.sdf")
    both = pc.load(STRUCTURES / "1l2y.pdb", ligands=[("", sdf), ("", sdf)])
    x = both.positions.copy()
    x[: bound.n_atoms] = bound.positions
    x[both.ligands[1].atoms] += 10.0
    both = both.with_positions(x)
    row = docking(Pairing.of(both, both), "A", "ligand")
    assert row["lddt_pli"] == pytest.approx(1.0)
    assert row["lddt_pli"] == pc.complex_quality(both, both)["lddt_pli"]
    native = STRUCTURES / "ala10.pdb"
    assert {"ligand", "lddt_pli"} <= {*pc.complex_quality(native, native)["ligands"]}


def test_a_ligand_of_a_symmetric_dimer_may_be_at_either_chain(folder, bound):
    """Names of chains of a homodimer mean nothing, so its ligand is in place at the other chain, too."""
    far, turn = bound.positions.max(axis=0) * [1, 0, 0] + [0.2, 0, 0], np.diag([-1.0, -1.0, 1.0])
    pc.save(bound, folder / "bound.pdb", hydrogens=False)
    whole = gemmi.read_structure(str(folder / "bound.pdb"))
    chain, ligand = whole[0][0], whole[0][1]
    assert (len(chain), len(ligand)) == (20, 1)
    rng = np.random.default_rng(3)
    for name, at_other in (("dimer", False), ("dimer-other", True)):
        model = gemmi.Model(1)
        for chain_name, part, is_turned in (("A", chain, False), ("B", chain, True), ("C", ligand, at_other)):
            added = part.clone()
            added.name = chain_name
            noise = 0.0 if name == "dimer" or part is ligand else 0.1
            for atom in (atom for residue in added for atom in residue):
                x = np.array(atom.pos.tolist()) - 10.0 * far
                x = (turn @ x if is_turned else x) + rng.normal(0.0, noise, 3)
                atom.pos = gemmi.Position(*x)
            model.add_chain(added)
        structure = gemmi.Structure()
        structure.add_model(model)
        structure.setup_entities()
        structure.write_pdb(str(folder / f"{name}.pdb"))
    quality = pc.complex_quality(folder / "dimer.pdb", folder / "dimer-other.pdb")
    assert quality["chain_mapping"] == "A:B,B:A"
    assert quality["ligand_rmsd_angstrom"] < 0.3
    assert quality["lddt_pli"] > 0.99


def test_a_model_without_the_interface_is_not_better_for_it(folder):
    """Its residues there have no RMSD. DockQ has no share of it, as of an infinite one."""
    structure = native_of("1ysa")
    for _ in range(37):
        del structure[0]["D"][0]
    structure.write_pdb(str(folder / "without.pdb"))
    table = pc.complex_quality(written(folder, "1ysa"), folder / "without.pdb")["interfaces"]
    row = table[table["interface"] == "A:D"].iloc[0]
    assert np.isnan(row["irms_angstrom"])
    assert (row["fnat"], row["dockq"]) == pytest.approx((0.0, 1.0 / 3.0), abs=1e-4)


def test_without_peppr_it_says_what_to_install(bound, monkeypatch, tmp_path, capsys):
    for name in ("peppr", "peppr.dockq"):
        monkeypatch.setitem(sys.modules, name, None)
    install = r'pip install "protochain\[quality\]"'
    native = STRUCTURES / "3i40.pdb"
    with pytest.raises(pc.ProtochainError, match=install):
        pc.complex_quality(native, native)
    assert install.replace("\\", "") in refusal("score", native, "--reference", native)
    with pytest.warns(UserWarning, match=install):
        table = rmsd_table(native, [native])
    assert table["rmsd_angstrom"].item() < 1e-6
    assert "dockq" not in table


def test_columns_are_printed_and_rank(folder, tmp_path, capsys):
    native = STRUCTURES / "3i40.pdb"
    models = [written(folder, name) for name in ("far", "noisy", "shifted")]
    assert run("rmsd", native, *models, "--json") == 0
    rows = json.loads(capsys.readouterr().out)["results"]
    expected = {row[0]: row[3:] for row in BY_DOCKQ_ROWS}
    for row in rows:
        values = map(float, expected[Path(row["file"]).stem])
        assert [row[key] for key in [*QUALITY][:4]] == pytest.approx([*values], abs=DOCKQ)
    out, page = tmp_path / "s.csv", tmp_path / "s.html"
    more = ["--reference", native, "--solvent", "vacuum", "--csv", out, "--report", page, "--workers", "1"]
    assert run("score", *models, "--rank", "dockq", *more) in (0, 3)
    table = pd.read_csv(out)
    assert [Path(file).stem for file in table["file"]] == ["shifted", "noisy", "far"]
    assert table["dockq"].tolist() == pytest.approx([row["dockq"] for row in rows[::-1]], abs=1e-6)
    assert "DockQ" in capsys.readouterr().out
    assert "dockq" in page.read_text()
    assert "rank DockQ requires reference" in refusal("score", native, "--rank", "DockQ")
    assert "lDDT-PLI" in refusal("score", native, "--rank", "LDT-PLI")


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    for name, (native, *_) in MODELS.items():
        native_of(native).write_pdb(str(folder / f"{native}.pdb"))
        model_of(name).write_pdb(str(folder / f"{name}.pdb"))
