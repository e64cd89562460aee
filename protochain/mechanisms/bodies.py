"""Bodies by name, and the state of a mechanism at one moment, as callables see it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import qr

from protochain.core.arrays import Floats
from protochain.core.checks import brief
from protochain.core.errors import MechanicsError
from protochain.core.settings import document_fields
from protochain.mechanics import multibody
from protochain.mechanics.multibody import Frames, HingeKind, Tree
from protochain.mechanics.multibody.articulated import Articulated, articulate
from protochain.mechanics.multibody.operational import Rows
from protochain.mechanisms.loop_factors import DEPENDENT
from protochain.mechanisms.loop_joints import LoopJoints

WORLD = "world"


@document_fields
@dataclass(frozen=True, eq=False)
class Bodies:
    """Bodies of a tree by name, each with axes of its own.

    A body's points, centre of mass and inertia are along its own axes. The frame of the
    tree has the same origin, but its z axis along the hinge.
    """

    tree: Tree  # Rigid bodies.
    names: tuple[str, ...]  # Names of the bodies.
    # (nb, 3, 3) float: Axes of the tree's frame of each body, as columns, in the body's own axes.
    turn: Floats
    hinges: Mapping[str, int]  # Name of each hinge -> number of the body beyond it.
    q: Floats  # (n_q,) float: Coordinates as built.
    qd: Floats  # (n_v,) float: Velocities as built.
    joints: LoopJoints | None = None  # Joints that close loops.
    joint_names: tuple[str, ...] = ()  # Name of the joint of each of their equations.
    gravity: Floats = field(default_factory=lambda: np.zeros(3))  # (3,) float: Acceleration of free fall.
    degrees: bool = False  # Whether angles of hinges, and their rates, are in degrees outside.

    @cached_property
    def built(self) -> "State":
        """State as built."""
        return State(self, 0.0, self.q, self.qd, multibody.pose(self.tree, self.q))

    @cached_property
    def numbers(self) -> dict[str, int]:
        """Number of each body by its name. -1 is the world."""
        return {WORLD: -1} | {name: number for number, name in enumerate(self.names)}

    def number(self, name: str, asking: str = "") -> int:
        """Return the number of a body, -1 for the world.

        Raises
        ------
        MechanicsError
            If the name is unknown. ``asking`` names the caller.
        """
        return _of(self.numbers, name, "body", asking)

    def hinge(self, name: str, asking: str = "") -> int:
        """Return the number of the body beyond a hinge.

        Raises
        ------
        MechanicsError
            If there is none of this name.
        """
        return _of(self.hinges, name, "hinge", asking)

    def freedom(self, hinge: str, asking: str = "") -> tuple[int, int]:
        """Places of a hinge's coordinate in q and of its rate in qd.

        Raises
        ------
        MechanicsError
            If the hinge is unknown, or it is fixed or a ball.
        """
        b = self.hinge(hinge, asking)
        if self.tree.v_start[b] == self.tree.v_start[b + 1]:
            raise MechanicsError(f'{_prefix(asking)}hinge "{hinge}" is fixed and has no coordinate')
        if self.tree.kind[b] == HingeKind.BALL_AXIS:
            raise MechanicsError(f'{_prefix(asking)}hinge "{hinge}" is a ball and has no single coordinate')
        return int(self.tree.q_start[b]), int(self.tree.v_start[b])

    def ball(self, hinge: str) -> tuple[slice, slice] | None:
        """Places of a ball's rotation vector in q and of its rates in qd, None for other hinges."""
        b = self.hinge(hinge)
        if self.tree.kind[b] != HingeKind.BALL_AXIS:
            return None
        q, v = int(self.tree.q_start[b - 2]), int(self.tree.v_start[b - 2])
        return slice(q, q + 3), slice(v, v + 3)

    def unit(self, hinge: str) -> float:
        """Internal value of an outside unit of a hinge's coordinate: pi / 180 of angles in degrees, or 1."""
        turns = self.tree.twist[self.hinge(hinge), 0] != 0.0
        return np.pi / 180.0 if self.degrees and turns else 1.0

    def weights(self, frames: Frames) -> Floats:
        """(nb, 6) float: moments of gravity about the bodies' origins, and forces, world axes."""
        force = self.tree.mass[:, None] * self.gravity
        arm = np.einsum("bij,bj->bi", frames.rotation, self.tree.com)
        return np.concatenate([np.cross(arm, force), force], axis=1)

    def inside(self, b: int, point: ArrayLike) -> Floats:
        """(3,) float: a point or direction in a body's own axes, along the axes of the tree's frame."""
        vector = np.asarray(point, dtype=float)
        return vector if b < 0 else np.asarray(self.turn[b].T @ vector)

    def axes(self, b: int) -> Floats:
        """(3, 3) float: a body's own axes, as columns, along the axes of the tree's frame."""
        return np.eye(3) if b < 0 else np.asarray(self.turn[b].T)


