"""Steps of explicit methods in one kernel, for mechanisms of weights, springs, torsions and joints alone.

A small mechanism's step is some microseconds of arithmetic, but dozens of calls in Python. Those are for what
acts by a function of the user's, remembers, dissipates or is driven; and for steps that fail, whose refusals
they word.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np

from protochain.core.arrays import Floats, Integers, floats, frozen, read_only
from protochain.mechanics.motion import Equations, Phase, System
from protochain.mechanics.multibody import Frames
from protochain.mechanics.multibody.algebra import kernel
from protochain.mechanics.multibody.articulated import (
    Articulated,
    factorise,
    inward_loads,
    outward_rates,
    put_rigid,
)
from protochain.mechanics.multibody.hamilton import put_momenta
from protochain.mechanics.multibody.kinematics import (
    inward_torques,
    move_along,
    outward_frames,
    outward_twists,
)
from protochain.mechanics.multibody.newton_euler import outward_loads
from protochain.mechanics.multibody.rotations import put_rates
from protochain.mechanics.multibody.tree import Q, V
from protochain.mechanics.tableaux import Tableau
from protochain.mechanisms.closed_equations import CLOSED, ITERATIONS, ClosedEquations
from protochain.mechanisms.elements import Conservative, Gravity, weigh
from protochain.mechanisms.linear_springs import Springs, pull
from protochain.mechanisms.loop_joints import LoopJoints, bends, factor_loops_at, gather, proximal, put_rows
from protochain.mechanisms.torsion import Torsions, wind

_NONE = np.empty(0, np.int64)
_NO_JOINTS = LoopJoints(_NONE.reshape(0, 2), np.empty(0), np.empty((0, 2, 3)), np.empty((0, 2, 3)))
_NO_SPRINGS = Springs(np.empty(0, "U1"), _NONE.reshape(0, 2), np.empty((0, 6)), np.empty((0, 3)))
_NO_TORSIONS = Torsions(_NONE, _NONE, np.empty((0, 3)))


@dataclass(frozen=True, eq=False)
class Acts:
    """What acts, as a kernel takes it.

    gravity (3,): Acceleration of free fall.
    ends, points, springs (n, 2) int: As of :class:`Springs`.
    coordinates, freedoms, torsions (k,) int: As of :class:`Torsions`.
    """

    gravity: Floats
    ends: Integers
    points: Floats
    springs: Floats
    coordinates: Integers
    freedoms: Integers
    torsions: Floats

    @classmethod
    def of(cls, parts: Sequence[Conservative]) -> Self | None:
        """Of elements; None if one is of another kind."""
        weights = [part for part in parts if isinstance(part, Gravity)]
        springs = [part for part in parts if isinstance(part, Springs)]
        torsions = [part for part in parts if isinstance(part, Torsions)]
        if len(weights) + len(springs) + len(torsions) < len(parts):
            return None
        pulling, winding = Springs.joined([_NO_SPRINGS, *springs]), Torsions.joined([_NO_TORSIONS, *torsions])
        gravity = read_only(sum((each.acceleration for each in weights), np.zeros(3)))
        return cls(
            gravity, pulling.ends, pulling.points, pulling.constants, winding.coordinates, winding.freedoms,
            winding.constants,
        )  # fmt: skip


@dataclass(frozen=True, eq=False, kw_only=True)
class InOneKernel(Equations):
    """Equations whose explicit steps are one call; all else is as of those it is mixed with."""

    acts: Acts = field(kw_only=True)

    def advance(self, tableau: Tableau, at: Phase, h: float) -> tuple[Phase, Floats, Floats]:
        """Phase after a step of an explicit method, and the errors of its displacement and velocities."""
        tree, acts, joints = self.tree, self.acts, getattr(self, "joints", _NO_JOINTS)
        done, q, qd, p, energy, torque, rotation, origin, *factors, moved, quickened = _step(
            h, *tableau.arrays, tree.links, tree.bodies, tree.size, acts.gravity, acts.ends, acts.points,
            acts.springs, acts.coordinates, acts.freedoms, acts.torsions, joints.body, joints.turns,
            joints.point, joints.along, floats(at.q, (tree.n_q,), "q"), floats(at.qd, (tree.n_v,), "qd"),
        )  # fmt: skip
        if not done:
            return super().advance(tableau, at, h)
        frames = Frames(frozen(rotation), frozen(origin))
        there = Articulated(tree, frames, *map(frozen, factors))
        return Phase(q, qd, p, energy, torque, there, at.time + h, at.work), moved, quickened


@dataclass(frozen=True, eq=False)
class CompiledSystem(InOneKernel, System):
    """A forest of rigid bodies."""


@dataclass(frozen=True, eq=False)
class CompiledLoops(InOneKernel, ClosedEquations):
    """Bodies with loops that joints close."""


@kernel
def _step(
    h: float, a: Floats, b: Floats, wrong: Floats, links: Integers, bodies: Floats, size: float,
    gravity: Floats, ends: Integers, points: Floats, springs: Floats, coordinates: Integers,
    freedoms: Integers, torsions: Floats, body: Integers, turns: np.ndarray, point: Floats, along: Floats,
    start: Floats, speed: Floats,
) -> tuple[Any, ...]:  # fmt: skip
    """Take a step, and close the loops; whether that was possible, the phase, its factors and errors."""
    tree, joints = (links, bodies, size), (body, turns, point, along)
    acts = gravity, ends, points, springs, coordinates, freedoms, torsions
    n, n_v, s = len(bodies), len(speed), len(b)
    rotation, origin, packed = np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((n, 21))
    gain, pivot, root = np.empty((n, 6)), np.empty(n), np.empty((links[n, Q] - links[n, V], 6, 6))
    frames, factors = (rotation, origin), (packed, gain, pivot, root)
    wrenches, loads, held, x = np.empty((n, 6)), np.empty((n, 6)), np.empty(n_v), np.empty(n_v)
    slopes, rates = np.zeros((s + 2, n_v)), np.zeros((s + 2, n_v))
    done, energy, q, qd = True, 0.0, start.copy(), speed.copy()
    # After the stages the step itself; after the step, as often as loops need, what closes them.
    for stage in range(s + 1 + ITERATIONS):
        i, inside = min(stage, s), stage < s
        if stage <= s:
            _put_stage(h, a[i] if inside else b, i, tree, slopes, rates, start, speed, x, q, qd)
        done, energy = _factors_at(inside, tree, acts, q, qd, frames, factors, wrenches, loads, x)
        if not done:
            break
        if inside:
            outward_rates(links, bodies, rotation, origin, gain, root, loads, x)
            rates[i] = x
        if len(body) == 0:
            if inside:
                continue
            break
        gap = _hold(inside, tree, joints, frames, factors, qd, x, loads, held)
        if inside:
            rates[i] += held
        elif gap <= CLOSED:
            qd += held
            break
        else:
            done = stage < s + ITERATIONS
            move_along(links, held, q)
    torque, p, moved, quickened = np.empty(n_v), np.empty(n_v), np.zeros(n_v), np.zeros(n_v)
    if done:
        _act(tree, acts, frames, q, wrenches, x)
        inward_torques(links, bodies, rotation, origin, wrenches, torque)
        torque += x
        put_momenta(links, bodies, rotation, origin, qd, wrenches, loads, p, held)
    for j in range(s):
        for k in range(n_v):
            moved[k] += h * wrong[j] * slopes[j, k]
            quickened[k] += h * wrong[j] * rates[j, k]
    return (
        done, q, qd, p, energy, torque, rotation, origin, packed, gain, pivot, root, moved, quickened
    )  # fmt: skip


@kernel
def _put_stage(
    h: float, weights: Floats, i: int, tree: tuple[Any, ...], slopes: Floats, rates: Floats, start: Floats,
    speed: Floats, x: Floats, q: Floats, qd: Floats,
) -> None:  # fmt: skip
    """Write coordinates and velocities of a stage, of the rates before it; and its displacement's rate."""
    x[:] = 0.0
    qd[:] = speed
    for j in range(i):
        weight = h * weights[j]
        for k in range(len(x)):
            x[k] += weight * slopes[j, k]
            qd[k] += weight * rates[j, k]
    q[:] = start
    move_along(tree[0], x, q)
    slopes[i] = qd
    put_rates(tree[0], x, slopes[i])


