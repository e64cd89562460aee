"""DNA and RNA: strands that move, with and without a protein."""

import gemmi
import mdtraj
import numpy as np
import openmm
import pytest
from fixtures.oracles import assert_equals_reference
from fixtures.refusals import expect_refusal
from fixtures.samples import STRUCTURES

import protochain as pc
from protochain.energies.factory import build_system
from protochain.structure.molecule.chirality import chiral_atoms, volume
from protochain.structure.molecule.repairs import Kind
from protochain.structure.molecule.residues import NUCLEIC


@pytest.fixture(scope="module")
def duplex():
    return pc.load(STRUCTURES / "1bna.pdb")


@pytest.fixture(scope="module")
def gcn4():
    return pc.load(STRUCTURES / "1ysa.pdb")


def watson_crick(structure, x, within):
    """Pairs of nucleotides of two chains with N1 of a purine this near (nm) to N3 of a pyrimidine."""
    name, residue = structure.atom_name, structure.atom_residue
    bases = structure.residue_name[residue]
    purine = np.flatnonzero((name == "N1") & np.isin(bases, ["DA", "DG", "A", "G"]))
    other = np.flatnonzero((name == "N3") & np.isin(bases, ["DT", "DC", "U", "C"]))
    near = np.linalg.norm(x[purine][:, None] - x[other], axis=2) < within
    chain = structure.residue_chain[residue]
    near &= chain[purine][:, None] != chain[other]
    return {(int(residue[purine[i]]), int(residue[other[j]])) for i, j in np.argwhere(near)}


def test_a_duplex_without_protein_moves_and_has_all_hydrogens(duplex):
    assert duplex.mobile.all() and not duplex.obstacle.any() and duplex.n_chains == 0
    assert [each.kind for each in duplex.repairs].count(Kind.STRAND) == 2
    topology = mdtraj.Topology.from_openmm(duplex.topology)
    # By hand: seven of the sugar and those of the base; hydroxyls at the four ends, without 5' phosphates.
    assert sum(a.element.symbol == "P" for a in topology.atoms) == 22
    per_base = {"DA": 11, "DT": 12, "DG": 11, "DC": 11}
    expected = sum(per_base[str(name)] for name in duplex.residue_name) + 4
    assert (duplex.atom_element == "H").sum() == expected


def test_the_energy_is_that_of_openmms_reference_platform(gcn4):
    assert_equals_reference(pc.energy(gcn4, "amber19", "obc2", "native"), gcn4.positions)


def test_dna_has_ol21_beside_ff19sb_and_ol15_beside_ff14sb(duplex):
    """Their torsions differ (Zgarbova et al., J. Chem. Theory Comput. 17:6292, 2021); bonds do not."""
    energies = {}
    for forcefield in ("amber14", "amber19"):
        system = build_system(duplex, forcefield, "vacuum")
        for k, force in enumerate(system.getForces()):
            force.setForceGroup(k)
        context = openmm.Context(
            system, openmm.VerletIntegrator(0.001), openmm.Platform.getPlatformByName("Reference")
        )
        context.setPositions(duplex.positions)
        energies[forcefield] = {
            type(force).__name__: context.getState(getEnergy=True, groups={k}).getPotentialEnergy()._value
            for k, force in enumerate(system.getForces())
        }
    ol15, ol21 = energies.values()
    assert ol15["HarmonicBondForce"] == pytest.approx(ol21["HarmonicBondForce"], rel=1e-6)
    assert abs(ol15["PeriodicTorsionForce"] - ol21["PeriodicTorsionForce"]) > 1.0


