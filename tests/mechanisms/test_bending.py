"""Motion of bodies that bend: integrators against equations by hand, drives, loads and their work."""

from dataclasses import replace

import numpy as np
import pytest
from fixtures.bending_trees import SPUN, on_a_hub, some, two_links
from fixtures.tolerances import ONE_STEP
from scipy.integrate import solve_ivp

from bench.scenes.canonical import by_hand
from protochain.core.errors import MechanicsError
from protochain.mechanics.motion import Applied, DormandPrince, ImplicitMidpoint, Leapfrog, Load, RungeKutta4
from protochain.mechanics.multibody import random_tree
from protochain.mechanisms import Rosenbrock
from protochain.mechanisms.bending import BendingSystem
from protochain.mechanisms.flexible.dynamics import momenta
from protochain.mechanisms.flexible.flexible import bend

START = np.array([0.3, 0.9, 0.05, -0.04]), np.array([2.0, -3.0, 0.5, 0.4])


def nothing(q, factors):
    return 0.0, np.zeros(len(q))


def adrift(flexible):
    return lambda q, factors: (0.0, np.zeros(flexible.n_v))


def links():
    flexible = two_links()
    return BendingSystem(flexible.tree, nothing, flexible=flexible)


def steps(system, integrator, at, n, h):
    for _ in range(n):
        at = integrator.step(system, at, h)
    return at


def exact(until):
    flexible = two_links()
    start = np.concatenate(START)
    return solve_ivp(by_hand(flexible), (0.0, until), start, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]


def test_links_that_bend_move_as_by_hand():
    system = links()
    start = system.at(*START)
    at = steps(system, DormandPrince(1e-11), start, 2, 0.1)
    assert np.concatenate([at.q, at.qd]) == pytest.approx(exact(0.2), abs=1e-8)
    assert at.total == pytest.approx(start.total, rel=1e-9)
    assert at.p == pytest.approx(momenta(system.flexible, at.q, at.qd)[0], abs=1e-12)


@pytest.mark.parametrize(
    ("integrator", "n", "order"),
    [(RungeKutta4(), 20, 4), (Rosenbrock(ONE_STEP), 80, 2)],
    ids=["rk4", "rosenbrock"],
)
def test_orders_are_those_of_rigid_bodies(integrator, n, order):
    system, wanted = links(), exact(0.2)
    ends = [steps(system, integrator, system.at(*START), k, 0.2 / k) for k in (n, 2 * n)]
    errors = [np.linalg.norm(np.concatenate([at.q, at.qd]) - wanted) for at in ends]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.4)


def test_wrenches_on_sections_do_the_work():
    """Pushed at every node, and braked at hinges and shapes, adrift: the change of energy is their work."""
    flexible, q, qd, _, rng = some(2, n=4)
    push = rng.normal(size=(len(bend(flexible, q).origin), 6))
    loads = (
        Load(lambda t, q, qd, bent: Applied(np.cos(5.0 * t) * push), depends_on_velocity=False),
        Load(lambda t, q, qd, bent: Applied(torques=-0.05 * qd)),
    )
    system = BendingSystem(flexible.tree, adrift(flexible), loads=loads, flexible=flexible)
    start = system.at(q, qd)
    at = steps(system, DormandPrince(1e-11), start, 1, 0.02)
    assert at.work.shape == (2,) and np.abs(at.work).min() > 1e-4
    assert at.total - start.total == pytest.approx(at.work.sum(), abs=1e-9 * start.total)
    # A force on a node does the work of its way: one alone, constant, against how far it has come.
    one = np.zeros_like(push)
    one[-1, 3:] = 1.0, -2.0, 0.5
    pulled = replace(system, loads=(Load(lambda t, q, qd, bent: Applied(one), False),))
    end = steps(pulled, DormandPrince(1e-11), pulled.at(q, qd), 1, 0.02)
    way = end.factors.origin[-1] - bend(flexible, q).origin[-1]
    assert end.work == pytest.approx([one[-1, 3:] @ way], abs=1e-8)


def test_the_drive_of_a_hub_does_the_work_of_its_beam():
    flexible = on_a_hub(SPUN, lag=2)

    def spin(t):
        return np.array([2.0 * t**2]), np.array([4.0 * t]), np.array([4.0])

    system = BendingSystem(flexible.tree, nothing, drive=spin, flexible=flexible)
    system = replace(system, potential=adrift(flexible))
    start = system.at(np.zeros(3), np.zeros(3))
    at = steps(system, DormandPrince(1e-10), start, 5, 0.1)
    assert (at.q[0], at.qd[0]) == (0.5, 2.0)
    assert at.total == pytest.approx(at.work[0], rel=1e-8) and at.work[0] > 100.0
    assert at.q[1] < -0.1  # the beam lags behind
    turned = system.with_velocities(at, np.array([9.0, 0.0, 0.0]))
    assert turned.qd[0] == 2.0


def test_what_cannot_bend_is_refused():
    system = links()
    for integrator in (Leapfrog(), ImplicitMidpoint()):
        with pytest.raises(MechanicsError, match="does not support bodies that bend; use Runge-Kutta"):
            integrator.step(system, system.at(*START), 0.01)
    with pytest.raises(MechanicsError, match="on the tree of the system"):
        BendingSystem(random_tree(2, 0), nothing, flexible=two_links())