@kernel
def _act(
    tree: tuple[Any, ...], acts: tuple[Any, ...], frames: tuple[Floats, Floats], q: Floats, wrenches: Floats,
    torques: Floats,
) -> tuple[bool, float]:  # fmt: skip
    """Write wrenches (nb, 6) and torques (n_v,); whether every force has a direction, and the energy."""
    gravity, ends, points, springs, coordinates, freedoms, torsions = acts
    rotation, origin = frames
    wrenches[:], torques[:] = 0.0, 0.0
    energy = weigh(tree[1], rotation, origin, gravity, wrenches)
    pulled = pull(rotation, origin, ends, points, springs, wrenches)
    return pulled >= 0.0, energy + pulled + wind(coordinates, freedoms, torsions, q, torques)


@kernel
def _factors_at(
    inside: bool, tree: tuple[Any, ...], acts: tuple[Any, ...], q: Floats, qd: Floats,
    frames: tuple[Floats, Floats], factors: tuple[Any, ...], wrenches: Floats, loads: Floats, x: Floats,
) -> tuple[bool, float]:  # fmt: skip
    """Write frames and factors, and inside a step what accelerates; whether they exist, and the energy."""
    (links, bodies, _), (rotation, origin), (packed, gain, pivot, root) = tree, frames, factors
    outward_frames(links, bodies, q, rotation, origin)
    put_rigid(rotation, bodies, packed)
    fine, energy = _act(tree, acts, frames, q, wrenches, x)
    loads[:] = 0.0
    if inside:
        outward_loads(links, bodies, rotation, origin, qd, np.zeros(len(qd)), loads)
        loads -= wrenches
    if fine:
        fine = factorise(links, bodies, rotation, origin, packed, gain, pivot, root, loads, x) < 0
    return fine, energy


