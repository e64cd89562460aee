"""Mechanism: a forest of rigid bodies, each joined to its parent by one hinge."""

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from protochain.core.arrays import Floats, Integers, Value, read_only
from protochain.core.errors import BodyError, Fault, MechanicsError
from protochain.core.settings import document_fields

PARENT, Q, V = range(3)
"""Columns of :attr:`Tree.links`."""
OFFSET, AXES, MASS, FIRST_MOMENT, SECOND_MOMENTS, TURN, SLIDE, ARMATURE = 0, 3, 12, 13, 16, 22, 23, 24
"""First columns of these in :attr:`Tree.bodies`. One array, since a call pays for every array argument."""
NO_INERTIA = 1e-12
"""Moment of inertia about an axis, relative to the sum of all three, below which it is rounding error."""


class HingeKind(IntEnum):
    """Kind of motion of a body relative to its parent (of a root: the world)."""

    FIXED = 0
    REVOLUTE = 1
    FREE = 2
    PRISMATIC = 3
    SCREW = 4
    BALL = 5
    BALL_AXIS = 6


_N_Q = {HingeKind.FIXED: 0, HingeKind.FREE: 7, HingeKind.BALL: 3, HingeKind.BALL_AXIS: 0}
N_Q = {kind: _N_Q.get(kind, 1) for kind in HingeKind}
N_V = {kind: {HingeKind.FIXED: 0, HingeKind.FREE: 6}.get(kind, 1) for kind in HingeKind}
"""Numbers of coordinates and velocities of each kind. FREE: quaternion (w, x, y, z), position, (omega, u)."""
BALL_PLACEMENT: Floats = read_only(np.roll(np.eye(3), 1, axis=0))
"""Axes y, z, x as columns: axes of each body of a ball, in the axes of the previous one."""


