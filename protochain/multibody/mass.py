"""M^-1, ln det M and velocities at a temperature, by either of two O(n) routes."""

from typing import Literal

import numpy as np

from protochain.arrays import Floats
from protochain.errors import MechanicsError
from protochain.multibody import articulated, fixman
from protochain.multibody.kinematics import Frames
from protochain.multibody.tree import Tree

Method = Literal["articulated", "fixman"]
"""How to solve: by articulated bodies (Featherstone), or by Fixman's method."""


def solve_mass(tree: Tree, frames: Frames, tau: Floats, method: Method = "articulated") -> Floats:
    """M^-1 tau in O(n), without forming M.

    Parameters
    ----------
    tree : Tree
    frames : Frames
    tau : (n_v,) float, kJ/mol
    method : str
        ``articulated`` eliminates the hinges' freedoms, ``fixman`` the directions they lock.

    Returns
    -------
    (n_v,) float, rad/ps^2 (nm/ps^2 for slides)

    Raises
    ------
    MechanicsError
        If M is singular, a body has no inverse inertia (``fixman``), or the method is unknown.
    """
    if checked(method) == "fixman":
        return fixman.solve(fixman.eliminate(tree, frames), tau)
    return articulated.solve_at_once(tree, frames, tau)


def log_det_mass(tree: Tree, frames: Frames, method: Method = "articulated") -> float:
    """Ln det M in O(n), without forming M.

    Parameters
    ----------
    tree : Tree
    frames : Frames
    method : str
        As in :func:`solve_mass`.

    Returns
    -------
    float
        Of M in amu nm^2 (amu for slides).

    Raises
    ------
    MechanicsError
        As :func:`solve_mass`.
    """
    if checked(method) == "fixman":
        return fixman.log_det(fixman.eliminate(tree, frames))
    return articulated.log_det(articulated.articulate(tree, frames))


def sample_velocities(tree: Tree, frames: Frames, thermal_energy: float, rng: np.random.Generator) -> Floats:
    """Velocities at thermal equilibrium: normal, with covariance kT M^-1.

    Parameters
    ----------
    tree : Tree
    frames : Frames
    thermal_energy : float, kJ/mol
        kT.
    rng : numpy.random.Generator

    Returns
    -------
    (n_v,) float, rad/ps (nm/ps for slides)

    Raises
    ------
    MechanicsError
        If M is singular.
    """
    noise = np.sqrt(thermal_energy) * rng.standard_normal(tree.n_v)
    return articulated.sample(articulated.articulate(tree, frames), noise)


def checked(method: str) -> str:
    """Return the method, if it is one.

    Raises
    ------
    MechanicsError
        Naming it and the choice there is.
    """
    if method not in ("articulated", "fixman"):
        raise MechanicsError(f"method {method!r} is not known; choose articulated or fixman")
    return method
