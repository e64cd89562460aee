"""Forces and moments on bodies, and torques at hinges: constants, or functions of time and state."""

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from protochain.core.arrays import Floats, read_only
from protochain.core.errors import MechanicsError
from protochain.mechanics.motion import Applied, Load
from protochain.mechanics.multibody import Frames
from protochain.mechanisms.bodies import Bodies, State
from protochain.mechanisms.element_arguments import answer, number, numbers
from protochain.mechanisms.elements import Acting, Named


@dataclass(frozen=True, eq=False)
class AppliedForce(Named):
    """Force at a point of a body, a moment, or both.

    Parameters
    ----------
    name, body : str
        Name of the load, and name of the body.
    at : (3,) array_like
        Point of the body at which the force acts.
    force, moment : (3,) array_like or callable, optional
        Along world axes, or a function of the time, or of the time and the :class:`State`, that returns it.

    Raises
    ------
    MechanicsError
        If the name is already in use, or nothing acts.
    """

    noun: ClassVar[str] = "load"

    body: str
    at: ArrayLike = (0.0, 0.0, 0.0)
    force: Any = None
    moment: Any = None

    def __post_init__(self) -> None:
        if self.force is None and self.moment is None:
            raise MechanicsError(f"{self.label}: it has no effect; give a force or a moment")
        self.fix(
            at=numbers(self.at, (3,), f"{self.label}: its point"),
            force=_law(self.force, (3,), f"{self.label}: its force"),
            moment=_law(self.moment, (3,), f"{self.label}: its moment"),
        )

    def bind(self, bodies: Bodies) -> Acting:
        """Return it as a load."""
        b, label = bodies.number(self.body, self.label), f"{self.label}: its"
        if b < 0:
            raise MechanicsError(f"{self.label}: the world does not move; name a body")
        point = bodies.inside(b, self.at)
        force, by_force = _of_state(self.force)
        moment, by_moment = _of_state(self.moment)

        def evaluate(quantity: str, function: Callable[..., Any], *arguments: Any) -> Floats:
            return numbers(answer(f"{label} {quantity}", function, *arguments), (3,), f"{label} {quantity}")

        def apply(time: float, q: Floats, qd: Floats, frames: Frames) -> Applied:
            def state() -> State:
                return State(bodies, time, q, qd, frames)

            wrenches = np.zeros((bodies.tree.n_bodies, 6))
            if self.force is not None:
                fx, fy, fz = evaluate("force", force, time, state).tolist()
                x, y, z = (frames.rotation[b] @ point).tolist()
                wrenches[b] = y * fz - z * fy, z * fx - x * fz, x * fy - y * fx, fx, fy, fz
            if self.moment is not None:
                wrenches[b, :3] += evaluate("moment", moment, time, state)
            return Applied(wrenches)

        return Acting(load=Load(apply, by_force or by_moment))


@dataclass(frozen=True, eq=False)
class HingeTorque(Named):
    """Torque at a hinge, between parent and child, or a force at a slide.

    Parameters
    ----------
    name, hinge : str
        Name of the torque, and name of the hinge.
    value : float or callable
        Torque, or a function of the time, or of the time and the :class:`State`, that returns it.

    Raises
    ------
    MechanicsError
        If the name is already in use.
    """

    noun: ClassVar[str] = "torque"

    hinge: str
    value: Any

    def __post_init__(self) -> None:
        self.fix(value=_law(self.value, (), f"{self.label}: its value"))

    def bind(self, bodies: Bodies) -> Acting:
        """Return it as a load."""
        freedom, label = bodies.freedom(self.hinge, self.label)[1], f"{self.label}: its value"
        value, by_state = _of_state(self.value)

        def apply(time: float, q: Floats, qd: Floats, frames: Frames) -> Applied:
            torques = np.zeros(bodies.tree.n_v)
            torque = answer(label, value, time, lambda: State(bodies, time, q, qd, frames))
            torques[freedom] = number(torque, label)
            return Applied(torques=torques)

        return Acting(load=Load(apply, by_state), inside=True, hinges=(self.hinge,))


def _law(value: Any, shape: tuple[int, ...], label: str) -> Any:
    """Constants as checked numbers of a shape, or a function or None as it is."""
    if value is None or (callable(value) and n_parameters(value)):
        return value
    if callable(value):
        raise MechanicsError(f"{label}: give a callable of t, or of t and state")
    return read_only(numbers(value, shape, label))


def _of_state(value: Any) -> tuple[Callable[..., Any], bool]:
    """A function of time and a maker of states, and whether it may depend on velocities."""
    if not callable(value):
        return (lambda time, state: value), False
    if n_parameters(value) == 1:
        return (lambda time, state: value(time)), False
    return (lambda time, state: value(time, state())), True


def n_parameters(value: Callable[..., Any]) -> int:
    """Number of arguments that a callable requires, one or two, or 0 if others. Defaults do not count."""
    try:
        parameters = inspect.signature(value).parameters.values()
    except (TypeError, ValueError):  # Some callables that are not of Python have no signature.
        return 1
    kinds = [parameter.kind for parameter in parameters if parameter.default is parameter.empty]
    if inspect.Parameter.KEYWORD_ONLY in kinds:
        return 0
    if inspect.Parameter.VAR_POSITIONAL in kinds:
        return 2
    needed = len([kind for kind in kinds if kind is not inspect.Parameter.VAR_KEYWORD])
    # A default of the time itself is none that matters.
    return needed if 1 <= needed <= 2 else int(not needed and _takes_one(value))


def _takes_one(value: Callable[..., Any]) -> bool:
    """Whether a callable can be called with the time."""
    try:
        inspect.signature(value).bind(None)
    except TypeError:
        return False
    return True
