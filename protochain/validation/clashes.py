"""Clashscore: pairs of atoms that overlap by 0.4 angstrom or more, hydrogens included, per 1000 atoms."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from protochain.chains.contacts import bonded_pairs
from protochain.core.arrays import GOLDEN, Floats, Integers, Value, cross, read_only
from protochain.core.graph import both_ways
from protochain.core.settings import document_fields
from protochain.core.units import ANGSTROM_PER_NM
from protochain.structure.molecule.model import Structure, per_structure
from protochain.validation.layout import positions
from protochain.validation.rings import rings

OVERLAP = 0.4  # Angstrom of overlap that make a clash.
_BOND, _CHARGED_BOND = 0.6, 0.8
"""Angstrom by which a hydrogen bond may overlap more, the second between opposite charges."""
_RADIUS = {
    "H": 1.22, "C": 1.70, "N": 1.55, "O": 1.40, "S": 1.80, "P": 1.80, "SE": 1.90, "F": 1.30, "CL": 1.77,
    "BR": 1.95, "I": 2.10, "LI": 0.60, "NA": 0.95, "K": 1.33, "RB": 1.48, "CS": 1.69, "MG": 0.65, "CA": 0.99,
    "SR": 1.10, "BA": 1.29, "MN": 0.80, "FE": 0.74, "CO": 0.70, "NI": 0.66, "CU": 0.72, "ZN": 0.71,
    "CD": 0.91, "HG": 1.00,
}  # fmt: skip
"""Angstrom, as in Probe, with Pauling's radii of ions."""
_RADIUS_UNKNOWN = 1.00
_DOTS = 24  # On each side of a contact.
_RIM = 0.85  # Share of the area of a contact that they cover: Probe has seldom a dot at its very rim.
_PORTION, _NEAREST = 2000, 8
"""Pairs per batch, and atoms compared first around a dot. They limit memory and time if atoms are crowded."""
_POLAR_OR_AROMATIC_H, _CARBONYL, _AROMATIC = 1.05, 1.65, 1.75

_LENGTH = {"C": 0.97, "N": 0.86, "O": 0.84, "S": 1.20}
_LENGTH_AROMATIC, _LENGTH_AMMONIUM = 0.93, 0.89
"""Angstrom from an atom to the centre of the electron cloud of its hydrogen, as Reduce places it."""


@document_fields
@dataclass(frozen=True, eq=False)
class Clashes(Value):
    """Clashes of a structure."""

    pairs: Integers  # (n, 2) int: Atoms that clash, the worst first.
    overlap_angstrom: Floats  # (n,) float: Overlaps of their radii.
    n_atoms: int  # Number of atoms, hydrogens included.

    @property
    def per_1000_atoms(self) -> float:
        """The clashscore."""
        return 1000.0 * len(self.pairs) / max(self.n_atoms, 1)

    def lines(self, structure: Structure) -> list[str]:
        """Describe each clash in a line, the worst first."""
        return [
            f"{structure.describe(i)} and {structure.describe(j)} overlap by {by:.2f} angstrom"
            for (i, j), by in zip(self.pairs.tolist(), self.overlap_angstrom.tolist(), strict=True)
        ]


