"""Forward dynamics by three sweeps: outward, inward, outward. O(n)."""

import numpy as np

from protochain.core.arrays import Floats, Integers, finite, floats
from protochain.mechanics.multibody import algebra, newton_euler
from protochain.mechanics.multibody.algebra import ZERO, kernel, subtract
from protochain.mechanics.multibody.articulated import accelerate, articulate, refuse_singular, solve
from protochain.mechanics.multibody.kinematics import WORLD, moved_freely, pose, seat, turned_by_hinge
from protochain.mechanics.multibody.newton_euler import AT_REST
from protochain.mechanics.multibody.tree import PARENT, SLIDE, TURN, Q, Tree, V
from protochain.mechanics.multibody.trigonometry import cosines_and_sines


def forward_dynamics(tree: Tree, q: Floats, qd: Floats, tau: Floats, wrench: Floats | None = None) -> Floats:
    """Solve M qdd + c(q, qd) = tau + J^T wrench for the accelerations qdd.

    Parameters
    ----------
    tree, q : Tree and (n_q,) float, rad (nm for prismatic hinges and the position of free roots)
        Rigid bodies and their coordinates.
    qd, tau : (n_v,) float, rad/ps (nm/ps for slides) and kJ/mol
        Velocities and torques. Driven hinges have accelerations in place of torques.
    wrench : (nb, 6) float, optional, kJ/mol/rad and kJ/mol/nm
        Moment on each body about its origin, and force, along world axes.

    Returns
    -------
    (n_v,) float, rad/ps^2 (nm/ps^2 for slides)
        Time derivatives of qd, as prescribed at driven hinges. Their torques are then
        :func:`~protochain.mechanics.multibody.inverse_dynamics` there.

    Raises
    ------
    MechanicsError
        If M is singular.
    ProtochainError
        If a number is not finite.

    Notes
    -----
    The Newton-Euler loads at qdd = 0 are subtracted, and articulated bodies solve for the accelerations:
    Featherstone (2008). O(n).

    Examples
    --------
    >>> from protochain import multibody
    >>> tree = multibody.random_tree(5, seed=1)
    >>> q = np.append([1.0, 0, 0, 0, 0, 0, 0], np.zeros(4))
    >>> rest, tau = np.zeros(tree.n_v), np.ones(tree.n_v)
    >>> qdd = multibody.forward_dynamics(tree, q, rest, tau)
    >>> bool(np.allclose(multibody.inverse_dynamics(tree, q, rest, qdd), tau))
    True
    """
    q, qd = floats(q, (tree.n_q,), "q"), finite(qd, (tree.n_v,), "qd")
    loads = np.zeros((tree.n_bodies, 6))
    if wrench is not None:
        loads += finite(wrench, loads.shape, "wrench")
    return _solve(tree, q, qd, finite(tau, (tree.n_v,), "tau").copy(), loads)


def accelerations(tree: Tree, q: Floats, qd: Floats, tau: Floats) -> Floats:
    """Accelerations (n_v,) as :func:`forward_dynamics`, of motions that may diverge."""
    q, qd = floats(q, (tree.n_q,), "q"), floats(qd, (tree.n_v,), "qd")
    return _solve(tree, q, qd, floats(tau, (tree.n_v,), "tau").copy(), np.zeros((tree.n_bodies, 6)))


def _solve(tree: Tree, q: Floats, qd: Floats, x: Floats, loads: Floats) -> Floats:
    """Overwrite torques in ``x`` by accelerations, and the external ``loads``."""
    if tree.is_plain:
        refuse_singular(_forward(tree.links, tree.bodies, q, qd, loads, x), q)
        return x
    # Separate sweeps, if hinges are driven or bodies have no mass.
    frames, prescribed = pose(tree, q), np.zeros(tree.n_v)
    prescribed[tree.driven_v] = x[tree.driven_v]
    inertial = newton_euler.inertial_loads(tree, frames, qd, prescribed)
    return solve(articulate(tree, frames), x, inertial - loads) + prescribed


@kernel
def _forward(links: Integers, bodies: Floats, q: Floats, qd: Floats, wrench: Floats, x: Floats) -> int:
    """Overwrite tau in ``x`` by accelerations, and the external ``wrench``."""
    n = len(bodies)
    rotation, origin, packed = np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((n, 21))
    motions = np.empty((n, 9))
    cosine, sine = np.empty(len(q)), np.empty(len(q))
    cosines_and_sines(q, cosine, sine)
    for b in range(n):
        p, k, j = links[b, PARENT], links[b, Q], links[b, V]
        n_v = links[b + 1, V] - j
        (above, start), motion = WORLD, AT_REST
        if p >= 0:
            above, start = algebra.matrix(rotation, p), algebra.vector(origin, p)
            motion = newton_euler.motion_of(motions, p)
        turn, at = seat(bodies, b, above, start)
        if n_v == 1:
            round_axis, along = bodies[b, TURN], bodies[b, SLIDE]
            turn, at = turned_by_hinge(turn, at, round_axis, along, q[k], cosine[k], sine[k])
            motion = newton_euler.carried_along(motion, subtract(at, start))
            axis = turn[2], turn[5], turn[8]
            motion = newton_euler.moved_by_hinge(motion, axis, round_axis, along, qd[j], 0.0)
        elif n_v == 6:
            turn, at = moved_freely(at, q, k)
            motion = algebra.vector_at(qd, j), ZERO, ZERO
        else:
            motion = newton_euler.carried_along(motion, subtract(at, start))
        algebra.put_matrix(turn, rotation, b)
        algebra.put(at, origin, b, 0)
        newton_euler.put_motion(motion, motions, b)
        rigid = algebra.rigid_inertia(turn, bodies, b)
        algebra.put_inertia(algebra.add_rigid(algebra.MASSLESS, rigid), packed, b)
        moment, force = newton_euler.load(rigid, motion)
        given_moment, given_force = algebra.pair(wrench, b)
        algebra.put_pair(subtract(moment, given_moment), subtract(force, given_force), wrench, b)
    return accelerate(links, bodies, rotation, origin, packed, wrench, x)
