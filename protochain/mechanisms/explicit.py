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
def _act(
    bodies: Floats, rotation: Floats, origin: Floats, q: Floats, gravity: Floats, ends: Integers,
    points: Floats, springs: Floats, coordinates: Integers, freedoms: Integers, torsions: Floats,
    wrenches: Floats, torques: Floats,
) -> tuple[bool, float]:  # fmt: skip
    """Write wrenches (nb, 6) and torques (n_v,); whether every force has a direction, and the energy."""
    wrenches[:], torques[:] = 0.0, 0.0
    energy = weigh(bodies, rotation, origin, gravity, wrenches)
    pulled = pull(rotation, origin, ends, points, springs, wrenches)
    return pulled >= 0.0, energy + pulled + wind(coordinates, freedoms, torsions, q, torques)


@kernel
def _step(
    h: float, a: Floats, b: Floats, wrong: Floats, links: Integers, bodies: Floats, size: float,
    gravity: Floats, ends: Integers, points: Floats, springs: Floats, coordinates: Integers,
    freedoms: Integers, torsions: Floats, body: Integers, turns: np.ndarray, point: Floats, along: Floats,
    start: Floats, speed: Floats,
) -> tuple[Any, ...]:  # fmt: skip
    """Take a step, and close the loops; whether that was possible, the phase, its factors and errors."""
    n, n_v, s, m = len(bodies), len(speed), len(b), len(body)
    rotation, origin, packed = np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((n, 21))
    gain, pivot, root = np.empty((n, 6)), np.empty(n), np.empty((links[n, Q] - links[n, V], 6, 6))
    wrenches, loads, still = np.empty((n, 6)), np.empty((n, 6)), np.zeros(n_v)
    error, rows, held, x = np.empty(m), np.zeros((m, 2, 6)), np.empty(n_v), np.empty(n_v)
    slopes, rates = np.zeros((s + 2, n_v)), np.zeros((s + 2, n_v))
    done, energy, q, qd = True, 0.0, start.copy(), speed.copy()
    # After the stages the step itself; after the step, as often as loops need, what closes them.
    for stage in range(s + 1 + ITERATIONS):
        i = min(stage, s)
        if stage <= s:
            x[:] = 0.0
            qd[:] = speed
            for j in range(i):
                weight = h * (a[i, j] if i < s else b[j])
                for k in range(n_v):
                    x[k] += weight * slopes[j, k]
                    qd[k] += weight * rates[j, k]
            q[:] = start
            move_along(links, x, q)
            slopes[i] = qd
            put_rates(links, x, slopes[i])
        outward_frames(links, bodies, q, rotation, origin)
        put_rigid(rotation, bodies, packed)
        fine, energy = _act(
            bodies, rotation, origin, q, gravity, ends, points, springs, coordinates, freedoms, torsions,
            wrenches, x,
        )  # fmt: skip
        loads[:] = 0.0
        if i < s:
            outward_loads(links, bodies, rotation, origin, qd, still, loads)
            loads -= wrenches
        if not fine or factorise(links, bodies, rotation, origin, packed, gain, pivot, root, loads, x) >= 0:
            done = False
            break
        if i < s:
            outward_rates(links, bodies, rotation, origin, gain, root, loads, x)
            rates[i] = x
        if m > 0:
            rows[:] = 0.0
            put_rows(rotation, origin, body, turns, point, along, error, rows)
            scales, inverse, factor, last = factor_loops_at(
                links, bodies, rotation, origin, gain, pivot, root, body, rows, size
            )
            gap = 0.0
            for k in range(m):
                gap = max(gap, abs(error[k]) / (1.0 if turns[k] else size))
            if i < s:
                error = -bends(links, bodies, rotation, origin, body, turns, point, along, qd, x)
            elif gap <= CLOSED:
                outward_twists(links, bodies, rotation, origin, qd, loads)
                for k in range(m):
                    error[k] = 0.0
                    for side in range(2):
                        if body[k, side] >= 0:
                            error[k] -= np.dot(rows[k, side], loads[body[k, side]])
            elif stage == s + ITERATIONS:
                done = False
                break
            else:
                error *= -1.0
            loads[:], held[:] = 0.0, 0.0
            gather(body, rows, scales * proximal(inverse, factor, last, scales * error), loads)
            loads *= -1.0
            inward_loads(links, bodies, rotation, origin, gain, pivot, loads, held)
            outward_rates(links, bodies, rotation, origin, gain, root, loads, held)
            if i < s:
                rates[i] += held
            elif gap <= CLOSED:
                qd += held
                break
            else:
                move_along(links, held, q)
        elif i == s:
            break
    torque, p, moved, quickened = np.empty(n_v), np.empty(n_v), np.zeros(n_v), np.zeros(n_v)
    if done:
        _act(
            bodies, rotation, origin, q, gravity, ends, points, springs, coordinates, freedoms, torsions,
            wrenches, x,
        )  # fmt: skip
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
