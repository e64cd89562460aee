"""Chains of unusual residues: small rings, crosslinks, planar C-alphas, and strands without a usual nucleotide."""

import numpy as np
import pytest
from fixtures.samples import shared
from fixtures.tolerances import GEOMETRY_NM
from rdkit import Chem
from rdkit.Chem import AllChem

import protochain as pc
from protochain.structure.chirality import chiral_atoms


def case(name):
    return shared(f"../cases/chemistry5/{name}")


def ring_of_two(path, side=""):
    """PDB file of a diketopiperazine: two glycines, or two alanines, as RDKit embeds it."""
    code, beta = ("ALA", "(C)") if side else ("GLY", "")
    hand = "[C@@H]" if side else "C"
    molecule = Chem.AddHs(Chem.MolFromSmiles(f"N1{hand}{beta}C(=O)N{hand}{beta}C1=O"))
    assert AllChem.EmbedMolecule(molecule, randomSeed=7) == 0
    AllChem.MMFFOptimizeMolecule(molecule)
    names = ("N", "CA", "CB", "C", "O") if side else ("N", "CA", "C", "O")
    x = molecule.GetConformer().GetPositions()
    lines = [
        f"ATOM  {i + 1:5d}  {names[i % len(names)]:3} {code} A   {i // len(names) + 1}    "
        f"{x[i][0]:8.3f}{x[i][1]:8.3f}{x[i][2]:8.3f}  1.00  0.00          {names[i % len(names)][0]:>2}\n"
        for i in range(2 * len(names))
    ]
    path.write_text("".join([*lines, "END\n"]))
    return path


def peptide_bonds(s):
    ends = s.atom_name[s.bonds]
    return int((np.sort(ends, axis=1) == ["C", "N"]).all(axis=1).sum())


@pytest.mark.parametrize(("side", "n_atoms"), [("", 14), ("alanine", 20)])
def test_a_ring_of_two_residues_is_closed(side, n_atoms, tmp_path):
    s = pc.load(ring_of_two(tmp_path / "two.pdb", side))
    assert s.n_residues == 2 and s.n_atoms == n_atoms and peptide_bonds(s) == 2
    r = pc.relax(s)
    assert r.status == "converged", r.message


def test_a_ring_of_three_residues_is_closed():
    s = pc.load(case("cyclo_ala3.cif"))
    assert s.n_residues == 3 and s.n_atoms == 30 and peptide_bonds(s) == 3
    assert pc.minimise(s).status == "converged"


def test_a_bond_in_a_ring_of_turning_bonds_is_no_hinge():
    s = pc.load(case("1j8z_crosslink.cif"))
    c = pc.build_chain(s)
    turned = c.q0.copy()
    turned[c.tree.q_start[c.hinge_body]] += np.random.default_rng(4).normal(size=c.n_hinges)
    x = pc.pose(c, turned).x
    loops = {tuple(pair) for pair in np.sort(c.loops, axis=1).tolist()}
    bonds = np.array([pair for pair in np.sort(s.bonds, axis=1).tolist() if tuple(pair) not in loops])
    before, after = (np.linalg.norm(at[bonds[:, 0]] - at[bonds[:, 1]], axis=1) for at in (s.positions, x))
    assert c.n_hinges > 20 and after == pytest.approx(before, abs=GEOMETRY_NM)


def test_a_planar_alpha_carbon_has_no_hand_and_no_place_of_its_beta_carbon():
    s = pc.load(case("dehydroalanine.cif"), keep="all")
    planar = np.flatnonzero((s.residue_name[s.atom_residue] == "DHA") & (s.atom_name == "CA"))
    assert len(planar) == 1 and planar[0] not in chiral_atoms(s)[:, 0]
    assert not pc.validate(s).listing()
    assert pc.relax(s).status == "converged"


@pytest.mark.parametrize("name", ["all_2F_strand.cif", "all_2F_strand.pdb"])
def test_a_strand_of_modified_nucleotides_alone_is_read(name):
    s, every = pc.load(case(name)), pc.load(case(name), keep="all")
    assert s.n_residues == 4 and np.array_equal(s.positions, every.positions)
