"""Steps of explicit methods in one kernel, for mechanisms whose elements are arrays of numbers.

A small mechanism's step is some microseconds of arithmetic, but dozens of calls in Python. Calls in Python
remain for elements that depend on the state or have a memory. They also report failing steps. Functions of
time are evaluated before the steps.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from struct import Struct
from typing import Any, NamedTuple

import numpy as np

from protochain.core.arrays import Floats, Integers, floats, freeze, read_only
from protochain.mechanics.motion import DormandPrince, Drive, Equations, Load, Phase, RungeKutta4, System
from protochain.mechanics.multibody import Frames, Tree, algebra, articulated, kinematics
from protochain.mechanics.multibody.algebra import inner_kernel, kernel
from protochain.mechanics.multibody.articulated import Articulated
from protochain.mechanics.multibody.hamilton import put_momenta
from protochain.mechanics.multibody.kernel_arrays import borrow, copy, copy_row, scatter
from protochain.mechanics.multibody.massless import find_slack
from protochain.mechanics.multibody.newton_euler import outward_loads
from protochain.mechanics.multibody.rotations import put_rates
from protochain.mechanics.multibody.tree import Q, V
from protochain.mechanics.tableaux import Tableau
from protochain.mechanisms import loop_factors, loop_joints
from protochain.mechanisms.bushing import Bushings, bend_bushings, resist_bushings
from protochain.mechanisms.compiled_loads import (
    FRICTION,
    HingeLoad,
    arrays_of_hinges,
    bend_axes,
    press_hinges,
    turn_hinges,
)
from protochain.mechanisms.elements import Conservative, Dampers, Gravity, weigh
from protochain.mechanisms.hinge_springs import Stopped, Torsions, push_back, slow, wind
from protochain.mechanisms.linear_springs import Springs, pull, resist
from protochain.mechanisms.loop_joints import CLOSED, ITERATIONS, ClosedEquations, LoopJoints
from protochain.mechanisms.motors import Drives

_MOST, _LEAST = 100_000, 1e-9
"""Substeps of a step, and the shortest by the step, as of ``in_substeps``, which words what fails."""
_AT_ONCE = 1024
"""Steps for which functions of time are evaluated at once."""
_pack = Struct("3d").pack
"""Three numbers -> their bytes. Any other count is refused."""
_NONE = np.empty(0, np.int64)
_NO_JOINTS = LoopJoints(_NONE.reshape(0, 2), np.empty(0, np.bool_), np.empty((0, 2, 3)), np.empty((0, 2, 3)))
_NO_SPRINGS = Springs(np.empty(0, "U1"), _NONE.reshape(0, 2), np.empty((0, 6)), np.empty((0, 3)))
_NO_TORSIONS = Torsions(_NONE, _NONE, np.empty((0, 3)))
_NO_BUSHINGS = Bushings(
    np.empty(0, "U1"), _NONE.reshape(0, 2), np.empty((0, 6)), *[np.empty((0, 3, 3))] * 2,
    *[np.empty((0, 6))] * 2,
)  # fmt: skip


class Compiled(NamedTuple):
    """Elements, as arguments of a kernel."""

    # Gravity, springs, torsions; springs and torsions that damp; the other elements, None without them.
    arrays: tuple[Any, ...]
    n_loads: int
    motions: tuple[Any, ...]  # Functions of time, which return three numbers each.
    units: Floats  # (k, 1): Internal values of their units.


def compile_elements(
    tree: Tree,
    parts: Sequence[Conservative],
    loads: Sequence[Load],
    drive: Drive | None,
    joints: LoopJoints | None,
) -> Compiled | None:
    """Elements as arguments of a kernel. None if one of them is a function of the state, or remembers."""
    dampers = [part for load in loads if isinstance(load, Dampers) for part in load.parts]
    # A subclass may compute other forces.
    compiled_kinds = Gravity, Springs, Torsions, Bushings, Stopped
    at_hinges = [load for load in loads if isinstance(load, HingeLoad)]
    pressed = [row for load in at_hinges for row in load.rows if row.kind == FRICTION and row.constants[3]]
    known = [load.gravity for load in at_hinges if load.gravity is not None]
    if (
        not all(type(part) in compiled_kinds for part in (*parts, *dampers))
        or not all(type(load) in (Dampers, HingeLoad) for load in loads)
        or not all(load.is_compiled for load in at_hinges)
        or not all(np.array_equal(gravity, known[0]) for gravity in known)
        or not (drive is None or type(drive) is Drives)
        or (joints is not None and (joints.rank is not None or pressed))
    ):
        return None
    gravity = read_only(sum((part.acceleration for part in parts if isinstance(part, Gravity)), np.zeros(3)))
    hinges, moving = arrays_of_hinges(loads)
    drives = () if drive is None else drive.drives
    units = [row.unit for row in moving] + ([] if drive is None else drive.units.tolist())
    others = (Bushings, Stopped)
    simple = tree.is_plain and all(isinstance(load, Dampers) for load in loads)
    extras = None
    if not simple or any(isinstance(part, others) for part in (*parts, *dampers)):
        stops = [part for part in parts if isinstance(part, Stopped)]
        bushings, damping = (
            Bushings.concatenate([_NO_BUSHINGS, *(part for part in some if isinstance(part, Bushings))])
            for some in (parts, dampers)
        )
        extras = (
            _driven_arrays(tree), tree.rotors, hinges,
            (bushings.ends, bushings.points, bushings.axes_a, bushings.axes_b, bushings.stiffness),
            (damping.ends, damping.points, damping.axes_b, damping.damping),
            read_only(np.array([(s.coordinate, s.freedom) for s in stops]).reshape(-1, 2), np.int64),
            read_only(np.reshape([(s.low, s.high, s.stiffness) for s in stops], (-1, 3))),
        )  # fmt: skip
    arrays = (gravity, *_rows(parts)), _rows(dampers), extras
    motions = *(row.motion for row in moving), *(driven.motion for driven in drives)
    return Compiled(arrays, len(loads), motions, read_only(np.reshape(units, (-1, 1))))


def _driven_arrays(tree: Tree) -> tuple[Any, ...]:
    """Arrays of driven hinges and balls, and whether a body has no mass."""
    return (
        tree.locked_links, tree.undriven_v, tree.driven_v, tree.driven_q, tree.balls, len(tree.massless) > 0,
    )  # fmt: skip


def _rows(parts: Sequence[Any]) -> tuple[Any, ...]:
    """Springs and torsions of all parts as arrays."""
    springs = Springs.concatenate([_NO_SPRINGS, *(part for part in parts if isinstance(part, Springs))])
    torsions = Torsions.concatenate([_NO_TORSIONS, *(part for part in parts if isinstance(part, Torsions))])
    return (
        springs.ends, springs.points, springs.constants, torsions.coordinates, torsions.freedoms,
        torsions.constants,
    )  # fmt: skip


@cache
def _parts_of(tableau: Tableau) -> tuple[list[float], Integers]:
    """Times between start and end of a step, by the step, and the places of stages and end among all."""
    parts = np.concatenate([[0.0], np.sum(tableau.arrays[0], axis=1), [1.0]])
    _, first, places = np.unique(np.round(parts, 12), return_index=True, return_inverse=True)
    # The kernel's own arrays may be written to: an array of the other type would compile the step again.
    return parts[first[1:-1]].tolist(), places[1:].astype(np.int64)


@dataclass(frozen=True, eq=False, kw_only=True)
class InOneKernel(Equations):
    """Equations whose explicit steps are one call. The rest is inherited from the other base."""

    compiled: Compiled = field(kw_only=True)

    @cached_property
    def _arrays(self) -> tuple[Any, ...]:
        """Arguments that are the same in every step."""
        tree, joints = self.tree, getattr(self, "joints", _NO_JOINTS)
        return (
            (tree.links, tree.bodies, tree.size),
            self.compiled.n_loads + (self.drive is not None),
            *self.compiled.arrays[:2],
            (joints.body, joints.turns, joints.point, joints.along, joints.fronts(tree)),
        )

    def advance(self, tableau: Tableau, at: Phase, h: float) -> tuple[Phase, Floats, Floats]:
        """Phase after a step of an explicit method, and the errors of its displacement and velocities."""
        tree = self.tree
        start, speed = floats(at.q, (tree.n_q,), "q"), floats(at.qd, (tree.n_v,), "qd")
        times, places = self._stage_times(tableau, at.time, h, 1)
        targets = self._targets(times)
        if targets is None:
            return super().advance(tableau, at, h)
        # Copies may be written to, as in a march: the step is compiled once.
        valid, *state, moved, quickened = _step(
            h,
            tableau.arrays,
            self._arrays,
            self.compiled.arrays[2],
            start.copy(),
            speed.copy(),
            targets,
            places,
        )
        if not valid:
            return super().advance(tableau, at, h)
        return self._phase(state, at.time + h, at.work), moved, quickened

    def march(
        self, method: RungeKutta4 | DormandPrince, at: Phase, h: float, steps: int, stride: int
    ) -> tuple[list[Any], Phase, int]:
        """March in one call, in substeps within a tolerance, if the method has one."""
        # -> Rows as of :data:`Row`, one for ``every`` steps; the phase at the end, and how many steps were
        # possible.
        tolerance, n_marched, listed = getattr(method, "tolerance", 0.0), 0, []
        moving = bool(self.compiled.motions)
        if steps < 1 or not len(at.q) or (moving and (tolerance > 0.0 or stride > 100 * _AT_ONCE)):
            return [], at, 0
        at_once = stride * max(1, _AT_ONCE // stride) if moving else steps
        while n_marched < steps:
            n = min(at_once, steps - n_marched)
            rows, at, n_taken = self._march(method, at, h, n, stride, tolerance)
            listed += rows
            n_marched += n_taken
            if n_taken < at_once:
                break
        return listed, at, n_marched

    def _march(
        self,
        method: RungeKutta4 | DormandPrince,
        at: Phase,
        h: float,
        steps: int,
        stride: int,
        tolerance: float,
    ) -> tuple[list[Any], Phase, int]:
        times, places = self._stage_times(method.tableau, at.time, h, steps)
        targets = self._targets(times)
        if targets is None:
            return [], at, 0
        # Arrays that may not be written to are of another type, for which the march is compiled again.
        n_taken, end, rows = _march(
            h, method.tableau.arrays, self._arrays, self.compiled.arrays[2],
            floats(at.q, (self.tree.n_q,), "q").copy(), floats(at.qd, (self.tree.n_v,), "qd").copy(),
            at.work.copy(), at.time,
            steps, stride, tolerance, method.order, self.units, targets, places,
        )  # fmt: skip
        if not n_taken:
            return [], at, 0
        times, q, qd, p, energies, works = (column[: n_taken // stride] for column in rows)
        listed = zip(times.tolist(), q, qd, p, energies.tolist(), works, [0.0] * len(works), strict=True)
        *state, total, time = end
        return list(listed), self._phase((*state, total - at.work), time, at.work), n_taken

    def _stage_times(
        self, tableau: Tableau, time: float, h: float, steps: int
    ) -> tuple[list[float], Integers]:
        """Times of the stages of steps, and the places of those of one step among them."""
        if not self.compiled.motions:
            return [], np.zeros(len(tableau.arrays[1]) + 1, np.int64)
        inner, places = _parts_of(tableau)
        times = [time]
        for _ in range(steps):
            times += [times[-1] + part * h for part in inner] + [times[-1] + h]
        return times, places

    def _targets(self, times: Sequence[float]) -> Floats | None:
        """(len(times), k, 3) float: functions of time. None if one fails, which calls in Python report."""
        motions = self.compiled.motions
        if not motions:
            return np.empty((1, 0, 3))
        try:
            # Arrays refuse all but three numbers, but an array for every answer would take longer than the
            # rest of a step. Both copy at once: a function may return the same array at all times.
            first = np.array([np.array(motion(times[0]), float) for motion in motions])
            rest = b"".join([_pack(*motion(time)) for time in times[1:] for motion in motions])
        except Exception:  # Functions of the user's may raise anything.
            return None
        if first.shape != (len(motions), 3):
            return None
        values = np.concatenate([first.ravel(), np.frombuffer(rest)]).reshape(len(times), *first.shape)
        return np.asarray(values * self.compiled.units) if np.all(np.isfinite(values)) else None

    def _phase(self, state: Sequence[Any], time: float, work: Floats) -> Phase:
        """Phase at the end of steps, after work before them."""
        q, qd, p, energy, torque, rotation, origin, packed, gain, pivot, root, forces, added = state
        frames = Frames(freeze(rotation), freeze(origin))
        factors_there = Articulated(self.tree, frames, *map(freeze, (packed, gain, pivot, root)))
        if not len(forces):
            return Phase(q, qd, p, energy, torque, factors_there, time, work)
        return Phase(q, qd, p, energy, torque, factors_there, time, work + added, forces)


@dataclass(frozen=True, eq=False)
class CompiledSystem(InOneKernel, System):
    """A forest of rigid bodies."""


@dataclass(frozen=True, eq=False)
class CompiledLoops(InOneKernel, ClosedEquations):
    """Bodies with loops that joints close."""


@kernel
def _march(
    h: float, tableau: tuple[Any, ...], arrays: tuple[Any, ...], extras: Any, start: Floats, speed: Floats,
    work: Floats, time: float, steps: int, stride: int, tolerance: float, order: int, units: Floats,
    targets: Floats, places: Integers,
) -> tuple[Any, ...]:  # fmt: skip
    """Steps that were possible, the last phase with work and time, and the rows. See ``march``."""
    n, total, now, n_taken, stage_places = steps // stride, work.copy(), time, 0, np.zeros_like(places)
    times, qs, qds = np.empty(n), np.empty((n, len(start))), np.empty((n, len(speed)))
    ps, energies, works = np.empty((n, len(speed))), np.empty(n), np.empty((n, len(work)))
    q, qd, times_of_step = start.copy(), speed.copy(), np.max(places)
    # Before the first step, a step of length 0 closes the loops and computes the factors at the start. It is
    # a part of the loop, because each call of the step is compiled into this kernel.
    for i in range(-1, steps):
        length, elapsed, spent, possible = h if i >= 0 else 0.0, 0.0, total.copy(), False
        part = length
        if i >= 0:
            stage_places = places + i * times_of_step
        for _ in range(_MOST):
            tried = _step(part, tableau, arrays, extras, q, qd, targets, stage_places)
            size = 0.0 if tried[0] or i < 0 else np.inf
            if tolerance > 0.0 and tried[0] and i >= 0:
                for k in range(len(units)):
                    error_of_step = max(abs(tried[14][k]), abs(h) * abs(tried[15][k])) / units[k]
                    size = max(size, error_of_step / tolerance) if error_of_step < np.inf else np.inf
            # As in_substeps: 0.9 of the estimated substep, within bounds.
            factor = 5.0 if size == 0.0 else min(5.0, max(0.2, 0.9 * size ** (-1.0 / order)))
            if size <= 1.0:
                current, elapsed = tried, elapsed + part
                q, qd = current[1], current[2]
                spent += current[13]
            else:
                factor = min(factor, 0.9)
            part *= factor
            possible = not abs(length - elapsed) > 1e-12 * abs(length)
            if possible or (tolerance == 0.0 and not tried[0]):
                break
            part = part if abs(part) < abs(length - elapsed) else length - elapsed
            if abs(part) <= _LEAST * abs(length):
                break
        if not possible:
            break
        last, total, now, n_taken = current, spent, now + length, i + 1
        if n_taken > 0 and n_taken % stride == 0:
            k = i // stride
            times[k], qs[k], qds[k], ps[k] = now, last[1], last[2], last[3]
            energies[k], works[k] = last[4], total
    return n_taken, (*last[1:13], total, now), (times, qs, qds, ps, energies, works)


@inner_kernel
def _step(
    h: float, tableau: tuple[Any, ...], arrays: tuple[Any, ...], extras: Any, start: Floats, speed: Floats,
    targets: Floats, places: Integers,
) -> tuple[Any, ...]:  # fmt: skip
    """Take a step, and close the loops."""
    # -> Whether that was possible; coordinates, velocities, momenta, energy and torques; frames and factors;
    # torques of loads and the drive (k, n_v), and their work (k,); errors of displacement and velocities.
    (links, bodies, _), n_loads = arrays[0], arrays[1]
    n, n_v, s = len(bodies), len(speed), len(tableau[1])
    rotation, origin, packed = np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((n, 21))
    gain, pivot, root = np.zeros((n, 6)), np.empty(n), np.empty((links[n, Q] - links[n, V], 6, 6))
    wrenches, loads, torques, x = np.empty((n, 6)), np.empty((n, 6)), np.empty(n_v), np.empty(n_v)
    slopes, rates, reactions = np.zeros((s + 2, n_v)), np.zeros((s + 2, n_v)), np.zeros((n, 6))
    forces, work, correction = np.zeros((n_loads, n_v)), np.zeros(n_loads), np.zeros(n_v)
    q, qd = start.copy(), speed.copy()
    valid, energy = _put_stages(
        h, tableau, arrays, extras, start, speed, targets, places, (rotation, origin),
        (packed, gain, pivot, root), (wrenches, loads, torques, x, slopes, rates, reactions, correction),
        (forces, work, q, qd),
    )  # fmt: skip
    torque, p, moved, quickened = np.empty(n_v), np.empty(n_v), np.zeros(n_v), np.zeros(n_v)
    if valid:
        kinematics.inward_torques(links, bodies, rotation, origin, wrenches, torque)
        torque += torques
        put_momenta(links, bodies, rotation, origin, qd, wrenches, loads, p, torques)
    for j in range(s):
        for k in range(n_v):
            moved[k] += h * tableau[2][j] * slopes[j, k]
            quickened[k] += h * tableau[2][j] * rates[j, k]
    return (
        valid, q, qd, p, energy, torque, rotation, origin, packed, gain, pivot, root, forces, work, moved,
        quickened,
    )  # fmt: skip


@inner_kernel
def _put_stages(
    h: float, tableau: tuple[Any, ...], arrays: tuple[Any, ...], extras: Any, start: Floats, speed: Floats,
    targets: Floats, places: Integers, frames: tuple[Floats, Floats], factors: tuple[Any, ...],
    room: tuple[Any, ...], results: tuple[Floats, Floats, Floats, Floats],
) -> tuple[bool, float]:  # fmt: skip
    """Write the end of a step into its arrays. Return whether the step was possible, and the energy there."""
    tableau, arrays, extras, targets = borrow(tableau), borrow(arrays), borrow(extras), borrow(targets)
    start, speed, frames, factors, room = (
        borrow(start), borrow(speed), borrow(frames), borrow(factors), borrow(room),
    )  # fmt: skip
    (a, b, _), (tree, n_loads, acts, dampers, joints) = tableau, arrays
    (links, bodies, _), (rotation, origin), s = tree, frames, len(b)
    wrenches, loads, torques, x, slopes, rates, reactions, correction = room
    forces, work, q, qd = borrow(results)
    valid, closed, energy = True, len(joints[0]) == 0, 0.0
    # After the stages the step itself; after the step, as often as loops need, what closes them, and with
    # loads the forces there.
    for stage in range(s + 2 + ITERATIONS):
        i, inside = min(stage, s), stage < s
        aims = targets[places[i]]
        if stage <= s:
            _put_stage(h, a[i] if inside else b, i, tree, extras, aims, slopes, rates, start, speed, x, q, qd)
        kinematics.outward_frames(links, bodies, q, rotation, origin)
        valid, energy = _act(tree, acts, extras, frames, q, wrenches, x)
        if n_loads > 0:
            _load(tree, dampers, extras, frames, q, qd, aims, loads, wrenches, x, forces)
        moves = inside or (closed and extras is not None)
        copy(x, torques)
        if not (valid and _factors_at(moves, tree, extras, aims, qd, frames, factors, wrenches, loads, x)):
            valid = False
            break
        if moves and not _press(tree, extras, frames, factors, qd, wrenches, torques, forces, x):
            valid = False
            break
        if len(joints[0]) > 0 and (moves or not closed):
            gap = _satisfy_joints(
                moves, tree, extras, joints, frames, factors, qd, x, loads, reactions, correction
            )
            if inside or closed:
                x += correction
            elif gap <= CLOSED:
                qd += correction
                closed = True
                if n_loads > 0 or extras is not None:
                    continue
            else:
                valid = stage < s + ITERATIONS
                kinematics.move_along(links, correction, q)
                if not valid:
                    break
                continue
        _drive(tree, extras, frames, qd, x, wrenches, reactions, torques, loads, forces)
        if inside:
            copy_row(x, rates, i)
            for k in range(n_loads):
                work[k] += h * b[i] * np.dot(forces[k], qd)
        elif closed:
            break
    return valid, energy


@inner_kernel
def _load(
    tree: tuple[Any, ...], dampers: tuple[Any, ...], extras: Any, frames: tuple[Floats, Floats], q: Floats,
    qd: Floats, aims: Floats, loads: Floats, wrenches: Floats, x: Floats, forces: Floats,
) -> None:  # fmt: skip
    """Write the torques of loads (k, n_v), and add them to wrenches and torques ``x``."""
    (links, bodies, _), (rotation, origin) = tree, frames
    ends, points, springs, _, freedoms, torsions = dampers
    forces[:] = 0.0
    if extras is not None:
        turn_hinges(links, bodies, extras[1], extras[0][4], extras[2], q, qd, aims, forces)
        for k in range(len(forces)):
            x += forces[k]
    damps = len(ends) + len(freedoms) > 0
    if extras is not None:
        damps = damps or len(extras[4][0]) > 0
    if damps:
        twists, damped, torques = np.empty_like(loads), np.empty_like(x), np.zeros_like(x)
        kinematics.outward_twists(links, bodies, rotation, origin, qd, twists)
        loads[:] = 0.0
        resist(rotation, origin, twists, ends, points, springs, loads)
        if extras is not None:
            bushing_ends, places, axes, constants = extras[4]
            resist_bushings(rotation, origin, twists, bushing_ends, places, axes, constants, loads)
        slow(freedoms, torsions, qd, torques)
        wrenches += loads
        x += torques
        # The load of all dampers is the first.
        kinematics.inward_torques(links, bodies, rotation, origin, loads, damped)
        forces[0] = damped + torques


@inner_kernel
def _press(
    tree: tuple[Any, ...], extras: Any, frames: tuple[Floats, Floats], factors: tuple[Any, ...], qd: Floats,
    wrenches: Floats, torques: Floats, forces: Floats, x: Floats,
) -> bool:  # fmt: skip
    """Add friction by forces. Return False if a hinge jams."""
    if extras is None:
        return True
    possible: bool = press_hinges(
        tree, extras[0], frames, factors, extras[2], qd, wrenches, torques, forces, x
    )
    return possible


@inner_kernel
def _drive(
    tree: tuple[Any, ...], extras: Any, frames: tuple[Floats, Floats], qd: Floats, qdd: Floats,
    wrenches: Floats, reactions: Floats, torques: Floats, loads: Floats, forces: Floats,
) -> None:  # fmt: skip
    """Write the torques of the drive, the last of ``forces``: what its motion needs beyond all others."""
    (links, bodies, _), (rotation, origin) = tree, frames
    if extras is None:
        return
    _, _, driven, _, balls, _ = extras[0]
    if len(driven) > 0:
        bent, needed = qdd.copy(), np.empty(len(qd))
        bend_axes(balls, qd, bent, -1.0)
        outward_loads(links, bodies, rotation, origin, qd, bent, loads)
        loads -= wrenches
        loads -= reactions
        kinematics.inward_torques(links, bodies, rotation, origin, loads, needed)
        for k in driven:
            forces[-1, k] = needed[k] + extras[1][k] * qdd[k] - torques[k]


@inner_kernel
def _put_stage(
    h: float, weights: Floats, i: int, tree: tuple[Any, ...], extras: Any, aims: Floats, slopes: Floats,
    rates: Floats, start: Floats, speed: Floats, x: Floats, q: Floats, qd: Floats,
) -> None:  # fmt: skip
    """Write coordinates and velocities of a stage by the previous rates, and its displacement's rate."""
    x[:] = 0.0
    copy(speed, qd)
    for j in range(i):
        weight = h * weights[j]
        for k in range(len(x)):
            x[k] += weight * slopes[j, k]
            qd[k] += weight * rates[j, k]
    copy(start, q)
    kinematics.move_along(tree[0], x, q)
    if extras is not None:
        _, _, driven, driven_places, _, _ = extras[0]
        for j in range(len(driven)):
            q[driven_places[j]], qd[driven[j]] = aims[j - len(driven), 0], aims[j - len(driven), 1]
    copy_row(qd, slopes, i)
    put_rates(tree[0], x, slopes[i])


