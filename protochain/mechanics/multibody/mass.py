"""Mass matrix M by composite rigid bodies, a reference, and M^-1, ln det M and thermal velocities in O(n)."""

from typing import Literal

import numpy as np

from protochain.core.arrays import Floats, Integers, finite
from protochain.core.errors import MechanicsError
from protochain.mechanics.multibody import algebra, articulated, fixman
from protochain.mechanics.multibody.algebra import Vector, add, cross, dot, kernel
from protochain.mechanics.multibody.kinematics import Frames
from protochain.mechanics.multibody.tree import ARMATURE, PARENT, SLIDE, TURN, Tree, V

Method = Literal["articulated", "fixman"]
"""Method of solution: articulated bodies (Featherstone), or Fixman's method."""


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


def solve_mass(tree: Tree, frames: Frames, tau: Floats, method: Method = "articulated") -> Floats:
    """Solve M x = tau in O(n), without forming M.

    Parameters
    ----------
    tree, frames : Tree, Frames
        Rigid bodies and their world frames.
    tau : (n_v,) float, kJ/mol
        Torques.
    method : str
        Method: ``articulated`` eliminates the freedoms of the hinges, ``fixman`` the directions they lock.

    Returns
    -------
    (n_v,) float, rad/ps^2 (nm/ps^2 for slides)
        Accelerations from rest.

    Raises
    ------
    MechanicsError
        If M is singular, masses are too far apart or a body has no inverse inertia (``fixman``), or the
        method is unknown.
    """
    tau = finite(tau, (tree.n_v,), "tau")
    if check_method(method) == "fixman":
        return fixman.solve(fixman.eliminate(tree, frames), tau)
    return articulated.solve_at_once(tree, frames, tau)


def log_det_mass(tree: Tree, frames: Frames, method: Method = "articulated") -> float:
    """Logarithm of det M in O(n), without forming M.

    Parameters
    ----------
    tree, frames : Tree, Frames
        Rigid bodies and their world frames.
    method : str
        Method as in :func:`solve_mass`.

    Returns
    -------
    float
        Value of ln det M, with M in amu nm^2 (amu for slides).

    Raises
    ------
    MechanicsError
        As :func:`solve_mass`.
    """
    if check_method(method) == "fixman":
        return fixman.log_det(fixman.eliminate(tree, frames))
    return articulated.log_det(articulated.articulate(tree, frames))


def sample_velocities(tree: Tree, frames: Frames, thermal_energy: float, rng: np.random.Generator) -> Floats:
    """Draw velocities at thermal equilibrium: normal, with covariance kT M^-1.

    Parameters
    ----------
    tree, frames : Tree, Frames
        Rigid bodies and their world frames.
    thermal_energy : float, kJ/mol
        Value of kT.
    rng : numpy.random.Generator
        Source of random numbers.

    Returns
    -------
    (n_v,) float, rad/ps (nm/ps for slides)
        Velocities.

    Raises
    ------
    MechanicsError
        If M is singular.
    """
    noise = np.sqrt(thermal_energy) * rng.standard_normal(tree.n_v)
    return articulated.sample(articulated.articulate(tree, frames), noise)


def check_method(method: str) -> str:
    """Return the method if it is known."""
    if method not in ("articulated", "fixman"):
        raise MechanicsError(f"method {method!r} is not known; choose articulated or fixman")
    return method


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
