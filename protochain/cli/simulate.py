"""``protochain simulate``."""

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from protochain.cli.options import (
    CONVERGED,
    UNCONVERGED,
    AsJson,
    Input,
    check_outputs,
    fail,
    inputs_of,
    named_after,
    prepare,
    with_settings,
)
from protochain.cli.terminal import (
    TROUBLED,
    foretell,
    print_outlook,
    print_simulation,
    run_progress,
    simulation_progress,
    typical_evaluations,
)
from protochain.core import defaults
from protochain.core.errors import refused
from protochain.core.interrupts import held_interrupts
from protochain.setup import Setup

if TYPE_CHECKING:
    from protochain.chain import Chain
    from protochain.core.arrays import Floats
    from protochain.dynamics import Simulation
    from protochain.energies import Energy

_RELAXED = 10.0
"""kJ/mol/rad. Largest torque at the start: the strain that is left heats little."""

_SHORTEST = 0.015
"""fs. Less than a thousandth of any useful step: who gives it means picoseconds."""

Output = Annotated[
    Path | None, typer.Option("-o", "--output", metavar="DIR", help="Folder [default: NAME-simulation].")
]
Steps = Annotated[int, typer.Option(help="Total number of time steps.")]
TimeStep = Annotated[float, typer.Option(help="Time step, fs.")]
Temperature = Annotated[
    float, typer.Option(help="Temperature of the thermostat and of the initial velocities, K.")
]
Thermostat = Annotated[str, typer.Option(help="langevin, nose-hoover, rescale, hmc or none.")]
Friction = Annotated[float, typer.Option(help="Coupling of the thermostat, 1/ps.")]
Integrator = Annotated[str, typer.Option(help="leapfrog, lobatto, midpoint, rk4 or dormand-prince.")]
Fixman = Annotated[
    bool, typer.Option("--fixman", help="Add Fixman's potential, against the bias of rigid bonds and angles.")
]
Loops = Annotated[str, typer.Option(help="Disulfides: open (force field) or closed (constraints).")]
HydrogenMass = Annotated[
    float | None, typer.Option(help="Mass of hydrogens, taken from the atoms they are bonded to, amu.")
]
TrajectoryLength = Annotated[int, typer.Option(help="Steps in each trajectory of hmc.")]
Every = Annotated[int, typer.Option(help="Steps between frames and rows of the log.")]
Trajectory = Annotated[str, typer.Option(help="dcd or xtc.")]
CheckpointEvery = Annotated[int, typer.Option(help="Rows between checkpoints.")]
Pulled = Annotated[
    str | None,
    typer.Option(
        "--pull",
        metavar="A:1:N-A:20:C",
        help="Pull two atoms apart by a moving spring; or residues (A:1-A:20), or selections, ' - ' between.",
    ),
]
PullStiffness = Annotated[float, typer.Option(metavar="K", help="Stiffness of this spring, kJ/mol/nm^2.")]
PullSpeed = Annotated[
    float, typer.Option(metavar="NM/PS", help="Speed of its length, nm/ps; below 0 together, 0 to hold.")
]
HingeSprings = Annotated[
    list[str] | None,
    typer.Option(
        "--hinge-spring",
        metavar="'KIND K C'",
        help="Spring (kJ/mol/rad^2) and damper (kJ/mol ps/rad^2) on all hinges of a kind, as 'omega 40 0.5'.",
    ),
]
Relax = Annotated[bool, typer.Option(help="Minimise first, by turning hinges.")]
Resume = Annotated[bool, typer.Option("--resume", help="Continue the simulation in DIR.")]
Force = Annotated[bool, typer.Option("--force", help="Replace the simulation in DIR.")]