def test_strands_are_rigid_bodies_in_torsions_unless_their_hinges_are_opened(gcn4):
    rigid = pc.build_chain(gcn4)
    assert len(rigid.loops) == 0
    strands = [np.flatnonzero(gcn4.residue_chain[gcn4.atom_residue] == chain) for chain in "AB"]
    assert all(len({*rigid.atom_body[atoms].tolist()}) == 1 for atoms in strands)
    opened = pc.build_chain(gcn4, "phi psi chi nucleic")
    mine = [hinge for hinge in opened.hinges if hinge.residue_name in NUCLEIC]
    # 20 nucleotides a strand: alpha and zeta 19 each, beta 19, gamma 20, epsilon 19, base 20.
    kinds = [hinge.kind for hinge in mine]
    assert {kind: kinds.count(kind) for kind in set(kinds)} == {
        "alpha": 38, "beta": 38, "gamma": 40, "epsilon": 38, "zeta": 38, "base": 40,
    }  # fmt: skip


def test_torsions_keep_bonds_and_sugars(duplex):
    chain = pc.build_chain(duplex, "nucleic")
    found = pc.minimise(chain, method="lbfgs", max_evaluations=40)
    i, j = duplex.bonds.T
    before, after = (np.linalg.norm(x[i] - x[j], axis=1) for x in (duplex.positions, found.x))
    assert np.abs(after - before).max() < 1e-9
    assert np.abs(found.x - duplex.positions).max() > 1e-3
    sugar = np.flatnonzero(np.isin(duplex.atom_name, ["C1'", "C2'", "C3'", "C4'", "O4'"]))
    for residue in range(duplex.n_residues):
        atoms = sugar[duplex.atom_residue[sugar] == residue]
        apart = [np.linalg.norm(x[atoms][:, None] - x[atoms], axis=2) for x in (duplex.positions, found.x)]
        assert np.abs(apart[0] - apart[1]).max() < 1e-9


def test_relax_keeps_base_pairs_and_phosphates(duplex):
    s = duplex
    relaxed = pc.relax(s)
    before, after = watson_crick(s, s.positions, 0.33), watson_crick(s, relaxed.x, 0.35)
    assert len(before) > 8 and len(before & after) >= 0.98 * len(before)
    phosphorus = s.atom_element == "P"
    moved = np.linalg.norm(relaxed.x - s.positions, axis=1)[phosphorus]
    assert 10.0 * np.median(moved) < 0.3


@pytest.fixture(scope="module")
def phosphorylated(tmp_path_factory):
    """The dodecamer without the first nucleotide of each strand, whose successor has its phosphate."""
    given = gemmi.read_structure(str(STRUCTURES / "1bna.pdb"))
    for chain in given[0]:
        del chain[0]
    given.remove_hydrogens()
    path = tmp_path_factory.mktemp("ends") / "ends.pdb"
    given.write_pdb(str(path))
    return pc.load(path)


def test_a_strand_keeps_its_5_phosphate_whose_third_oxygen_is_built(phosphorylated):
    s = phosphorylated
    assert not s.losses and s.mobile.all() and (s.atom_element == "P").sum() == 22
    for oxygen in np.flatnonzero(s.atom_name == "OP3").tolist():
        residue = s.atom_residue == s.atom_residue[oxygen]
        p, *others = (
            s.positions[np.flatnonzero(residue & (s.atom_name == name))[0]]
            for name in ("P", "O5'", "OP1", "OP2")
        )
        arms = np.array([s.positions[oxygen], *others]) - p
        arms /= np.linalg.norm(arms, axis=1)[:, None]
        # Tetrahedral, as far as the crystal's other three bonds are: cosines of -1/3.
        assert arms[1:] @ arms[0] == pytest.approx(np.full(3, -1 / 3), abs=0.2)


@pytest.mark.parametrize("forcefield", ["amber14", "amber19"])
def test_a_5_phosphate_has_lost_both_its_hydrogens(phosphorylated, forcefield):
    """An energy equal to the Reference platform's, and charges -2 at the 5' phosphates, -1 between."""
    s = phosphorylated
    assert_equals_reference(pc.energy(s, forcefield, "gbn2", "native"), s.positions)
    system = build_system(s, forcefield, "vacuum")
    (force,) = (each for each in system.getForces() if isinstance(each, openmm.NonbondedForce))
    charge = [force.getParticleParameters(k)[0]._value for k in range(s.n_atoms)]
    assert sum(charge) == pytest.approx(2 * (-2 - 10), abs=1e-6)
    oxygens = [charge[k] for k in np.flatnonzero(np.isin(s.atom_name, ["OP1", "OP2", "OP3"]))[:3]]
    # As of phosphoserine's dianion (Homeyer et al., J. Mol. Model. 12:281, 2006: -0.95).
    assert oxygens == pytest.approx([-0.95] * 3, abs=0.03)


