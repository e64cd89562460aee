"""The family of the compliance method: angles of one's choice, one compliance, what a fixed angle leaves."""

from itertools import pairwise

import numpy as np
import pytest
from fixtures.quadratics import Flat, Quadratic, positive
from fixtures.samples import chain, energy

import protochain as pc
from protochain.minimisers import KCM, RECIPES, Descent, Fixed, Proportional, Status, recipe_of
from protochain.minimisers.kcm import by_largest, largest_eigenvalue
from protochain.minimisers.loop import Stop, run
from protochain.minimisers.problem import Problem
from protochain.minimisers.recipes import at_angle
from protochain.minimisers.steps import AcceptReject, Armijo

DIFFERENCE = 1e-6
"""Relative, of products with the Hessian of a quadratic by central differences: cancellation alone."""


def test_kcm_at_an_angle_is_kcm_with_that_step():
    assert pc.kcm().runs == RECIPES["kcm"].runs and pc.kcm().name == "kcm-0.0005"
    found = recipe_of(pc.kcm(angle=0.01))
    assert found.name == "kcm-0.01" and found.keeps_geometry
    assert found.runs[0].method == Descent(KCM(norm=by_largest), Fixed(0.01))
    assert at_angle(RECIPES["kcm-armijo"], 0.02).runs[0].method.rule == Armijo(0.02, window=5)
    assert at_angle(RECIPES["kcm-sign"], 0.02).runs[0].method.rule == AcceptReject(0.02)


def test_every_step_of_kcm_turns_the_hinge_of_largest_torque_by_the_angle():
    c, e = chain("1l2y.pdb"), energy("1l2y.pdb")
    seen = []
    r = pc.minimise(c, e, pc.kcm(angle=0.003), max_evaluations=12, watch=lambda row, x: seen.append(x))
    assert r.method == "kcm-0.003" and r.status is Status.BUDGET and len(seen) == 12
    q = [pc.build_chain(c.structure.with_positions(x)).q0 for x in seen]
    for before, after in pairwise(q):
        turn = (after - before + np.pi) % (2.0 * np.pi) - np.pi
        assert np.abs(turn).max() == pytest.approx(0.003, rel=1e-6)


@pytest.mark.parametrize(
    ("recipe", "angle", "said"),
    [
        ("lbfgs", 0.01, "angle: does not apply to 'lbfgs'; choose from kcm, kcm-2norm, kcm-sign, "),
        ("kcm-proportional", 0.01, "angle: does not apply to 'kcm-proportional'"),
        ("kcm", 0.0, "angle 0: give a number above 0, at most pi, in rad"),
        ("kcm", np.nan, "angle nan: give a number above 0, at most pi, in rad"),
        ("kcm", 30.0, "angle 30: give a number above 0, at most pi, in rad"),
        ("kcm", "0.1", "angle '0.1': give a number"),
    ],
)
def test_an_angle_that_makes_no_sense_is_refused(recipe, angle, said):
    with pytest.raises(pc.ProtochainError) as refusal:
        at_angle(RECIPES[recipe], angle)
    assert str(refusal.value).startswith(said)


def quadratic(n=6, stiffest=100.0):
    hessian = positive(n, 3, stiffest)
    return hessian, Problem(Flat(), Quadratic(hessian), 10_000)


def test_the_largest_eigenvalue_is_that_of_the_hessian():
    hessian, problem = quadratic()
    at = problem.evaluate(np.arange(1.0, 7.0))
    assert largest_eigenvalue(problem, at, 6) == pytest.approx(100.0, rel=DIFFERENCE)
    assert problem.n_evaluations == 1 + 12
    few = largest_eigenvalue(problem, at, 3)
    assert np.linalg.eigvalsh(hessian)[-2] < few <= 100.0 * (1.0 + DIFFERENCE)
    # The size counts, not the sign: a direction of large negative curvature is not a soft one.
    falling = Problem(Flat(), Quadratic(-hessian), 100)
    assert largest_eigenvalue(falling, falling.evaluate(np.ones(6)), 6) == pytest.approx(
        100.0, rel=DIFFERENCE
    )
    # An eigenvector as the start leaves nothing more to span.
    vector = np.linalg.eigh(hessian)[1][:, 2]
    before = problem.n_evaluations
    assert largest_eigenvalue(problem, problem.evaluate(vector), 6) == pytest.approx(
        np.linalg.eigvalsh(hessian)[2], rel=1e-5
    )
    assert problem.n_evaluations == before + 3


@pytest.mark.parametrize(("safety", "converges"), [(0.25, True), (0.95, True), (1.05, False)])
def test_one_compliance_converges_up_to_two_over_the_largest_eigenvalue(safety, converges):
    _, problem = quadratic()
    points = []
    method = Descent(Proportional(safety, 6), Fixed(1.0))
    ending = run(problem, method, np.arange(1.0, 7.0), 1e-6, 3000, points.append)
    assert (ending.stop is Stop.TOLERANCE) == converges
    first, second, third = points[:3]
    compliance = 2.0 * safety / 100.0
    assert second.q - first.q == pytest.approx(compliance * first.torque, rel=10 * DIFFERENCE)
    # It is found once, and stays.
    assert third.q - second.q == pytest.approx(compliance * second.torque, rel=10 * DIFFERENCE)
