"""OpenMM's own minimiser, as the reference: all atoms free, Cartesian L-BFGS."""

from collections.abc import Callable

import numpy as np
import openmm

from protochain.arrays import Floats
from protochain.energies import Energy, OpenMMEnergy
from protochain.interrupts import held_interrupts
from protochain.minimisers.loop import Stop


class _Enough(Exception):
    """Raised through OpenMM, which has no other way out of a line search."""


class _Reporter(openmm.MinimizationReporter):
    """Records each iteration; stops at the budget or on an interrupt."""

    def __init__(
        self, record: Callable[[Floats, float, int], None], budget: int, interrupts: list[int]
    ) -> None:
        super().__init__()
        self.record, self.budget, self.interrupts = record, budget, interrupts
        self.n_iterations = 0
        self.n_evaluations = 0
        self.stop = Stop.NO_DESCENT
        self.best = np.inf
        self.best_x: Floats | None = None

    def count(self, state: openmm.State) -> tuple[float, Floats]:
        """Count an evaluation of the forces (a PythonForce that exerts none)."""
        if self.n_evaluations >= self.budget:
            self.stop = Stop.BUDGET
        if self.interrupts:
            self.stop = Stop.INTERRUPTED
        if self.stop is not Stop.NO_DESCENT:
            raise _Enough
        self.n_evaluations += 1
        return 0.0, np.zeros((1, 3))

    def report(self, iteration: int, x: list[float], grad: list[float], args: dict[str, float]) -> bool:
        try:
            self.n_iterations += 1
            energy, positions = args["system energy"], np.array(x).reshape(-1, 3)
            if energy < self.best:
                self.best, self.best_x = energy, positions
            self.record(positions, energy, self.n_evaluations)
        except KeyboardInterrupt:
            self.stop = Stop.INTERRUPTED
        return self.stop is not Stop.NO_DESCENT


def local_energy_minimizer(
    energy: Energy,
    platform: str,
    x: Floats,
    tolerance: float,
    max_evaluations: int,
    record: Callable[[Floats, float, int], None],
) -> tuple[Stop, Floats, int, int]:
    """Run ``openmm.LocalEnergyMinimizer``, watching it.

    Parameters
    ----------
    energy : Energy
        Its System and threads are used.
    platform : str
        ``CPU`` (single precision) or ``Reference`` (double).
    x : (na, 3) float, nm
    tolerance : float, kJ/mol/nm
        RMS force at which it stops. It returns nothing, and in single precision it also stops, silently,
        when its line search finds no lower energy.
    max_evaluations : int
        Kept to the last: a line search is broken off.
    record : callable
        Called with positions, energy and evaluations so far after each iteration.

    Returns
    -------
    Stop, (na, 3) float, int, int
        Why it ended, the positions of lowest energy, iterations, evaluations of the forces.
    """
    with held_interrupts() as interrupts:
        reporter = _Reporter(record, max_evaluations, interrupts)
        _minimise(energy, platform, x, tolerance, reporter)
    best = x if reporter.best_x is None else reporter.best_x
    return reporter.stop, best, reporter.n_iterations, reporter.n_evaluations


def _minimise(energy: Energy, platform: str, x: Floats, tolerance: float, reporter: _Reporter) -> None:
    counted = OpenMMEnergy(energy.system, platform, energy.threads)
    counter = openmm.PythonForce(reporter.count)
    counter.setParticles([0])
    counted.system.addForce(counter)
    context = counted.make_context(counted.system)
    context.setPositions(np.asarray(x))
    try:
        openmm.LocalEnergyMinimizer.minimize(context, tolerance, 0, reporter)
    except (openmm.OpenMMException, _Enough):
        if reporter.stop is Stop.NO_DESCENT:
            reporter.stop = Stop.NON_FINITE
