"""Steps of explicit methods in one kernel, for mechanisms of weights, springs, dampers and joints alone.

A small mechanism's step is some microseconds of arithmetic, but dozens of calls in Python. Those are for what
act by a function of the user's, remember or are driven, and for failing steps, whose refusals
they word.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from protochain.core.arrays import Floats, floats, freeze, read_only
from protochain.mechanics.motion import DormandPrince, Equations, Phase, RungeKutta4, System
from protochain.mechanics.multibody import Frames, articulated, kinematics
from protochain.mechanics.multibody.algebra import kernel
from protochain.mechanics.multibody.articulated import Articulated
from protochain.mechanics.multibody.hamilton import put_momenta
from protochain.mechanics.multibody.newton_euler import outward_loads
from protochain.mechanics.multibody.rotations import put_rates
from protochain.mechanics.multibody.tree import Q, V
from protochain.mechanics.tableaux import Tableau
from protochain.mechanisms import loop_joints
from protochain.mechanisms.elements import Conservative, Damping, Gravity, weigh
from protochain.mechanisms.hinge_springs import Torsions, slow, wind
from protochain.mechanisms.linear_springs import Springs, pull, resist
from protochain.mechanisms.loop_joints import CLOSED, ITERATIONS, ClosedEquations, LoopJoints

_MOST, _LEAST = 100_000, 1e-9
"""Substeps of a step, and the shortest by the step, as of ``in_substeps``, which words what fails."""
_NONE = np.empty(0, np.int64)
_NO_JOINTS = LoopJoints(_NONE.reshape(0, 2), np.empty(0, np.bool_), np.empty((0, 2, 3)), np.empty((0, 2, 3)))
_NO_SPRINGS = Springs(np.empty(0, "U1"), _NONE.reshape(0, 2), np.empty((0, 6)), np.empty((0, 3)))
_NO_TORSIONS = Torsions(_NONE, _NONE, np.empty((0, 3)))


def arrays_of(parts: Sequence[Conservative], dampers: Sequence[Damping]) -> tuple[Any, ...] | None:
    """Forces and dampers as arguments of a kernel. None if an element is of another kind."""
    # Acceleration of free fall; ends, points and constants of :class:`Springs`; coordinates, freedoms and
    # constants of :class:`Torsions`. Dampers have the same, but gravity.
    weights = [part.acceleration for part in parts if isinstance(part, Gravity)]
    other_parts = [part for part in parts if not isinstance(part, Gravity)]
    if not all(isinstance(part, Springs | Torsions) for part in (*other_parts, *dampers)):
        return None
    gravity = read_only(sum(weights, np.zeros(3)))
    return (gravity, *_rows(other_parts)), _rows(dampers)


def _rows(parts: Sequence[Any]) -> tuple[Any, ...]:
    """Springs and torsions of all parts as arrays."""
    springs = Springs.concatenate([_NO_SPRINGS, *(part for part in parts if isinstance(part, Springs))])
    torsions = Torsions.concatenate([_NO_TORSIONS, *(part for part in parts if isinstance(part, Torsions))])
    return (
        springs.ends, springs.points, springs.constants, torsions.coordinates, torsions.freedoms,
        torsions.constants,
    )  # fmt: skip


@dataclass(frozen=True, eq=False, kw_only=True)
class InOneKernel(Equations):
    """Equations whose explicit steps are one call. The rest is inherited from the other base."""

    acts: tuple[Any, ...] = field(kw_only=True)

    @cached_property
    def _arrays(self) -> tuple[Any, ...]:
        """Arguments that are the same in every step."""
        tree, joints = self.tree, getattr(self, "joints", _NO_JOINTS)
        return (
            (tree.links, tree.bodies, tree.size),
            *self.acts,
            (joints.body, joints.turns, joints.point, joints.along),
        )

    def advance(self, tableau: Tableau, at: Phase, h: float) -> tuple[Phase, Floats, Floats]:
        """Phase after a step of an explicit method, and the errors of its displacement and velocities."""
        tree = self.tree
        start, speed = floats(at.q, (tree.n_q,), "q"), floats(at.qd, (tree.n_v,), "qd")
        # Copies may be written to, as in a march: the step is compiled once.
        valid, *state, moved, quickened = _step(h, tableau.arrays, self._arrays, start.copy(), speed.copy())
        if not valid:
            return super().advance(tableau, at, h)
        return self._phase(state, at.time + h, at.work), moved, quickened

    def march(
        self, method: RungeKutta4 | DormandPrince, at: Phase, h: float, steps: int, stride: int
    ) -> tuple[list[Any], Phase, int]:
        """March in one call, in substeps within a tolerance, if the method has one."""
        # -> Rows as of :data:`Row`, one for ``every`` steps; the phase at the end, and how many steps were
        # possible.
        if steps < 1 or not len(at.q):
            return [], at, 0
        work = at.work.sum()
        n_taken, end, rows = _march(
            h, method.tableau.arrays, self._arrays, floats(at.q, (self.tree.n_q,), "q"),
            floats(at.qd, (self.tree.n_v,), "qd"), work, at.time, steps, stride,
            getattr(method, "tolerance", 0.0), method.order, self.units,
        )  # fmt: skip
        if not n_taken:
            return [], at, 0
        times, q, qd, p, energies, works = (column[: n_taken // stride] for column in rows)
        worked = works[:, None] if len(at.work) else np.empty((len(works), 0))
        listed = zip(times.tolist(), q, qd, p, energies.tolist(), worked, [0.0] * len(works), strict=True)
        *state, total, time = end
        return list(listed), self._phase((*state, total - work), time, at.work), n_taken

    def _phase(self, state: Sequence[Any], time: float, work: Floats) -> Phase:
        """Phase at the end of steps, after work before them."""
        q, qd, p, energy, torque, rotation, origin, packed, gain, pivot, root, damped, added = state
        frames = Frames(freeze(rotation), freeze(origin))
        factors_there = Articulated(self.tree, frames, *map(freeze, (packed, gain, pivot, root)))
        if not self.loads:
            return Phase(q, qd, p, energy, torque, factors_there, time, work)
        return Phase(q, qd, p, energy, torque, factors_there, time, work + added, damped[None])


@dataclass(frozen=True, eq=False)
class CompiledSystem(InOneKernel, System):
    """A forest of rigid bodies."""


@dataclass(frozen=True, eq=False)
class CompiledLoops(InOneKernel, ClosedEquations):
    """Bodies with loops that joints close."""


@kernel
def _march(
    h: float, tableau: tuple[Any, ...], arrays: tuple[Any, ...], start: Floats, speed: Floats, work: float,
    time: float, steps: int, stride: int, tolerance: float, order: int, units: Floats,
) -> tuple[Any, ...]:  # fmt: skip
    """Steps that were possible, the last phase with work and time, and the rows. See ``march``."""
    n, total, now, n_taken = steps // stride, work, time, 0
    times, qs, qds = np.empty(n), np.empty((n, len(start))), np.empty((n, len(speed)))
    ps, energies, works = np.empty((n, len(speed))), np.empty(n), np.empty(n)
    last = _step(0.0, tableau, arrays, start.copy(), speed.copy())
    for i in range(steps):
        current, possible, elapsed, spent, part = last, True, 0.0, total, h
        for _ in range(_MOST):
            if not abs(h - elapsed) > 1e-12 * abs(h):
                break
            part = part if abs(part) < abs(h - elapsed) else h - elapsed
            if abs(part) <= _LEAST * abs(h):
                possible = False
                break
            tried = _step(part, tableau, arrays, current[1], current[2])
            size = 0.0 if tried[0] else np.inf
            if tolerance > 0.0 and tried[0]:
                for k in range(len(units)):
                    error_of_step = max(abs(tried[14][k]), abs(h) * abs(tried[15][k])) / units[k]
                    size = max(size, error_of_step / tolerance) if error_of_step < np.inf else np.inf
            # As in_substeps: 0.9 of the estimated substep, within bounds.
            factor = 5.0 if size == 0.0 else min(5.0, max(0.2, 0.9 * size ** (-1.0 / order)))
            if size <= 1.0:
                current, elapsed, spent = tried, elapsed + part, spent + tried[13]
            else:
                factor = min(factor, 0.9)
            part *= factor
            if tolerance == 0.0 and not tried[0]:
                possible = False
                break
        if not possible or abs(h - elapsed) > 1e-12 * abs(h):
            break
        last, total, now, n_taken = current, spent, now + h, i + 1
        if n_taken % stride == 0:
            k = i // stride
            times[k], qs[k], qds[k], ps[k] = now, last[1], last[2], last[3]
            energies[k], works[k] = last[4], total
    return n_taken, (*last[1:13], total, now), (times, qs, qds, ps, energies, works)


@kernel
def _step(
    h: float, tableau: tuple[Any, ...], arrays: tuple[Any, ...], start: Floats, speed: Floats
) -> tuple[Any, ...]:
    """Take a step, and close the loops."""
    # -> Whether that was possible; coordinates, velocities, momenta, energy and torques; frames and factors;
    # torques of dampers, and their work; errors of displacement and velocities.
    (a, b, error_weights), (tree, acts, dampers, joints) = tableau, arrays
    links, bodies, _ = tree
    n, n_v, s = len(bodies), len(speed), len(b)
    rotation, origin, packed = np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((n, 21))
    gain, pivot, root = np.empty((n, 6)), np.empty(n), np.empty((links[n, Q] - links[n, V], 6, 6))
    frames, factors = (rotation, origin), (packed, gain, pivot, root)
    wrenches, loads, torques_damped, x = np.empty((n, 6)), np.empty((n, 6)), np.empty(n_v), np.empty(n_v)
    slopes, rates = np.zeros((s + 2, n_v)), np.zeros((s + 2, n_v))
    damped, twists = np.zeros(n_v), np.empty((n, 6))
    valid, energy, work, q, qd = True, 0.0, 0.0, start.copy(), speed.copy()
    # After the stages the step itself; after the step, as often as loops need, what closes them.
    for stage in range(s + 1 + ITERATIONS):
        i, inside = min(stage, s), stage < s
        if stage <= s:
            _put_stage(h, a[i] if inside else b, i, tree, slopes, rates, start, speed, x, q, qd)
        kinematics.outward_frames(links, bodies, q, rotation, origin)
        valid, energy = _act(tree, acts, frames, q, wrenches, x)
        if inside and len(dampers[0]) + len(dampers[3]) > 0:
            work += h * b[i] * _damp(tree, dampers, frames, qd, twists, loads, damped, torques_damped)
            wrenches += loads
            x += torques_damped
        if not (valid and _factors_at(inside, tree, qd, frames, factors, wrenches, loads, x)):
            valid = False
            break
        if inside:
            articulated.outward_rates(links, bodies, rotation, origin, gain, root, loads, x)
            rates[i] = x
        if len(joints[0]) == 0:
            if inside:
                continue
            break
        gap = _satisfy_joints(inside, tree, joints, frames, factors, qd, x, loads, torques_damped)
        if inside:
            rates[i] += torques_damped
        elif gap <= CLOSED:
            qd += torques_damped
            break
        else:
            valid = stage < s + ITERATIONS
            kinematics.move_along(links, torques_damped, q)
    torque, p, moved, quickened = np.empty(n_v), np.empty(n_v), np.zeros(n_v), np.zeros(n_v)
    if valid:
        _act(tree, acts, frames, q, wrenches, x)
        kinematics.inward_torques(links, bodies, rotation, origin, wrenches, torque)
        torque += x
        if len(dampers[0]) + len(dampers[3]) > 0:
            _damp(tree, dampers, frames, qd, twists, loads, damped, torques_damped)
            torque += damped
        put_momenta(links, bodies, rotation, origin, qd, wrenches, loads, p, torques_damped)
    for j in range(s):
        for k in range(n_v):
            moved[k] += h * error_weights[j] * slopes[j, k]
            quickened[k] += h * error_weights[j] * rates[j, k]
    return (
        valid, q, qd, p, energy, torque, rotation, origin, packed, gain, pivot, root, damped, work,
        moved, quickened,
    )  # fmt: skip


@kernel
def _damp(
    tree: tuple[Any, ...], dampers: tuple[Any, ...], frames: tuple[Floats, Floats], qd: Floats,
    twists: Floats, loads: Floats, damped: Floats, torques: Floats,
) -> float:  # fmt: skip
    """Write wrenches and torques of dampers, and both as torques (n_v,), ``damped``. Return their power."""
    (links, bodies, _), (rotation, origin) = tree, frames
    ends, points, springs, _, freedoms, torsions = dampers
    kinematics.outward_twists(links, bodies, rotation, origin, qd, twists)
    loads[:], torques[:] = 0.0, 0.0
    resist(rotation, origin, twists, ends, points, springs, loads)
    slow(freedoms, torsions, qd, torques)
    twists[:] = loads
    kinematics.inward_torques(links, bodies, rotation, origin, twists, damped)
    damped += torques
    return np.dot(damped, qd)


@kernel
def _put_stage(
    h: float, weights: Floats, i: int, tree: tuple[Any, ...], slopes: Floats, rates: Floats, start: Floats,
    speed: Floats, x: Floats, q: Floats, qd: Floats,
) -> None:  # fmt: skip
    """Write coordinates and velocities of a stage by the previous rates, and its displacement's rate."""
    x[:] = 0.0
    qd[:] = speed
    for j in range(i):
        weight = h * weights[j]
        for k in range(len(x)):
            x[k] += weight * slopes[j, k]
            qd[k] += weight * rates[j, k]
    q[:] = start
    kinematics.move_along(tree[0], x, q)
    slopes[i] = qd
    put_rates(tree[0], x, slopes[i])


