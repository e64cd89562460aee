"""Side chains built atom by atom from ideal bond lengths, angles and dihedrals.

N, CA and C place C-beta as in an L-amino acid. PeptideBuilder's geometries place the other atoms (Tien,
Sydykova, Meyer, Wilke, PeerJ 1:e80, 2013). Callers build D-amino acids as mirror images.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np

from protochain.core.arrays import Floats, cross, dihedral
from protochain.core.graph import within
from protochain.structure.molecule import residues
from protochain.structure.molecule.member import Member
from protochain.structure.sidechains.rotamers import BACKBONE, rotamers

Places = dict[str, Floats]
"""Positions by atom name, angstrom: (3,), or (n, 3) of n candidates."""

_BONDED = 1.95
"""Angstrom. Nearer heavy atoms of an ideal residue are bonded: C-S is 1.81, 1-3 pairs are above 2.1."""
_CHI = {**residues.CHI, "PRO": (("N", "CA", "CB", "CG"), ("CA", "CB", "CG", "CD"))}
_CORRECTED = {
    "LEU": {"CA_CB_CG_CD2_diangle": -63.1},
    "LYS": {"CD_CE_length": 1.52, "CE_NZ_length": 1.49, "CD_CE_NZ_angle": 111.7},
    "TRP": {
        "CG_CD1_NE1_angle": 110.2, "CG_CD2_CE2_angle": 107.2, "CD2_CE2_CZ2_angle": 122.4,
        "CE2_CZ2_CH2_angle": 117.5, "CD2_CE3_CZ3_angle": 118.6,
    },
    "TYR": {"CG_CD1_CE1_angle": 121.2, "CG_CD2_CE2_angle": 121.2, "CD1_CE1_CZ_angle": 119.6},
}  # fmt: skip
"""Differences of PeptideBuilder 1.1 from crystals: exchanged CD1 and CD2, lysine's planar amine, and rings
closed by short bonds (the angles here are from Engh, Huber, Acta Cryst. A47:392, 1991)."""
_BACKBONE = ("N", "CA", "C", "O")


@dataclass(frozen=True)
class Branch:
    """An atom of a side chain, placed from the three atoms before it."""

    name: str
    element: str
    before: tuple[str, str, str]  # Names of the atoms three, two and one bonds before it.
    length: float  # Angstrom.
    angle: float  # Rad.
    dihedral: float  # Rad.
    chi: int | None  # Index of the chi that turns it.


@dataclass(frozen=True, eq=False)
class Ideal:
    """Ideal geometry of an L-amino acid."""

    x: Mapping[str, Floats]  # angstrom: Heavy atoms.
    bonds: Mapping[str, tuple[str, ...]]  # Bonded atoms.
    branches: tuple[Branch, ...]  # The side chain beyond CB, in the order of building.
    chi: tuple[float, ...]  # rad.

    def within(self, name: str, n: int) -> set[str]:
        """Names of the atoms within n bonds of an atom, without the atom."""
        return within(self.bonds, name, n) - {name}


@dataclass(frozen=True, eq=False)
class Site:
    """A residue whose side chain is to be completed."""

    member: Member
    sign: int  # 1, or -1 for a D-amino acid, which is built as its mirror image.
    before: Member | None  # Its neighbours in the chain.
    after: Member | None

    @property
    def heavy_positions(self) -> Places:
        """Positions of the present heavy atoms, mirrored for a D-amino acid."""
        return self._places(self.member)

    @property
    def backbone(self) -> tuple[float, float]:
        """Phi and psi, degrees, of the L-amino acid, usual at chain ends."""
        positions = self.heavy_positions
        n, alpha, c = (positions[name] for name in ("N", "CA", "C"))
        before = self._places(self.before).get("C") if self.before else None
        after = self._places(self.after).get("N") if self.after else None
        phi = BACKBONE[0] if before is None else float(np.rad2deg(dihedral(before, n, alpha, c)))
        psi = BACKBONE[1] if after is None else float(np.rad2deg(dihedral(n, alpha, c, after)))
        return phi, psi

    def _places(self, member: Member) -> Places:
        return {atom.name: self.sign * np.array(atom.pos.tolist()) for atom in member.heavy}


@cache
def ideal(residue: str) -> Ideal:
    """Return the ideal geometry of one of the 20 standard residues."""
    # Imported here because Biopython would slow every start of the program.
    import PeptideBuilder

    geometry = PeptideBuilder.Geometry.geometry(residues.STANDARD[residue])
    vars(geometry).update(_CORRECTED.get(residue, {}))
    (built,) = PeptideBuilder.initialize_res(geometry).get_residues()
    x = {atom.get_name(): np.array(atom.coord, dtype=np.float64) for atom in built}
    element = {atom.get_name(): atom.element for atom in built}
    bonds = {a: tuple(b for b in x if b != a and np.linalg.norm(x[a] - x[b]) < _BONDED) for a in x}
    quartets = _CHI.get(residue, ())
    turning = {quartet[1:3]: k for k, quartet in enumerate(quartets)}
    before = {"CB": ("C", "N", "CA")}
    for parent in (order := ["CB"] if "CB" in x else []):
        for name in bonds[parent]:
            if name not in before and name not in _BACKBONE:
                great, grand = ("N", "CA") if parent == "CB" else before[parent][1:]
                before[name] = (great, grand, parent)
                order.append(name)
    branches = tuple(
        Branch(
            name, element[name], before[name], float(np.linalg.norm(x[before[name][2]] - x[name])),
            _angle(*(x[n] for n in (*before[name][1:], name))),
            float(dihedral(*(x[n] for n in (*before[name], name)))), turning.get(before[name][1:]),
        )
        for name in order[1:]
    )  # fmt: skip
    return Ideal(x, bonds, branches, tuple(float(dihedral(*(x[n] for n in q))) for q in quartets))


def conformers(residue: str, *backbone: float) -> tuple[Floats, Floats]:
    """Dihedrals (n, n_chi), rad, and frequencies (n,) of conformers. Proline has two ring puckers."""
    chi, frequency = rotamers(residue, *backbone)
    if residue == "PRO":
        pucker = np.array(ideal(residue).chi)
        return np.sign(chi * pucker[0]) * pucker, frequency
    return (chi, frequency) if len(chi) else (np.zeros((1, 0)), np.ones(1))


def fixed_chi(residue: str, present: Mapping[str, Floats]) -> dict[int, float]:
    """Dihedrals, rad, by index of chi, that the present atoms determine."""
    geometry = ideal(residue)
    angles: dict[int, float] = {}
    for branch in geometry.branches:
        quartet = (*branch.before, branch.name)
        if branch.chi is not None and branch.chi not in angles and all(name in present for name in quartet):
            turn = float(dihedral(*(present[name] for name in quartet))) - branch.dihedral
            angles[branch.chi] = geometry.chi[branch.chi] + turn
    return angles


def build_atoms(residue: str, present: Mapping[str, Floats], chi: Floats) -> Places:
    """Place the missing atoms of a side chain, angstrom, for dihedrals (n, n_chi), rad."""
    geometry, n = ideal(residue), len(chi)
    at: Places = dict(present)
    if "CB" in geometry.x and "CB" not in at:
        at["CB"] = beta_carbon(residue, present)
    for branch in geometry.branches:
        if branch.name in at:
            continue
        turn = np.full(n, branch.dihedral)
        siblings = [s for s in geometry.branches if s.before == branch.before and s.name in present]
        a, b, c = (at[name] for name in branch.before)
        if siblings:
            turn = turn + dihedral(a, b, c, present[siblings[0].name]) - siblings[0].dihedral
        elif branch.chi is not None:
            # Planar dihedrals (chi5 of arginine) are not in chi.
            value = chi[:, branch.chi] if branch.chi < chi.shape[1] else 0.0
            turn = turn + value - geometry.chi[branch.chi]
        at[branch.name] = place_points(a, b, c, branch.length, branch.angle, turn)
    return {name: np.broadcast_to(x, (n, 3)) for name, x in at.items() if name not in present}


def beta_carbon(residue: str, present: Mapping[str, Floats]) -> Floats:
    """(3,) float, angstrom: CB of an L-amino acid at N, CA and C."""
    x = ideal(residue).x
    frame, ideal_frame = _frame(present), _frame(x)
    return np.asarray(present["CA"] + frame.T @ (ideal_frame @ (x["CB"] - x["CA"])))


def bridge_gaps(residue: str, present: Mapping[str, Floats]) -> Places:
    """Place missing atoms between present ones, angstrom, by distances within two bonds."""
    geometry, positions = ideal(residue), dict(present)
    chi, _ = conformers(residue)
    before = {branch.name: branch.before for branch in geometry.branches}
    outward = [*before]
    for place, name in enumerate([n for n in ["CB", *outward] if n in geometry.x]):
        beyond = [n for n in geometry.within(name, 2) if n in outward[place:] and n in present]
        # Atoms with the same parents determine one another.
        beyond = [n for n in beyond if name not in before or before[name] != before[n]]
        if name in positions or not beyond:
            continue
        near = sorted(n for n in geometry.within(name, 2) if n in positions)
        target = np.array([np.linalg.norm(geometry.x[n] - geometry.x[name]) for n in near])
        fixed = np.array([positions[n] for n in near])
        starts = build_atoms(residue, positions, chi)[name]
        misfit = np.linalg.norm(starts[:, None] - fixed, axis=2) - target
        start = starts[int(np.argmin(np.round((misfit**2).sum(axis=1), 6)))]
        positions[name] = _at_distances(fixed, target, start)
    return {name: x for name, x in positions.items() if name not in present}


def _at_distances(fixed: Floats, target: Floats, start: Floats) -> Floats:
    """(3,) float: the point near a start whose distances to other points fit best."""
    from scipy.optimize import least_squares

    def misfit(x: Floats) -> Floats:
        return np.asarray(np.linalg.norm(x - fixed, axis=1) - target)

    return np.asarray(least_squares(misfit, start).x)


def _frame(x: Mapping[str, Floats]) -> Floats:
    """(3, 3) float: axes as rows, of which the first bisects N-CA-C and the third is normal to it."""
    n, c = unit(x["N"] - x["CA"]), unit(x["C"] - x["CA"])
    first, third = unit(n + c), unit(cross(n, c))
    return np.array([first, cross(third, first), third])


def place_points(
    a: Floats, b: Floats, c: Floats, length: float | Floats, angle: float | Floats, turn: Floats
) -> Floats:
    """Place points (n, 3) at a distance from c, an angle with b and dihedrals (n,) with a."""
    length, angle, turn = (np.asarray(value)[..., None] for value in (length, angle, turn))
    along = unit(c - b)
    normal = unit(cross(b - a, along))
    aside = cross(normal, along)
    out = np.sin(angle) * (np.cos(turn) * aside + np.sin(turn) * normal)
    return np.asarray(c + length * (out - np.cos(angle) * along))


def unit(v: Floats) -> Floats:
    """Unit vectors of (..., 3). Zero vectors stay zero."""
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-9))


def _angle(a: Floats, b: Floats, c: Floats) -> float:
    return float(np.arccos(np.clip(unit(a - b) @ unit(c - b), -1.0, 1.0)))
