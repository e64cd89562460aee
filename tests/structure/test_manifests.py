"""Cases of users: each line of a MANIFEST.tsv in ``../shared/cases`` gives what the line says it must give.

A manifest is added by its folder in ``CHECKS``: a check for each file, called with the path of the file.
"""

import csv
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
from fixtures.samples import MORE_STRUCTURES, load
from scipy.spatial.distance import pdist

import protochain as pc
from protochain.core.checks import designs, sequences
from protochain.energies.decomposed import residues_of
from protochain.structure.molecule.repairs import Kind

CASES = MORE_STRUCTURES.parent / "cases"
DIGITS = 4e-4
"""nm: distances between positions of three digits in angstrom, each wrong by up to 0.0005 an axis."""


def kinds(structure: pc.Structure) -> list[Kind]:
    return [repair.kind for repair in structure.repairs]


def counts(n_residues: int, n_atoms: int, **options: str) -> Callable[[Path], None]:
    """Check that a file has so many residues and atoms, and that no atom is lost."""

    def check(path: Path) -> None:
        s = pc.load(path, **options)
        assert (s.n_residues, s.n_atoms, s.losses) == (n_residues, n_atoms, ())

    return check


def is_whole(path: Path) -> None:
    s, sample = pc.load(path), load("1l2y.pdb")
    assert (s.n_residues, s.n_atoms, s.losses) == (20, 304, ()) and Kind.MADE_WHOLE in kinds(s)
    assert pdist(s.positions) == pytest.approx(pdist(sample.positions), abs=DIGITS)


def has_disulfides(path: Path) -> None:
    s = pc.load(path)
    assert kinds(s).count(Kind.BRIDGE) == 3 and Kind.IMAGE_MOVED in kinds(s)


def has_three_waters(path: Path) -> None:
    for keep in ("water", "all"):
        s = pc.load(path, keep=keep)
        assert s.residue_name.tolist().count("HOH") == 3 and s.losses == () and s.n_residues == 23
    s = pc.load(path)
    assert dict(s.left_out) == {"waters": 3} and s.losses == ()


def has_designs(path: Path) -> None:
    native, *samples = designs(sequences(path, "sequence"))
    assert native[1] == f"A={21 * 'G'}/B={30 * 'G'}" and len(samples) == 2
    for number, last in ((2, "T"), (3, "A")):
        first, second = sequences(f"{path}#{number}", "sequence").split("/")
        assert (len(first), len(second), second[-1]) == (len("A=") + 21, len("B=") + 30, last)
    with pytest.raises(pc.ProtochainError, match="has 3 records"):
        sequences(f"{path}#4", "sequence")
    s = pc.Setup(sequence=f"{path}#2").load(path.with_name("c79_bb.pdb"))
    assert s.residue_name[[0, 20, 21]].tolist() == ["GLY", "ASN", "PHE"]


def without_pseudo_atoms(n_residues: int, n_atoms: int) -> Callable[[Path], None]:
    def check(path: Path) -> None:
        counts(n_residues, n_atoms)(path)
        assert Kind.VIRTUAL in kinds(pc.load(path))

    return check


def joins_copies(path: Path) -> None:
    s = pc.load(path)
    (repair,) = [repair for repair in s.repairs if repair.kind is Kind.MODELS_ARE_COPIES]
    assert repair.facts["count"] == 1 and s.n_residues == 51
    joined = pc.load(path, assembly="models")
    assert joined.n_residues == 102 and len(dict.fromkeys(joined.residue_chain.tolist())) == 4


def has_confidence(path: Path) -> None:
    row = pc.score_interface(pc.load(path), "A", "B").record()
    assert row["interface_plddt"] == pytest.approx(85.0, abs=1.0) and 0 < row["pdockq"] < 1


def is_read_by_openmm(path: Path) -> None:
    s = pc.load(path)
    assert (s.n_residues, s.n_atoms, s.losses) == (3, 33, ())


