"""Spaces and their springs on a few atoms, by hand; what warming up does."""

from types import SimpleNamespace

import numpy as np
import pytest
from fixtures.samples import chain, load

import protochain as pc
from protochain.chains.chain import pose, pull_back
from protochain.mechanics import multibody
from protochain.minimisers import RECIPES, spring_model
from protochain.minimisers.annealing import Annealing
from protochain.minimisers.curvature import springs_solver
from protochain.minimisers.problem import evaluate
from protochain.minimisers.recipes import Recipe, Run
from protochain.minimisers.spaces import ROOT_LEVER, Cartesian, Positions, Torsions, spaces
from protochain.minimisers.spring_model import Springs, _directions
from protochain.minimisers.start import Start


def test_steps_residuals_and_units_of_both_spaces():
    c = chain("ala10.pdb")
    torsions, atoms = spaces(c)
    assert (torsions.longest, torsions.first, atoms.longest, atoms.first) == (0.5, 0.01, 0.03, 0.005)
    assert torsions.unit.format(12.34567) == "largest torque 12.35 kJ/mol/rad"
    assert atoms.unit.format(12.34567) == "RMS force 12.35 kJ/mol/nm"
    assert torsions.residual(np.array([1.0, -7.0, 3.0])) == 7.0
    assert torsions.sizes(np.array([1.0, -7.0, 0.0, 2.0])) == {
        "rms_torque_kj_mol_rad": np.sqrt(13.5), "max_torque_kj_mol_rad": 7.0,
    }  # fmt: skip
    assert torsions.chain is c and atoms.structure is c.structure and atoms.moving is c.moving
    assert spaces(c)[0] is torsions


def test_a_chain_starts_at_its_own_positions_only():
    c = chain("ala10.pdb")
    assert Torsions(c).start(c.structure.positions.copy()) is c.q0
    with pytest.raises(ValueError, match="a chain starts at its own positions"):
        Torsions(c).start(c.structure.positions + 1e-9)


def test_a_free_root_moves_by_a_tenth_of_a_nanometre_for_each_unit():
    c = pc.build_chain(load("3i40.pdb"), root="free")
    space = Torsions(c)
    expected = np.ones(c.n_v)
    roots = [b for b in range(c.n_bodies) if c.tree.parent[b] < 0]
    for b in roots:
        expected[c.tree.v_start[b] + 3 : c.tree.v_start[b] + 6] = 0.1
    assert ROOT_LEVER == 0.1 and len(roots) == 2 and space.scale.tolist() == expected.tolist()
    at, forces = pose(c, c.q0), np.random.default_rng(0).normal(size=c.structure.positions.shape)
    assert space.torque(at, forces) == pytest.approx(expected * pull_back(c, at, forces), rel=1e-12)
    step = 0.01 * np.random.default_rng(1).normal(size=c.n_v)
    assert np.array_equal(space.move(c.q0, step), multibody.integrate(c.tree, c.q0, expected * step))
    assert np.array_equal(space.place(c.q0).x, at.x)


def test_free_atoms_are_their_positions():
    s = load("ala10.pdb")
    moving = np.zeros(s.n_atoms, dtype=bool)
    moving[[1, 4]] = True
    space = Cartesian(s, moving)
    q = space.start(s.positions)
    assert q.shape == (3 * s.n_atoms,) and np.array_equal(space.place(q).x, s.positions)
    found = space.torque(Positions(q), np.full((s.n_atoms, 3), 2.0))
    torque = space.outward(s.positions, found).reshape(-1, 3)
    assert torque[[1, 4]] == pytest.approx(2.0, rel=1e-15) and not np.delete(torque, [1, 4], axis=0).any()
    # Over six components; none is no division by zero, and too many to square are infinite.
    assert space.residual(found) == pytest.approx(2.0, rel=1e-15)
    assert space.sizes(np.where(torque > 0.0, np.array([3.0, 6.0, 6.0]), 0.0).ravel()) == {
        "rms_force_kj_mol_nm": np.sqrt(27.0), "max_force_kj_mol_nm": 9.0,
    }  # fmt: skip
    assert Cartesian(s, np.zeros_like(moving)).residual(np.zeros(3)) == 0.0
    with np.errstate(over="raise"):
        assert space.residual(np.full(3, 1e200)) == np.inf
        assert space.sizes(np.full(3 * s.n_atoms, 1e200))["max_force_kj_mol_nm"] == np.inf
        assert Torsions(chain("ala10.pdb")).sizes(np.full(3, 1e200))["rms_torque_kj_mol_rad"] == np.inf
    push = space.inertia(None)(np.ones(3 * s.n_atoms)).reshape(-1, 3)
    assert push == pytest.approx(1.0 / np.repeat(s.atom_mass, 3).reshape(-1, 3))


