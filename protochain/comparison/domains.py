"""Rigid domains: parts of a chain that one rigid motion takes from one structure to another.

Adaptive selection of Wriggers, Schulten, Proteins 29:1 (1997): a few neighbours are superposed, all that then
lie within a tolerance are taken in, and so on until nothing changes; of the domains that grow so from
different places the largest is kept, and the next is sought in what is left.
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from protochain.core.arrays import Floats, Integers
from protochain.structure.superpose import motion, rmsd

TOLERANCE = 0.2
"""nm from where a domain's motion takes a residue."""
LEAST = 20
"""Residues of a domain, and neighbours from which one grows."""
_SEEDS = 100
"""Places, evenly along the sequence, from which domains grow."""
_MOST_STEPS = 50
"""Superpositions of one growth, which may go to and fro at last."""


class Domain(NamedTuple):
    """A part that moves as a rigid body."""

    members: Integers  # (n,) int: Points of it.
    rmsd: float  # Of its points, superposed by themselves, in their unit.
    turn: float  # degrees: Of its motion against that of the largest domain.


def rigid_domains(x: Floats, y: Floats) -> list[Domain]:
    """Find the rigid domains of points (n, 3) that moved from x to y, the largest first: x, y (n, 3) nm."""
    left, motions = np.arange(len(x)), list[tuple[Floats, Floats]]()
    while len(left) >= LEAST:
        domain = _largest(x, y, left)
        if len(domain) < LEAST:
            break
        motions.append(motion(x[domain], y[domain]))
        left = np.setdiff1d(left, domain)
    if not motions:
        return []
    away = np.array([_away(x, y, rigid_motion) for rigid_motion in motions])
    nearest = away.argmin(axis=0)
    parts = [np.flatnonzero((nearest == k) & (away[k] <= TOLERANCE)) for k in range(len(away))]
    parts = sorted((part for part in parts if len(part) >= LEAST), key=len, reverse=True)
    turns = [motion(x[part], y[part])[0] for part in parts]
    angles = [np.degrees(Rotation.from_matrix(turn @ turns[0].T).magnitude()) for turn in turns]
    return [
        Domain(part, rmsd(y[part], x[part]), float(angle))
        for part, angle in zip(parts, angles, strict=True)
    ]  # fmt: skip


def _largest(x: Floats, y: Floats, left: Integers) -> Integers:
    """Largest domain of the points that are left, grown from all of them or from neighbours."""
    best = _grow(x, y, left, left)
    if len(best) == len(left):
        return best
    for seed in left[:: max(1, len(left) // _SEEDS)]:
        near = left[np.argsort(np.linalg.norm(x[left] - x[seed], axis=1), kind="stable")[:LEAST]]
        grown = _grow(x, y, left, near)
        best = grown if len(grown) > len(best) else best
    return best


def _grow(x: Floats, y: Floats, left: Integers, members: Integers) -> Integers:
    for _ in range(_MOST_STEPS):
        within = left[_away(x[left], y[left], motion(x[members], y[members])) <= TOLERANCE]
        if len(within) < LEAST:
            return within[:0]
        if np.array_equal(within, members):
            break
        members = within
    return members


def _away(x: Floats, y: Floats, move: tuple[Floats, Floats]) -> Floats:
    """Distance (n,) of each point of y from where a motion takes that of x."""
    turn, shift = move
    return np.asarray(np.linalg.norm(x @ turn.T + shift - y, axis=1))
