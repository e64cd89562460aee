import numpy as np
import pytest
from fixtures.samples import load
from fixtures.tolerances import RMSD_ANGSTROM
from scipy.spatial.transform import Rotation

import protochain as pc
from protochain.structure.superpose import rmsd, superpose


@pytest.fixture(scope="module")
def pairs():
    """(structure, positions) of real and made deformations, from 0.05 to some angstrom."""
    s = load("1ubq.pdb")
    rng = np.random.default_rng(0)
    made = [(s, s.positions + size * rng.normal(size=s.positions.shape)) for size in (0.005, 0.05, 0.3)]
    c = pc.build_chain(s)
    return [*made, (s, pc.pose(c, c.q0 + 0.02 * rng.normal(size=c.n_q)).x)]


def test_ca_rmsd_equals_mdtraj(pairs):
    import mdtraj

    for s, x in pairs:
        alpha = s.alpha_carbons
        frames = mdtraj.Trajectory(
            np.array([s.positions, x], dtype=np.float32), mdtraj.Topology.from_openmm(s.topology)
        )
        ours = pc.ca_rmsd(s, x, s.positions)
        # Its rmsd kernel subtracts large single-precision numbers: below an angstrom it has fewer digits
        # than asked for here, while its superposition keeps them.
        if ours > 1.0:
            theirs = 10 * mdtraj.rmsd(frames, frames, 0, atom_indices=alpha)[1]
            assert ours == pytest.approx(float(theirs), abs=RMSD_ANGSTROM)
        frames.superpose(frames, 0, atom_indices=alpha)
        off = frames.xyz[1, alpha].astype(float) - frames.xyz[0, alpha]
        assert ours == pytest.approx(10 * np.sqrt(np.mean(np.sum(off**2, axis=1))), abs=RMSD_ANGSTROM)


@pytest.mark.parametrize("n", [1, 2, 3, 50])
def test_a_rigid_motion_has_no_rmsd_and_a_mirror_image_does(n):
    rng = np.random.default_rng(n)
    x = rng.normal(size=(n, 3))
    moved = Rotation.random(rng=rng).apply(x) + np.array([1, 2, 3])
    assert rmsd(moved, x) < 1e-14
    assert np.allclose(superpose(moved, x), x, atol=1e-13)
    if n > 3:
        assert rmsd(x * [1, 1, -1], x) > 0.1


def test_superposition_is_the_least_over_rotations():
    rng = np.random.default_rng(1)
    x, y = rng.normal(size=(2, 9, 3))
    best = rmsd(x, y)
    centred = x - x.mean(axis=0) + y.mean(axis=0)
    for turn in Rotation.random(500, rng=rng):
        tried = turn.apply(centred - y.mean(axis=0)) + y.mean(axis=0)
        assert np.sqrt(np.mean(np.sum((tried - y) ** 2, axis=1))) >= best - 1e-12
