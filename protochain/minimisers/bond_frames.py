"""Frames that turn with the bonds of each atom, and steps that preserve bond lengths while bonds turn.

Soft motions of all atoms are turns about bonds. A model of the Hessian or an L-BFGS pair belongs to the bond
directions at one point. In frames of the bonds it also applies to the turned molecule, as in corotational
finite elements. A straight step along a turn stretches bonds by half its square over their length, which
costs more energy than the turn gains.
"""

import numpy as np

from protochain.core.arrays import Floats, Integers
from protochain.core.graph import both_ways
from protochain.mechanics.multibody.algebra import (
    Vector,
    add,
    cross,
    dot,
    kernel,
    put,
    scale,
    subtract,
    vector,
)  # fmt: skip

SWEEPS = 4
"""Sweeps over all bonds. With one, a run needs a tenth more evaluations. With eight, it needs as many."""
_SHORT, _THIN = 1e-4, 0.05
"""Shortest bond, nm, and smallest sine of a bond angle, for which an atom has a frame."""


def legs_of(bonds: Integers, mass: Floats) -> Integers:
    """(na, 3) int: origin of each atom's frame, and the two atoms that define its axes, -1 for none."""
    # The atom and its two heaviest neighbours. For an end atom: its neighbour, the atom itself, and the
    # heaviest other neighbour of this neighbour.
    n = len(mass)
    ends = both_ways(bonds)
    atom, neighbour = ends[np.lexsort((ends[:, 1], -mass[ends[:, 1]], ends[:, 0]))].T
    # The last atoms look beyond the end.
    first, count = np.searchsorted(atom, np.arange(n)), np.bincount(atom, minlength=n)
    neighbours = np.array([*neighbour, -1, -1])[first[:, None] + np.arange(2)]
    neighbours[count < 2, 1] = neighbours[count < 1, 0] = -1
    legs = np.column_stack([np.arange(n), neighbours])
    legs[count == 0] = -1
    ending = np.flatnonzero(count == 1)
    parent = neighbours[ending, 0]
    beyond = np.where(neighbours[parent, 0] == ending, neighbours[parent, 1], neighbours[parent, 0])
    legs[ending] = np.where(beyond[:, None] < 0, -1, np.column_stack([parent, ending, beyond]))
    return legs


@kernel
def _axes(x: Floats, legs: Integers, i: int) -> tuple[Vector, Vector, Vector]:
    """Axes of an atom's frame, or the world axes if it has none."""
    origin, first, last = legs[i, 0], legs[i, 1], legs[i, 2]
    if origin >= 0:
        at = vector(x, origin)
        along, aside = subtract(vector(x, first), at), subtract(vector(x, last), at)
        normal = cross(along, aside)
        length, breadth = np.sqrt(dot(along, along)), np.sqrt(dot(aside, aside))
        area = np.sqrt(dot(normal, normal))
        if length > _SHORT and area > _THIN * length * breadth:
            along, normal = scale(1.0 / length, along), scale(1.0 / area, normal)
            return along, cross(normal, along), normal
    return (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


@kernel
def inward(x: Floats, legs: Integers, vectors: Floats) -> Floats:
    """Convert vectors (na, 3) from world axes to the atoms' frames at x (na, 3)."""
    components = np.empty_like(vectors)
    for i in range(len(vectors)):
        a, b, c = _axes(x, legs, i)
        v = vector(vectors, i)
        put((dot(a, v), dot(b, v), dot(c, v)), components, i, 0)
    return components


@kernel
def outward(x: Floats, legs: Integers, vectors: Floats) -> Floats:
    """Convert vectors (na, 3) from the atoms' frames at x (na, 3) to world axes."""
    world_vectors = np.empty_like(vectors)
    for i in range(len(vectors)):
        a, b, c = _axes(x, legs, i)
        u, v, w = vector(vectors, i)
        put(add(scale(u, a), add(scale(v, b), scale(w, c))), world_vectors, i, 0)
    return world_vectors


@kernel
def apply_step(x: Floats, step: Floats, bonds: Integers, weight: Floats) -> Floats:
    """Positions (na, 3) after a step, with bond lengths that are correct to first order in the step."""
    # weight (na,): Inverse masses of the atoms, 0 for fixed ones.
    lengths, at = np.empty(len(bonds)), x + step
    for n in range(len(bonds)):
        i, j = bonds[n, 0], bonds[n, 1]
        d = subtract(vector(x, i), vector(x, j))
        length = max(np.sqrt(dot(d, d)), _SHORT)
        extension = dot(d, subtract(vector(step, i), vector(step, j))) / length
        lengths[n] = max(length + extension, 0.5 * length)
    for _ in range(SWEEPS):
        for n in range(len(bonds)):
            i, j = bonds[n, 0], bonds[n, 1]
            total = weight[i] + weight[j]
            if total > 0.0:
                d = subtract(vector(at, i), vector(at, j))
                length = max(np.sqrt(dot(d, d)), _SHORT)
                d = scale((lengths[n] - length) / (length * total), d)
                put(add(vector(at, i), scale(weight[i], d)), at, i, 0)
                put(subtract(vector(at, j), scale(weight[j], d)), at, j, 0)
    return at
