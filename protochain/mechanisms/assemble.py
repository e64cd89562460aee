"""Bodies and hinges by name -> a tree, each body with its frame along its hinge."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from protochain.arrays import Floats, Integers, read_only
from protochain.errors import MechanicsError
from protochain.mechanisms.bodies import WORLD, Bodies
from protochain.multibody import HingeKind, Tree
from protochain.multibody.tree import NO_INERTIA

KINDS = {
    "revolute": HingeKind.REVOLUTE,
    "prismatic": HingeKind.PRISMATIC,
    "screw": HingeKind.SCREW,
    "fixed": HingeKind.FIXED,
}


@dataclass(frozen=True, eq=False)
class Body:
    """A body as given: mass, centre of mass, inertia (3, 3); where it starts, if it is free."""

    mass: float
    com: Floats
    inertia: Floats
    position: Floats
    rotation: Floats
    velocity: Floats
    spin: Floats
    says_where: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Hinge:
    """A hinge as given."""

    parent: str
    child: str
    kind: str
    at: Floats
    axis: Floats
    rotation: Floats
    q: float
    qd: float
    pitch: float


def assemble(
    bodies: Mapping[str, Body], hinges: Mapping[str, Hinge], driven: Mapping[str, tuple[float, float]]
) -> tuple[Bodies, Floats, Floats]:
    """Return the bodies of a tree, and coordinates (n_q,) and velocities (n_v,) at the start.

    ``driven`` has the coordinate and rate of driven hinges at the start.

    Raises
    ------
    MechanicsError
        If bodies and hinges are no trees, or a body has no inertia that its hinge needs.
    """
    inward = _inward(bodies, hinges)
    order = _ordered(bodies, hinges, inward)
    place = {name: number for number, name in enumerate(order)} | {WORLD: -1}
    n = len(order)
    parent, kind, pitch = np.full(n, -1), np.full(n, HingeKind.FREE), np.zeros(n)
    offset, placement, turn = np.zeros((n, 3)), np.tile(np.eye(3), (n, 1, 1)), np.tile(np.eye(3), (n, 1, 1))
    q, qd = [], []
    for b, name in enumerate(order):
        body = bodies[name]
        if name not in inward:
            q += [*quaternion(body.rotation), *body.position]
            qd += [*body.spin, *body.velocity]
            continue
        hinge = hinges[inward[name]]
        parent[b], kind[b], pitch[b] = place[hinge.parent], KINDS[hinge.kind], hinge.pitch
        above = turn[parent[b]] if parent[b] >= 0 else np.eye(3)
        if hinge.kind != "fixed":
            turn[b] = with_z_along(hinge.rotation.T @ hinge.axis)
            start = driven.get(inward[name], (hinge.q, hinge.qd))
            q.append(start[0])
            qd.append(start[1])
        offset[b], placement[b] = above.T @ hinge.at, above.T @ hinge.rotation @ turn[b]
    given = [bodies[name] for name in order]
    _refuse_free_needles(order, parent, kind, given)
    more: dict[str, Any] = {}
    if driven:
        more["driven"] = np.array([inward.get(name) in driven for name in order])
    try:
        tree = Tree(
            parent, kind, offset, placement, np.array([body.mass for body in given]),
            np.array([t.T @ body.com for t, body in zip(turn, given, strict=True)]),
            np.array([t.T @ body.inertia @ t for t, body in zip(turn, given, strict=True)]), pitch, **more,
        )  # fmt: skip
    except MechanicsError as error:
        raise MechanicsError(by_name(str(error), order)) from None
    numbers = {hinge: place[each.child] for hinge, each in hinges.items()}
    return Bodies(tree, order, read_only(turn), numbers), read_only(q), read_only(qd)


def _refuse_free_needles(
    names: tuple[str, ...], parent: Integers, kind: Integers, bodies: Sequence[Body]
) -> None:
    """Raise if a free body without others on it can turn about an axis without inertia."""
    with_others = set(parent.tolist())
    for b, body in enumerate(bodies):
        if kind[b] != HingeKind.FREE or b in with_others:
            continue
        moments = np.linalg.eigvalsh(body.inertia)
        if body.mass > 0.0 and moments[0] <= NO_INERTIA * np.sum(moments):
            raise MechanicsError(
                f'body "{names[b]}": it is free, and nothing resists its turning; give it an inertia about '
                "all axes, or hinges that do not turn it"
            )


def by_name(message: str, names: tuple[str, ...]) -> str:
    """Return a message with the name of the body in place of the number with which it begins."""
    head, colon, rest = message.partition(":")
    number = head.removeprefix("body ")
    if not colon or head == number or not number.isdigit() or int(number) >= len(names):
        return message
    return f'body "{names[int(number)]}":{rest}'


def with_z_along(axis: Floats) -> Floats:
    """(3, 3) float: axes, as columns, of which the third is along a vector of length one."""
    if np.array_equal(axis, [0.0, 0.0, 1.0]):
        return np.eye(3)
    x = np.cross(np.eye(3)[int(np.argmin(np.abs(axis)))], axis)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(axis, x), axis])


def quaternion(rotation: Floats) -> Floats:
    """(4,) float: unit quaternion (w, x, y, z) of a rotation, w not negative."""
    r = rotation
    # Row i is the quaternion times four times its i-th component: the longest has no cancellation.
    rows = np.array([
        [1 + r[0, 0] + r[1, 1] + r[2, 2], r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]],
        [r[2, 1] - r[1, 2], 1 + r[0, 0] - r[1, 1] - r[2, 2], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0]],
        [r[0, 2] - r[2, 0], r[0, 1] + r[1, 0], 1 - r[0, 0] + r[1, 1] - r[2, 2], r[1, 2] + r[2, 1]],
        [r[1, 0] - r[0, 1], r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], 1 - r[0, 0] - r[1, 1] + r[2, 2]],
    ])  # fmt: skip
    lengths = np.linalg.norm(rows, axis=1)
    best = int(np.argmax(lengths))
    found = rows[best] / lengths[best]
    return np.asarray(found if found[0] >= 0.0 else -found)


def _inward(bodies: Mapping[str, Body], hinges: Mapping[str, Hinge]) -> dict[str, str]:
    """Body -> its inward hinge."""
    inward: dict[str, str] = {}
    known = ", ".join(f'"{name}"' for name in list(bodies)[:12])
    for name, hinge in hinges.items():
        for role, body in (("parent", hinge.parent), ("child", hinge.child)):
            if body not in bodies and (role, body) != ("parent", WORLD):
                raise MechanicsError(
                    f'hinge "{name}": its {role} "{body}" is no body; there are {known}; add it by body()'
                    if body != WORLD
                    else f'hinge "{name}": the world cannot be a child; swap parent and child'
                )
        if hinge.child in inward:
            raise MechanicsError(
                f'body "{hinge.child}" has two inward hinges, "{inward[hinge.child]}" and "{name}"; '
                "bodies form trees: close a loop by a bushing"
            )
        inward[hinge.child] = name
        strange = bodies[hinge.child].says_where
        if strange:
            raise MechanicsError(
                f'body "{hinge.child}": {strange[0]} is of free bodies only, and hinge "{name}" holds it; '
                "give q and qd of the hinge"
            )
    return inward


def _ordered(
    bodies: Mapping[str, Body], hinges: Mapping[str, Hinge], inward: Mapping[str, str]
) -> tuple[str, ...]:
    """Names such that parents come before children, and branches stay together."""
    children: dict[str, list[str]] = {name: [] for name in (WORLD, *bodies)}
    for name in bodies:
        children[hinges[inward[name]].parent if name in inward else WORLD].append(name)
    order, waiting = [], [WORLD]
    while waiting:
        name = waiting.pop()
        order.append(name)
        waiting += reversed(children[name])
    found = set(order)
    left = [name for name in bodies if name not in found]
    if left:
        raise MechanicsError(
            f'body "{left[0]}" hangs on itself: hinge "{inward[left[0]]}" is part of a loop of hinges; '
            "open it, and close it by a bushing"
        )
    return tuple(order[1:])
