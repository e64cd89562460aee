"""Mechanisms that are struck, and blows to them by name."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from protochain.core.arrays import Floats
from protochain.mechanics.multibody import Tree, random_tree
from protochain.mechanics.multibody.articulated import Articulated, articulate
from protochain.mechanics.multibody.kinematics import pose
from protochain.mechanisms import Mechanism, Model, State
from protochain.mechanisms.impacts import ContactPoint, Impact, impact
from protochain.mechanisms.impacts.impact import Law, Order

UP = (0.0, 0.0, 1.0)
G = 9.81
"""m/s^2."""


@dataclass(frozen=True)
class Blow:
    """Where bodies of a mechanism touch.

    first, second: Bodies, or "world".
    at (3,): The point, in the second body's own axes.
    normal (3,): From the first to the second, in the world.
    friction, restitution: Coefficients.
    """

    first: str
    second: str
    at: ArrayLike = (0.0, 0.0, 0.0)
    normal: ArrayLike = UP
    friction: float = 0.0
    restitution: float = 0.0

    def point(self, state: State) -> ContactPoint:
        """The point of contact in a state."""
        number = state.bodies.number
        pair = number(self.first), number(self.second)
        place, normal = state.point(self.second, self.at), np.asarray(self.normal, float)
        return ContactPoint(
            f"{self.first}-{self.second}", pair, place, normal, self.friction, self.restitution
        )


def struck(
    model: Model, blows: Sequence[Blow], law: Law = "poisson", order: Order = "together"
) -> tuple[Impact, float]:
    """Strike a mechanism as it starts."""
    start = model.start()
    state = model.state(start)
    return impact(state.factors, state.qd, [b.point(state) for b in blows], law, None, order), start.kinetic


def two_rods(tip_mass: float = 1.0) -> Mechanism:
    """Make two uniform rods of 1 m in a row from a pin, without what their tip strikes.

    Of 1 kg (the lower of ``tip_mass``), 20 and 30 degrees off the vertical, at -0.1 and -0.2 rad/s.
    """
    m = Mechanism()
    for name, mass in (("upper", 1.0), ("lower", tip_mass)):
        m.body(name, mass=mass, com=(0.0, 0.0, -0.5), inertia=(mass / 12.0, mass / 12.0, 0.0))
    m.hinge("pin", "world", "upper", axis=(0.0, 1.0, 0.0), q=np.radians(20.0), qd=-0.1)
    m.hinge("knee", "upper", "lower", at=(0.0, 0.0, -1.0), axis=(0.0, 1.0, 0.0), q=np.radians(10.0), qd=-0.1)
    return m


TIP = (0.0, 0.0, -1.0)
"""Tip of the lower rod."""


def rods(friction: float, restitution: float = 0.5, tip_mass: float = 1.0) -> tuple[Model, Blow]:
    """Make the rods of :func:`two_rods`, whose tip strikes a level floor."""
    return two_rods(tip_mass).build(), Blow("world", "lower", TIP, UP, friction, restitution)


def cradle(masses: Sequence[float], speeds: Sequence[float], restitution: float) -> tuple[Model, list[Blow]]:
    """Make balls in a row along x, each of which touches the next."""
    m = Mechanism()
    for i, (mass, speed) in enumerate(zip(masses, speeds, strict=True)):
        m.body(f"ball {i}", mass=mass)
        m.hinge(
            f"slide {i}", "world", f"ball {i}", "prismatic", (float(i), 0.0, 0.0), (1.0, 0.0, 0.0), qd=speed
        )
    pairs = range(len(masses) - 1)
    along = (1.0, 0.0, 0.0)
    return m.build(), [
        Blow(f"ball {i}", f"ball {i + 1}", (-0.5, 0.0, 0.0), along, 0.0, restitution) for i in pairs
    ]


def ball(spin: ArrayLike, velocity: ArrayLike, friction: float, restitution: float) -> tuple[Model, Blow]:
    """Make a uniform ball of 1 kg and 0.1 m that strikes the floor."""
    m = Mechanism()
    m.body("ball", mass=1.0, inertia=0.4 * 0.1**2, position=(0.0, 0.0, 0.1), velocity=velocity, spin=spin)
    return m.build(), Blow("world", "ball", (0.0, 0.0, -0.1), UP, friction, restitution)


def dropped(height: float) -> Model:
    """Make a ball of 1 kg that falls along z from a height."""
    m = Mechanism(gravity=(0.0, 0.0, -G))
    m.body("ball", mass=1.0)
    m.hinge("fall", "world", "ball", "prismatic", axis=UP, q=height)
    return m.build()


def brick(corner: ArrayLike = (-0.1, -0.06, -0.04)) -> tuple[Model, Blow]:
    """Make a brick of 1 kg that tumbles, and strikes the floor with a corner, sliding."""
    m = Mechanism()
    sides = np.array([0.2, 0.12, 0.08])
    inertia = (np.sum(sides**2) - sides**2) / 12.0
    m.body("brick", mass=1.0, inertia=inertia, velocity=(-0.3, 0.6, -1.0), spin=(2.0, -5.0, 4.0))
    return m.build(), Blow("world", "brick", corner, UP, 0.3, 0.6)


def box(com: ArrayLike, points: int, friction: float) -> tuple[Model, list[Blow]]:
    """Make a box of 3 kg and 2 x 2 x 1 m that falls flat on a square of points x points."""
    m = Mechanism()
    m.body("box", mass=3.0, com=com, inertia=(1.25, 1.25, 2.0), velocity=(0.0, 0.0, -2.0))
    places = np.linspace(-1.0, 1.0, points)
    return m.build(), [Blow("world", "box", (x, y, -0.5), UP, friction, 0.3) for x in places for y in places]


def chain(n: int, seed: int = 0) -> tuple[Articulated, Floats, ContactPoint]:
    """Make a random serial chain in motion, whose last body strikes a wall: factors, velocities, point."""
    rng = np.random.default_rng(seed)
    tree: Tree = random_tree(n, rng)
    q, qd = rng.normal(scale=0.1, size=tree.n_q), rng.normal(size=tree.n_v)
    frames = pose(tree, q)
    wall = ContactPoint("wall", (-1, n - 1), frames.origin[-1], np.array(UP), 0.4, 0.5)
    factors = articulate(tree, frames)
    # The normal is such that it approaches.
    if impact(factors, qd, [wall]).before[0, 2] > 0.0:
        qd = -qd
    return factors, qd, wall
