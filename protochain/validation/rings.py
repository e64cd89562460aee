"""Threaded rings: a bond that goes through a ring, which no minimiser can undo without breaking a bond."""

from collections import deque
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from protochain.core.arrays import Floats, Integers, cross, distance, read_only
from protochain.core.graph import Neighbours, neighbours
from protochain.core.settings import document_fields
from protochain.structure.molecule.model import Structure, per_positions, per_structure
from protochain.validation.layout import positions

LARGEST = 20
"""Atoms of the largest ring examined. A chain cannot pass through such a small ring. Macrocycles that are
threaded in nature, for example lasso peptides, have more."""
_SMALL = 7  # Atoms of the largest ring that is nearly flat. Its surface is spanned from its centre.
_LONG = 0.25  # nm. Longer bonds are compared with every ring.


@document_fields
@dataclass(frozen=True)
class ThreadedRing:
    """A ring, and a bond that goes through it."""

    residue: int  # Residue of the ring, the first one if several form it.
    atoms: tuple[int, ...]  # Atoms of the ring, in their order around it.
    bond: tuple[int, int]  # Atoms of the bond.
    ring: str  # Name of the ring.
    through: str  # Name of the bond.

    def __str__(self) -> str:
        return f"{self.through} goes through {self.ring}"


def threaded_rings(structure: Structure, x: Floats | None = None) -> list[ThreadedRing]:
    """Find the rings that a bond goes through.

    Covered are rings of at most 20 atoms: those within residues (Phe, Tyr, Trp, His, Pro, and of molecules
    outside the protein). Also covered is the smallest ring through each bond between side chains, as of a
    disulfide, or between the ends of a chain. Larger loops, as of most disulfides, are not examined, because
    they can be threaded in nature, as in cystine knots. A ring of up to seven atoms is spanned by triangles
    from its centre, a larger one by the triangles of least total area.

    Every bond is compared, to hydrogens too. Exceptions are bonds that begin at the ring, bonds between
    residues of a ring of several residues, and bonds within fixed molecules if the ring is fixed too.

    Parameters
    ----------
    structure : Structure
        Structure to measure.
    x : (na, 3) float, nm, optional
        Positions to measure, by default the structure's own.

    Returns
    -------
    list of ThreadedRing
        In the order of the rings' first atoms.

    Raises
    ------
    ProtochainError
        If x has another shape.
    """
    return list(_find_threaded(structure, positions(structure, x)))


@per_positions
def _find_threaded(structure: Structure, x: Floats) -> tuple[ThreadedRing, ...]:
    ring_index, bonds = _near(structure, x)
    if not len(ring_index):
        return ()
    all_rings, (indices, row) = rings(structure), np.unique(ring_index, return_inverse=True)
    triangles = np.zeros((len(indices), LARGEST, 3, 3))  # those of no size are crossed by nothing
    for k, ring in enumerate(indices.tolist()):
        corners = x[list(all_rings[ring])]
        spanned = _fan(corners) if len(corners) <= _SMALL else corners[_least_area(corners)]
        triangles[k, : len(spanned)] = spanned
    crossed = _are_crossed(triangles[row], x[bonds[:, 0]], x[bonds[:, 1]])
    return tuple(
        _describe_threading(structure, all_rings[ring], (i, j))
        for ring, (i, j) in zip(ring_index[crossed].tolist(), bonds[crossed].tolist(), strict=True)
    )