def clashes(structure: Structure, x: Floats | None = None) -> Clashes:
    """Find the clashes that MolProbity counts: overlaps of 0.4 angstrom or more between atoms not bonded.

    As in MolProbity (Word et al., J. Mol. Biol. 285:1711, 1999; Williams et al., Protein Sci. 27:293, 2018)
    hydrogens are at the centres of their electron clouds, nearer to their atoms than their nuclei, with the
    radii for these. Pairs up to three bonds apart, four if one is a hydrogen, are excepted. So are hydrogen
    bonds: a hydrogen at N, O or S with an O, S, free N or aromatic ring, unless 0.4 angstrom too near for
    one. As in Probe, a contact counts for its pair of deepest overlap, unless in an atom bonded to either.

    Differences: Probe covers all atoms with dots, but this function only the contacts. MolProbity places
    hydrogens anew, and may turn amides and histidines, before it counts. Contacts within fixed molecules
    outside the protein are not counted here.

    Parameters
    ----------
    structure : Structure
        Structure to measure.
    x : (na, 3) float, nm, optional
        Positions to measure, by default the structure's own.

    Returns
    -------
    Clashes
        Pairs, the worst first, and the clashscore.

    Raises
    ------
    ProtochainError
        If x has another shape.
    """
    x = positions(structure, x)
    kinds = _kinds(structure)
    x = _at_clouds(structure, ANGSTROM_PER_NM * x)
    tree = cKDTree(x)
    pairs = tree.query_pairs(2 * kinds.radius.max() - OVERLAP, output_type="ndarray").astype(np.int64)
    pairs = np.sort(pairs[~structure.obstacle[pairs].all(axis=1)], axis=1)
    distance = np.linalg.norm(x[pairs[:, 0]] - x[pairs[:, 1]], axis=1)
    overlap = kinds.radius[pairs].sum(axis=1) - distance
    deep = overlap - _allowance(kinds, pairs) >= OVERLAP
    pairs, overlap = pairs[deep], overlap[deep]
    free = ~_is_excluded(structure, *pairs.T)
    pairs, overlap = pairs[free], overlap[free]
    is_visible = _is_seen(structure, tree, pairs)
    pairs, overlap = pairs[is_visible], overlap[is_visible]
    order = np.lexsort((pairs[:, 1], pairs[:, 0], -overlap))
    return Clashes(read_only(pairs[order], np.int64), read_only(overlap[order]), structure.n_atoms)


def clash_discs(structure: Structure) -> tuple[Integers, Floats]:
    """Pairs (n, 2) of atoms that clash, and the discs (n, 7) where their spheres cross."""
    # A disc has its centre, its normal and its radius, angstrom.
    pairs = clashes(structure).pairs
    x = _at_clouds(structure, ANGSTROM_PER_NM * structure.positions)[pairs]
    first, second = _kinds(structure).radius[pairs].T
    arm = x[:, 1] - x[:, 0]
    distance = np.maximum(np.linalg.norm(arm, axis=1), 1e-6)
    along = (distance**2 + first**2 - second**2) / (2.0 * distance)
    normal = arm / distance[:, None]
    radius = np.sqrt(np.maximum(first**2 - along**2, 0.0))
    return pairs, np.column_stack([x[:, 0] + along[:, None] * normal, normal, radius])


@dataclass(frozen=True, eq=False)
class _Kinds:
    """Radii, donors and acceptors of hydrogen bonds, charges, hydrogens, their parents and bond lengths."""

    radius: Floats
    donor: NDArray[np.bool_]
    acceptor: NDArray[np.bool_]
    charge: Integers
    hydrogens: Integers
    parents: Integers
    lengths: Floats


@per_structure
def _kinds(structure: Structure) -> _Kinds:
    element = np.char.upper(structure.atom_element)
    n, bonds = structure.n_atoms, structure.bonds
    ends = both_ways(bonds)
    is_h = element == "H"
    degree = np.bincount(ends[:, 0], minlength=n)
    n_hydrogens = np.bincount(ends[is_h[ends[:, 1]], 0], minlength=n)
    carbonyl, aromatic, six = (np.zeros(n, dtype=bool) for _ in range(3))
    end_oxygen = (element == "O") & (degree == 1)
    carbonyl[ends[end_oxygen[ends[:, 1]], 0]] = True
    flat = ~is_h & ((element != "C") | (degree == 3))
    for ring in rings(structure):
        atoms = list(ring)
        if len(atoms) in (5, 6) and flat[atoms].all():
            aromatic[atoms] = True
            six[atoms] |= len(atoms) == 6
    radius = np.array([_RADIUS.get(symbol, _RADIUS_UNKNOWN) for symbol in element.tolist()])
    radius[(element == "C") & aromatic] = _AROMATIC
    radius[(element == "C") & carbonyl] = _CARBONYL
    # A hydrogen has one bond; one without any, or a second, is read as it is.
    pairs = ends[is_h[ends[:, 0]] & ~is_h[ends[:, 1]]]
    hydrogens, first = np.unique(pairs[:, 0], return_index=True)
    parents = pairs[first, 1]
    polar = np.isin(element[parents], ["N", "O", "S"])
    radius[hydrogens[polar | aromatic[parents]]] = _POLAR_OR_AROMATIC_H
    lengths = np.array([_LENGTH.get(symbol, np.nan) for symbol in element[parents].tolist()])
    lengths[aromatic[parents] & (element[parents] == "C")] = _LENGTH_AROMATIC
    lengths[(element[parents] == "N") & (degree[parents] == 4)] = _LENGTH_AMMONIUM
    donor = np.zeros(n, dtype=bool)
    donor[hydrogens[polar]] = True
    acceptor = np.isin(element, ["O", "S"]) | ((element == "C") & six)
    acceptor |= (element == "N") & (n_hydrogens == 0) & (degree <= 2)
    charge = _charges(structure, ends, degree)
    charge[hydrogens] = charge[parents]
    return _Kinds(radius, donor, acceptor, charge, hydrogens, parents, lengths)


