"""One point of contact: how the velocity there changes with the normal impulse, piece by piece.

With u = (normal, two tangential) components of the relative velocity, W its inverse inertia and p the normal
impulse, du/dp = W (1, t). While the point slips, t = -mu u_t/|u_t|. In the variable s with dp = |u_t| ds,

    d theta/ds = c x (W_tn - mu W_tt c),  d ln|u_t|/ds = c . (W_tn - mu W_tt c),  c = (cos theta, sin theta)

has no singularity at the end of the slip (Keller, J. Appl. Mech. 53:1, 1986, Batlle, J. Appl. Mech. 63:168,
1996). If theta stays, as in every plane problem, the velocity is linear in p and the segment exact.
"""

import numpy as np

from protochain.core.arrays import Floats
from protochain.mechanics.multibody.algebra import kernel
from protochain.mechanics.tableaux import DORMAND_PRINCE

NEWTON, POISSON, STRONGE = range(3)
"""Laws of restitution."""
DONE, IMMOVABLE, JAMMED, LOST, ENDLESS, GOING = range(6)
"""Outcome of a path: success, nothing gives way along the normal, Newton's law requires a normal velocity
that a sticking point cannot have, too many steps, too many turns, or not yet finished."""
Contact = tuple[float, float, float, float, float, float]
"""W_tn (2), W_tt (its upper triangle) and mu, in units of W_nn."""
Slip = tuple[float, float]
"""Tangential velocity or its direction, and a tangential impulse per normal one."""
Phase = tuple[bool, int, float]
"""Whether it is the restitution, the law, the goal at its end. The state y (6,) is angle and logarithm of the
slip, the impulses, and the work of the normal one."""
_STRAIGHT, _ROUNDING, _NOTHING = 1e-12, 4e-15, 1e-12
"""Bounds on the turn of a constant direction of slip, relative to the change of its speed and for rounding.
Inverse inertia or velocity that is rounding error."""
_MOST, _TRIALS = 20_000, 200
"""Pieces of one path, and trials of one step. Curved ones end near a direction that stays, after dozens."""

_A, _WRONG = np.array(DORMAND_PRINCE.a), np.array(DORMAND_PRINCE.error)


@kernel
def follow(
    w: Floats, u: Floats, mu: float, e: float, law: int, slow: float, tolerance: float, out: Floats
) -> int:
    """Write impulse (normal, two tangential), work and pieces of an impact. Return the outcome."""
    # w (3, 3), u (3,), out (8,): impulse, impulse of the compression, its work, all work, numbers of straight
    # and curved pieces.
    out[:] = 0.0
    nn, speed = w[0, 0], -u[0]
    if not nn > _NOTHING * _NOTHING * max(nn, max(w[1, 1], w[2, 2])):
        return IMMOVABLE
    # In units of the inverse inertia and the speed along the normal.
    of = w[0, 1] / nn, w[0, 2] / nn, w[1, 1] / nn, w[1, 2] / nn, w[2, 2] / nn, mu
    slip = u[1] / speed, u[2] / speed
    least = max(_NOTHING * max(1.0, np.sqrt(of[2] + of[4])), slow / speed)
    at_rest = max(1e-6 * max(1.0, np.hypot(slip[0], slip[1])), 1e3 * slow / speed)
    y = np.zeros(6)
    status = _impact(of, slip, e, law, least, at_rest, tolerance, y, out)
    unit = speed / nn
    out[0], out[1], out[2], out[3] = y[2] * unit, y[3] * unit, y[4] * unit, out[3] * unit
    out[4], out[5] = out[4] * unit * speed, y[5] * unit * speed
    return status


@kernel
def _impact(
    of: Contact, slip: Slip, e: float, law: int, least: float, at_rest: float, tolerance: float, y: Floats,
    out: Floats,
) -> int:  # fmt: skip
    """Write the state at the end of compression and restitution, piece by piece. Return the outcome."""
    stage, new, mu = np.zeros((7, 6)), np.zeros(6), of[5]
    grip = np.hypot(of[0], of[1]) + mu * (of[2] + of[4])
    phase, turning, stopped = (False, law, 0.0), mu > 0.0, np.hypot(slip[0], slip[1]) <= least
    status, step, t = GOING, 0.0, (0.0, 0.0)
    for _ in range(_MOST):
        straight, length, s, turn, growth = True, np.inf, t, 0.0, 0.0
        size, s = _slip(of, slip, least, step == 0.0, y) if turning else (0.0, t)
        # The slip can end together with a phase.
        if turning and (stopped or size <= least):
            t, turning = _from_rest(of), False
        elif turning:
            turn, growth = _slip_rates(of, s)
            straight = abs(turn) <= max(_STRAIGHT * abs(growth), _ROUNDING * grip)
            t = -mu * s[0], -mu * s[1]
            if straight and growth < 0.0:
                length = -size / growth
        if straight:
            status, event = _straight_piece(of, phase, t, length, at_rest, y)
            stopped, step = not event and length < np.inf, 0.0
            out[6] += 1.0
        else:
            step = _first_step(of, s, turn, growth, step)
            event, step = _curved_piece(of, phase, step, tolerance, y, stage, new)
            # The remaining slip is rounding error.
            stopped = not event and np.exp(y[1]) <= least
            out[7] += 1.0
        if status == GOING:
            status, phase = _next_phase(of, phase, event, e, y, out)
        if status != GOING:
            return status
    return LOST


