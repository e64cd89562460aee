"""Force of a contact that remembers how far it was sheared: springs, dampers and friction."""

import numpy as np

from bench.soil.box_kernels import axis_normal, best_axis, box_on_axis
from bench.soil.box_volume import box_in_box
from protochain.core.arrays import Floats
from protochain.mechanics.multibody.algebra import (
    Matrix,
    Vector,
    add,
    cross,
    dot,
    kernel,
    put,
    scale,
    subtract,
    vector,
)

NORMAL, TANGENT, DAMPING, FRICTION, PREFER, DEEPEST, STILL, JOLT, PATIENCE, VOLUME = range(10)
"""Of ``law``: stiffnesses, damping ratio, friction, length by which faces are preferred, deepest contact in
half edges; speed and acceleration below which a cube may sleep, and for how long; whether overlaps press."""
DAMPED, RUBBED, SLEPT, WORK, STORED = range(5)
"""Of ``sums``: energy lost to dampers, friction and sleep, work of the plates, energy in the springs now."""
SLIP, TWIST, FORCE, MOMENT, BACK, ENERGY, HELD, AXIS, PART, N_MEMORY = 0, 3, 4, 7, 10, 13, 14, 15, 16, 17
"""What is remembered of a contact: tangential displacement, and that of its turning about the normal; force
and moment on the first, moment on the second; energy in its springs, and in the tangential ones; 1 + its
axis; part of the stiffness that is left."""
AXES = 16
"""More than there are axes: what is remembered is axis + AXES x face of the other."""
LEAST_PART = 0.1
"""Of the stiffness: less would let bodies through."""
_SAME = 0.9
"""Cosine of the angle by which a contact's normal may turn in a step and its memory turns with it."""


@kernel
def memory_used(memory: Floats, row: int) -> bool:
    """Whether a contact is remembered."""
    return memory[row, ENERGY] > 0.0


@kernel
def pressed(number: int, found: Floats) -> float:
    """Twice the energy of the normal springs, at stiffness 1."""
    energy = 0.0
    for a in range(number):
        energy += found[a, 4] * found[a, 3] * found[a, 3]
    return energy


@kernel
def deepest(number: int, found: Floats) -> float:
    """Depth of the deepest point."""
    depth = 0.0
    for a in range(number):
        depth = max(depth, found[a, 3])
    return depth


@kernel
def meet(
    c1: Vector, r1: Matrix, h1: Vector, c2: Vector, r2: Matrix, h2: Vector, prefer_faces: float,
    law: Floats, memory: Floats, row: int, sums: Floats, polygon: Floats, other: Floats, found: Floats,
    spare: Floats,
) -> tuple[int, float, Vector]:  # fmt: skip
    """Contact of two boxes that remembers its axis: points in ``found``, depth of the deepest, normal.

    Energy must not come from a choice: another axis is taken only once its springs would hold no more, or
    where the old one has no points left; then, and where a face meets another one, they are softened until
    they hold the same.
    """
    if law[VOLUME] > 0.0:
        memory[row, PART] = 1.0
        return box_in_box(c1, r1, h1, c2, r2, h2, polygon, other, found, spare)
    n, number, side, axis = (0.0, 0.0, 0.0), 0, 0, 0
    # A face that is preferred to edges may have no points.
    for preferred in (prefer_faces, 0.0):
        gap, axis = best_axis(c1, r1, h1, c2, r2, h2, preferred, 0.0)
        if gap >= 0.0:
            return 0, 0.0, n
        n = axis_normal(c1, r1, c2, r2, axis)
        number, side = box_on_axis(c1, r1, h1, c2, r2, h2, axis, n, polygon, other, found)
        if number > 0:
            break
    last = int(memory[row, AXIS]) - 1
    if not memory_used(memory, row):
        memory[row, PART] = 1.0
    else:
        before, after, old = 0.0, pressed(number, found), last % AXES
        if old != axis:
            m = axis_normal(c1, r1, c2, r2, old)
            count, own = box_on_axis(c1, r1, h1, c2, r2, h2, old, m, polygon, other, spare)
            before = pressed(count, spare)
            if count > 0 and (number == 0 or after > before):
                number, n, axis, side, after = count, m, old, own, before
                for a in range(count):
                    for k in range(8):
                        found[a, k] = spare[a, k]
        if last != axis + AXES * side and number > 0:
            now = 0.5 * law[NORMAL] * after
            held = memory[row, ENERGY] - memory[row, HELD]
            if old != axis and before > 0.0:
                # Its face may have changed, too: what it held before counts then.
                held = min(held, 0.5 * law[NORMAL] * memory[row, PART] * before)
            memory[row, PART] = min(max(held / now, LEAST_PART), 1.0)
            sums[DAMPED] += max(held - memory[row, PART] * now, 0.0)
    memory[row, AXIS] = 1.0 + axis + AXES * side
    return number, deepest(number, found), n


@kernel
def forget(memory: Floats, row: int, sums: Floats) -> None:
    """End a contact; what its tangential springs held is lost."""
    sums[RUBBED] += memory[row, HELD]
    for k in range(N_MEMORY):
        memory[row, k] = 0.0


