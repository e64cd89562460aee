"""Hinges of a structure: its rotatable bonds, and the rigid groups of atoms that they join."""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from protochain.core.arrays import Floats, Integers, cross, read_only
from protochain.core.graph import Neighbours, beyond, components, group_members, neighbours
from protochain.ligands.molecule import Molecule
from protochain.structure.molecule import residues
from protochain.structure.molecule.dihedrals import dihedral_finder
from protochain.structure.molecule.model import Structure, per_structure
from protochain.structure.molecule.sugars import last_of_ring

HINGES = ("phi", "psi", "omega", "chi", "polar", "rotors", "angles", "nucleic", "ligand", "glycan")
"""Kinds of hinge that can be opened. ``polar`` is the rotors that turn hydrogens of O, S and N."""
ON_AXIS = np.deg2rad(5.0)
"""A hinge with all outer atoms this close to its axis is closed: threshold of cctbx's scitbx/rigid_body."""


@dataclass(frozen=True)
class Hinge:
    """Dihedral or bond angle that is a degree of freedom."""

    chain: str  # Residue of the dihedral, as in the file.
    residue_name: str
    residue_number: str
    insertion_code: str
    # ``phi``, ``psi``, ``omega``, ``chi1`` ... ``chi5`` or ``rotor``; ``angle N`` or ``angle CA``; of a
    # nucleotide ``alpha``, ``beta``, ``gamma``, ``epsilon``, ``zeta`` or ``base``; ``torsion`` of a ligand or
    # a glycan.
    kind: str
    # Four of a dihedral about the bond atoms[1]-atoms[2], or three of a bond angle at atoms[1].
    atoms: tuple[int, ...]

    @property
    def is_angle(self) -> bool:
        """Whether it is a bond angle rather than a dihedral."""
        return len(self.atoms) == 3

    @property
    def on_axis(self) -> tuple[int, ...]:
        """Atoms on the hinge axis."""
        return self.atoms[1:2] if self.is_angle else self.atoms[1:3]

    @property
    def name(self) -> str:
        """Name of the hinge, as ``phi A:3``. All torsions of a ligand have one name."""
        return f"{self.kind} {self.chain}:{self.residue_number}{self.insertion_code}"

    def __str__(self) -> str:
        number = f"{self.residue_number}{self.insertion_code}"
        return f"{self.kind} of {self.residue_name} {number} chain {self.chain}"


@per_structure
def cross_links(structure: Structure) -> np.ndarray:
    """(nbonds,) bool: bonds between residues not along chains. A molecule is rigid at its first bond."""
    first, second = structure.bonds.T
    r1, r2 = structure.atom_residue[first], structure.atom_residue[second]
    peptide = (r2 == r1 + 1) & (structure.atom_name[first] == "C") & (structure.atom_name[second] == "N")
    free = structure.mobile[first] | structure.mobile[second]
    with_hetero = structure.kept[first] | structure.kept[second]
    cut = (r1 != r2) & (with_hetero | ~peptide) & ~free
    to_protein = np.flatnonzero(
        cut & structure.kept[second] & ~structure.obstacle[second] & ~structure.kept[first]
    )
    _, rows = np.unique(second[to_protein], return_index=True)
    cut[to_protein[rows]] = False
    cut |= (r1 != r2) & free & structure.coordination
    borne = (r1 != r2) & (structure.mobile[first] != structure.mobile[second]) & ~cut
    piece = components(structure.bonds[~cut & ~borne], structure.n_atoms)
    for row in np.flatnonzero(borne).tolist():
        first_piece, second_piece = piece[structure.bonds[row]]
        cut[row] = first_piece == second_piece
        piece[piece == second_piece] = first_piece
    return read_only(cut, np.bool_)


@per_structure
def find_hinges(structure: Structure, kinds: tuple[str, ...]) -> tuple[Hinge, ...]:
    """Dihedrals of these kinds whose four atoms are present, in residue order."""
    return (*_hinges(structure, kinds),)


