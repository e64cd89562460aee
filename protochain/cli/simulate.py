"""``protochain simulate``."""

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from protochain.cli.options import (
    CONVERGED,
    PH,
    UNCONVERGED,
    Altloc,
    AsJson,
    Disulfide,
    Engine,
    Forcefield,
    Hinges,
    Input,
    Keep,
    Model,
    Move,
    NoDisulfide,
    Seed,
    Solvent,
    Strict,
    Threads,
    Trust,
    fail,
    named_after,
    prepare,
    reading,
)  # fmt: skip
from protochain.cli.terminal import print_simulation, simulation_progress
from protochain.interrupts import held_interrupts

_RELAXED = 10.0
"""kJ/mol/rad. Largest torque of the start: what is left warms up nothing."""


def simulate(
    context: typer.Context,
    source: Input,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="DIR", help="Folder [default: NAME-simulation].")
    ] = None,
    steps: Annotated[int, typer.Option(help="Time steps in all.")] = 10_000,
    time_step: Annotated[float, typer.Option(help="fs.")] = 5.0,
    temperature: Annotated[
        float, typer.Option(help="K, of the thermostat and of the first velocities.")
    ] = 300.0,
    thermostat: Annotated[
        str, typer.Option(help="langevin, nose-hoover, rescale, hmc or none.")
    ] = "langevin",
    friction: Annotated[float, typer.Option(help="How tightly the thermostat holds, 1/ps.")] = 1.0,
    integrator: Annotated[
        str, typer.Option(help="leapfrog, lobatto, midpoint, rk4 or dormand-prince.")
    ] = "leapfrog",
    hinges: Hinges = "phi psi chi",
    move: Move = "all",
    fixman: Annotated[
        bool, typer.Option("--fixman", help="Undo the bias of rigid bonds and angles.")
    ] = False,
    loops: Annotated[
        str, typer.Option(help="Disulfides: open (force field) or closed (constraints).")
    ] = "open",
    hydrogen_mass: Annotated[
        float | None, typer.Option(help="amu, taken from what the hydrogens are bonded to.")
    ] = None,
    trajectory_length: Annotated[int, typer.Option(help="Steps a trajectory of hmc.")] = 10,
    every: Annotated[int, typer.Option(help="Steps between frames and rows of the log.")] = 100,
    trajectory: Annotated[str, typer.Option(help="dcd or xtc.")] = "dcd",
    checkpoint_every: Annotated[int, typer.Option(help="Rows between checkpoints.")] = 10,
    relax: Annotated[bool, typer.Option(help="Turn hinges to a minimum first.")] = True,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with the simulation in DIR.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace the simulation in DIR.")] = False,
    solvent: Solvent = "obc2",
    forcefield: Forcefield = "amber14",
    engine: Engine = "auto",
    seed: Seed = 0,
    threads: Threads = None,
    as_json: AsJson = False,
    model: Model = "",
    altloc: Altloc = "",
    keep: Keep = "",
    disulfide: Disulfide = None,
    no_disulfide: NoDisulfide = False,
    ph: PH = 7.0,
    strict: Strict = False,
    trust_forcefield: Trust = False,
) -> None:
    """Simulate one structure as rigid bodies; write trajectory, log, checkpoints and the last frame."""
    from protochain.dynamics import simulate as run
    from protochain.dynamics.folder import check_folder
    from protochain.dynamics.settings import SimulationSettings
    from protochain.minimisers import minimise

    settings: dict[str, Any] = {
        "temperature": temperature, "time_step": time_step / 1000.0, "thermostat": thermostat,
        "friction": friction, "integrator": integrator, "fixman": fixman, "loops": loops,
        "hydrogen_mass": hydrogen_mass, "trajectory_length": trajectory_length, "every": every, "seed": seed,
    }  # fmt: skip
    SimulationSettings(**settings).check(steps, checkpoint_every)
    taken = reading(model, altloc, keep, disulfide, no_disulfide, ph, strict)
    output = output or Path(f"{named_after(source)[0]}-simulation")
    check_folder(output, trajectory, resume, force)
    chain, energy, preparation = prepare(
        source, taken, hinges, forcefield, solvent, engine, threads, trust_forcefield, move
    )
    context.with_resource(held_interrupts())
    q = chain.q0
    if relax and not resume and loops == "open":
        relaxed = minimise(chain, energy, "lbfgs", _RELAXED, seed=seed)
        print(
            f"{source}: minimised first: {relaxed.start.energy:.1f} -> {relaxed.end.energy:.1f} kJ/mol, "
            f"C-alpha RMSD {relaxed.ca_rmsd_angstrom:.2f} angstrom",
            file=sys.stderr,
        )
        q = relaxed.q
    with simulation_progress(source.stem, steps, time_step / 1000.0) as watch:
        done = run(
            chain, energy, q, n_steps=steps, output=output, trajectory=trajectory,
            checkpoint_every=checkpoint_every, resume=resume, force=force, watch=watch, **settings,
        )  # fmt: skip
    record = {
        **done.record(),
        "input": str(source),
        "output": str(output),
        "seconds_preparation": preparation,
    }
    if as_json:
        print(json.dumps(record, allow_nan=False))
    else:
        print_simulation(record)
    if not done.is_sound:
        raise SystemExit(
            fail(f"{source}: {done.message}; what it did is in {output}/*.part.*, named as not sound")
        )
    raise typer.Exit(CONVERGED if done.ending == "completed" else UNCONVERGED)
