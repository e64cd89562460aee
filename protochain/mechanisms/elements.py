"""What acts in a mechanism: elements with an exact energy, and loads, whose work is counted."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from protochain import multibody
from protochain.arrays import Floats
from protochain.mechanisms.bodies import Bodies
from protochain.motion import Applied, Load, Phase
from protochain.multibody import Frames, Tree
from protochain.multibody.algebra import (
    add_pair,
    cross,
    dot,
    kernel,
    matrix,
    scale,
    turned,
    vector,
    vector_at,
)
from protochain.multibody.articulated import Articulated
from protochain.multibody.tree import FIRST_MOMENT, MASS


class Conservative(Protocol):
    """Elements of one kind, whose forces are minus the gradient of an energy."""

    def add(self, q: Floats, frames: Frames, wrenches: Floats, torques: Floats) -> float:
        """Add wrenches (nb, 6), about the bodies' origins along world axes, and torques (n_v,) in place.

        Returns the energy.
        """


class Damping(Protocol):
    """Elements of one kind, whose forces oppose velocities."""

    def resist(self, frames: Frames, twists: Floats, qd: Floats, wrenches: Floats, torques: Floats) -> None:
        """Add wrenches (nb, 6) and torques (n_v,) in place, from the twists (nb, 6) of the bodies."""


class Memory(Protocol):
    """What an element keeps from step to step, as anchors of friction; it does not change within one."""

    def begin(self, start: Phase) -> None:
        """Begin a run."""

    def settle(self, at: Phase) -> None:
        """End a step; the start of a run is one, too."""

    def end(self, at: Phase | None) -> None:
        """End a run at a phase from which another may go on; None if it has failed."""


@dataclass(frozen=True, eq=False)
class Acting:
    """What one element does.

    Parameters
    ----------
    conservative : Conservative, optional
        Part with an energy.
    load : Load, optional
        Part whose work is counted.
    dissipates : bool
        Whether the work of the load is dissipation.
    inside : bool
        Whether all of it acts between bodies of the mechanism, so that it keeps their momentum.
    memory : Memory, optional
        What it keeps from step to step.
    """

    conservative: Conservative | None = None
    load: Load | None = None
    dissipates: bool = False
    inside: bool = False
    memory: Memory | None = None


class Element(Protocol):
    """Forces of the user's own, for :meth:`protochain.mechanisms.Mechanism.force`."""

    def bind(self, bodies: Bodies) -> Acting:
        """Return what acts in a mechanism with these bodies, whose names become numbers here."""


@dataclass(frozen=True, eq=False)
class Sum:
    """Potential of conservative elements: wrenches of all of them are pulled back once.

    Parameters
    ----------
    tree : Tree
        Rigid bodies.
    parts : sequence of Conservative
        Elements, by kind.
    """

    tree: Tree
    parts: Sequence[Conservative]

    def __call__(self, q: Floats, factors: Articulated) -> tuple[float, Floats]:
        """Energy and torques (n_v,)."""
        tree = self.tree
        torques = np.zeros(tree.n_v)
        if not self.parts:
            return 0.0, torques
        wrenches = np.zeros((tree.n_bodies, 6))
        energy = 0.0
        for part in self.parts:
            energy += part.add(q, factors.frames, wrenches, torques)
        return energy, torques + multibody.pull_back(tree, factors.frames, wrenches)


@dataclass(frozen=True, eq=False)
class Gravity:
    """Weight of all bodies; its energy is zero at the world's origin.

    Parameters
    ----------
    tree : Tree
        Rigid bodies.
    acceleration : (3,) float
        Acceleration of free fall.
    """

    tree: Tree
    acceleration: Floats

    def add(self, q: Floats, frames: Frames, wrenches: Floats, torques: Floats) -> float:
        """Add the weights."""
        energy: float = _weigh(self.tree.bodies, frames.rotation, frames.origin, self.acceleration, wrenches)
        return energy


def damping(tree: Tree, parts: Sequence[Damping]) -> Load:
    """Return all dampers as one load."""

    def applied(time: float, q: Floats, qd: Floats, frames: Frames) -> Applied:
        twists = multibody.velocities(tree, frames, qd)
        wrenches, torques = np.zeros((tree.n_bodies, 6)), np.zeros(tree.n_v)
        for part in parts:
            part.resist(frames, twists, qd, wrenches, torques)
        return Applied(wrenches, torques)

    return Load(applied)


@kernel
def _weigh(bodies: Floats, rotation: Floats, origin: Floats, gravity: Floats, wrenches: Floats) -> float:
    energy, g = 0.0, vector_at(gravity, 0)
    for b in range(len(bodies)):
        mass, first = bodies[b, MASS], turned(matrix(rotation, b), vector(bodies, b, FIRST_MOMENT))
        energy -= mass * dot(g, vector(origin, b)) + dot(g, first)
        add_pair(cross(first, g), scale(mass, g), wrenches, b)
    return energy
