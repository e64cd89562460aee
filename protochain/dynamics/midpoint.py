"""Implicit midpoint rule in the coordinates of a tree: stable for stiff springs."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from scipy.optimize import NoConvergence, newton_krylov
from scipy.sparse.linalg import LinearOperator

from protochain import multibody
from protochain.arrays import Floats
from protochain.dynamics.leapfrog import put_end_momenta
from protochain.dynamics.system import Integrator, Phase, StepTooLargeError, System
from protochain.multibody.articulated import solve
from protochain.multibody.hamilton import momenta


@dataclass(frozen=True)
class ImplicitMidpoint(Integrator):
    """Implicit midpoint rule: reversible and symplectic, of order two, with the potential at the midpoint.

    The discrete Lagrangian is h L(exp(xi/2) q, xi/h) with xi the displacement of the step, so that momenta
    are conserved as by the leapfrog (Marsden, West, Acta Numerica 10:357, 2001). Newton-Krylov
    iteration (scipy's ``newton_krylov``) finds the displacement, with some tens of evaluations of the
    potential a step.

    Parameters
    ----------
    tolerance : float
        Error of the equation for the velocities, relative to the largest velocity.
    """

    reversible: ClassVar[bool] = True

    tolerance: float = 1e-10

    def step(self, system: System, at: Phase, time_step: float) -> Phase:
        """Advance by one time step.

        Raises
        ------
        StepTooLargeError
            If Newton's method does not converge.
        """
        tree, h = system.tree, time_step

        def end(qd: Floats, sign: float) -> Floats:
            """Momenta at the start (1) or the end (-1) of a step with these velocities."""
            q = multibody.integrate(tree, at.q, 0.5 * h * qd)
            factors, p = system.factors(q), np.empty(tree.n_v)
            _, torque = system.potential(q, factors)
            mu, gradient = momenta(tree, factors.frames, qd)
            put_end_momenta(tree.links, sign * h, qd, mu, torque + gradient, p)
            return p

        size = max(1.0, float(np.max(np.abs(at.qd))))
        guess = at.qd + 0.5 * h * solve(at.factors, at.torque)
        identity = LinearOperator((tree.n_v, tree.n_v), matvec=lambda x: x)
        try:
            solve_it: Any = newton_krylov
            qd: Floats = solve_it(
                lambda qd: solve(at.factors, end(qd, 1.0) - at.p),
                guess,
                f_tol=self.tolerance * size,
                maxiter=50,
                inner_M=identity,
                method="gmres",
            )
        except (NoConvergence, ValueError):
            raise StepTooLargeError(
                f"Newton's method finds no velocities for a time step of {1000 * abs(h):g} fs"
            ) from None
        q = multibody.integrate(tree, at.q, h * qd)
        return system.kick(q, end(qd, -1.0), system.factors(q), 0.0)
