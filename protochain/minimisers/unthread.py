"""Unthreading of bonds that pass through rings. A force field cannot do this, as a bond would have to break.

The bond is pushed out over one side of the ring, while the two residues do not repel each other.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from protochain.core.arrays import Floats, Integers, read_only
from protochain.minimisers.problem import Force, Placement
from protochain.minimisers.restraints import SoftRepulsion, Sum
from protochain.minimisers.stages import Stage
from protochain.structure.molecule.model import Structure
from protochain.validation.rings import ThreadedRing, threaded_rings

ATTEMPTS = 5  # Number of sides of a ring that are tried in turn.
_STIFFNESS = 2e4  # kJ/mol/nm^2.
_OUTSIDE = 0.35  # nm from a ring's centre to the middle of an unthreaded bond: a ring's radius and a contact.
_PATH_RADIUS = 0.3  # nm. Nearer atoms block the path of the bond.
_ATOM_COST = 0.05  # nm, cost of each atom in the path.
_BOND_COST = 0.3
"""nm, cost of each end of a side that is bonded to other heavy atoms: the bond would get stuck there."""


@dataclass(frozen=True, eq=False)
class Push:
    """Push of a bond out of a ring: E = k/2 max(0, out - s)^2, with its middle s from the centre."""

    ring: Integers  # (n,) int.
    bond: Integers  # (2,) int.
    way: Floats  # (3,): Unit vector.

    def __call__(self, x: Floats) -> tuple[float, Floats]:
        """Energy and forces."""
        distance = float((x[self.bond].mean(axis=0) - x[self.ring].mean(axis=0)) @ self.way)
        remaining = max(0.0, _OUTSIDE - distance)
        forces = np.zeros_like(x)
        forces[self.bond] += _STIFFNESS * remaining / len(self.bond) * self.way
        forces[self.ring] -= _STIFFNESS * remaining / len(self.ring) * self.way
        return 0.5 * _STIFFNESS * remaining**2, forces


def unthread_stages(soft: Stage, closing: Callable[[Stage], Stage]) -> list[Stage]:
    """Stages that unthread rings. All but the first run only if a threaded ring remains."""
    stages = []
    for attempt in range(ATTEMPTS):
        out = replace(
            soft, ready=_is_threaded, fit=partial(_push_bonds, attempt), name="freeing threaded rings"
        )
        stages += [out, closing(soft)]
    return stages


def _is_threaded(stage: Stage, at: Placement) -> bool:
    return bool(threaded_rings(_repulsion_of(stage).structure, at.x))


def _push_bonds(attempt: int, stage: Stage, x: Floats) -> Stage:
    """Stage that pushes each threading bond out over the side of its ring for this attempt."""
    soft = _repulsion_of(stage)
    assert isinstance(stage.energy, Sum)
    rings = threaded_rings(soft.structure, x)
    residue = soft.structure.atom_residue
    pairs = [(ring.residue, int(residue[atom])) for ring in rings for atom in ring.bond]
    passing = replace(soft, passing=read_only(pairs, np.int64))
    terms = [part for part in stage.energy.parts if part is not soft]
    pushes: list[Force] = [push_of(soft.structure, x, ring, attempt) for ring in rings]
    return replace(stage, energy=Sum([passing, *terms, *pushes]))


def _repulsion_of(stage: Stage) -> SoftRepulsion:
    assert isinstance(stage.energy, Sum)
    return next(part for part in stage.energy.parts if isinstance(part, SoftRepulsion))


def push_of(structure: Structure, x: Floats, threaded: ThreadedRing, attempt: int) -> Push:
    """Push over one side of a ring, the best side at the first attempt, then the next one."""
    # x (na, 3) nm.
    # The best side is near the bond. Beyond it is free space, and no other bond of the ring.
    ring, bond = np.array(threaded.atoms), np.array(threaded.bond)
    corners = x[ring] - x[ring].mean(axis=0)
    normal = np.linalg.svd(corners)[2][2]
    sides = 0.5 * (corners + np.roll(corners, -1, axis=0))
    sides -= np.outer(sides @ normal, normal)
    outward = sides / np.linalg.norm(sides, axis=1, keepdims=True)
    through = x[bond] - x[ring].mean(axis=0)
    height = through @ normal
    share = height[0] / (height[0] - height[1]) if height[0] != height[1] else 0.5
    at = through[0] + np.clip(share, 0.0, 1.0) * (through[1] - through[0])
    distance = np.linalg.norm(sides, axis=1) - outward @ at
    excluded = np.isin(structure.atom_residue, structure.atom_residue[[*ring, *bond]])
    surroundings = x[~excluded] - x[ring].mean(axis=0)
    n_blocking = [np.sum(np.linalg.norm(surroundings - _OUTSIDE * d, axis=1) < _PATH_RADIUS) for d in outward]
    heavy = structure.bonds[(structure.atom_element[structure.bonds] != "H").all(axis=1)]
    leaving = heavy[np.isin(heavy, ring).sum(axis=1) == 1]
    has_bond = np.isin(ring, leaving).astype(float)
    cost = distance + _ATOM_COST * np.array(n_blocking) + _BOND_COST * (has_bond + np.roll(has_bond, -1))
    side = np.argsort(cost, kind="stable")[attempt % len(cost)]
    return Push(ring, bond, outward[side])
