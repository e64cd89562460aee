"""Molecules broken by a periodic box are made whole, and chains in another image are moved back.

Positions move by lattice vectors only. A whole structure stays unchanged, bit for bit.
"""

from itertools import pairwise, product

import gemmi
import numpy as np
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree
from scipy.spatial import KDTree

from protochain.core.arrays import Floats, Integers
from protochain.core.graph import components, group_members
from protochain.structure.molecule.member import residue_in_file
from protochain.structure.molecule.repairs import Kind, Repair
from protochain.structure.molecule.residues import Residue
from protochain.structure.preparation.structure_draft import Changes, Draft

_MIN_CELL = 3.0
"""Angstrom. No molecule has a cell as thin as this. Files without a box state 1 angstrom or 0."""
_BONDED, _LINKED = 2.2, 3.0
"""Angstrom: longest bonds within residues, and between residues, also in models with distorted bonds."""
_DISULFIDE = 2.5
_CONTACT = 6.0  # Angstrom between heavy atoms of molecules that touch, as in frames.
_MAX_ATOMS = 2000  # Atoms of the largest residue that is examined.
_LINKS = (("C", "N"), ("O3'", "P"))


class _Molecules:
    """Positions of the residues of a model, and the lattice vectors by which they move."""

    def __init__(self, model: gemmi.Model, cell: gemmi.UnitCell) -> None:
        self.residues = [(chain, residue) for chain in model for residue in chain]
        self.atoms = [atom for _, residue in self.residues for atom in residue]
        sizes = [len(residue) for _, residue in self.residues]
        self.residue_of = np.repeat(np.arange(len(sizes)), sizes)
        self.starts = np.concatenate([[0], np.cumsum(sizes)])
        self.lattice = np.array(cell.orth.mat.tolist()).T
        self.to_fractions = np.linalg.inv(self.lattice)
        self.x = np.array([atom.pos.tolist() for atom in self.atoms])
        self.shifts = np.zeros((len(self.x), 3))
        self.piece = np.arange(len(sizes))
        owner = self.residue_of.tolist()
        self.ends = {(owner[k], a.name): k for k, a in enumerate(self.atoms) if a.name in {*sum(_LINKS, ())}}

    def positions(self, atoms: Integers) -> Floats:
        """Return the positions of atoms after their moves."""
        return np.asarray(self.x[atoms] + self.shifts[atoms] @ self.lattice)

    def nearest_image(self, first: int, second: int) -> tuple[Floats, float, float]:
        """Return the shifts to another atom's nearest image, and the distances with and without them."""
        vector = np.diff(self.positions(np.array([first, second])), axis=0)[0]
        shifts = np.round(vector @ self.to_fractions)
        return shifts, float(np.linalg.norm(vector - shifts @ self.lattice)), float(np.linalg.norm(vector))

    def join_within(self) -> None:
        """Move the atoms of each residue together."""
        fractions = self.x @ self.to_fractions
        low, high = (extreme.reduceat(fractions, self.starts[:-1]) for extreme in (np.minimum, np.maximum))
        is_wide = (high - low > 0.5).any(axis=1)
        for residue in np.flatnonzero(is_wide).tolist():
            atoms = np.arange(self.starts[residue], self.starts[residue + 1])
            if len(atoms) <= _MAX_ATOMS:
                self.shifts[atoms] = self._residue_shifts(self.x[atoms], self.residues[residue][1])

    def _residue_shifts(self, x: Floats, residue: gemmi.Residue) -> Floats:
        shifts = np.zeros((len(x), 3))
        direct = KDTree(x).query_pairs(_BONDED, output_type="ndarray")
        if len(np.unique(components(direct, len(x)))) == 1:
            return shifts
        vectors = x[None] - x[:, None]
        images = np.round(vectors @ self.to_fractions)
        length = np.linalg.norm(vectors - images @ self.lattice, axis=-1) + np.finfo(float).eps
        if not {"CA", "C1'"} & {atom.name for atom in residue}:
            # Molecules that share a number may be anywhere: only bonds join them.
            length[length > _BONDED] = 0.0
        tree = minimum_spanning_tree(length)
        order, parent = breadth_first_order(tree, 0, directed=False)
        for k in order[1:]:
            shifts[k] = shifts[parent[k]] - images[parent[k], k]
        return shifts

    def join_chains(self) -> None:
        """Move each residue to the residue before it, if they are bonded."""
        for r, following in pairwise(range(len(self.residues))):
            if self.residues[r][0].name != self.residues[following][0].name:
                continue
            for end, start in _LINKS:
                i, j = self.ends.get((r, end)), self.ends.get((following, start))
                if i is None or j is None:
                    continue
                shifts, nearest, length = self.nearest_image(i, j)
                if nearest < _LINKED:
                    self.piece[following] = self.piece[r]
                    if length >= _LINKED:
                        self.shifts[self.starts[following] : self.starts[following + 1]] -= shifts

    def move(self, piece: int, shifts: Floats) -> None:
        self.shifts[(self.piece == piece)[self.residue_of]] += shifts

    def join_disulfides(self) -> list[int]:
        """Move chains to their partners in disulfide bonds, and return the first residues of moved chains."""
        sulphurs = np.array([k for k, atom in enumerate(self.atoms) if atom.name == "SG"], dtype=np.int64)
        vectors = self.x[sulphurs][None] - self.x[sulphurs][:, None]
        vectors -= np.round(vectors @ self.to_fractions) @ self.lattice
        moved = []
        for i, j in sulphurs[np.argwhere(np.triu(np.linalg.norm(vectors, axis=-1) < _DISULFIDE, 1))].tolist():
            first, second = (int(self.piece[self.residue_of[k]]) for k in (i, j))
            if first != second:
                shifts, nearest, length = self.nearest_image(i, j)
                if nearest < _DISULFIDE <= length:
                    self.move(second, -shifts)
                    moved.append(second)
                if nearest < _DISULFIDE:
                    self.piece[self.piece == second] = first
        return moved

    def join_images(self) -> list[int]:
        """Move molecules without contacts to an image in contact, and return their first residues."""
        heavy = np.array([k for k, atom in enumerate(self.atoms) if not atom.is_hydrogen()])
        groups = [heavy[atoms] for atoms in group_members(self.piece[self.residue_of[heavy]])]
        # Waters stay: they are obstacles at most, and many.
        groups = [atoms for atoms in groups if [self.atoms[k].element.name for k in atoms] not in ([], ["O"])]
        pieces = {int(self.piece[self.residue_of[atoms[0]]]): atoms for atoms in groups}
        counts = np.bincount(self.piece)
        chains = [piece for piece in pieces if counts[piece] > 1]
        moved: list[int] = []
        placed = chains[:1]
        remaining = chains[1:]
        while remaining:
            tree = KDTree(self.positions(np.concatenate([pieces[piece] for piece in placed])))
            images = {piece: self._image(tree, pieces[piece]) for piece in remaining}
            # Chains in contact come first, then chains with an image in contact, then the unmoved others.
            ranks = {piece: 2 if shifts is None else int(shifts.any()) for piece, shifts in images.items()}
            chosen = min(remaining, key=ranks.__getitem__)
            moved += self._move_to_image(chosen, images[chosen])
            placed.append(chosen)
            remaining.remove(chosen)
        if placed:
            tree = KDTree(self.positions(np.concatenate([pieces[piece] for piece in placed])))
            for piece in (p for p in pieces if counts[p] == 1):
                moved += self._move_to_image(piece, self._image(tree, pieces[piece]))
        return moved

    def _move_to_image(self, piece: int, shifts: Floats | None) -> list[int]:
        if shifts is None or not shifts.any():
            return []
        self.move(piece, shifts)
        return [piece]

    def _image(self, tree: KDTree, atoms: Integers) -> Floats | None:
        return touching_image(tree, self.positions(atoms), self.lattice, _CONTACT)


