"""Bodies that bend by assumed modes, in floating frames, on the hinges of a tree: kinematics and inertia.

A flexible body is a row of rigid sections. With eta the amplitudes of its shapes, the section at x moves to
x + phi eta - eta^T S eta / 2 in the body's frame, and turns by the rotation vector psi eta. The second-order
part is the shortening of a beam that bends without stretching: without it a rotating beam is not stiffened
by its own centrifugal force (Kane, Ryan, Banerjee, J. Guidance 10:139, 1987). Bodies outward ride on
sections. With J what gives the twists of sections from qd, the mass matrix is the sum of J^T I J.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from protochain.arrays import Floats, Integers, Value, floats, frozen, read_only
from protochain.errors import MechanicsError
from protochain.multibody.kinematics import integrate as integrate_rigid
from protochain.multibody.tree import HingeKind, Tree

_SMALL = 1e-2
"""rad. Below it quotients of differences lose digits, while three terms of their series do not."""


@dataclass(frozen=True, eq=False)
class Shapes(Value):
    """Sections of a body and the shapes in which it bends.

    Parameters
    ----------
    place : (n, 3) float
        Centres of the sections at rest, in the body's frame.
    mass, inertia : (n,) float and (n, 3, 3) float
        Mass of each section, and inertia about its centre, along the body's axes at rest. A section may be
        without either, as one that only carries another body.
    moves, turns : (n, 3, k) float
        Displacement and rotation vector of each section for unit amplitude of each shape.
    shortening : (n, 3, k, k) float
        Half of its product with two amplitudes is taken off the displacement; symmetric in the last two.
    stiffness : (k, k) float
        Half of its product with two amplitudes is the elastic energy.

    Raises
    ------
    MechanicsError
        If shapes of arrays do not belong together.
    """

    place: Floats
    mass: Floats
    inertia: Floats
    moves: Floats
    turns: Floats
    shortening: Floats
    stiffness: Floats

    def __post_init__(self) -> None:
        n, k = len(self.place), len(self.stiffness)
        for name, shape in (
            ("place", (n, 3)), ("mass", (n,)), ("inertia", (n, 3, 3)), ("moves", (n, 3, k)),
            ("turns", (n, 3, k)), ("shortening", (n, 3, k, k)), ("stiffness", (k, k)),
        ):  # fmt: skip
            array = read_only(getattr(self, name))
            if array.shape != shape or not np.all(np.isfinite(array)):
                raise MechanicsError(
                    f"{name} of a body of {n} sections and {k} shapes is no finite array of shape {shape}"
                )
            object.__setattr__(self, name, array)

    @property
    def n_shapes(self) -> int:
        """Number of shapes."""
        return len(self.stiffness)


@dataclass(frozen=True, eq=False)
class Flexible(Value):
    """Forest of bodies of which some bend.

    The coordinates are those of the tree, then the amplitudes of the shapes, body by body.

    Parameters
    ----------
    tree : Tree
        Hinges, and all bodies at rest; mass, centre and inertia are read of rigid bodies only.
    shapes : tuple of Shapes or None
        Of each body; None for a rigid one.
    section : (nb,) int
        Section of its parent that each body rides on; -1 for the parent's frame, which does not bend.

    Raises
    ------
    MechanicsError
        If there are not as many shapes as bodies, or a body rides on a section that is not there.
    """

    tree: Tree
    shapes: tuple[Shapes | None, ...]
    section: Integers

    def __post_init__(self) -> None:
        n = self.tree.n_bodies
        object.__setattr__(self, "section", read_only(self.section, np.int64))
        if len(self.shapes) != n or self.section.shape != (n,):
            raise MechanicsError(f"a tree of {n} bodies needs {n} shapes (or None) and {n} sections")
        for b, (p, at) in enumerate(zip(self.tree.parent, self.section, strict=True)):
            carrier = self.shapes[p] if p >= 0 else None
            if not -1 <= at < (len(carrier.place) if carrier else 0):
                raise MechanicsError(f"body {b}: its parent has no section {at} to ride on")

    @cached_property
    def shape_start(self) -> Integers:
        """(nb + 1,) int: body b's amplitudes have rates ``qd[shape_start[b]:shape_start[b + 1]]``."""
        counts = [0 if s is None else s.n_shapes for s in self.shapes]
        return read_only(self.tree.n_v + np.concatenate([[0], np.cumsum(counts)]), np.int64)

    @cached_property
    def node_start(self) -> Integers:
        """(nb + 1,) int: body b's nodes are these rows; its frame is the first, its sections follow."""
        counts = [2 if s is None else 1 + len(s.place) for s in self.shapes]
        return read_only(np.concatenate([[0], np.cumsum(counts)]), np.int64)

    @cached_property
    def bodies(self) -> tuple[Shapes, ...]:
        """Shapes of all bodies, with their frames as a first section: of a rigid one there are none."""
        return tuple(_with_frame(self.tree, b, shapes) for b, shapes in enumerate(self.shapes))

    @property
    def n_v(self) -> int:
        """Number of freedoms."""
        return int(self.shape_start[-1])

    @property
    def n_q(self) -> int:
        """Number of coordinates."""
        return self.n_v - self.tree.n_v + self.tree.n_q