def _charges(structure: Structure, ends: Integers, degree: Integers) -> Integers:
    """Signs of charge: of ammonium and guanidinium nitrogens, of carboxylate oxygens, as their bonds say."""
    element, n = np.char.upper(structure.atom_element), structure.n_atoms
    end_oxygen = (element == "O") & (degree == 1)
    charge = np.sign(structure.formal_charge)
    charge[(element == "N") & (degree == 4)] = 1
    nitrogens = np.bincount(ends[(element == "N")[ends[:, 1]], 0], minlength=n)
    oxygens = np.bincount(ends[end_oxygen[ends[:, 1]], 0], minlength=n)
    guanidinium, carboxylate = (element == "C") & (nitrogens == 3), (element == "C") & (oxygens == 2)
    of_arginine, of_acid = ends[guanidinium[ends[:, 0]], 1], ends[carboxylate[ends[:, 0]], 1]
    charge[of_arginine[element[of_arginine] == "N"]] = 1
    charge[of_acid[end_oxygen[of_acid]]] = -1
    return np.asarray(charge)


def _at_clouds(structure: Structure, x: Floats) -> Floats:
    """Positions (na, 3) with hydrogens at the centres of their electron clouds, angstrom."""
    kinds, moved = _kinds(structure), np.array(x)
    arm = x[kinds.hydrogens] - x[kinds.parents]
    length = np.linalg.norm(arm, axis=1)
    has_length = np.isfinite(kinds.lengths) & (length > 0)
    share = kinds.lengths[has_length] / length[has_length]
    moved[kinds.hydrogens[has_length]] = x[kinds.parents[has_length]] + share[:, None] * arm[has_length]
    return moved


def _allowance(kinds: _Kinds, pairs: Integers) -> Floats:
    """Additional overlaps (n,) allowed for hydrogen bonds, 0 for other pairs, angstrom."""
    i, j = pairs.T
    bonded = (kinds.donor[i] & kinds.acceptor[j]) | (kinds.acceptor[i] & kinds.donor[j])
    product = kinds.charge[i] * kinds.charge[j]
    return np.where(bonded & (product <= 0), np.where(product < 0, _CHARGED_BOND, _BOND), 0.0)


def _is_excluded(structure: Structure, i: Integers, j: Integers) -> NDArray[np.bool_]:
    """Whether atoms i and j (n,) are too few bonds apart to clash."""
    code, excluded = np.minimum(i, j) * structure.n_atoms + np.maximum(i, j), _excluded_pairs(structure)
    index = np.minimum(np.searchsorted(excluded, code), len(excluded) - 1)
    return excluded[index] == code if len(excluded) else np.zeros(len(code), dtype=bool)


@per_structure
def _excluded_pairs(structure: Structure) -> Integers:
    """Pairs (n,) up to three bonds apart, four if one is a hydrogen, each as one number, ascending."""
    near, far = bonded_pairs(structure, 3), bonded_pairs(structure, 4)
    far = far[(structure.atom_element == "H")[far].any(axis=1)]
    return np.sort(np.concatenate([near, far]) @ np.array([structure.n_atoms, 1]))


