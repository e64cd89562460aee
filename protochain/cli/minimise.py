"""``protochain minimise``."""

import json
import math
from contextlib import ExitStack
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
    Force,
    Forcefield,
    Hinges,
    Input,
    Keep,
    MaxEvaluations,
    MaxRmsd,
    Method,
    Move,
    NoDisulfide,
    Restrain,
    Seed,
    Solvent,
    Strict,
    Threads,
    Tolerance,
    Trust,
    check_outputs,
    fail,
    named_after,
    prepare,
    reading,
)  # fmt: skip
from protochain.cli.terminal import print_distribution, print_table, progress
from protochain.errors import ProtochainError
from protochain.interrupts import held_interrupts


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
    model: Annotated[str, typer.Option(help="Number of the model [default: the first], or all.")] = "",
    altloc: Altloc = "",
    keep: Keep = "",
    disulfide: Disulfide = None,
    no_disulfide: NoDisulfide = False,
    ph: PH = 7.0,
    strict: Strict = False,
    trust_forcefield: Trust = False,
) -> None:
    """Minimise the energy of one structure."""
    from protochain.minimisers import explore
    from protochain.minimisers import minimise as run
    from protochain.minimisers.api import Minimisation
    from protochain.minimisers.recipes import recipe_of
    from protochain.storage import write_atomically
    from protochain.structure.read import model_numbers
    from protochain.structure.trajectory import TrajectoryFile, check_trajectory
    from protochain.structure.write import check_fits, check_format

    limit = math.inf if max_rmsd is None else max_rmsd
    Minimisation(recipe_of(method), tolerance, max_evaluations, seed, restrain, limit, checkpoint, resume)
    if starts > 1 and (checkpoint or resume or trajectory):
        raise ProtochainError("starts: a checkpoint or trajectory is of one run; give one start")
    if starts == 1 and hop is not None:
        raise ProtochainError("hop: goes from minimum to minimum; give --starts 2 or more")
    taken = reading("" if model == "all" else model, altloc, keep, disulfide, no_disulfide, ph, strict)
    stem, suffix = named_after(source)
    output = output or Path(f"{stem}.{method}{suffix}")
    check_format(output)
    if trajectory:
        check_trajectory(trajectory)
    others = [path for path in (trace, trajectory, checkpoint) if path]
    outputs: list[tuple[int | None, Path]] = [(taken["model"], output)]
    if model == "all":
        if others or resume or str(source) == "-":
            raise ProtochainError(
                "model all: takes a file, and no trace, trajectory or checkpoint: they are of one model"
            )
        outputs = [(n, output.with_name(f"{output.stem}.{n}{output.suffix}")) for n in model_numbers(source)]
    check_outputs(source, [path for _, path in outputs] + others, force)

    def solve(number: int | None, output: Path) -> tuple[dict[str, Any], dict[str, Any], str]:
        chain, energy, preparation = prepare(
            source, taken | {"model": number}, hinges, forcefield, solvent, engine, threads, trust_forcefield,
            move,
        )  # fmt: skip
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
                "tolerance": tolerance, "max_evaluations": max_evaluations, "restraint": restrain,
                "max_rmsd": limit, "watch": watch,
            }  # fmt: skip
            if starts == 1:
                solution = run(
                    chain, energy, method, seed=seed, checkpoint=checkpoint, resume=resume, **settings
                )
                distribution: dict[str, Any] = {}
            else:
                found = explore(
                    chain, energy, method, starts, seed=seed, spread=math.radians(spread),
                    hop_temperature=hop, **settings,
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
        return record, distribution, solution.status

    records: list[dict[str, Any]] = []
    for number, path in outputs:
        record, distribution, status = solve(number, path)
        records.append(record | ({"model": number} if number is not None else {}))
        if not as_json and distribution:
            print_distribution(distribution["starts_summary"])
        if status == "interrupted":
            break
    if as_json:
        print(json.dumps({"models": records} if model == "all" else records[0], allow_nan=False))
    else:
        print_table(records)
        print(f"written: {', '.join(record['output'] for record in records)}")
    done = len(records) == len(outputs) and all(record["status"] == "converged" for record in records)
    raise typer.Exit(CONVERGED if done else UNCONVERGED)
