"""Hinges that follow a motion: prescribed, or by motors with a PD controller and feed-forward."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from protochain.core.arrays import Floats
from protochain.core.checks import brief
from protochain.core.errors import MechanicsError
from protochain.core.settings import document_fields
from protochain.mechanics import multibody
from protochain.mechanics.motion import Applied, Drive
from protochain.mechanics.multibody import Frames
from protochain.mechanisms.bodies import Bodies
from protochain.mechanisms.compiled_loads import MOTOR, HingeLoad, HingeRow
from protochain.mechanisms.element_arguments import amount, answer, number
from protochain.mechanisms.elements import Acting, Named


@dataclass(frozen=True, eq=False)
class Driven(Named, noun="drive of hinge"):
    """Prescribed motion of a hinge, by its name: time -> coordinate, rate, acceleration."""

    motion: Callable[[float], tuple[float, float, float]]

    def __post_init__(self) -> None:
        if not callable(self.motion):
            raise self.refusal(
                f"motion {brief(self.motion)}: give a function of time, as lambda t: (t, 1, 0)"
            )

    def at(self, time: float) -> tuple[float, float, float]:
        """Coordinate, rate and acceleration at a time."""
        values = answer(f"{self.label}: its motion", self.motion, time)
        try:
            q, qd, qdd = (float(value) for value in values)
        except (TypeError, ValueError):
            q = qd = qdd = np.nan
        if not np.isfinite(q + qd + qdd):
            raise self.refusal(
                f"at time {time:g} it gives {brief(values)}; give coordinate, rate and acceleration, finite"
            )
        return q, qd, qdd


@document_fields
@dataclass(frozen=True, eq=False)
class Motor(Named, noun="motor"):
    """Motors of hinges that follow a motion: torques of a PD controller, and feed-forward.

    The torque is k (q* - q) + c (qd* - qd), and with feed-forward also the inverse dynamics of the
    bodies and their weight. There all followed hinges are at q*, qd*, qdd*, the others as they are without
    acceleration: it knows nothing of springs, loads and loops.

    Raises
    ------
    MechanicsError
        If the name is already in use, no hinge is followed, or a constant is negative.
    """

    # Hinge -> function of the time that returns coordinate, rate and acceleration, or a constant coordinate.
    follow: Mapping[str, Any]
    stiffness: float = 0.0  # Gain k, of every hinge.
    damping: float = 0.0  # Gain c, of every hinge.
    feed_forward: bool = False  # Whether inverse dynamics is added.
    limit: float = np.inf  # Largest torque of a hinge.

    def __post_init__(self) -> None:
        label = f"{self.label}: its"
        if not (isinstance(self.follow, Mapping) and self.follow):
            remedy = 'give hinges and their motions, as {"elbow": lambda t: (t, 1, 0)}'
            raise MechanicsError(f"{label} follow {brief(self.follow)}: {remedy}")
        self.check(stiffness=amount, damping=amount)
        if not (self.limit == np.inf or number(self.limit, f"{label} limit") > 0.0):
            raise MechanicsError(f"{label} limit {self.limit:g}: give one above 0")
        self.fix(follow={hinge: self._drive_of(hinge, motion) for hinge, motion in self.follow.items()})

    def _drive_of(self, hinge: str, motion: Any) -> Driven:
        if callable(motion):
            return Driven(hinge, motion)
        coordinate = number(motion, f'{self.label}: its hinge "{hinge}"')
        return Driven(hinge, lambda time: (coordinate, 0.0, 0.0))

    def bind(self, bodies: Bodies) -> Acting:
        """Return its torques as a load."""
        tree, names = bodies.tree, tuple(self.follow)
        places, freedoms = np.array([bodies.freedom(name, self.label) for name in names]).T
        if np.any(is_driven := np.isin(freedoms, tree.driven_v)):
            raise self.refusal(f'hinge "{names[int(np.argmax(is_driven))]}" is driven; remove it')
        units = np.array([bodies.unit(name) for name in names])

        def apply(time: float, q: Floats, qd: Floats, frames: Frames) -> Applied:
            targets, rate, quickening = units * np.array([drive.at(time) for drive in self.follow.values()]).T
            torque = self.stiffness * (targets - q[places]) + self.damping * (rate - qd[freedoms])
            if self.feed_forward:
                q_target, moving, qdd = q.copy(), qd.copy(), np.zeros(tree.n_v)
                q_target[places], moving[freedoms], qdd[freedoms] = targets, rate, quickening
                weight = bodies.weights(multibody.pose(tree, q_target))
                torque = torque + multibody.inverse_dynamics(tree, q_target, moving, qdd, weight)[freedoms]
            torques = np.zeros(tree.n_v)
            torques[freedoms] = np.clip(torque, -self.limit, self.limit)
            return Applied(torques=torques)

        rows = [
            HingeRow(MOTOR, place, freedom, (self.stiffness, self.damping, self.limit), drive.motion, unit)
            for place, freedom, drive, unit in zip(places, freedoms, self.follow.values(), units, strict=True)
        ]
        gravity = bodies.gravity if self.feed_forward else None
        load = HingeLoad(apply, rows=tuple(rows), computed=apply, gravity=gravity)
        return Acting(load=load, inside=True, hinges=names)


@dataclass(frozen=True, eq=False)
class Drives:
    """All drives as one, in the order of the tree."""

    drives: Sequence[Driven]
    units: Floats  # Internal values of their units.

    def __call__(self, time: float) -> tuple[Floats, Floats, Floats]:
        """Coordinates, rates and accelerations."""
        q, qd, qdd = np.array([driven.at(time) for driven in self.drives]).T * self.units
        return q, qd, qdd


def drive_of(bodies: Bodies, drives: Sequence[Driven]) -> Drives:
    """All drives as one, in the order of the tree."""
    ordered = sorted(drives, key=lambda driven: bodies.hinge(driven.name))
    return Drives(ordered, np.array([bodies.unit(driven.name) for driven in ordered]))


def check_drive(bodies: Bodies, drive: Drive, time: float, nudge: float) -> None:
    """Raise if a drive's rates and accelerations are not the derivatives of its coordinates and rates."""
    tree = bodies.tree
    before, at, after = (np.array(drive(t)) for t in (time - nudge, time, time + nudge))
    change = (after[:2] - before[:2]) / (2.0 * nudge)
    # A hundredth, and what the differences are rounded by: a start from rest cancels terms of order one.
    rounded = (1e-12 * np.abs(at[:2]) + 1e-13 * tree.units[tree.driven_v]) / nudge
    allowed = 0.01 * np.maximum(np.abs(change), np.abs(at[1:])) + rounded
    if np.any(np.abs(change - at[1:]) > allowed):
        row, k = (int(i) for i in np.argwhere(np.abs(change - at[1:]) > allowed)[0])
        driven = [hinge for hinge, b in bodies.hinges.items() if tree.v_start[b] in tree.driven_v]
        name = sorted(driven, key=bodies.hinge)[k]
        noun, rate = ("coordinate", "rate") if row == 0 else ("rate", "acceleration")
        raise MechanicsError(
            f'drive of hinge "{name}": at time {time:g} its {noun} changes by {change[row, k]:g} per time, '
            f"but its {rate} is {at[row + 1, k]:g}; give the derivative"
        )
