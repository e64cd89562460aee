"""Chains of unusual residues: small rings, crosslinks, planar C-alphas, and strands all modified."""

import numpy as np
import pytest
from fixtures.samples import STRUCTURES, shared
from fixtures.tolerances import GEOMETRY_NM
from rdkit import Chem
from rdkit.Chem import AllChem

import protochain as pc
from protochain.structure.molecule.chirality import chiral_atoms


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


TERMS = {
    "HarmonicBondForce": ("getNumBonds", "getBondParameters", 2),
    "HarmonicAngleForce": ("getNumAngles", "getAngleParameters", 3),
    "PeriodicTorsionForce": ("getNumTorsions", "getTorsionParameters", 4),
}
"""Methods of OpenMM that count and return terms, and how many atoms a term has."""


def terms_between_nucleotides(s, forcefield):
    """Values of the bonded terms across each O3'-P, by atoms and whether DNA and RNA meet there."""
    found: tuple[dict, dict] = {}, {}
    is_dna = np.char.startswith(s.residue_name.astype(str), "D")
    system = pc.energy(s, forcefield, "vacuum", engine="openmm").system
    for force in system.getForces():
        if force.getName() not in TERMS:
            continue
        count, read, n = TERMS[force.getName()]
        values: dict[tuple, set] = {}
        for k in range(getattr(force, count)()):
            each = getattr(force, read)(k)
            numbers = tuple(round(float(getattr(value, "_value", value)), 6) for value in each[n:])
            values.setdefault(tuple(each[:n]), set()).add(numbers)
        for atoms, numbers in values.items():
            of = s.atom_residue[list(atoms)]
            if len({*of.tolist()}) == 2:
                key = tuple(sorted((str(s.atom_name[i]), int(s.atom_residue[i] - of.min())) for i in atoms))
                is_mixed = len({*is_dna[of].tolist()}) == 2
                found[is_mixed].setdefault(key, set()).add(frozenset(numbers))
    return found


@pytest.mark.parametrize("forcefield", ["amber14", "amber19"])
def test_bonds_between_rna_and_dna_have_the_terms_of_either(forcefield):
    """Each term across a junction is one of OL3, or of OL15 or OL21, for atoms of these names."""
    s = pc.load(case("rna_one_deoxy.cif"), forcefield=forcefield)
    dna = pc.load(STRUCTURES / "1bna.pdb", forcefield=forcefield)
    of_rna, across = terms_between_nucleotides(s, forcefield)
    of_dna, _ = terms_between_nucleotides(dna, forcefield)
    assert across.keys() == of_rna.keys() == of_dna.keys()
    for key, its in across.items():
        assert its <= of_rna[key] | of_dna[key], key


def test_a_strand_of_rna_and_dna_is_relaxed():
    assert pc.relax(pc.load(case("rna_one_deoxy.cif"))).status == "converged"


def test_the_chemistry_of_an_amino_acid_in_a_chain_may_be_given():
    smiles = "N[C@@H](Cc1ccc(O)c([N+](=O)[O-])c1)C(=O)O"
    s = pc.load(case("ncaa_given_as_smiles.cif"), ligands=f"ZZA={smiles}")
    heavy = (s.residue_name[s.atom_residue] == "ZZA") & (s.atom_element != "H")
    # Of the amino acid, without the oxygen that a peptide bond takes.
    assert heavy.sum() == Chem.MolFromSmiles(smiles).GetNumAtoms() - 1
    assert not s.obstacle.any() and pc.relax(s).status == "converged"
    with pytest.raises(pc.ProtochainError, match="ALA"):
        pc.load(case("ncaa_given_as_smiles.cif"), ligands=("ALA=C[C@H](N)C(=O)O", f"ZZA={smiles}"))
