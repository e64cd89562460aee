"""The implicit midpoint rule on the coordinates of a tree: stable where springs are stiff."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import NoConvergence, newton_krylov
from scipy.sparse.linalg import LinearOperator

from protochain import multibody
from protochain.arrays import Floats, Integers
from protochain.dynamics.system import Phase, StepTooLargeError, System
from protochain.multibody.algebra import kernel, put_at, scale, vector_at
from protochain.multibody.articulated import articulate, solve
from protochain.multibody.hamilton import momenta
from protochain.multibody.rotations import tangent, tangent_inverse
from protochain.multibody.tree import V


@dataclass(frozen=True)
class ImplicitMidpoint:
    """Reversible and symplectic, of order two, with the potential taken half-way.

    The discrete Lagrangian is h L(exp(xi/2) q, xi/h) with xi the displacement of the step, so that momenta
    are conserved as by the leapfrog (Marsden, West, Acta Numerica 10:357, 2001, section 2.6). Newton's method
    with Krylov subspaces (scipy's ``newton_krylov``) finds the displacement: some tens of evaluations of the
    potential a step.

    Parameters
    ----------
    tolerance : float
        Of the equation for the velocities, relative to the largest.
    """

    tolerance: float = 1e-10

    def init(self, system: System, q: Floats, qd: Floats) -> Phase:
        """Return the phase at q, moving with qd."""
        return system.at(q, qd)

    def step(self, system: System, at: Phase, time_step: float) -> Phase:
        """One step.

        Raises
        ------
        StepTooLargeError
            If Newton's method does not converge.
        """
        tree, h = system.tree, time_step

        def halfway(qd: Floats) -> tuple[Floats, Floats]:
            """Momenta of the velocity, and half of what the step pushes."""
            factors = articulate(tree, multibody.pose(tree, multibody.integrate(tree, at.q, 0.5 * h * qd)))
            _, torque = system.potential(multibody.integrate(tree, at.q, 0.5 * h * qd), factors)
            mu, gradient = momenta(tree, factors.frames, qd)
            return mu, 0.5 * h * (torque + gradient)

        def missing(qd: Floats) -> Floats:
            mu, push = halfway(qd)
            return solve(at.factors, _end(tree.links, h, qd, mu, -push, -1.0) - at.p)

        size = max(1.0, float(np.max(np.abs(at.qd))))
        guess = at.qd + 0.5 * h * solve(at.factors, at.torque)
        identity = LinearOperator((tree.n_v, tree.n_v), matvec=lambda x: x)
        try:
            solve_it: Any = newton_krylov
            qd: Floats = solve_it(
                missing, guess, f_tol=self.tolerance * size, maxiter=50, inner_M=identity, method="gmres"
            )
        except (NoConvergence, ValueError):
            raise StepTooLargeError(
                f"Newton's method finds no velocities for a time step of {1000 * abs(h):g} fs"
            ) from None
        mu, push = halfway(qd)
        p = _end(tree.links, h, qd, mu, push, 1.0)
        q = multibody.integrate(tree, at.q, h * qd)
        return system.from_factors(q, articulate(tree, multibody.pose(tree, q)), p=p)


@kernel
def _end(links: Integers, h: float, qd: Floats, mu: Floats, push: Floats, side: float) -> Floats:
    """Momenta at the end (side 1) or the start (side -1) of a step: dexp^-T (mu + dexp_half^T push)."""
    p = mu + push
    for b in range(len(links) - 1):
        k = links[b, V]
        if links[b + 1, V] - k == 6:
            # On rotations dexp of xi transposed is dexp of -xi.
            xi = scale(-side * h, vector_at(qd, k))
            push_k = tangent(scale(0.5, xi), vector_at(push, k))
            put_at(push_k, p, k)
            for i in range(3):
                p[k + i] += mu[k + i]
            put_at(tangent_inverse(xi, vector_at(p, k)), p, k)
    return p
