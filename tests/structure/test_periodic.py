"""Molecules broken across a periodic box, and chains in another image, in single files and topologies."""

from itertools import product

import gemmi
import numpy as np
import pytest
from fixtures.repairs import turned_amides
from fixtures.samples import STRUCTURES, load
from scipy.spatial import KDTree
from scipy.spatial.distance import pdist

import protochain as pc
from protochain.structure.ensemble import Ensemble
from protochain.structure.formats.frames import open_frames
from protochain.structure.molecule.repairs import Kind
from protochain.structure.preparation.periodic import touching_image

TRUNCATED = gemmi.UnitCell(44.0, 44.0, 44.0, 109.4712206, 109.4712206, 109.4712206)
BOXES = {
    "cubic": gemmi.UnitCell(40.0, 40.0, 40.0, 90.0, 90.0, 90.0), "octahedron": TRUNCATED,
    "triclinic": gemmi.UnitCell(38.0, 45.0, 50.0, 75.0, 80.0, 65.0),
}  # fmt: skip
DIGITS = {".pdb": 4e-4, ".cif": 4e-4, ".gro": 2e-3}
"""nm: distances between positions of the digits of a file, each wrong by half of the last digit."""


def wrapped(name, cell, shift):
    """A sample with each atom in the unit cell at the origin, after a shift of fractional coordinates."""
    structure = gemmi.read_structure(str(STRUCTURES / name))
    structure.cell, structure.spacegroup_hm = cell, "P 1"
    structure.remove_waters()
    del structure.assemblies[:]
    while len(structure) > 1:
        del structure[1]
    for place in structure[0].all():
        at = cell.fractionalize(place.atom.pos).tolist()
        inside = [(a + b) % 1.0 for a, b in zip(at, shift, strict=True)]
        place.atom.pos = cell.orthogonalize(gemmi.Fractional(*inside))
    return structure


def written(structure, path):
    if path.suffix == ".cif":
        structure.make_mmcif_document().write_file(str(path))
    elif path.suffix == ".pdb":
        structure.write_pdb(str(path))
    else:
        import MDAnalysis

        structure.write_pdb(str(path.with_suffix(".pdb")))
        MDAnalysis.Universe(str(path.with_suffix(".pdb"))).atoms.write(str(path))
        path.with_suffix(".pdb").unlink()
    return path


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    ("box", "suffix", "shift"),
    [
        ("cubic", ".pdb", (0.05, 0.5, 0.93)), ("cubic", ".cif", (0.0, 0.0, 0.0)),
        ("octahedron", ".pdb", (0.1, 0.2, 0.3)), ("triclinic", ".cif", (0.55, 0.02, 0.98)),
        ("triclinic", ".gro", (0.5, 0.5, 0.0)),
    ],
)  # fmt: skip
def test_a_wrapped_molecule_has_the_distances_of_the_whole_one(box, suffix, shift, tmp_path):
    s = pc.load(written(wrapped("1l2y.pdb", BOXES[box], shift), tmp_path / f"x{suffix}"))
    sample = load("1l2y.pdb")
    assert (s.n_residues, s.n_atoms, s.losses) == (20, 304, ())
    assert pdist(s.positions) == pytest.approx(pdist(sample.positions), abs=DIGITS[suffix])
    assert any(repair.kind is Kind.MADE_WHOLE for repair in s.repairs)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("turns", [turns for turns in product((-1, 0, 1), repeat=3) if any(turns)][::5])
def test_a_chain_in_another_image_comes_back(turns, tmp_path):
    structure = gemmi.read_structure(str(STRUCTURES / "3i40.pdb"))
    structure.cell, structure.spacegroup_hm = BOXES["triclinic"], "P 1"
    structure.remove_ligands_and_waters()
    whole = pc.load(written(structure, tmp_path / "whole.pdb"))
    assert not any(repair.kind in (Kind.MADE_WHOLE, Kind.IMAGE_MOVED) for repair in whole.repairs)
    way = structure.cell.orthogonalize(gemmi.Fractional(*turns))
    for place in structure[0].all():
        if place.chain.name == "B":
            place.atom.pos = gemmi.Position(*(place.atom.pos + way).tolist())
    s = pc.load(written(structure, tmp_path / "x.pdb"))
    assert s.positions == pytest.approx(whole.positions, abs=2e-4)
    sulphurs = s.atom_element[s.bonds] == "S"
    assert (s.bonds == whole.bonds).all() and sulphurs.all(axis=1).sum() == 3


@pytest.mark.parametrize("name", ["1ejg.pdb", "4pti.pdb", "1ubq.cif", "3i40.pdb"])
def test_crystals_stay_as_they_are(name):
    parsed = gemmi.read_structure(str(STRUCTURES / name))
    at = {
        (p.chain.name, str(p.residue.seqid), p.atom.name, p.atom.altloc): p.atom.pos.tolist()
        for p in parsed[0].all()
    }
    s = load(name)
    (known,) = np.nonzero(s.origin.place >= 0)
    read = 10.0 * s.positions[known]
    names = [s.origin.atoms[k].split("/") for k in s.origin.place[known]]
    keys = [(chain, number, atom, altloc[0] if altloc else "\0") for chain, number, _, atom, *altloc in names]
    shared = [k for k, key in enumerate(keys) if key in at and key[:3] not in turned_amides(s)]
    assert parsed.cell.is_crystal() and len(shared) > 300
    assert read[shared] == pytest.approx(np.array([at[keys[k]] for k in shared]), abs=1e-9)
    assert not any(repair.kind in (Kind.MADE_WHOLE, Kind.IMAGE_MOVED) for repair in s.repairs)


@pytest.mark.filterwarnings("ignore")
def test_a_wrapped_topology_serves_the_frames_of_a_trajectory(tmp_path):
    import mdtraj

    path = written(wrapped("1l2y.pdb", BOXES["cubic"], (0.05, 0.5, 0.93)), tmp_path / "top.pdb")
    frame = mdtraj.load(str(path))
    frame.save_xtc(str(tmp_path / "x.xtc"))
    (frame,) = frames = open_frames(tmp_path / "x.xtc")
    at = Ensemble.of(pc.load(path), frames).at(frame)
    assert pdist(at.positions) == pytest.approx(pdist(load("1l2y.pdb").positions), abs=2e-3)


@pytest.mark.parametrize("cell", BOXES.values(), ids=BOXES)
def test_the_image_that_touches_is_the_shift_undone(cell):
    lattice = np.array(cell.orth.mat.tolist()).T
    draw = np.random.default_rng(3)
    others, x = draw.normal(size=(40, 3)), draw.normal(loc=(4.0, 0.0, 0.0), size=(20, 3))
    for turns in product((-1.0, 0.0, 1.0), repeat=3):
        back = touching_image(KDTree(others), x - np.array(turns) @ lattice, lattice, 6.0)
        assert back == pytest.approx(turns)
    assert touching_image(KDTree(others), x + 0.5 * lattice.sum(axis=0), lattice, 1.0) is None
