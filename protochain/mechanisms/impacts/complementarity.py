"""Several points of contact at once: impulses in friction cones that are complementary to velocities.

At each point the normal impulse is at least its floor f, and larger only if u_n = 0. The tangential one is in
the disc of radius mu L_n, on its edge and against u_t if the point slips. Projected Gauss-Seidel sweeps
(Jean, Comput. Methods Appl. Mech. Eng. 177:235, 1999) lead to the point at which Newton on the natural map
(Alart, Curnier, ibid. 92:353, 1991) finds the solution to rounding. A small multiple of 1 is added to W: it
spreads the load over redundant points as springs of equal stiffness would, with the least norm. It is removed
by shifts (Rockafellar's proximal points, SIAM J. Control Optim. 14:877, 1976).
"""

import numpy as np

from protochain.core.arrays import Floats
from protochain.mechanics.multibody.algebra import kernel

SOLVED, UNSOLVED, SEVERAL = range(3)
"""Outcome: found, not found, or found together with another solution."""
_SOFT = 1e-9
"""Addition to W, relative to its largest element."""
_EXACT = 1e-13
"""Residual, relative to the largest impulse."""
_OTHER = 1e-6
"""Distance of two solutions' velocities, relative to the largest, from which they differ."""
_PROXIMAL = 500