@document_fields
@dataclass(frozen=True, eq=False)
class Tree(Value):
    """Forest of rigid bodies in which every parent comes before its children.

    The frame of body ``b`` relative to its parent is a translation by ``offset[b]``, a rotation by
    ``placement[b]``, and then the hinge, along the z axis of the frame: REVOLUTE turns by q, PRISMATIC
    slides by q, SCREW turns by q and slides by ``pitch[b]`` q. FREE turns by a quaternion and moves by a
    vector (Featherstone, *Rigid Body Dynamics Algorithms*, 2008, sections 4.1 and 4.4). A ball is three
    bodies in one place: BALL, with a rotation vector of at most pi as coordinates, and two of BALL_AXIS,
    without coordinates. The first two have no mass. Their rates are the angular velocity by the axes x, y and
    z of the third, relative to the parent of the first.

    Raises
    ------
    MechanicsError
        If a parent does not come before its child, an array has a wrong shape or unphysical values, a
        hinge has no inertia, or a driven body is not a hinge of one freedom.
    """

    parent: Integers  # (nb,) int: Parent of each body, ``-1`` for a root. Requires ``parent[b] < b``.
    kind: Integers  # (nb,) int: Kind of the hinge between each body and its parent, a :class:`HingeKind`.
    offset: Floats  # (nb, 3) float, nm: Origin of the body's frame in the parent's frame at q = 0.
    placement: Floats  # (nb, 3, 3) float: Rotation of the body's frame in the parent's frame at q = 0.
    # (nb,) float, amu: Mass. A body may be without mass, as between the two hinges of a universal joint, if
    # the outward bodies resist its hinge.
    mass: Floats
    com: Floats  # (nb, 3) float, nm: Centre of mass in the body's frame.
    # (nb, 3, 3) float, amu nm^2: Inertia tensor about the centre of mass, along the body's axes.
    inertia: Floats
    pitch: Floats | None = None  # (nb,) float, nm/rad, optional: Translation per radian of SCREW hinges.
    # (nb,) bool, optional: Hinges of one freedom whose motion is prescribed: solutions with M leave their
    # freedoms out, and :func:`~protochain.mechanics.multibody.forward_dynamics` needs their accelerations.
    # None by default.
    driven: NDArray[np.bool_] | None = None
    # (nb,) float, amu nm^2 (amu for slides), optional: Inertia of the rotor of a motor, added to the diagonal
    # of M at every freedom of the hinge. It has no weight and no momentum. Zeros by default.
    armature: Floats | None = None
    # (nb,) bool, optional: Bodies with an unphysical inertia that is used unchanged, as the dummy links in
    # files of robots. None by default.
    nominal: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        n = len(self.parent)
        for name in ("pitch", "armature"):
            if getattr(self, name) is None:
                object.__setattr__(self, name, np.zeros(n))
        for name, dtype, shape in (
            ("parent", np.int64, (n,)), ("kind", np.int64, (n,)), ("offset", float, (n, 3)),
            ("placement", float, (n, 3, 3)), ("mass", float, (n,)), ("com", float, (n, 3)),
            ("inertia", float, (n, 3, 3)), ("pitch", float, (n,)), ("armature", float, (n,)),
        ):  # fmt: skip
            array = read_only(getattr(self, name), dtype)
            if array.shape != shape:
                raise MechanicsError(f"{name} of a tree of {n} bodies has shape {array.shape}, not {shape}")
            _refuse(~np.isfinite(array), f"its {name} is not finite")
            object.__setattr__(self, name, array)
        _check_topology(self)
        object.__setattr__(self, "driven", _check_driven(self))
        _refuse(~is_rotation(self.placement), "its placement is not a rotation")
        _check_inertia(self)

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
        """(nb + 1,) int: body b's freedoms are ``qd[v_start[b]:v_start[b + 1]]``."""
        return _starts(self.kind, N_V)

    @cached_property
    def hinge_bodies(self) -> Integers:
        """(k,) int: bodies with one freedom."""
        return read_only(np.flatnonzero(np.diff(self.v_start) == 1), np.int64)

    @cached_property
    def massless(self) -> Integers:
        """(k,) int: bodies without mass."""
        return read_only(np.flatnonzero(self.mass == 0.0), np.int64)

    @cached_property
    def is_plain(self) -> bool:
        """Whether no hinge is driven and every body has mass."""
        return self.driven is None and len(self.massless) == 0

    @cached_property
    def rotors(self) -> Floats:
        """(n_v,) float: armature of each freedom."""
        assert self.armature is not None
        return read_only(np.repeat(self.armature, np.diff(self.v_start)))

    @cached_property
    def balls(self) -> Integers:
        """(k, 3) int: freedoms of the balls."""
        first = self.v_start[:-1][self.kind == HingeKind.BALL]
        return read_only(first[:, None] + np.arange(3), np.int64)

    @cached_property
    def driven_q(self) -> Integers:
        """(k,) int: coordinates of the driven hinges."""
        return read_only(self.q_start[:-1][self._is_driven], np.int64)

    @cached_property
    def driven_v(self) -> Integers:
        """(k,) int: freedoms of the driven hinges."""
        return read_only(self.v_start[:-1][self._is_driven], np.int64)

    @cached_property
    def undriven_v(self) -> Integers:
        """(n_v - k,) int: all other freedoms."""
        return read_only(np.setdiff1d(np.arange(self.n_v), self.driven_v), np.int64)

    @property
    def _is_driven(self) -> NDArray[np.bool_]:
        return np.zeros(self.n_bodies, dtype=np.bool_) if self.driven is None else self.driven

    @cached_property
    def twist(self) -> Floats:
        """(nb, 2) float: turn (rad) and slide (nm) along the hinge's axis for each unit of q."""
        twist = np.zeros((self.n_bodies, 2))
        twist[np.isin(self.kind, [HingeKind.REVOLUTE, HingeKind.BALL, HingeKind.BALL_AXIS])] = 1.0, 0.0
        twist[self.kind == HingeKind.PRISMATIC] = 0.0, 1.0
        screw = self.kind == HingeKind.SCREW
        assert self.pitch is not None
        twist[screw, 0], twist[screw, 1] = 1.0, self.pitch[screw]
        return read_only(twist)

    @cached_property
    def rigid(self) -> Floats:
        """(nb, 10) float: mass, first moment and xx, xy, xz, yy, yz, zz about the frame's origin."""
        about_origin = self.inertia + self.mass[:, None, None] * _squared_cross(self.com)
        rows, columns = np.triu_indices(3)
        moment = self.mass[:, None] * self.com
        return read_only(np.column_stack([self.mass, moment, about_origin[:, rows, columns]]))

    @cached_property
    def links(self) -> Integers:
        """(nb + 1, 3) int: parent, q_start, v_start, as read by the sweeps."""
        parent = np.append(self.parent, len(self.parent) - 1)
        return read_only(np.column_stack([parent, self.q_start, self.v_start]), np.int64)

    @cached_property
    def locked_links(self) -> Integers:
        """(nb + 1, 3) int: :attr:`links` of the tree with its driven hinges fixed.

        Sweeps that solve with M read it, so a hinge is locked at no cost for trees without driven hinges.
        """
        if self.driven is None:
            return self.links
        before = np.concatenate([[0], np.cumsum(self.driven)])
        return read_only(self.links - np.outer(before, [0, 1, 1]), np.int64)

    @cached_property
    def bodies(self) -> Floats:
        """(nb, 25) float: offset, columns of placement, rigid, twist, armature, as read by the sweeps."""
        assert self.armature is not None
        axes = self.placement.swapaxes(1, 2).reshape(self.n_bodies, 9)
        return read_only(np.column_stack([self.offset, axes, self.rigid, self.twist, self.armature]))

    @cached_property
    def size(self) -> float:
        """Largest lever arm or radius of gyration of a body, or 1 if all are points without lever arms.

        It makes tolerances independent of the unit of length.
        """
        mass = np.where(self.mass > 0.0, self.mass, 1.0)
        gyration = np.sqrt(np.maximum(np.trace(self.inertia, axis1=1, axis2=2), 0.0) / mass)
        arms = np.linalg.norm(np.concatenate([self.offset[self.parent >= 0], self.com]), axis=1)
        size = max(np.max(gyration, initial=0.0), np.max(arms, initial=0.0))
        return float(size) if size > 0.0 else 1.0

    @cached_property
    def units(self) -> Floats:
        """(n_v,) float: amount of each freedom for a radian or a :attr:`size`."""
        return self._units(self.v_start, 3)

    @cached_property
    def coordinate_units(self) -> Floats:
        """(n_q,) float: as :attr:`units`, of each coordinate. A quaternion has pure numbers."""
        return self._units(self.q_start, 4)

    def _units(self, starts: Integers, n_turning: int) -> Floats:
        out, first = np.ones(starts[-1]), starts[:-1]
        out[first[self.kind == HingeKind.PRISMATIC]] = self.size
        for start in first[self.kind == HingeKind.FREE]:
            out[start + n_turning : start + n_turning + 3] = self.size
        return read_only(out)

    @cached_property
    def n_q(self) -> int:
        """Number of coordinates."""
        return int(self.q_start[-1])

    @cached_property
    def n_v(self) -> int:
        """Number of freedoms."""
        return int(self.v_start[-1])


