"""Choice of the conformers of rebuilt side chains: the combination of lowest energy, all at once.

Each residue takes a rotamer of its backbone, turned by up to 9 degrees about chi1; then all are turned about
chi1 and chi2 once more, from where they are. Both times it is the combination of lowest energy of
``packing_energies`` that is taken, and a disulfide bond where two cysteines allow one. The same coordinates
give the same choice.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from protochain.core.arrays import Floats, Integers
from protochain.core.graph import within
from protochain.structure.molecule import residues
from protochain.structure.molecule.member import Member
from protochain.structure.sidechains.arms import WIDTH, dihedral_grid, wrap_angle
from protochain.structure.sidechains.assignment import Assignment, assign_states
from protochain.structure.sidechains.conflicts import touching
from protochain.structure.sidechains.ideal import Places, build_atoms, conformers, fixed_chi, ideal
from protochain.structure.sidechains.packing_energies import REACH, Kinds, rarity, table
from protochain.structure.sidechains.sites import Site

_APART = 3
"""Bonds: atoms no further apart along the chain do not touch."""
_TURN, _FINER = np.deg2rad(9.0), np.deg2rad(8.0)
"""About chi1 of a rotamer, and then about chi1 and chi2."""
_TURNED = np.deg2rad(9.5)
"""A turn of this size costs a half."""
_MANY = frozenset({"ARG", "GLN", "GLU", "LYS", "PRO", "SER"})
"""Residues whose rotamers are not turned at first: there are many, or they are puckers of a ring."""
_HOPELESS = 20.0
"""Conformers that cost so much more than the best, without the other side chains, are left out."""
_BOND, _BOND_WIDTH, _BOND_GAIN = 2.05, 0.15, 40.0
"""Angstrom, angstrom, -: a disulfide bond, its deviation, and what it gains."""
_BETAS = (3.2, 4.7)
"""Angstrom: least and largest distance of the CB across a disulfide bond."""


@dataclass(frozen=True, eq=False)
class Choices:
    """Conformers of a side chain."""

    site: Site
    names: tuple[str, ...]  # Its missing atoms.
    chi: Floats  # (n, n_chi) rad.
    x: Floats  # (n, n_atoms, 3) angstrom.
    cost: Floats  # (n,): Without the other residues that are built.


class Packing(NamedTuple):
    """Side chains that were packed."""

    places: list[Places]  # angstrom: The missing atoms of each site.
    # Whether no other combination of the conformers tried has a lower energy; if not, the search was too
    # long.
    is_proven: bool


def pack(members: Sequence[Member], sites: Sequence[Site]) -> Packing:
    """Place the missing side-chain atoms of residues."""
    here = _Surroundings(members)
    choices = [_choices(site, here, *candidate_conformers(site)) for site in sites]
    first = _settled(choices)
    finer = [
        _choices(each.site, here, *_turned(each, state))
        for each, state in zip(choices, first.states.tolist(), strict=True)
    ]
    last = _settled(finer)
    places = [
        dict(zip(each.names, each.x[k], strict=True))
        for each, k in zip(finer, last.states.tolist(), strict=True)
    ]
    return Packing(places, first.is_proven and last.is_proven)


def candidate_conformers(site: Site) -> tuple[Floats, Floats]:
    """Dihedrals and costs of the conformers; those unlike the dihedrals of atoms in place cost more."""
    name = site.member.name
    chi, frequency = conformers(name, *site.backbone)
    if name == "CYS":
        # A disulfide bond closes at dihedrals between the rotamers.
        turns = np.deg2rad(np.arange(-180.0, 180.0, 10.0))[:, None]
        near = np.exp(-0.5 * (wrap_angle(turns - chi.T) / WIDTH) ** 2)
        chi, frequency = turns, near @ frequency
    cost = rarity(name, frequency)
    if name not in _MANY and name != "CYS" and chi.shape[1]:
        chi, cost = dihedral_grid(chi, cost, (0.0, -_TURN, _TURN), 1, _TURNED)
    for k, value in fixed_chi(name, site.known).items():
        if k < chi.shape[1]:
            cost = cost + 0.5 * (wrap_angle(chi[:, k] - value) / WIDTH) ** 2
    return chi, cost


def _turned(each: Choices, state: int) -> tuple[Floats, Floats]:
    """Dihedrals and costs about a conformer."""
    chi = each.chi[[state]]
    n = 0 if each.site.member.name == "PRO" else min(2, chi.shape[1])
    return dihedral_grid(chi, np.zeros(1), (0.0, -_FINER, _FINER), n, _TURNED)


def _choices(site: Site, here: "_Surroundings", chi: Floats, cost: Floats) -> Choices:
    built = build_atoms(site.member.name, site.known, chi)
    names = tuple(built)
    x = site.sign * np.stack([built[name] for name in names], axis=1)
    cost = cost + here.felt(site, names, x)
    hopeful = cost <= cost.min() + _HOPELESS
    return Choices(site, names, chi[hopeful], np.ascontiguousarray(x[hopeful]), cost[hopeful])


def _settled(choices: Sequence[Choices]) -> Assignment:
    """Conformer of each residue."""
    tables = {}
    for i, j in touching([each.x for each in choices], REACH):
        found = _between(choices[i], choices[j])
        if found.any():
            tables[i, j] = found
    return assign_states([each.cost for each in choices], tables)


def _between(one: Choices, other: Choices) -> Floats:
    contact, depth = _kinds(one).beside(_kinds(other))
    if "SG" not in one.names or "SG" not in other.names:
        return table(one.x, other.x, contact, depth)
    i, j = one.names.index("SG"), other.names.index("SG")
    apart = np.linalg.norm(one.x[:, None, i] - other.x[None, :, j], axis=-1)
    bond = _disulfide(apart, float(np.linalg.norm(_beta(one) - _beta(other))))
    return np.asarray(table(one.x, other.x, contact, depth) + bond)


def _kinds(choices: Choices) -> Kinds:
    return Kinds([(choices.site.member.name, name, "") for name in choices.names])


def _beta(choices: Choices) -> Floats:
    """(3,) float, angstrom: CB, in place or built."""
    if "CB" in choices.names:
        return np.asarray(choices.x[0, choices.names.index("CB")])
    return choices.site.sign * choices.site.known["CB"]


class _Surroundings:
    """Heavy atoms that are there."""

    def __init__(self, members: Sequence[Member]) -> None:
        heavy = [(m, atom) for m in members for atom in m.heavy]
        self.x = np.array([atom.pos.tolist() for _, atom in heavy])
        self.name = np.array([atom.name for _, atom in heavy])
        self.owner = np.array([id(member) for member, _ in heavy])
        self.kinds = [
            (m.name, a.name, "" if m.name in residues.STANDARD else a.element.name) for m, a in heavy
        ]
        self.tree = KDTree(self.x)

    def felt(self, site: Site, names: tuple[str, ...], x: Floats) -> Floats:
        """Energies (n,) of conformers x (n, n_atoms, 3) with the atoms of others that are there."""
        centre = x.reshape(-1, 3).mean(axis=0)
        reach = np.linalg.norm(x - centre, axis=2).max() + REACH
        near = np.array(sorted(self.tree.query_ball_point(centre, reach)), dtype=np.int64)
        near = near[self.owner[near] != id(site.member)]
        if not len(near):
            return np.zeros(len(x))
        joined = _joined(site)
        atoms = list(zip(self.owner[near].tolist(), self.name[near].tolist(), strict=True))
        free = np.array([[atom not in joined[name] for atom in atoms] for name in names])
        mine = Kinds([(site.member.name, name, "") for name in names])
        contact, depth = mine.beside(Kinds([self.kinds[k] for k in near]))
        felt = table(x, self.x[near][None], np.where(free, contact, 0.0), depth)[:, 0]
        if "SG" in names:
            apart = np.linalg.norm(x[:, names.index("SG"), None] - self.x[near], axis=-1)
            beta = x[0, names.index("CB")] if "CB" in names else site.sign * site.known["CB"]
            for k, betas in self._sulphurs(site, near, beta):
                felt += _disulfide(apart[:, k], betas)
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


def _disulfide(apart: Floats, betas: float) -> Floats:
    """Cost of two sulphurs at a distance: a bond where the backbones allow one."""
    if not _BETAS[0] < betas < _BETAS[1]:
        return np.zeros_like(apart)
    return np.asarray(-_BOND_GAIN * np.exp(-0.5 * ((apart - _BOND) / _BOND_WIDTH) ** 2))
