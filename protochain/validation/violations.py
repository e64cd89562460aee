"""Structural violations as AlphaFold counts them, also across chains, and covalent bonds of a wrong length.

Jumper et al., Nature 596:583 (2021), supplement 1.9.11, equations 44 to 46: ``find_structural_violations``
with a tolerance of 12 standard deviations for bonds and angles and of 1.5 angstrom for contacts. AlphaFold
skips bonds to hydrogen. Here all covalent bonds are compared with :mod:`protochain.validation.strain`.
"""

import csv
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from protochain.core.arrays import Floats, Integers, Value, distance, freeze, read_only
from protochain.core.graph import both_ways
from protochain.core.markup import plural
from protochain.core.settings import document_fields
from protochain.core.units import ANGSTROM_PER_NM
from protochain.structure.molecule.model import Structure, per_positions, per_structure
from protochain.structure.molecule.residues import STANDARD, STATE_PARENT
from protochain.validation.layout import positions
from protochain.validation.strain import bond_lines, wrong_bonds

_SIGMAS = 12.0
_OVERLAP = 1.5  # Angstrom by which two atoms may overlap.
_RADIUS = {"C": 1.7, "N": 1.55, "O": 1.52, "S": 1.8}  # AlphaFold's van der Waals radii, angstrom.

_BOND, _BOND_PROLINE = (1.329, 0.014), (1.341, 0.016)
"""Angstrom: length of C-N and its standard deviation, then for the N of a proline."""
_CA_C_N = (-0.4473, 0.014)
"""Cosine and standard deviation. AlphaFold up to 2.3, ColabFold and OpenFold use the deviation of the
bond here. AlphaFold uses 0.0311 since September 2025. The stricter, earlier value is used."""
_C_N_CA = (-0.5203, 0.0353)
_SOFT = 1e-6  # Added to squares under a root, as in AlphaFold's counts.
_CA, _C, _N = 1, 2, 0  # Places of backbone atoms in a residue.
_WIDTH = 14  # Heavy atoms of the largest amino acid, without the second oxygen of a terminus.
_TYPES = tuple(STANDARD)  # Amino acids, in the order of the tables.
_TABLE = Path(__file__).parent / "data" / "geometry.csv"  # Bond lengths and angles of the amino acids.


@document_fields
@dataclass(frozen=True, eq=False)
class Violations(Value):
    """Violations of a structure, true if there is one."""

    bonds: Integers  # (n, 2) int: Atoms C and N of peptide bonds of wrong length.
    angles_ca_c_n: Integers  # (n, 3) int: Atoms of wrong angles CA-C-N at peptide bonds.
    angles_c_n_ca: Integers  # (n, 3) int: Atoms of wrong angles C-N-CA at peptide bonds.
    clashes: Integers  # (n, 2) int: Atoms of different residues that overlap.
    # (n, 2) int: Atoms of one residue that are too near to one another or, one or two bonds apart, too far.
    within: Integers
    # (n, 2) int: Atoms of covalent bonds more than 0.3 angstrom longer or shorter than usual (to hydrogen
    # shorter by a third). All elements except metals count, in all molecules that move.
    covalent: Integers
    # (nr,) bool: Residues with an atom among these, for a wrong bond or angle both residues.
    per_residue: NDArray[np.bool_]

    @property
    def residues(self) -> Integers:
        """(n,) int: indices of the residues concerned, ascending."""
        return np.flatnonzero(self.per_residue)

    @property
    def clashing_atoms(self) -> Integers:
        """(n,) int: atoms that overlap with one of another residue, ascending."""
        return np.unique(self.clashes)

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of each kind: peptide bonds, their angles, clashes, distances, covalent bonds."""
        kinds = ("bonds", "angles_ca_c_n", "angles_c_n_ca", "clashes", "within", "covalent")
        return {kind: len(getattr(self, kind)) for kind in kinds}

    def __bool__(self) -> bool:
        return bool(self.per_residue.any())

    def __str__(self) -> str:
        if not self:
            return "no violations"
        angles = len(self.angles_ca_c_n) + len(self.angles_c_n_ca)
        counts = (
            (len(self.bonds), "peptide bond", ""),
            (angles, "angle at a peptide bond", "angles at peptide bonds"),
            (len(self.clashing_atoms), "atom in clashes", "atoms in clashes"),
            (len(self.within), "distance within a residue", "distances within residues"),
            (len(self.covalent), "covalent bond of a wrong length", "covalent bonds of a wrong length"),
        )
        parts = ", ".join(plural(*count) for count in counts if count[0])
        return f"violations in {plural(len(self.residues), 'residue')}: {parts}"

    def lines(self, structure: Structure, x: Floats | None = None) -> list[str]:
        """Describe each violation in a line, at x (na, 3), nm, by default the structure's own positions."""
        x = structure.positions if x is None else x
        covalent = [f"covalent bond: {line}" for line in bond_lines(structure, x, self.covalent)]
        x = ANGSTROM_PER_NM * x
        angles = np.vstack([self.angles_ca_c_n, self.angles_c_n_ca])
        cosine = _cosine(*(x[angles[:, k]] for k in range(3)))
        degrees = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
        bent = []
        for triple, value in zip(angles.tolist(), degrees.tolist(), strict=True):
            name = "-".join(structure.atom_name[triple].tolist())
            ends = sorted({int(structure.atom_residue[atom]) for atom in triple})
            where = " and ".join(structure.describe_residue(residue) for residue in ends)
            bent.append(f"angle: {name} of {where} is {value:.0f} degrees")
        bonds, clashes, within = (
            [
                f"{kind}: {structure.describe(i)} and {structure.describe(j)} are {r:.2f} angstrom apart"
                for (i, j), r in zip(pairs.tolist(), distance(*x[pairs.T]), strict=True)
            ]
            for kind, pairs in (("bond", self.bonds), ("clash", self.clashes), ("distance", self.within))
        )
        return [*bonds, *bent, *clashes, *within, *covalent]