@kernel
def _next_phase(
    of: Contact, phase: Phase, event: bool, e: float, y: Floats, out: Floats
) -> tuple[int, Phase]:
    """Outcome and phase after a piece: restitution, or compression again if the slip presses on."""
    restoring, law, _ = phase
    if restoring and _normal_velocity(of, y) < -1e-10:
        return GOING, (False, law, 0.0)
    if not event:
        return GOING, phase
    if restoring:
        return DONE, phase
    p, work = y[2], y[5]
    out[3], out[4] = p, work
    goal = e if law == NEWTON else ((1.0 + e) * p if law == POISSON else (1.0 - e * e) * work)
    return (DONE if e == 0.0 else GOING), (True, law, goal)


@kernel
def _normal_velocity(of: Contact, y: Floats) -> float:
    return -1.0 + y[2] + of[0] * y[3] + of[1] * y[4]


@kernel
def _slip(of: Contact, start: Slip, least: float, anew: bool, y: Floats) -> tuple[float, Slip]:
    """Size and direction of the slip, anew from the impulses, else from angle and logarithm."""
    if not anew:
        return np.exp(y[1]), (np.cos(y[0]), np.sin(y[0]))
    n1, n2, t11, t12, t22, _ = of
    v1 = start[0] + n1 * y[2] + t11 * y[3] + t12 * y[4]
    v2 = start[1] + n2 * y[2] + t12 * y[3] + t22 * y[4]
    size = np.hypot(v1, v2)
    if size <= least:
        return 0.0, (0.0, 0.0)
    y[0], y[1] = np.arctan2(v2, v1), np.log(size)
    return size, (v1 / size, v2 / size)


@kernel
def _slip_rates(of: Contact, s: Slip) -> tuple[float, float]:
    """Rates of the angle and of the logarithm of the slip."""
    n1, n2, t11, t12, t22, mu = of
    c1, c2 = n1 - mu * (t11 * s[0] + t12 * s[1]), n2 - mu * (t12 * s[0] + t22 * s[1])
    return s[0] * c2 - s[1] * c1, s[0] * c1 + s[1] * c2


@kernel
def _straight_piece(
    of: Contact, phase: Phase, t: Slip, length: float, at_rest: float, y: Floats
) -> tuple[int, bool]:
    """Follow a constant direction to the end of phase or slip. Return outcome, and whether the phase ends."""
    restoring, law, goal = phase
    u_n, slope = _normal_velocity(of, y), 1.0 + of[0] * t[0] + of[1] * t[1]
    end = _end_of_piece(restoring, law, u_n, slope, goal - _value(phase, u_n, y), y)
    if length == np.inf and end == np.inf:
        # Sticking, where the normal velocity goes with the tangential one, which is zero.
        if restoring:
            return (JAMMED if law == NEWTON else DONE), False
        if abs(u_n) > at_rest:
            return LOST, False
        end = 0.0
    d = end if end <= length else length
    y[5] += d * (u_n + 0.5 * d * slope)
    y[2] += d
    y[3] += d * t[0]
    y[4] += d * t[1]
    return GOING, end <= length


@kernel
def _first_step(of: Contact, s: Slip, turn: float, growth: float, step: float) -> float:
    """Step of a curved piece, from the previous step."""
    # Steps contract towards a direction that stays while they are below 3.3 / |d turn/d theta|.
    across = of[5] * (s[1] * s[1] * of[2] - 2.0 * s[0] * s[1] * of[3] + s[0] * s[0] * of[4])
    stiff = abs(growth + across) + abs(turn) + abs(growth)
    return min(0.1 / stiff if step == 0.0 else step, 3.0 / stiff)


