"""Every kind of bonded molecule in the files written: read again, the same bonds and the same energy."""

import functools

import gemmi
import numpy as np
import pytest
from fixtures import covalent
from fixtures.modified import modified
from fixtures.samples import STRUCTURES, shared
from fixtures.tolerances import SAME_SYSTEM_KJ_MOL
from openmm import app

import protochain as pc

CHEMISTRY, METALS = "../cases/chemistry5/", "../cases/metals5/"
SOTORASIB = "C=CC(=O)N1CCN([C@@H](C)C1)c1nc(=O)n(-c2c(C)ccnc2C(C)C)c2nc(-c3c(O)cccc3F)c(F)cc12"
NITROTYROSINE = "N[C@@H](Cc1ccc(O)c([N+](=O)[O-])c1)C(=O)O"
AMINE = ("CD", "CE", "NZ")


def filed(name, **options):
    """A file of the collection."""
    return lambda folder: pc.load(shared(name), keep="all", **options)


def bonded(kind, called="", smiles=""):
    """Components of the dictionary, the ligand under another name with the chemistry of SMILES if given."""

    def build(folder):
        case = covalent.KINDS[kind]
        path, _ = covalent.written(folder, case)
        if called:
            path.write_text(path.read_text().replace(case.molecules[-1].removeprefix("="), called))
        return pc.load(path, keep="all", ligands={called: smiles} if called else ())

    return build


def in_chain(sequence, number, name, joint=None):
    """A peptide of which one residue is modified."""

    def build(folder):
        pc.save(pc.from_sequence(sequence), folder / "plain.pdb")
        changes = {("A", number): (name, joint) if joint else name}
        return pc.load(modified(folder / "plain.pdb", changes, folder))

    return build


def in_strand(changes):
    """The duplex of which nucleotides are modified; its ends have no phosphates."""

    def build(folder):
        lines = (STRUCTURES / "1bna.pdb").read_text().splitlines(keepends=True)
        (folder / "plain.pdb").write_text("".join(lines))
        return pc.load(modified(folder / "plain.pdb", changes, folder), keep="all")

    return build