def violations(structure: Structure, x: Floats | None = None) -> Violations:
    """Find the structural violations that AlphaFold counts, and covalent bonds of a wrong length.

    AlphaFold's rules are of the heavy atoms of the 20 amino acids, without the second oxygen of a terminus.
    Covalent bonds are measured of all molecules that move, with their hydrogens.

    Residues are neighbours if they are bonded, or follow one another in a chain with consecutive numbers. A
    chain that was split at a C-N bond that is far too long violates this bond.

    AlphaFold uses the number alone, in a file of several chains too. It compares no two residues of one
    number, and excludes C and N of consecutive numbers in any chains. This function compares all contacts
    between chains. In a single chain all counts except the covalent bonds are AlphaFold's.

    Parameters
    ----------
    structure : Structure
        Structure to measure.
    x : (na, 3) float, nm, optional
        Positions to measure, by default the structure's own.

    Returns
    -------
    Violations
        By kind, and the residues concerned.

    Raises
    ------
    ProtochainError
        If x has another shape.
    """
    return _violations(structure, positions(structure, x))


@per_positions
def _violations(structure: Structure, x: Floats) -> Violations:
    wrong_length = wrong_bonds(structure, x)
    covalent = wrong_length[~structure.obstacle[wrong_length].all(axis=1)]
    x = ANGSTROM_PER_NM * x
    violating = [
        read_only(atoms, np.int64)
        for atoms in (*_connections(structure, x), _clashes(structure, x), _within(structure, x), covalent)
    ]
    concerned = np.zeros(structure.n_residues, dtype=bool)
    for atoms in violating:
        concerned[structure.atom_residue[atoms]] = True
    bonds, ca_c_n, c_n_ca, clashes, within, covalent = violating
    return Violations(bonds, ca_c_n, c_n_ca, clashes, within, covalent, read_only(concerned, np.bool_))


def _connections(structure: Structure, x: Floats) -> tuple[Integers, Integers, Integers]:
    """Wrong bonds (n, 2), angles CA-C-N (n, 3) and angles C-N-CA (n, 3)."""
    joints, proline = _joints(structure)
    mean, sigma = np.where(proline[:, None], _BOND_PROLINE, _BOND).T
    ca, c, n, next_ca = (x[joints[:, k]] for k in range(4))
    return (
        joints[_is_off(_length(n - c), mean, sigma)][:, 1:3],
        joints[_is_off(_cosine(ca, c, n), *_CA_C_N)][:, :3],
        joints[_is_off(_cosine(c, n, next_ca), *_C_N_CA)][:, 1:],
    )


def _is_off(value: Floats, mean: Floats | float, sigma: Floats | float) -> NDArray[np.bool_]:
    return np.asarray(np.sqrt(_SOFT + (value - mean) ** 2) > _SIGMAS * sigma)


def _length(v: Floats) -> Floats:
    return np.asarray(np.sqrt(_SOFT + (v**2).sum(axis=-1)))