@kernel
def _act(
    tree: tuple[Any, ...], acts: tuple[Any, ...], frames: tuple[Floats, Floats], q: Floats, wrenches: Floats,
    torques: Floats,
) -> tuple[bool, float]:  # fmt: skip
    """Write wrenches (nb, 6) and torques (n_v,). Return whether all forces have directions, and energy."""
    gravity, ends, points, springs, coordinates, freedoms, torsions = acts
    rotation, origin = frames
    wrenches[:], torques[:] = 0.0, 0.0
    energy = weigh(tree[1], rotation, origin, gravity, wrenches)
    pulled = pull(rotation, origin, ends, points, springs, wrenches)
    return pulled >= 0.0, energy + pulled + wind(coordinates, freedoms, torsions, q, torques)


@kernel
def _factors_at(
    inside: bool, tree: tuple[Any, ...], qd: Floats, frames: tuple[Floats, Floats], factors: tuple[Any, ...],
    wrenches: Floats, loads: Floats, x: Floats,
) -> bool:  # fmt: skip
    """Write factors, and within a step the accelerating torques. Return whether the factors exist."""
    (links, bodies, _), (rotation, origin), (packed, gain, pivot, root) = tree, frames, factors
    articulated.put_rigid(rotation, bodies, packed)
    loads[:] = 0.0
    if inside:
        outward_loads(links, bodies, rotation, origin, qd, np.zeros(len(qd)), loads)
        loads -= wrenches
    failed: int = articulated.factorise(links, bodies, rotation, origin, packed, gain, pivot, root, loads, x)
    return failed < 0


