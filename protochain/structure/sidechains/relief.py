"""Rebuilt side chains turned out of overlaps with other atoms, hydrogens included.

Their conformers were chosen among heavy atoms, before there were hydrogens (packing).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from protochain.core.arrays import Floats, Integers
from protochain.core.graph import neighbours, within
from protochain.structure import residues
from protochain.structure.chirality import hand
from protochain.structure.draft import Member
from protochain.structure.sidechains.arms import WIDTH, Arm, arm_of, around, backbone_of, wrapped
from protochain.structure.sidechains.ideal import conformers

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


def relieved(
    x: Floats,
    owners: Sequence[tuple[Member, str]],
    elements: Sequence[str],
    bonds: Integers,
    rebuilt: dict[int, tuple[str, ...]],
) -> Floats:
    """Turn rebuilt side chains that overlap with other atoms.

    x (na, 3) nm, bonds (nbonds, 2) int.
    -> (na, 3) nm: Bond lengths and angles are kept.
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

    def arm(self, place: int, names: tuple[str, ...]) -> "_Turning | None":
        """What of a side chain can turn, if anything: built atoms whose bonds lead to no other residue."""
        member, at = self.members[place], self.atoms[place]
        built = {at[name] for name in names}
        own = hand(member) or 1
        backbone = backbone_of(self.bonded, at, self.x, own)
        chi, frequency = conformers(member.name, *backbone)
        quartets = [tuple(at[name] for name in quartet) for quartet in residues.CHI.get(member.name, ())]
        whole = arm_of(self.bonded, quartets[: chi.shape[1]])
        hydrogen = self.radius == residues.VAN_DER_WAALS["H"]
        columns = [k for k, its in enumerate(whole.outward) if {*its[~hydrogen[its]].tolist()} <= built]
        if not columns:
            return None
        arm = Arm(tuple(whole.axes[k] for k in columns), tuple(whole.outward[k] for k in columns))
        return _Turning(arm, own * chi[:, columns], -np.log(np.maximum(frequency, 1e-6)))

    def crowded(self, arms: dict[int, "_Turning"]) -> list[int]:
        """Residues that can turn and have an atom too near to another."""
        tree = KDTree(self.x)
        found = set()
        for place, turning in arms.items():
            for i in turning.arm.moved.tolist():
                near = np.array(tree.query_ball_point(self.x[i], _NEAR * 2 * self.radius.max()))
                apart = np.linalg.norm(self.x[near] - self.x[i], axis=1)
                close = near[apart < _NEAR * (self.radius[near] + self.radius[i])]
                touched = set(close.tolist()) - within(self.bonded, i, _APART)
                found |= {place for _ in touched} | {self.place[j] for j in touched if self.place[j] in arms}
        return [place for place in arms if place in found]

    def turn(self, turning: "_Turning") -> None:
        """Give a side chain the conformer of lowest cost."""
        moved = turning.arm.moved
        chi, cost = self._tried(turning)
        tried = turning.arm.turned(self.x, chi)
        cost = cost + self._repulsion(moved, tried)
        best = int(np.argmin(np.round(cost, 6)))
        if best:
            self.x[moved] = tried[best]

    def _tried(self, turning: "_Turning") -> tuple[Floats, Floats]:
        """Dihedrals (n, n_chi) to try, those of now first, and their costs (n,)."""
        now = turning.arm.dihedrals(self.x)
        chi, cost = around(turning.chi, turning.rarity, _TURNS, min(2, len(now)))
        strain = 0.5 * (wrapped(turning.chi - now) / WIDTH) ** 2
        return np.vstack([now, chi]), np.append((turning.rarity + strain.sum(axis=1)).min(), cost)

    def _repulsion(self, moved: Integers, tried: Floats) -> Floats:
        """(n,) float: repulsion of positions tried (n, n_moved, 3) by each other and by all other atoms."""
        still = np.setdiff1d(np.arange(len(self.x)), moved)
        felt = np.zeros(len(tried))
        for k, atom in enumerate(moved.tolist()):
            bonded = list(within(self.bonded, atom, _APART))
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


@dataclass(frozen=True, eq=False)
class _Turning:
    """An arm, its conformers (n, n_chi), rad, and the negative logarithms (n,) of their frequencies."""

    arm: Arm
    chi: Floats
    rarity: Floats
