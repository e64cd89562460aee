"""Chirality of C-alpha, other chiral atoms of amino acids, sugars, and molecules with a source."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from protochain.core.arrays import Floats, Integers, cross
from protochain.core.graph import neighbours
from protochain.core.units import ANGSTROM_PER_NM
from protochain.structure.molecule.member import Member
from protochain.structure.molecule.model import BoundLigand, Structure, per_structure
from protochain.structure.molecule.residues import NUCLEOTIDES, Atom
from protochain.structure.molecule.sugars import letters_of, sugar_centres

WELL_FORMED = 2.2e-3
"""nm^3. Below this volume the configuration of a C-alpha may be noise. Ideal residues have 2.5e-3."""
_BONDED = 0.22  # nm. Largest distance of bonded neighbours. Atoms two bonds apart have 0.25.
_ALPHA = {"CA": ("N", "C", "CB")}
_CENTRES = {
    "THR": {**_ALPHA, "CB": ("CA", "OG1", "CG2")},
    "TPO": {**_ALPHA, "CB": ("CA", "OG1", "CG2")},
    "ILE": {**_ALPHA, "CB": ("CA", "CG1", "CG2")},
    "HYP": {**_ALPHA, "CG": ("CB", "CD", "OD1")},
}
"""Chiral atoms and three neighbours, seen clockwise from the fourth in an L-amino acid."""
_ALPHA_ORDERS = ("N", "C", "CB"), ("C", "CB", "N"), ("CB", "N", "C")
_SUGAR = {"C3'": ("C4'", "C2'", "O3'"), "C4'": ("C5'", "C3'", "O4'")}
for _name in NUCLEOTIDES:
    _ribose = {} if _name.startswith("D") else {"C2'": ("C3'", "C1'", "O2'")}
    _CENTRES[_name] = {"C1'": ("O4'", "C2'", "N9" if _name[-1] in "AG" else "N1"), **_SUGAR, **_ribose}


def centres(residue: str) -> dict[str, tuple[str, str, str]]:
    """Chiral atoms of a residue, each with three neighbours."""
    return _CENTRES.get(residue, _ALPHA)


def volume(x: Floats) -> Floats:
    """Signed volume (...) of the bonds of x (..., 4, 3): positive in an L-amino acid."""
    arms = x[..., 1:, :] - x[..., :1, :]
    return np.asarray((arms[..., 0, :] * cross(arms[..., 1, :], arms[..., 2, :])).sum(-1))


def chirality(member: Member, centre: str = "CA", least: float = 0.0) -> int:
    """Chirality of an atom: 1 for L, -1 for D, 0 if atoms are missing or the volume is small (nm^3)."""
    # An unbonded atom counts as missing, as CB of a peptoid.
    neighbours = centres(member.name).get(centre, ())
    atoms = [member.atom(name) for name in (centre, *neighbours)]
    x = np.array([atom.pos.tolist() for atom in atoms if atom is not None]) / ANGSTROM_PER_NM
    is_whole = len(x) == 4 and np.linalg.norm(x[1:] - x[0], axis=1).max() < _BONDED
    size = float(volume(x)) if is_whole else 0.0
    return int(np.sign(size)) if abs(size) > least else 0


def inverted_atoms(members: Sequence[Member]) -> list[Atom]:
    """List the chiral atoms whose configuration contradicts the name of the residue."""
    return [
        Atom(centre, member.residue)
        for member in members
        for centre in centres(member.name)
        if chirality(member, centre) == (1 if member.is_d else -1)
    ]


def changed_stereocentres(structure: Structure, x: Floats, reference: Floats) -> list[str]:
    """Name the chiral atoms (``CA of A:LYS14``) differing between positions (na, 3), nm."""
    atoms = chiral_atoms(structure)
    if not len(atoms):
        return []
    flipped = np.sign(volume(x[atoms])) != np.sign(volume(reference[atoms]))
    return atom_names(structure, atoms[flipped, 0])


def atom_names(structure: Structure, atoms: Integers) -> list[str]:
    """Name atoms (n,) of a structure, as :func:`changed_stereocentres` does."""
    return [str(structure.atom(atom)) for atom in atoms.tolist()]


def wrong_centres(structure: Structure, x: Floats, mirrored: NDArray[np.bool_]) -> Integers:
    """Find the chiral atoms (n,) at x (na, 3), nm, that are not L, or not D if ``mirrored`` (nr,)."""
    atoms = chiral_atoms(structure)
    signs = np.where(mirrored[structure.atom_residue[atoms[:, 0]]], -1.0, 1.0)
    return np.asarray(atoms[signs * volume(x[atoms]) < 0.0, 0])


def mirror_images(structure: Structure) -> dict[str, Integers]:
    """Find mirror-image chains: most stereocentres of their amino acids are D under L names."""
    atoms = chiral_atoms(structure)
    owner = structure.atom_residue[atoms[:, 0]]
    amino = np.isin(owner, structure.atom_residue[structure.alpha_carbons])
    atoms, owner = atoms[amino], owner[amino]
    chain = structure.residue_chain[owner]
    is_other = ~structure.mirrored[owner] & (volume(structure.positions[atoms]) < 0.0)
    masks = {str(name): chain == name for name in np.unique(chain)}
    return {name: np.unique(owner[mask]) for name, mask in masks.items() if is_other[mask].mean() > 0.5}


def with_mirror_images(structure: Structure) -> Structure:
    """Return the structure with the residues of mirror-image chains as D-amino acids."""
    mirrored = structure.mirrored.copy()
    mirrored[[r for residues in mirror_images(structure).values() for r in residues.tolist()]] = True
    return replace(structure, mirrored=mirrored)


@per_structure
def chiral_atoms(structure: Structure) -> Integers:
    """(n, 4) int: chiral atoms and three neighbours, of positive volume, or negative in ``mirrored``.

    Sources of ligands and fragments have priority over names. In ``mirrored`` residues, an L-amino acid is
    the mirror image of its source, and other residues follow their source.
    """
    names: list[dict[str, int]] = [{} for _ in range(structure.n_residues)]
    is_sugar = np.isin(structure.residue_name, [*NUCLEOTIDES])
    is_sugar[[*structure.glycans]] = True
    for i in np.flatnonzero(~structure.kept | (structure.mobile & is_sugar[structure.atom_residue])).tolist():
        names[int(structure.atom_residue[i])][str(structure.atom_name[i])] = i
    sugars = {r: sugar_centres(letters_of(code)) for r, code in structure.glycans.items()}
    quartets = {
        at[centre]: [at[name] for name in (centre, *neighbours)]
        for r, (residue, at) in enumerate(zip(structure.residue_name, names, strict=True))
        for centre, neighbours in sugars.get(r, centres(str(residue))).items()
        # Dehydroamino acids have a planar C-alpha.
        if {centre, *neighbours} <= at.keys() and len(structure.neighbours[at[centre]]) > 3
    }
    name, res = structure.atom_name, structure.atom_residue
    for ligand in (*structure.ligands, *structure.fragments):
        source_rows = [row for row in _source_centres(ligand) if min(row) >= 0]
        alphas = (row for row in source_rows if name[row[0]] == "CA")
        are_l = {res[row[0]] for row in alphas if tuple(name[row[1:]].tolist()) in _ALPHA_ORDERS}
        for i, a, b, c in source_rows:
            quartets[i] = [i, b, a, c] if structure.mirrored[res[i]] and res[i] not in are_l else [i, a, b, c]
    rows = np.array([*quartets.values()], dtype=np.int64).reshape(-1, 4)
    ends = np.sort(np.stack(np.broadcast_arrays(rows[:, :1], rows[:, 1:])), axis=0)
    bonded = np.sort(structure.bonds, axis=1) @ [structure.n_atoms, 1]
    return rows[np.isin(ends[0] * structure.n_atoms + ends[1], bonded).all(axis=1)]


def _source_centres(ligand: BoundLigand) -> Iterator[list[int]]:
    """Stereocentres of a molecule, each with three neighbours, heavy ones first, and -1 for cap atoms."""
    molecule = ligand.ligand.molecule
    near = neighbours(molecule.bonds, molecule.n_atoms)
    for centre in np.flatnonzero(molecule.handedness).tolist():
        bonded = near[centre]
        order = sorted(range(len(bonded)), key=lambda k: (molecule.elements[bonded[k]] == 1, k))
        swaps = sum(a > b for a, b in combinations(order, 2))
        # Clockwise in RDKit: the first three neighbours span a negative volume.
        positive = (molecule.handedness[centre] == 2) == (swaps % 2 == 0)
        a, b, c = (bonded[k] for k in order[:3])
        yield ligand.atoms[[centre, *((a, b, c) if positive else (b, a, c))]].tolist()
