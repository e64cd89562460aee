"""Contact of balls with planes, surfaces and each other: laws of the normal force, and friction."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from scipy.optimize import brentq

from protochain.core.arrays import read_only
from protochain.core.checks import brief
from protochain.core.errors import MechanicsError
from protochain.core.settings import document_fields
from protochain.mechanics.motion import Load
from protochain.mechanisms.bodies import Bodies
from protochain.mechanisms.contact_forces import ContactForces
from protochain.mechanisms.element_arguments import number
from protochain.mechanisms.elements import Acting, Named
from protochain.mechanisms.shapes import Ball, Obstacle, OnPlane, Other, finder


@document_fields
@dataclass(frozen=True)
class Law:
    """Normal force F = K d^n (1 + a d') at depth d, which never pulls."""

    stiffness: float  # Stiffness K, force by depth to the power n.
    exponent: float = 1.5  # Power n: 1.5 for round bodies (Hertz), 1 for a spring.
    damping: float = 0.0  # Damping a, time by length: see :func:`lankarani_nikravesh` and :func:`flores`.

    def __post_init__(self) -> None:
        _check_numbers(self, "of a contact")
        if not (np.isfinite(self.stiffness) and self.stiffness > 0.0):
            raise MechanicsError(f"the stiffness {self.stiffness:g} of a contact must be positive and finite")
        if not 1.0 <= self.exponent < np.inf:
            raise MechanicsError(f"the exponent {self.exponent:g} of a contact must be 1 or more")
        if not 0.0 <= self.damping < np.inf:
            raise MechanicsError(f"the damping {self.damping:g} of a contact must be finite, not negative")


@document_fields
@dataclass(frozen=True)
class Friction:
    """Friction of asperities: a spring and a damper from the point at which a contact began, which slips.

    The tangential force is -(k s + c v), s from the anchor and v the velocity, and never above
    ``coefficient`` times the normal force: there the anchor is dragged along.
    """

    coefficient: float  # Largest tangential force by normal force.
    stiffness: float  # Stiffness k of the spring.
    damping: float = 0.0  # Constant c of the damper.

    def __post_init__(self) -> None:
        _check_numbers(self, "of friction")
        for name in ("coefficient", "stiffness", "damping"):
            if not 0.0 <= getattr(self, name) < np.inf:
                raise MechanicsError(f"the {name} of friction must be finite and not negative")


def _check_numbers(law: Law | Friction, label: str) -> None:
    """Make numbers of the fields."""
    for column in fields(law):
        object.__setattr__(law, column.name, number(getattr(law, column.name), f"the {column.name} {label}"))


def lankarani_nikravesh(stiffness: float, restitution: float, speed: float, exponent: float = 1.5) -> Law:
    """Law with the loss of a restitution near one, a = 3 (1 - e^2) / (4 v).

    Parameters
    ----------
    stiffness : float
        Stiffness of :class:`Law`.
    restitution : float
        Restitution e, 0 to 1. The real one is higher: :func:`real_restitution`.
    speed : float
        Speed of approach v for which it is exact. Slower impacts lose less.
    exponent : float
        Exponent of :class:`Law`.

    Returns
    -------
    Law
        Lankarani, Nikravesh, J. Mech. Des. 112:369 (1990).
    """
    _refuse_restitution(restitution, 0.0, speed)
    return Law(stiffness, exponent, 0.75 * (1.0 - restitution**2) / speed)


def flores(stiffness: float, restitution: float, speed: float, exponent: float = 1.5) -> Law:
    """Law for any restitution but zero, a = 8 (1 - e) / (5 e v).

    Parameters
    ----------
    stiffness : float
        Stiffness of :class:`Law`.
    restitution : float
        Restitution e, above 0, to 1. The real one is near it: :func:`real_restitution`.
    speed : float
        Speed of approach v for which it is exact. Slower impacts lose less.
    exponent : float
        Exponent of :class:`Law`.

    Returns
    -------
    Law
        Flores, Machado, Silva, Martins, Multibody Syst. Dyn. 25:357 (2011).
    """
    _refuse_restitution(restitution, np.nextafter(0.0, 1.0), speed)
    return Law(stiffness, exponent, 1.6 * (1.0 - restitution) / (restitution * speed))


def _refuse_restitution(restitution: float, least: float, speed: float) -> None:
    number(restitution, "the restitution")
    number(speed, "the speed of approach")
    if not least <= restitution <= 1.0:
        above = "0 to 1" if least == 0.0 else "above 0, to 1 (its damping has no end at 0)"
        raise MechanicsError(f"the restitution {restitution:g} must be {above}")
    if not 0.0 < speed < np.inf:
        raise MechanicsError(f"the speed {speed:g} of approach must be positive and finite")


def real_restitution(loss: float) -> float:
    """Ratio of the speeds after and before an impact by F = K d^n (1 + a d'), whatever K, n and the masses.

    Parameters
    ----------
    loss : float
        Damping by speed of approach, c = a v.

    Returns
    -------
    float
        Root r of c - ln(1 + c) = -c r - ln(1 - c r): both sides are integrals of v dv / (1 + a v), equal
        to the integral of K d^n / m over the depth, in compression and in restitution.

    Raises
    ------
    MechanicsError
        If c is negative or not finite.
    """
    if not 0.0 <= loss < np.inf:
        raise MechanicsError(f"the loss {loss:g} of an impact must be finite and not negative")
    if loss < 1e-5:
        return 1.0 - 2.0 * loss / 3.0 + 4.0 * loss**2 / 9.0
    spent = float(loss - np.log1p(loss))
    if spent > 30.0:
        return (1.0 - float(np.exp(-1.0 - spent))) / loss

    def excess(out: float) -> float:
        return float(-out - np.log1p(-out)) - spent

    return float(brentq(excess, 0.0, min(loss, 1.0 - 1e-16), xtol=1e-16)) / loss


@document_fields
@dataclass(frozen=True, eq=False)
class Contact(Named, noun="contact"):
    """Balls that touch a plane, a surface, other balls or each other."""

    # Balls, or points, fixed in bodies. Those of one body do not touch each other.
    balls: Sequence[Ball]
    other: Other  # Obstacle of the balls: Plane, Surface, sequence of Ball, or None for each other.
    law: Law  # Normal force.
    friction: Friction | None = None  # Tangential force, none by default.

    def __post_init__(self) -> None:
        self.fix(balls=self._balls(self.balls, "balls"))
        if not isinstance(self.other, Obstacle):
            self.fix(other=self._balls(self.other, "other"))
        for name, kind, remedy in (
            ("law", Law, "a Law, as flores(1e6, 0.5, 1.0)"),
            ("friction", Friction | None, "a Friction, or none"),
        ):
            if not isinstance(getattr(self, name), kind):
                raise self.refusal(f"{name} {brief(getattr(self, name))}: give {remedy}")

    def _balls(self, value: Any, name: str) -> tuple[Ball, ...]:
        balls = tuple(value) if isinstance(value, Iterable) else (None,)
        if not all(isinstance(ball, Ball) for ball in balls):
            remedy = 'a list of balls, as [Ball("wheel", 0.1)]'
            also = ", a plane, a surface, or None" if name == "other" else ""
            raise self.refusal(f"{name} {brief(value)}: give {remedy}{also}")
        return balls

    def bind(self, bodies: Bodies) -> Acting:
        """Return the elastic force with its energy, the rest as a load, and the anchors of friction."""
        source = finder(bodies, self.balls, self.other, self.label)
        law, rub = self.law, self.friction or Friction(0.0, 0.0)
        constants = (law.stiffness, law.exponent, law.damping, rub.coefficient, rub.stiffness, rub.damping)
        forces = ContactForces(bodies.tree, source, read_only(constants))
        loses = law.damping > 0.0 or rub.coefficient > 0.0
        load = Load(forces.resist) if loses else None
        # Anchors of friction, and balls that may pass through their obstacle, are looked at after each step.
        memory = forces if rub.coefficient > 0.0 or not isinstance(source, OnPlane) else None
        inside = bool((source.balls.body >= 0).all() and source.body >= 0)
        return Acting(forces, load, dissipates=loses, inside=inside, memory=memory)