@dataclass(frozen=True, eq=False)
class Bent(Value):
    """Where all nodes are, at one q: frames of bodies and sections, body by body as in ``node_start``.

    Parameters
    ----------
    rotation, origin : (nn, 3, 3) and (nn, 3) float
        Axes of the nodes in the world, as columns, and their places.
    columns : tuple of (n, 6, k) float
        Of each body: twists of its nodes about their places, for unit rates of its amplitudes.
    """

    rotation: Floats
    origin: Floats
    columns: tuple[Floats, ...]


def bend(flexible: Flexible, q: Floats) -> Bent:
    """Frames of all bodies and sections at q, by one outward sweep.

    Parameters
    ----------
    flexible, q : Flexible and (n_q,) float
        Bodies and their coordinates.

    Returns
    -------
    Bent
        World frames of the nodes.
    """
    tree, starts = flexible.tree, flexible.node_start
    q = floats(q, (flexible.n_q,), "q")
    rotation, origin = np.empty((starts[-1], 3, 3)), np.empty((starts[-1], 3))
    columns = []
    for b, shapes in enumerate(flexible.bodies):
        above, at, offset = np.eye(3), np.zeros(3), tree.offset[b]
        if tree.parent[b] >= 0:
            k = carrier_of(flexible, b)
            above, at = rotation[k], origin[k]
            offset = offset - flexible.bodies[tree.parent[b]].place[k - starts[tree.parent[b]]]
        turn, at = _past_hinge(tree, b, above @ tree.placement[b], at + above @ offset, q)
        eta = amplitudes(flexible, q, b)
        short = shapes.shortening @ eta
        nodes = slice(starts[b], starts[b + 1])
        theta = shapes.turns @ eta
        rotation[nodes] = turn @ Rotation.from_rotvec(theta).as_matrix()
        origin[nodes] = at + (shapes.place + shapes.moves @ eta - 0.5 * short @ eta) @ turn.T
        local = np.concatenate([dexp(theta) @ shapes.turns, shapes.moves - short], axis=1)
        columns.append(frozen(np.concatenate([turn @ local[:, :3], turn @ local[:, 3:]], axis=1)))
    return Bent(frozen(rotation), frozen(origin), tuple(columns))


def integrate(flexible: Flexible, q: Floats, qd: Floats) -> Floats:
    """Advance q along constant velocities for unit time, as :func:`protochain.multibody.integrate`."""
    tree = flexible.tree
    q, qd = floats(q, (flexible.n_q,), "q"), floats(qd, (flexible.n_v,), "qd")
    rigid = integrate_rigid(tree, q[: tree.n_q], qd[: tree.n_v])
    return np.concatenate([rigid, q[tree.n_q :] + qd[tree.n_v :]])


def elastic(flexible: Flexible, q: Floats) -> tuple[float, Floats]:
    """Elastic energy, and the torques (n_v,) of all bodies that bend: minus its gradient."""
    energy, torque = 0.0, np.zeros(flexible.n_v)
    for b, shapes in enumerate(flexible.bodies):
        eta, own = amplitudes(flexible, q, b), slice(*flexible.shape_start[b : b + 2])
        torque[own] = -shapes.stiffness @ eta
        energy -= 0.5 * float(torque[own] @ eta)
    return energy, torque


def amplitudes(flexible: Flexible, q: Floats, b: int) -> Floats:
    """(k,) float: how far body b is bent in each of its shapes."""
    shift = flexible.tree.n_q - flexible.tree.n_v
    return q[flexible.shape_start[b] + shift : flexible.shape_start[b + 1] + shift]


def carrier_of(flexible: Flexible, b: int) -> int:
    """Node that body b rides on; -1 for the world."""
    p = flexible.tree.parent[b]
    return int(flexible.node_start[p] + 1 + flexible.section[b]) if p >= 0 else -1


def hinge_columns(flexible: Flexible, bent: Bent, b: int) -> Floats:
    """(6, n_v of the hinge) float: twist of body b about its origin for unit rates of its hinge."""
    kind = flexible.tree.kind[b]
    if kind == HingeKind.FREE:
        return np.eye(6)
    if kind == HingeKind.FIXED:
        return np.zeros((6, 0))
    axis, (turn, slide) = bent.rotation[flexible.node_start[b], :, 2], flexible.tree.twist[b]
    return np.concatenate([turn * axis, slide * axis])[:, None]


