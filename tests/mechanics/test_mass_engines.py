"""Pinocchio, given the same tree, finds the same accelerations."""

import numpy as np
import pytest
from fixtures.pinocchio_tree import KINDS, pinocchio_acceleration, state

from protochain.mechanics.multibody import (
    HingeKind,
    forward_dynamics,
    log_det_mass,
    mass_matrix,
    pose,
    random_tree,
)

AGREEMENT = {30: 1e-10, 300: 1e-8}
"""Relative, by number of hinges: two stable methods differ by eps times the condition of M, some 1e4 at 30
hinges and 1e7 at 300."""


@pytest.mark.parametrize("root", [HingeKind.REVOLUTE, HingeKind.FREE])
@pytest.mark.parametrize("branching", [0.0, 0.5])
@pytest.mark.parametrize("n", AGREEMENT)
def test_accelerations_agree(n, branching, root):
    tree = random_tree(n + (root == HingeKind.FREE), 17 + n, branching, root, KINDS)
    s = state(tree, n)
    theirs = pinocchio_acceleration(tree, s)
    ours = forward_dynamics(tree, s.q, s.qd, s.tau)
    assert np.abs(ours - theirs).max() < AGREEMENT[n] * np.abs(ours).max()


def test_the_mass_matrix_is_pinocchios():
    tree = random_tree(40, 3, 0.3, HingeKind.REVOLUTE, KINDS)
    s = state(tree, 1)
    frames = pose(tree, s.q)
    # Accelerations for unit torques at rest are the columns of the inverse.
    s.qd = np.zeros(tree.n_v)
    columns = []
    for unit in np.eye(tree.n_v):
        s.tau = unit
        columns.append(pinocchio_acceleration(tree, s))
    m = mass_matrix(tree, frames)
    assert np.abs(m @ np.array(columns).T - np.eye(tree.n_v)).max() < 1e-9
    assert log_det_mass(tree, frames) == pytest.approx(-np.linalg.slogdet(columns)[1], abs=1e-9)
