"""``simulate``: constrained dynamics of a chain, from names and numbers to files and a result."""

import hashlib
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from protochain import defaults
from protochain.arrays import Floats, floats
from protochain.articulate import as_chain, build_chain
from protochain.chain import Chain, place_atoms, rigid_groups
from protochain.dynamics.closure import Closure, closure_of
from protochain.dynamics.fixman import fixman
from protochain.dynamics.folder import Folder, check_folder
from protochain.dynamics.loop import Course, Ending, Moment, advance, initial, run
from protochain.dynamics.overall import can_drift
from protochain.dynamics.settings import Settings, integrator, thermostat
from protochain.dynamics.simulation import Simulation
from protochain.dynamics.system import StepTooLargeError, System, chain_potential, total
from protochain.energies.factory import energy as build_energy
from protochain.energies.protocol import Energy, check_is_of
from protochain.errors import ProtochainError
from protochain.interrupts import held_interrupts
from protochain.multibody import HingeKind, articulated
from protochain.structure.superpose import rmsd_angstrom
from protochain.units import MOLAR_GAS

Watcher = Callable[[Mapping[str, float], Floats], None]
"""Called with each row of the log and the positions it is about."""


def simulate(
    chain: Any,
    energy: Energy | None = None,
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
) -> Simulation:
    """Simulate a chain of rigid bodies at constant energy or temperature.

    Parameters
    ----------
    chain : Chain, Structure, path, or anything that :func:`protochain.as_structure` takes
        A file is loaded, a structure cut into a chain with the default hinges. A root that ``auto`` fixed is
        freed.
    energy : Energy, optional
        ff14SB with OBC2 by default.
    q : (n_q,) float, optional
        Where to begin, in the coordinates of the chain as it is given; its input pose by default. Begin from
        a minimum: a strained start is hot.
    temperature : float, K
        Of the thermostat, and of the first velocities.
    time_step : float, ps
    n_steps : int
        In all: a run that is resumed goes on up to this many.
    thermostat : str
        ``langevin``, ``nose-hoover``, ``rescale``, ``hmc`` (hybrid Monte Carlo) or ``none``.
    seed : int
        The same seed gives the same trajectory.
    friction : float, 1/ps
        How tightly the thermostat holds.
    integrator : str
        ``leapfrog`` (reversible, one energy a step), ``lobatto`` (as good for short chains), ``midpoint``
        (implicit, for stiff springs), ``rk4`` or ``dormand-prince`` (references).
    fixman : bool
        Add Fixman's potential, which undoes the bias of rigid bonds and angles.
    loops : str
        Disulfides and other bonds at which the tree was cut: ``open`` leaves them to the force field,
        ``closed`` keeps their length and angles by constraints.
    hydrogen_mass : float, optional, amu
        As in :func:`protochain.build_chain`.
    trajectory_length : int
        Steps a trajectory of hybrid Monte Carlo.
    every : int
        Steps between rows of the log and frames.
    output : path-like, optional
        Folder for the trajectory, ``log.csv``, ``last.pdb``, ``checkpoint.npz`` and ``summary.json``.
    trajectory : str
        ``dcd`` or ``xtc``.
    checkpoint_every : int
        Rows between checkpoints.
    resume : bool
        Go on with the simulation in the folder: as if it had not been stopped, bit for bit.
    force : bool
        Replace a simulation that is in the folder.
    watch : callable, optional
        Called with every row and its positions.

    Returns
    -------
    Simulation

    Raises
    ------
    ProtochainError
        If a name is unknown, a number makes no sense, or the input or the folder cannot be used.
    """
    settings = Settings(
        temperature, time_step, thermostat, friction, integrator, fixman, loops, hydrogen_mass,
        trajectory_length, every, seed,
    )  # fmt: skip
    settings.check(n_steps, checkpoint_every)
    if output is not None:
        check_folder(Path(output), trajectory, resume, force)
    elif resume:
        raise ProtochainError("resume: give the folder of the simulation as output")
    chain = as_chain(chain)
    if energy is None:
        energy = build_energy(chain.structure)
    check_is_of(energy, chain.structure)
    scene = _scene(chain, energy, q, settings)
    folder = Folder(Path(output), trajectory, scene.identity) if output is not None else None
    with threadpool_limits(1, "blas"):
        return _simulate(scene, folder, resume, n_steps, checkpoint_every, watch)