@per_structure
def rings(structure: Structure) -> tuple[tuple[int, ...], ...]:
    """Rings of at most 20 atoms, in order, within residues or closed by side chains or ends of a chain."""
    residue_of = structure.atom_residue
    heavy = (structure.atom_element != "H")[structure.bonds].all(axis=1)
    bonds = structure.bonds[heavy]
    inside = residue_of[bonds[:, 0]] == residue_of[bonds[:, 1]]
    cycles: list[tuple[int, ...]] = []
    n = structure.n_residues
    atoms = np.bincount(residue_of[structure.atom_element != "H"], minlength=n)
    edges = np.bincount(residue_of[bonds[inside, 0]], minlength=n)
    # As many bonds as atoms: a ring. Molecules in several pieces would have fewer bonds.
    start = np.searchsorted(residue_of, np.arange(n))
    inner = bonds[inside]
    for residue in np.flatnonzero(edges >= atoms).tolist():
        bonded = inner[residue_of[inner[:, 0]] == residue] - start[residue]
        local = _cycles(tuple(map(tuple, bonded.tolist())))
        cycles += [tuple(int(start[residue]) + atom for atom in ring) for ring in local]
    cycles += _closed_rings(structure, bonds, bonds[~inside])
    return tuple(sorted(cycles))


def _closed_rings(structure: Structure, bonds: Integers, between: Integers) -> list[tuple[int, ...]]:
    """Smallest ring through each bond between residues that does not follow the chain."""
    metal = ~np.isin(structure.atom_element, ["C", "N", "O", "S"])
    residue, name = structure.atom_residue[between], structure.atom_name[between]
    follows = (np.abs(residue[:, 0] - residue[:, 1]) == 1) & (np.sort(name, axis=1) == ["C", "N"]).all(axis=1)
    closing = between[~follows & ~metal[between].any(axis=1)]
    if not len(closing):
        return []
    near = neighbours(bonds[~metal[bonds].any(axis=1)], structure.n_atoms)
    cycles = (_cycle(near, int(i), int(j)) for i, j in closing)
    return list({frozenset(ring): ring for ring in cycles if ring}.values())


@lru_cache(maxsize=256)
def _cycles(bonds: tuple[tuple[int, int], ...]) -> tuple[tuple[int, ...], ...]:
    """Smallest ring through each bond of a molecule, each ring once."""
    near = neighbours(np.array(bonds), 1 + max(map(max, bonds)))
    cycles = (_cycle(near, i, j) for i, j in bonds)
    return tuple({frozenset(ring): ring for ring in cycles if ring}.values())


def _cycle(near: Neighbours, i: int, j: int) -> tuple[int, ...]:
    """Smallest ring through the bond of i and j, empty if it has more than LARGEST atoms."""
    before, ahead, size = {i: i}, deque([(i, 1)]), 0
    while ahead and j not in before:
        atom, size = ahead.popleft()
        if size == LARGEST:
            return ()
        for neighbour in near[atom]:
            if neighbour not in before and {atom, neighbour} != {i, j}:
                before[neighbour] = atom
                ahead.append((neighbour, size + 1))
    if j not in before:
        return ()
    path = [j]
    while path[-1] != i:
        path.append(before[path[-1]])
    return tuple(path[::-1])


@per_structure
def _barred_atoms(structure: Structure) -> tuple[frozenset[int], ...]:
    """Atoms of each ring, and of all r of a ring of several: their bonds do not go through it."""
    residue_of, barred = structure.atom_residue, []
    for ring in rings(structure):
        r = np.unique(residue_of[list(ring)])
        barred.append(frozenset(ring if len(r) == 1 else np.flatnonzero(np.isin(residue_of, r)).tolist()))
    return tuple(barred)


