"""M^-1, ln det M and thermal velocities in O(n), M^-1 and ln det M by either of two methods."""

from typing import Literal

import numpy as np

from protochain.core.arrays import Floats, finite
from protochain.core.errors import MechanicsError
from protochain.mechanics.multibody import articulated, fixman
from protochain.mechanics.multibody.kinematics import Frames
from protochain.mechanics.multibody.tree import Tree

Method = Literal["articulated", "fixman"]
"""Method of solution: articulated bodies (Featherstone), or Fixman's method."""


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
