"""Overlaps parted by moves that stay local, bonds drawn out of rings, and what is said of both."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from fixtures import models
from fixtures.molecules import crowded
from fixtures.samples import chain, energy, load
from fixtures.tolerances import GEOMETRY_NM
from scipy.spatial.transform import Rotation

import protochain as pc
from protochain.chains.contacts import overlaps
from protochain.core.errors import StrayWarning
from protochain.energies.factory import bonded_part
from protochain.minimisers import RECIPES, Stop, spring_model, verdict
from protochain.minimisers.clash_resolution import all_atom_clash_stages, torsion_clash_stages
from protochain.minimisers.curvature import near_terms, springs_solver
from protochain.minimisers.metrics import Damped
from protochain.minimisers.problem import evaluate
from protochain.minimisers.restraints import Bound, ChiralityRestraint, SoftRepulsion
from protochain.minimisers.spaces import spaces
from protochain.minimisers.stages import walk
from protochain.minimisers.start_warnings import FAR, StrayWatcher, describe_start, describe_stray, is_crowded
from protochain.minimisers.unthread import Push, push_of
from protochain.structure.molecule.chirality import changed_stereocentres
from protochain.structure.superpose import rmsd_angstrom
from protochain.validation import threaded_rings

SLOPE = 1e-6
"""Relative. Central differences of harmonic terms, with a step of 1e-6 nm: round-off of some kJ/mol."""


@pytest.fixture(scope="module")
def planted():
    """A bond of an arginine through the ring of a proline."""
    (plant,) = models.planted_rings([load("1l2y.pdb")], 1, seed=3)
    return plant.structure


def slope(energy, x, along):
    step = 1e-6 * along
    return (energy(x + step)[0] - energy(x - step)[0]) / 2e-6


def moved(s, x):
    return rmsd_angstrom(x[s.alpha_carbons], s.positions[s.alpha_carbons])


def test_a_bound_holds_atoms_beyond_it_and_no_others():
    home = np.zeros((3, 3))
    x = np.array([[0.3, 0.4, 0.0], [0.0, 0.0, 0.6], [0.0, 0.9, 1.2]])
    value, forces = Bound(home, 0.6)(x)
    assert value == pytest.approx(0.5 * 1e4 * 0.9**2)
    assert forces == pytest.approx(np.array([[0, 0, 0], [0, 0, 0], [0, -0.6 * 9e3, -0.8 * 9e3]]))


def test_tethers_stiffen_torsions_and_atoms_as_their_second_derivatives():
    c = chain("ala10.pdb")
    at = spaces(c)[0].place(c.q0)
    weight = np.random.default_rng(1).uniform(1.0, 9.0, c.n_atoms)
    with_them, without = (spring_model.torsion_stiffness(c, at, tether=each) for each in (weight, None))
    jacobian = np.empty((3 * c.n_atoms, c.n_v))
    for k, unit in enumerate(np.eye(c.n_v)):
        ahead, behind = (spaces(c)[0].place(spaces(c)[0].move(c.q0, d * unit)).x for d in (1e-5, -1e-5))
        jacobian[:, k] = (ahead - behind).ravel() / 2e-5
    expected = jacobian.T @ (np.repeat(weight, 3)[:, None] * jacobian)
    assert with_them - without == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())
    x, moving = at.x, np.ones(c.n_atoms, dtype=bool)
    bonded = spring_model.covalent(c.structure)
    stiff = springs_solver(c.structure, bonded, x, moving, tether=1e9 * np.ones(c.n_atoms))
    pull = np.random.default_rng(2).normal(size=3 * c.n_atoms)
    # Against so stiff tethers all else is a thousandth.
    assert stiff(pull) == pytest.approx(pull / 1e9, rel=0.02, abs=1e-11)


def test_residues_that_pass_one_another_do_not_repel():
    s = crowded().structure
    every = SoftRepulsion(s)
    pairs = np.array([(i, j) for i in range(s.n_residues) for j in range(i + 1)])
    assert every(s.positions)[0] > 0.0
    assert SoftRepulsion(s, pairs)(s.positions)[0] == 0.0
    first = overlaps(s, s.positions)[0]
    names = [s.describe(i) for i in range(s.n_atoms)]
    i, j = (s.atom_residue[names.index(name)] for name in (first.first, first.second))
    for passing in ([[i, j]], [[j, i]]):
        less = SoftRepulsion(s, np.array(passing))
        assert 0.0 < less(s.positions)[0] < every(s.positions)[0]
        along = np.random.default_rng(0).normal(size=s.positions.shape)
        assert slope(less, s.positions, along) == pytest.approx(
            -np.sum(less(s.positions)[1] * along), rel=1e-4
        )


def test_bonds_angles_and_dihedrals_are_what_is_left_of_an_energy():
    e, x = energy("1l2y.pdb"), load("1l2y.pdb").positions
    whole, held = e.parts(x)[0], bonded_part(e)
    assert held(x)[0] == pytest.approx(
        sum(whole[kind] for kind in ("bonds", "angles", "torsions")), rel=1e-12
    )
    assert bonded_part(pc.energies.as_energy(lambda x: (0.0, 0.0 * x), load("1l2y.pdb"))) is None


def test_a_push_leads_out_of_the_ring_until_the_bond_is_out():
    x = np.zeros((8, 3))
    angle = np.arange(6) * np.pi / 3
    x[:6] = 0.14 * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(6)])
    x[6:] = [[0.0, 0.0, 0.07], [0.02, 0.0, -0.07]]
    push = Push(np.arange(6), np.array([6, 7]), np.array([0.0, 1.0, 0.0]))
    value, forces = push(x)
    assert value == pytest.approx(0.5 * 2e4 * 0.35**2) and forces.sum(axis=0) == pytest.approx(np.zeros(3))
    along = np.random.default_rng(0).normal(size=x.shape)
    assert slope(push, x, along) == pytest.approx(-np.sum(forces * along), rel=SLOPE)
    assert (forces[6:, 1] > 0).all() and (forces[:6, 1] < 0).all() and not forces[:, [0, 2]].any()
    x[6:, 1] += 0.36
    value, forces = push(x)
    assert value == 0.0 and not forces.any()


def test_each_side_of_a_ring_has_its_turn_those_at_its_own_bonds_last(planted):
    ring = threaded_rings(planted)[0]
    pushes = [push_of(planted, planted.positions, ring, k) for k in range(len(ring.atoms))]
    corners = planted.positions[list(ring.atoms)] - planted.positions[list(ring.atoms)].mean(axis=0)
    tops = [np.sort(np.argsort(-corners @ push.way)[:2]).tolist() for push in pushes]
    assert len({tuple(top) for top in tops}) == len(ring.atoms) == 5
    # The first side is not that of N and CA, where the backbone goes on.
    names = [{str(planted.atom_name[ring.atoms[k]]) for k in top} for top in tops]
    assert names[-1] == {"N", "CA"} and not names[0] & {"N", "CA"}
    again = push_of(planted, planted.positions, ring, len(ring.atoms))
    assert np.array_equal(again.way, pushes[0].way)
    # The same wherever the whole is; where others crowd the first side, it is the last.
    turn = Rotation.from_rotvec([0.4, 1.0, -0.3]).as_matrix()
    full, x = planted.positions.copy(), planted.positions @ turn.T + [3.0, -2.0, 1.0]
    others = np.flatnonzero(~np.isin(planted.atom_residue, planted.atom_residue[[*ring.atoms, *ring.bond]]))
    full[others[:20]] = full[list(ring.atoms)].mean(axis=0) + 0.35 * pushes[0].way
    for k, push in enumerate(pushes):
        assert push_of(planted, x, ring, k).way == pytest.approx(turn @ push.way, abs=1e-9)
    assert np.array_equal(push_of(planted, full, ring, 4).way, pushes[0].way)


def test_a_threaded_ring_is_freed_and_the_fold_kept(planted):
    c, e = pc.build_chain(planted), energy("1l2y.pdb")
    torsions, atoms = spaces(c)
    told = []
    done = walk(
        all_atom_clash_stages(torsions, atoms, e, 10.0, None, True), planted.positions, 2000, None,
        lambda at, stage, n: told.append(stage.name),
    )  # fmt: skip
    assert threaded_rings(planted) and not threaded_rings(planted, done.x)
    assert list(dict.fromkeys(told)) == ["freeing threaded rings", "resolving clashes", "held by springs"]
    assert not overlaps(planted, done.x) and not changed_stereocentres(planted, done.x, planted.positions)
    assert moved(planted, done.x) < 0.5
    lengths = [
        np.linalg.norm(np.diff(x[planted.bonds], axis=1), axis=2)
        for x in (done.x, load("1l2y.pdb").positions)
    ]
    assert np.abs(lengths[0] - lengths[1]).max() < 0.01


@pytest.mark.parametrize("method", ["cartesian", "lbfgs"])
def test_overlaps_are_parted_near_the_start(method):
    s = models.with_random_side_chains(load("1vii.pdb"), 4, chis=1)
    assert len(overlaps(s, s.positions)) > 10
    c, e = pc.build_chain(s), energy("1vii.pdb")
    torsions, atoms = spaces(c)
    if method == "lbfgs":
        plan, limit = torsion_clash_stages(torsions, e, 10.0, None, True), 1.0
    else:
        # Before the restraints of side chains are removed.
        plan, limit = all_atom_clash_stages(torsions, atoms, e, 10.0, None, True)[:-2], 0.6
    done = walk(plan, c.structure.positions, 3000, None, lambda *_: None)
    assert not overlaps(s, done.x) and moved(s, done.x) < limit
    lengths = [np.linalg.norm(np.diff(x[s.bonds], axis=1), axis=2) for x in (done.x, s.positions)]
    assert (np.abs(lengths[0] - lengths[1]).max() < GEOMETRY_NM) == (method == "lbfgs")


def test_a_run_from_overlaps_goes_on_from_any_stage_as_if_it_had_never_stopped(tmp_path):
    c, e = crowded(), energy("1l2y.pdb")
    seen = {}

    class Watch:
        def at_stage(self, name, evaluations):
            seen.setdefault(name, evaluations)

        def __call__(self, row, x):
            pass

    whole = pc.minimise(c, e, "hybrid", tolerance=1.0, watch=Watch())
    budgets = [n + 2 for n in seen.values() if n + 2 < whole.n_evaluations]
    assert len(budgets) >= 3
    for budget in budgets[::2]:
        kept = tmp_path / f"{budget}.npz"
        part = pc.minimise(c, e, "hybrid", tolerance=1.0, max_evaluations=budget, checkpoint=kept)
        assert part.n_evaluations == budget
        rest = pc.minimise(c, e, "hybrid", tolerance=1.0, resume=kept)
        assert rest.n_evaluations == whole.n_evaluations and np.array_equal(rest.x, whole.x)


def test_straying_is_told_once_and_at_once():
    s, told = load("1l2y.pdb"), []
    look = StrayWatcher(s, told.append)
    middle = s.positions[s.alpha_carbons].mean(axis=0)
    size = 10.0 * np.sqrt(np.mean(np.sum((s.positions[s.alpha_carbons] - middle) ** 2, axis=1)))
    for share in (0.0, 0.95, 1.05, 1.5):
        x = middle + (1.0 + share * FAR / size) * (s.positions - middle)
        look(x)
        assert len(told) == (share > 1.0) == bool(describe_stray(s, x))
    assert told == ["2.1 angstrom from a start whose atoms overlapped; relax preserves the fold"]


def stretched(at):
    """Energy whose minimum is at twice the size of a structure."""
    home = 2.0 * (at - at.mean(axis=0))
    return lambda x: (0.5 * np.sum((x - x.mean(axis=0) - home) ** 2), -(x - x.mean(axis=0) - home))


def test_a_watcher_or_a_warning_says_that_a_run_strays_and_the_message_too():
    c, told = crowded(), []
    pull = stretched(c.structure.positions)

    class Watch:
        at_warning = staticmethod(told.append)

        def __call__(self, row, x):
            pass

    r = pc.minimise(c, pull, "cartesian", tolerance=0.01, watch=Watch())
    assert len(told) == 1 and f"; {r.ca_rmsd_angstrom:.1f} angstrom" in r.message
    with pytest.warns(StrayWarning, match="angstrom from a start whose atoms overlapped"):
        pc.minimise(c, pull, "cartesian", tolerance=0.01)
    calm = chain("1l2y.pdb")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        r = pc.minimise(calm, stretched(calm.structure.positions), "cartesian", tolerance=0.01)
    # Nothing is said on the way, but the end says so, whatever the start.
    assert r.ca_rmsd_angstrom > FAR and r.ended in r.message and "start" not in r.ended
    assert f"; {r.ca_rmsd_angstrom:.1f} angstrom from its start" in r.message
    near = pc.minimise(calm, stretched(calm.structure.positions), "cartesian", max_evaluations=1)
    assert near.message == near.ended


def test_what_is_wrong_with_a_start_is_said_before(planted):
    assert describe_start(load("1l2y.pdb"), RECIPES["hybrid"]) == [] and not is_crowded(load("1l2y.pdb"))
    assert is_crowded(planted)
    first, *rings, last = describe_start(planted, RECIPES["hybrid"])
    assert first.startswith(
        f"{len(overlaps(planted, planted.positions))} pairs of atoms overlap; violations in "
    )
    assert rings == [str(ring) for ring in threaded_rings(planted)]
    assert last.startswith("hybrid: ")


def test_the_metric_is_damped_in_proportion_to_the_rms_force():
    c, e = chain("1l2y.pdb"), energy("1l2y.pdb")
    space = spaces(c, near_terms(e))[1]
    at = evaluate(space, e, space.start(c.structure.positions))
    pull = np.random.default_rng(0).normal(size=at.torque.shape)
    damped, plain = Damped(damping=300.0).at(space, at), space.stiffness(at)
    step = damped(pull)
    # (P + d) s = f and P t = f - d s: one solution by the other metric.
    assert plain(pull - 300.0 * at.residual * step) == pytest.approx(step, rel=1e-6, abs=1e-12)
    calm = replace(at, residual=0.0)
    assert np.array_equal(Damped().at(space, calm)(pull), plain(pull))


@pytest.mark.parametrize("met", [True, False])
def test_a_ring_left_threaded_is_a_clash(planted, met, monkeypatch):
    (ring, *_), s = threaded_rings(planted), load("1l2y.pdb")
    monkeypatch.setattr(verdict, "threaded_rings", lambda structure, x: [ring])
    status, message = verdict.verdict(Stop.TOLERANCE, met, "so far", s, s.positions, 5)
    assert status == "clash" and str(ring) in message
    assert verdict.verdict(Stop.INTERRUPTED, met, "so far", s, s.positions, 5)[0] == "interrupted"


def interpenetrating(path, shift):
    """Two copies of the Trp-cage, the second one shifted into the first by so many nm."""
    pc.save(load("1l2y.pdb"), path)
    atoms = [line for line in path.read_text().splitlines(keepends=True) if line.startswith("ATOM")]
    far = [f"{line[:21]}B{line[22:30]}{float(line[30:38]) + 100.0:8.3f}{line[38:]}" for line in atoms]
    path.write_text("".join([*atoms, "TER\n", *far, "TER\n", "END\n"]))
    s = pc.load(path)
    second = (s.residue_chain[s.atom_residue] == "B")[:, None]
    return s.with_positions(s.positions + np.where(second, np.array(shift) - [10.0, 0.0, 0.0], 0.0))


@pytest.mark.filterwarnings("ignore::protochain.core.errors.StrayWarning")
@pytest.mark.parametrize(
    "shift",
    [
        (0.1, 0.0, 0.0),
        *(pytest.param(at, marks=pytest.mark.slow) for at in ((0.05, 0.05, 0.05), (0.02, 0.01, 0.03))),
    ],
)
def test_a_clash_resolution_inverts_no_stereocentre(shift, tmp_path):
    s = interpenetrating(tmp_path / "two.pdb", shift)
    assert len(overlaps(s, s.positions)) > 100
    r = pc.minimise(s, max_evaluations=2000)
    assert not changed_stereocentres(s, r.x, s.positions) and r.status != "inverted"


def test_only_right_stereocentres_are_preserved():
    s = models.shaken(load("1ubq.pdb"), 0.25, seed=1)
    every, right = ChiralityRestraint.of(s), ChiralityRestraint.preserving(s)
    wrong = every.inversions(s.positions)
    assert len(wrong) and not len(right.inversions(s.positions))
    assert {*right.atoms[:, 0]} == {*every.atoms[:, 0]} - {*wrong.tolist()}