@kernel
def _curved_piece(
    of: Contact, phase: Phase, d: float, tolerance: float, y: Floats, stage: Floats, new: Floats
) -> tuple[bool, float]:
    """Make one step, at most to the end of the phase. Return whether the phase ends, and the next step."""
    before = _value(phase, _normal_velocity(of, y), y) - phase[2]
    factor = 1.0
    for _ in range(_TRIALS):
        error = _embedded_step(of, y, d, stage, new)
        factor = min(5.0, max(0.2, 0.9 * (tolerance / max(error, 1e-30)) ** 0.2))
        if error <= tolerance:
            break
        d *= factor
    beyond = _value(phase, _normal_velocity(of, new), new) - phase[2]
    event = beyond >= 0.0
    d = _step_to_event(of, phase, d, before, beyond, y, stage, new) if event else d * factor
    y[:] = new
    return event, d


@kernel
def _step_to_event(
    of: Contact, phase: Phase, d: float, f_low: float, f_high: float, y: Floats, stage: Floats, new: Floats
) -> float:
    """Step, up to d, that ends the phase, by the Illinois method. f is the excess over the goal."""
    low, high, f = 0.0, d, f_high
    for _ in range(_TRIALS):
        if abs(f) <= 1e-15 * max(1.0, abs(phase[2])) or high - low <= 1e-15 * high:
            break
        d = low + (high - low) * f_low / (f_low - f_high) if f_low < 0.0 else 0.5 * (low + high)
        if not low < d < high:
            d = 0.5 * (low + high)
        _embedded_step(of, y, d, stage, new)
        f = _value(phase, _normal_velocity(of, new), new) - phase[2]
        if f >= 0.0:
            high, f_high = d, f
            f_low *= 0.5
        else:
            low, f_low = d, f
            f_high *= 0.5
    return d


@kernel
def _value(phase: Phase, u_n: float, y: Floats) -> float:
    """Quantity that reaches its goal at the end of a phase."""
    restoring, law, _ = phase
    if not restoring or law == NEWTON:
        return u_n
    return y[2] if law == POISSON else y[5]


@kernel
def _end_of_piece(restoring: bool, law: int, u_n: float, slope: float, left: float, y: Floats) -> float:
    """Normal impulse to the end of the phase along a straight piece, infinite if there is none."""
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
def _embedded_step(of: Contact, y: Floats, d: float, stage: Floats, new: Floats) -> float:
    """Write the state a step d further. Return the estimate of its error."""
    mu = of[5]
    for i in range(7):
        for j in range(6):
            x = 0.0
            for k in range(i):
                x += _A[i, k] * stage[k, j]
            new[j] = y[j] + d * x
        s1, s2, slip = np.cos(new[0]), np.sin(new[0]), np.exp(new[1])
        stage[i, 0], stage[i, 1] = _slip_rates(of, (s1, s2))
        stage[i, 2] = slip
        stage[i, 3], stage[i, 4] = -mu * slip * s1, -mu * slip * s2
        stage[i, 5] = slip * _normal_velocity(of, new)
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
def _from_rest(of: Contact) -> Slip:
    """Tangential impulse per normal one at u_t = 0: it sticks if friction can, else slip starts."""
    # W_tn + W_tt t = b s with t = -mu s: (b + mu W_tt) s = W_tn, whose length falls from more than 1 at b = 0
    # to 0, so that there is one such b. Along the axes of W_tt.
    n1, n2, t11, t12, t22, mu = of
    mean, half = 0.5 * (t11 + t22), 0.5 * (t11 - t22)
    spread = np.hypot(half, t12)
    large = mean + spread
    small = (t11 * t22 - t12 * t12) / large if large > 0.0 else 0.0
    # The axis of the larger one.
    angle = 0.5 * np.arctan2(t12, half)
    a1, a2 = np.cos(angle), np.sin(angle)
    first, second = a1 * n1 + a2 * n2, a1 * n2 - a2 * n1
    if small <= 1e-13 * large:
        # Nothing moves along this axis, by normal impulses either.
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
    """Write impulses, and impulses of the compressions, of one point after the other, the fastest first."""
    # out (2, 3 k).
    v, block, local, state_of_point = u.copy(), np.empty((3, 3)), np.empty(8), np.empty(3)
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
        state_of_point[:] = v[i : i + 3]
        status = follow(block, state_of_point, mu[i // 3], e[i // 3], law, slow[i // 3], tolerance, local)
        if status == LOST:
            # Rounding errors are too large a part of the remaining approach.
            return ENDLESS, i // 3
        if status != DONE:
            return status, i // 3
        for j in range(3):
            out[0, i + j] += local[j]
            for k in range(len(v)):
                v[k] += w[k, i + j] * local[j]
        out[1, i] += local[3]
    return ENDLESS, i // 3