def minimises_without_hinges(path: Path) -> None:
    c = pc.build_chain(path)
    assert c.n_hinges == 0 and str(pc.minimise(c).status) == "converged"


def beads_removed(path: Path) -> None:
    s = pc.load(path)
    assert (s.n_residues, s.n_atoms) == (51, 782) and {loss.name for loss in s.losses} == {"MMB"}
    assert len(s.losses) == sum(" MMB " in line for line in path.read_text().splitlines())


def has_two_frames(path: Path) -> None:
    first, second = pc.load(path), pc.load(path, model=2)
    assert Kind.MODELS_LEFT_OUT in kinds(first) and first.n_atoms == second.n_atoms == 304
    assert not np.allclose(first.positions, second.positions)


def selects_by_insertion_code(path: Path) -> None:
    s = pc.load(path)
    numbers = np.char.add(s.residue_number, s.residue_insertion_code)
    for part, chosen in (
        ("H:112A", ["112A"]), ("H:111A-112", ["111A", "112B", "112A", "112"]),
        ("H:105-108", ["105", "106", "107", "108"]), ("H:112B-112A", ["112B", "112A"]),
    ):  # fmt: skip
        assert numbers[residues_of(s, part, "between")].tolist() == chosen
    table = pc.energy_terms(path, "residue", between="H:112A,H:105-108")
    assert np.isfinite(table["total"]).all()


CHECKS: Mapping[str, Mapping[str, Callable[[Path], None] | None]] = {
    "field5": {
        "c32_pbc.pdb": is_whole,
        "c32d_chain_image.pdb": has_disulfides,
        "c02_maestro_waters.pdb": has_three_waters,
        "c79_mpnn.fa": has_designs,
        "c79_bb.pdb": counts(51, 363),
        "c04_pymol_ps.pdb": without_pseudo_atoms(36, 596),
        "c06b_cyana_q.pdb": without_pseudo_atoms(36, 596),
        "c68_centroid.pdb": without_pseudo_atoms(20, 304),
        "c54_assembly_as.pdb": joins_copies,
        "c81_native.pdb": counts(51, 782),
        "c22b_esmfold_dimer.pdb": has_confidence,
        "pmd_ala_ala_ala.rst7": is_read_by_openmm,
        "pmd_ala_ala_ala.parm7": is_read_by_openmm,
        "pmd_model.cif": minimises_without_hinges,
        "c12_utf16.pdb": counts(20, 304),
        "c09_lightdock_mmb.pdb": beads_removed,
        "d23_cat_end.pdb": counts(21, 316),
        "d25_endmdl_ligand.pdb": counts(21, 316),
        "d24_frames_by_end.pdb": has_two_frames,
        "c13_imgt.pdb": selects_by_insertion_code,
        # Of other items: flipped amides, and ambiguous restraints.
        "c97b_flipped_asn43.pdb": None,
        "cns_or.tbl": None,
    },
    # The manifests of chemistry5, metals5 and reliability5: their folder and checks.
}


def files(folder: str) -> list[str]:
    """Files that the lines of a manifest name."""
    path = CASES / folder / "MANIFEST.tsv"
    if not path.exists():
        return []
    with path.open() as file:
        return [row["file"] for row in csv.DictReader(file, delimiter="\t", quoting=csv.QUOTE_NONE)]


@pytest.mark.parametrize(
    ("folder", "file"),
    [(folder, file) for folder, checks in CHECKS.items() for file, check in checks.items() if check],
)
def test_a_case_gives_what_its_line_says(folder, file):
    path = CASES / folder / file
    if not path.exists():
        pytest.skip(f"{path.name} is not here")
    check = CHECKS[folder][file]
    assert check is not None
    check(path)


@pytest.mark.parametrize("folder", CHECKS)
def test_every_line_of_a_manifest_has_a_check(folder):
    if not files(folder):
        pytest.skip(f"{folder} is not here")
    assert {*files(folder)} <= CHECKS[folder].keys()
