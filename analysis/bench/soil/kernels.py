"""Motion of cubes that touch each other, planes and plates: all steps in one kernel.

Velocity Verlet, with velocities half a step ahead by the last accelerations where damping and friction need
them. A cube turns alike about all axes, so that nothing gyroscopic is left; its turn in a step is Cayley's.
"""

from typing import NamedTuple

import numpy as np

from bench.soil.box_kernels import box_on_plane
from bench.soil.contact import (
    BACK,
    DEEPEST,
    FORCE,
    JOLT,
    N_MEMORY,
    PART,
    PATIENCE,
    PREFER,
    SLEPT,
    STILL,
    STORED,
    WORK,
    collect,
    forget,
    meet,
    memory_used,
    respond,
)
from protochain.core.arrays import Floats, Integers
from protochain.mechanics.multibody.algebra import (
    Matrix,
    Vector,
    add,
    dot,
    kernel,
    put,
    rotate,
    scale,
    subtract,
    vector,
)

DONE, LISTS, TOO_DEEP, TOO_FAST = range(4)
"""Why the kernel returns: all steps are taken, new lists are needed, or something is refused."""


class Cubes(NamedTuple):
    """Cubes: half edges and masses; and what changes in place, see :class:`pile_parts.Heap`."""

    half: Floats
    mass: Floats
    x: Floats
    q: Floats
    v: Floats
    w: Floats
    acc: Floats
    asleep: Integers
    still: Floats


class Planes(NamedTuple):
    """Fixed half spaces: normal and offset (p, 4), and what is remembered of each cube on each."""

    plane: Floats
    memory: Floats


class Boards(NamedTuple):
    """Plates: body, (m, 15) centre, rotation and half edges in its frame; motion of the bodies."""

    body: Integers
    plate: Floats
    origin: Floats
    rotation: Floats
    twist: Floats


class Lists(NamedTuple):
    """What may touch, what is remembered of it, and where cubes and plates were when they were made."""

    start: Integers
    other: Integers
    memory: Floats
    then: Floats
    plates_then: Floats
    skin: float


@kernel
def quaternion_matrix(q: Floats, i: int) -> Matrix:
    """Rotation of unit quaternion i, (w, x, y, z)."""
    w, x, y, z = q[i, 0], q[i, 1], q[i, 2], q[i, 3]
    return (
        1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y),
        2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x),
        2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y),
    )  # fmt: skip


@kernel
def turn_quaternion(q: Floats, i: int, turn: Vector) -> None:
    """Turn by a small rotation vector: (1, turn / 2), made a unit, times q."""
    x, y, z = 0.5 * turn[0], 0.5 * turn[1], 0.5 * turn[2]
    a, b, c, d = q[i, 0], q[i, 1], q[i, 2], q[i, 3]
    w = a - x * b - y * c - z * d
    u, v, t = b + x * a + y * d - z * c, c + y * a + z * b - x * d, d + z * a + x * c - y * b
    size = 1.0 / np.sqrt(w * w + u * u + v * v + t * t)
    q[i, 0], q[i, 1], q[i, 2], q[i, 3] = size * w, size * u, size * v, size * t


@kernel
def matrix_at(m: Floats, i: int) -> Matrix:
    """Row i of nine numbers."""
    return m[i, 0], m[i, 1], m[i, 2], m[i, 3], m[i, 4], m[i, 5], m[i, 6], m[i, 7], m[i, 8]


@kernel
def place_plates(s: int, plates: Boards, placed: Floats) -> None:
    """Centres and rotations (m, 12) of plates at step s, from the frames of their bodies."""
    plate, origin, rotation = plates.plate, plates.origin, plates.rotation
    for m in range(len(plates.body)):
        b = plates.body[m]
        r = (
            rotation[s, b, 0, 0], rotation[s, b, 0, 1], rotation[s, b, 0, 2],
            rotation[s, b, 1, 0], rotation[s, b, 1, 1], rotation[s, b, 1, 2],
            rotation[s, b, 2, 0], rotation[s, b, 2, 1], rotation[s, b, 2, 2],
        )  # fmt: skip
        put(
            add((origin[s, b, 0], origin[s, b, 1], origin[s, b, 2]), rotate(r, vector(plate, m))),
            placed,
            m,
            0,
        )
        for k in range(3):
            axis = rotate(r, (plate[m, 3 + k], plate[m, 6 + k], plate[m, 9 + k]))
            placed[m, 3 + k], placed[m, 6 + k], placed[m, 9 + k] = axis


