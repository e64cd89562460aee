"""Friction in hinges: Coulomb's, constant or by the force that the hinge transmits, and viscous."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from protochain.core.arrays import Floats
from protochain.core.errors import Fault, MechanicsError
from protochain.core.settings import document_fields
from protochain.mechanics.motion import Applied, Load, Phase
from protochain.mechanics.multibody import Frames
from protochain.mechanisms.assembly import Assembly
from protochain.mechanisms.bodies import Bodies
from protochain.mechanisms.compiled_loads import FRICTION, ITERATIONS, SAME, HingeLoad, HingeRow
from protochain.mechanisms.element_arguments import amount
from protochain.mechanisms.elements import Acting, Named
from protochain.mechanisms.reactions import transmitted_forces


@document_fields
@dataclass(frozen=True, eq=False)
class HingeFriction(Named, noun="friction"):
    """Friction in a hinge, whose work is dissipation: -(T + mu r N) tanh(qd / v) - c qd.

    N is the force across the axis that the hinge transmits. Its moments across the axis press on nothing.
    A hinge that would stick creeps, at less than the speed v.

    Raises
    ------
    MechanicsError
        If the name is already in use, it does nothing, or a constant is negative.
    """

    hinge: str  # Name of the hinge.
    torque: float = 0.0  # Constant part T of Coulomb's friction, a force at a slide.
    coefficient: float = 0.0  # Coefficient mu.
    radius: float = 1.0  # Radius r of the pin. A slide has none.
    damping: float = 0.0  # Torque by rate c, of viscous friction.
    # Rate v within which Coulomb's friction changes its sign: far below the motion's rates, and far above the
    # resolution of a step.
    speed: float = 1e-3

    def __post_init__(self) -> None:
        self.check(torque=amount, coefficient=amount, radius=amount, damping=amount, speed=amount)
        if self.torque == self.coefficient * self.radius == self.damping == 0.0:
            raise self.refusal(
                "it has no effect; give a torque, a coefficient or a damping",
                fault=Fault.NO_STIFFNESS,
            )
        if not self.speed > 0.0:
            raise self.refusal("its speed is zero; give one far below those of the motion")

    def bind(self, bodies: Bodies) -> Acting:
        """Return its torques as a load."""
        b, (_, freedom) = bodies.hinge(self.hinge, self.label), bodies.freedom(self.hinge, self.label)
        turn, slide = bodies.tree.twist[b]
        if self.coefficient and turn and slide:
            raise self.refusal("a screw has no pin; give a torque, or a damping")
        arm = self.coefficient * (self.radius if turn else 1.0)
        rubs = Rubbing(self.label, b, freedom, self.torque, arm, self.damping, self.speed)
        return Acting(friction=rubs, inside=True)


class Rubbing(NamedTuple):
    """Friction of a hinge, bound."""

    label: str  # Kind and name, for messages.
    body: int  # body, freedom: Body beyond the hinge, and place in qd.
    freedom: int
    torque: float  # torque, arm, damping, speed: Constants; arm is coefficient times radius.
    arm: float
    damping: float
    speed: float

    def against(self, qd: Floats, force: float = 0.0) -> float:
        """Torque under a force across the axis."""
        rate = float(qd[self.freedom])
        return -(self.torque + self.arm * force) * float(np.tanh(rate / self.speed)) - self.damping * rate


def friction(model: Assembly, hinges: Sequence[Rubbing]) -> Load:
    """Return the friction of all hinges as one load, for a mechanism without it."""
    # Forces that hinges transmit change linearly with the torques of friction, which change with these: a
    # fixed point of as many numbers as there are hinges whose friction depends on forces.
    pressed = [hinge for hinge in hinges if hinge.arm]
    system, tree = model.system, model.tree

    def forces(at: Phase) -> Floats:
        """(k, 3) float: across the axes."""
        across = transmitted_forces(model, at).hinges[[hinge.body for hinge in pressed], 3:]
        axes = at.factors.frames.rotation[[hinge.body for hinge in pressed], :, 2]
        return np.asarray(across - np.sum(across * axes, axis=1)[:, None] * axes)

    def sizes(time: float, q: Floats, qd: Floats) -> Floats:
        """(k,) float: forces across the axes with all friction acting."""
        factors = system.factors(q)
        _, torque, loads = system.forces(time, q, qd, factors)
        torque = torque + _torques(hinges, qd, {})
        at = Phase(q, qd, qd, 0.0, torque, factors, time, loads=loads)
        alone, units = forces(at), np.eye(tree.n_v)
        changes = [forces(replace(at, torque=torque + units[hinge.freedom])) - alone for hinge in pressed]
        size = np.linalg.norm(alone, axis=1)
        slip = np.array([hinge.against(qd, 1.0) - hinge.against(qd) for hinge in pressed])
        for _ in range(ITERATIONS):
            before, size = size, np.linalg.norm(alone + np.einsum("jki,j->ki", changes, slip * size), axis=1)
            if np.max(np.abs(size - before)) <= SAME * np.max(size):
                return size
        label = pressed[int(np.argmax(np.abs(size - before)))].label
        raise MechanicsError(f"{label}: it jams at time {time:g}, as no force of its hinge balances "
                             "its friction; give a smaller coefficient or radius")  # fmt: skip

    def apply(time: float, q: Floats, qd: Floats, frames: Frames) -> Applied:
        pressing = sizes(time, q, qd) if pressed else ()
        by_freedom = {hinge.freedom: size for hinge, size in zip(pressed, pressing, strict=True)}
        return Applied(torques=_torques(hinges, qd, by_freedom))

    rows = [
        HingeRow(FRICTION, hinge.body, hinge.freedom, (hinge.torque, hinge.damping, hinge.speed, hinge.arm))
        for hinge in hinges
    ]
    return HingeLoad(apply, rows=tuple(rows), computed=apply)


def _torques(hinges: Sequence[Rubbing], qd: Floats, forces: Mapping[int, float]) -> Floats:
    out = np.zeros(len(qd))
    for hinge in hinges:
        out[hinge.freedom] += hinge.against(qd, forces.get(hinge.freedom, 0.0))
    return out
