"""OpenMM's own minimiser, as the reference: all atoms free, Cartesian L-BFGS."""

import copy
from collections.abc import Callable
from functools import partial

import numpy as np
import openmm

from protochain.chains.chain import Chain
from protochain.core.arrays import Floats
from protochain.core.interrupts import held_interrupts
from protochain.core.timings import part
from protochain.energies import Energy, OpenMMEnergy, constrain_hydrogens
from protochain.minimisers.loop import Stop
from protochain.minimisers.recipes import Recipe
from protochain.minimisers.spaces import spaces
from protochain.minimisers.stages import SINGLE_PRECISION_ENDS, Outcome

Record = Callable[[Floats, float, int, Floats], None]
"""Called with positions, energy, evaluations so far and forces after each iteration."""
_SETTLED = 100.0
"""kJ/mol/nm. RMS force below which OpenMM's dynamics start, as remaining strain would become heat."""
_MD_STEPS, _MD_FRAME = 1000, 20


@part("loop")
def minimise_by_openmm(
    recipe: Recipe, chain: Chain, energy: Energy, tolerance: float, max_evaluations: int, seed: int,
    record: Record,
) -> Outcome:  # fmt: skip
    """Minimise by OpenMM's own minimiser, after its dynamics if the recipe draws random numbers."""
    # It continues on the Reference platform if single precision fails. The result is the structure of lowest
    # energy among those minimised before the dynamics and at the end.
    x = chain.structure.positions
    n_iterations, n_evaluations, stop, relaxed = 0, 1, Stop.BUDGET, x
    value, forces = energy(x)
    record(x, value, 1, forces)

    def outcome(x: Floats) -> Outcome:
        atoms = spaces(chain)[1]
        return Outcome(stop, atoms, atoms.start(x), n_iterations, n_evaluations)

    def note(x: Floats, value: float, evaluations: int, forces: Floats, before: int) -> None:
        record(x, value, before + evaluations, forces)

    if np.isnan(value):
        stop = Stop.NON_FINITE
        return outcome(x)
    # Dynamics, after a short minimisation.
    if recipe.draws_random:
        settle = partial(local_energy_minimizer, tolerance=_SETTLED)
        for part in (settle, partial(langevin_dynamics, seed=seed)):
            budget = max_evaluations - n_evaluations
            if budget < 1:
                break
            recorder = partial(note, before=n_evaluations)
            stop, x, iterations, evaluations = part(energy, "CPU", x, max_evaluations=budget, record=recorder)
            n_iterations += iterations
            n_evaluations += evaluations
            relaxed = x if part is settle else relaxed
            if stop is Stop.INTERRUPTED:
                return outcome(relaxed)
    # Minimisation, in double precision if single precision does not converge.
    for platform in ("CPU", "Reference"):
        if n_evaluations >= max_evaluations:
            stop = Stop.BUDGET
            break
        recorder = partial(note, before=n_evaluations)
        stop, x, iterations, evaluations = local_energy_minimizer(
            energy, platform, x, tolerance, max_evaluations - n_evaluations, recorder
        )
        n_iterations += iterations
        n_evaluations += evaluations
        _, forces = energy.reference(x)
        rms_force = np.sqrt(np.mean(forces[chain.moving] ** 2))
        if stop not in SINGLE_PRECISION_ENDS or rms_force <= tolerance:
            break
    # Dynamics not followed by a complete minimisation leaves a hot structure.
    return outcome(min(x, relaxed, key=lambda y: energy(y)[0]))


class _StopMinimisation(Exception):
    """Raised through OpenMM to stop a line search."""