@kernel
def plate_moved(placed: Floats, then: Floats, plate: Floats, m: int) -> float:
    """Bound on how far any point of a plate has moved."""
    x = subtract(vector(placed, m), vector(then, m))
    bound = np.sqrt(dot(x, x))
    for k in range(3):
        d = (
            placed[m, 3 + k] - then[m, 3 + k],
            placed[m, 6 + k] - then[m, 6 + k],
            placed[m, 9 + k] - then[m, 9 + k],
        )
        bound += plate[m, 12 + k] * np.sqrt(dot(d, d))
    return bound


@kernel
def drift(h: float, cubes: Cubes, lists: Lists) -> tuple[bool, int]:
    """Half a kick and a drift; whether lists hold still, and a cube that is too fast, or -1."""
    x, v, w, acc, half, skin = cubes.x, cubes.v, cubes.w, cubes.acc, cubes.half, lists.skin
    hold, fast = True, -1
    for i in range(len(x)):
        if cubes.asleep[i]:
            continue
        u = add(vector(v, i), scale(0.5 * h, vector(acc, i)))
        put(u, v, i, 0)
        put(add(vector(x, i), scale(h, u)), x, i, 0)
        o = add(vector(w, i), scale(0.5 * h, vector(acc, i, 3)))
        put(o, w, i, 0)
        turn_quaternion(cubes.q, i, scale(h, o))
        # Not: larger, which no number is that is none.
        if not h * h * dot(u, u) <= half[i] * half[i] or not h * h * dot(o, o) <= 0.25:
            fast = i
        moved = subtract(vector(x, i), vector(lists.then, i))
        if not 4.0 * dot(moved, moved) <= skin * skin:
            hold = False
    return hold, fast


@kernel
def settle(h: float, cubes: Cubes, total: Floats, law: Floats, gravity: Vector, sums: Floats) -> None:
    """Accelerations, the other half of the kick, and who falls asleep or wakes."""
    v, w, acc, half, mass, still = cubes.v, cubes.w, cubes.acc, cubes.half, cubes.mass, cubes.still
    for i in range(len(v)):
        inertia = mass[i] * 2.0 / 3.0 * half[i] * half[i]
        reach = np.sqrt(3.0) * half[i]
        a = add(gravity, scale(1.0 / mass[i], vector(total, i)))
        t = scale(1.0 / inertia, vector(total, i, 3))
        jolt2 = max(dot(a, a), reach * reach * dot(t, t))
        if cubes.asleep[i]:
            if jolt2 <= law[JOLT] * law[JOLT]:
                continue
            cubes.asleep[i], still[i] = 0, 0.0
        else:
            put(add(vector(v, i), scale(0.5 * h, a)), v, i, 0)
            put(add(vector(w, i), scale(0.5 * h, t)), w, i, 0)
        put(a, acc, i, 0)
        put(t, acc, i, 3)
        u, o = vector(v, i), vector(w, i)
        if law[PATIENCE] >= 0.0:
            slow = dot(u, u) + reach * reach * dot(o, o) < law[STILL] * law[STILL]
            # Well below what wakes it, lest it wake at once.
            still[i] = still[i] + h if slow and 4.0 * jolt2 < law[JOLT] * law[JOLT] else 0.0
            if still[i] > law[PATIENCE]:
                cubes.asleep[i] = 1
                sums[SLEPT] += 0.5 * (mass[i] * dot(u, u) + inertia * dot(o, o))
                for k in range(3):
                    v[i, k] = w[i, k] = acc[i, k] = acc[i, 3 + k] = 0.0


