"""Joints that close loops of bodies, their freedoms, and the coordinates that close the loops."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import null_space
from scipy.spatial.transform import Rotation

from protochain.core.arrays import Floats, read_only
from protochain.core.checks import brief, optional
from protochain.core.errors import Fault, MechanicsError
from protochain.core.settings import document_fields
from protochain.mechanics import multibody
from protochain.mechanisms.assemble import axes_along
from protochain.mechanisms.bodies import Bodies
from protochain.mechanisms.element_arguments import direction, rotation_matrix
from protochain.mechanisms.elements import Between
from protochain.mechanisms.loop_factors import moved_by, order_along
from protochain.mechanisms.loop_joints import CLOSED, LoopJoints, least_change

X, Y, Z = np.eye(3)
_SLIDES = {
    "spherical": (X, Y, Z), "revolute": (X, Y, Z), "universal": (X, Y, Z), "rigid": (X, Y, Z),
    "cylindrical": (X, Y), "prismatic": (X, Y), "planar": (Z,),
}  # fmt: skip
"""Kind -> directions in which the points stay together, in axes whose z is the axis of the joint."""
_ALIGNED = ((X, Z), (Y, Z))
_LOCKED = ((X, Y), (Y, Z), (Z, X))
_TURNS: dict[str, tuple[tuple[Floats, Floats], ...]] = {
    "revolute": _ALIGNED, "cylindrical": _ALIGNED, "planar": _ALIGNED, "prismatic": _LOCKED, "rigid": _LOCKED,
}  # fmt: skip
"""Kind -> pairs of directions, of the first and the second body, that stay at right angles."""


@document_fields
@dataclass(frozen=True, eq=False)
class Closing(Between, noun="closing"):
    """A joint that closes a loop: both points meet. Bodies turn about it as they lie when built.

    Raises
    ------
    MechanicsError
        If the name is already in use, or an argument is invalid.
    """

    # Freedoms of the joint: ``revolute``, ``spherical``, ``universal``, ``cylindrical``, ``prismatic``,
    # ``planar`` or ``rigid``. Redundant joints are allowed, as revolute ones in a plane.
    kind: str = "revolute"
    # (3,) float: Its axis in the axes of a. The normal of the plane of ``planar``, the arm of a of
    # ``universal``.
    axis: Any = (0.0, 0.0, 1.0)
    # (3,) float, optional: Of ``universal`` only: the arm of b, at right angles to the axis, in b's axes.
    axis_b: Any = None
    # (3, 3) float, optional: Of ``rigid`` only: axes of b, as columns, in the axes of a. By default as built.
    rotation: Any = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (isinstance(self.kind, str) and self.kind in _SLIDES):
            *kinds, last = sorted(_SLIDES)
            raise self.refusal(f"its kind {brief(self.kind)}: give {', '.join(kinds)} or {last}")
        if (self.kind == "universal") != (self.axis_b is not None):
            raise self.refusal("axis_b applies to kind universal only, which requires it")
        self.check(axis=direction, axis_b=optional(direction))
        if self.rotation is not None and self.kind != "rigid":
            raise self.refusal(f"rotation applies to kind rigid, not to {self.kind}")
        self.check(rotation=optional(rotation_matrix))

    def bind(self, bodies: Bodies) -> LoopJoints:
        """Return its equations."""
        (ends,), (points,) = self.ends(bodies)
        # Axes of the joint in the world as built, then in the frame of each body.
        turn = axes_along(self.axis[None])[0]
        world = bodies.built.rotation(self.a[0]) @ turn
        frames = [np.eye(3) if b < 0 else bodies.built.frames.rotation[b] for b in ends]
        in_a, in_b = (frame.T @ world for frame in frames)
        if self.rotation is not None:
            in_b = bodies.axes(int(ends[1])) @ self.rotation.T @ turn
        turns = [(in_a @ s, in_b @ t) for s, t in _TURNS.get(self.kind, ())]
        if self.axis_b is not None:
            turns.append((in_a @ Z, bodies.inside(int(ends[1]), self.axis_b)))
        along = [(in_a @ s, np.zeros(3)) for s in _SLIDES[self.kind]] + turns
        m, slides = len(along), len(along) - len(turns)
        return LoopJoints(
            np.tile(ends, (m, 1)), np.arange(m) >= slides, np.tile(points.reshape(2, 3), (m, 1, 1)),
            np.array(along),
        )  # fmt: skip


def close_loops(bodies: Bodies, closings: Sequence[Closing]) -> Bodies:
    """Close the loops: coordinates and rates that the mechanism was given stay if they can, others follow."""
    if not closings:
        return bodies
    tree = bodies.tree
    ends = np.array(
        [[bodies.number(body, joint.label) for body, _ in (joint.a, joint.b)] for joint in closings]
    )
    closings = [closings[k] for k in order_along(moved_by(tree.locked_links, ends))]
    fixed, q, undriven = _given_coordinates(bodies), bodies.q, tree.undriven_v
    for approached in _approaches(bodies, closings):
        parts = [joint.bind(bodies) for joint in approached]
        joint_of = np.repeat(np.arange(len(parts)), [len(part.body) for part in parts])
        columns: dict[str, Any] = {
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in ("body", "turns", "point", "along")
        }
        joints, nearby = LoopJoints(**columns), replace(bodies, q=q)
        # Given coordinates stay if the other freedoms can close the loops.
        assembled, worst = _assemble(nearby, joints, np.setdiff1d(undriven, np.flatnonzero(fixed)))
        if assembled is None:
            assembled, worst = _assemble(nearby, joints, undriven)
        if assembled is None:
            raise MechanicsError(
                f"{closings[joint_of[worst[0]]].label}: it stays open by {worst[1]:.3g}; give coordinates of "
                "hinges nearer to where it closes",
                fault=Fault.OPEN,
            )
        q = assembled
    joints = replace(joints, rank=_constant_rank(bodies, joints, q, undriven))
    qd = _rates(bodies, joints, q, undriven, [joint.label for joint in closings], joint_of)
    names = tuple(closings[k].name for k in joint_of.tolist())
    return replace(bodies, q=read_only(q), qd=read_only(qd), joints=joints, joint_names=names)


def _approaches(bodies: Bodies, closings: Sequence[Closing]) -> Iterator[list[Closing]]:
    """Yield the closings with their rotations in steps, at most 0.5 rad, from those as built."""
    # The right angles of a rigid joint hold at other rotations, too, which Newton's method finds from afar.
    turned: dict[str, tuple[Floats, Floats]] = {}
    for joint in closings:
        if joint.rotation is not None:
            built = bodies.built.rotation(joint.a[0]).T @ bodies.built.rotation(joint.b[0])
            turned[joint.name] = built, Rotation.from_matrix(built.T @ joint.rotation).as_rotvec()
    angles = [float(np.linalg.norm(turn)) for _, turn in turned.values()]
    steps = max(1, int(np.ceil(max(angles, default=0.0) / 0.5)))
    for k in range(1, steps):
        way = {
            name: built @ Rotation.from_rotvec(k / steps * turn).as_matrix()
            for name, (built, turn) in turned.items()
        }
        yield [replace(joint, rotation=way.get(joint.name)) for joint in closings]
    yield [*closings]


def _constant_rank(bodies: Bodies, joints: LoopJoints, q: Floats, undriven: np.ndarray) -> int | None:
    """Rank of the closed loops, if it is larger when they are open, as for Bennett's linkage."""
    if not len(undriven):
        return None

    def rank(q: Floats) -> int:
        return _rank(_matrix(bodies, joints, q, undriven))

    all_freedoms = np.arange(bodies.tree.n_v)
    away = _away(all_freedoms)
    if rank(open_ := _displace(bodies, q, all_freedoms, away)) == rank(q):
        return None
    # Elsewhere on the loops, by drives too: the start may be a dead point.
    free = null_space(_matrix(bodies, joints, q, all_freedoms), rcond=1e-6)
    displaced = replace(bodies, q=_displace(bodies, q, all_freedoms, free @ (free.T @ away)))
    elsewhere, _ = _assemble(displaced, joints, all_freedoms)
    if elsewhere is None or rank(open_) == (closed_ := rank(elsewhere)):
        return None
    return closed_


