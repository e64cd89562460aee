"""One point of contact: how the velocity there changes with the normal impulse, piece by piece.

With u = (normal, two tangential) components of the relative velocity, W its inverse inertia and p the normal
impulse, du/dp = W (1, t). While the point slips, t = -mu u_t/|u_t|. In the variable s with dp = |u_t| ds,

    d theta/ds = c x (W_tn - mu W_tt c),  d ln|u_t|/ds = c . (W_tn - mu W_tt c),  c = (cos theta, sin theta)

has no singularity where the slip ends (Keller, J. Appl. Mech. 53:1, 1986; Batlle, J. Appl. Mech. 63:168,
1996). Where theta stays, as in every plane problem, the velocity is linear in p and the piece exact.
"""

import numpy as np

from protochain.core.arrays import Floats
from protochain.mechanics.multibody.algebra import kernel
from protochain.mechanics.tableaux import DORMAND_PRINCE

NEWTON, POISSON, STRONGE = range(3)
"""Laws of restitution."""
DONE, IMMOVABLE, JAMMED, LOST, ENDLESS = range(5)
"""How a path ended: as it should; nothing gives way along the normal; Newton's law asks for a normal velocity
that a sticking point cannot have; too many steps; too many turns."""
ANGLE = 0
"""Columns of the state of a curved piece: angle and logarithm of slip, impulses, work of the normal one."""
_STRAIGHT, _ROUNDING, _NOTHING = 1e-12, 4e-15, 1e-12
"""How little the direction of slip turns, to the change of its speed, and to rounding, if it stays; inverse
inertia or velocity that is rounding error."""
_MOST = 20_000
"""Steps of one path. A curved piece ends near a direction that stays, after some dozens."""

_A, _WRONG = np.array(DORMAND_PRINCE.a), np.array(DORMAND_PRINCE.error)


