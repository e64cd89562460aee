"""``protochain simulate``."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from protochain.chains.setup import Setup
from protochain.cli import options
from protochain.cli.first import METHOD, announce_duration, minimise_first
from protochain.cli.lines import Kind, tell, with_detail
from protochain.cli.terminal import print_outlook, print_simulation, simulation_progress
from protochain.core.interrupts import held_interrupts
from protochain.core.storage import claim_folder
from protochain.dynamics.simulate_settings import Pull, RunSettings, SimulationSettings

if TYPE_CHECKING:
    from protochain.chains.chain import Chain
    from protochain.core.arrays import Floats
    from protochain.dynamics import Simulation
    from protochain.energies import Energy

_RELAXED = 10.0  # kJ/mol/rad. Largest torque at the start. The remaining strain heats little.

Output = Annotated[
    Path | None, typer.Option("-o", "--output", metavar="DIR", help="Folder [default: NAME-simulation].")
]
Relax = Annotated[bool, typer.Option(help="Minimise first, in torsions.")]


@with_detail
@options.with_settings()
def simulate(
    context: typer.Context,
    source: options.Input,
    output: Output = None,
    relax: Relax = True,
    as_json: options.AsJson = False,
    *,
    running: RunSettings,
    simulation: SimulationSettings,
    pulling: Pull,
    setup: Setup,
) -> None:
    """Simulate one structure as rigid bodies. Write trajectory, log, checkpoints and the last frame.

    Unlike pc.simulate, it minimises first, as structures in files are strained. --no-relax omits this.
    """
    from protochain.dynamics import simulate as run
    from protochain.dynamics.folder import check_folder, files_of
    from protochain.dynamics.simulate_chain import prepare_chain
    from protochain.dynamics.thermostats import THERMOSTATS

    simulation, thermostat = replace(simulation, pull=pulling), THERMOSTATS[simulation.thermostat]
    if not thermostat.metropolis:
        options.refuse(context, "trajectory_length", "applies to thermostat hmc only")
    if not hasattr(thermostat, "friction"):
        options.refuse(context, "friction", f"does not apply to thermostat {simulation.thermostat}")
    output = output or Path(f"{options.named_after(source)[0]}-simulation")
    check_folder(output, running.trajectory, running.resume, running.force)
    files = [] if running.resume else files_of(output, running.trajectory)
    options.check_outputs([source], files, setup, new=[] if running.force else files)
    context.with_resource(claim_folder(output, "simulation", running.resume))
    chain, energy, preparation = options.prepare(source, setup)
    if simulation.pull or simulation.hinge_springs or simulation.hydrogen_mass is not None:
        prepare_chain(chain, simulation)  # Reports missing hinges before the work.
    relax = relax and not running.resume
    times = print_outlook(chain.structure, METHOD) if relax else 0
    announce_duration(chain, energy, running.n_steps, times)
    context.with_resource(held_interrupts())
    q = _minimise(chain, energy, simulation) if relax else chain.q0
    with simulation_progress(source.stem, running.n_steps, simulation.time_step) as watch:
        result = run(chain, energy, q, output=output, watch=watch, **vars(running), **vars(simulation))
    origin = {"input": str(source), "output": str(output), "seconds_preparation": preparation}
    page = output / "report.html"
    if result.is_sound and result.trajectory is not None and (result.n_steps or not page.exists()):
        from protochain.comparison.simulated import write_simulated

        record = result.record()
        write_simulated(chain.structure, result.trace, record, result.trajectory, page)
    _end(result, origin, as_json)


def _end(result: "Simulation", origin: dict[str, Any], as_json: bool) -> None:
    record = {**result.record(), **origin}
    if as_json:
        options.print_json(record)
    elif result.is_sound:
        print_simulation(record)
    if not result.is_sound:
        where = f"Earlier frames are in {origin['output']}/*.part.*"
        raise SystemExit(options.fail(f"{origin['input']}: {result.message}. {where}"))
    raise typer.Exit(options.CONVERGED if result.ending == "completed" else options.INTERRUPTED)


def _minimise(chain: "Chain", energy: "Energy", simulation: SimulationSettings) -> "Floats":
    """Minimise in torsions, report the changes, and return the coordinates."""
    solution, line = minimise_first(chain, energy, _RELAXED, simulation.seed, simulation.restraints)
    # Without loop constraints. The force field closes the loops, and their strain is minimised, too.
    note = ", then loops are constrained" if simulation.loops == "closed" else ""
    tell(Kind.PROGRESS, f"{line}{note}")
    return solution.q