def _matrix(bodies: Bodies, joints: LoopJoints, q: Floats, moves: np.ndarray) -> Floats:
    """(m, moves): rates of the errors by the rates of these freedoms, in radians and sizes of the tree."""
    return joints.matrix(bodies.tree, multibody.pose(bodies.tree, q))[:, moves]


def _rank(matrix: Floats) -> int:
    return int(np.linalg.matrix_rank(matrix, 1e-6))


def _away(moves: np.ndarray) -> Floats:
    """Random displacement of these freedoms, in radians and sizes of the tree, the same in each call."""
    return np.asarray(0.05 * np.random.default_rng(0).normal(size=len(moves)))


def _displace(bodies: Bodies, q: Floats, moves: np.ndarray, by: Floats) -> Floats:
    """Coordinates after these freedoms have moved, in radians and sizes of the tree."""
    step = np.zeros(bodies.tree.n_v)
    step[moves] = by
    return multibody.integrate(bodies.tree, q, step * bodies.tree.units)


def closing(bodies: Bodies, joints: LoopJoints, q: Floats) -> Floats | None:
    """Coordinates near q that close the loops by hinges without drives. None beyond a dead point."""
    return _assemble(replace(bodies, q=q), joints, bodies.tree.undriven_v)[0]


def _given_coordinates(bodies: Bodies) -> np.ndarray:
    """(n_v,) bool: freedoms whose coordinates are not zero, and the places of free bodies."""
    tree = bodies.tree
    n_v = np.diff(tree.v_start)
    moved = [np.any(q) for q in np.split(bodies.q, tree.q_start[1:-1])]
    is_given = np.repeat((n_v == 6) | moved, n_v)
    is_given[tree.balls] = is_given[tree.balls[:, :1]]
    return is_given


