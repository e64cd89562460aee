"""Bodies and hinges by name -> a tree, each body with its frame along its hinge."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from protochain.core.arrays import Floats, Integers, read_only
from protochain.core.checks import brief, optional
from protochain.core.errors import BodyError, MechanicsError
from protochain.core.settings import document_fields
from protochain.mechanics.multibody import HingeKind, Tree
from protochain.mechanics.multibody.tree import BALL_PLACEMENT, NO_INERTIA
from protochain.mechanisms.bodies import WORLD, Bodies
from protochain.mechanisms.element_arguments import amount, direction, number, numbers, rotation_matrix
from protochain.mechanisms.elements import Named

KINDS = {kind: HingeKind[kind.upper()] for kind in ("revolute", "prismatic", "screw", "ball", "fixed")}
_TURNING = ("revolute", "screw")

_LOG = logging.getLogger(__name__)
NOWHERE = (0.0, 0.0, 0.0)
_OF_FREE_BODIES = ("position", "rotation", "velocity", "spin")


@document_fields
@dataclass(frozen=True, eq=False)
class Body(Named, noun="body"):
    """A body. Without a hinge it is free."""

    mass: float  # Mass. Zero if a body further out has some that its hinge moves.
    # (3,) float: Centre of mass, from the body's origin in its own axes. The origin lies on the body's hinge.
    com: Any = NOWHERE
    inertia: Any = 0.0  # Tensor about the centre of mass, or its diagonal, or one moment for all axes.
    position: Any = None  # (3,) float, optional: Origin of a free body at the start.
    rotation: Any = None  # (3, 3) float, optional: Axes of a free body in the world, as columns.
    velocity: Any = None  # (3,) float, optional: Velocity of the origin of a free body, world axes.
    spin: Any = None  # (3,) float, optional: Angular velocity of a free body, world axes.
    # Inertia that a free body has in addition in all of its six freedoms, without weight.
    armature: float = 0.0
    nominal: ClassVar[bool] = False

    def __post_init__(self) -> None:
        self.check(armature=amount, mass=amount)
        self.fix(com=numbers(self.com, f"{self.label}: its centre of mass"))
        self.check(inertia=_inertia, rotation=optional(rotation_matrix))
        self.check(position=optional(numbers), velocity=optional(numbers), spin=optional(numbers))


class NominalBody(Body):
    """A body whose inertia is used as it is, though no distribution of mass has it."""

    nominal: ClassVar[bool] = True


@document_fields
@dataclass(frozen=True, eq=False)
class Hinge(Named, noun="hinge"):
    """A hinge, which joins a body to its parent. A body has one inward hinge."""

    parent: str  # Body, or "world".
    child: str  # Body.
    kind: str = "revolute"  # Kind of its motion: ``revolute``, ``prismatic``, ``screw``, ``ball``, ``fixed``.
    at: Any = NOWHERE  # (3,) float: Origin of the child at q = 0, in the parent's axes.
    axis: Any = (0.0, 0.0, 1.0)  # (3,) float: Axis of the hinge, in the parent's axes.
    # (3, 3) float, optional: Axes of the child at q = 0, as columns, in the parent's axes. Equal by default.
    rotation: Any = None
    q: Any = 0.0  # Coordinate at the start, of a ball a rotation vector.
    qd: Any = 0.0  # Rate at the start, of a ball the child's angular velocity.
    pitch: float = 0.0  # Slide of a screw per radian.
    # Inertia of the rotor of a motor as the hinge feels it, by radian: of each freedom of a ball.
    armature: float = 0.0

    def __post_init__(self) -> None:
        label = f"{self.label}: its"
        if not (isinstance(self.kind, str) and self.kind in KINDS):
            *kinds, last = KINDS
            raise MechanicsError(f"{label} kind {brief(self.kind)}: give {', '.join(kinds)} or {last}")
        coordinate = _rotation_vector if self.kind == "ball" else number
        self.check(pitch=number, armature=amount, q=coordinate, qd=coordinate)
        if (self.kind == "screw") != (self.pitch != 0.0):
            raise MechanicsError(
                f"{label} pitch is zero; give a pitch, or kind revolute"
                if self.kind == "screw"
                else f"{label} pitch applies to screws only; give kind screw"
            )
        if self.kind == "fixed" and (self.q or self.qd or self.armature):
            raise MechanicsError(
                f"{label} q, qd and armature must be zero as it is fixed; give a rotation, or another kind"
            )
        self.fix(at=numbers(self.at, f"{label} place"))
        self.fix(rotation=np.eye(3) if self.rotation is None else self.rotation)
        self.check(axis=direction, rotation=rotation_matrix)


def assemble(
    bodies: Mapping[str, Body], hinges: Mapping[str, Hinge], driven: Mapping[str, tuple[float, float]],
    gravity: Floats, degrees: bool,
) -> Bodies:  # fmt: skip
    """Return the bodies of a tree: ``driven`` has the coordinate and rate of driven hinges at the start."""
    inward, hinge_names = _inward(bodies, hinges), list(hinges)
    bodies, hinges, inward = _with_axes_of_balls(bodies, hinges, inward)
    order = _order_hinges(bodies, hinges, inward)
    place = {name: number for number, name in enumerate(order)} | {WORLD: -1}
    n, listed = len(order), [bodies[name] for name in order]
    parent, kind, pitch, armature = np.full(n, -1), np.full(n, HingeKind.FREE), np.zeros(n), np.zeros(n)
    at, axis, rotation = np.zeros((n, 3)), np.tile([0.0, 0.0, 1.0], (n, 1)), np.tile(np.eye(3), (n, 1, 1))
    q, qd = [], []
    for b, (name, body) in enumerate(zip(order, listed, strict=True)):
        if name not in inward:
            turned = np.eye(3) if body.rotation is None else body.rotation
            q += [*quaternion(turned), *_or_still(body.position)]
            qd += [*_or_still(body.spin), *_or_still(body.velocity)]
            armature[b] = body.armature
            continue
        hinge = hinges[inward[name]]
        # Bodies between the axes of a ball have the name of the ball, and are inside it.
        kind[b] = HingeKind.BALL_AXIS if isinstance(hinge, _BallAxis) else KINDS[hinge.kind]
        parent[b], pitch[b], armature[b] = place[hinge.parent], hinge.pitch, hinge.armature
        at[b], axis[b], rotation[b] = hinge.at, hinge.axis, hinge.rotation
        unit = np.pi / 180.0 if degrees and hinge.kind in (*_TURNING, "ball") else 1.0
        if hinge.kind in _TURNING and abs(hinge.q * unit) > 2.0 * np.pi:
            inside = "degrees" if degrees else "radians; see np.radians, or units"
            _LOG.warning("%s: its q %g is more than a turn: angles are %s", hinge.label, hinge.q, inside)
        start = driven.get(hinge.name, (unit * hinge.q, unit * hinge.qd))
        # The coordinates and rates of a ball are those of its first body.
        if not (hinge.kind == "fixed" or isinstance(hinge, _BallAxis)):
            q += [*start[0]] if hinge.kind == "ball" else [start[0]]
            qd += [*start[1]] if hinge.kind == "ball" else [start[1]]
    turn = axes_along(np.einsum("bji,bj->bi", rotation, axis))
    turn[np.isin(kind, [HingeKind.FREE, HingeKind.FIXED, HingeKind.BALL, HingeKind.BALL_AXIS])] = np.eye(3)
    above = np.where((parent < 0)[:, None, None], np.eye(3), turn[parent]).swapaxes(1, 2)
    offset, placement = np.einsum("bij,bj->bi", above, at), above @ rotation @ turn
    back = turn.swapaxes(1, 2)
    _refuse_free_needles(order, parent, kind, listed)
    options: dict[str, Any] = {"armature": armature, "nominal": np.array([body.nominal for body in listed])}
    if driven:
        options["driven"] = np.array([inward.get(name) in driven for name in order])
    try:
        tree = Tree(
            parent, kind, offset, placement, np.array([body.mass for body in listed]),
            np.einsum("bij,bj->bi", back, np.array([body.com for body in listed])),
            back @ np.array([body.inertia for body in listed]) @ turn, pitch, **options,
        )  # fmt: skip
    except BodyError as error:
        raise error.by_name(order) from None
    beyond = {name: place[hinges[name].child] for name in hinge_names}
    return Bodies(
        tree, order, read_only(turn), beyond, read_only(q), read_only(qd), gravity=read_only(gravity),
        degrees=degrees,
    )  # fmt: skip


class _BallAxis(Hinge):
    """Second and third axis of a ball."""


def _with_axes_of_balls(
    bodies: Mapping[str, Body], hinges: Mapping[str, Hinge], inward: dict[str, str]
) -> tuple[Mapping[str, Body], Mapping[str, Hinge], dict[str, str]]:
    """Bodies and hinges, each ball as a tree has it: three bodies in one place, of which two have no mass."""
    balls = [hinge for hinge in hinges.values() if hinge.kind == "ball"]
    if not balls:
        return bodies, hinges, inward
    bodies, hinges, inward = {**bodies}, {**hinges}, {**inward}
    for ball in balls:
        names = [f"{ball.name}: {axis}" for axis in "xy"]
        bodies.update({name: Body(name, 0.0) for name in names})
        steps = [ball.parent, *names, ball.child]
        for k, (parent, child) in enumerate(pairwise(steps)):
            name = ball.name if child == ball.child else child
            kind, rotation, at = (
                (_BallAxis, BALL_PLACEMENT, NOWHERE) if k else (Hinge, ball.rotation, ball.at)
            )
            hinges[name] = kind(
                name, parent, child, "ball", at, rotation=rotation, q=ball.q, qd=ball.qd,
                armature=ball.armature,
            )  # fmt: skip
            inward[child] = name
    return bodies, hinges, inward


def _or_still(value: Floats | None) -> Floats:
    return np.zeros(3) if value is None else value


def _refuse_free_needles(
    names: tuple[str, ...], parent: Integers, kind: Integers, bodies: Sequence[Body]
) -> None:
    """Raise if a free body without others on it can turn about an axis without inertia."""
    for b in np.setdiff1d(np.flatnonzero(kind == HingeKind.FREE), parent).tolist():
        body = bodies[b]
        moments = np.linalg.eigvalsh(body.inertia)
        if body.mass > 0.0 and moments[0] <= NO_INERTIA * np.sum(moments):
            raise MechanicsError(
                f'body "{names[b]}": it is free and has no inertia about some axis; give it an inertia about '
                "all axes, or hinges that do not turn it"
            )


def _rotation_vector(value: ArrayLike, label: str) -> Floats:
    """A rotation vector (3,) of a ball, or its rates. Zero is none."""
    return numbers(NOWHERE if np.ndim(value) == 0 and value == 0.0 else value, label)


def _inertia(value: ArrayLike, label: str) -> Floats:
    """An inertia tensor (3, 3) of its diagonal, of all of it, or of one number for a ball."""
    if np.ndim(value) == 0:
        return number(value, label) * np.eye(3)
    if np.shape(value) == (3,):
        return np.diag(numbers(value, label))
    matrix = numbers(value, label, (3, 3))
    if np.max(np.abs(matrix - matrix.T)) > 1e-9 * np.max(np.abs(matrix)):
        raise MechanicsError(f"{label} is not symmetric: give the tensor about the centre of mass")
    return 0.5 * (matrix + matrix.T)


def axes_along(axis: Floats) -> Floats:
    """(n, 3, 3) float: axes, as columns, of which the third are along vectors (n, 3) of length one."""
    x = np.cross(np.eye(3)[np.argmin(np.abs(axis), axis=1)], axis)
    x /= np.linalg.norm(x, axis=1)[:, None]
    axes = np.stack([x, np.cross(axis, x), axis], axis=2)
    axes[np.all(axis == (0.0, 0.0, 1.0), axis=1)] = np.eye(3)
    return axes


def quaternion(rotation: Floats) -> Floats:
    """(..., 4) float: unit quaternions (w, x, y, z) of rotations (..., 3, 3), w not negative."""
    return np.roll(Rotation.from_matrix(rotation).as_quat(canonical=True), 1, axis=-1)


def _inward(bodies: Mapping[str, Body], hinges: Mapping[str, Hinge]) -> dict[str, str]:
    """Body -> its inward hinge."""
    inward: dict[str, str] = {}
    valid = ", ".join(f'"{name}"' for name in list(bodies)[:12])
    for name, hinge in hinges.items():
        for role, body in (("parent", hinge.parent), ("child", hinge.child)):
            if body not in bodies and (role, body) != ("parent", WORLD):
                raise MechanicsError(
                    f'hinge "{name}": its {role} "{body}" is not a body ({valid}); add it by body()'
                    if body != WORLD
                    else f'hinge "{name}": the world cannot be a child; swap parent and child'
                )
        if hinge.child in inward:
            raise MechanicsError(
                f'body "{hinge.child}" has two inward hinges, "{inward[hinge.child]}" and "{name}"; '
                "bodies form trees: replace one hinge by close()"
            )
        inward[hinge.child] = name
        child = bodies[hinge.child]
        strange = next((key for key in _OF_FREE_BODIES if getattr(child, key) is not None), None)
        strange = "armature" if child.armature else strange
        if strange:
            raise MechanicsError(
                f'body "{hinge.child}": {strange} applies to free bodies only, but hinge "{name}" moves it; '
                f"give {'that' if child.armature else 'q and qd'} of the hinge"
            )
    return inward


def _order_hinges(
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
    reached = set(order)
    left = [name for name in bodies if name not in reached]
    if left:
        raise MechanicsError(
            f'body "{left[0]}" is in a loop of hinges, with hinge "{inward[left[0]]}"; '
            "replace one hinge of the loop by close()"
        )
    return tuple(order[1:])
