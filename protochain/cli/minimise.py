"""``protochain minimise``."""

import json
import math
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any

import typer

from protochain.cli.options import (
    CONVERGED,
    UNCONVERGED,
    AsJson,
    Engine,
    Force,
    Forcefield,
    Hinges,
    Input,
    MaxEvaluations,
    MaxRmsd,
    Method,
    Move,
    Restrain,
    Seed,
    Solvent,
    Threads,
    Tolerance,
    Trust,
    check_outputs,
    fail,
    prepare,
)  # fmt: skip
from protochain.errors import ProtochainError
from protochain.interrupts import held_interrupts
from protochain.terminal import print_distribution, print_table, progress


def minimise(
    context: typer.Context,
    source: Input,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="PDB or mmCIF [default: NAME.METHOD.pdb].")
    ] = None,
    method: Method = "hybrid",
    solvent: Solvent = "obc2",
    forcefield: Forcefield = "amber14",
    hinges: Hinges = "phi psi chi",
    engine: Engine = "auto",
    tolerance: Tolerance = 1.0,
    max_evaluations: MaxEvaluations = 5000,
    move: Move = "all",
    restrain: Restrain = "",
    max_rmsd: MaxRmsd = None,
    starts: Annotated[
        int,
        typer.Option(help="Minimise this often, from dihedrals perturbed at random; the best is written."),
    ] = 1,
    spread: Annotated[float, typer.Option(help="Degrees by which starts differ, standard deviation.")] = 11.5,
    hop: Annotated[
        float | None, typer.Option(help="Start from the minimum before; kept as Metropolis at this K.")
    ] = None,
    checkpoint: Annotated[Path | None, typer.Option(help="Write what it takes to go on, .npz.")] = None,
    resume: Annotated[Path | None, typer.Option(help="Go on from a checkpoint.")] = None,
    trace: Annotated[Path | None, typer.Option(help="CSV with a row an iteration.")] = None,
    trajectory: Annotated[Path | None, typer.Option(help="DCD or XTC with a frame an iteration.")] = None,
    seed: Seed = 0,
    threads: Threads = None,
    as_json: AsJson = False,
    force: Force = False,
    trust_forcefield: Trust = False,
) -> None:
    """Minimise the energy of one structure."""
    from protochain.minimisers import explore
    from protochain.minimisers import minimise as run
    from protochain.minimisers.api import check_settings
    from protochain.minimisers.stages import read_hold
    from protochain.structure.trajectory import TrajectoryFile, check_trajectory
    from protochain.structure.write import check_fits, check_format, write_atomically

    hold = read_hold(restrain, max_rmsd)
    check_settings(method, tolerance, max_evaluations, hold, bool(checkpoint or resume))
    if starts > 1 and (checkpoint or resume or trajectory):
        raise ProtochainError("starts: a checkpoint or trajectory is of one run; give one start")
    if starts == 1 and hop is not None:
        raise ProtochainError("hop: goes from minimum to minimum; give --starts 2 or more")
    suffix = ".cif" if source.suffix.lower() in (".cif", ".mmcif") else ".pdb"
    output = output or Path(f"{source.stem}.{method}{suffix}")
    check_format(output)
    if trajectory:
        check_trajectory(trajectory)
    check_outputs(source, [path for path in (output, trace, trajectory, checkpoint) if path], force)
    chain, energy, preparation = prepare(
        source, hinges, forcefield, solvent, engine, threads, trust_forcefield, move
    )
    check_fits(chain.structure, output)
    context.with_resource(held_interrupts())
    with ExitStack() as stack:
        show = stack.enter_context(progress(method, max_evaluations))
        frames = stack.enter_context(TrajectoryFile(trajectory, chain.structure)) if trajectory else None

        def watch(row: dict[str, float], x: Any) -> None:
            show(row, x)
            if frames:
                frames.append(x)

        settings: dict[str, Any] = {
            "tolerance": tolerance, "max_evaluations": max_evaluations, "restraint": hold.restraint,
            "max_rmsd": hold.max_rmsd, "watch": watch,
        }  # fmt: skip
        if starts == 1:
            solution = run(chain, energy, method, seed=seed, checkpoint=checkpoint, resume=resume, **settings)
            distribution: dict[str, Any] = {}
        else:
            found = explore(
                chain, energy, method, starts, seed=seed, spread=math.radians(spread), hop_temperature=hop,
                **settings,
            )  # fmt: skip
            solution, distribution = found.best, found.overall()
    if not solution.is_usable:
        raise SystemExit(fail(f"{source}: {solution.message}"))
    solution.save(output)
    if trace:
        write_atomically(trace, lambda to: solution.trace.to_csv(to, index=False))
    record = {
        **solution.record(),
        **distribution,
        "input": str(source),
        "output": str(output),
        "seconds_preparation": preparation,
    }
    if as_json:
        print(json.dumps(record, allow_nan=False))
    else:
        print_table([record])
        if distribution:
            print_distribution(distribution["starts_summary"])
        print(f"written: {output}")
    raise typer.Exit(CONVERGED if solution.status == "converged" else UNCONVERGED)
