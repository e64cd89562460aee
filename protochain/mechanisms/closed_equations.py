"""Equations of motion of trees whose loops are closed by joints."""

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from protochain.core.arrays import Floats
from protochain.core.errors import Fault
from protochain.mechanics.motion.system import Equations, Phase, StepTooLargeError
from protochain.mechanics.multibody.articulated import Articulated, solve
from protochain.mechanics.multibody.kinematics import pull_back
from protochain.mechanisms.loop_joints import LoopJoints, factor_loops

CLOSED = 1e-12
"""Largest error of a loop after a step, in cosines and sizes of the tree: a thousand times rounding."""
ITERATIONS = 20


@dataclass(frozen=True, eq=False)
class ClosedEquations(Equations):
    """Forest of rigid bodies with loops, whose joints constrain accelerations, velocities and places.

    Parameters
    ----------
    tree : Tree
        Rigid bodies.
    potential : callable
        Energy and torques at q.
    loads, drive : tuple of Load, and callable, optional
        As of :class:`Equations`.
    joints : LoopJoints
        Joints that close the loops.

    Notes
    -----
    Accelerations are those without loops plus the effect of the joints' least forces (Gauss's principle). The
    projections after a step are smallest by the kinetic energy, so that neither lets the loops drift.
    """

    beyond: ClassVar[str] = "closed loops"

    joints: LoopJoints = field(kw_only=True)

    def prescribe(self, time: float, q: Floats, qd: Floats) -> tuple[Floats, Floats, Articulated]:
        """Coordinates, velocities and factors, with the loops closed.

        Raises
        ------
        StepTooLargeError
            If no coordinates nearby close them.
        """
        q, qd, factors = super().prescribe(time, q, qd)
        units = np.where(self.joints.turns, 1.0, self.tree.size)
        for _ in range(ITERATIONS):
            loops = factor_loops(factors, self.joints)
            gap = float(np.max(np.abs(loops.error) / units))
            if not gap > CLOSED:
                return q, qd - loops.change(loops.rates(qd)), factors
            q = self.integrate(q, -loops.change(loops.error))
            factors = self.factors(q)
        raise StepTooLargeError(f"a loop does not close: gap {gap:.2g} of its size", fault=Fault.OPEN)

    def constrain(self, qd: Floats, qdd: Floats, factors: Articulated) -> tuple[Floats, Floats]:
        """Accelerations (n_v,) with the loops closed, and the torques (n_v,) of their joints."""
        loops = factor_loops(factors, self.joints)
        impulses = loops.impulses(-self.joints.accelerations(self.tree, factors.frames, qd, qdd))
        torques = pull_back(self.tree, factors.frames, loops.wrenches(impulses))
        return qdd + solve(factors, torques), torques

    def with_velocities(self, at: Phase, qd: Floats) -> Phase:
        """Return the phase with other velocities, projected on the loops, except at driven hinges."""
        return self.at(at.q, qd, at.time, at.work)
