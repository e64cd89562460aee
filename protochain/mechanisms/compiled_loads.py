"""Loads of hinges in the kernel of explicit steps: motors, torques, stops and friction, by arrays."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from protochain.core.arrays import Floats, Integers, read_only
from protochain.mechanics.motion import Load
from protochain.mechanics.multibody import articulated, kinematics
from protochain.mechanics.multibody.algebra import (
    Vector,
    add,
    dot,
    hinge_axis,
    inertia,
    inertia_times,
    inner_kernel,
    kernel,
    pair,
    vector,
)
from protochain.mechanics.multibody.kernel_arrays import copy
from protochain.mechanics.multibody.newton_euler import outward_loads
from protochain.mechanisms.elements import weigh

STOP, FRICTION, MOTOR, TORQUE = range(4)
"""Kinds of rows."""
ITERATIONS = 100
SAME = 1e-12
"""Largest relative change of friction in an iteration that counts as convergence."""


class HingeRow(NamedTuple):
    """Load of one hinge."""

    kind: int
    place: int  # Coordinate in q. Of friction the body beyond the hinge.
    freedom: int  # Place in qd.
    # STOP: low, high, stiffness, damping. FRICTION: torque, damping, speed, torque by force. MOTOR:
    # stiffness, damping, limit. TORQUE: value.
    constants: tuple[float, ...]
    motion: Callable[[float], Any] | None = None  # Time -> three numbers: target or torque.
    unit: float = 1.0  # Of these numbers.


@dataclass(frozen=True, eq=False)
class HingeLoad(Load):
    """Torques at hinges, with the rows that a kernel computes them from."""

    rows: tuple[HingeRow, ...] = ()
    # Function that the rows compute. A load with another function is computed by calls in Python.
    computed: Callable[..., Any] | None = None
    gravity: Floats | None = None  # (3,): Acceleration of free fall in feed-forward, None without it.

    @property
    def is_compiled(self) -> bool:
        """Whether the rows compute it."""
        return self.applied == self.computed


def arrays_of_hinges(loads: Sequence[Load]) -> tuple[tuple[Any, ...], list[HingeRow]]:
    """Arrays of the loads at hinges, and the rows with a motion, in the order of their numbers."""
    rows: list[tuple[int, ...]] = []
    constants: list[tuple[float, ...]] = []
    moving: list[HingeRow] = []
    feed_forward: list[tuple[int, int]] = []
    gravity: Floats = np.zeros(3)
    for number, load in enumerate(loads):
        if not isinstance(load, HingeLoad):
            continue
        if load.gravity is not None:
            feed_forward.append((len(rows), len(rows) + len(load.rows)))
            gravity = load.gravity
        for row in load.rows:
            rows.append((row.kind, number, row.place, row.freedom, -1 if row.motion is None else len(moving)))
            constants.append((*row.constants, *[0.0] * (4 - len(row.constants))))
            moving += [] if row.motion is None else [row]
    return (
        read_only(np.array(rows, np.int64).reshape(-1, 5), np.int64),
        read_only(np.reshape(constants, (-1, 4))),
        read_only(np.array(feed_forward, np.int64).reshape(-1, 2), np.int64), read_only(gravity),
    ), moving  # fmt: skip


@kernel
def turn_hinges(
    links: Integers, bodies: Floats, rotors: Floats, balls: Integers, hinges: tuple[Any, ...], q: Floats,
    qd: Floats, targets: Floats, forces: Floats,
) -> None:  # fmt: skip
    """Add the torques of each load to its row of ``forces`` (k, n_v), without friction by forces."""
    rows, constants, feed_forward, gravity = hinges
    n, ahead = len(bodies), np.zeros(len(rows))
    for f in range(len(feed_forward)):
        # Inverse dynamics at the targets: Luh, Walker, Paul (1980).
        first, last = feed_forward[f, 0], feed_forward[f, 1]
        goal, rate, quickening, torque = q.copy(), qd.copy(), np.zeros(len(qd)), np.empty(len(qd))
        for i in range(first, last):
            goal[rows[i, 2]], rate[rows[i, 3]] = targets[rows[i, 4], 0], targets[rows[i, 4], 1]
            quickening[rows[i, 3]] = targets[rows[i, 4], 2]
        rotation, origin = np.empty((n, 3, 3)), np.empty((n, 3))
        loads = np.empty((n, 6))
        kinematics.outward_frames(links, bodies, goal, rotation, origin)
        bend_axes(balls, rate, quickening, -1.0)
        outward_loads(links, bodies, rotation, origin, rate, quickening, loads)
        bend_axes(balls, rate, quickening, 1.0)
        weigh(bodies, rotation, origin, -gravity, loads)
        kinematics.inward_torques(links, bodies, rotation, origin, loads, torque)
        for i in range(first, last):
            k = rows[i, 3]
            ahead[i] = torque[k] + rotors[k] * quickening[k]
    for i in range(len(rows)):
        kind, k, place, motion = rows[i, 0], rows[i, 3], rows[i, 2], rows[i, 4]
        a, b, c, d = constants[i, 0], constants[i, 1], constants[i, 2], constants[i, 3]
        torque_of_row = 0.0
        if kind == STOP:
            depth = q[place] - min(max(q[place], a), b)
            if depth != 0.0:
                sign = 1.0 if depth > 0.0 else -1.0
                torque_of_row = -sign * max(d * sign * qd[k], -c * abs(depth))
        elif kind == FRICTION:
            torque_of_row = -a * np.tanh(qd[k] / c) - b * qd[k]
        elif kind == MOTOR:
            drawn = a * (targets[motion, 0] - q[place]) + b * (targets[motion, 1] - qd[k]) + ahead[i]
            torque_of_row = min(max(drawn, -c), c)
        else:
            torque_of_row = targets[motion, 0] if motion >= 0 else a
        forces[rows[i, 1], k] += torque_of_row


@kernel
def bend_axes(balls: Integers, qd: Floats, qdd: Floats, sign: float) -> None:
    """Add the products of :func:`~protochain.mechanics.multibody.rotations.hinge_accelerations`."""
    for i in range(len(balls)):
        k = balls[i, 0]
        x, y, z = qd[k], qd[k + 1], qd[k + 2]
        qdd[k] += sign * y * z
        qdd[k + 1] -= sign * x * z
        qdd[k + 2] += sign * x * y


@kernel
def press_hinges(
    tree: tuple[Any, ...], locked: tuple[Any, ...], frames: tuple[Floats, Floats], factors: tuple[Any, ...],
    hinges: tuple[Any, ...], qd: Floats, wrenches: Floats, torques: Floats, forces: Floats, qdd: Floats,
) -> bool:  # fmt: skip
    """Add friction by the forces of hinges to torques and accelerations. Return False if it jams."""
    # As ``hinge_friction.friction``: a fixed point, of forces that change linearly with friction.
    (links, bodies, _), (locked_links, undriven, _, _, balls, _) = tree, locked
    (rotation, origin), (packed, gain, pivot, root), (rows, constants, _, _) = frames, factors, hinges
    pressed, count, n_v = np.empty(len(rows), np.int64), 0, len(qd)
    for i in range(len(rows)):
        if rows[i, 0] == FRICTION and constants[i, 3] > 0.0:
            pressed[count] = i
            count += 1
    if count == 0:
        return True
    loads, motions = np.empty((len(bodies), 6)), np.empty((len(bodies), 6))
    rates, torque, x = qdd.copy(), np.empty(n_v), np.empty(len(undriven))
    across, changes = np.empty((count + 1, count, 3)), np.zeros((count, n_v))
    # Forces that hinges transmit without friction: Luh, Walker, Paul (1980).
    bend_axes(balls, qd, rates, -1.0)
    outward_loads(links, bodies, rotation, origin, qd, rates, loads)
    loads -= wrenches
    kinematics.inward_torques(links, bodies, rotation, origin, loads, torque)
    for i in range(count):
        b = rows[pressed[i], 2]
        _put_across(rotation, b, vector(loads, b, 3), across, 0, i)
    # Changes by a unit torque at each hinge: P a + z, Featherstone (2008), section 7.1.
    for r in range(count):
        for j in range(len(undriven)):
            x[j] = 1.0 if undriven[j] == rows[pressed[r], 3] else 0.0
        loads[:] = 0.0
        articulated.inward_loads(locked_links, bodies, rotation, origin, gain, pivot, loads, x)
        articulated.outward_rates(locked_links, bodies, rotation, origin, gain, root, motions, x)
        for j in range(len(undriven)):
            changes[r, undriven[j]] = x[j]
        for i in range(count):
            b = rows[pressed[i], 2]
            omega, u = pair(motions, b)
            _, force = inertia_times(inertia(packed, b), omega, u)
            _put_across(rotation, b, add(force, vector(loads, b, 3)), across, r + 1, i)
    slip, size, before = np.empty(count), np.empty(count), np.empty(count)
    for i in range(count):
        row = pressed[i]
        slip[i] = -constants[row, 3] * np.tanh(qd[rows[row, 3]] / constants[row, 2])
        size[i] = np.sqrt(np.sum(across[0, i] * across[0, i]))
    for _ in range(ITERATIONS):
        copy(size, before)
        change = 0.0
        for i in range(count):
            square = 0.0
            for j in range(3):
                part = across[0, i, j]
                for k in range(count):
                    part += across[k + 1, i, j] * slip[k] * before[k]
                square += part * part
            size[i] = np.sqrt(square)
            change = max(change, abs(size[i] - before[i]))
        if change <= SAME * np.max(size):
            for i in range(count):
                row = pressed[i]
                forces[rows[row, 1], rows[row, 3]] += slip[i] * size[i]
                torques[rows[row, 3]] += slip[i] * size[i]
                for k in range(n_v):
                    qdd[k] += slip[i] * size[i] * changes[i, k]
            return True
    return False


@inner_kernel
def _put_across(rotation: Floats, b: int, force: Vector, across: Floats, r: int, i: int) -> None:
    """Write the part of a force across the axis of a body's hinge."""
    axis = hinge_axis(rotation, b)
    along = dot(force, axis)
    for j in range(3):
        across[r, i, j] = force[j] - along * axis[j]