def rigid_bodies(point_body: Integers, point: Floats, mass: Floats, n: int) -> tuple[Floats, Floats, Floats]:
    """Mass, centre of mass and inertia of bodies made of point masses.

    Parameters
    ----------
    point_body : (k,) int
        Body of each point.
    point : (k, 3) float, nm
        Positions in the frames of the bodies.
    mass : (k,) float, amu
        Masses of the points.
    n : int
        Number of bodies.

    Returns
    -------
    (n,) float, (n, 3) float, (n, 3, 3) float
        Parameters ``mass``, ``com`` and ``inertia`` of :class:`Tree`, zeros for bodies without points.
    """
    total, first, second = np.zeros(n), np.zeros((n, 3)), np.zeros((n, 3, 3))
    np.add.at(total, point_body, mass)
    np.add.at(first, point_body, mass[:, None] * point)
    com = first / np.where(total > 0.0, total, 1.0)[:, None]
    # About the centre of mass from the start: the parallel-axis theorem would cancel digits.
    np.add.at(second, point_body, mass[:, None, None] * _squared_cross(point - com[point_body]))
    return total, com, second


def _starts(kind: Integers, sizes: dict[HingeKind, int]) -> Integers:
    counts = np.array([sizes[k] for k in HingeKind])[kind]
    return read_only(np.concatenate([[0], np.cumsum(counts)]), np.int64)