def _is_seen(structure: Structure, tree: cKDTree, pairs: Integers) -> NDArray[np.bool_]:
    """Whether the contact of a pair (n, 2) can be seen from one of its atoms: in the middle, or around it."""
    seen = np.zeros(len(pairs), dtype=bool)
    for share in (np.zeros(1), np.sqrt(_RIM * np.arange(1, _DOTS) / (_DOTS - 1))):
        for way in (pairs, pairs[:, ::-1]):
            unseen = np.flatnonzero(~seen)
            for batch in np.split(unseen, range(_PORTION, len(unseen), _PORTION)):
                seen[batch] = _has_free_dot(structure, tree, way[batch], share)
    return seen


def _has_free_dot(structure: Structure, tree: cKDTree, pairs: Integers, share: Floats) -> NDArray[np.bool_]:
    """Whether a dot on the first atom of pairs (n, 2) is deep in the second, in none bonded, none deeper."""
    x, kinds = np.asarray(tree.data), _kinds(structure)
    first, second = pairs.T
    dots = _dots(x[first], x[second], kinds.radius[pairs], _allowance(kinds, pairs) + OVERLAP, share)
    reach = (kinds.radius[second][:, None] - np.linalg.norm(dots - x[second][:, None], axis=-1)).ravel()
    dots, farthest = dots.reshape(-1, 3), kinds.radius.max()
    hidden = np.zeros(len(dots), dtype=bool)

    def hide(dot: Integers, atom: Integers) -> None:
        row = dot // len(share)
        depth = kinds.radius[atom] - np.linalg.norm(x[atom] - dots[dot], axis=1)
        excluded = _is_excluded(structure, first[row], atom)
        stranger = (atom != first[row]) & (atom != second[row])
        hidden[dot[np.where(excluded, depth > 0, stranger & (depth > reach[dot]))]] = True

    # The nearest atoms hide most dots. The other dots are compared with all atoms within reach.
    nearest = np.asarray(tree.query(dots, _NEAREST, distance_upper_bound=farthest)[1])
    dot, rank = np.nonzero(nearest < tree.n)
    hide(dot, nearest[dot, rank])
    visible = np.flatnonzero(~hidden)
    count = np.asarray(tree.query_ball_point(dots[visible], farthest, return_length=True))
    portion = _PORTION * _DOTS * _NEAREST
    ends = np.searchsorted(np.cumsum(count), range(portion, int(count.sum()), portion))
    for batch in np.split(visible, ends):
        near = tree.query_ball_point(dots[batch], farthest)
        if (number := [len(atoms) for atoms in near]) and sum(number):
            hide(np.repeat(batch, number), np.concatenate(near).astype(np.int64))
    return np.asarray(~hidden.reshape(len(pairs), len(share)).all(axis=1))


def _dots(a: Floats, b: Floats, radius: Floats, depth: Floats, share: Floats) -> Floats:
    """Dots (n, m, 3) on spheres about a (n, 3), in spheres about b by at least a depth (n,), radii (n, 2)."""
    arm = b - a
    distance = np.maximum(np.linalg.norm(arm, axis=1), 1e-6)
    axis = arm / distance[:, None]
    inner = np.maximum(radius[:, 1] - depth, 0.0)
    limit = (distance**2 + radius[:, 0] ** 2 - inner**2) / (2 * distance * radius[:, 0])
    cosine = 1.0 - share**2 * (1.0 - np.clip(limit, -1.0, 1.0)[:, None])
    sine = np.sqrt(np.maximum(1.0 - cosine**2, 0.0))
    e1 = cross(axis, np.eye(3)[np.argmin(np.abs(axis), axis=1)])
    e1 /= np.maximum(np.linalg.norm(e1, axis=1, keepdims=True), 1e-9)
    e2, turn = cross(axis, e1), GOLDEN * np.arange(len(share))
    around = np.cos(turn)[:, None] * e1[:, None] + np.sin(turn)[:, None] * e2[:, None]
    return np.asarray(
        a[:, None] + radius[:, :1, None] * (cosine[..., None] * axis[:, None] + sine[..., None] * around)
    )
