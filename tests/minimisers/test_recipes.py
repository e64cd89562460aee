"""Methods by name: what each runs, in which space, on which energy."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from fixtures.molecules import crowded
from fixtures.samples import chain, energy

import protochain as pc
from protochain.minimisers import METHODS, RECIPES, Recipe, Run, recipe_of
from protochain.minimisers.annealing import Annealing, AnnealingState
from protochain.minimisers.clash_resolution import BACKBONE_TETHER, run_if_unstrained
from protochain.minimisers.curvature import near_terms
from protochain.minimisers.descent import Descent, DescentState
from protochain.minimisers.fire import Fire, FireState
from protochain.minimisers.kcm import KCM
from protochain.minimisers.lbfgs import LBFGS
from protochain.minimisers.loop import Stop
from protochain.minimisers.metrics import Damped, Mass, Stiffness
from protochain.minimisers.newton import PseudoTransient, PseudoTransientState
from protochain.minimisers.restraints import (
    SOFT_TETHER,
    Bound,
    ChiralityRestraint,
    Hold,
    SoftRepulsion,
    Tethers,
)
from protochain.minimisers.spaces import spaces
from protochain.minimisers.stages import PATIENCE, Stage, last, lowest
from protochain.minimisers.steps import Fixed, StrongWolfe

NEAR = Descent(LBFGS(Stiffness(5), 5), StrongWolfe())
BY_LBFGS = Run(NEAR, by_springs=Descent(LBFGS(Stiffness(20), 100), StrongWolfe()))
ALL_ATOMS = Run(NEAR, in_torsions=False, by_springs=Descent(LBFGS(Stiffness(40), 100), StrongWolfe()))
NEARBY = replace(ALL_ATOMS, method=Descent(LBFGS(Damped(5, 300.0), 5), StrongWolfe()))
"""The default: what all atoms do, damped in proportion to the RMS force."""


def test_lbfgs_is_fitted_to_the_near_terms_and_without_them_to_springs():
    c, e = chain("ala10.pdb"), energy("ala10.pdb")
    for name, runs in (("lbfgs", [BY_LBFGS]), ("hybrid", [BY_LBFGS, ALL_ATOMS])):
        known = RECIPES[name].plan(c, e, e, 2.0, Hold(), 0)
        assert [stage.method for stage in known] == [run.method for run in runs]
        assert [stage.space.terms for stage in known] == [near_terms(e)] * len(runs)
        assert [stage.method for stage in plan_of(RECIPES[name], c)] == [run.by_springs for run in runs]


def test_a_recipe_says_what_moves_and_which_states_it_has():
    turned, moved = Run(Fire()), Run(Fire(), in_torsions=False)
    for runs, keeps, turns in (
        ((turned,), True, True), ((moved,), False, False), ((turned, moved), False, True), ((), True, False),
    ):  # fmt: skip
        recipe = Recipe("own", runs)
        assert (recipe.keeps_geometry, recipe.in_torsions) == (keeps, turns)
        assert not Recipe("own", runs, by_openmm=True).keeps_geometry
    states = (AnnealingState, FireState, DescentState, PseudoTransientState)
    all_of_them = (Annealing(), Fire(), BY_LBFGS.method, PseudoTransient())
    assert Recipe("own", tuple(map(Run, all_of_them))).states == states
    assert Recipe("own", (Run(Fire()), Run(object()))).states == () == RECIPES["openmm"].states


@pytest.mark.parametrize(
    ("engine", "threads", "by_openmm", "in_order"),
    [
        ("native", 1, False, True), ("native", 2, False, True), ("native", 1, True, True),
        ("native", 2, True, False), ("openmm", 1, False, True), ("openmm", 2, False, False),
    ],
)  # fmt: skip
def test_runs_repeat_exactly_where_sums_are_in_order_and_nothing_is_drawn(
    engine, threads, by_openmm, in_order
):
    energy = SimpleNamespace(engine=engine, threads=threads, device="cpu")
    assert Recipe("own", by_openmm=by_openmm).repeats_exactly(energy) is in_order
    assert Recipe("own", by_openmm=by_openmm, draws_random=True).repeats_exactly(energy) is False


def test_openmms_methods_need_a_system():
    without = SimpleNamespace(system=None, atoms=None)
    with pytest.raises(pc.ProtochainError, match="requires an OpenMM System"):
        RECIPES["openmm"].check(without)
    RECIPES["openmm"].check(SimpleNamespace(system="some", atoms=None))
    RECIPES["lbfgs"].check(without)


def plan_of(recipe, c, hold=None, tolerance=2.0, seed=7, exact=True):
    whole, reduced = (SimpleNamespace(is_exact=exact, name=name, exact=name) for name in ("whole", "reduced"))
    return recipe.plan(c, whole, reduced, tolerance, hold or Hold(), seed)


def test_a_plan_is_of_the_recipes_runs_in_their_spaces_on_their_energies():
    c = chain("ala10.pdb")
    torsions, atoms = spaces(c)
    first, second = plan_of(RECIPES["hybrid"], c)
    assert (first.space, first.energy.name, first.tolerance) == (torsions, "reduced", 300.0)
    assert (second.space, second.energy.name, second.tolerance) == (atoms, "whole", 2.0)
    assert (first.method, second.method) == (BY_LBFGS.by_springs, ALL_ATOMS.by_springs)
    assert (first.name, second.name) == ("torsions", "all atoms")
    for stage in (first, second):
        assert stage.restraint is None and stage.recorded and stage.after == ()
        assert (stage.patience, stage.answer) == (PATIENCE, lowest)
    moved, quenched = plan_of(RECIPES["anneal"], c)
    assert (moved.tolerance, moved.patience, moved.answer) == (0.0, 2000, last)
    # The seed is that of the run.
    assert moved.method == Annealing(600.0, 2000, seed=7) and quenched.tolerance == 2.0


def test_single_precision_goes_on_in_double_where_the_recipe_says_so():
    c = chain("ala10.pdb")
    stages = plan_of(RECIPES["anneal"], c, exact=False)
    assert [getattr(stage.energy, "name", stage.energy) for stage in stages] == ["reduced"] * 3
    ends = (Stop.TOLERANCE, Stop.NO_DESCENT, Stop.NON_FINITE)
    assert [stage.after for stage in stages] == [(), (), ends] and stages[2].energy == "reduced"
    assert stages[2].method == BY_LBFGS.by_springs and stages[2].tolerance == 2.0


def test_the_last_run_is_repeated_for_each_restraint():
    c = chain("ala10.pdb")
    hold = Hold((100.0, 10.0, 0.0))
    stages = plan_of(RECIPES["hybrid"], c, hold)
    weights = [stage.restraint and stage.restraint.parts[0].weight.max() for stage in stages]
    assert weights == [100.0, 100.0, 10.0, None]
    assert [stage.space for stage in stages] == [spaces(c)[0], *[spaces(c)[1]] * 3]


def test_the_springs_of_a_restraint_are_in_the_metric():
    c, e = chain("ala10.pdb"), energy("ala10.pdb")
    for name in ("cartesian", "hybrid", "newton", "kcm-stiffness"):
        *_, last_held, free = RECIPES[name].plan(c, e, e, 2.0, Hold((100.0, 0.0), term=term), 0)
        metric = last_held.method.direction.metric
        assert (
            np.array_equal(metric.tether, last_held.restraint.parts[0].weight)
            and metric.tether.max() == 100.0
        )
        assert not metric.is_soft and metric.refresh_every == free.method.direction.metric.refresh_every
        assert isinstance(free.method.direction.metric, Stiffness)
    # The mass is no model of the energy.
    kept = RECIPES["kcm-metric"].plan(c, e, e, 2.0, Hold((100.0,)), 0)[-1]
    assert kept.method.direction.metric == Mass()


def test_overlaps_are_parted_in_torsions_and_springs_released_one_after_the_other():
    c = crowded()
    s, (torsions, _) = c.structure, spaces(c)
    soft, *held, free = plan_of(RECIPES["lbfgs"], c)
    assert [stage.name for stage in (soft, free)] == ["resolving clashes", "torsions"]
    assert [stage.name for stage in held] == ["held by springs"] * 3
    assert all(stage.space is torsions for stage in (soft, *held, free))
    assert not soft.recorded and all(stage.recorded for stage in (*held, free))
    assert {stage.energy.name for stage in (*held, free)} == {
        "reduced"
    } and free.method == BY_LBFGS.by_springs
    repulsion, tethers, bound, _ = soft.energy.parts
    kinds = [SoftRepulsion, Tethers, Bound, ChiralityRestraint]
    assert [type(part) for part in soft.energy.parts] == kinds
    assert repulsion.structure is s and not len(repulsion.passing)
    backbone = np.isin(s.atom_name, ["N", "CA", "C", "O"])
    assert set(tethers.weight[backbone]) == {BACKBONE_TETHER} and set(tethers.weight[~backbone]) == {
        SOFT_TETHER
    }
    assert np.array_equal(tethers.home, s.positions) and np.array_equal(bound.home, s.positions)
    # Springs to where the stage before ended, beside the restraint that the user gives.
    x = s.positions + 0.1
    assert [stage.fit(stage, x).restraint.parts[0].weight.max() for stage in held] == [4184.0, 400.0, 40.0]
    user = plan_of(RECIPES["lbfgs"], c, Hold(term=term))[1]
    springs, chirality, own = user.fit(user, x).restraint.parts
    assert isinstance(chirality, ChiralityRestraint)
    assert np.array_equal(springs.home, x) and [part.args for part in own.parts] == [(term,)]
    assert not springs.weight[s.atom_element == "H"].any()
    assert len(plan_of(RECIPES["kcm"], c)) == 1 and len(plan_of(RECIPES["lbfgs"], chain("1l2y.pdb"))) == 1


def term(x):
    return 0.0, np.zeros_like(x)


def test_methods_that_may_move_all_atoms_part_overlaps_with_all_atoms():
    c, e = crowded(), energy("1l2y.pdb")
    torsions, atoms = spaces(c, near_terms(e))
    soft, held, *settled, turned, free = RECIPES["hybrid"].plan(c, e, e, 5.0, Hold(), 0)
    assert [stage.space for stage in (soft, held, turned, free)] == [atoms, atoms, torsions, atoms]
    # Side chains settle while springs hold the backbone.
    backbone = np.isin(c.structure.atom_name, ["N", "CA", "C", "O"])
    weights = [stage.fit(stage, c.structure.positions).restraint.parts[0].weight for stage in settled]
    assert [set(weight[backbone]) for weight in weights] == [{1000.0}, {100.0}]
    assert not any(weight[~backbone].any() for weight in weights)
    assert [stage.tolerance for stage in settled] == [5.0, 5.0]
    assert soft.energy.parts[0].forcefield == "amber14" and held.energy is e and held.tolerance == 10.0
    bonded = soft.energy.parts[0].parts(c.structure.positions)[0]
    assert bonded["nonbonded"] == 0.0 and bonded["bonds"] == e.parts(c.structure.positions)[0]["bonds"]
    # Torsions go on from a chain rebuilt where the atoms are, if anything overlaps not at all.
    x = held.space.structure.positions + 0.001 * np.arange(3)
    fitted = turned.fit(turned, x)
    assert np.array_equal(fitted.space.chain.structure.positions, x) and fitted.energy.left_out
    assert not turned.ready(turned, atoms.place(atoms.start(c.structure.positions)))
    # A callable has no bonds to hold the molecule together: torsions part the atoms.
    own = pc.energies.as_energy(lambda x: (0.0, 0.0 * x), c.structure)
    assert RECIPES["hybrid"].plan(c, own, own, 2.0, Hold(), 0)[0].space is spaces(c)[0]


def test_all_atoms_are_parted_near_their_start_and_then_all_go():
    c, e = crowded(), energy("1l2y.pdb")
    atoms = spaces(c, near_terms(e))[1]
    *parting, free = RECIPES["cartesian"].plan(c, e, e, 5.0, Hold(), 0)
    names = [stage.name for stage in parting]
    assert names == ["resolving clashes", *["held by springs"] * 3] and free.name == "all atoms"
    assert all(stage.space is atoms for stage in (*parting, free)) and free.tolerance == 5.0
    # Without overlaps all atoms go at once, however large the torques: they have no levers.
    for torque in (0.0, 1e9, np.inf):
        (only,) = RECIPES["cartesian"].plan(chain("1l2y.pdb"), e, e, 5.0, Hold(), 0, torque)
        assert only.name == "all atoms" and only.method == NEARBY.method


@pytest.mark.parametrize(("torque", "parts"), [(9e4, False), (2e5, True), (np.nan, True), (np.inf, True)])
def test_strain_without_overlaps_is_held_too(torque, parts):
    c = chain("1l2y.pdb")
    whole = SimpleNamespace(is_exact=True, name="whole", system=None)
    for name, stages in (("hybrid", 2), ("lbfgs", 1)):
        plan = RECIPES[name].plan(c, whole, whole, 2.0, Hold(), 0, torque)
        assert (plan[0].name == "held by springs") is parts
        assert len(plan) == stages + parts * 3
    assert len(RECIPES["kcm"].plan(c, whole, whole, 2.0, Hold(), 0, torque)) == 1


@pytest.mark.parametrize(("share", "runs"), [(0.9, True), (1.1, False)])
def test_torsions_take_over_once_the_largest_torque_is_ordinary(share, runs):
    """That of the stage; after one in all atoms a tenth as large, of the whole energy where the atoms are."""
    c = chain("ala10.pdb")
    pull = np.random.default_rng(0).normal(size=c.structure.positions.shape)
    stage = Stage(spaces(c)[0], None, None, 1.0)
    moved = c.structure.with_positions(c.structure.positions * [1.0, 1.02, 0.98])
    for structure, energy_of, limit in (
        (c.structure, lambda pulled: (replace(stage, energy=pulled),), 1e4),
        (moved, lambda pulled: (stage, pulled), 1e3),
    ):
        space = spaces(pc.build_chain(structure))[0]
        at = space.place(space.start(structure.positions))
        size = space.residual(space.torque(at, pull))
        held = run_if_unstrained(*energy_of(lambda x, by=limit * share / size: (0.0, by * pull)))
        assert held.ready(held, at) is runs
    crowd = spaces(crowded())[0]
    calm = run_if_unstrained(Stage(crowd, None, lambda x: (0.0, 0.0 * x), 1.0))
    assert not calm.ready(calm, crowd.place(crowd.chain.q0))


@dataclass(frozen=True)
class Own:
    """A random method of somebody's own."""

    seed: int = 0

    def init(self, problem, at):
        """Nothing."""

    def step(self, problem, state):
        """Nothing."""