@kernel
def restitute(w: Floats, u: Floats, mu: Floats, e: Floats, out: Floats) -> int:
    """Write impulses of an impact of k points by Poisson's law: of both phases, and of the compression."""
    # w, u (3 k, 3 k), mu, e (k,), out (2, 3 k).
    n = len(u)
    floor, addition, before = np.zeros(n // 3), np.zeros(n), u
    low, high, part = 0.0, 1.0, 1.0
    for phase in range(40):
        status = _unique(w, before, mu, floor, addition)
        if status != SOLVED:
            out[0] = addition
            return status
        if phase == 0:
            out[1] = addition
            before = u + w @ addition
        else:
            out[0] = out[1] + addition
            moved = w @ out[0]
            gain, size = 0.0, 0.0
            for i in range(n):
                gain += out[0, i] * (u[i] + 0.5 * moved[i])
                size += abs(out[0, i] * u[i])
            # With one e for all points, no energy is gained. Points of different e can gain energy: then a
            # common factor lowers all e until no energy is gained.
            if gain <= 1e-12 * size:
                low = part
                if part == 1.0 or high - low < 1e-6:
                    break
            else:
                high = part
            part = 0.5 * (low + high) if high - low >= 1e-6 else low
        for i in range(n // 3):
            floor[i] = part * e[i] * out[1, 3 * i]
    return SOLVED


@kernel
def _unique(w: Floats, u: Floats, mu: Floats, floor: Floats, out: Floats) -> int:
    """Write the one solution, by a search from four starts if friction may allow more than one."""
    n = len(u)
    soft = w.copy()
    added = _SOFT * np.max(np.abs(w))
    for i in range(n):
        soft[i, i] += added
    x, before, shift = np.zeros(n), np.zeros(n), np.zeros(n)
    starts = 4 if np.max(mu) > 0.0 else 1
    is_found = False
    for step in range(starts + _PROXIMAL):
        if step == 1 and starts > 1:
            # Start at which all points stick.
            x = -u
            _eliminate(soft.copy(), x)
        elif 1 < step < starts:
            # Starts at which all points slip on, or back, with ten times the normal impulse.
            sign = 1.0 if step == 2 else -1.0
            for i in range(0, n, 3):
                slip = np.hypot(u[i + 1], u[i + 2])
                x[i] = floor[i // 3] + 10.0 * abs(u[i]) / soft[i, i]
                for j in range(1, 3):
                    x[i + j] = sign * mu[i // 3] * x[i] * u[i + j] / slip if slip > 0.0 else 0.0
        elif step >= starts:
            # Shifts that remove the addition to W.
            if not is_found:
                return UNSOLVED
            x[:] = out
            before[:] = out
        solved = _solve(soft, u - added * before, mu, floor, x, 6 if step < starts else 2, step == 1)
        shift = x - out
        if step >= starts:
            if not solved:
                # Impulses have no limit, as between wedges. Velocities are right except for the addition.
                return SOLVED
            out[:] = x
            if added * np.max(np.abs(shift)) <= _EXACT * np.max(np.abs(u)):
                return SOLVED
        elif solved and is_found:
            if np.max(np.abs(w @ shift)) > _OTHER * (np.max(np.abs(u)) + np.max(np.abs(w @ x))):
                out[:] = shift
                return SEVERAL
        elif solved:
            out[:] = x
            is_found = True
    return SOLVED


@kernel
def _solve(w: Floats, u: Floats, mu: Floats, floor: Floats, x: Floats, limit: int, backwards: bool) -> bool:
    """Overwrite x by a solution. Return False if none is found."""
    sweeps = 4
    for rounds in range(limit):
        if _newton(w, u, mu, floor, x):
            return True
        _sweep(w, u, mu, floor, x, sweeps, backwards, 1.0 if rounds < 3 else 0.3)
        sweeps *= 4
    return False


@kernel
def _sweep(
    w: Floats, u: Floats, mu: Floats, floor: Floats, x: Floats, sweeps: int, backwards: bool, part: float
) -> None:
    """Projected Gauss-Seidel: point by point, the normal impulse and then the tangential one."""
    k = len(mu)
    v = u + w @ x
    for _ in range(sweeps):
        for place in range(k):
            i = 3 * (k - 1 - place if backwards else place)
            d = part * (max(floor[i // 3], x[i] - v[i] / w[i, i]) - x[i])
            x[i] += d
            v += d * w[i]
            stiff = _stiffness(w, i)
            y, z = x[i + 1] - v[i + 1] / stiff, x[i + 2] - v[i + 2] / stiff
            length, bound = np.hypot(y, z), mu[i // 3] * x[i]
            cut = bound / length if length > bound else 1.0
            y, z = part * (cut * y - x[i + 1]), part * (cut * z - x[i + 2])
            x[i + 1] += y
            x[i + 2] += z
            v += y * w[i + 1] + z * w[i + 2]


@kernel
def _stiffness(w: Floats, i: int) -> float:
    """Larger eigenvalue of the tangential block."""
    mean, half = 0.5 * (w[i + 1, i + 1] + w[i + 2, i + 2]), 0.5 * (w[i + 1, i + 1] - w[i + 2, i + 2])
    return mean + np.hypot(half, w[i + 1, i + 2])


@kernel
def _newton(w: Floats, u: Floats, mu: Floats, floor: Floats, x: Floats) -> bool:
    """Overwrite x by a root of the natural map, if Newton's method finds one from there."""
    n = len(u)
    y, residual, slope = x.copy(), np.empty(n), np.empty((n, n))
    last, n_stalled = np.inf, 0
    for _ in range(30):
        size = _natural_map(w, u, mu, floor, y, residual, slope)
        error = np.max(np.abs(residual))
        if error <= _EXACT * size:
            x[:] = y
            return True
        if not np.isfinite(error):
            return False
        # Pieces may be entered in turn, without end.
        n_stalled = n_stalled + 1 if error > 0.5 * last else 0
        last = min(last, error)
        if n_stalled > 6:
            return False
        _eliminate(slope, residual)
        y -= residual
    return False


@kernel
def _eliminate(a: Floats, x: Floats) -> None:
    """Overwrite x by the solution of a z = x, and a by its factors. x is not finite if a is singular."""
    n = len(x)
    for j in range(n):
        p = j
        for i in range(j + 1, n):
            if abs(a[i, j]) > abs(a[p, j]):
                p = i
        if p != j:
            for k in range(j, n):
                a[j, k], a[p, k] = a[p, k], a[j, k]
            x[j], x[p] = x[p], x[j]
        for i in range(j + 1, n):
            part = a[i, j] / a[j, j]
            if part != 0.0:
                for k in range(j + 1, n):
                    a[i, k] -= part * a[j, k]
                x[i] -= part * x[j]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= a[i, k] * x[k]
        x[i] /= a[i, i]


@kernel
def _natural_map(
    w: Floats, u: Floats, mu: Floats, floor: Floats, x: Floats, residual: Floats, slope: Floats
) -> float:
    """Write the residual, as impulses, and its derivative. Return the size of impulses."""
    n = len(u)
    v = u + w @ x
    slope[:] = 0.0
    size = 0.0
    for i in range(0, n, 3):
        j = i // 3
        per = 1.0 / w[i, i]
        size = max(size, max(np.max(np.abs(x[i : i + 3])), abs(per * u[i])))
        if x[i] - floor[j] - per * v[i] > 0.0:
            residual[i] = per * v[i]
            slope[i] = per * w[i]
        else:
            residual[i] = x[i] - floor[j]
            slope[i, i] = 1.0
        per = 1.0 / _stiffness(w, i)
        bound = mu[j] * x[i]
        y, z = x[i + 1] - per * v[i + 1], x[i + 2] - per * v[i + 2]
        length = np.hypot(y, z)
        if not bound > 0.0:
            residual[i + 1], residual[i + 2] = x[i + 1], x[i + 2]
            slope[i + 1, i + 1], slope[i + 2, i + 2] = 1.0, 1.0
        elif length <= bound:
            residual[i + 1], residual[i + 2] = per * v[i + 1], per * v[i + 2]
            slope[i + 1], slope[i + 2] = per * w[i + 1], per * w[i + 2]
        else:
            y, z = y / length, z / length
            part = bound / length
            residual[i + 1], residual[i + 2] = x[i + 1] - bound * y, x[i + 2] - bound * z
            # part (1 - d d^T) per W, then the identity less part (1 - d d^T), less mu d along the normal.
            for k in range(n):
                across = per * part * (y * w[i + 2, k] - z * w[i + 1, k])
                slope[i + 1, k], slope[i + 2, k] = -z * across, y * across
            slope[i + 1, i + 1] += 1.0 - part * z * z
            slope[i + 1, i + 2] += part * y * z
            slope[i + 2, i + 1] += part * y * z
            slope[i + 2, i + 2] += 1.0 - part * y * y
            slope[i + 1, i] -= mu[j] * y
            slope[i + 2, i] -= mu[j] * z
    return size