@kernel
def march(
    first: int, last: int, drifted: bool, h: float, cubes: Cubes, planes: Planes, plates: Boards,
    lists: Lists, law: Floats, gravity: Vector, reaction: Floats, sums: Floats,
) -> tuple[int, int, int, int, float]:  # fmt: skip
    """Take steps ``first`` to ``last``; where it stopped, why, and which bodies, how deep.

    ``drifted``: the first step's drift has been taken. ``last`` < ``first``: only forces at ``first``.
    """
    # One function: in parts the compiler would fuse other products with sums, and round otherwise.
    half, mass, x, q, v, w, acc, asleep, _ = cubes
    (plane, plane_memory), (body, plate, origin, _, twist) = planes, plates
    start, other, memory = lists.start, lists.other, lists.memory
    n, n_planes, n_plates = len(x), len(plane), len(body)
    turn, total, guess = np.empty((n, 9)), np.zeros((n, 6)), np.empty((n, 6))
    placed, found = np.empty((n_plates, 12)), np.empty((8, 8))
    polygon, spare, more = np.empty((12, 7)), np.empty((12, 7)), np.empty((8, 8))
    zero = (0.0, 0.0, 0.0)
    s = first
    while s <= last or s == first:
        at = s if s <= last else first
        place_plates(at, plates, placed)
        if not drifted and s <= last:
            hold, fast = drift(h, cubes, lists)
            if fast >= 0:
                return s, TOO_FAST, fast, -1, 0.0
            for m in range(n_plates):
                if not 2.0 * plate_moved(placed, lists.plates_then, plate, m) <= lists.skin:
                    hold = False
            if not hold:
                return s, LISTS, 0, 0, 0.0
        drifted = False
        for i in range(n):
            r = quaternion_matrix(q, i)
            turn[i, 0], turn[i, 1], turn[i, 2], turn[i, 3], turn[i, 4] = r[0], r[1], r[2], r[3], r[4]
            turn[i, 5], turn[i, 6], turn[i, 7], turn[i, 8] = r[5], r[6], r[7], r[8]
            # Where the half step ahead is not known yet, there is no step.
            ahead = 0.5 * h if s <= last else 0.0
            for k in range(3):
                guess[i, k] = v[i, k] + ahead * acc[i, k]
                guess[i, 3 + k] = w[i, k] + ahead * acc[i, 3 + k]
            for k in range(6):
                total[i, k] = 0.0
        sums[STORED] = 0.0
        step = h if s <= last else 0.0
        for i in range(n):
            xi, ri, hi = vector(x, i), matrix_at(turn, i), (half[i], half[i], half[i])
            vi, wi, ui, oi = vector(guess, i), vector(guess, i, 3), vector(v, i), vector(w, i)
            reach = np.sqrt(3.0) * half[i]
            for p in range(n_planes):
                row = i * n_planes + p
                up = vector(plane, p)
                if not asleep[i]:
                    if dot(up, xi) - plane[p, 3] > reach:
                        if memory_used(plane_memory, row):
                            forget(plane_memory, row, sums)
                        continue
                    count, depth = box_on_plane(up, plane[p, 3], xi, ri, hi, found)
                    if depth > law[DEEPEST] * half[i]:
                        return s, TOO_DEEP, i, -1 - p, depth
                    down = scale(-1.0, up)
                    respond(
                        count, down, found, xi, vi, wi, ui, oi, xi, zero, zero, zero, zero, -1.0, 1.0,
                        mass[i], law, step, plane_memory, row, sums,
                    )  # fmt: skip
                collect(plane_memory, row, total, i, sums)
            for row in range(start[i], start[i + 1]):
                j = other[row]
                m, b = j - n, -1
                if j < n:
                    rests = asleep[i] and asleep[j]
                    xj, rj, hj = vector(x, j), matrix_at(turn, j), (half[j], half[j], half[j])
                    vj, wj, uj, oj, ref = (
                        vector(guess, j),
                        vector(guess, j, 3),
                        vector(v, j),
                        vector(w, j),
                        xj,
                    )
                    both = mass[i] * mass[j] / (mass[i] + mass[j])
                    d, far = subtract(xj, xi), reach + np.sqrt(3.0) * half[j]
                    apart = dot(d, d) > far * far
                else:
                    b = body[m]
                    rests = asleep[i] != 0
                    for k in range(6):
                        rests = rests and twist[at, b, k] == 0.0
                    xj, hj = vector(placed, m), vector(plate, m, 12)
                    rj = (placed[m, 3], placed[m, 4], placed[m, 5], placed[m, 6], placed[m, 7], placed[m, 8],
                          placed[m, 9], placed[m, 10], placed[m, 11])  # fmt: skip
                    ref = (origin[at, b, 0], origin[at, b, 1], origin[at, b, 2])
                    vj = (twist[at, b, 3], twist[at, b, 4], twist[at, b, 5])
                    wj = (twist[at, b, 0], twist[at, b, 1], twist[at, b, 2])
                    # Half a step ago: the mean of both ends.
                    k = at - 1 if at > 0 else 0
                    uj = add(scale(0.5, vj), scale(0.5, (twist[k, b, 3], twist[k, b, 4], twist[k, b, 5])))
                    oj = add(scale(0.5, wj), scale(0.5, (twist[k, b, 0], twist[k, b, 1], twist[k, b, 2])))
                    both, apart = mass[i], False
                if not rests:
                    count, depth, normal = 0, 0.0, zero
                    if not apart and j < n:
                        count, depth, normal = meet(
                            xi, ri, hi, xj, rj, hj, law[PREFER] * half[i], law, memory, row, sums,
                            polygon, spare, found, more,
                        )  # fmt: skip
                    elif not apart:
                        # Of two faces the first's gives the direction: the plate's, which hardly tilts.
                        count, depth, normal = meet(
                            xj, rj, hj, xi, ri, hi, law[PREFER] * half[i], law, memory, row, sums,
                            polygon, spare, found, more,
                        )  # fmt: skip
                        normal = scale(-1.0, normal)
                    if count == 0:
                        if memory_used(memory, row):
                            forget(memory, row, sums)
                        continue
                    if depth > law[DEEPEST] * half[i]:
                        return s, TOO_DEEP, i, j, depth
                    respond(
                        count, normal, found, xi, vi, wi, ui, oi, ref, vj, wj, uj, oj, 1.0 if j < n else -1.0,
                        memory[row, PART], both, law, step, memory, row, sums,
                    )  # fmt: skip
                collect(memory, row, total, i, sums)
                force, back = vector(memory, row, FORCE), vector(memory, row, BACK)
                if j < n:
                    for k in range(3):
                        total[j, k] -= force[k]
                        total[j, 3 + k] += back[k]
                else:
                    for k in range(3):
                        reaction[at, b, k] += back[k]
                        reaction[at, b, 3 + k] -= force[k]
                    # What the body does to the cubes is minus what they do to it.
                    sums[WORK] -= step * (dot(back, wj) - dot(force, vj))
        if s > last:
            for i in range(n):
                for k in range(3):
                    acc[i, k] = gravity[k] + total[i, k] / mass[i]
                    acc[i, 3 + k] = total[i, 3 + k] / (mass[i] * 2.0 / 3.0 * half[i] * half[i])
            break
        settle(h, cubes, total, law, gravity, sums)
        s += 1
    return s, DONE, 0, 0, 0.0


@kernel
def carry_over(
    start: Integers, other: Integers, memory: Floats, new_start: Integers, new_other: Integers,
    new_memory: Floats,
) -> None:  # fmt: skip
    """Give contacts of new lists what is remembered of them; both sorted."""
    for i in range(len(start) - 1):
        row = start[i]
        for new in range(new_start[i], new_start[i + 1]):
            while row < start[i + 1] and other[row] < new_other[new]:
                row += 1
            if row < start[i + 1] and other[row] == new_other[new]:
                for k in range(N_MEMORY):
                    new_memory[new, k] = memory[row, k]
