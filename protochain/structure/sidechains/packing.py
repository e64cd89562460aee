"""Choice of the conformers of rebuilt side chains: without overlaps, and the more frequent the better.

Each residue takes the conformer of lowest cost: the negative logarithm of its frequency, and a repulsion of
heavy atoms that is linear in their distance, as in SCWRL3 (Canutescu, Shelenkov, Dunbrack, Protein Sci.
12:2001, 2003). Residues are revisited, alone and in pairs, until none changes. The same coordinates give the
same choice.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from protochain.core.arrays import Floats, Integers
from protochain.core.graph import within
from protochain.structure.draft import Member
from protochain.structure.sidechains.arms import WIDTH, wrapped
from protochain.structure.sidechains.conflicts import beside, touching
from protochain.structure.sidechains.ideal import Places, conformers, fixed_chi, grown, ideal

_RADIUS = {"C": 1.77, "N": 1.5, "O": 1.45, "S": 1.82}
"""Angstrom: heavy atoms nearer than the sum repel, carbons with their hydrogens."""
_STEEPNESS = 30.0
"""Repulsion at distance zero, in units of the logarithm of a frequency."""
_REACH = 3.7
"""Angstrom: no atoms further apart repel."""
_APART = 3
"""Bonds: atoms no further apart along the chain do not repel."""
_SWEEPS = 30
_BOND, _BOND_WIDTH, _BOND_GAIN = 2.05, 0.15, 40.0
"""Angstrom, angstrom, -: a disulfide bond, its deviation, and what it gains."""
_BETAS = (3.2, 4.7)
"""Angstrom: least and largest distance of the CB across a disulfide bond."""


@dataclass(frozen=True, eq=False)
class Site:
    """A residue whose side chain is to be completed.

    Parameters
    ----------
    member : Member
    sign : int
        1, or -1 for a D-amino acid, which is built in the mirror.
    before, after : Member or None
        Its neighbours in the chain.
    """

    member: Member
    sign: int
    before: Member | None
    after: Member | None

    @property
    def known(self) -> Places:
        """Heavy atoms that are there, mirrored for a D-amino acid."""
        heavy = (atom for atom in self.member.atoms if not atom.is_hydrogen())
        return {atom.name: self.sign * np.array(atom.pos.tolist()) for atom in heavy}


@dataclass(frozen=True, eq=False)
class Choices:
    """Conformers of a side chain.

    Parameters
    ----------
    site : Site
    names : tuple of str
        Its missing atoms.
    x : (n, n_atoms, 3) float, angstrom
    cost : (n,) float
        Without the other residues that are built.
    """

    site: Site
    names: tuple[str, ...]
    x: Floats
    cost: Floats


def packed(members: Sequence[Member], sites: Sequence[Site]) -> list[Places]:
    """Place the missing side-chain atoms of residues.

    Parameters
    ----------
    members : sequence of Member
        All residues and molecules of the structure.
    sites : sequence of Site

    Returns
    -------
    list of dict of str to (3,) float, angstrom
        The missing atoms of each site.
    """
    here = _Surroundings(members)
    choices = [_choices(site, here) for site in sites]
    return [
        dict(zip(each.names, each.x[k], strict=True))
        for each, k in zip(choices, _settled(choices), strict=True)
    ]


def choosable(site: Site) -> tuple[Floats, Floats]:
    """Dihedrals and rarities of the conformers; those unlike the dihedrals of atoms in place are rare."""
    chi, frequency = conformers(site.member.name)
    if site.member.name == "CYS":
        # A disulfide bond closes at dihedrals between the rotamers.
        turns = np.deg2rad(np.arange(-180.0, 180.0, 10.0))[:, None]
        near = np.exp(-0.5 * (wrapped(turns - chi.T) / WIDTH) ** 2)
        chi, frequency = turns, near @ frequency
    rarity = -np.log(np.maximum(frequency, 1e-6))
    for k, value in fixed_chi(site.member.name, site.known).items():
        if k < chi.shape[1]:
            rarity = rarity + 0.5 * (wrapped(chi[:, k] - value) / WIDTH) ** 2
    return chi, rarity


def _choices(site: Site, here: "_Surroundings") -> Choices:
    chi, rarity = choosable(site)
    built = grown(site.member.name, site.known, chi)
    names = tuple(built)
    x = site.sign * np.stack([built[name] for name in names], axis=1)
    return Choices(site, names, x, rarity + here.repulsion(site, names, x))


def _settled(choices: Sequence[Choices]) -> list[int]:
    """Conformer of each residue.

    By descent, while ``relaxation.assignment`` proves the minimum: that needs kernels, for which loading a
    file is not to wait, and hydrogens, which decide between near equals, are still to come.
    """
    tables = {
        (i, j): table
        for i, j in touching([each.x for each in choices], _REACH)
        if (table := _between(choices[i], choices[j])).any()
    }
    partners = beside(tables, len(choices))
    taken = [int(np.argmin(np.round(each.cost, 6))) for each in choices]

    def cost(i: int, without: int = -1) -> Floats:
        return choices[i].cost + sum(
            (table[:, taken[j]] for j, table in partners[i] if j != without), np.zeros(len(choices[i].cost))
        )

    for _ in range(_SWEEPS):
        before = list(taken)
        for i in range(len(choices)):
            taken[i] = int(np.argmin(np.round(cost(i), 6)))
        for (i, j), table in tables.items():
            both = cost(i, j)[:, None] + cost(j, i)[None] + table
            taken[i], taken[j] = (int(k) for k in np.unravel_index(np.argmin(np.round(both, 6)), both.shape))
        if taken == before:
            break
    return taken


def _between(one: Choices, other: Choices) -> Floats:
    apart = np.linalg.norm(one.x[:, None, :, None] - other.x[None, :, None], axis=-1)
    table = _repulsion(apart, _radii(one.names)[:, None] + _radii(other.names)).sum(axis=(2, 3))
    if "SG" in one.names and "SG" in other.names:
        sulphurs = apart[:, :, one.names.index("SG"), other.names.index("SG")]
        betas = np.linalg.norm(_beta(one) - _beta(other))
        table = table + _disulfide(sulphurs, float(betas))
    return np.asarray(table)


def _beta(choices: Choices) -> Floats:
    """(3,) float, angstrom: CB, in place or built."""
    if "CB" in choices.names:
        return np.asarray(choices.x[0, choices.names.index("CB")])
    return choices.site.sign * choices.site.known["CB"]


class _Surroundings:
    """Heavy atoms that are there."""

    def __init__(self, members: Sequence[Member]) -> None:
        heavy = [(m, atom) for m in members for atom in m.atoms if not atom.is_hydrogen()]
        self.x = np.array([atom.pos.tolist() for _, atom in heavy])
        self.name = np.array([atom.name for _, atom in heavy])
        self.owner = np.array([id(member) for member, _ in heavy])
        self.radius = np.array([_RADIUS.get(atom.element.name, _RADIUS["C"]) for _, atom in heavy])
        self.tree = KDTree(self.x)

    def repulsion(self, site: Site, names: tuple[str, ...], x: Floats) -> Floats:
        """Repulsion (n,) of conformers x (n, n_atoms, 3) by the atoms that are there, and by themselves."""
        centre = x.reshape(-1, 3).mean(axis=0)
        reach = np.linalg.norm(x - centre, axis=2).max() + _REACH
        near = np.array(sorted(self.tree.query_ball_point(centre, reach)), dtype=np.int64)
        joined, own = _joined(site), id(site.member)
        atoms = list(zip(self.owner[near].tolist(), self.name[near].tolist(), strict=True))
        free = np.array([[atom not in joined[name] for atom in atoms] for name in names])
        folded = np.triu([[(own, other) not in joined[name] for other in names] for name in names], 1)
        radius = _radii(names)[:, None]
        apart = np.linalg.norm(x[:, :, None] - self.x[near], axis=-1)
        inside = np.linalg.norm(x[:, :, None] - x[:, None], axis=-1)
        felt = (free * _repulsion(apart, radius + self.radius[near])).sum(axis=(1, 2))
        felt += (folded * _repulsion(inside, radius + _radii(names))).sum(axis=(1, 2))
        if "SG" in names:
            beta = x[0, names.index("CB")] if "CB" in names else site.sign * site.known["CB"]
            for k, betas in self._sulphurs(site, near, beta):
                felt += _disulfide(apart[:, names.index("SG"), k], betas)
        return np.asarray(felt)

    def _sulphurs(self, site: Site, near: Integers, beta: Floats) -> list[tuple[int, float]]:
        """Unbonded sulphurs of other cysteines among the near atoms, with the distances of the CB."""
        found = []
        for k, atom in enumerate(near):
            if self.name[atom] == "SG" and self.owner[atom] != id(site.member):
                partners = self.tree.query_ball_point(self.x[atom], 2.5)
                other = np.flatnonzero((self.owner == self.owner[atom]) & (self.name == "CB"))
                if sum(self.name[p] == "SG" for p in partners) == 1 and len(other):
                    found.append((k, float(np.linalg.norm(self.x[other[0]] - beta))))
        return found


def _joined(site: Site) -> dict[str, set[tuple[int, str]]]:
    """Atoms (owner, name) that are within few bonds of each side-chain atom, and the atom itself."""
    own, bonds = id(site.member), defaultdict[tuple[int, str], set[tuple[int, str]]](set)

    def join(a: tuple[int, str], b: tuple[int, str]) -> None:
        bonds[a].add(b)
        bonds[b].add(a)

    for name, others in ideal(site.member.name).bonds.items():
        for other in others:
            join((own, name), (own, other))
    if site.before:
        for other in ("CA", "O", "N"):
            join((id(site.before), "C"), (id(site.before), other) if other != "N" else (own, "N"))
    if site.after:
        join((own, "C"), (id(site.after), "N"))
        join((id(site.after), "N"), (id(site.after), "CA"))
    return {name: within(bonds, (own, name), _APART) for name in ideal(site.member.name).x}


def _radii(names: Sequence[str]) -> Floats:
    return np.array([_RADIUS[name[0]] for name in names])


def _repulsion(apart: Floats, contact: Floats) -> Floats:
    return np.asarray(_STEEPNESS * np.maximum(0.0, 1.0 - apart / contact))


def _disulfide(apart: Floats, betas: float) -> Floats:
    """Cost of two sulphurs at a distance: a bond where the backbones allow one."""
    if not _BETAS[0] < betas < _BETAS[1]:
        return np.zeros_like(apart)
    return np.asarray(-_BOND_GAIN * np.exp(-0.5 * ((apart - _BOND) / _BOND_WIDTH) ** 2))