def _squared_cross(c: Floats) -> Floats:
    """-[c]x [c]x: the moment of inertia of a unit mass at c, (nb, 3, 3)."""
    return np.sum(c * c, axis=1)[:, None, None] * np.eye(3) - c[:, :, None] * c[:, None, :]


def _refuse(mask: np.ndarray, reason: str, values: Any = None, fault: Fault | None = None) -> None:
    """Raise if any body is invalid. ``why`` may have a place for the value of the first one."""
    if np.any(mask):
        b = int(np.argwhere(mask)[0][0])
        raise BodyError(b, reason if values is None else reason.format(values[b]), fault)


def _check_topology(tree: Tree) -> None:
    n = tree.n_bodies
    late = (tree.parent >= np.arange(n)) | (tree.parent < -1)
    _refuse(late, "its parent {} must come before it", tree.parent)
    _refuse(~np.isin(tree.kind, list(HingeKind)), "{} is not a kind of hinge", tree.kind)
    free = tree.kind == HingeKind.FREE
    mask = free & ((tree.parent >= 0) | np.any(tree.placement != np.eye(3), axis=(1, 2)))
    _refuse(mask, "only a root can be free, and then without a placement: its coordinates are the world's")
    first = np.flatnonzero(tree.kind == HingeKind.BALL)
    axes = np.flatnonzero(tree.kind == HingeKind.BALL_AXIS)
    if not np.array_equal(axes, (first[:, None] + [1, 2]).ravel()) or not (
        np.all(tree.parent[axes] == axes - 1)
        and np.all(tree.mass[axes - 1] == 0.0)
        and np.all(tree.offset[axes] == 0.0)
        and np.all(tree.placement[axes] == BALL_PLACEMENT)
    ):
        raise BodyError(int((*first, *axes)[0]), "a ball requires three bodies at one point; see Tree")


def _check_driven(tree: Tree) -> NDArray[np.bool_] | None:
    """Return the checked mask of driven bodies, or None if no hinge is driven."""
    if tree.driven is None:
        return None
    n, driven = tree.n_bodies, np.asarray(tree.driven)
    if driven.shape != (n,) or driven.dtype != np.bool_:
        raise MechanicsError(
            f"driven of a tree of {n} bodies is {driven.dtype} of shape {driven.shape}, not bool of ({n},)"
        )
    is_wrong = driven & ((np.diff(tree.v_start) != 1) | (tree.kind >= HingeKind.BALL))
    names = [HingeKind(kind).name for kind in tree.kind]
    _refuse(is_wrong, "only a hinge of one freedom can be driven, not a {} one", names)
    return read_only(driven, np.bool_) if np.any(driven) else None


