"""Bodies that bend by assumed modes, in floating frames, on the hinges of a tree: kinematics and inertia.

A flexible body is a row of rigid sections. With eta the amplitudes of its shapes, the section at x moves to
x + phi eta - eta^T S eta / 2 in the body's frame, and turns by the rotation vector psi eta. The second-order
part is the shortening of a beam that bends without stretching: without it a rotating beam is not stiffened
by its own centrifugal force (Kane, Ryan, Banerjee, J. Guidance 10:139, 1987). Bodies outward ride on
sections. With J what gives the twists of sections from qd, the mass matrix is the sum of J^T I J.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from protochain.core.arrays import Floats, Integers, Value, floats, freeze, read_only
from protochain.core.errors import BodyError, MechanicsError
from protochain.core.settings import document_fields
from protochain.mechanics.multibody.kinematics import integrate as integrate_rigid
from protochain.mechanics.multibody.tree import Tree
from protochain.mechanisms.flexible.kernels import put_frames


@document_fields
@dataclass(frozen=True, eq=False)
class Shapes(Value):
    """Sections of a body and the shapes in which it bends.

    Raises
    ------
    MechanicsError
        If shapes of arrays do not belong together.
    """

    place: Floats  # (n, 3) float: Centres of the sections at rest, in the body's frame.
    # (n,) float: Mass of each section. A section may be without mass, as one that only carries another body.
    mass: Floats
    # (n, 3, 3) float: Inertia of each section about its centre, along the body's axes at rest.
    inertia: Floats
    moves: Floats  # (n, 3, k) float: Displacement of each section for unit amplitude of each shape.
    turns: Floats  # (n, 3, k) float: Rotation vector of each section for unit amplitude of each shape.
    # (n, 3, k, k) float: Half of its product with two amplitudes shortens the displacement. Symmetric in the
    # last two.
    shortening: Floats
    stiffness: Floats  # (k, k) float: Half of its product with two amplitudes is the elastic energy.

    def __post_init__(self) -> None:
        n, k = len(self.place), len(self.stiffness)
        for name, shape in (
            ("place", (n, 3)), ("mass", (n,)), ("inertia", (n, 3, 3)), ("moves", (n, 3, k)),
            ("turns", (n, 3, k)), ("shortening", (n, 3, k, k)), ("stiffness", (k, k)),
        ):  # fmt: skip
            array = read_only(getattr(self, name))
            if array.shape != shape or not np.all(np.isfinite(array)):
                raise MechanicsError(
                    f"{name} of a body of {n} sections and {k} shapes is not a finite array of shape {shape}"
                )
            object.__setattr__(self, name, array)

    @property
    def n_shapes(self) -> int:
        """Number of shapes."""
        return len(self.stiffness)


@document_fields
@dataclass(frozen=True, eq=False)
class Flexible(Value):
    """Forest of bodies of which some bend.

    The coordinates are the tree's, then the amplitudes of the shapes, body by body.

    Raises
    ------
    MechanicsError
        If there are not as many shapes as bodies, or a body rides on a section that is not there.
    """

    tree: Tree  # Hinges, and all bodies at rest. Only rigid bodies need mass, centre and inertia.
    shapes: tuple[Shapes | None, ...]  # Shapes of each body, None for a rigid one.
    # (nb,) int: Section of its parent that each body rides on, -1 for the parent's frame, which does not
    # bend.
    section: Integers

    def __post_init__(self) -> None:
        n = self.tree.n_bodies
        object.__setattr__(self, "section", read_only(self.section, np.int64))
        if len(self.shapes) != n or self.section.shape != (n,):
            raise MechanicsError(f"a tree of {n} bodies needs {n} shapes (or None) and {n} sections")
        for b, (p, at) in enumerate(zip(self.tree.parent, self.section, strict=True)):
            carrier = self.shapes[p] if p >= 0 else None
            if not -1 <= at < (len(carrier.place) if carrier else 0):
                raise BodyError(b, f"its parent has no section {at}")

    @cached_property
    def shape_start(self) -> Integers:
        """(nb + 1,) int: body b's amplitudes have rates ``qd[shape_start[b]:shape_start[b + 1]]``."""
        counts = [0 if s is None else s.n_shapes for s in self.shapes]
        return read_only(self.tree.n_v + np.concatenate([[0], np.cumsum(counts)]), np.int64)

    @cached_property
    def node_start(self) -> Integers:
        """(nb + 1,) int: first row of each body's nodes. The first node is its frame, its sections follow."""
        counts = [2 if s is None else 1 + len(s.place) for s in self.shapes]
        return read_only(np.concatenate([[0], np.cumsum(counts)]), np.int64)

    @cached_property
    def sections(self) -> Shapes:
        """All nodes, padded to the largest number of shapes. The stiffness is unused."""
        n_most = max((s.n_shapes for s in self.shapes if s is not None), default=0)
        nodes = [_nodes(self.tree, b, shapes, n_most) for b, shapes in enumerate(self.shapes)]
        place, mass, inertia, moves, turns, shortening = (
            np.concatenate(part) for part in zip(*nodes, strict=True)
        )
        return Shapes(place, mass, inertia, moves, turns, shortening, np.zeros((n_most, n_most)))

    @cached_property
    def links(self) -> Integers:
        """(nb + 1, 6) int: columns of ``flexible_algebra``, as read by the sweeps."""
        tree, n = self.tree, self.tree.n_bodies
        carrier = np.where(tree.parent >= 0, self.node_start[tree.parent] + 1 + self.section, -1)
        driven = np.zeros(n) if tree.driven is None else tree.driven
        columns = (
            np.append(carrier, -1), tree.q_start, tree.v_start, self.node_start, self.shape_start,
            np.append(driven, 0),
        )  # fmt: skip
        return read_only(np.column_stack(columns), np.int64)

    @cached_property
    def seats(self) -> Floats:
        """(nb, 25) float: :attr:`Tree.bodies`, with offsets from the sections that carry the bodies."""
        seats, carrier = self.tree.bodies.copy(), self.links[:-1, 0]
        seats[:, :3] -= np.where(carrier[:, None] >= 0, self.sections.place[carrier], 0.0)
        return read_only(seats)

    @cached_property
    def rotors(self) -> Floats:
        """(n_v,) float: armature of each freedom, zero for amplitudes."""
        return read_only(np.pad(self.tree.rotors, (0, self.n_v - self.tree.n_v)))

    @cached_property
    def arrays(self) -> tuple[Floats, Floats, Floats, Floats, Floats, Floats]:
        """Places, masses, inertias (nn, ...), moves and turns (nn, K, 3), shortening (nn, K, K, 3)."""
        sections = self.sections
        return (
            sections.place, sections.mass, sections.inertia, read_only(sections.moves.swapaxes(1, 2)),
            read_only(sections.turns.swapaxes(1, 2)), read_only(np.moveaxis(sections.shortening, 1, 3)),
        )  # fmt: skip

    @cached_property
    def springs(self) -> tuple[Floats, Integers]:
        """(nb, K, K) float: stiffness of each body, and (nb, K) int: its amplitudes, -1 for none."""
        counts, n_most = np.diff(self.shape_start), len(self.sections.stiffness)
        stiffness = np.zeros((len(counts), n_most, n_most))
        for b, shapes in enumerate(self.shapes):
            if shapes is not None:
                stiffness[b, : counts[b], : counts[b]] = shapes.stiffness
        place = (self.shape_start[:-1] - self.tree.n_v)[:, None] + np.arange(n_most)
        place = np.where(np.arange(n_most) < counts[:, None], place, -1)
        return read_only(stiffness), read_only(place, np.int64)

    def node(self, body: int, section: int = -1) -> int:
        """Number of a node: of a section of a body, or by default of its frame."""
        n_most = int(self.node_start[body + 1] - self.node_start[body]) - 1
        if not -1 <= section < n_most:
            raise BodyError(body, f"it has no section {section}; give one from 0 to {n_most - 1}, or -1")
        return int(self.node_start[body]) + 1 + section

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
    """Places of all nodes at one q: frames of bodies and sections, body by body as in ``node_start``."""

    # rotation, origin: (nn, 3, 3): Axes of the nodes in the world, as columns, and their places.
    rotation: Floats
    origin: Floats
    # (nn, K, 6): Twists of the nodes about their places, for unit rates of their body's amplitudes.
    columns: Floats