@dataclass(frozen=True, eq=False)
class _Scene:
    """What is simulated, and how."""

    chain: Chain
    energy: Energy
    moving: Energy
    q: Floats
    settings: Settings
    course: Course
    closure: Closure | None
    freedoms: int

    @property
    def identity(self) -> dict[str, Any]:
        """What a checkpoint belongs to."""
        return {
            **self.settings.record(),
            "hinges": self.chain.opened,
            "root": self.chain.root,
            "move": self.chain.move,
            "engine": self.energy.engine,
            "system": self.energy.fingerprint,
            "start": hashlib.sha256(self.chain.structure.positions.tobytes()).hexdigest(),
        }

    def row(self, now: Moment, start: Floats) -> tuple[dict[str, float], Floats]:
        """Row of the log, and positions."""
        s, at = self.settings, now.at
        x = place_atoms(self.chain, at.factors.frames)
        bias = 0.5 * s.thermal_energy * articulated.log_det(at.factors) if s.fixman else 0.0
        alpha = self.chain.structure.alpha_carbons
        row = {
            "step": now.step,
            "time_ps": now.step * s.time_step,
            "kinetic_kj_mol": at.kinetic,
            "potential_kj_mol": at.potential - bias,
            "total_kj_mol": at.total - bias,
            "conserved_kj_mol": now.conserved,
            "temperature_k": 2.0 * at.kinetic / (self.freedoms * MOLAR_GAS),
            "ca_rmsd_angstrom": rmsd_angstrom(x[alpha], start[alpha]),
        }
        if s.fixman:
            row["fixman_kj_mol"] = bias
        if self.closure is not None:
            row["closure_error_nm"] = float(np.max(np.abs(self.closure.errors(at.factors.frames))))
        return row, x


def _scene(chain: Chain, energy: Energy, q: Floats | None, settings: Settings) -> _Scene:
    """Free the root, make hydrogens heavy, and put the parts together."""
    given = chain.q0 if q is None else floats(q, (chain.n_q,), "q")
    root = "free" if chain.root == "auto" else chain.root
    mass = settings.hydrogen_mass if settings.hydrogen_mass is not None else chain.hydrogen_mass
    made = build_chain(chain.structure, chain.opened, root, move=chain.move, hydrogen_mass=mass)
    moving = energy.without_constants(rigid_groups(made), made.structure.positions)
    parts = [chain_potential(made, moving)]
    if settings.fixman:
        parts.append(fixman(settings.thermal_energy))
    closure = closure_of(made) if settings.loops == "closed" else None
    system = System(made.tree, parts[0] if len(parts) == 1 else total(parts), closure)
    stays = can_drift(made.tree) and settings.thermostat in ("none", "nose-hoover", "rescale")
    freedoms = made.n_v - (6 if stays else 0) - (0 if closure is None else len(closure.length))
    course = Course(
        system, integrator(settings), thermostat(settings, freedoms), settings.time_step,
        settings.thermal_energy, settings.seed, stays,
    )  # fmt: skip
    return _Scene(
        made, energy, moving, _carried_over(chain, made, given), settings, course, closure, freedoms
    )


def _carried_over(chain: Chain, made: Chain, q: Floats) -> Floats:
    """Coordinates of a chain in one with the same bodies, whose roots may have been freed."""
    start = made.q0.copy()
    old, new = chain.tree.q_start, made.tree.q_start
    start[new[made.hinge_body]] = q[old[chain.hinge_body]]
    for b in np.flatnonzero(chain.tree.kind == HingeKind.FREE):
        start[new[b] : new[b] + 7] = q[old[b] : old[b] + 7]
    return start


@held_interrupts()
def _simulate(
    scene: _Scene,
    folder: Folder | None,
    resume: bool,
    n_steps: int,
    checkpoint_every: int,
    watch: Watcher | None,
) -> Simulation:
    course, every = scene.course, scene.settings.every
    structure = scene.chain.structure
    rows: list[dict[str, float]] = []
    interval = every * scene.settings.time_step

    def report(now: Moment) -> None:
        row, x = scene.row(now, origin)
        rows.append(row)
        if folder:
            folder.append(row, x)
            if now.step and now.step % (every * checkpoint_every) == 0:
                folder.store(now, scene.moving.lists_at)
        if watch:
            watch(row, x)

    if folder and resume:
        start, rows[:], lists_at = folder.reopen(scene.chain.tree, structure, interval)
        origin = folder.start
        if len(lists_at):
            scene.moving.list_at(lists_at)
    else:
        start = initial(course, scene.q)
        origin = place_atoms(scene.chain, start.at.factors.frames)
        if folder:
            folder.open(structure, origin, interval, list(scene.row(start, origin)[0]))
        report(start)
    with suppress(StepTooLargeError):
        # Kernels are compiled, or loaded, off the clock.
        advance(course, start)
    began = perf_counter()
    now, ending, why = run(course, start, n_steps, every, report)
    seconds = perf_counter() - began
    if folder:
        folder.store(now, scene.moving.lists_at)
        folder.close(ending is not Ending.UNSTABLE)
    result = Simulation(
        chain=scene.chain,
        energy_function=scene.energy,
        settings=scene.settings,
        freedoms=scene.freedoms,
        now=now,
        ending=ending,
        message=_message(ending, why, now, scene.settings),
        rows=tuple(rows),
        n_steps=now.step - start.step,
        seconds=seconds,
    )
    if folder:
        folder.summarise(result.record())
        if result.is_sound:
            result.save(folder.last(structure))
    return result


def _message(ending: Ending, why: str, now: Moment, settings: Settings) -> str:
    done = f"{now.step} steps, {now.step * settings.time_step:g} ps"
    if ending is Ending.UNSTABLE:
        return (
            f"unstable after {done}: {why}; take a time step below {1000 * settings.time_step:g} fs, "
            "heavier hydrogens, or begin from a minimum"
        )
    return f"{ending}: {done}"