def _near(structure: Structure, x: Floats) -> tuple[Integers, Integers]:
    """Indices (n,) of rings, and bonds (n, 2) that are near enough to go through them."""
    all_rings, bonds = rings(structure), structure.bonds
    if not all_rings:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 2), dtype=np.int64)
    middle = 0.5 * (x[bonds[:, 0]] + x[bonds[:, 1]])
    is_long = distance(*x[bonds.T]) > _LONG
    short, long = np.flatnonzero(~is_long), np.flatnonzero(is_long)
    corners = [x[list(ring)] for ring in all_rings]
    centre = np.array([points.mean(axis=0) for points in corners])
    reach = [distance(*ends).max() + 0.5 * _LONG for ends in zip(corners, centre, strict=True)]
    nearby = cKDTree(middle[short]).query_ball_point(centre, reach).tolist()
    fixed = np.asarray(structure.obstacle[bonds].all(axis=1))
    ring_index, near_bonds = [], []
    for ring, (atoms, barred) in enumerate(zip(all_rings, _barred_atoms(structure), strict=True)):
        near = np.concatenate([short[np.sort(np.array(nearby[ring], dtype=np.int64))], long])
        if structure.obstacle[list(atoms)].all():
            near = near[~fixed[near]]
        ends = [pair for pair in bonds[near].tolist() if not barred.intersection(pair)]
        ring_index += [ring] * len(ends)
        near_bonds += ends
    return np.array(ring_index, dtype=np.int64), np.array(near_bonds, dtype=np.int64).reshape(-1, 2)


def _fan(corners: Floats) -> Floats:
    """Triangles (n, 3, 3) from near a ring's centre to its sides. At the centre, round-off would decide."""
    weights = 1.0 + 0.03 * np.arange(len(corners))
    apex = np.broadcast_to(weights @ corners / weights.sum(), corners.shape)
    return np.stack([apex, corners, np.roll(corners, -1, axis=0)], axis=1)


def _least_area(corners: Floats) -> Integers:
    """Corners (n - 2, 3) of a polygon's least triangles (G. T. Klincsek, Ann. Discrete Math. 9:121, 1980)."""
    n = len(corners)
    cost, best = np.zeros((n, n)), np.zeros((n, n), dtype=np.int64)
    for width in range(2, n):
        for i in range(n - width):
            k, j = np.arange(i + 1, i + width), i + width
            area = 0.5 * np.linalg.norm(cross(corners[k] - corners[i], corners[j] - corners[i]), axis=1)
            total = cost[i, k] + cost[k, j] + area
            best[i, j] = k[np.argmin(total)]
            cost[i, j] = total.min()
    triangles, ahead = [], [(0, n - 1)]
    while ahead:
        first, last = ahead.pop()
        if last - first > 1:
            middle = int(best[first, last])
            triangles.append((first, middle, last))
            ahead += [(first, middle), (middle, last)]
    return read_only(triangles, np.int64)


def _are_crossed(triangles: Floats, start: Floats, end: Floats) -> NDArray[np.bool_]:
    """Whether lines (n,) from start to end go through an odd number of triangles (n, m, 3, 3), by volume."""
    along = (end - start)[:, None]
    a, b, c = (triangles[:, :, k] - start[:, None] for k in range(3))
    normal = cross(b - a, c - a)
    opposite = (normal * a).sum(axis=-1) * (normal * (a - along)).sum(axis=-1) < 0
    turns = np.stack([(cross(p, q) * along).sum(axis=-1) for p, q in ((a, b), (b, c), (c, a))])
    within = (turns > 0).all(axis=0) | (turns <= 0).all(axis=0)
    return np.asarray((opposite & within).sum(axis=1) % 2 == 1)


def _describe_threading(structure: Structure, atoms: tuple[int, ...], bond: tuple[int, int]) -> ThreadedRing:
    residue_of, name = structure.atom_residue, structure.atom_name
    residues = list(dict.fromkeys(residue_of[list(atoms)].tolist()))
    if len(residues) == 1:
        ring = f"the ring {'-'.join(name[list(atoms)].tolist())} of {structure.describe_residue(residues[0])}"
    else:
        first, last = structure.describe(atoms[0]), structure.describe(atoms[-1])
        ring = f"the ring of {len(atoms)} atoms that the bond between {first} and {last} closes"
    i, j = bond
    if residue_of[i] == residue_of[j]:
        through = f"bond {name[i]}-{name[j]} of {structure.describe_residue(int(residue_of[i]))}"
    else:
        through = f"the bond between {structure.describe(i)} and {structure.describe(j)}"
    return ThreadedRing(int(residue_of[list(atoms)].min()), atoms, bond, ring, through)
