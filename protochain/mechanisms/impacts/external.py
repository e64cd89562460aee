"""Given impulses, as of a hammer: M (qd+ - qd-) = sum of J_p^T P over the points p struck."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from protochain.core.arrays import Floats, floats
from protochain.core.checks import brief
from protochain.core.errors import Fault, MechanicsError
from protochain.mechanisms.impacts.bodies import Bodies

External = Mapping[int, tuple[ArrayLike, ArrayLike]]
"""Body -> world point (3,) and impulse on the body there (3,), world axes."""


def strike(bodies: Bodies, qd: Floats, external: External) -> tuple[Floats, float]:
    """Velocities (n_v,) after given impulses, from velocities qd (n_v,), and the work of the impulses."""
    wrench = external_wrench(bodies, external)
    after = qd + bodies.change(wrench)
    return after, 0.5 * float(np.sum(wrench * bodies.twists(qd + after)))


def external_wrench(bodies: Bodies, external: External) -> Floats:
    """(nb, 6) float: given impulses as wrenches about the bodies' origins, checked."""
    wrench = np.zeros((len(bodies.origin), 6))
    for body, (point, impulse) in check_external(external, len(wrench)).items():
        wrench[body] = *np.cross(point - bodies.origin[body], impulse), *impulse
    return wrench


def check_external(external: External, n: int) -> dict[int, tuple[Floats, Floats]]:
    """Body -> world point and impulse, of n bodies. Raise MechanicsError for invalid ones."""
    if not isinstance(external, Mapping):
        raise MechanicsError(f"external {brief(external)}: give {{body: (point, impulse)}}")
    impulses = {}
    for body, blow in external.items():
        if isinstance(body, bool) or not isinstance(body, int | np.integer) or not 0 <= body < n:
            raise MechanicsError(f"external: there is no body {brief(body)}; give a number from 0 to {n - 1}")
        label = f"external, body {body}"
        if not (isinstance(blow, tuple | list | np.ndarray) and len(blow) == 2):
            raise MechanicsError(f"{label}: give a pair, (point, impulse)")
        pair = floats(blow[0], (3,), f"{label}: point"), floats(blow[1], (3,), f"{label}: impulse")
        for quantity, values in zip(("point", "impulse"), pair, strict=True):
            if not np.isfinite(values).all():
                raise MechanicsError(f"{label}: its {quantity} is not finite", fault=Fault.NOT_FINITE)
        impulses[int(body)] = pair
    return impulses