class _Reporter(openmm.MinimizationReporter):
    """Record each iteration, and stop at the budget or on an interrupt."""

    def __init__(self, record: Record, budget: int, interrupts: list[int]) -> None:
        super().__init__()
        self.record, self.budget, self.interrupts = record, budget, interrupts
        self.n_iterations = 0
        self.n_evaluations = 0
        self.stop = Stop.NO_DESCENT
        self.best = np.inf
        self.best_x: Floats | None = None

    def count(self, state: openmm.State) -> tuple[float, Floats]:
        """Count an evaluation of the forces, as a PythonForce of zero."""
        if self.n_evaluations >= self.budget:
            self.stop = Stop.BUDGET
        if self.interrupts:
            self.stop = Stop.INTERRUPTED
        if self.stop is not Stop.NO_DESCENT:
            raise _StopMinimisation
        self.n_evaluations += 1
        return 0.0, np.zeros((1, 3))

    def report(self, iteration: int, x: list[float], grad: list[float], args: dict[str, float]) -> bool:
        try:
            self.n_iterations += 1
            energy, positions = args["system energy"], np.array(x).reshape(-1, 3)
            if energy < self.best:
                self.best, self.best_x = energy, positions
            self.record(positions, energy, self.n_evaluations, -np.array(grad).reshape(-1, 3))
        except KeyboardInterrupt:
            self.stop = Stop.INTERRUPTED
        return self.stop is not Stop.NO_DESCENT


def local_energy_minimizer(
    energy: Energy, platform: str, x: Floats, tolerance: float, max_evaluations: int, record: Record
) -> tuple[Stop, Floats, int, int]:
    """Run ``openmm.LocalEnergyMinimizer``, recorded and with a budget: x (na, 3) nm, tolerance kJ/mol/nm."""
    with held_interrupts() as interrupts:
        reporter = _Reporter(record, max_evaluations, interrupts)
        counter = openmm.PythonForce(reporter.count)
        counter.setParticles([0])
        counted = OpenMMEnergy(copy.deepcopy(energy.system), platform, energy.threads)
        counted.system.addForce(counter)
        context = counted.make_context(counted.system)
        context.setPositions(np.asarray(x))
        try:
            openmm.LocalEnergyMinimizer.minimize(context, tolerance, 0, reporter)
        except (openmm.OpenMMException, _StopMinimisation):
            if reporter.stop is Stop.NO_DESCENT:
                reporter.stop = Stop.NON_FINITE
    best = x if reporter.best_x is None else reporter.best_x
    return reporter.stop, best, reporter.n_iterations, reporter.n_evaluations


def langevin_dynamics(
    energy: Energy, platform: str, x: Floats, max_evaluations: int, record: Record, seed: int
) -> tuple[Stop, Floats, int, int]:
    """Run OpenMM's constrained dynamics: 300 K, 2 fs, bonds to hydrogens at the force field's lengths."""
    # Arguments and results are as in :func:`local_energy_minimizer`, but it ends at its last positions. Each
    # step is one iteration and one evaluation of the forces.
    simulated = OpenMMEnergy(copy.deepcopy(energy.system), platform, energy.threads)
    constrain_hydrogens(simulated.system)
    integrator = openmm.LangevinMiddleIntegrator(300.0, 1.0, 0.002)
    integrator.setRandomNumberSeed(seed + 1)
    context = simulated.make_context(simulated.system, integrator)
    context.setPositions(np.asarray(x))
    n_steps, steps_done = min(_MD_STEPS, max_evaluations), 0
    with held_interrupts() as interrupts:
        try:
            context.applyConstraints(1e-6)
            context.setVelocitiesToTemperature(300.0, seed + 1)
            while steps_done < n_steps and not interrupts:
                n_block = min(_MD_FRAME, n_steps - steps_done)
                integrator.step(n_block)
                steps_done += n_block
                state = context.getState(positions=True, energy=True, forces=True)
                positions = np.asarray(state.getPositions(asNumpy=True)._value, dtype=np.float64)
                if not np.isfinite(positions).all():
                    return Stop.NON_FINITE, x, steps_done, steps_done
                x = positions
                forces = np.asarray(state.getForces(asNumpy=True)._value, dtype=np.float64)
                record(x, state.getPotentialEnergy()._value, steps_done, forces)
        except openmm.OpenMMException:
            return Stop.NON_FINITE, x, steps_done, steps_done
        except KeyboardInterrupt:
            return Stop.INTERRUPTED, x, steps_done, steps_done
    return Stop.INTERRUPTED if interrupts else Stop.NO_DESCENT, x, steps_done, steps_done
