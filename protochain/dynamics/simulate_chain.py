"""``simulate``: constrained dynamics of a chain, from settings to output files and a result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from protochain.chains.articulate import run_identity, transfer_coordinates, with_energy, with_free_root
from protochain.chains.chain import Chain, place_atoms
from protochain.chains.frame import Frame, frame_of
from protochain.chains.restraint_list import Restraints
from protochain.core import defaults
from protochain.core.arrays import Floats, Watcher, finite
from protochain.core.checks import WATCHER, check_arguments, optional, path
from protochain.core.errors import Argument, ProtochainError
from protochain.core.interrupts import held_interrupts
from protochain.core.markup import abridge
from protochain.core.processors import one_blas_thread
from protochain.core.settings import document_settings, settings_from
from protochain.core.storage import claim_folder, json_text, write_text
from protochain.core.units import MOLAR_GAS
from protochain.dynamics.closure import Closure, closure_of
from protochain.dynamics.folder import Folder, check_folder, constants_of, rescue_on_failure
from protochain.dynamics.hinge_springs import HingeSprings, dampers, hinge_springs, hinges_of
from protochain.dynamics.integrators import INTEGRATORS
from protochain.dynamics.loop import Ending, Propagator, State, advance, initial
from protochain.dynamics.loop import run as propagate
from protochain.dynamics.potential import chain_potential, fixman
from protochain.dynamics.pulling import MovingSpring, check_pull, moving_spring, refuse_fixed
from protochain.dynamics.simulate_settings import HingeSpring, Pull, RunSettings, SimulationSettings
from protochain.dynamics.simulation import Simulation, describe_outcome
from protochain.dynamics.thermostats import THERMOSTATS, build_thermostat
from protochain.energies import Energy
from protochain.energies.custom import EnergyFunction
from protochain.mechanics.motion.system import Potential, StepTooLargeError, System, total
from protochain.mechanics.multibody import HingeKind
from protochain.structure.molecule.chirality import changed_stereocentres
from protochain.structure.superpose import rmsd_angstrom
from protochain.structure.write import common_suffix


@document_settings(SimulationSettings, RunSettings)
@check_arguments(output=optional(path), watch=WATCHER)
def simulate(
    chain: Any,
    energy: Energy | EnergyFunction | None = None,
    q: Floats | None = None,
    temperature: float = defaults.TEMPERATURE,
    time_step: float = defaults.TIME_STEP,
    n_steps: int = defaults.N_STEPS,
    thermostat: str = defaults.THERMOSTAT,
    seed: int = defaults.SEED,
    *,
    friction: float = defaults.FRICTION,
    integrator: str = defaults.INTEGRATOR,
    fixman: bool = False,
    loops: str = defaults.LOOPS,
    hydrogen_mass: float | None = None,
    trajectory_length: int = defaults.TRAJECTORY_LENGTH,
    every: int = defaults.EVERY,
    output: str | Path | None = None,
    trajectory: str = defaults.TRAJECTORY,
    checkpoint_every: int = defaults.CHECKPOINT_EVERY,
    resume: bool = False,
    force: bool = False,
    watch: Watcher | None = None,
    pull: Pull | str | None = None,
    hinge_springs: HingeSpring | str | Sequence[HingeSpring | str] = (),
    restraints: Any = (),
    superpose: bool = True,
) -> Simulation:
    """Simulate a chain of rigid bodies at constant energy or temperature.

    Parameters
    ----------
    chain : Chain, Structure, path, or anything that :func:`protochain.as_structure` accepts
        Chain to simulate. Files are loaded, and structures are divided into rigid bodies with the default
        hinges, results with their own hinges. A root that ``auto`` has fixed is freed.
    energy : Energy or callable, optional
        As in :func:`protochain.minimise`.
    q : (n_q,) float, optional
        Initial coordinates of the given chain. Default: its input pose. Minimise first: strain becomes heat.
    output : path-like, optional
        Folder for the trajectory, ``log.csv``, ``last.pdb``, ``checkpoint.npz`` and ``summary.json``.
    watch : callable, optional
        Called with every row of the log and its positions, as written.

    Returns
    -------
    Simulation
        Final state, log and outcome.

    Raises
    ------
    ProtochainError
        If a setting is unknown or out of range, or the input or the folder cannot be used.

    Examples
    --------
    >>> c = pc.build_chain(pc.from_sequence("GAG"))
    >>> m = pc.simulate(c, n_steps=20, seed=1)
    >>> str(m.ending), len(m.q)
    ('completed', 12)
    """
    arguments = locals()
    settings, running = settings_from(SimulationSettings, arguments), settings_from(RunSettings, arguments)
    path = None if output is None else Path(output)
    if path is not None:
        check_folder(path, trajectory, running.resume, running.force)
    elif running.resume:
        raise ProtochainError(Argument("resume", True), ": give the folder of the simulation as output")
    chain, energy = with_energy(chain, energy)
    with nullcontext() if path is None else claim_folder(path, "simulation", running.resume):
        # A resumed run has the loops of its original start, not of this q.
        run = _prepare(chain, energy, q, settings, constants_of(path) if resume and path else {})
        folder = None if path is None else Folder(path, trajectory, run.identity, run.constants)
        with one_blas_thread(), rescue_on_failure(folder):
            return _simulate(run, folder, running, watch)


@dataclass(frozen=True, eq=False)
class _Run:
    """Chain, energy (with and without terms that are constant in rigid bodies), start and propagator."""

    chain: Chain
    energy: Energy
    varying: Energy
    q: Floats
    settings: SimulationSettings
    propagator: Propagator
    closure: Closure | None
    freedoms: int
    pull: MovingSpring | None
    springs: HingeSprings | None
    held_by: str  # Outside object that fixes the molecule in space, or empty.
    biases: Mapping[str, Potential]
    """Potentials in addition to the force field, by column of the log, and a pull of speed 0."""

    @property
    def constants(self) -> dict[str, Floats]:
        """Constants that the run measures at its start, by names of ``folder.CONSTANTS``."""
        arrays = {
            "loop_lengths": None if self.closure is None else self.closure.length,
            "pull_start": None if self.pull is None else np.array([self.pull.start]),
            "hinge_rest": None if self.springs is None else self.springs.rest_values,
        }
        return {name: values for name, values in arrays.items() if values is not None}

    @property
    def identity(self) -> dict[str, Any]:
        """Settings and input that a run must share to resume from the checkpoint."""
        return {**self.settings.record(), **run_identity(self.chain, self.energy)}

    def frame(self, origin: Floats) -> Frame:
        """Frame of output positions: the start (na, 3), superposed on the input."""
        on_input = Frame(self.chain.structure, self.held_by, self.settings.superpose)
        return replace(on_input, start=self.chain.structure.with_positions(on_input(origin)))

    def row(self, state: State, start: Floats) -> tuple[dict[str, float], Floats]:
        """Row of the log, and positions in the frame of the run. RMSDs are relative to ``start``."""
        s, at = self.settings, state.at
        x = place_atoms(self.chain, at.factors.frames)
        biases = {name: energy(at.q, at.factors)[0] for name, energy in self.biases.items()}
        bias = sum(biases.values())
        alpha = self.chain.structure.alpha_carbons
        row: dict[str, float] = {
            "step": state.step,
            "time_ps": state.step * s.time_step,
            "kinetic_kj_mol": at.kinetic,
            "potential_kj_mol": at.potential - bias,
            "total_kj_mol": at.total - bias,
            "conserved_kj_mol": state.conserved_energy,
            "temperature_k": 2.0 * at.kinetic / (self.freedoms * MOLAR_GAS),
            "ca_rmsd_angstrom": rmsd_angstrom(x[alpha], start[alpha]),
        }
        row |= {name: value for name, value in biases.items() if name != "pull"}
        if self.propagator.dampers is not None:
            row["dampers_kj_mol"] = state.damped
        if self.closure is not None:
            row["closure_error_nm"] = float(np.max(np.abs(self.closure.errors(at.factors.frames))))
        if self.pull is not None:
            row |= self.pull.row(at)
        return row, x


def prepare_chain(chain: Chain, settings: SimulationSettings) -> Chain:
    """Prepare a chain for simulation: free a root that ``auto`` has fixed, and set hydrogen masses."""
    simulated = with_free_root(chain, settings.hydrogen_mass)
    if settings.pull is not None:
        check_pull(settings.pull, simulated)
    for spring in settings.hinge_springs:
        hinges_of(spring, simulated)
    return simulated


def _prepare(
    original: Chain, energy: Energy, q: Floats | None, settings: SimulationSettings,
    constants: Mapping[str, Floats],
) -> _Run:  # fmt: skip
    """Free the root, repartition hydrogen masses, and set up potential, constraints and propagator."""
    # A resumed run has the constants from its start, which may differ from those at q.
    coordinates = original.q0 if q is None else finite(q, (original.n_q,), "q")
    chain = prepare_chain(original, settings)
    varying = energy.without_constants(chain.rigid_groups, chain.structure.positions)
    start = transfer_coordinates(original, chain, coordinates)
    closure = closure_of(chain, start) if settings.loops == "closed" else None
    if closure is not None:
        closure = replace(closure, length=_constant(constants, "loop_lengths", closure.length))
    springs = hinge_springs(settings.hinge_springs, chain, start)
    if springs is not None:
        springs = replace(springs, rest_values=_constant(constants, "hinge_rest", springs.rest_values))
    pull = moving_spring(settings.pull, chain, start) if settings.pull is not None else None
    if pull is not None:
        pull = replace(pull, start=float(_constant(constants, "pull_start", np.array([pull.start]))[0]))
    # Potential: force field and biases.
    biases: dict[str, Potential] = {}
    if settings.fixman:
        biases["fixman_kj_mol"] = fixman(settings.thermal_energy, closure)
    if springs is not None:
        biases["hinge_springs_kj_mol"] = springs.potential
    if settings.restraints:
        restraints = Restraints.of(chain.structure, settings.restraints)
        biases["restraints_kj_mol"] = chain_potential(chain, restraints)
    if pull is not None and pull.speed == 0.0:
        biases["pull"] = pull.potential
    parts = [chain_potential(chain, varying), *biases.values()]
    loads = (pull.load(),) if pull is not None and pull.speed != 0.0 else ()
    system = System(chain.tree, parts[0] if len(parts) == 1 else total(parts), closure, loads=loads)
    if settings.pull is not None and pull is not None:
        refuse_fixed(settings.pull, pull, system, chain.structure, start)
    freedoms = chain.n_v - (0 if closure is None else len(closure.length))
    # Only a molecule that is not fixed from outside conserves its momentum, which can then be removed.
    held_by = frame_of(chain, energy, _holder(chain, settings)).held_by
    removes = not held_by and THERMOSTATS[settings.thermostat].conserves_momentum
    freedoms -= 6 if removes else 0
    noise = 0.0 if settings.thermostat == "none" else settings.thermal_energy
    kt = settings.thermal_energy
    propagator = Propagator(
        system, INTEGRATORS[settings.integrator], build_thermostat(settings.record(), kt, freedoms),
        settings.time_step, kt, settings.seed, removes, dampers(settings.hinge_springs, chain, noise),
    )  # fmt: skip
    return _Run(
        chain, energy, varying, start, settings, propagator, closure, freedoms, pull, springs, held_by, biases
    )


def _holder(chain: Chain, settings: SimulationSettings) -> str:
    """Roots or restraints that fix the molecule in space, or an empty text if it can move as one."""
    if any(restraint.is_external for restraint in settings.restraints):
        return "restraints of positions"
    is_free = np.all(chain.tree.kind[chain.tree.parent < 0] == HingeKind.FREE)
    return "" if is_free else "a fixed root"


def _constant(constants: Mapping[str, Floats], name: str, default: Floats) -> Floats:
    """Constant from the start of the run to be resumed, or the default if none has this shape."""
    # The checkpoint is then from another run, or damaged, which is reported when it is read.
    stored = constants.get(name)
    return default if stored is None or stored.shape != default.shape else stored


@held_interrupts()
def _simulate(run: _Run, folder: Folder | None, running: RunSettings, watch: Watcher | None) -> Simulation:
    """Run a simulation from its start or checkpoint, and write its files."""
    interval, structure = run.settings.every, run.chain.structure
    start, origin, rows = _start(run, folder, running.resume)
    frame = run.frame(origin)
    frames = list[Any]()

    def report(state: State) -> None:
        row, positions = run.row(state, origin)
        x = frame(positions)
        rows.append(row)
        if folder is None:
            frames.append(x.astype(np.float32))
        else:
            folder.append(row, x)
            if state.step and state.step % (interval * running.checkpoint_every) == 0:
                folder.store(state, run.varying.lists_at)
        if watch:
            watch(row, x)

    if not running.resume:
        report(start)
    with suppress(StepTooLargeError):
        # Compile or load the kernels before the clock starts.
        advance(run.propagator, start)
    began = perf_counter()
    state, ending, reason = propagate(run.propagator, start, running.n_steps, interval, report)
    seconds = perf_counter() - began
    end = place_atoms(run.chain, state.at.factors.frames)
    inverted = changed_stereocentres(structure, end, structure.positions)
    if inverted and ending is not Ending.UNSTABLE:
        ending, reason = Ending.UNSTABLE, f"{abridge(inverted)} inverted"
    # Final checkpoint, result and summary.
    if folder:
        folder.store(state, run.varying.lists_at)
        folder.close(ending is not Ending.UNSTABLE)
    result = Simulation(
        chain=run.chain, energy_function=run.energy, settings=run.settings, freedoms=run.freedoms,
        state=state, ending=ending,
        message=describe_outcome(ending, reason, state.step, run.settings, structure, origin),
        rows=tuple(rows), last=run.row(state, origin)[0], n_steps=state.step - start.step,
        seconds=seconds, frame=frame, stored_frames=tuple(frames),
        trajectory=None if folder is None else folder.trajectory,
    )  # fmt: skip
    if folder:
        summary = folder.path / "summary.json"
        if result.n_steps or not summary.exists():  # Of the run that made the steps.
            write_text(summary, json_text(result.record()))
        if result.is_sound:
            result.save(folder.path / f"last{common_suffix([structure])}")
    return result


def _start(run: _Run, folder: Folder | None, resume: bool) -> tuple[State, Floats, list[dict[str, float]]]:
    """First state, positions (na, 3) at step 0, and rows so far. Files are created or reopened."""
    interval = run.settings.every * run.settings.time_step

    def columns(state: State, origin: Floats) -> list[str]:
        return list(run.row(state, origin)[0])

    if folder and resume:
        first = run.propagator.thermostat.init
        state, rows, lists_at = folder.resume(run.chain.tree, run.chain.structure, interval, first, columns)
        if len(lists_at):
            run.varying.list_at(lists_at)
        return state, folder.start, rows
    state = initial(run.propagator, run.q)
    origin = place_atoms(run.chain, state.at.factors.frames)
    if folder:
        folder.open(run.chain.structure, origin, interval, columns(state, origin))
    return state, origin, []