@kernel
def follow(
    w: Floats, u: Floats, mu: float, e: float, law: int, slow: float, tolerance: float, out: Floats
) -> int:  # fmt: skip
    """Write the impulse (normal, two tangential) that ends an impact, and how it came about.

    w, u (3, 3), out (8,).
    """
    size = max(w[0, 0], max(w[1, 1], w[2, 2]))
    out[:] = 0.0
    if not w[0, 0] > _NOTHING * _NOTHING * size:
        return IMMOVABLE
    # In units of the normal's own inverse inertia and speed.
    nn, speed = w[0, 0], -u[0]
    n1, n2 = w[0, 1] / nn, w[0, 2] / nn
    t11, t12, t22 = w[1, 1] / nn, w[1, 2] / nn, w[2, 2] / nn
    b1, b2 = u[1] / speed, u[2] / speed
    grip = np.hypot(n1, n2) + mu * (t11 + t22)
    least = max(_NOTHING * max(1.0, np.sqrt(t11 + t22)), slow / speed)

    y, new, stage = np.zeros(6), np.zeros(6), np.zeros((7, 6))
    restoring, turning = False, mu > 0.0
    stopped = np.hypot(b1, b2) <= least
    goal, p_end, a_end, step = 0.0, 0.0, 0.0, 0.0
    s1, s2 = 1.0, 0.0
    status = LOST
    for _ in range(_MOST):
        u_n = -1.0 + y[2] + n1 * y[3] + n2 * y[4]
        length = np.inf
        t1, t2 = 0.0, 0.0
        straight = True
        if turning:
            if stopped:
                t1, t2 = _from_rest(n1, n2, t11, t12, t22, mu)
                turning = False
            else:
                v1 = b1 + n1 * y[2] + t11 * y[3] + t12 * y[4]
                v2 = b2 + n2 * y[2] + t12 * y[3] + t22 * y[4]
                if step == 0.0:
                    slip = np.hypot(v1, v2)
                    y[0], y[1] = np.arctan2(v2, v1), np.log(slip)
                    s1, s2 = v1 / slip, v2 / slip
                else:
                    slip = np.exp(y[1])
                    s1, s2 = np.cos(y[0]), np.sin(y[0])
                c1, c2 = n1 - mu * (t11 * s1 + t12 * s2), n2 - mu * (t12 * s1 + t22 * s2)
                turn, growth = s1 * c2 - s2 * c1, s1 * c1 + s2 * c2
                straight = abs(turn) <= max(_STRAIGHT * abs(growth), _ROUNDING * grip)
                if straight:
                    t1, t2 = -mu * s1, -mu * s2
                    if growth < 0.0:
                        length = -slip / growth
        elif mu > 0.0:
            # The piece that began from rest goes on.
            t1, t2 = s1, s2
        before = goal - _value(restoring, law, u_n, y)
        event = False
        if straight:
            slope = 1.0 + n1 * t1 + n2 * t2
            end = _end_of_piece(restoring, law, u_n, slope, before, y)
            if length == np.inf and end == np.inf:
                # Sticking, where the normal velocity goes with the tangential one, which is zero.
                if restoring and law == NEWTON:
                    status = JAMMED
                    break
                if restoring or abs(u_n) > max(1e-6 * max(1.0, np.hypot(b1, b2)), 1e3 * slow / speed):
                    status = DONE if restoring else LOST
                    break
                end = 0.0
            event = end <= length
            d = end if event else length
            y[5] += d * (u_n + 0.5 * d * slope)
            y[2] += d
            y[3] += d * t1
            y[4] += d * t2
            out[6] += 1.0
            stopped = not event and length < np.inf
            if not turning:
                s1, s2 = t1, t2
            step = 0.0
        else:
            # A curved piece: one step, and where it passes the end of a phase, the step that ends there.
            # Steps contract towards a direction that stays while they are below 3.3 / |d turn/d theta|.
            across = mu * (s2 * s2 * t11 - 2.0 * s1 * s2 * t12 + s1 * s1 * t22)
            stiff = abs(growth + across) + abs(turn) + abs(growth)
            if step == 0.0:
                step = 0.1 / stiff
            step = min(step, 3.0 / stiff)
            low, high, f_low, f_high = 0.0, step, -before, 0.0
            refining, d = False, step
            for _ in range(200):
                error = _curved(y, d, n1, n2, t11, t12, t22, mu, stage, new)
                factor = min(5.0, max(0.2, 0.9 * (tolerance / max(error, 1e-30)) ** 0.2))
                u_n = -1.0 + new[2] + n1 * new[3] + n2 * new[4]
                f = _value(restoring, law, u_n, new) - goal
                if not refining:
                    if not error <= tolerance:
                        d *= factor
                        step = d
                        continue
                    event = f >= 0.0
                    if not event:
                        step = d * factor
                        break
                    refining, high, f_high = True, d, f
                elif f >= 0.0:
                    high, f_high = d, f
                    f_low *= 0.5
                else:
                    low, f_low = d, f
                    f_high *= 0.5
                if abs(f) <= 1e-15 * max(1.0, abs(goal)) or high - low <= 1e-15 * high:
                    break
                d = low + (high - low) * f_low / (f_low - f_high) if f_low < 0.0 else 0.5 * (low + high)
                if not low < d < high:
                    d = 0.5 * (low + high)
            y[:] = new
            out[7] += 1.0
            # What is left of the slip is rounding error.
            stopped = not event and np.exp(y[1]) <= least
            if event:
                step = d
        u_n = -1.0 + y[2] + n1 * y[3] + n2 * y[4]
        if restoring and u_n < -1e-10:
            # The slip has turned so that it presses again: the compression goes on.
            restoring, event, goal = False, False, 0.0
        if event:
            if restoring:
                status = DONE
                break
            restoring = True
            p_end, a_end = y[2], y[5]
            goal = e if law == NEWTON else ((1.0 + e) * p_end if law == POISSON else (1.0 - e * e) * a_end)
            if e == 0.0:
                status = DONE
                break
    unit = speed / nn
    out[0], out[1], out[2], out[3] = y[2] * unit, y[3] * unit, y[4] * unit, p_end * unit
    out[4], out[5] = a_end * unit * speed, y[5] * unit * speed
    return status


@kernel
def _value(restoring: bool, law: int, u_n: float, y: Floats) -> float:
    """What reaches its goal at the end of a phase."""
    if not restoring or law == NEWTON:
        return u_n
    return y[2] if law == POISSON else y[5]


@kernel
def _end_of_piece(restoring: bool, law: int, u_n: float, slope: float, left: float, y: Floats) -> float:
    """Normal impulse to the end of the phase along a straight piece; infinite if there is none."""
    steep = slope > 1e-13
    if restoring and law == POISSON:
        return max(left, 0.0)
    if restoring and law == STRONGE:
        # u_n d + slope d^2 / 2 = left, u_n >= 0: the root in the form without cancellation.
        under = u_n * u_n + 2.0 * slope * left
        bottom = u_n + np.sqrt(max(under, 0.0))
        return 2.0 * left / bottom if steep and bottom > 0.0 else np.inf
    return max(left, 0.0) / slope if steep else np.inf