def test_springs_have_the_stiffness_of_their_bonds_and_distance():
    constants = (
        spring_model.DEPTH, spring_model.DECAY, spring_model.REACH, spring_model.TORSION_FLOOR,
        spring_model.CARTESIAN_FLOOR,
    )  # fmt: skip
    assert constants == (0.4, 14.0, 1.3, 150.0, 8.0e3)
    assert (spring_model.BOND, spring_model.ANGLE, spring_model.DIHEDRAL) == (2.5e5, 4.0e4, 2.0e3)
    s = load("ala10.pdb")
    x = 9.0 * np.arange(s.n_atoms)[:, None] * np.array([1.0, 0.0, 0.0])
    first, other = np.flatnonzero(s.atom_element == "C")[[0, -1]]
    # Carbon atoms touch at 0.34 nm; springs reach 1.3 times as far.
    for share, n in ((0.5, 1), (1.0, 1), (1.25, 1), (1.29, 1), (1.31, 0)):
        x[other] = x[first] + [0.0, 0.34 * share, 0.0]
        found = spring_model.contacts(s, x, 3)
        assert found.pairs.tolist() == [[first, other]] * n
        expected = 72.0 * 0.4 / 0.34**2 * np.exp(-14.0 * (share - 1.0))
        assert found.stiffness.tolist() == [pytest.approx(expected, rel=1e-9)] * n
    joined = spring_model.covalent(s)
    stiffness = {tuple(pair): k for pair, k in zip(joined.pairs.tolist(), joined.stiffness, strict=True)}
    place = {name: int(np.flatnonzero((s.atom_name == name) & (s.atom_residue == 4))[0]) for name in
             ("N", "CA", "C", "O", "CB")}  # fmt: skip

    def between(a, b):
        return stiffness.get(tuple(sorted((place[a], place[b]))))

    assert (between("N", "CA"), between("N", "C"), between("N", "O")) == (2.5e5, 4.0e4, 2.0e3)
    assert (between("CB", "CA"), between("CB", "C"), between("CB", "O")) == (2.5e5, 4.0e4, 2.0e3)
    assert (first, other) not in stiffness


def test_contacts_leave_out_pairs_a_few_bonds_apart():
    s = load("ala10.pdb")
    x = s.positions
    pairs = [
        {tuple(pair) for pair in spring_model.contacts(s, x, bonds).pairs.tolist()} for bonds in (1, 2, 3)
    ]
    assert pairs[0] > pairs[1] > pairs[2]


def test_the_solver_of_springs_is_that_of_their_stiffness():
    x = np.array([[0.0, 0.0, 0.0], [3.0, 4.0, 0.0], [0.0, 0.0, 2.0], [0.0, 0.0, 2.0]])
    both = Springs(np.array([[0, 1], [0, 2], [2, 3]]), np.array([100.0, 10.0, 7.0]))
    none, pull = Springs(np.empty((0, 2), np.int64), np.empty(0)), np.random.default_rng(0).normal(size=12)
    along = np.array([0.6, 0.8, 0.0])
    one, two = 100.0 * np.outer(along, along), 10.0 * np.diag([0.0, 0.0, 1.0])
    for coupled in (True, False):
        expected = np.zeros((12, 12))
        for i, j, block in ((0, 1, one), (0, 2, two)):
            for a, b, sign in ((i, i, 1), (j, j, 1), (i, j, -coupled), (j, i, -coupled)):
                expected[3 * a : 3 * a + 3, 3 * b : 3 * b + 3] += sign * block
        bonded, near = (both, none) if coupled else (none, both)
        solve = springs_solver(None, bonded, x, np.ones(4, dtype=bool), lambda *_, near=near: near, floor=1.0)
        assert solve(pull) == pytest.approx(np.linalg.solve(expected + np.eye(12), pull), abs=1e-12)
    # From the second atom to the first; atoms at one point have no direction.
    assert _directions(x, both.pairs).tolist() == [[-0.6, -0.8, 0.0], [0.0, 0.0, -1.0], [0.0, 0.0, 0.0]]


def test_the_solver_of_free_atoms_moves_those_only():
    s = load("ala10.pdb")
    moving = np.zeros(s.n_atoms, dtype=bool)
    moving[2] = True
    x = 9.0 * np.arange(s.n_atoms)[:, None] * np.array([1.0, 0.0, 0.0])
    solve = springs_solver(s, Springs(np.array([[1, 2]]), np.array([2000.0])), x, moving)
    step = solve(np.full(3 * s.n_atoms, 1e4)).reshape(-1, 3)
    assert step[2] == pytest.approx([1.0, 1.25, 1.25]) and not np.delete(step, 2, axis=0).any()


class Noted:
    """An energy that notes where it is asked."""

    def __init__(self, name, log):
        self.name, self.log, self.engine, self.exact, self.lists_at = name, log, "native", self, None
        self.device = "cpu"

    def __call__(self, x):
        self.log.append(self.name)
        return 0.0, np.zeros_like(x)

    def list_at(self, x):
        self.log.append(f"lists of {self.name}")

    def without_constants(self, groups, x):
        self.log.append("reduce")
        return Noted("reduced", self.log)


JUDGED = ("lists of whole", "whole")
"""In torsions: where all atoms move, the run itself evaluates its start."""


@pytest.mark.parametrize(
    ("method", "done"),
    [
        ("lbfgs", [*JUDGED, "reduce", "reduced", "reduced"]),
        ("cartesian", ["whole"]),
        ("hybrid", [*JUDGED, "reduce", "reduced", "reduced", "whole"]),
        ("openmm", ["whole"]),
        ("md", [*JUDGED, "reduce", "reduced", "reduced", "reduced"]),
    ],
)
def test_what_a_method_needs_is_warmed_up_once(method, done):
    log = []
    start = Start(chain("ala10.pdb"), Noted("whole", log))
    start.warm(RECIPES[method])
    assert log == ["lists of whole", *done]
    log.clear()
    start.warm(RECIPES[method])
    assert log == ["lists of whole", *(["reduced"] if method == "md" else [])]


def test_a_method_that_warms_itself_is_given_a_problem_with_one_evaluation():
    given = []
    warming = SimpleNamespace(init=1, step=1, warm=lambda problem, at: given.append((problem, at)))
    c, log = chain("ala10.pdb"), []
    start = Start(c, Noted("whole", log))
    start.warm(Recipe("own", (Run(warming), Run(Annealing()))))
    ((problem, at),) = given
    assert (
        problem.space is spaces(c)[0]
        and problem.energy is start.reduced_energy
        and problem.max_evaluations == 1
    )
    assert np.array_equal(at.q, evaluate(problem.space, start.reduced_energy, c.q0).q)