@kernel
def respond(
    number: int, n: Vector, found: Floats, xi: Vector, vi: Vector, wi: Vector, ui: Vector, oi: Vector,
    xj: Vector, vj: Vector, wj: Vector, uj: Vector, oj: Vector, sign: float, part: float,
    mass: float, law: Floats, h: float, memory: Floats, row: int, sums: Floats,
) -> bool:  # fmt: skip
    """Put force and moments of a contact into its memory; whether it presses.

    Bodies i and j have velocities v, w now and had u, o half a step ago, which moved them to where they are.
    Springs, with ``part`` of the stiffness, and dampers at the points push along their directions, ``sign``
    times those found, and never pull. Together they are one force at the
    centre of pressure, where a spring acts against sliding and one against turning about the normal, with the
    points' radius of gyration as its lever. Both slip where they exceed friction times the force together: an
    ellipsoid as limit surface (Howe, Cutkosky, Int. J. Robot. Res. 15:603, 1996).
    """
    k, kt, mu = law[NORMAL], law[TANGENT], law[FRICTION]
    c, ct = 2.0 * law[DAMPING] * np.sqrt(k * mass), 2.0 * law[DAMPING] * np.sqrt(kt * mass)
    k *= part
    total, stored, square, lever = 0.0, 0.0, 0.0, (0.0, 0.0, 0.0)
    force, moment = lever, lever
    v, w = subtract(vi, vj), subtract(wi, wj)
    # Velocity of i relative to j at a lever from xi: v - wj x (xi - xj) + w x lever.
    v = subtract(v, cross(wj, subtract(xi, xj)))
    for a in range(number):
        arm = subtract(vector(found, a), xi)
        depth, share = found[a, 3], found[a, 4]
        along = scale(sign, vector(found, a, 5))
        rate = dot(along, add(v, cross(w, arm)))
        spring = k * share * depth
        push = max(spring + c * share * rate, 0.0)
        sums[DAMPED] += (push - spring) * rate * h
        stored += 0.5 * spring * depth
        total += push
        square += push * dot(arm, arm)
        lever = add(lever, scale(push, arm))
        force = subtract(force, scale(push, along))
        moment = subtract(moment, scale(push, cross(arm, along)))
    if total <= 0.0:
        forget(memory, row, sums)
        return False
    lever = scale(1.0 / total, lever)
    radius2 = max(square / total - dot(lever, lever), 0.0)
    slide = add(v, cross(w, lever))
    slide = subtract(slide, scale(dot(slide, n), n))
    # The spring turns with the two bodies, and stays in the plane of contact.
    old = vector(memory, row, SLIP)
    size2 = dot(old, old)
    slip = add(old, scale(0.5 * h, cross(add(wi, wj), old)))
    slip = subtract(slip, scale(dot(slip, n), n))
    if size2 > 0.0:
        left = dot(slip, slip)
        if left > _SAME * _SAME * size2:
            slip = scale(np.sqrt(size2 / left), slip)
        else:
            sums[RUBBED] += 0.5 * kt * (size2 - left)
    # One that has begun in this step did so halfway, as far as we know.
    since = h if memory_used(memory, row) else 0.5 * h
    moved = subtract(ui, uj)
    moved = subtract(moved, cross(oj, subtract(subtract(xi, xj), scale(0.5 * h, moved))))
    moved = add(moved, cross(subtract(oi, oj), lever))
    slip = add(slip, scale(since, subtract(moved, scale(dot(moved, n), n))))
    # Sliding, and turning by the radius of gyration, share what friction there is.
    radius, spin = np.sqrt(radius2), dot(w, n)
    rolled = memory[row, TWIST] + since * radius * dot(subtract(oi, oj), n)
    drag, grip, most = scale(kt, slip), kt * rolled, mu * total
    size = np.sqrt(dot(drag, drag) + grip * grip)
    if size > most:
        # The work is of the mean of this step's drag and the last one's, whose spring held 1/2 F^2 / kt.
        before = np.sqrt(2.0 * kt * memory[row, HELD])
        sums[RUBBED] += 0.5 * (before + most) * (size - most) / kt
        slip, rolled = scale(most / size, slip), most / size * rolled
        drag, grip = scale(kt, slip), kt * rolled
    else:
        drag, grip = add(drag, scale(ct, slide)), grip + ct * radius * spin
        size = np.sqrt(dot(drag, drag) + grip * grip)
        if size > most:
            drag, grip = scale(most / size, drag), most / size * grip
        loss = dot(subtract(drag, scale(kt, slip)), slide)
        sums[RUBBED] += h * (loss + (grip - kt * rolled) * radius * spin)
    force = subtract(force, drag)
    moment = subtract(moment, add(cross(lever, drag), scale(radius * grip, n)))
    put(slip, memory, row, SLIP)
    memory[row, TWIST] = rolled
    put(force, memory, row, FORCE)
    put(moment, memory, row, MOMENT)
    put(scale(-1.0, add(moment, cross(subtract(xi, xj), force))), memory, row, BACK)
    memory[row, HELD] = 0.5 * kt * (dot(slip, slip) + rolled * rolled)
    memory[row, ENERGY] = stored + memory[row, HELD]
    return True


@kernel
def collect(memory: Floats, row: int, total: Floats, i: int, sums: Floats) -> None:
    """Add force and moment of a contact to those of its first cube."""
    for k in range(6):
        total[i, k] += memory[row, FORCE + k]
    sums[STORED] += memory[row, ENERGY]