@inner_kernel
def _act(
    tree: tuple[Any, ...], acts: tuple[Any, ...], extras: Any, frames: tuple[Floats, Floats], q: Floats,
    wrenches: Floats, torques: Floats,
) -> tuple[bool, float]:  # fmt: skip
    """Write wrenches (nb, 6) and torques (n_v,). Return whether all forces have directions, and energy."""
    gravity, ends, points, springs, coordinates, freedoms, torsions = acts
    rotation, origin = frames
    wrenches[:], torques[:] = 0.0, 0.0
    energy = weigh(tree[1], rotation, origin, gravity, wrenches)
    pulled = pull(rotation, origin, ends, points, springs, wrenches)
    possible = pulled >= 0.0
    energy += pulled + wind(coordinates, freedoms, torsions, q, torques)
    if extras is not None:
        bushing_ends, places, axes_a, axes_b, stiffness = extras[3]
        bent = bend_bushings(rotation, origin, bushing_ends, places, axes_a, axes_b, stiffness, wrenches)
        possible = possible and bent >= 0.0
        energy += bent + push_back(extras[5], extras[6], q, torques)
    return possible, energy


@inner_kernel
def _factors_at(
    moves: bool, tree: tuple[Any, ...], extras: Any, aims: Floats, qd: Floats, frames: tuple[Floats, Floats],
    factors: tuple[Any, ...], wrenches: Floats, loads: Floats, x: Floats,
) -> bool:  # fmt: skip
    """Write factors. If it moves, overwrite torques by accelerations. Return whether the factors exist."""
    (links, bodies, _), (rotation, origin), (packed, gain, pivot, root) = tree, frames, factors
    articulated.put_rigid(rotation, bodies, packed)
    loads[:] = 0.0
    still, solution, solved = np.zeros(len(qd)), x, links
    if extras is not None:
        solved, undriven, driven, _, balls, massless = extras[0]
        solution = x[undriven]
        for j in range(len(driven)):
            still[driven[j]] = aims[j - len(driven), 2]
        bend_axes(balls, qd, still, -1.0)
    if moves:
        outward_loads(links, bodies, rotation, origin, qd, still, loads)
        loads -= wrenches
    failed: int = articulated.factorise(
        solved, bodies, rotation, origin, packed, gain, pivot, root, loads, solution
    )
    if extras is not None:
        slack = find_slack(solved, bodies, rotation, origin, packed, pivot, root) if massless else -1
        failed = max(failed, slack)
    if failed >= 0:
        return False
    if moves:
        articulated.outward_rates(solved, bodies, rotation, origin, gain, root, loads, solution)
        if extras is not None:
            for j in range(len(driven)):
                x[driven[j]] = aims[j - len(driven), 2]
            scatter(solution, undriven, x)
    return True


