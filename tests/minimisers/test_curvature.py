"""The metric of the near terms against second derivatives of each term, by differences of its energy."""

import numpy as np
import openmm
import pytest
from fixtures.samples import chain, energy, load
from scipy.spatial.distance import cdist

import protochain as pc
from protochain.chains.chain import pose
from protochain.energies.native.terms import compile_system
from protochain.mechanics import multibody
from protochain.minimisers import curvature
from protochain.minimisers.curvature import COUPLED, FLOOR, REACH, near_terms
from protochain.minimisers.near_kernels import STIFFEST, bends, free_pairs, turns, well_stiffness
from protochain.minimisers.problem import evaluate
from protochain.minimisers.spaces import spaces


def angle(x):
    u, v = x[0] - x[1], x[2] - x[1]
    return np.arccos(u @ v / np.linalg.norm(u) / np.linalg.norm(v))


def dihedral(x):
    a, b = np.cross(x[1] - x[0], x[2] - x[1]), np.cross(x[2] - x[1], x[3] - x[2])
    return np.arctan2(np.linalg.norm(x[2] - x[1]) * (x[1] - x[0]) @ b, a @ b)


def gradient(function, x, step=1e-5):
    found = np.empty_like(x)
    for place in np.ndindex(*x.shape):
        h = np.zeros_like(x)
        h[place] = step
        found[place] = (function(x + h) - function(x - h)) / (2 * step)
    return found


def outer_sum(n, parts):
    """Dense matrix of k g g^T, from atoms, gradients and stiffness."""
    dense = np.zeros((n, 3, n, 3))
    for atoms, g, k in parts:
        for p, i in enumerate(atoms):
            for q, j in enumerate(atoms):
                dense[i, :, j] += k * np.outer(g[p], g[q])
    return dense.reshape(3 * n, 3 * n)


def spring(n, i, j, x, along, across):
    u = (x[i] - x[j]) / np.linalg.norm(x[i] - x[j])
    block = along * np.outer(u, u) + across * (np.eye(3) - np.outer(u, u))
    dense = np.zeros((n, 3, n, 3))
    dense[i, :, i], dense[j, :, j], dense[i, :, j], dense[j, :, i] = block, block, -block, -block
    return dense.reshape(3 * n, 3 * n)


def shaken(name="ala10.pdb", seed=0, size=0.01):
    s = load(name)
    return s, s.positions + size * np.random.default_rng(seed).normal(size=s.positions.shape)


def dense_of(at, n):
    dense = np.zeros((n, 3, n, 3))
    for i in range(n):
        dense[i, :, i] = at.atom_blocks[i].reshape(3, 3)
    for (i, j), block in zip(at.pairs, at.pair_blocks.reshape(-1, 3, 3), strict=True):
        dense[i, :, j] += block
        dense[j, :, i] += block.T
    return dense.reshape(3 * n, 3 * n)


def expected_matrix(s, e, x):
    """The model term by term from the System's own parameters."""
    terms, n = e.terms, s.n_atoms
    dense = np.zeros((3 * n, 3 * n))
    for (i, j), (r0, k) in zip(terms.bonded["bonds"].atoms, terms.bonded["bonds"].parameters, strict=True):
        r = np.linalg.norm(x[i] - x[j])
        dense += spring(n, i, j, x, k, max(0.0, k * (1 - r0 / r)))
    parts = []
    for atoms, (_, k) in zip(terms.bonded["angles"].atoms, terms.bonded["angles"].parameters, strict=True):
        parts.append((atoms, gradient(angle, x[atoms]), k))
    # Cosines of one dihedral add up with the sizes of their curvatures.
    for atoms, (m, phase, k) in zip(
        terms.bonded["torsions"].atoms, terms.bonded["torsions"].parameters, strict=True
    ):
        g = gradient(dihedral, x[atoms])
        parts.append((atoms, g, abs(k * m**2 * np.cos(m * dihedral(x[atoms]) - phase))))
    dense += outer_sum(n, parts)
    exceptions = terms.nonbonded.exceptions
    for (i, j), (a, b, _) in zip(exceptions.atoms, exceptions.parameters, strict=True):
        r = np.linalg.norm(x[i] - x[j])
        dense += spring(n, i, j, x, *positive(a, b, r))
    off = {tuple(pair) for pair in exceptions.atoms.tolist()}
    blocks = np.kron(np.eye(n), np.ones((3, 3)))
    for i, j in np.argwhere(np.triu(cdist(x, x) < REACH, 1)):
        if (i, j) in off:
            continue
        types = terms.nonbonded.lj_type[i], terms.nonbonded.lj_type[j]
        along, across = positive(
            terms.nonbonded.a12[types], terms.nonbonded.b6[types], np.linalg.norm(x[i] - x[j])
        )
        one = spring(n, i, j, x, along, across)
        dense += one if along > COUPLED else one * blocks
    return dense