def shifts(lever: Floats) -> Floats:
    """(..., 6, 6) float: twist about a point -> the same twist about another, a lever (..., 3) away."""
    out = np.zeros((*lever.shape[:-1], 6, 6))
    out[..., range(6), range(6)] = 1.0
    x, y, z = np.moveaxis(lever, -1, 0)
    out[..., 3, 1], out[..., 3, 2], out[..., 4, 2] = z, -y, x
    out[..., 4, 0], out[..., 5, 0], out[..., 5, 1] = -z, y, -x
    return out


def inertias(flexible: Flexible, bent: Bent) -> Floats:
    """(nn, 6, 6) float: spatial inertia of each node about its place, world axes; none of bodies' frames."""
    out = np.zeros((len(bent.origin), 6, 6))
    mass = np.concatenate([shapes.mass for shapes in flexible.bodies])
    inertia = np.concatenate([shapes.inertia for shapes in flexible.bodies])
    out[:, :3, :3] = bent.rotation @ inertia @ bent.rotation.swapaxes(1, 2)
    out[:, 3:, 3:] = mass[:, None, None] * np.eye(3)
    return out


def dexp(theta: Floats) -> Floats:
    """(n, 3, 3) float: rate of a rotation vector (n, 3) -> angular velocity."""
    a, b, _, _ = _coefficients(theta)
    cross = _crosses(theta)
    return np.asarray(np.eye(3) + a[:, None, None] * cross + b[:, None, None] * cross @ cross)


def dexp_rate(theta: Floats, rate: Floats) -> Floats:
    """(n, 3, 3) float: time derivative of :func:`dexp` as a rotation vector changes at a rate (n, 3)."""
    a, b, a_slope, b_slope = _coefficients(theta)
    along = np.einsum("ni,ni->n", theta, rate)
    k, kd = _crosses(theta), _crosses(rate)
    return np.asarray(
        (a_slope * along)[:, None, None] * k
        + a[:, None, None] * kd
        + (b_slope * along)[:, None, None] * k @ k
        + b[:, None, None] * (kd @ k + k @ kd)
    )


def _coefficients(theta: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Values of a = (1 - cos t) / t^2, b = (t - sin t) / t^3, and their derivatives by t, over t."""
    t2 = np.einsum("ni,ni->n", theta, theta)
    t = np.sqrt(np.maximum(t2, _SMALL**2))
    sine, cosine = np.sin(t), np.cos(t)
    near = t2 < _SMALL**2
    return (
        np.where(near, 1 / 2 - t2 / 24 + t2**2 / 720, (1 - cosine) / t**2),
        np.where(near, 1 / 6 - t2 / 120 + t2**2 / 5040, (t - sine) / t**3),
        np.where(near, -1 / 12 + t2 / 180 - t2**2 / 6720, (t * sine - 2 * (1 - cosine)) / t**4),
        np.where(near, -1 / 60 + t2 / 1260 - t2**2 / 60480, (3 * sine - 2 * t - t * cosine) / t**5),
    )


def _crosses(a: Floats) -> Floats:
    """(n, 3, 3) float: matrices of cross products a x."""
    return np.asarray(-shifts(a)[:, 3:, :3])


def _with_frame(tree: Tree, b: int, shapes: Shapes | None) -> Shapes:
    """Shapes with the body's frame as the first section."""
    if shapes is None:
        one = np.zeros((1, 3, 0))
        shapes = Shapes(
            tree.com[b : b + 1], tree.mass[b : b + 1], tree.inertia[b : b + 1], one, one,
            np.zeros((1, 3, 0, 0)), np.zeros((0, 0)),
        )  # fmt: skip
    parts = {
        name: np.concatenate([np.zeros_like(part[:1]), part])
        for name, part in vars(shapes).items()
        if name != "stiffness"
    }
    return replace(shapes, **parts)


def _past_hinge(tree: Tree, b: int, turn: Floats, at: Floats, q: Floats) -> tuple[Floats, Floats]:
    """Frame of body b with its hinge at q, from the frame at q = 0."""
    k, kind = tree.q_start[b], tree.kind[b]
    if kind == HingeKind.FREE:
        return Rotation.from_quat(q[k : k + 4], scalar_first=True).as_matrix(), at + q[k + 4 : k + 7]
    if kind == HingeKind.FIXED:
        return turn, at
    angle, slide = tree.twist[b] * q[k]
    c, s = np.cos(angle), np.sin(angle)
    return turn @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), at + slide * turn[:, 2]
