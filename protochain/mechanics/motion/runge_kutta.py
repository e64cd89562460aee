"""Explicit Runge-Kutta methods for trees: high-order references, not for long runs (the energy drifts)."""

from dataclasses import dataclass
from functools import partial
from typing import ClassVar

from protochain.core.checks import check_fields
from protochain.core.settings import document_fields
from protochain.mechanics.motion.substeps import TOLERANCE, in_substeps
from protochain.mechanics.motion.system import Equations, Integrator, Phase
from protochain.mechanics.tableaux import CLASSICAL, DORMAND_PRINCE, Tableau


@dataclass(frozen=True)
class RungeKutta4(Integrator):
    """Classical Runge-Kutta method of order four. Free roots follow the exponential map.

    Munthe-Kaas, BIT 38:92 (1998): the displacement of a root within the step is integrated, so that
    quaternions have unit length.
    """

    tableau: ClassVar[Tableau] = CLASSICAL
    order: ClassVar[int] = 4

    @property
    def remedy(self) -> str:
        """Remedy for a time step that is too long."""
        return "use a shorter one, DormandPrince(), or for stiff dampers Rosenbrock()"

    def step(self, system: Equations, at: Phase, time_step: float) -> Phase:
        """Advance by one time step, with four evaluations of the potential."""
        return system.advance(self.tableau, at, time_step)[0]


@document_fields
@dataclass(frozen=True)
class DormandPrince(Integrator):
    """Runge-Kutta method of order five with adaptive substeps."""

    tableau: ClassVar[Tableau] = DORMAND_PRINCE
    order: ClassVar[int] = 5

    # Error of a coordinate, or of a velocity times the time step, in radians and sizes of the tree.
    tolerance: float = 1e-8

    def __post_init__(self) -> None:
        check_fields(self, tolerance=TOLERANCE)

    @property
    def remedy(self) -> str:
        """Remedy for a time step that is too long."""
        return f"use DormandPrince({self.tolerance / 100:.1g}), or for stiff dampers Rosenbrock()"

    def step(self, system: Equations, at: Phase, time_step: float) -> Phase:
        """Advance by one time step, in as many substeps as the tolerance requires.

        Raises
        ------
        StepTooLargeError
            If a substep would have to be shorter than rounding allows.
        """
        substep = partial(system.advance, self.tableau)
        return in_substeps(substep, system, at, time_step, self.tolerance, self.order)