def positive(a, b, r):
    """Curvatures of A/r^12 - B/r^6 as differences of it: U'' and U'/r, none below 0."""
    h = 1e-5 * r

    def well(r):
        return a / r**12 - b / r**6

    return (
        max(0.0, (well(r + h) - 2 * well(r) + well(r - h)) / h**2),
        max(0.0, (well(r + h) - well(r - h)) / (2 * h * r)),
    )


def test_the_model_is_the_sum_of_its_terms_each_made_positive():
    s, x = shaken()
    e = energy("ala10.pdb")
    terms = near_terms(e)
    found = dense_of(
        curvature.curvature(terms, x, curvature.free_wells(terms, x, np.ones(s.n_atoms, bool))), s.n_atoms
    )
    expected = expected_matrix(s, e, x)
    assert np.abs(found - expected).max() < 1e-4 * np.abs(expected).max()
    # Term by term: the softest are far below that.
    assert found == pytest.approx(expected, rel=2e-3, abs=20.0)
    assert np.linalg.eigvalsh(found).min() > -1e-6 * np.abs(found).max()


def test_atoms_in_line_or_at_one_point_give_finite_blocks():
    x = np.array([[0.0, 0, 0], [0.1, 0, 0], [0.2, 0, 0], [0.3, 0, 0], [0.3, 0, 0]])
    assert np.isfinite(bends(x, np.array([[0, 1, 2], [2, 3, 4]]))).all()
    waves, first = np.array([[2.0, 0.0, 5.0]]), np.array([0, 1])
    found, stiff = turns(x, np.array([[0, 1, 2, 3]]), waves, first)
    assert np.isfinite(found).all() and stiff == pytest.approx(20.0)
    along, across = well_stiffness(x, np.array([[3, 4]]), np.array([1e-6]), np.array([1e-3]))
    assert along == STIFFEST and across == 0.0


def test_a_wave_of_no_period_is_an_improper():
    x = np.random.default_rng(0).normal(size=(4, 3))
    found = turns(
        x, np.array([[0, 1, 2, 3]]), np.array([[0.0, 0.0, 7.0], [1.0, 0.3, 0.0]]), np.array([0, 2])
    )[1]
    assert found == pytest.approx(7.0)


@pytest.mark.parametrize("spread", [1.0, 50.0])
def test_free_pairs_are_those_of_all_distances(spread):
    s, e = load("1l2y.pdb"), energy("1l2y.pdb")
    terms, x = near_terms(e), s.positions.copy()
    # An atom far away must not make the grid large.
    x[7] = spread * 100.0
    moving = np.random.default_rng(0).random(s.n_atoms) < 0.3
    near = np.triu(cdist(x, x) <= REACH, 1)
    near[tuple(np.sort(e.terms.nonbonded.exceptions.atoms, axis=1).T)] = False
    near &= moving[:, None] | moving
    found = free_pairs(x, *terms.partners, moving, REACH)
    assert {tuple(pair) for pair in found.tolist()} == {tuple(pair) for pair in np.argwhere(near).tolist()}
    assert len(found) == near.sum() > 100


def test_more_pairs_than_there_is_room_for_are_found_too():
    x = 0.01 * np.random.default_rng(0).random((60, 3))
    none = np.zeros(61, np.int64), np.empty(0, np.int64)
    assert len(free_pairs(x, *none, np.ones(60, bool), REACH)) == 60 * 59 // 2