def _cosine(a: Floats, b: Floats, c: Floats) -> Floats:
    """Cosines (n,) of the angles at b."""
    u, v = a - b, c - b
    return np.asarray((u * v).sum(axis=-1) / (_length(u) * _length(v)))


def _clashes(structure: Structure, x: Floats) -> Integers:
    """Atoms (n, 2) of different residues that overlap."""
    atoms, radius, bonded = _contacts(structure)
    reach = 2 * max(_RADIUS.values()) - _OVERLAP
    pairs = np.sort(atoms[cKDTree(x[atoms]).query_pairs(reach, output_type="ndarray")], axis=1)
    residue, sulphur = structure.atom_residue, radius == _RADIUS["S"]
    different = residue[pairs[:, 0]] != residue[pairs[:, 1]]
    # AlphaFold spares all pairs of SG, bonded or not.
    spared = ((structure.atom_name[pairs] == "SG") & sulphur[pairs]).all(axis=1)
    spared |= np.isin(pairs @ [structure.n_atoms, 1], bonded)
    pairs = pairs[different & ~spared & (distance(*x[pairs.T]) < radius[pairs].sum(axis=1) - _OVERLAP)]
    return np.asarray(pairs[np.lexsort(pairs.T[::-1])])


def _within(structure: Structure, x: Floats) -> Integers:
    """Atoms (n, 2) of one residue at a wrong distance."""
    pairs, lower, upper = _neighbours(structure)
    length = distance(*x[pairs.T])
    return np.asarray(pairs[(length < lower) | (length > upper)])


@per_structure
def _neighbours(structure: Structure) -> tuple[Integers, Floats, Floats]:
    """Atoms (n, 2) of one residue, and the least and greatest distances allowed (n,), angstrom."""
    atom_at, kind = _places(structure)
    lower, upper = _bounds()
    i, j = np.triu_indices(atom_at.shape[1], 1)
    first, second = atom_at[:, i], atom_at[:, j]
    residue, pair = np.nonzero((first >= 0) & (second >= 0))
    row = kind[residue], i[pair], j[pair]
    pairs = np.sort(np.column_stack([first[residue, pair], second[residue, pair]]), axis=1)
    return pairs, lower[row], upper[row]


@cache
def _bounds() -> tuple[Floats, Floats]:
    """Least and greatest distances (20, 14, 14) allowed within a residue, angstrom."""
    mean, sigma = _distances()
    radius = np.zeros(mean.shape[:2])
    for (residue, name), place in _slots().items():
        radius[_TYPES.index(residue), place] = _RADIUS[name[0]]
    finite = np.isfinite(mean)
    contact = radius[:, :, None] + radius[:, None] - _OVERLAP
    return np.where(finite, mean - _SIGMAS * sigma, contact), np.where(finite, mean + _SIGMAS * sigma, np.inf)


@per_structure
def _joints(structure: Structure) -> tuple[Integers, NDArray[np.bool_]]:
    """Atoms CA, C, N, CA (n, 4) of neighbours in a chain, and whether N is a proline's."""
    atom_at, kind = _places(structure)
    carbon, nitrogen = atom_at[:, _C], atom_at[:, _N]
    residue, ends = structure.atom_residue, both_ways(structure.bonds)
    is_c, is_n = np.zeros(structure.n_atoms, dtype=bool), np.zeros(structure.n_atoms, dtype=bool)
    is_c[carbon[carbon >= 0]] = is_n[nitrogen[nitrogen >= 0]] = True
    bonded = residue[ends[is_c[ends[:, 0]] & is_n[ends[:, 1]]]]
    number = np.array([_as_number(text) for text in structure.residue_number.tolist()])
    follows = (structure.residue_chain[1:] == structure.residue_chain[:-1]) & (np.diff(number) == 1)
    first = np.flatnonzero(follows & (kind[1:] >= 0) & (kind[:-1] >= 0))
    pairs = np.unique(np.vstack([bonded, np.column_stack([first, first + 1])]), axis=0)
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    joints = np.column_stack([atom_at[pairs[:, 0]][:, [_CA, _C]], atom_at[pairs[:, 1]][:, [_N, _CA]]])
    complete = (joints >= 0).all(axis=1)
    proline = kind[pairs[:, 1]] == _TYPES.index("PRO")
    return read_only(joints[complete], np.int64), read_only(proline[complete], np.bool_)