def test_a_method_is_found_by_name_by_import_or_as_it_is():
    assert recipe_of("kcm") is RECIPES["kcm"] is recipe_of(RECIPES["kcm"])
    assert recipe_of(Own(3)) == Recipe("Own", (Run(Own(3)),), draws_random=True)
    assert recipe_of(Fire(fade=0.5)) == Recipe("Fire", (Run(Fire(fade=0.5)),))
    named = recipe_of(Descent(KCM(), Fixed(0.1)))
    assert named == Recipe("KCM", (Run(Descent(KCM(), Fixed(0.1))),))
    assert recipe_of("protochain.minimisers:Fire") == Recipe("Fire", (Run(Fire()),))
    assert recipe_of("protochain.minimisers.recipes:_LBFGS").name == "LBFGS"
    (stage,) = plan_of(recipe_of(Own(3)), chain("ala10.pdb"))
    assert stage.method == Own(7)


NAMES = ", ".join(METHODS)


@pytest.mark.parametrize(
    ("method", "said"),
    [
        ("gradient", f"method 'gradient' is not known; choose from {NAMES}"),
        ("no_such:Thing", "method 'no_such:Thing' cannot be imported"),
        ("math:Thing", "method 'math:Thing' cannot be imported"), (3, "method 3: give a name"),
        (StrongWolfe(), "method StrongWolfe() is a step rule"),
        (SimpleNamespace(init=1), "method namespace(init=1): give a name"),
        (SimpleNamespace(step=1), "method namespace(step=1): give a name"),
    ],
)  # fmt: skip
def test_what_is_no_method_is_refused(method, said):
    with pytest.raises(pc.ProtochainError) as refusal:
        recipe_of(method)
    assert str(refusal.value).startswith(said)


def test_the_outlook_knows_the_methods_that_converge_and_the_order_of_their_costs():
    typical = {name: recipe.typical for name, recipe in RECIPES.items() if recipe.typical}
    by_cost = ["lbfgs", "cartesian", "hybrid", "newton", "md", "openmm", "anneal", "openmm-md"]
    assert sorted(typical, key=typical.__getitem__) == by_cost
