"""Products of the torsional Hessian with a vector, by differences of torques."""

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from bench.cases import Point
from bench.cost import least_seconds
from bench.studies.precision.differences import extrapolated
from bench.studies.precision.peptides import Peptide, peptide
from protochain.core.arrays import Floats
from protochain.mechanics.multibody import integrate

Torque = Callable[[float], Floats]
"""Distance along a direction -> minus the torques there."""

FIRST = {"vacuum": 0.02, "obc2": 0.002}
"""rad. First step of the reference: OBC2 has kinks, where spheres begin to overlap, and few within this."""


def one_sided(torque: Torque, here: Floats, h: float) -> Floats:
    """Difference from the torques ``here``, as truncated Newton's method takes it."""
    return (torque(h) - here) / h


def central(torque: Torque, here: Floats, h: float) -> Floats:
    """Of order two."""
    return (torque(h) - torque(-h)) / (2 * h)


def fourth_order(torque: Torque, here: Floats, h: float) -> Floats:
    """Of order four."""
    return (4 * central(torque, here, h / 2) - central(torque, here, h)) / 3


RULES = {"one-sided": (one_sided, 1), "central": (central, 2), "order four": (fourth_order, 4)}
"""Rule, and evaluations beyond the one at the point."""


def along(of: Peptide, direction: Floats) -> Torque:
    """Minus the torques as a function of the distance along a direction (n_v,)."""

    def torque(h: float) -> Floats:
        q = integrate(of.chain.tree, of.q, h * direction)
        return -of.system.potential(q, of.system.factors(q))[1]

    return torque


def measure(quick: bool) -> Iterator[Point]:
    """Error by rule and step, at a minimum, along a random direction whose largest turn is the step."""
    for solvent, first in FIRST.items():
        of = peptide("GAG" if quick else "YGGFM", solvent, "fixed")
        direction = np.random.default_rng(2).normal(size=of.chain.n_v)
        direction /= np.abs(direction).max()
        torque = along(of, direction)
        exact, left = extrapolated(torque, first, 7)
        here, size = torque(0.0), float(np.linalg.norm(exact))
        against = f"extrapolated differences, which agree to {left / float(np.abs(exact).max()):.0e}"
        for name, (rule, evaluations) in RULES.items():
            for h in 10.0 ** -np.arange(1, 10, 2 if quick else 1, dtype=float):
                error = float(np.linalg.norm(rule(torque, here, h) - exact)) / size
                seconds = least_seconds(partial(rule, torque, here, h), 0.02)
                yield Point(
                    name, f"{h:g} rad", seconds, error, of.name, "1", against, evaluations, of.chain.n_v
                )
