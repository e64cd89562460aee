"""Contact of balls with planes, surfaces and each other: laws of the normal force, and friction."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from protochain import multibody
from protochain.arrays import Floats, Integers
from protochain.errors import MechanicsError
from protochain.mechanisms.bodies import Bodies
from protochain.mechanisms.elements import Acting
from protochain.mechanisms.shapes import Ball, Finder, Plane, Surface, Touches, finder, placed
from protochain.mechanisms.springs import push, speed_of
from protochain.motion import Applied, Load
from protochain.multibody import Frames, Tree
from protochain.multibody.algebra import (
    Vector,
    add,
    dot,
    kernel,
    scale,
    subtract,
    vector,
)  # fmt: skip


@dataclass(frozen=True)
class Law:
    """Normal force F = K d^n (1 + a d') at depth d, which never pulls.

    Parameters
    ----------
    stiffness : float
        K.
    exponent : float
        n: 1.5 for round bodies (Hertz), 1 for a spring.
    damping : float
        a, time per length: see :func:`lankarani_nikravesh` and :func:`flores`.
    """

    stiffness: float
    exponent: float = 1.5
    damping: float = 0.0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.stiffness) and self.stiffness > 0.0):
            raise MechanicsError(f"the stiffness {self.stiffness:g} of a contact must be positive and finite")
        if not 1.0 <= self.exponent < np.inf:
            raise MechanicsError(f"the exponent {self.exponent:g} of a contact must be 1 or more")
        if not 0.0 <= self.damping < np.inf:
            raise MechanicsError(f"the damping {self.damping:g} of a contact must be finite, not negative")


@dataclass(frozen=True)
class Friction:
    """Friction of asperities: a spring and a damper from the point where a contact began, which slips.

    The tangential force is -(k s + c v), s from the anchor and v the velocity, and never above ``coefficient``
    times the normal force: there the anchor is dragged along.

    Parameters
    ----------
    coefficient : float
        mu.
    stiffness, damping : float
        k and c.
    """

    coefficient: float
    stiffness: float
    damping: float = 0.0

    def __post_init__(self) -> None:
        for name in ("coefficient", "stiffness", "damping"):
            if not 0.0 <= getattr(self, name) < np.inf:
                raise MechanicsError(f"the {name} of friction must be finite and not negative")


def lankarani_nikravesh(
    stiffness: float, restitution: float, speed: float, exponent: float = 1.5
) -> Law:
    """Law whose loss is that of a restitution near one, a = 3 (1 - e^2) / (4 v).

    Parameters
    ----------
    stiffness, exponent : float
        K and n of :class:`Law`.
    restitution : float
        e, 0 to 1. The real one is higher: :func:`real_restitution`.
    speed : float
        Speed of approach v for which it holds; slower impacts lose less.

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
    stiffness, exponent, speed : float
        As of :func:`lankarani_nikravesh`.
    restitution : float
        e, above 0, to 1. The real one is near it: :func:`real_restitution`.

    Returns
    -------
    Law
        Flores, Machado, Silva, Martins, Multibody Syst. Dyn. 25:357 (2011).
    """
    _refuse_restitution(restitution, np.nextafter(0.0, 1.0), speed)
    return Law(stiffness, exponent, 1.6 * (1.0 - restitution) / (restitution * speed))


def _refuse_restitution(restitution: float, least: float, speed: float) -> None:
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
        c = a v, of the damping and the speed of approach.

    Returns
    -------
    float
        r that solves c - ln(1 + c) = -c r - ln(1 - c r): both sides are the same integral of v dv / (1 + a v),
        equal to that of K d^n / m over the depth, in compression and in restitution.

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


@dataclass(frozen=True, eq=False)
class Contact:
    """Balls that touch a plane, a surface, other balls or each other; an element of a mechanism.

    Parameters
    ----------
    balls : sequence of Ball
        Balls.
    other : Plane, Surface or sequence of Ball, optional
        What they touch; by default each other.
    law : Law
        Normal force.
    friction : Friction, optional
        Tangential force; none by default.
    name : str
        Name, for messages.
    """

    balls: Sequence[Ball]
    other: Plane | Surface | Sequence[Ball] | None
    law: Law
    friction: Friction | None = None
    name: str = "contact"

    def bind(self, bodies: Bodies) -> Acting:
        """Return the elastic force with its energy, damping and friction as a load, and anchors between steps.

        Raises
        ------
        MechanicsError
            If a body is not there, or a shape cannot be touched.
        """
        found = finder(bodies, self.balls, self.other, self.name)
        pressing = Pressing(bodies.tree, found, self.law, self.friction)
        loses = self.law.damping > 0.0 or self.friction is not None
        return Acting(
            conservative=pressing,
            load=Load(pressing.resist) if loses else None,
            dissipates=loses,
            inside=pressing.is_inside,
            memory=pressing,
        )


@dataclass(frozen=True, eq=False)
class Anchors:
    """Where springs of friction begin: pairs (k, 2), and in each body's frame the ends (k, 6) of the spring."""

    pair: Integers
    arms: Floats


NO_ANCHORS = Anchors(np.empty((0, 2), np.int64), np.empty((0, 6)))


class Pressing:
    """A contact in a mechanism. What changes in a run is the anchors, after each of its steps.

    Parameters
    ----------
    tree : Tree
        Rigid bodies.
    finder : Finder
        Where they touch.
    law : Law
        Normal force.
    friction : Friction, optional
        Tangential force.
    """

    def __init__(self, tree: Tree, finder: Finder, law: Law, friction: Friction | None) -> None:
        self.tree, self.finder, self.law, self.friction = tree, finder, law, friction
        self.anchors = NO_ANCHORS
        self._last: tuple[Frames, Touches] | None = None

    @property
    def is_inside(self) -> bool:
        """Whether all forces act between bodies of the mechanism."""
        return bool((self.finder.balls.body >= 0).all() and getattr(self.finder, "body", 0) >= 0)

    def touches(self, frames: Frames) -> Touches:
        """Touches at one pose, which are asked for by the elastic force and the load."""
        if self._last is None or self._last[0] is not frames:
            self._last = frames, self.finder.touches(frames)
        return self._last[1]

    def add(self, q: Floats, frames: Frames, wrenches: Floats, torques: Floats) -> float:
        """Add the elastic forces."""
        _, ends, place, normal, depth = self.touches(frames)
        energy: float = _press(
            frames.origin, ends, place, normal, depth, self.law.stiffness, self.law.exponent, wrenches
        )
        return energy

    def resist(self, time: float, q: Floats, qd: Floats, frames: Frames) -> Applied:
        """Damping and friction."""
        touches = self.touches(frames)
        wrenches = np.zeros((self.tree.n_bodies, 6))
        if len(touches.pair):
            stretch, _ = self.stretches(frames, touches)
            twists = multibody.velocities(self.tree, frames, qd)
            _resist(frames.origin, twists, touches, stretch, _numbers(self.law, self.friction), wrenches)
        return Applied(wrenches)

    def stretches(self, frames: Frames, touches: Touches) -> tuple[Floats, Integers]:
        """(k, 3) float: springs of friction, zero where none has been anchored; (k,) int: their anchors."""
        anchor = _matches(touches.pair, self.anchors.pair)
        arms = self.anchors.arms[anchor]
        (turn_a, at_a), (turn_b, at_b) = (placed(frames, body) for body in touches.ends.T)
        apart = at_a - at_b + np.einsum("nij,nj->ni", turn_a, arms[:, :3])
        apart -= np.einsum("nij,nj->ni", turn_b, arms[:, 3:])
        apart[anchor < 0] = 0.0
        apart -= np.sum(apart * touches.normal, axis=1)[:, None] * touches.normal
        return apart, anchor

    def forget(self) -> None:
        """Begin a run."""
        self.anchors, self._last = NO_ANCHORS, None

    def settle(self, time: float, q: Floats, qd: Floats, frames: Frames) -> None:
        """End a step: drag anchors along, and set those of new touches.

        Raises
        ------
        MechanicsError
            If a touch is so deep that its direction means nothing.
        """
        touches = self.touches(frames)
        self.finder.refuse_depth(touches)
        if self.friction is None or not len(touches.pair):
            self.anchors = NO_ANCHORS
            return
        stretch, _ = self.stretches(frames, touches)
        twists = multibody.velocities(self.tree, frames, qd)
        _drag(frames.origin, twists, touches, stretch, _numbers(self.law, self.friction))
        (turn_a, at_a), (turn_b, at_b) = (placed(frames, body) for body in touches.ends.T)
        # Anchored anew at the present place, lest a ball that rolls be taken for one that slips.
        arm_a = np.einsum("nji,nj->ni", turn_a, touches.place - at_a)
        arm_b = np.einsum("nji,nj->ni", turn_b, touches.place - stretch - at_b)
        self.anchors = Anchors(touches.pair, np.column_stack([arm_a, arm_b]))


def _numbers(law: Law, friction: Friction | None) -> Floats:
    """K, n, a, mu, k, c."""
    rub = (0.0, 0.0, 0.0) if friction is None else (friction.coefficient, friction.stiffness, friction.damping)
    return np.array([law.stiffness, law.exponent, law.damping, *rub])