def _hinges(structure: Structure, kinds: tuple[str, ...]) -> Iterator[Hinge]:
    modified = _find_modified(structure)
    requested = {*kinds, "rotors"} if "polar" in kinds else {*kinds}
    index, bonds_of = dihedral_finder(structure, requested)
    for r in range(structure.n_residues):
        named_bonds = bonds_of(r)
        if r in modified and {*residues.BACKBONE} <= index[r].keys():
            named_bonds += _by_graph(structure, index[r])
        for kind, label, (a, b, c, d) in named_bonds:
            if a is None or b is None or c is None or d is None:
                continue
            is_polar = kind == "rotors" and structure.atom_element[c] != "C"
            if kind in kinds or (is_polar and "polar" in kinds):
                yield _hinge(structure, r, label, (a, b, c, d))
    if "ligand" in kinds:
        for bound in structure.ligands:
            residue = int(structure.atom_residue[bound.atoms[0]])
            for atoms in _turning_bonds(bound.ligand.molecule):
                yield _hinge(structure, residue, "torsion", tuple(bound.atoms[list(atoms)].tolist()))

    if "glycan" in kinds:
        ends = structure.atom_residue[structure.bonds]
        linked = (ends[:, 0] != ends[:, 1]) & np.isin(ends, [*structure.glycans]).any(axis=1)
        for first, second in structure.bonds[linked].tolist():
            is_carbon = structure.atom_element[first] == "C"
            path = (*_towards_ring(structure, *((first, second) if is_carbon else (second, first))),)
            for k in range(len(path) - 3):
                yield _hinge(structure, int(structure.atom_residue[path[1]]), "torsion", path[k : k + 4])


def _towards_ring(structure: Structure, anomeric: int, bearing: int) -> Iterator[int]:
    """Atoms of the turning bonds from an anomeric carbon to the ring it is linked to, and one before."""
    element, near = structure.atom_element, structure.neighbours
    yield next(k for k in near[anomeric] if k != bearing and element[k] != "H")
    yield anomeric
    yield bearing
    last = next(k for k in near[bearing] if k != anomeric and element[k] != "H")
    yield last
    r = int(structure.atom_residue[last])
    at = {str(structure.atom_name[k]): int(k) for k in np.flatnonzero(structure.atom_residue == r)}
    if r in structure.glycans:
        k = int(str(structure.atom_name[last])[1:]) - 1
        outside = range(k, min(k, last_of_ring(structure.glycans[r]) - 1) - 1, -1)
        for number in outside if k else [2]:
            yield at[f"C{number}"]
    elif element[bearing] == "O":  # The amide of asparagine does not turn.
        yield at["CA"]


def _hinge(structure: Structure, r: int, label: str, atoms: tuple[int, ...]) -> Hinge:
    return Hinge(
        str(structure.residue_chain[r]), str(structure.residue_name[r]), str(structure.residue_number[r]),
        str(structure.residue_insertion_code[r]), label, atoms,
    )  # fmt: skip


def _turning_bonds(molecule: Molecule) -> Iterator[tuple[int, int, int, int]]:
    """Acyclic single bonds between heavy atoms with further neighbours, with an atom before and one after."""
    heavy = molecule.elements != 1
    bonds = molecule.bonds
    near = neighbours(bonds[heavy[bonds].all(axis=1)], molecule.n_atoms)
    for k, (b, c) in enumerate(bonds.tolist()):
        if molecule.orders[k] != 1 or min(len(near[b]), len(near[c])) < 2:
            continue
        piece = components(np.delete(bonds, k, axis=0), molecule.n_atoms)
        if piece[b] != piece[c] and not _is_amide(molecule, near, b, c):
            yield next(a for a in near[b] if a != c), b, c, next(d for d in near[c] if d != b)


def _is_amide(molecule: Molecule, near: Neighbours, b: int, c: int) -> bool:
    """Whether a bond links a nitrogen to a carbon with a double bond to oxygen, nitrogen or sulphur."""
    double = {frozenset(bond) for bond in molecule.bonds[molecule.orders == 2].tolist()}
    return any(
        molecule.elements[n] == 7
        and any(molecule.elements[k] in (7, 8, 16) and frozenset((o, k)) in double for k in near[o])
        for n, o in ((b, c), (c, b))
    )


def _find_modified(structure: Structure) -> set[int]:
    """Residues of the protein whose side chains are in no table."""
    present = np.unique(structure.atom_residue[~structure.kept])
    tabulated = [*residues.STANDARD, *residues.CAPS]
    return {*present[~np.isin(structure.residue_name[present], tabulated)].tolist()}


