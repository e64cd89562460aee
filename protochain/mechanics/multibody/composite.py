"""Dense mass matrix by composite rigid bodies: reference for the O(n) methods."""

import numpy as np

from protochain.core.arrays import Floats, Integers
from protochain.mechanics.multibody.algebra import (
    Vector,
    add,
    add_inertia,
    add_rigid,
    cross,
    dot,
    freedom,
    hinge_axis,
    inertia,
    inertia_times,
    kernel,
    lever,
    matrix,
    put_inertia,
    rigid_inertia,
    shifted_inertia,
)  # fmt: skip
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
        Mass matrix; entries between two slides are in amu, between a turn and a slide in amu nm.

    Notes
    -----
    Composite-rigid-body algorithm: Walker, Orin (1982); Featherstone (2008). O(n depth), and
    O(n^2) to clear the matrix.
    """
    out = np.zeros((tree.n_v, tree.n_v))
    _composite(
        tree.links, tree.bodies, frames.rotation, frames.origin,
        np.zeros((tree.n_bodies, 21)), out,
    )  # fmt: skip
    return out


@kernel
def _composite(
    links: Integers, bodies: Floats, rotation: Floats, origin: Floats,
    carried: Floats, out: Floats,
) -> None:  # fmt: skip
    for b in range(len(bodies) - 1, -1, -1):
        p = links[b, PARENT]
        n_v = links[b + 1, V] - links[b, V]
        composite = add_rigid(inertia(carried, b), rigid_inertia(matrix(rotation, b), bodies, b))
        put_inertia(composite, carried, b)
        if p >= 0:
            add_inertia(shifted_inertia(composite, lever(origin, b, p)), carried, p)
        for j in range(n_v):
            k = links[b, V] + j
            omega, u = freedom(hinge_axis(rotation, b), bodies[b, TURN], bodies[b, SLIDE], n_v, j)
            moment, force = inertia_times(composite, omega, u)
            _project(links, bodies, rotation, b, moment, force, k, out)
            out[k, k] += bodies[b, ARMATURE]
            at, above = b, p
            while above >= 0:
                moment = add(moment, cross(lever(origin, at, above), force))
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
        omega, u = freedom(hinge_axis(rotation, b), bodies[b, TURN], bodies[b, SLIDE], n_v, i)
        entry = dot(omega, moment) + dot(u, force)
        out[links[b, V] + i, k] = entry
        out[k, links[b, V] + i] = entry