@kernel
def _hold(
    inside: bool, tree: tuple[Any, ...], joints: tuple[Any, ...], frames: tuple[Floats, Floats],
    factors: tuple[Any, ...], qd: Floats, qdd: Floats, loads: Floats, held: Floats,
) -> float:  # fmt: skip
    """Write the accelerations inside a step, else the velocities, else the displacement that joints ask for.

    -> How far loops are open: after the step velocities are held once they are closed.
    """
    (links, bodies, size), (body, turns, point, along) = tree, joints
    (rotation, origin), (_, gain, pivot, root) = frames, factors
    m, gap = len(body), 0.0
    error, rows = np.empty(m), np.zeros((m, 2, 6))
    put_rows(rotation, origin, body, turns, point, along, error, rows)
    scales, inverse, factor, last = factor_loops_at(
        links, bodies, rotation, origin, gain, pivot, root, body, rows, size
    )
    for k in range(m):
        gap = max(gap, abs(error[k]) / (1.0 if turns[k] else size))
    if inside:
        error = -bends(links, bodies, rotation, origin, body, turns, point, along, qd, qdd)
    elif gap <= CLOSED:
        outward_twists(links, bodies, rotation, origin, qd, loads)
        for k in range(m):
            error[k] = 0.0
            for side in range(2):
                if body[k, side] >= 0:
                    error[k] -= np.dot(rows[k, side], loads[body[k, side]])
    else:
        error *= -1.0
    loads[:], held[:] = 0.0, 0.0
    gather(body, rows, scales * proximal(inverse, factor, last, scales * error), loads)
    loads *= -1.0
    inward_loads(links, bodies, rotation, origin, gain, pivot, loads, held)
    outward_rates(links, bodies, rotation, origin, gain, root, loads, held)
    return gap