@inner_kernel
def _satisfy_joints(
    moves: bool, tree: tuple[Any, ...], extras: Any, joints: tuple[Any, ...], frames: tuple[Floats, Floats],
    factors: tuple[Any, ...], qd: Floats, qdd: Floats, loads: Floats, reactions: Floats, correction: Floats,
) -> float:  # fmt: skip
    """Write accelerations if it moves, else the velocities, else the displacement that joints ask for."""
    # -> How far loops are open: after the step velocities are corrected once they are closed.
    (links, bodies, size), (body, turns, point, along, fronts) = tree, joints
    (rotation, origin), (_, gain, pivot, root) = frames, factors
    m, gap, solved, bent, solution = len(body), 0.0, links, qdd, correction
    if extras is not None:
        solved, undriven, _, _, balls, _ = extras[0]
        bent, solution = qdd.copy(), np.empty(len(undriven))
        bend_axes(balls, qd, bent, -1.0)
    error, rows = np.empty(m), np.zeros((m, 2, 6))
    loop_joints.put_rows(rotation, origin, body, turns, point, along, error, rows)
    scales, _, columns, spans, order = loop_factors.factor_loops_at(
        solved, bodies, rotation, origin, gain, pivot, root, body, rows, size, fronts
    )
    for k in range(m):
        gap = max(gap, abs(error[k]) / (1.0 if turns[k] else size))
    if moves:
        error = -loop_joints.bends(links, bodies, rotation, origin, body, turns, point, along, qd, bent)
    elif gap <= CLOSED:
        kinematics.outward_twists(links, bodies, rotation, origin, qd, loads)
        for k in range(m):
            error[k] = 0.0
            for side in range(2):
                if body[k, side] >= 0:
                    moment, force = algebra.pair(rows[k], side)
                    omega, u = algebra.pair(loads, body[k, side])
                    error[k] -= algebra.dot(moment, omega) + algebra.dot(force, u)
    else:
        error *= -1.0
    reactions[:], solution[:], correction[:] = 0.0, 0.0, 0.0
    loop_joints.gather(
        body, rows, loop_factors.least_impulses(scales, columns, spans, order, error), reactions
    )
    for b in range(len(bodies)):
        moment, force = algebra.pair(reactions, b)
        algebra.put_pair(algebra.scale(-1.0, moment), algebra.scale(-1.0, force), loads, b)
    articulated.inward_loads(solved, bodies, rotation, origin, gain, pivot, loads, solution)
    articulated.outward_rates(solved, bodies, rotation, origin, gain, root, loads, solution)
    if extras is not None:
        scatter(solution, undriven, correction)
    return gap