def _assemble(
    bodies: Bodies, joints: LoopJoints, moves: np.ndarray
) -> tuple[Floats | None, tuple[int, float]]:
    """Coordinates that close the loops by these freedoms, or None. The worst equation, its error."""
    tree, q = bodies.tree, bodies.q
    units = np.where(joints.turns, 1.0, tree.size)
    for _ in range(100):
        error = joints.rows(multibody.pose(tree, q))[0]
        worst = int(np.argmax(np.abs(error) / units))
        if abs(error[worst]) <= CLOSED * units[worst]:
            return q, (worst, 0.0)
        if not len(moves):
            break
        step = least_change(_matrix(bodies, joints, q, moves), -error / units)
        # Newton's method goes astray by longer steps.
        step *= min(1.0, 0.3 / max(float(np.max(np.abs(step))), 1e-300))
        q = _displace(bodies, q, moves, step)
    return None, (worst, abs(float(error[worst])))


def _rates(
    bodies: Bodies, joints: LoopJoints, q: Floats, undriven: np.ndarray, labels: Sequence[str], of: np.ndarray
) -> Floats:
    """Rates (n_v,) that leave the loops closed: given rates stay, the others follow with the least norm."""
    tree, qd = bodies.tree, bodies.qd.copy()
    g = _matrix(bodies, joints, q, np.arange(tree.n_v))
    rates = qd / tree.units
    follow = undriven[qd[undriven] == 0.0]
    if len(follow):
        rates[follow] = least_change(g[:, follow], -(g @ rates))
    left = np.abs(g @ rates)
    worst = int(np.argmax(left))
    # Slower opening is rounding.
    if left[worst] > 1e-6 * np.max(np.abs(rates), initial=0.0):
        by = left[worst] * (1.0 if joints.turns[worst] else tree.size)
        displaced = _matrix(bodies, joints, _displace(bodies, q, follow, _away(follow)), follow)
        dead = joints.rank is None and _rank(g[:, follow]) < _rank(displaced)
        where, remedy = "", "give those of fewer hinges: the others follow"
        if dead:
            where = "at a dead point "
            remedy = "start near it, or give the rate of a hinge that can turn there"
        raise MechanicsError(
            f"{labels[of[worst]]}: {where}the rates of hinges open it by {by:.3g} per time; {remedy}",
            fault=Fault.OPEN,
        )
    return np.asarray(rates * tree.units)