@with_settings()
def simulate(
    context: typer.Context,
    source: Input,
    output: Output = None,
    steps: Steps = defaults.N_STEPS,
    time_step: TimeStep = 1000.0 * defaults.TIME_STEP,
    temperature: Temperature = defaults.TEMPERATURE,
    thermostat: Thermostat = defaults.THERMOSTAT,
    friction: Friction = defaults.FRICTION,
    integrator: Integrator = defaults.INTEGRATOR,
    fixman: Fixman = False,
    loops: Loops = defaults.LOOPS,
    hydrogen_mass: HydrogenMass = None,
    trajectory_length: TrajectoryLength = defaults.TRAJECTORY_LENGTH,
    every: Every = defaults.EVERY,
    trajectory: Trajectory = defaults.TRAJECTORY,
    checkpoint_every: CheckpointEvery = defaults.CHECKPOINT_EVERY,
    pull: Pulled = None,
    pull_stiffness: PullStiffness = defaults.PULL_STIFFNESS,
    pull_speed: PullSpeed = defaults.PULL_SPEED,
    hinge_spring: HingeSprings = None,
    relax: Relax = True,
    resume: Resume = False,
    force: Force = False,
    seed: Annotated[int, typer.Option(help="Seed of all random numbers.")] = defaults.SEED,
    as_json: AsJson = False,
    *,
    setup: Setup,
) -> None:
    """Simulate one structure as rigid bodies; write trajectory, log, checkpoints and the last frame.

    Unlike pc.simulate it minimises first, since structures in files are strained; --no-relax omits this.
    """
    from protochain.dynamics import simulate as run
    from protochain.dynamics.folder import check_folder, files_of
    from protochain.dynamics.settings import SimulationSettings
    from protochain.dynamics.simulate import freed

    settings: dict[str, Any] = {
        "temperature": temperature, "time_step": time_step / 1000.0, "thermostat": thermostat,
        "friction": friction, "integrator": integrator, "fixman": fixman, "loops": loops,
        "hydrogen_mass": hydrogen_mass, "trajectory_length": trajectory_length, "every": every, "seed": seed,
        **_beside(pull, pull_stiffness, pull_speed, hinge_spring),
    }  # fmt: skip
    _check_time_step(time_step)
    SimulationSettings(**settings).check(steps, checkpoint_every)
    output = output or Path(f"{named_after(source)[0]}-simulation")
    check_folder(output, trajectory, resume, force)
    check_outputs(inputs_of(setup, source), files_of(output, trajectory))
    chain, energy, preparation = prepare(source, setup)
    if pull or hinge_spring:
        freed(chain, SimulationSettings(**settings))  # What is not there is said before the work.
    relax = relax and not resume
    _foretell(source, chain, energy, steps, relax)
    context.with_resource(held_interrupts())
    q = _relaxed(source, chain, energy, loops, seed) if relax else chain.q0
    with simulation_progress(source.stem, steps, time_step / 1000.0) as watch:
        done = run(
            chain, energy, q, n_steps=steps, output=output, trajectory=trajectory,
            checkpoint_every=checkpoint_every, resume=resume, force=force, watch=watch, **settings,
        )  # fmt: skip
    beside = {"input": str(source), "output": str(output), "seconds_preparation": preparation}
    _end(done, beside, as_json)


def _beside(
    pull: str | None, stiffness: float, speed: float, hinge_springs: list[str] | None
) -> dict[str, Any]:
    """Settings of what acts beside the force field."""
    from protochain.core.checks import ends
    from protochain.dynamics.settings import HingeSpring, Pull

    return {
        "pull": None if pull is None else Pull(ends(pull, "pull"), stiffness, speed),
        "hinge_springs": HingeSpring.several(hinge_springs or (), "hinge_spring"),
    }


def _end(done: "Simulation", beside: dict[str, Any], as_json: bool) -> None:
    """Print what a simulation came to, and exit."""
    record = {**done.record(), **beside}
    if as_json:
        print(json.dumps(record, allow_nan=False))
    elif done.is_sound:
        print_simulation(record)
    if not done.is_sound:
        where = f"the frames until then are in {beside['output']}/*.part.*"
        raise SystemExit(fail(f"{beside['input']}: {done.message}; {where}"))
    raise typer.Exit(CONVERGED if done.ending == "completed" else UNCONVERGED)


def _check_time_step(given: float) -> None:
    """Refuse a time step that is meant in another unit."""
    from protochain.dynamics.settings import LONGEST_STEP

    if not 0.0 < given < 1000.0 * LONGEST_STEP:
        raise refused(
            "time_step", f"{given:g} fs", f"give a number above 0 and below {1000.0 * LONGEST_STEP:g}"
        )
    if given < _SHORTEST:
        raise refused("time_step", f"{given:g} fs", f"give femtoseconds: {1000.0 * given:g} are {given:g} ps")


def _foretell(source: Path, chain: "Chain", energy: "Energy", steps: int, relax: bool) -> None:
    """Say before a long run how long it will be, and what a minimisation does about a bad start."""
    usual = most = steps
    if relax:
        troubled = print_outlook(source, chain.structure, "lbfgs")
        usual += (TROUBLED if troubled else 1) * typical_evaluations("lbfgs", defaults.MAX_EVALUATIONS)
        most += defaults.MAX_EVALUATIONS
    foretell(source, chain, energy, usual, most)


def _relaxed(source: Path, chain: "Chain", energy: "Energy", loops: str, seed: int) -> "Floats":
    """Minimise by turning hinges; report what it changed, and return the coordinates."""
    from protochain.minimisers import minimise

    with run_progress("lbfgs", defaults.MAX_EVALUATIONS, writes=False) as watch:
        relaxed = minimise(chain, energy, "lbfgs", _RELAXED, seed=seed, watch=watch)
    if relaxed.status == "interrupted":
        raise KeyboardInterrupt
    # Without constraints: the force field holds the loops, and takes the strain from them, too.
    kept = "; loops are kept closed as they are after it" if loops == "closed" else ""
    print(
        f"{source}: minimised first: {relaxed.start.energy:.1f} -> {relaxed.end.energy:.1f} kJ/mol, "
        f"C-alpha RMSD {relaxed.ca_rmsd_angstrom:.2f} angstrom{kept}",
        file=sys.stderr,
    )
    return relaxed.q
