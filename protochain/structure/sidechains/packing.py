"""Choose the conformers of all rebuilt side chains at once: the combination of lowest energy.

The first step chooses rotamers for the backbone, turned by up to 9 degrees about chi1. The second step turns
the chosen conformers about chi1 and chi2. Both steps minimise the energy of ``packing_energies``, with a
disulfide bond if two cysteines allow one. Equal coordinates lead to equal choices.
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
from protochain.structure.sidechains.ideal import Places, Site, build_atoms, conformers, fixed_chi, ideal
from protochain.structure.sidechains.packing_energies import REACH, Kinds, rarity, table
from protochain.structure.sidechains.reduction import touching

_EXCLUDED_BONDS = 3  # Bonds. Atoms at most so many bonds apart do not interact.
_TURN, _FINER = np.deg2rad(9.0), np.deg2rad(8.0)
"""Rad. Turns about chi1 of a rotamer in the first step, and about chi1 and chi2 in the second."""
_TURN_WIDTH = np.deg2rad(9.5)  # Rad. A turn of this size costs 0.5.
_NOT_TURNED = frozenset({"ARG", "GLN", "GLU", "LYS", "PRO", "SER"})
"""Residues without turns in the first step. They have many rotamers, or ring puckers."""
_COST_CUTOFF = 20.0  # Largest cost above the best conformer, without the other side chains.
_BOND, _BOND_WIDTH, _BOND_GAIN = 2.05, 0.15, 40.0
"""Angstrom, angstrom, -: a disulfide bond, its deviation, and its gain."""
_CB_DISTANCES = (3.2, 4.7)  # Angstrom: least and largest distance of the CB across a disulfide bond.


@dataclass(frozen=True, eq=False)
class Choices:
    """Conformers of a side chain."""

    site: Site
    names: tuple[str, ...]  # Its missing atoms.
    chi: Floats  # (n, n_chi) rad.
    x: Floats  # (n, n_atoms, 3) angstrom.
    cost: Floats  # (n,): Without the other rebuilt residues.


class Packing(NamedTuple):
    """Packed side chains."""

    places: list[Places]  # angstrom: The missing atoms of each site.
    # Whether no combination of the tried conformers has a lower energy. If not, the search was too long.
    is_proven: bool


def pack(members: Sequence[Member], sites: Sequence[Site]) -> Packing:
    """Place the missing side-chain atoms of residues."""
    surroundings = _Surroundings(members)
    choices = [_choices(site, surroundings, *candidate_conformers(site)) for site in sites]
    first = _choose_conformers(choices)
    finer = [
        _choices(choice.site, surroundings, *_turns_about(choice, state))
        for choice, state in zip(choices, first.states.tolist(), strict=True)
    ]
    last = _choose_conformers(finer)
    places = [
        dict(zip(choice.names, choice.x[k], strict=True))
        for choice, k in zip(finer, last.states.tolist(), strict=True)
    ]
    return Packing(places, first.is_proven and last.is_proven)


def candidate_conformers(site: Site) -> tuple[Floats, Floats]:
    """Return dihedrals and costs of conformers. Deviations from dihedrals of present atoms add costs."""
    name = site.member.name
    chi, frequency = conformers(name, *site.backbone)
    if name == "CYS":
        # A disulfide bond closes at dihedrals between the rotamers.
        turns = np.deg2rad(np.arange(-180.0, 180.0, 10.0))[:, None]
        near = np.exp(-0.5 * (wrap_angle(turns - chi.T) / WIDTH) ** 2)
        chi, frequency = turns, near @ frequency
    cost = rarity(name, frequency)
    if name not in _NOT_TURNED and name != "CYS" and chi.shape[1]:
        chi, cost = dihedral_grid(chi, cost, (0.0, -_TURN, _TURN), 1, _TURN_WIDTH)
    for k, value in fixed_chi(name, site.heavy_positions).items():
        if k < chi.shape[1]:
            cost = cost + 0.5 * (wrap_angle(chi[:, k] - value) / WIDTH) ** 2
    return chi, cost


def _turns_about(choices: Choices, state: int) -> tuple[Floats, Floats]:
    """Return dihedrals around a conformer and their costs."""
    chi = choices.chi[[state]]
    n = 0 if choices.site.member.name == "PRO" else min(2, chi.shape[1])
    return dihedral_grid(chi, np.zeros(1), (0.0, -_FINER, _FINER), n, _TURN_WIDTH)


def _choices(site: Site, surroundings: "_Surroundings", chi: Floats, cost: Floats) -> Choices:
    built = build_atoms(site.member.name, site.heavy_positions, chi)
    names = tuple(built)
    x = site.sign * np.stack([built[name] for name in names], axis=1)
    cost = cost + surroundings.energies(site, names, x)
    hopeful = cost <= cost.min() + _COST_CUTOFF
    return Choices(site, names, chi[hopeful], np.ascontiguousarray(x[hopeful]), cost[hopeful])


def _choose_conformers(choices: Sequence[Choices]) -> Assignment:
    tables = {}
    for i, j in touching([choice.x for choice in choices], REACH):
        energies = _pair_energies(choices[i], choices[j])
        if energies.any():
            tables[i, j] = energies
    return assign_states([choice.cost for choice in choices], tables)


def _pair_energies(first: Choices, second: Choices) -> Floats:
    contact, depth = _kinds(first).pair_parameters(_kinds(second))
    if "SG" not in first.names or "SG" not in second.names:
        return table(first.x, second.x, contact, depth)
    i, j = first.names.index("SG"), second.names.index("SG")
    distance = np.linalg.norm(first.x[:, None, i] - second.x[None, :, j], axis=-1)
    bond = _disulfide(distance, float(np.linalg.norm(_beta(first) - _beta(second))))
    return np.asarray(table(first.x, second.x, contact, depth) + bond)


def _kinds(choices: Choices) -> Kinds:
    return Kinds([(choices.site.member.name, name, "") for name in choices.names])


def _beta(choices: Choices) -> Floats:
    """(3,) float, angstrom: CB, present or built."""
    if "CB" in choices.names:
        return np.asarray(choices.x[0, choices.names.index("CB")])
    return choices.site.sign * choices.site.heavy_positions["CB"]


class _Surroundings:
    """Present heavy atoms."""

    def __init__(self, members: Sequence[Member]) -> None:
        heavy = [(m, atom) for m in members for atom in m.heavy]
        self.x = np.array([atom.pos.tolist() for _, atom in heavy])
        self.name = np.array([atom.name for _, atom in heavy])
        self.owner = np.array([id(member) for member, _ in heavy])
        self.kinds = [
            (m.name, a.name, "" if m.name in residues.STANDARD else a.element.name) for m, a in heavy
        ]
        self.tree = KDTree(self.x)

    def energies(self, site: Site, names: tuple[str, ...], x: Floats) -> Floats:
        """Energies (n,) of conformers x (n, n_atoms, 3) with the present atoms of other residues."""
        centre = x.reshape(-1, 3).mean(axis=0)
        reach = np.linalg.norm(x - centre, axis=2).max() + REACH
        near = np.array(sorted(self.tree.query_ball_point(centre, reach)), dtype=np.int64)
        near = near[self.owner[near] != id(site.member)]
        if not len(near):
            return np.zeros(len(x))
        excluded = _nearby(site)
        atoms = list(zip(self.owner[near].tolist(), self.name[near].tolist(), strict=True))
        free = np.array([[atom not in excluded[name] for atom in atoms] for name in names])
        site_kinds = Kinds([(site.member.name, name, "") for name in names])
        contact, depth = site_kinds.pair_parameters(Kinds([self.kinds[k] for k in near]))
        energy = table(x, self.x[near][None], np.where(free, contact, 0.0), depth)[:, 0]
        if "SG" in names:
            distances = np.linalg.norm(x[:, names.index("SG"), None] - self.x[near], axis=-1)
            beta = x[0, names.index("CB")] if "CB" in names else site.sign * site.heavy_positions["CB"]
            for k, betas in self._sulphurs(site, near, beta):
                energy += _disulfide(distances[:, k], betas)
        return np.asarray(energy)

    def _sulphurs(self, site: Site, near: Integers, beta: Floats) -> list[tuple[int, float]]:
        """Unbonded sulphurs of other cysteines among the near atoms, with the CB-CB distances."""
        sulphurs = []
        for k, atom in enumerate(near):
            if self.name[atom] == "SG" and self.owner[atom] != id(site.member):
                partners = self.tree.query_ball_point(self.x[atom], 2.5)
                beta_atoms = np.flatnonzero((self.owner == self.owner[atom]) & (self.name == "CB"))
                if sum(self.name[p] == "SG" for p in partners) == 1 and len(beta_atoms):
                    sulphurs.append((k, float(np.linalg.norm(self.x[beta_atoms[0]] - beta))))
        return sulphurs


def _nearby(site: Site) -> dict[str, set[tuple[int, str]]]:
    """Atoms (owner, name) within few bonds of each side-chain atom, which is included."""
    owner, bonds = id(site.member), defaultdict[tuple[int, str], set[tuple[int, str]]](set)

    def join(a: tuple[int, str], b: tuple[int, str]) -> None:
        bonds[a].add(b)
        bonds[b].add(a)

    for name, partners in ideal(site.member.name).bonds.items():
        for partner in partners:
            join((owner, name), (owner, partner))
    if site.before:
        for partner in ("CA", "O", "N"):
            join((id(site.before), "C"), (id(site.before), partner) if partner != "N" else (owner, "N"))
    if site.after:
        join((owner, "C"), (id(site.after), "N"))
        join((id(site.after), "N"), (id(site.after), "CA"))
    return {name: within(bonds, (owner, name), _EXCLUDED_BONDS) for name in ideal(site.member.name).x}


def _disulfide(distance: Floats, betas: float) -> Floats:
    """Cost of two sulphurs at a distance, negative for a bond if the backbones allow one."""
    if not _CB_DISTANCES[0] < betas < _CB_DISTANCES[1]:
        return np.zeros_like(distance)
    return np.asarray(-_BOND_GAIN * np.exp(-0.5 * ((distance - _BOND) / _BOND_WIDTH) ** 2))
