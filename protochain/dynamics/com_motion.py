"""Centre-of-mass motion: translation and rotation of the whole system, and its removal."""

import numpy as np

from protochain.core.arrays import Floats
from protochain.mechanics import multibody
from protochain.mechanics.multibody import Frames, HingeKind, Tree


def has_free_roots(tree: Tree) -> bool:
    """Whether all roots are free, so that an isolated system conserves momentum."""
    return bool(np.all(tree.kind[tree.parent < 0] == HingeKind.FREE))


def remove_com_motion(tree: Tree, frames: Frames, qd: Floats) -> Floats:
    """Remove translation and rotation of the whole from velocities (n_v,), if all roots are free."""
    centre = multibody.centre_of_mass(tree, frames)
    turns = [_rigid_motion(tree, frames, axis, np.zeros(3), centre) for axis in np.eye(3)]
    inertia = np.stack([multibody.momentum(tree, frames, turn)[1] for turn in turns], axis=1)
    linear, angular = multibody.momentum(tree, frames, qd)
    # A lone diatomic has neither inertia nor angular momentum about its axis.
    omega = np.asarray(np.linalg.lstsq(inertia, angular, rcond=1e-12)[0], dtype=np.float64)
    return np.asarray(qd - _rigid_motion(tree, frames, omega, linear / tree.mass.sum(), centre))


def _rigid_motion(tree: Tree, frames: Frames, omega: Floats, u: Floats, centre: Floats) -> Floats:
    """Velocities of the roots for a rotation of the whole system about the centre and a translation."""
    qd = np.zeros(tree.n_v)
    for b in np.flatnonzero(tree.parent < 0):
        k = tree.v_start[b]
        qd[k : k + 3], qd[k + 3 : k + 6] = omega, u + np.cross(omega, frames.origin[b] - centre)
    return qd