def bend(flexible: Flexible, q: Floats) -> Bent:
    """Frames of all bodies and sections at q, by one outward sweep."""
    place, _, _, moves, turns, shortening = flexible.arrays
    n, n_most = len(place), moves.shape[1]
    rotation, origin, columns = np.empty((n, 3, 3)), np.empty((n, 3)), np.zeros((n, n_most, 6))
    put_frames(
        flexible.links, flexible.seats, place, moves, turns, shortening, floats(q, (flexible.n_q,), "q"),
        rotation, origin, columns,
    )  # fmt: skip
    return Bent(freeze(rotation), freeze(origin), freeze(columns))


def integrate(flexible: Flexible, q: Floats, qd: Floats) -> Floats:
    """Advance q along constant velocities for unit time, as ``multibody.integrate``."""
    tree = flexible.tree
    q, qd = floats(q, (flexible.n_q,), "q"), floats(qd, (flexible.n_v,), "qd")
    rigid = integrate_rigid(tree, q[: tree.n_q], qd[: tree.n_v])
    return np.concatenate([rigid, q[tree.n_q :] + qd[tree.n_v :]])


def elastic(flexible: Flexible, q: Floats) -> tuple[float, Floats]:
    """Elastic energy, and the torques (n_v,) of all bodies that bend: minus its gradient."""
    stiffness, place = flexible.springs
    rigid = flexible.tree.n_q
    eta = np.append(q[rigid:], 0.0)[place]
    pull = np.einsum("bkl,bl->bk", stiffness, eta)
    torque, is_used = np.zeros(flexible.n_v), place >= 0
    torque[flexible.tree.n_v + place[is_used]] = -pull[is_used]
    return 0.5 * float(np.vdot(pull, eta)), torque


def _nodes(tree: Tree, b: int, shapes: Shapes | None, n_most: int) -> tuple[Floats, ...]:
    """Fields of a body's shapes but the stiffness, for ``most`` shapes, its frame as the first section."""
    if shapes is None:
        fields: tuple[Floats, ...] = (
            tree.com[b : b + 1], tree.mass[b : b + 1], tree.inertia[b : b + 1], np.zeros((1, 3, 0)),
            np.zeros((1, 3, 0)), np.zeros((1, 3, 0, 0)),
        )  # fmt: skip
    else:
        fields = (shapes.place, shapes.mass, shapes.inertia, shapes.moves, shapes.turns, shapes.shortening)
    n_missing = n_most - fields[3].shape[2]
    frame = [(1, 0)]
    widths = [[], [], [], [(0, n_missing)], [(0, n_missing)], [(0, n_missing)] * 2]
    return tuple(
        np.pad(field, frame + [(0, 0)] * (field.ndim - 1 - len(width)) + width)
        for field, width in zip(fields, widths, strict=True)
    )