KINDS = {
    "given ligand": filed(f"{CHEMISTRY}cov_Z9Q.cif", ligands={"Z9Q": SOTORASIB}),
    "given ligand, double bond": bonded("pyridoxal", "QPL", "Cc1ncc(COP(=O)(O)O)c(C=O)c1O"),
    "given ligand, double bond, chain": bonded("retinal", "QRT", "O=CC=C(C)C=CC=C(C)C=CC1=C(C)CCCC1(C)C"),
    "given ligand, long name": bonded("pyridoxal", "QPLXY", "Cc1ncc(COP(=O)(O)O)c(C=O)c1O"),
    "given ligand, acceptor": bonded("acrylate-at-lysine", "QKR", "C=CC(=O)O"),
    "given ligand, leaving group": bonded("sulfonyl-tyrosine", "QES", "NCCc1ccc(cc1)S(=O)(=O)F"),
    "given amino acid": filed(f"{CHEMISTRY}ncaa_given_as_smiles.cif", ligands={"ZZA": NITROTYROSINE}),
    "ligand of the dictionary": bonded("acrylamide-as-added"),
    "ligand with a phosphate": bonded("pyridoxal"),
    "ligand at tyrosine": bonded("adenylyl-tyrosine"),
    "disulfide of a ligand": bonded("disulfide-glutathione"),
    "modified residue": in_chain("AAKAAA", 3, "M3L", AMINE),
    "modified first residue": in_chain("EAAA", 1, "PCA", ("CB", "CG", "CD")),
    "methylated backbone": in_chain("AALAAA", 3, "MLE", ("CA", "N", "CB")),
    "phosphorylated residue": in_chain("AASAAA", 3, "SEP"),
    "N-glycan": bonded("n-glycan"),
    "O-glycan": bonded("o-glycan"),
    "C-glycan": bonded("c-mannose"),
    "capped ends": filed("aaqaa3_capped.pdb"),
    "cyclic peptide": filed("5vav_cyclic.pdb"),
    "ring of D-amino acids": bonded("cycle"),
    "crosslink": bonded("tryptathionine"),
    "isopeptide": bonded("isopeptide-aspartate"),
    "thioether ring": bonded("lanthionine"),
    "hydrocarbon staple": bonded("staple"),
    "modified nucleotide": in_strand({("A", 3): ("5CM", ("C1'", "N1", "C6"))}),
    "phosphorothioate": filed(f"{CHEMISTRY}dna_phosphorothioate.cif"),
    "strand of modified nucleotides": filed(f"{CHEMISTRY}all_2F_strand.cif"),
    "heme and histidine": filed(f"{METALS}hem_his.pdb"),
    "heme and cyanide": filed(f"{METALS}hem_his_CN.pdb"),
    "cluster in place": filed(f"{METALS}sf4.pdb"),
    "ion held by ATP": filed(f"{METALS}mgatp2.pdb"),
    "ions": filed("3znf_zinc_finger.pdb"),
    "disulfide between chains": lambda folder: pc.load(STRUCTURES / "3i40.pdb"),
}
"""Structures with bonds that force fields of proteins do not have, and what else a file has to state."""
MORE = {
    "given ligand", "O-glycan", "heme and histidine",
    "given ligand, double bond, chain", "given ligand, acceptor", "given ligand, leaving group",
    "ligand at tyrosine", "disulfide of a ligand", "modified first residue", "methylated backbone",
    "C-glycan", "ring of D-amino acids", "isopeptide", "thioether ring", "hydrocarbon staple",
    "phosphorothioate", "strand of modified nucleotides", "cluster in place", "ion held by ATP",
}  # fmt: skip
ALL = [pytest.param(kind, marks=pytest.mark.slow if kind in MORE else ()) for kind in KINDS]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A structure of each kind, and its energy where it is, made once for all tests of the kind."""

    @functools.cache
    def make(kind):
        structure = shaken(KINDS[kind](tmp_path_factory.mktemp("kind")))
        return structure, pc.energy(structure)(structure.positions)[0]

    return make


def places(structure):
    """Index of each atom by chain, number and name."""
    named = zip(structure.atom_residue.tolist(), structure.atom_name.tolist(), strict=True)
    residues = [structure.residue(r) for r in range(structure.n_residues)]
    return {(residues[r].chain, residues[r].number, name): k for k, (r, name) in enumerate(named)}


def shaken(structure):
    """The structure as a run might leave it, with the positions that mmCIF has."""
    step = np.random.default_rng(0).normal(scale=0.003, size=structure.positions.shape)
    return structure.with_positions(np.round(structure.positions + step * ~structure.obstacle[:, None], 8))


def pairs(bonds):
    return {frozenset(pair) for pair in np.asarray(bonds).tolist()}


def assert_same_system(before, expected, after):
    """Assert the same atoms and bonds, and the same energy at the same positions, which PDB rounds."""
    here, there = places(before), places(after)
    assert here.keys() == there.keys()
    at = np.array([here[each] for each in there])
    assert pairs(at[after.bonds]) == pairs(before.bonds)
    for name in ("obstacle", "mobile", "kept", "formal_charge", "atom_element"):
        assert np.array_equal(getattr(after, name), getattr(before, name)[at]), name
    assert pc.energy(after)(before.positions[at])[0] == pytest.approx(expected, abs=SAME_SYSTEM_KJ_MOL, rel=0)


@pytest.mark.parametrize("suffix", [".cif", ".pdb"])
@pytest.mark.parametrize("kind", ALL)
def test_every_kind_read_again_is_the_same_system(kind, suffix, made, tmp_path):
    before, expected = made(kind)
    path = tmp_path / f"out{suffix}"
    pc.save(before, path)
    assert_same_system(before, expected, pc.load(path, keep="all"))


@pytest.mark.parametrize(
    "kind",
    ["given ligand, double bond", "given amino acid", "ligand of the dictionary", "ligand with a phosphate"],
)
def test_from_format_to_format_it_stays_the_same_system(kind, made, tmp_path):
    before, expected = made(kind)
    after = before
    for n, suffix in enumerate((".pdb", ".cif", ".pdb")):
        pc.save(after, tmp_path / f"{n}{suffix}")
        after = pc.load(tmp_path / f"{n}{suffix}", keep="all")
    assert_same_system(before, expected, after)


@pytest.mark.parametrize("kind", ALL)
def test_openmm_finds_every_bond_in_mmcif_and_gemmi_in_pdb(kind, made, tmp_path):
    """Springs of metals are no bonds of OpenMM, and molecules that stay in place have none."""
    s, _ = made(kind)
    pc.save(s, tmp_path / "out.cif")
    topology = app.PDBxFile(str(tmp_path / "out.cif")).topology
    assert [atom.element.symbol for atom in topology.atoms()] == s.atom_element.tolist()
    inside = s.atom_residue[s.bonds[:, 0]] == s.atom_residue[s.bonds[:, 1]]
    expected = s.bonds[~s.coordination & ~(inside & s.obstacle[s.bonds].any(axis=1))]
    assert pairs([(one.index, other.index) for one, other in topology.bonds()]) == pairs(expected)
    pc.save(s, tmp_path / "out.pdb")
    written = gemmi.read_structure(str(tmp_path / "out.pdb"))
    at = {place.atom.serial: k for k, place in enumerate(written[0].all())}
    drawn = {frozenset((at[one], at[other])) for one, ends in written.conect_map.items() for other in ends}
    between = s.bonds[~inside & ~s.coordination]
    standard = [gemmi.find_tabulated_residue(name).is_standard() for name in s.residue_name_in_file.tolist()]
    unusual = between[~np.array(standard)[s.atom_residue[between]].all(axis=1)]
    assert drawn >= pairs(unusual)
    assert len(written.connections) >= len(unusual)
