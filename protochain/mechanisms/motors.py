"""Motors that move hinges along a motion: a PD controller, and feed-forward by inverse dynamics."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from protochain.core.arrays import Floats
from protochain.core.checks import brief
from protochain.core.errors import MechanicsError
from protochain.mechanics import multibody
from protochain.mechanics.motion import Applied, Load
from protochain.mechanics.multibody import Frames
from protochain.mechanisms.bodies import Bodies
from protochain.mechanisms.drives import Driven
from protochain.mechanisms.element_arguments import not_negative, number
from protochain.mechanisms.elements import Acting, Named


@dataclass(frozen=True, eq=False)
class Motor(Named):
    """Motors of hinges that follow a motion: torques of a PD controller, and feed-forward.

    The torque is k (q* - q) + c (qd* - qd), and with feed-forward also the inverse dynamics of the
    bodies and their weight. There all followed hinges are at q*, qd*, qdd*, the others as they are without
    acceleration: it knows nothing of springs, loads and loops.

    Parameters
    ----------
    name : str
        Name.
    follow : mapping
        Hinge -> time -> coordinate, rate and acceleration, or a constant coordinate.
    stiffness, damping : float
        Gains k and c, of every hinge.
    feed_forward : bool
        Whether inverse dynamics is added.
    limit : float
        Largest torque of a hinge.

    Raises
    ------
    MechanicsError
        If the name is already in use, no hinge is followed, or a constant is negative.
    """

    noun: ClassVar[str] = "motor"

    follow: Mapping[str, Any]
    stiffness: float = 0.0
    damping: float = 0.0
    feed_forward: bool = False
    limit: float = np.inf

    def __post_init__(self) -> None:
        label = f"{self.label}: its"
        if not (isinstance(self.follow, Mapping) and self.follow):
            remedy = 'give hinges and their motions, as {"elbow": lambda t: (t, 1, 0)}'
            raise MechanicsError(f"{label} follow {brief(self.follow)}: {remedy}")
        for name in ("stiffness", "damping"):
            self.fix(**{name: float(not_negative(getattr(self, name), f"{label} {name}"))})
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
            raise MechanicsError(
                f'{self.label}: hinge "{names[int(np.argmax(is_driven))]}" is driven; remove it'
            )
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

        return Acting(load=Load(apply), inside=True, hinges=names)