def _check_inertia(tree: Tree) -> None:
    _refuse(tree.mass < 0, "its mass {:g} must not be negative", tree.mass)
    nominal = np.zeros(tree.n_bodies, dtype=bool) if tree.nominal is None else tree.nominal
    ghost = (tree.mass == 0) & np.any(tree.inertia != 0.0, axis=(1, 2)) & ~nominal
    _refuse(ghost, "it has inertia but no mass")
    turned = np.abs(tree.inertia - tree.inertia.swapaxes(1, 2)).max(axis=(1, 2), initial=0.0)
    skew = turned > 1e-9 * np.abs(tree.inertia).max(axis=(1, 2), initial=0.0)
    is_wrong = skew | ~(is_inertia(tree.inertia) | nominal)
    _refuse(is_wrong, "its inertia is impossible for a rigid body")
    assert tree.armature is not None
    _refuse(tree.armature < 0, "its armature {:g} must not be negative", tree.armature)
    moves = (np.diff(tree.v_start) > 0) & ~tree._is_driven & (tree.armature == 0.0)
    _refuse(
        moves & _carries_nothing(tree),
        "neither it nor any body beyond it has mass, so nothing resists its hinge; "
        "give it mass, or make the hinge FIXED or driven",
        fault=Fault.NO_INERTIA,
    )
    _refuse(
        moves & _turns_nothing(tree),
        "all mass beyond its hinge is on the hinge's axis, so it has no inertia; make the hinge FIXED",
        fault=Fault.NO_INERTIA,
    )


def is_inertia(tensor: Floats) -> NDArray[np.bool_]:
    """Whether distributions of mass have these symmetric tensors (n, 3, 3) about their centres: (n,) bool."""
    moments = np.linalg.eigvalsh(tensor)
    # No moment exceeds the sum of the other two.
    tolerance = 1e-9 * np.sum(moments, axis=1)
    return (moments[:, 2] - moments[:, 1] - moments[:, 0] <= tolerance) & (moments[:, 2] >= 0.0)


def is_rotation(matrix: Floats) -> NDArray[np.bool_]:
    """Whether finite matrices (n, 3, 3) are rotations: (n,) bool."""
    product = matrix @ matrix.swapaxes(1, 2)
    is_orthonormal = np.all(np.abs(product - np.eye(3)) <= 1e-9, axis=(1, 2))
    return is_orthonormal & (np.linalg.det(matrix) > 0.0)


def _carries_nothing(tree: Tree) -> np.ndarray:
    """(nb,) bool: bodies without mass, with nothing but such bodies beyond them."""
    empty = (tree.mass == 0.0) & ~np.any(tree.inertia, axis=(1, 2))
    if np.any(empty):
        for b in range(tree.n_bodies - 1, -1, -1):
            if tree.parent[b] >= 0:
                empty[tree.parent[b]] &= empty[b]
    return empty


def _turns_nothing(tree: Tree) -> np.ndarray:
    """(nb,) bool: phantom hinges, which turn only mass on their own axis, at every q."""
    # A parent with a child is one only if all mass of the child lies on the parent's axis, too.
    axial = tree.rigid[:, 9]
    total = tree.rigid[:, 4] + tree.rigid[:, 7] + tree.rigid[:, 9]
    on_axis = axial <= NO_INERTIA * total
    turning = (tree.twist[:, 0] != 0) & (tree.twist[:, 1] == 0)
    if not np.any(on_axis & turning):
        return on_axis & turning
    length = float(np.max(np.abs(tree.offset[tree.parent >= 0]), initial=0.0))
    is_point = total <= NO_INERTIA * tree.mass * length**2
    for b in range(tree.n_bodies - 1, -1, -1):
        p = tree.parent[b]
        if p < 0:
            continue
        along = np.hypot(*tree.offset[b, :2]) <= 1e-9 * float(np.linalg.norm(tree.offset[b]))
        collinear = along and np.hypot(*tree.placement[b, :2, 2]) <= 1e-9
        stays = is_point[b] and tree.twist[b, 1] == 0
        on_axis[p] &= on_axis[b] and (collinear or (along and stays))
        is_point[p] &= stays and not np.any(tree.offset[b])
    return on_axis & turning
