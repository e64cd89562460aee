"""What a mechanism is: a forest of rigid bodies, each joined to its parent by one hinge."""

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property

import numpy as np

from protochain.arrays import Floats, Integers, read_only
from protochain.errors import ProtochainError


class HingeKind(IntEnum):
    """How a body moves relative to its parent (a root's parent is the world)."""

    FIXED = 0
    REVOLUTE = 1
    FREE = 2


N_Q = {HingeKind.FIXED: 0, HingeKind.REVOLUTE: 1, HingeKind.FREE: 7}
N_V = {HingeKind.FIXED: 0, HingeKind.REVOLUTE: 1, HingeKind.FREE: 6}
"""Coordinates and freedoms of each kind. FREE: quaternion (w, x, y, z), then position; (omega, v)."""


@dataclass(frozen=True, eq=False)
class Tree:
    """A forest of rigid bodies in which every parent comes before its children.

    The frame of body ``b`` relative to its parent is a translation by ``offset[b]``, a rotation by
    ``placement[b]``, and then the hinge: REVOLUTE turns by q about ``axis[b]`` through the frame's own
    origin, FREE turns by a quaternion and moves by a vector (Featherstone, *Rigid Body Dynamics
    Algorithms*, 2008, section 4.4).

    Parameters
    ----------
    parent : (nb,) int
        Parent of each body, ``-1`` for a root; ``parent[b] < b``.
    kind : (nb,) int
        :class:`HingeKind` of the hinge that carries each body.
    axis : (nb, 3) float
        Unit hinge axis in the body's own frame; ignored unless REVOLUTE.
    offset : (nb, 3) float, nm
        Origin of the body's frame in the parent's frame at q = 0.
    placement : (nb, 3, 3) float
        Rotation of the body's frame in the parent's frame at q = 0.

    Raises
    ------
    ProtochainError
        If a parent does not come before its child, or an array does not fit.
    """

    parent: Integers
    kind: Integers
    axis: Floats
    offset: Floats
    placement: Floats

    def __post_init__(self) -> None:
        for name, dtype in (("parent", np.int64), ("kind", np.int64), ("axis", float), ("offset", float)):
            object.__setattr__(self, name, read_only(getattr(self, name), dtype))
        object.__setattr__(self, "placement", read_only(self.placement))
        n = len(self.parent)
        shapes = (self.kind.shape, self.axis.shape, self.offset.shape, self.placement.shape)
        if shapes != ((n,), (n, 3), (n, 3), (n, 3, 3)):
            raise ProtochainError(f"arrays of a tree of {n} bodies have the shapes {shapes}")
        late = np.flatnonzero((self.parent >= np.arange(n)) | (self.parent < -1))
        if len(late):
            raise ProtochainError(f"body {late[0]}: its parent {self.parent[late[0]]} must come before it")
        turning = self.kind == HingeKind.REVOLUTE
        if not np.allclose(np.linalg.norm(self.axis[turning], axis=1), 1.0, atol=1e-9):
            raise ProtochainError("hinge axes must have unit length")
        free = self.kind == HingeKind.FREE
        if np.any(self.parent[free] >= 0) or np.any(self.placement[free] != np.eye(3)):
            raise ProtochainError(
                "only a root can be free, and its coordinates are the world's: no placement"
            )

    @property
    def n_bodies(self) -> int:
        """Number of bodies."""
        return len(self.parent)

    @cached_property
    def q_start(self) -> Integers:
        """(nb + 1,) int: body b's coordinates are ``q[q_start[b]:q_start[b + 1]]``."""
        return _starts(self.kind, N_Q)

    @cached_property
    def v_start(self) -> Integers:
        """(nb + 1,) int: body b's freedoms are ``v[v_start[b]:v_start[b + 1]]``."""
        return _starts(self.kind, N_V)

    @property
    def n_q(self) -> int:
        """Number of coordinates."""
        return int(self.q_start[-1])

    @property
    def n_v(self) -> int:
        """Number of freedoms."""
        return int(self.v_start[-1])


def _starts(kind: Integers, sizes: dict[HingeKind, int]) -> Integers:
    counts = [sizes[HingeKind(k)] for k in kind]
    return read_only(np.concatenate([[0], np.cumsum(counts)]), np.int64)