def _by_graph(structure: Structure, index: Mapping[str, int]) -> Iterator[tuple[str, str, list[int | None]]]:
    """Yield kind, name and atoms of turning side-chain bonds, outwards, without rings and planar pairs."""
    atoms = [*index.values()]
    near = neighbours(structure.bonds[np.isin(structure.bonds, atoms).all(axis=1)], structure.n_atoms)
    element, number = structure.atom_element, 0
    trigonal = {a for a in atoms if element[a] == "C" and len(near[a]) == 3}
    planar = trigonal | {a for a in atoms if element[a] == "N" and {*near[a]} & trigonal}
    before = {index["N"]: index["CA"], index["CA"]: index["N"]}
    queue = [*before]
    seen = {*queue, index["C"]}
    for a in queue:
        for b in (neighbour for neighbour in near[a] if neighbour not in seen):
            seen.add(b)
            queue.append(b)
            before[b] = a
            tips = sorted((tip for tip in near[b] if tip != a), key=lambda tip: element[tip] == "H")
            in_ring = bool({*near[a]} - {b} & beyond(near, a, b))
            if not tips or {a, b} <= planar or in_ring:
                continue
            is_chi = element[tips[0]] != "H"
            number += is_chi
            kind, label = ("chi", f"chi{number}") if is_chi else ("rotors", "rotor")
            yield kind, label, [before[a], a, b, tips[0]]


def turning_hinges(
    structure: Structure, bonds: Integers, hinges: list[Hinge]
) -> tuple[list[Hinge], Integers]:
    """Hinges that turn some inertia, and the rigid group of each atom. Repeats until all hinges do."""
    while True:
        group = _without_hinges(structure.n_atoms, bonds, hinges)
        hinges = [hinge for hinge in hinges if group[hinge.atoms[1]] != group[hinge.atoms[2]]]
        if closing := _in_rings(group, hinges):
            hinges = [hinge for k, hinge in enumerate(hinges) if k not in closing]
            continue
        members = group_members(group)
        touching = Counter(group[[hinge.atoms[1:3] for hinge in hinges]].ravel().tolist())
        real = [
            hinge
            for hinge in hinges
            if not any(
                touching[group[end]] == 1 and _on_axis(structure.positions, members[group[end]], start, end)
                for start, end in (hinge.atoms[1:3], hinge.atoms[2:0:-1])
            )
        ]
        if len(real) == len(hinges):
            return hinges, group
        hinges = real


def _without_hinges(n_atoms: int, bonds: Integers, hinges: list[Hinge]) -> Integers:
    """(na,) int: component of each atom without hinge bonds. Both ends of a ring bond are in one."""
    turning = {frozenset(hinge.atoms[1:3]) for hinge in hinges}
    rigid = np.array([frozenset(bond) not in turning for bond in bonds.tolist()], dtype=bool)
    return components(bonds[rigid], n_atoms)


def _in_rings(group: Integers, hinges: list[Hinge]) -> set[int]:
    """Hinges whose groups (na,) form rings with others, by the paths of a spanning forest."""
    ends = group[np.array([hinge.atoms[1:3] for hinge in hinges], dtype=np.int64).reshape(-1, 2)].tolist()
    at: dict[int, list[int]] = {}
    for k, pair in enumerate(ends):
        for end in pair:
            at.setdefault(end, []).append(k)
    # Hinge towards the root of each group, and number of hinges to the root.
    inward, depth = dict[int, int](), dict[int, int]()
    for root in at:
        queue = [] if root in depth else [root]
        depth.setdefault(root, 0)
        for first in queue:
            for k in at[first]:
                second = ends[k][ends[k][0] == first]
                if second not in depth:
                    inward[second], depth[second] = k, depth[first] + 1
                    queue.append(second)
    closing: set[int] = set()
    for k in {*range(len(ends))} - {*inward.values()}:
        closing.add(k)
        first, second = ends[k]
        while first != second:
            first, second = (first, second) if depth[first] >= depth[second] else (second, first)
            closing.add(inward[first])
            first = ends[inward[first]][ends[inward[first]][0] == first]
    return closing


def _on_axis(x: Floats, members: Integers, start: int, end: int) -> bool:
    """Whether all members of the group of ``end`` are within ON_AXIS of the axis, seen from that atom."""
    axis = (x[end] - x[start]) / np.linalg.norm(x[end] - x[start])
    arms = x[members] - x[end]
    across = np.linalg.norm(cross(arms, axis), axis=1)
    return bool(np.all(across <= np.sin(ON_AXIS) * np.linalg.norm(arms, axis=1)))