@document_fields
@dataclass(frozen=True, eq=False)
class State:
    """A mechanism at one moment."""

    bodies: Bodies  # Bodies by name.
    t: float  # Time.
    q: Floats  # (n_q,) float: Coordinates.
    qd: Floats  # (n_v,) float: Velocities.
    frames: Frames  # Frames of the bodies.

    @cached_property
    def twists(self) -> Floats:
        """(nb, 6) float: angular velocities and velocities of the bodies' origins, world axes."""
        return multibody.velocities(self.bodies.tree, self.frames, self.qd)

    @cached_property
    def factors(self) -> Articulated:
        """Factors of the mass matrix, as impulses need them."""
        return articulate(self.bodies.tree, self.frames)

    @property
    def loops(self) -> Rows | None:
        """Rows of the joints that close loops, without those that depend on others, as impulses need them."""
        if self.bodies.joints is None:
            return None
        joints = self.bodies.joints
        _, rows = joints.rows(self.frames)
        r, order = qr(joints.matrix(self.bodies.tree, self.frames).T, mode="r", pivoting=True)
        sizes = np.abs(np.diagonal(r))
        counts = sizes > DEPENDENT * max(1.0, np.max(sizes, initial=0.0))
        rank_rows = np.sort(order[: len(sizes)][counts][: joints.rank])
        return Rows(rows.body[rank_rows], rows.wrench[rank_rows])

    def rotation(self, body: str) -> Floats:
        """(3, 3) float: a body's own axes in the world, as columns."""
        b = self.bodies.number(body)
        return np.eye(3) if b < 0 else np.asarray(self.frames.rotation[b] @ self.bodies.turn[b].T)

    def point(self, body: str, at: ArrayLike = (0.0, 0.0, 0.0)) -> Floats:
        """(3,) float: a point of a body, in the world."""
        b, arm = self.bodies.number(body), self._arm(body, at)
        return arm if b < 0 else np.asarray(self.frames.origin[b] + arm)

    def velocity(self, body: str, at: ArrayLike = (0.0, 0.0, 0.0)) -> Floats:
        """(3,) float: velocity of a point of a body, world axes."""
        b = self.bodies.number(body)
        if b < 0:
            return np.zeros(3)
        return np.asarray(self.twists[b, 3:] + np.cross(self.twists[b, :3], self._arm(body, at)))

    def spin(self, body: str) -> Floats:
        """(3,) float: angular velocity of a body, world axes."""
        b = self.bodies.number(body)
        return np.zeros(3) if b < 0 else self.twists[b, :3].copy()

    def angle(self, hinge: str) -> Any:
        """Coordinate of a hinge: an angle, or the length of a slide, or a ball's rotation vector (3,)."""
        return self._of_hinge(hinge, self.q, 0)

    def rate(self, hinge: str) -> Any:
        """Rate of a hinge's coordinate. A ball has the relative angular velocity (3,), axes of the child."""
        return self._of_hinge(hinge, self.qd, 1)

    def jacobian(self, body: str, at: ArrayLike = (0.0, 0.0, 0.0)) -> Floats:
        """(6, n_v) float: J, so that J qd is the velocity of a point of a body, then its angular velocity."""
        b, arm, tree = self.bodies.number(body), self._arm(body, at), self.bodies.tree
        out = np.zeros((6, tree.n_v))
        for k in range(6 if b >= 0 else 0):
            wrenches, unit = np.zeros((tree.n_bodies, 6)), np.eye(3)[k % 3]
            wrenches[b] = [*np.cross(arm, unit), *unit] if k < 3 else [*unit, 0.0, 0.0, 0.0]
            out[k] = multibody.pull_back(tree, self.frames, wrenches)
        return out

    @property
    def weight(self) -> Floats:
        """(n_v,) float: torques of gravity at the hinges, forces of it at slides and free bodies."""
        return multibody.pull_back(self.bodies.tree, self.frames, self.bodies.weights(self.frames))

    def _of_hinge(self, hinge: str, values: Floats, k: int) -> Any:
        """Entry of q (k = 0) or qd (k = 1) of a hinge, in its unit outside. All three of a ball."""
        ball = self.bodies.ball(hinge)
        value = values[(ball or self.bodies.freedom(hinge))[k]] / self.bodies.unit(hinge)
        return value if ball else float(value)

    def _arm(self, body: str, at: ArrayLike) -> Floats:
        arm = np.asarray(at, dtype=float)
        if arm.shape != (3,):
            raise MechanicsError(f'the point {brief(at)} of "{body}": give three numbers, as (0, 0, 1)')
        return np.asarray(self.rotation(body) @ arm)


def _of(numbers: Mapping[str, int], name: str, kind: str, asking: str) -> int:
    if isinstance(name, str) and name in numbers:
        return numbers[name]
    names_known = ", ".join(f'"{known_name}"' for known_name in list(numbers)[:12]) or "none"
    raise MechanicsError(f'{_prefix(asking)}there is no {kind} "{name}"; there are {names_known}')


def _prefix(asking: str) -> str:
    return f"{asking}: " if asking else ""