def touching_image(tree: KDTree, x: Floats, lattice: Floats, contact: float) -> Floats | None:
    """Return how many of each lattice vector (3,) to add to a molecule so that it touches others.

    The molecule is at x (n, 3), the others are in the tree, and rows of the lattice (3, 3) are its vectors,
    all in one unit. Zeros if the molecule touches the others unmoved, or None if no image is within the
    contact distance.
    """
    if np.min(tree.query(x)[0]) < contact:
        return np.zeros(3)
    shifts = np.array([*product((-1.0, 0.0, 1.0), repeat=3)])
    nearest = [float(np.min(tree.query(x + shift @ lattice)[0])) for shift in shifts]
    return shifts[int(np.argmin(nearest))] if min(nearest) < contact else None


def make_whole(draft: Draft) -> Changes:
    """Make the molecules of a model whole by the cell of its file, and report the moved molecules."""
    structure, model, cell = draft.file, draft.model, draft.file.cell
    if min(cell.a, cell.b, cell.c) < _MIN_CELL or not cell.is_crystal():
        return
    molecules = _Molecules(model, cell)
    molecules.join_within()
    molecules.join_chains()
    broken = np.unique(molecules.residue_of[molecules.shifts.any(axis=1)]).tolist()
    moved = molecules.join_disulfides()
    # Chains of crystals stay in the asymmetric unit.
    if broken or structure.spacegroup_hm.replace(" ", "") in ("", "P1"):
        moved += molecules.join_images()
    for k in np.flatnonzero(molecules.shifts.any(axis=1)).tolist():
        molecules.atoms[k].pos = gemmi.Position(*molecules.positions(np.array([k]))[0].tolist())
    box = " x ".join(f"{length:g}" for length in (cell.a, cell.b, cell.c))
    if broken:
        yield Repair.of(Kind.MADE_WHOLE, box=box, count=len(broken), residue=_residue(molecules, broken[0]))
    if moved:
        places = tuple(_residue(molecules, piece) for piece in dict.fromkeys(moved))
        yield Repair.of(Kind.IMAGE_MOVED, box=box, count=len(places), residues=places)


def _residue(molecules: _Molecules, k: int) -> Residue:
    chain, residue = molecules.residues[k]
    return residue_in_file(chain.name, residue)
