"""Dense mass matrix by composite rigid bodies: reference for the O(n) methods."""

import numpy as np

from protochain.core.arrays import Floats, Integers
from protochain.mechanics.multibody import algebra
from protochain.mechanics.multibody.algebra import Vector, add, cross, dot, kernel
from protochain.mechanics.multibody.kinematics import Frames
from protochain.mechanics.multibody.tree import ARMATURE, PARENT, SLIDE, TURN, Tree, V


def mass_matrix(tree: Tree, frames: Frames) -> Floats:
    """Mass matrix M(q): kinetic energy is qd^T M qd / 2.

    Parameters
    ----------
    tree, frames : Tree, Frames
        Rigid bodies and their world frames.

    Returns
    -------
    (n_v, n_v) float, amu nm^2
        Mass matrix. Entries between two slides are in amu, between a turn and a slide in amu nm.

    Notes
    -----
    Composite-rigid-body algorithm: Walker, Orin (1982), Featherstone (2008). O(n depth), and
    O(n^2) to clear the matrix.
    """
    out = np.zeros((tree.n_v, tree.n_v))
    _composite(tree.links, tree.bodies, frames.rotation, frames.origin, np.zeros((tree.n_bodies, 21)), out)
    return out


@kernel
def _composite(
    links: Integers, bodies: Floats, rotation: Floats, origin: Floats, carried: Floats, out: Floats
) -> None:
    for b in range(len(bodies) - 1, -1, -1):
        p = links[b, PARENT]
        n_v = links[b + 1, V] - links[b, V]
        rigid = algebra.rigid_inertia(algebra.matrix(rotation, b), bodies, b)
        composite = algebra.add_rigid(algebra.inertia(carried, b), rigid)
        algebra.put_inertia(composite, carried, b)
        if p >= 0:
            algebra.add_inertia(algebra.shifted_inertia(composite, algebra.lever(origin, b, p)), carried, p)
        for j in range(n_v):
            k, axis = links[b, V] + j, algebra.hinge_axis(rotation, b)
            omega, u = algebra.freedom(axis, bodies[b, TURN], bodies[b, SLIDE], n_v, j)
            moment, force = algebra.inertia_times(composite, omega, u)
            _project(links, bodies, rotation, b, moment, force, k, out)
            out[k, k] += bodies[b, ARMATURE]
            at, above = b, p
            while above >= 0:
                moment = add(moment, cross(algebra.lever(origin, at, above), force))
                _project(links, bodies, rotation, above, moment, force, k, out)
                at, above = above, links[above, PARENT]


@kernel
def _project(
    links: Integers, bodies: Floats, rotation: Floats, b: int, moment: Vector, force: Vector, k: int,
    out: Floats,
) -> None:  # fmt: skip
    """Write the entries of column k and row k that belong to body b's freedoms."""
    n_v = links[b + 1, V] - links[b, V]
    for i in range(n_v):
        omega, u = algebra.freedom(algebra.hinge_axis(rotation, b), bodies[b, TURN], bodies[b, SLIDE], n_v, i)
        entry = dot(omega, moment) + dot(u, force)
        out[links[b, V] + i, k] = entry
        out[k, links[b, V] + i] = entry
