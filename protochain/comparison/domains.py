"""Rigid domains: parts of a chain that move as rigid bodies between two structures.

Adaptive selection of Wriggers, Schulten, Proteins 29:1 (1997): a few neighbours are superposed, all residues
within a tolerance are added, and this is repeated until nothing changes. Domains grow from different seeds.
The largest is selected, and the search continues with the remaining residues.
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from protochain.core.arrays import Floats, Integers
from protochain.structure.superpose import motion, rmsd

TOLERANCE = 0.2
"""nm. Largest distance of a residue from its position by the domain's motion."""
LEAST = 20
"""Fewest residues of a domain, and number of neighbours from which it grows."""
_SEEDS = 100  # Number of seeds, evenly along the sequence, from which domains grow.
_MOST_STEPS = 50  # Limit of superpositions of one growth, which may alternate at its end.


class Domain(NamedTuple):
    """A part that moves as a rigid body."""

    members: Integers  # (n,) int: Indices of its points.
    rmsd: float  # RMSD of its points, superposed separately, in their unit.
    turn: float  # degrees: Angle of its motion relative to the largest domain's.


def rigid_domains(x: Floats, y: Floats) -> list[Domain]:
    """Find the rigid domains of points (n, 3) that moved from x to y, the largest first: x, y (n, 3) nm."""
    remaining, motions = np.arange(len(x)), list[tuple[Floats, Floats]]()
    while len(remaining) >= LEAST:
        domain = _largest(x, y, remaining)
        if len(domain) < LEAST:
            break
        motions.append(motion(x[domain], y[domain]))
        remaining = np.setdiff1d(remaining, domain)
    if not motions:
        return []
    deviations = np.array([_deviations(x, y, rigid_motion) for rigid_motion in motions])
    nearest = deviations.argmin(axis=0)
    parts = [np.flatnonzero((nearest == k) & (deviations[k] <= TOLERANCE)) for k in range(len(deviations))]
    parts = sorted((part for part in parts if len(part) >= LEAST), key=len, reverse=True)
    turns = [motion(x[part], y[part])[0] for part in parts]
    angles = [np.degrees(Rotation.from_matrix(turn @ turns[0].T).magnitude()) for turn in turns]
    return [
        Domain(part, rmsd(y[part], x[part]), float(angle))
        for part, angle in zip(parts, angles, strict=True)
    ]  # fmt: skip


def _largest(x: Floats, y: Floats, remaining: Integers) -> Integers:
    """Largest domain of the remaining points, grown from all of them or from neighbours."""
    best = _grow(x, y, remaining, remaining)
    if len(best) == len(remaining):
        return best
    for seed in remaining[:: max(1, len(remaining) // _SEEDS)]:
        near = remaining[np.argsort(np.linalg.norm(x[remaining] - x[seed], axis=1), kind="stable")[:LEAST]]
        domain = _grow(x, y, remaining, near)
        best = domain if len(domain) > len(best) else best
    return best


def _grow(x: Floats, y: Floats, points: Integers, members: Integers) -> Integers:
    for _ in range(_MOST_STEPS):
        within = points[_deviations(x[points], y[points], motion(x[members], y[members])) <= TOLERANCE]
        if len(within) < LEAST:
            return within[:0]
        if np.array_equal(within, members):
            break
        members = within
    return members


def _deviations(x: Floats, y: Floats, move: tuple[Floats, Floats]) -> Floats:
    """Distance (n,) of each point of y from the moved point of x."""
    turn, shift = move
    return np.asarray(np.linalg.norm(x @ turn.T + shift - y, axis=1))
