"""Implicit midpoint rule in the coordinates of a tree: stable for stiff springs."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from scipy.optimize import NoConvergence, newton_krylov
from scipy.sparse.linalg import LinearOperator

from protochain.core.arrays import Floats
from protochain.core.checks import check_fields
from protochain.core.settings import document_fields
from protochain.mechanics import multibody
from protochain.mechanics.motion.leapfrog import put_end_momenta
from protochain.mechanics.motion.substeps import TOLERANCE
from protochain.mechanics.motion.system import Equations, Integrator, Phase, StepTooLargeError, canonical
from protochain.mechanics.multibody.articulated import Articulated, solve
from protochain.mechanics.multibody.hamilton import momenta

LEAST = 1e-3
"""rad, or size of the tree, in a step. Smaller motions are solved to the same absolute error."""


@document_fields
@dataclass(frozen=True)
class ImplicitMidpoint(Integrator):
    """Implicit midpoint rule: reversible and symplectic, of order two, with the potential at the midpoint.

    The discrete Lagrangian is h L(exp(xi/2) q, xi/h) with xi the displacement of the step, so that momenta
    are conserved as by the leapfrog (Marsden, West, Acta Numerica 10:357, 2001). Newton-Krylov
    iteration (scipy's ``newton_krylov``) finds the displacement, with some tens of evaluations of the
    potential a step.
    """

    reversible: ClassVar[bool] = True

    # Error of the equation for the velocities, relative to the largest velocity, or to ``LEAST`` a step if
    # that is more. If rounding leaves less, relative to a radian in a step.
    tolerance: float = 1e-10

    def __post_init__(self) -> None:
        check_fields(self, tolerance=TOLERANCE)

    def step(self, system: Equations, at: Phase, time_step: float) -> Phase:
        """Advance by one time step.

        Raises
        ------
        StepTooLargeError
            If Newton's method does not converge.
        MechanicsError
            If hinges are driven.
        """
        system = canonical(system, "midpoint rule")
        tree, h = system.tree, time_step

        def middle(qd: Floats) -> tuple[Articulated, Floats, Floats | None]:
            """Factors, torques and loads at the midpoint of a step with these velocities."""
            q = multibody.integrate(tree, at.q, 0.5 * h * qd)
            factors = system.factors(q)
            _, torque, loads = system.forces(at.time + 0.5 * h, q, qd, factors)
            return factors, torque, loads

        def end(qd: Floats, factors: Articulated, torque: Floats, sign: float) -> Floats:
            """Momenta at the start (1) or the end (-1) of a step with these velocities."""
            p = np.empty(tree.n_v)
            mu, gradient = momenta(tree, factors.frames, qd)
            put_end_momenta(tree.links, sign * h, qd, mu, torque + gradient, p)
            return p

        guess = (at.qd + 0.5 * h * solve(at.factors, at.torque)) / tree.units
        # In radians and sizes of the tree.
        size = max(LEAST / abs(h), float(np.max(np.abs(at.qd) / tree.units)))

        def lack(scaled: Floats) -> Floats:
            qd = tree.units * scaled
            factors, torque, _ = middle(qd)
            return np.asarray(solve(at.factors, end(qd, factors, torque, 1.0) - at.p) / tree.units)

        try:
            scaled = _root(lack, guess, self.tolerance * max(1.0 / abs(h), size), 50)
        except (NoConvergence, ValueError):
            raise StepTooLargeError("Newton's method finds no velocities for the time step") from None
        if float(np.max(np.abs(lack(scaled)), initial=0.0)) > self.tolerance * size:
            # Closer, unless stiffness leaves no digits for it.
            with suppress(NoConvergence, ValueError):
                scaled = _root(lack, scaled, self.tolerance * size, 3)
        qd = tree.units * scaled
        factors, torque, loads = middle(qd)
        q = multibody.integrate(tree, at.q, h * qd)
        work = at.work if loads is None else at.work + h * (loads @ qd)
        p = end(qd, factors, torque, -1.0)
        return system.arrive(q, p, system.factors(q), at.time + h, work)


def _root(function: Callable[[Floats], Floats], guess: Floats, tolerance: float, iterations: int) -> Floats:
    """Zero of a function (n,) of (n,), by Newton-Krylov iteration."""
    find: Any = newton_krylov
    identity = LinearOperator((len(guess), len(guess)), matvec=lambda x: x)
    root: Floats = find(
        function, guess, f_tol=tolerance, maxiter=iterations, inner_M=identity, method="gmres"
    )
    return root
