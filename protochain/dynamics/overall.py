"""Motion of everything as one: how much there is, and taking it away."""

import numpy as np

from protochain import multibody
from protochain.arrays import Floats
from protochain.multibody import Frames, HingeKind, Tree


def can_drift(tree: Tree) -> bool:
    """Whether all roots are free: then what is isolated keeps its momenta."""
    return bool(np.all(tree.kind[tree.parent < 0] == HingeKind.FREE))


def without_drift(tree: Tree, frames: Frames, qd: Floats) -> Floats:
    """Velocities less the motion of all bodies as one.

    Parameters
    ----------
    tree : Tree
        All its roots are free.
    frames : Frames
    qd : (n_v,) float, rad/ps and nm/ps

    Returns
    -------
    (n_v,) float
        With no linear momentum, and no angular momentum about the centre of mass.
    """
    centre = multibody.centre_of_mass(tree, frames)
    turns = [_as_one(tree, frames, axis, np.zeros(3), centre) for axis in np.eye(3)]
    inertia = np.stack([multibody.momentum(tree, frames, turn)[1] for turn in turns], axis=1)
    linear, angular = multibody.momentum(tree, frames, qd)
    # A lone diatomic has no inertia about its own axis, and then no momentum either.
    omega = np.asarray(np.linalg.lstsq(inertia, angular, rcond=1e-12)[0], dtype=np.float64)
    return np.asarray(qd - _as_one(tree, frames, omega, linear / tree.mass.sum(), centre))


def _as_one(tree: Tree, frames: Frames, omega: Floats, u: Floats, centre: Floats) -> Floats:
    """Velocities of the roots that turn everything about the centre and move it."""
    qd = np.zeros(tree.n_v)
    for b in np.flatnonzero(tree.parent < 0):
        k = tree.v_start[b]
        qd[k : k + 3], qd[k + 3 : k + 6] = omega, u + np.cross(omega, frames.origin[b] - centre)
    return qd