@kernel
def _satisfy_joints(
    inside: bool, tree: tuple[Any, ...], joints: tuple[Any, ...], frames: tuple[Floats, Floats],
    factors: tuple[Any, ...], qd: Floats, qdd: Floats, loads: Floats, correction: Floats,
) -> float:  # fmt: skip
    """Write accelerations inside a step, else the velocities, else the displacement that joints ask for."""
    # -> How far loops are open: after the step velocities are corrected once they are closed.
    (links, bodies, size), (body, turns, point, along) = tree, joints
    (rotation, origin), (_, gain, pivot, root) = frames, factors
    m, gap = len(body), 0.0
    error, rows = np.empty(m), np.zeros((m, 2, 6))
    loop_joints.put_rows(rotation, origin, body, turns, point, along, error, rows)
    scales, coefficients, order, _ = loop_joints.factor_loops_at(
        links, bodies, rotation, origin, gain, pivot, root, body, rows, size
    )
    for k in range(m):
        gap = max(gap, abs(error[k]) / (1.0 if turns[k] else size))
    if inside:
        error = -loop_joints.bends(links, bodies, rotation, origin, body, turns, point, along, qd, qdd)
    elif gap <= CLOSED:
        kinematics.outward_twists(links, bodies, rotation, origin, qd, loads)
        for k in range(m):
            error[k] = 0.0
            for side in range(2):
                if body[k, side] >= 0:
                    error[k] -= np.dot(rows[k, side], loads[body[k, side]])
    else:
        error *= -1.0
    loads[:], correction[:] = 0.0, 0.0
    loop_joints.gather(body, rows, loop_joints.least_impulses(scales, coefficients, order, error), loads)
    loads *= -1.0
    articulated.inward_loads(links, bodies, rotation, origin, gain, pivot, loads, correction)
    articulated.outward_rates(links, bodies, rotation, origin, gain, root, loads, correction)
    return gap
