"""Frames of bonds: what turns with a molecule is the same in them, and steps keep the lengths of bonds."""

import numpy as np
import pytest
from fixtures.samples import energy, load
from scipy.spatial.transform import Rotation

from protochain.minimisers.bond_frames import legs_of
from protochain.minimisers.curvature import near_terms
from protochain.minimisers.problem import evaluate
from protochain.minimisers.spaces import Cartesian, Positions

ROUNDED = 1e-9
"""Relative, of forces and steps after a turn of all positions in doubles."""


def turned(x):
    turn = Rotation.from_rotvec([0.3, -1.2, 0.7]).as_matrix()
    return x @ turn.T, turn


def test_what_turns_with_the_molecule_is_the_same_in_its_frames():
    s, e = load("1l2y.pdb"), energy("1l2y.pdb")
    space = Cartesian(s, np.ones(s.n_atoms, bool), near_terms(e))
    x, turn = turned(s.positions)
    at, after = (evaluate(space, e, each.ravel()) for each in (s.positions, x))
    assert after.torque == pytest.approx(at.torque, rel=ROUNDED, abs=1e-6)
    step, its = (space.stiffness(each)(each.torque) for each in (at, after))
    assert its == pytest.approx(step, rel=ROUNDED, abs=1e-11)
    assert space.move(after.q, its).reshape(-1, 3) == pytest.approx(
        space.move(at.q, step).reshape(-1, 3) @ turn.T, abs=1e-11
    )
    assert space.transport_torque(after.torque, after.pose, at.pose) == pytest.approx(
        space.inward(at.x, e(x)[1]), abs=1e-9
    )


def test_frames_lose_nothing_of_a_vector():
    s = load("1l2y.pdb")
    space = Cartesian(s, np.ones(s.n_atoms, bool))
    v = np.random.default_rng(0).normal(size=3 * s.n_atoms)
    inside = space.inward(s.positions, v)
    assert space.outward(s.positions, inside) == pytest.approx(v, abs=1e-14)
    size = np.linalg.norm(v.reshape(-1, 3), axis=1)
    assert np.linalg.norm(inside.reshape(-1, 3), axis=1) == pytest.approx(size, rel=1e-14)


def test_legs_are_bonded_and_atoms_without_enough_neighbours_have_none():
    s = load("1l2y.pdb")
    bonded = {frozenset(pair) for pair in s.bonds.tolist()}
    for i, (origin, *legs) in enumerate(legs_of(s.bonds, s.atom_mass).tolist()):
        assert i in (origin, legs[0]) and all(frozenset((origin, leg)) in bonded for leg in legs)
        assert len({origin, *legs}) == 3
    # An ion, two atoms of a molecule, and three in a row.
    found = legs_of(np.array([[1, 2], [3, 4], [4, 5]]), np.array([23.0, 16.0, 1.0, 1.0, 12.0, 16.0]))
    assert found.tolist() == [[-1] * 3] * 3 + [[4, 3, 5], [4, 5, 3], [4, 5, 3]]


def test_a_turn_stretches_bonds_little_and_fixed_atoms_stay():
    s = load("1l2y.pdb")
    moving = np.arange(s.n_atoms) != 5
    space = Cartesian(s, moving)
    x = s.positions - s.positions[5]
    around = np.cross([0.2, 0.5, -0.4], x)
    first, second = s.bonds.T

    def stretched(at):
        lengths = [np.linalg.norm(each[first] - each[second], axis=1) for each in (x, at)]
        return np.abs(lengths[1] - lengths[0]).max()

    def after(share):
        return space.move(x.ravel(), share * space.inward(x, around)).reshape(-1, 3)

    straight = stretched(x + 0.1 * around)
    # The worst case: all bonds turn together, and each gives way to its neighbours alone.
    assert stretched(after(0.1)) < 0.25 * straight
    assert np.array_equal(after(0.1)[5], x[5]) and np.array_equal(Positions(x.ravel()).x, x)
    # The first order of a step is its own, whatever it does to bonds.
    step = np.random.default_rng(1).normal(size=x.shape) * moving[:, None]
    near = [(space.move(x.ravel(), h * space.inward(x, step)).reshape(-1, 3) - x) / h for h in (1e-6, -1e-6)]
    assert np.mean(near, axis=0) == pytest.approx(step, abs=1e-6)