def _as_number(text: str) -> float:
    """Residue number, or NaN for text without one, which follows nothing."""
    try:
        return float(text)
    except ValueError:
        return np.nan


@per_structure
def _contacts(structure: Structure) -> tuple[Integers, Floats, Integers]:
    """Atoms (n,) that may clash, radii (na,), and pairs that are bonded or joined C-N, each as one number."""
    atom_at, _ = _places(structure)
    atoms = np.sort(atom_at[atom_at >= 0])
    radius = np.array([_RADIUS.get(name[:1], 0.0) for name in structure.atom_name.tolist()])
    joined = np.vstack([_joints(structure)[0][:, 1:3], structure.bonds])
    bonded = np.sort(joined, axis=1) @ np.array([structure.n_atoms, 1])
    return read_only(atoms, np.int64), read_only(radius), read_only(bonded, np.int64)


@cache
def _norms() -> tuple[tuple[str, tuple[str, ...], float, float], ...]:
    """Residue, atoms, mean and deviation of bonds and angles, which have two and three atoms."""
    with _TABLE.open(newline="") as file:
        rows = list(csv.reader(file))[1:]
    return tuple((row[0], tuple(row[1].split("-")), float(row[2]), float(row[3])) for row in rows)


@cache
def _slots() -> dict[tuple[str, str], int]:
    """Place (0 to 13) of each heavy atom in its residue, by names of residue and atom: N, CA, C, O first."""
    place_of: dict[tuple[str, str], int] = {}
    for residue in _TYPES:
        others = (name for owner, atoms, *_ in _norms() if owner == residue for name in atoms)
        names = dict.fromkeys(("N", "CA", "C", "O", *others))
        place_of |= {(residue, name): place for place, name in enumerate(names)}
    return place_of


@cache
def _distances() -> tuple[Floats, Floats]:
    """Usual distances (20, 14, 14), angstrom, one or two bonds apart, and deviations, or NaN."""
    shape = (len(_TYPES), _WIDTH, _WIDTH)
    mean, sigma = np.full(shape, np.nan), np.full(shape, np.nan)
    for n_atoms in (2, 3):
        for residue, atoms, *value in _norms():
            if len(atoms) != n_atoms:
                continue
            kind, places = _TYPES.index(residue), [_slots()[residue, name] for name in atoms]
            if n_atoms == 3:
                i, j, k = places
                arms = ((mean[kind, i, j], sigma[kind, i, j]), (mean[kind, j, k], sigma[kind, j, k]))
                value = _opposite(*arms, np.radians(value))
            first, last = places[0], places[-1]
            mean[kind, first, last] = mean[kind, last, first] = value[0]
            sigma[kind, first, last] = sigma[kind, last, first] = value[1]
    return freeze(mean), freeze(sigma)


def _opposite(a: tuple[float, float], b: tuple[float, float], angle: Floats) -> list[float]:
    """Side of a triangle opposite to the angle between sides a and b, each with its standard deviation."""
    cosine, sine = np.cos(angle[0]), np.sin(angle[0])
    side = np.sqrt(a[0] ** 2 + b[0] ** 2 - 2 * a[0] * b[0] * cosine)
    parts = ((a[0] - b[0] * cosine) * a[1], (b[0] - a[0] * cosine) * b[1], a[0] * b[0] * sine * angle[1])
    return [float(side), float(np.sqrt(sum(part**2 for part in parts)) / side)]


@per_structure
def _places(structure: Structure) -> tuple[Integers, Integers]:
    """Atom in each place of each residue (nr, 14), or -1, and its type (nr,), -1 of caps and molecules."""
    names = [STATE_PARENT.get(name, (name, ""))[0] for name in structure.residue_name.tolist()]
    kind = np.array([_TYPES.index(name) if name in STANDARD else -1 for name in names], dtype=np.int64)
    kind[structure.atom_residue[structure.kept]] = -1
    atom_at = np.full((structure.n_residues, _WIDTH), -1, dtype=np.int64)
    residue = structure.atom_residue
    heavy = np.flatnonzero((structure.atom_element != "H") & (kind[residue] >= 0))
    table = _slots()
    owners, atom_names = residue[heavy].tolist(), structure.atom_name[heavy].tolist()
    for atom, r, name in zip(heavy.tolist(), owners, atom_names, strict=True):
        if (place := table.get((names[r], name))) is not None:
            atom_at[r, place] = atom
    return read_only(atom_at, np.int64), read_only(kind, np.int64)
