"""Sugars and base pairs of DNA and RNA, against mdtraj's torsions and textbook values."""

import mdtraj
import numpy as np
import pytest
from fixtures.samples import ROOT, STRUCTURES

import protochain as pc
from protochain.validation import measures
from protochain.validation.nucleic import nucleotides

pytest.importorskip("biotite")
RIBOSWITCH = ROOT.parent / "shared" / "complexes" / "models" / "4gxy.cif"


@pytest.fixture(scope="module")
def duplex():
    return pc.load(STRUCTURES / "1bna.pdb")


def test_the_dodecamer_has_its_twelve_pairs_and_a_base_drawn_out_is_in_none(duplex):
    """Drew et al., Proc. Natl. Acad. Sci. 78:2179 (1981): nucleotide k of one strand pairs with 25 - k."""
    found = nucleotides(duplex, duplex.positions)
    numbers = duplex.residue_number[found.pairs].astype(int)
    assert sorted(map(sorted, numbers.tolist())) == [[k, 25 - k] for k in range(1, 13)]
    x = duplex.positions.copy()
    x[duplex.atom_residue == 5] += 3.0
    left = duplex.residue_number[nucleotides(duplex, x).pairs].astype(int)
    assert sorted(map(sorted, left.tolist())) == [[k, 25 - k] for k in range(1, 13) if k != 6]


def test_a_strand_alone_has_no_pairs():
    strand = pc.load(STRUCTURES / "1bna.pdb", chains="A")
    assert nucleotides(strand, strand.positions).pairs.shape == (0, 2)
    assert pc.validate(strand).measures["base_pairs"] == 0


def test_the_phase_is_that_of_the_torsions_of_the_ring_by_mdtraj(duplex):
    """nu_j = amplitude cos(phase + 144 (j - 2)), to what a five-membered ring departs from it."""
    found = nucleotides(duplex, duplex.positions)
    trajectory = mdtraj.Trajectory(duplex.positions[None], mdtraj.Topology.from_openmm(duplex.topology))
    ring = ("C4'", "O4'", "C1'", "C2'", "C3'")
    at = [
        [
            [int(np.flatnonzero((duplex.atom_residue == r) & (duplex.atom_name == ring[(j + k) % 5]))[0])
             for k in range(4)]
            for j in range(5)
        ]
        for r in found.residue
    ]  # fmt: skip
    nu = np.rad2deg(mdtraj.compute_dihedrals(trajectory, np.reshape(at, (-1, 4)))).reshape(-1, 5)
    angle = found.phase[:, None] + 144.0 * (np.arange(5) - 2)
    assert np.abs(nu - found.amplitude[:, None] * np.cos(np.deg2rad(angle))).max() < 5.0


def test_b_dna_is_south_rna_north_and_a_bent_sugar_is_found(duplex):
    found = nucleotides(duplex, duplex.positions)
    assert np.median(found.phase) == pytest.approx(144.0, abs=25.0)
    assert not found.outlier.any()
    assert pc.validate(duplex).measures["base_pairs"] == 12
    x = duplex.positions.copy()
    r = int(found.residue[3])
    oxygen, axis = (
        int(np.flatnonzero((duplex.atom_residue == r) & (duplex.atom_name == name))[0])
        for name in ("O3'", "C4'")
    )
    # To the other side of the ring: delta near -60.
    x[oxygen] = 2.0 * x[axis] - x[oxygen]
    worse = nucleotides(duplex, x)
    assert np.flatnonzero(worse.outlier).tolist() == [3]
    assert measures(duplex, x)["pucker_outliers"] == 1


def test_a_riboses_pucker_agrees_with_the_place_of_the_phosphate_after_it():
    if not RIBOSWITCH.exists():
        pytest.skip(f"{RIBOSWITCH.name} is not here")
    found = nucleotides(structure := pc.load(RIBOSWITCH), structure.positions)
    assert np.median(found.phase) == pytest.approx(18.0, abs=15.0)
    assert not found.outlier.any() and len(found.pairs) > 50


def test_the_table_says_what_each_nucleotide_is_paired_with(duplex):
    table = pc.validate(duplex).nucleotide_table
    assert table.loc[0, ["chain", "residue", "name", "paired_with"]].tolist() == ["A", "1", "DC", "B:24"]
    assert len(table) == 24 and pc.validate(STRUCTURES / "ala10.pdb").nucleotide_table.empty


def test_what_only_bears_a_nucleotides_name_has_no_base(tmp_path):
    """Carbons far from the protein, under DA: kept by element, and no base of a pair."""
    lines = (STRUCTURES / "1l2y.pdb").read_text().splitlines(keepends=True)
    protein = [line for line in lines if line.startswith("ATOM")]
    ring = [
        f"{'HETATM':6}{line[6:17]} DA Z   1    {float(line[30:38]) + 50:8.3f}{line[38:]}"
        for line in protein
        if line[17:26] == "TRP A   6" and line[12:16].strip() in ("CE2", "CZ2", "CH2", "CZ3")
    ]  # fmt: skip
    (tmp_path / "named.pdb").write_text("".join([*protein, "TER\n", *ring, "END\n"]))
    structure = pc.load(tmp_path / "named.pdb", keep="all")
    assert "DA" in structure.residue_name
    assert pc.validate(structure).measures["base_pairs"] == 0
