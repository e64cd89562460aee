"""O(n) mechanics of trees of rigid bodies, independent of proteins and energies."""

from protochain.mechanics.multibody.forward import forward_dynamics
from protochain.mechanics.multibody.kinematics import Frames, integrate, jacobian, pose, pull_back, velocities
from protochain.mechanics.multibody.loops import log_det_closed, solve_closed
from protochain.mechanics.multibody.mass import (
    Method,
    log_det_mass,
    mass_matrix,
    sample_velocities,
    solve_mass,
)
from protochain.mechanics.multibody.newton_euler import (
    centre_of_mass,
    inverse_dynamics,
    kinetic_energy,
    momentum,
    multiply_mass,
)
from protochain.mechanics.multibody.operational import (
    Rows,
    log_det_gradient,
    operational_inverse,
    point_rows,
    row_matrix,
)
from protochain.mechanics.multibody.random_tree import random_tree
from protochain.mechanics.multibody.tree import HingeKind, Tree, rigid_bodies

__all__ = [
    "Frames", "HingeKind", "Method", "Rows", "Tree", "centre_of_mass", "forward_dynamics", "integrate",
    "inverse_dynamics", "jacobian", "kinetic_energy", "log_det_closed", "log_det_gradient",
    "log_det_mass", "mass_matrix", "momentum", "multiply_mass", "operational_inverse", "point_rows",
    "pose", "pull_back", "random_tree", "rigid_bodies", "row_matrix", "sample_velocities", "solve_closed",
    "solve_mass", "velocities",
]  # fmt: skip