def test_sugars_have_their_hands_and_a_mirrored_one_is_told_and_turned(duplex):
    """Cahn, Ingold, Prelog by RDKit's dictionary entry: C1' R, C3' S, C4' R of deoxyguanosine."""
    centres = chiral_atoms(duplex)
    assert len(centres) == 3 * duplex.n_residues and (volume(duplex.positions[centres]) > 0.0).all()
    x = duplex.positions.copy()
    hydrogen, carbon = (
        int(np.flatnonzero((duplex.atom_residue == 4) & (duplex.atom_name == name))[0])
        for name in ("H3'", "O3'")
    )
    x[[hydrogen, carbon]] = x[[carbon, hydrogen]]
    wrong = duplex.with_positions(x)
    assert pc.validate(wrong).measures["inverted_stereocentres"] == 1
    relaxed = pc.relax(wrong)
    assert (volume(relaxed.x[centres]) > 0.0).all()


def test_a_strand_by_itself_is_minimised_in_all_atoms_and_turns_only_hinges_that_are_opened(tmp_path):
    """Without hinges of nucleotides it is one rigid body: methods in torsions leave it as it is."""
    strand = pc.load(STRUCTURES / "1bna.pdb", chains="A")
    c, e = pc.build_chain(strand), pc.energy(strand)
    assert c.n_v == 0
    free = pc.minimise(c, e, max_evaluations=20)
    assert free.end.energy < free.start.energy
    for method in ("lbfgs", "md"):
        still = pc.minimise(c, e, method)
        assert np.allclose(still.x, strand.positions, atol=1e-12)
    for call in (lambda: pc.normal_modes(c, e), lambda: pc.search(c, e, evaluations=50)):
        with pytest.raises(pc.ProtochainError, match="open more"):
            call()


@pytest.mark.filterwarnings("error")
def test_a_batch_takes_dna_alone_which_has_neither_alpha_carbons_nor_amino_acids(tmp_path, capsys):
    batch = pc.batch(STRUCTURES / "1bna.pdb", tmp_path / "out", "cartesian", max_evaluations=20, workers=1)
    row = batch.table.iloc[0]
    assert np.isnan(row["ca_rmsd_angstrom"]) and row["n_residues"] == 0
    assert row["energy_end_reference_kj_mol"] < row["energy_start_kj_mol"]


def test_of_dna_alone_that_is_not_kept_nothing_is_left_and_a_trace_is_no_strand(tmp_path):
    with expect_refusal("keep", match="8 residues DC") as refused:
        pc.load(STRUCTURES / "1bna.pdb", keep="none")
    assert refused.value.parts[-1].name == "keep"
    text = (STRUCTURES / "1bna.pdb").read_text().splitlines(True)
    (tmp_path / "x.pdb").write_text("".join(line for line in text if line[12:16].strip() == "P"))
    with pytest.raises(pc.ProtochainError, match="no protein found"):
        pc.load(tmp_path / "x.pdb")


def test_a_strand_of_dna_may_have_ambers_names_of_rna(tmp_path):
    """G5 is the first guanosine of RNA, and of DNA in older files: the sugar decides."""
    text = (STRUCTURES / "1bna.pdb").read_text()
    (tmp_path / "x.pdb").write_text(text.replace(" DC A   1", " C5 A   1"))
    assert pc.load(tmp_path / "x.pdb").residue_name[0] == "DC"


def test_chains_stand_in_the_order_of_the_file_dna_before_protein():
    filed = gemmi.read_structure(str(STRUCTURES / "1ysa.pdb"))[0]
    s = pc.load(STRUCTURES / "1ysa.pdb")
    assert [*dict.fromkeys(s.residue_chain.tolist())] == [chain.name for chain in filed]