def test_the_solver_leaves_fixed_atoms_alone_and_counts_tethers():
    s, x = shaken()
    e = energy("ala10.pdb")
    terms = near_terms(e)
    rng = np.random.default_rng(1)
    moving, tether = rng.random(s.n_atoms) < 0.6, rng.uniform(0.0, 5e3, s.n_atoms)
    at = curvature.curvature(terms, x, curvature.free_wells(terms, x, moving))
    dense = dense_of(at, s.n_atoms) + np.diag(np.repeat(FLOOR + tether, 3))
    free, torque = np.repeat(moving, 3), rng.normal(size=3 * s.n_atoms)
    step = curvature.near_solver(terms, x, moving, tether=tether)(torque)
    assert dense[np.ix_(free, free)] @ step[free] == pytest.approx(torque[free], rel=1e-8, abs=1e-9)
    assert not step[~free].any()


def test_stiffness_in_torsions_is_the_model_seen_by_them():
    c, e = chain("3i40.pdb"), energy("3i40.pdb")
    space, at = spaces(c, near_terms(e))[0], evaluate(spaces(c)[0], e, c.q0)
    posed, s = pose(c, c.q0), c.structure
    twists = multibody.jacobian(c.tree, posed.frames)[c.atom_body]
    arms = posed.x - posed.frames.origin[c.atom_body]
    moves = twists[:, 3:] + np.cross(twists[:, :3], arms[:, :, None], axis=1)
    jacobian = moves.reshape(3 * s.n_atoms, c.n_v) * space.scale
    terms = near_terms(e)
    springs = curvature.springs_of(terms, posed.x, np.ones(s.n_atoms, bool))
    matrix = curvature.TORSION_FLOOR * np.eye(c.n_v)
    lines = posed.x[springs.pairs[:, 0]] - posed.x[springs.pairs[:, 1]]
    lines /= np.linalg.norm(lines, axis=1, keepdims=True)
    parts = [(springs.pairs, np.stack([lines, -lines], axis=1), springs.stiffness)]
    for atoms, g, k in (*parts, *curvature.bonded_gradients(terms, posed.x)):
        rows = np.einsum("nka,nkav->nv", g, jacobian.reshape(-1, 3, c.n_v)[atoms])
        matrix += rows.T @ (k[:, None] * rows)
    torque = np.random.default_rng(0).normal(size=c.n_v)
    assert matrix @ space.stiffness(at)(torque) == pytest.approx(torque, rel=1e-6, abs=1e-6)
    # A disulfide resists the turns that would open it: no bond of it is left out.
    sulfur = np.isin(s.atom_name[terms.bonds.atoms], ["SG"]).all(axis=1)
    assert sulfur.sum() == 3


def test_terms_are_those_of_the_system_whatever_the_engine_and_none_of_a_callable():
    s, e = load("ala10.pdb"), energy("ala10.pdb")
    by_openmm = pc.energy(s, engine="openmm")
    one, other = near_terms(e), near_terms(by_openmm)
    assert np.array_equal(one.pairs, other.pairs) and np.array_equal(one.waves, other.waves)
    assert near_terms(e.without_constants(chain("ala10.pdb").rigid_groups, s.positions)) is one
    assert near_terms(pc.energies.as_energy(lambda x: (0.0, 0.0 * x), s)) is None
    system = by_openmm.system
    more = openmm.CustomExternalForce("x^2")
    other = openmm.XmlSerializer.deserialize(openmm.XmlSerializer.serialize(system))
    other.addForce(more)
    assert near_terms(pc.energy(s, system=other)) is None


def test_impropers_of_charmm_count_and_dihedrals_are_each_there_once():
    s = load("ala10.pdb")
    e = pc.energy(s, forcefield="charmm36", solvent="vacuum")
    terms, all_of_it = near_terms(e), compile_system(e.system)
    constant = terms.waves[terms.waves[:, 0] == 0.0]
    impropers = all_of_it.bonded["impropers"].parameters
    assert len(impropers) and sorted(constant[:, 2]) == pytest.approx(sorted(2.0 * impropers[:, 1]))
    assert (
        len(terms.waves) == len(all_of_it.bonded["torsions"].atoms) + len(impropers) == terms.first_wave[-1]
    )
    seen = [tuple(min(row, row[::-1])) for row in terms.dihedrals.tolist()]
    assert len(set(seen)) == len(seen)
