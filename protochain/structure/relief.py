"""Rebuilt side chains turned out of overlaps with other atoms, hydrogens included.

Their conformers were chosen among heavy atoms, before there were hydrogens (packing).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from protochain.core.arrays import Floats, Integers, neighbours
from protochain.structure import residues
from protochain.structure.chirality import hand
from protochain.structure.draft import Member
from protochain.structure.packing import WIDTH, wrapped
from protochain.structure.sidechains import conformers, dihedral
from protochain.structure.turning import beyond, turned

_NEAR = 0.65
"""Fraction of the sum of the van der Waals radii: nearer atoms are moved. Hydrogen bonds are longer."""
_FIRM = 0.7
"""Fraction below which atoms repel while a residue chooses."""
_STEEPNESS = 100.0
"""Repulsion at distance zero, in units of the logarithm of a frequency."""
_APART = 3
"""Bonds: atoms no further apart along the chain do not repel."""
_TURNS = np.deg2rad([0.0, -12.0, 12.0, -24.0, 24.0])
_SWEEPS = 8
_DECIMALS = 6
"""Decimals (nm), as of hydrogens."""


@dataclass(frozen=True, eq=False)
class Arm:
    """A side chain that can turn.

    Parameters
    ----------
    chi : (n, n_chi) float, rad
        Its conformers.
    rarity : (n,) float
        Negative logarithms of their frequencies.
    axes : tuple of (4,) int
        Atoms that define each chi.
    outward : tuple of (n_turned,) int
        Atoms that each chi turns.
    """

    chi: Floats
    rarity: Floats
    axes: tuple[tuple[int, ...], ...]
    outward: tuple[Integers, ...]


def relieved(
    x: Floats,
    owners: Sequence[tuple[Member, str]],
    elements: Sequence[str],
    bonds: Integers,
    rebuilt: dict[int, tuple[str, ...]],
) -> Floats:
    """Turn rebuilt side chains that overlap with other atoms.

    Parameters
    ----------
    x : (na, 3) float, nm
    owners : sequence of (Member, str)
        Residue and name of each atom.
    elements : sequence of str
    bonds : (nbonds, 2) int
    rebuilt : dict of int to tuple of str
        Atoms added to side chains, by ``id`` of their residue.

    Returns
    -------
    (na, 3) float, nm
        Bond lengths and angles are kept.
    """
    if not rebuilt:
        return x
    room = _Room(x, owners, elements, bonds)
    arms = {place: arm for place in rebuilt if (arm := room.arm(place, rebuilt[place])) is not None}
    for _ in range(_SWEEPS):
        crowded = room.crowded(arms)
        before = room.x.copy()
        for place in crowded:
            room.turn(arms[place])
        if np.array_equal(before, room.x):
            break
    return np.where(room.x == x, x, np.round(room.x, _DECIMALS))


class _Room:
    """All atoms, where they are now."""

    def __init__(
        self, x: Floats, owners: Sequence[tuple[Member, str]], elements: Sequence[str], bonds: Integers
    ) -> None:
        self.x = np.array(x)
        self.radius = np.array([residues.VAN_DER_WAALS.get(element, 0.17) for element in elements])
        self.atoms: dict[int, dict[str, int]] = {}
        self.members: dict[int, Member] = {}
        self.place = [id(member) for member, _ in owners]
        for i, (member, name) in enumerate(owners):
            self.atoms.setdefault(id(member), {})[name] = i
            self.members[id(member)] = member
        self.bonded = neighbours(bonds, len(owners))

    def within(self, atom: int, n: int) -> set[int]:
        """Atoms at most n bonds away, itself included."""
        found = {atom}
        for _ in range(n):
            found |= {other for each in found for other in self.bonded[each]}
        return found

    def arm(self, place: int, names: tuple[str, ...]) -> Arm | None:
        """What of a side chain can turn, if anything: built atoms whose bonds lead to no other residue."""
        member, at = self.members[place], self.atoms[place]
        built = {at[name] for name in names}
        axes, outward, columns = [], [], []
        for k, quartet in enumerate(residues.CHI.get(member.name, ())):
            atoms = tuple(at[name] for name in quartet)
            its = beyond(self.bonded, atoms[1], atoms[2])
            heavy = {i for i in its if self.radius[i] != residues.VAN_DER_WAALS["H"]}
            if heavy <= built:
                axes.append(atoms)
                outward.append(np.array(sorted(its), dtype=np.int64))
                columns.append(k)
        chi, frequency = conformers(member.name)
        columns = [k for k in columns if k < chi.shape[1]]
        if not columns:
            return None
        chosen = hand(member) * chi[:, columns]
        n = len(columns)
        return Arm(chosen, -np.log(np.maximum(frequency, 1e-6)), tuple(axes[:n]), tuple(outward[:n]))

    def crowded(self, arms: dict[int, Arm]) -> list[int]:
        """Residues that can turn and have an atom too near to another."""
        tree = KDTree(self.x)
        found = set()
        for place, arm in arms.items():
            for i in arm.outward[0].tolist():
                near = np.array(tree.query_ball_point(self.x[i], _NEAR * 2 * self.radius.max()))
                apart = np.linalg.norm(self.x[near] - self.x[i], axis=1)
                close = near[apart < _NEAR * (self.radius[near] + self.radius[i])]
                touched = set(close.tolist()) - self.within(i, _APART)
                found |= {place for _ in touched} | {self.place[j] for j in touched if self.place[j] in arms}
        return [place for place in arms if place in found]

    def turn(self, arm: Arm) -> None:
        """Give a side chain the conformer of lowest cost."""
        moved = arm.outward[0]
        chi, cost = self._tried(arm)
        tried = turned(self.x, arm.axes, arm.outward, chi, moved)
        cost = cost + self._repulsion(moved, tried)
        best = int(np.argmin(np.round(cost, 6)))
        if best:
            self.x[moved] = tried[best]

    def _tried(self, arm: Arm) -> tuple[Floats, Floats]:
        """Dihedrals (n, n_chi) to try, those of now first, and their costs (n,)."""
        now = np.array([dihedral(*self.x[list(quartet)]) for quartet in arm.axes])
        n_turned = min(2, len(now))
        steps = np.zeros((len(_TURNS) ** n_turned, len(now)))
        steps[:, :n_turned] = np.stack(np.meshgrid(*[_TURNS] * n_turned), axis=-1).reshape(len(steps), -1)
        chi = (arm.chi[:, None] + steps).reshape(-1, len(now))
        cost = (arm.rarity[:, None] + 0.5 * ((steps / WIDTH) ** 2).sum(axis=1)).ravel()
        strain = 0.5 * (wrapped(arm.chi - now) / WIDTH) ** 2
        return np.vstack([now, chi]), np.append((arm.rarity + strain.sum(axis=1)).min(), cost)

    def _repulsion(self, moved: Integers, tried: Floats) -> Floats:
        """(n,) float: repulsion of positions tried (n, n_moved, 3) by each other and by all other atoms."""
        still = np.setdiff1d(np.arange(len(self.x)), moved)
        felt = np.zeros(len(tried))
        for k, atom in enumerate(moved.tolist()):
            bonded = list(self.within(atom, _APART))
            at = tried[:, k]
            reach = 2 * _FIRM * self.radius.max()
            beside = (self.x[still] > at.min(axis=0) - reach) & (self.x[still] < at.max(axis=0) + reach)
            near = still[beside.all(axis=1)]
            near = near[~np.isin(near, bonded)]
            felt += self._felt(atom, at[:, None], self.x[near], near)
            later = np.flatnonzero(~np.isin(moved, bonded))
            later = later[later > k]
            felt += self._felt(atom, at[:, None], tried[:, later], moved[later])
        return felt

    def _felt(self, atom: int, at: Floats, x: Floats, others: Integers) -> Floats:
        """(n,) float: repulsion of an atom at (n, 1, 3) by others at x (n_others, 3) or (n, n_others, 3)."""
        way = at - x
        apart = np.sqrt(np.einsum("...i,...i", way, way))
        contact = _FIRM * (self.radius[atom] + self.radius[others])
        return np.asarray((_STEEPNESS * np.maximum(0.0, 1.0 - apart / contact)).sum(axis=1))