@kernel
def _curved(
    y: Floats, d: float, n1: float, n2: float, t11: float, t12: float, t22: float, mu: float,
    stage: Floats, new: Floats,
) -> float:  # fmt: skip
    """Write the state a step d further; return the estimate of its error."""
    for i in range(7):
        for j in range(6):
            x = 0.0
            for k in range(i):
                x += _A[i, k] * stage[k, j]
            new[j] = y[j] + d * x
        s1, s2, slip = np.cos(new[0]), np.sin(new[0]), np.exp(new[1])
        c1, c2 = n1 - mu * (t11 * s1 + t12 * s2), n2 - mu * (t12 * s1 + t22 * s2)
        stage[i, 0], stage[i, 1] = s1 * c2 - s2 * c1, s1 * c1 + s2 * c2
        stage[i, 2] = slip
        stage[i, 3], stage[i, 4] = -mu * slip * s1, -mu * slip * s2
        stage[i, 5] = slip * (-1.0 + new[2] + n1 * new[3] + n2 * new[4])
    largest = 0.0
    size = max(1.0, abs(new[2]))
    for j in range(6):
        x = 0.0
        for k in range(7):
            x += _WRONG[k] * stage[k, j]
        unit = 1.0 if j < 2 else size * (max(1.0, mu) if 3 <= j <= 4 else 1.0)
        largest = max(largest, abs(d * x) / unit)
    return largest


@kernel
def _from_rest(
    n1: float, n2: float, t11: float, t12: float, t22: float, mu: float
) -> tuple[float, float]:  # fmt: skip
    """Tangential impulse per normal one at u_t = 0: it sticks if friction can, else slip starts.

    W_tn + W_tt t = b s with t = -mu s: (b + mu W_tt) s = W_tn, whose length falls from more than 1 at b = 0
    to 0, so that there is one such b. Along the axes of W_tt.
    """
    mean, half = 0.5 * (t11 + t22), 0.5 * (t11 - t22)
    spread = np.hypot(half, t12)
    large = mean + spread
    small = (t11 * t22 - t12 * t12) / large if large > 0.0 else 0.0
    # The axis of the larger one.
    angle = 0.5 * np.arctan2(t12, half)
    a1, a2 = np.cos(angle), np.sin(angle)
    first, second = a1 * n1 + a2 * n2, a1 * n2 - a2 * n1
    if small <= 1e-13 * large:
        # Nothing moves along this axis; nor does the normal along it.
        small, second = 0.0, 0.0
    x = -first / large if large > 0.0 else 0.0
    z = -second / small if small > 0.0 else 0.0
    if np.hypot(x, z) > mu:
        low, high = 0.0, np.hypot(n1, n2)
        b = 0.0
        for _ in range(100):
            f, g = b + mu * large, b + mu * small
            x = first / f if first != 0.0 else 0.0
            z = second / g if second != 0.0 else 0.0
            length = np.hypot(x, z)
            if length > 1.0:
                low = b
            else:
                high = b
            if abs(length - 1.0) <= 1e-15 or high - low <= 1e-16 * high:
                break
            # Newton on 1/length - 1, which is nearly straight.
            fall = (x * x / f if first != 0.0 else 0.0) + (z * z / g if second != 0.0 else 0.0)
            b += (length - 1.0) * length * length / fall
            if not low < b < high:
                b = 0.5 * (low + high)
        length = np.hypot(x, z)
        x, z = -mu * x / length, -mu * z / length
    return a1 * x - a2 * z, a2 * x + a1 * z


@kernel
def follow_in_turn(
    w: Floats, u: Floats, mu: Floats, e: Floats, law: int, slow: Floats, tolerance: float, turns: int,
    out: Floats,
) -> tuple[int, int]:  # fmt: skip
    """Write impulses, and those of the compressions, of one point after the other, the fastest first.

    out (2, 3 k).
    """
    v, block, local, own = u.copy(), np.empty((3, 3)), np.empty(8), np.empty(3)
    out[:] = 0.0
    i = 0
    for _ in range(turns):
        i = -1
        for j in range(len(slow)):
            if v[3 * j] < -slow[j] and (i < 0 or v[3 * j] < v[i]):
                i = 3 * j
        if i < 0:
            return DONE, 0
        block[:] = w[i : i + 3, i : i + 3]
        own[:] = v[i : i + 3]
        status = follow(block, own, mu[i // 3], e[i // 3], law, slow[i // 3], tolerance, local)
        if status == LOST:
            # Of what approach is left, rounding errors are too large a part.
            return ENDLESS, i // 3
        if status != DONE:
            return status, i // 3
        for j in range(3):
            out[0, i + j] += local[j]
            for k in range(len(v)):
                v[k] += w[k, i + j] * local[j]
        out[1, i] += local[3]
    return ENDLESS, i // 3
