"""Driven hinges and bodies without mass in motion, against closed forms and scipy's integrators."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from protochain import multibody
from protochain.errors import MechanicsError
from protochain.motion import (
    Applied,
    DormandPrince,
    Event,
    ImplicitMidpoint,
    Leapfrog,
    Load,
    Rosenbrock,
    RungeKutta4,
    System,
    march,
)  # fmt: skip
from protochain.multibody import HingeKind, Tree, random_tree

G = 9.81
LENGTH, MASS, INERTIA = 0.7, 2.0, 0.05
"""Pendulum: a body of 2 kg whose centre is 0.7 m below its pivot, with a moment of inertia about the centre."""
ALONG_X = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
"""Frame whose z axis is the world's x: a slide along x."""


def on_a_cart(driven=True, cart=3.0):
    """A pendulum about y that hangs from a cart on the world's x axis; downwards at q = 0."""
    # The body's z axis is the world's y, its x axis the world's -z.
    seat = np.array([[0.0, -1, 0], [0, 0, 1], [-1, 0, 0]])
    return Tree(
        np.array([-1, 0]),
        np.array([HingeKind.PRISMATIC, HingeKind.REVOLUTE]),
        np.zeros((2, 3)),
        np.stack([ALONG_X, ALONG_X.T @ seat]),
        np.array([cart, MASS]),
        np.array([[0.0, 0, 0], [LENGTH, 0, 0]]),
        np.stack([(cart > 0.0) * np.eye(3), INERTIA * np.eye(3)]),
        driven=np.array([driven, False]),
    )


def weight(q, factors):
    return MASS * G * LENGTH * (1.0 - float(np.cos(q[1]))), np.array([0.0, -MASS * G * LENGTH * np.sin(q[1])])


def motion(time):
    """To and fro, faster and faster: where the cart is, its velocity, its acceleration."""
    phase, rate = 3.0 * time + time**2, 3.0 + 2.0 * time
    x = 0.3 * np.sin(phase)
    return (
        np.array([x]),
        np.array([0.3 * rate * np.cos(phase)]),
        np.array([0.6 * np.cos(phase) - rate**2 * x]),
    )


def driven_system(**others):
    return System(on_a_cart(), weight, drive=motion, **others)


def angle_and_work(until, damping=0.0, start=(0.4, 1.0)):
    """The pendulum's angle and rate and the work of its drive, by DOP853 from the textbook equation."""
    inertia, lever = INERTIA + MASS * LENGTH**2, MASS * LENGTH

    def rates(t, y):
        (_,), (v,), (a,) = motion(t)
        # A turn by y about the world's y axis carries what hangs down towards -x.
        acceleration = (lever * a * np.cos(y[0]) - lever * G * np.sin(y[0]) - damping * y[1]) / inertia
        force = (3.0 + MASS) * a - lever * (acceleration * np.cos(y[0]) - y[1] ** 2 * np.sin(y[0]))
        return [y[1], acceleration, force * v]

    return solve_ivp(rates, (0.0, until), (*start, 0.0), method="DOP853", rtol=1e-13, atol=1e-13).y[:, -1]


def steps(system, integrator, at, n, h):
    for _ in range(n):
        at = integrator.step(system, at, h)
    return at


def begun(system):
    return system.at(np.array([9.0, 0.4]), np.array([9.0, 1.0]))


def test_a_pendulum_on_a_driven_pivot_moves_as_by_dop853():
    system = driven_system()
    at = steps(system, DormandPrince(1e-13), begun(system), 4, 0.25)
    angle, rate, work = angle_and_work(1.0)
    assert at.q == pytest.approx([motion(1.0)[0][0], angle], abs=1e-11)
    assert at.qd == pytest.approx([motion(1.0)[1][0], rate], abs=1e-11)
    assert at.work == pytest.approx([work], abs=1e-10)
