"""Forces and moments on bodies, and torques at hinges: constants, or functions of time and state."""

import inspect
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from protochain.core.arrays import Floats, read_only
from protochain.core.checks import Check
from protochain.core.errors import MechanicsError
from protochain.core.settings import document_fields
from protochain.mechanics.motion import Applied, Load
from protochain.mechanics.multibody import Frames
from protochain.mechanisms.bodies import Bodies, State
from protochain.mechanisms.compiled_loads import TORQUE, HingeLoad, HingeRow
from protochain.mechanisms.element_arguments import answer, number, numbers
from protochain.mechanisms.elements import Acting, Named


@document_fields
@dataclass(frozen=True, eq=False)
class AppliedForce(Named, noun="load"):
    """Force at a point of a body, a moment, or both.

    Raises
    ------
    MechanicsError
        If the name is already in use, or nothing acts.
    """

    body: str  # Name of the body.
    at: ArrayLike = (0.0, 0.0, 0.0)  # (3,) float: Point of the body at which the force acts.
    # (3,) float or callable, optional: Force along world axes, or a function of the time, or of the time and
    # the :class:`State`, that returns it.
    force: Any = None
    moment: Any = None  # (3,) float or callable, optional: Moment, as the force.

    def __post_init__(self) -> None:
        if self.force is None and self.moment is None:
            raise self.refusal("it has no effect; give a force or a moment")
        self.fix(at=numbers(self.at, f"{self.label}: its point"))
        self.check(force=partial(_law, check=numbers), moment=partial(_law, check=numbers))

    def bind(self, bodies: Bodies) -> Acting:
        """Return it as a load."""
        b, label = bodies.number(self.body, self.label), f"{self.label}: its"
        if b < 0:
            raise self.refusal("the world does not move; name a body")
        point = bodies.inside(b, self.at)
        force, by_force = _evaluator(self.force, bodies, f"{label} force", numbers)
        moment, by_moment = _evaluator(self.moment, bodies, f"{label} moment", numbers)

        def apply(time: float, q: Floats, qd: Floats, frames: Frames) -> Applied:
            wrenches = np.zeros((bodies.tree.n_bodies, 6))
            if self.force is not None:
                fx, fy, fz = force(time, q, qd, frames).tolist()
                x, y, z = (frames.rotation[b] @ point).tolist()
                wrenches[b] = y * fz - z * fy, z * fx - x * fz, x * fy - y * fx, fx, fy, fz
            if self.moment is not None:
                wrenches[b, :3] += moment(time, q, qd, frames)
            return Applied(wrenches)

        return Acting(load=Load(apply, by_force or by_moment))


@document_fields
@dataclass(frozen=True, eq=False)
class HingeTorque(Named, noun="torque"):
    """Torque at a hinge, between parent and child, or a force at a slide.

    Raises
    ------
    MechanicsError
        If the name is already in use.
    """

    hinge: str  # Name of the hinge.
    value: Any  # Torque, or a function of the time, or of the time and the :class:`State`, that returns it.

    def __post_init__(self) -> None:
        self.check(value=partial(_law, check=number))

    def bind(self, bodies: Bodies) -> Acting:
        """Return it as a load."""
        place, freedom = bodies.freedom(self.hinge, self.label)
        torque, by_state = _evaluator(self.value, bodies, f"{self.label}: its value", number)

        def apply(time: float, q: Floats, qd: Floats, frames: Frames) -> Applied:
            torques = np.zeros(bodies.tree.n_v)
            torques[freedom] = torque(time, q, qd, frames)
            return Applied(torques=torques)

        load = Load(apply, by_state)
        if not by_state:
            value = self.value
            row = HingeRow(TORQUE, place, freedom, (0.0 if callable(value) else float(value),))
            if callable(value):
                row = row._replace(motion=lambda time: (value(time), 0.0, 0.0))
            load = HingeLoad(apply, False, (row,), apply)
        return Acting(load=load, inside=True, hinges=(self.hinge,))


def _law(value: Any, label: str, check: Check) -> Any:
    """Constants as checked numbers, or a function or None as it is."""
    if value is None or (callable(value) and n_parameters(value)):
        return value
    if callable(value):
        raise MechanicsError(f"{label}: give a callable of t, or of t and state")
    return read_only(check(value, label))


def _evaluator(value: Any, bodies: Bodies, label: str, check: Check) -> tuple[Callable[..., Any], bool]:
    """A function of time, q, qd and frames, and whether it may depend on velocities."""
    by_state = callable(value) and n_parameters(value) == 2

    def evaluate(time: float, *at: Any) -> Any:
        if not callable(value):
            return value
        arguments = (time, State(bodies, time, *at)) if by_state else (time,)
        return check(answer(label, value, *arguments), label)

    return evaluate, by_state


def n_parameters(value: Callable[..., Any]) -> int:
    """Number of arguments that a callable requires, one or two, or 0 if others. Defaults do not count."""
    try:
        signature = inspect.signature(value)
    except (TypeError, ValueError):  # Some callables that are not of Python have no signature.
        return 1
    several = any(parameter.kind is parameter.VAR_POSITIONAL for parameter in signature.parameters.values())
    for n in (2, 1) if several else (1, 2):
        with suppress(TypeError):
            signature.bind(*[None] * n)
            return n
    return 0
