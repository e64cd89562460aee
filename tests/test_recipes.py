"""Methods by name: what each runs, in which space, on which energy."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import chain
from test_descent import crowded

import protochain as pc
from protochain.minimisers import METHODS, RECIPES, Recipe, Run, recipe_of
from protochain.minimisers.annealing import Annealing, AnnealingState
from protochain.minimisers.descent import Descent, DescentState
from protochain.minimisers.fire import Fire, FireState
from protochain.minimisers.kcm import KCM, by_largest, by_length, by_sign
from protochain.minimisers.lbfgs import LBFGS
from protochain.minimisers.loop import Stop
from protochain.minimisers.metrics import Euclidean, Mass, Stiffness
from protochain.minimisers.newton import Newton, PseudoTransient, PseudoTransientState
from protochain.minimisers.restraints import SOFT_TETHER, Hold, SoftRepulsion, Tethers
from protochain.minimisers.spaces import spaces
from protochain.minimisers.stages import PATIENCE, last, lowest, parting
from protochain.minimisers.steps import AcceptReject, Armijo, Decaying, Fixed, StrongWolfe

TURNING = {
    "kcm": (Descent(KCM(Euclidean(), by_largest), Fixed(0.0005)), False),
    "kcm-2norm": (Descent(KCM(Euclidean(), by_length), Fixed(0.002)), False),
    "kcm-sign": (Descent(KCM(Euclidean(), by_sign), Fixed(0.0001)), False),
    "kcm-decaying": (Descent(KCM(), Decaying(0.002, 200.0)), False),
    "kcm-adaptive": (Descent(KCM(), AcceptReject(0.0005)), False),
    "kcm-armijo": (Descent(KCM(), Armijo(0.0005, 5)), False),
    "kcm-transient": (PseudoTransient(), False),
    "kcm-metric": (Descent(KCM(Mass(1)), AcceptReject(0.0005, 1.2, 0.5)), False),
    "kcm-stiffness": (Descent(KCM(Stiffness(20)), AcceptReject(0.0005)), False),
    "fire": (Fire(), False),
    "quench": (Fire(mixing=1.0, fade=1.0), False),
    "newton": (Descent(Newton(), StrongWolfe()), True),
    "lbfgs": (Descent(LBFGS(), StrongWolfe()), True),
}
"""Methods in torsions: what runs, and whether overlaps are parted before."""
TYPICAL = {"newton": 400, "lbfgs": 150}
"""Evaluations they usually take; the others use up all there are."""
BY_LBFGS = Run(Descent(LBFGS(Stiffness(20), 100), StrongWolfe()))
ALL_ATOMS = Run(Descent(LBFGS(Stiffness(40), 100), StrongWolfe()), in_torsions=False)


def test_each_method_in_torsions_is_as_documented():
    for name, (method, parts) in TURNING.items():
        expected = Run(method, True, None, 500, lowest, True)
        assert RECIPES[name] == Recipe(name, (expected,), parts, False, False, TYPICAL.get(name, 0))


def test_dynamics_run_to_their_end_and_end_in_a_minimum():
    for name, method, random in (
        ("md", Annealing(0.0, 1000, 10.0, 0.004, 0), False),
        ("anneal", Annealing(600.0, 2000, 10.0, 0.004, 0), True),
    ):
        moved = Run(method, True, 0.0, method.n_steps, last, False)
        assert RECIPES[name] == Recipe(name, (moved, BY_LBFGS), True, random, False, method.n_steps + 150)


def test_the_other_methods_move_all_atoms():
    expected = (
        Recipe("cartesian", (ALL_ATOMS,), False, typical=500),
        Recipe("hybrid", (Run(BY_LBFGS.method, tolerance=300.0), ALL_ATOMS), True, typical=500),
        Recipe("openmm", (), False, False, True, 1500),
        Recipe("openmm-md", (), False, True, True, 3000),
    )
    for recipe in expected:
        assert RECIPES[recipe.name] == recipe
    assert set(METHODS) == {*TURNING, "md", "anneal", *(recipe.name for recipe in expected)}
    assert list(RECIPES) == list(METHODS)


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
    energy = SimpleNamespace(engine=engine, threads=threads)
    assert Recipe("own", by_openmm=by_openmm).repeats_exactly(energy) is in_order
    assert Recipe("own", by_openmm=by_openmm, draws_random=True).repeats_exactly(energy) is False


def test_openmms_methods_need_a_system():
    without = SimpleNamespace(system=None)
    with pytest.raises(pc.ProtochainError) as refusal:
        RECIPES["openmm"].check(without)
    assert str(refusal.value) == (
        "method 'openmm' needs an OpenMM System, and a callable has none; choose another"
    )
    RECIPES["openmm"].check(SimpleNamespace(system="some"))
    RECIPES["lbfgs"].check(without)


def plan_of(recipe, c, hold=None, tolerance=2.0, seed=7, exact=True):
    whole, reduced = (
        SimpleNamespace(is_exact=exact, name=name, reference=name) for name in ("whole", "reduced")
    )
    return recipe.plan(c, whole, reduced, tolerance, hold or Hold(), seed)


def test_a_plan_is_of_the_recipes_runs_in_their_spaces_on_their_energies():
    c = chain("ala10.pdb")
    torsions, atoms = spaces(c)
    first, second = plan_of(RECIPES["hybrid"], c)
    assert (first.space, first.energy.name, first.tolerance) == (torsions, "reduced", 300.0)
    assert (second.space, second.energy.name, second.tolerance) == (atoms, "whole", 2.0)
    assert (first.method, second.method) == (BY_LBFGS.method, ALL_ATOMS.method)
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
    assert stages[2].method == BY_LBFGS.method and stages[2].tolerance == 2.0


def test_the_last_run_is_repeated_for_each_restraint():
    c = chain("ala10.pdb")
    hold = Hold((100.0, 10.0, 0.0))
    stages = plan_of(RECIPES["hybrid"], c, hold)
    weights = [stage.restraint and stage.restraint.parts[0].weight.max() for stage in stages]
    assert weights == [100.0, 100.0, 10.0, None]
    assert [stage.space for stage in stages] == [spaces(c)[0], *[spaces(c)[1]] * 3]


def test_overlaps_are_parted_first_by_the_recipes_that_say_so():
    c = crowded()
    s = c.structure
    first, second = plan_of(RECIPES["lbfgs"], c)
    assert second.energy.name == "reduced" and first.tolerance == 1.0 and not first.recorded
    assert (first.name, second.name) == ("parting overlaps", "torsions")
    assert first.space is second.space is spaces(c)[0]
    assert first.method == BY_LBFGS.method and first.patience == PATIENCE and first.restraint is None
    soft, tethers = parting(spaces(c)[0]).energy.parts
    assert [type(part) for part in first.energy.parts] == [SoftRepulsion, Tethers] and soft.structure is s
    assert tethers.weight.tolist() == [SOFT_TETHER] * s.n_atoms == [10.0] * s.n_atoms
    assert np.array_equal(tethers.home, s.positions)
    assert len(plan_of(RECIPES["kcm"], c)) == 1 and len(plan_of(RECIPES["lbfgs"], chain("1l2y.pdb"))) == 1


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
        ("gradient", f"method 'gradient' is not known; choose from {NAMES}, or give module:name"),
        ("no_such:Thing", "method 'no_such:Thing' cannot be imported: No module named 'no_such'"),
        (":Thing", "method ':Thing' cannot be imported: Empty module name"),
        ("math:Thing", "method 'math:Thing' cannot be imported: module 'math' has no attribute 'Thing'"),
        (3, "method 3: give a name, or an object with init and step, as Descent(direction, rule)"),
        (Fixed(1.0), "method Fixed(length=1.0) is a step rule: give it with a direction, as "
                     "Descent(direction, Fixed(length=1.0))"),
        (StrongWolfe(), "method StrongWolfe() is a step rule: give it with a direction, as "
                        "Descent(direction, StrongWolfe())"),
        (SimpleNamespace(init=1), "method namespace(init=1): give a name, or an object with init and step, "
                                  "as Descent(direction, rule)"),
        (SimpleNamespace(step=1), "method namespace(step=1): give a name, or an object with init and step, "
                                  "as Descent(direction, rule)"),
    ],
)  # fmt: skip
def test_what_is_no_method_is_refused(method, said):
    with pytest.raises(pc.ProtochainError) as refusal:
        recipe_of(method)
    assert str(refusal.value) == said
