"""Motion with events: moments at which a function of the state falls through zero, and what happens there."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from scipy.optimize import brentq

from protochain.core.errors import Fault, MechanicsError
from protochain.mechanics.motion.system import Equations, Integrator, Phase

_SAME_TIME = 1e-12
"""Error of the time of an event, relative to the time step."""
_SHORTEST = 2.0**-30
"""Shortest time between two events of one kind, relative to the time step."""


@dataclass(frozen=True, eq=False)
class Event:
    """Something that happens when a value falls through zero."""

    name: str  # Name, for messages.
    value: Callable[[Phase], float]  # Phase -> float: positive before the event.
    # System, phase -> phase from which the motion goes on, at the same time: with other velocities by
    # :meth:`Equations.with_velocities`.
    jump: Callable[[Any, Phase], Phase]
    # Whether the motion goes on below zero, as past a mark. Otherwise the value must rise again.
    passes: bool = False


def march(
    system: Equations,
    integrator: Integrator,
    at: Phase,
    until: float,
    time_step: float,
    events: Sequence[Event] = (),
) -> Iterator[tuple[Phase, Event | None]]:
    """Advance to a time, stopping at events."""
    # The time of an event is found by Brent's method on the length of the last step, to 1e-12 of a step; of
    # several in one step the earliest is taken; those of one time follow each other in the order given.
    if not time_step > 0.0:
        raise MechanicsError(f"the time step {time_step:g} must be positive")
    fired: tuple[Event, ...] = ()
    while until - at.time > _SAME_TIME * time_step:
        h, after = _past(system, integrator, at, min(time_step, until - at.time), fired)
        # Rounding may leave an event that has been passed just above zero.
        passed = {id(event) for event in fired if event.passes}
        falling = [e for e in events if id(e) not in passed and e.value(at) >= 0.0 > e.value(after)]
        if not falling:
            at, fired = after, ()
            yield at, None
            continue
        moments = [_moment(system, integrator, at, h, event, time_step) for event in falling]
        first = min(moments)
        at = integrator.step(system, at, first) if first > 0.0 else at
        fired = tuple(
            e for e, s in zip(falling, moments, strict=True) if s - first <= 2.0 * _SAME_TIME * time_step
        )
        for event in fired:
            at = event.jump(system, at)
            yield at, event


def _past(
    system: Equations, integrator: Integrator, at: Phase, h: float, fired: tuple[Event, ...]
) -> tuple[float, Phase]:
    """Take the longest of the steps h, h/2, h/4 ... after which events just past have risen above zero."""
    length = h
    while length > _SHORTEST * h:
        after = integrator.step(system, at, length)
        low = [event for event in fired if not (event.passes or event.value(after) > 0.0)]
        if not low:
            return length, after
        length *= 0.5
    raise MechanicsError(
        f"{low[0].name}: its value is not above zero after its jump at time {at.time:g}; "
        "let the jump raise the value, or remove this event",
        fault=Fault.ENDLESS,
    )


def _moment(
    system: Equations, integrator: Integrator, at: Phase, h: float, event: Event, time_step: float
) -> float:
    """Length of the step at whose end the value is zero."""

    def value(length: float) -> float:
        return event.value(integrator.step(system, at, length) if length > 0.0 else at)

    return float(brentq(value, 0.0, h, xtol=_SAME_TIME * time_step))
