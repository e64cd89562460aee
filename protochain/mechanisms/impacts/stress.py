"""Mean impulse stress in rigid bodies, which follows from their motion and the impulses on them."""

from collections.abc import Sequence

import numpy as np

from protochain.core.arrays import Floats
from protochain.core.errors import MechanicsError
from protochain.mechanics.multibody.articulated import Articulated
from protochain.mechanisms.impacts.bodies import External, RigidBodies, check_external
from protochain.mechanisms.impacts.impact import Impact
from protochain.mechanisms.impacts.points import ContactPoint


def impulse_stress(
    factors: Articulated,
    qd: Floats,
    found: Impact,
    points: Sequence[ContactPoint],
    external: External | None = None,
) -> Floats:
    """Integral of the impulse stress over each body. By its volume, the mean of Cauchy's impulse tensor.

    Parameters
    ----------
    factors : Articulated
        Rigid bodies, as for :func:`impact`.
    qd : (n_v,) float
        Velocities before.
    found : Impact
        Result of the impact.
    points : sequence of ContactPoint
        Points of contact.
    external : mapping of int to ((3,) float, (3,) float), optional
        Impulses that were given.

    Returns
    -------
    (nb, 3, 3) float
        Symmetric, world axes. Impulse times length, negative in compression.

    Raises
    ------
    MechanicsError
        If the impact had loops, whose rows do not give the places of their joints in a body. If bodies
        bend, or for ``external``, as :func:`impact`.

    Notes
    -----
    With impulse stress S, div S = rho dv inside and S n = p on the surface, so that the integral of S is the
    sum of P r^T over impulses P at r, less the integral of rho dv r^T. A hinge bears at the origin of its
    outward body. Its couple C has no place, so the part [C]/2, which makes S symmetric, is used.
    O(n).
    """
    if not isinstance(factors, Articulated):
        raise MechanicsError("impulse stress: shapes of flexible bodies do not locate the forces")
    tree, frames, bodies = factors.tree, factors.frames, RigidBodies(factors)
    if len(found.loops):
        raise MechanicsError(
            "impulse stress: rows of loops do not locate the joint forces; remove the loops, or close "
            "them by points"
        )
    loads, out = np.zeros((tree.n_bodies, 6)), np.zeros((tree.n_bodies, 3, 3))

    def push(body: int, at: Floats, impulse: Floats, couple: Floats) -> None:
        if body >= 0:
            arm = at - frames.origin[body]
            loads[body] += *(np.cross(arm, impulse) + couple), *impulse
            out[body] += np.outer(impulse, arm) + 0.5 * np.cross(np.eye(3), couple)

    none = np.zeros(3)
    for point, impulse in zip(points, found.impulse, strict=True):
        push(point.bodies[0], point.point, -impulse, none)
        push(point.bodies[1], point.point, impulse, none)
    for body, (at, impulse) in check_external(external or {}, tree.n_bodies).items():
        push(body, at, impulse, none)
    change = bodies.twists(found.qd) - bodies.twists(qd)
    for b in reversed(range(tree.n_bodies)):
        turn, shift = change[b, :3], change[b, 3:]
        axes = frames.rotation[b]
        inertia, centre, mass = axes @ tree.inertia[b] @ axes.T, axes @ tree.com[b], tree.mass[b]
        spread = 0.5 * np.trace(inertia) * np.eye(3) - inertia + mass * np.outer(centre, centre)
        moved = np.outer(mass * shift, centre) + np.cross(np.eye(3), turn) @ spread
        momentum = mass * (shift + np.cross(turn, centre))
        # Twice the part of rho dv r^T that is not symmetric is the moment of momentum.
        moment = np.array([moved[2, 1] - moved[1, 2], moved[0, 2] - moved[2, 0], moved[1, 0] - moved[0, 1]])
        through = np.concatenate([moment, momentum]) - loads[b]
        out[b] += 0.5 * np.cross(np.eye(3), through[:3]) - moved
        push(int(tree.parent[b]), frames.origin[b], -through[3:], -through[:3])
    return out
