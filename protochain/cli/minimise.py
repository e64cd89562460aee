"""``protochain minimise``."""

import json
import math
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from protochain import defaults
from protochain.cli.options import (
    CONVERGED,
    UNCONVERGED,
    AsJson,
    Input,
    MaxEvaluations,
    MaxRmsd,
    Seed,
    Tolerance,
    check_outputs,
    fail,
    named_after,
    prepare,
    with_setup,
)
from protochain.cli.terminal import (
    foretell,
    print_distribution,
    print_table,
    print_written,
    run_progress,
    typical_evaluations,
)
from protochain.errors import ProtochainError
from protochain.interrupts import held_interrupts
from protochain.setup import ALL_MODELS, Setup

if TYPE_CHECKING:
    from protochain.chain import Chain
    from protochain.energies import Energy
    from protochain.minimisers import Solution

Output = Annotated[
    Path | None, typer.Option("-o", "--output", help="PDB or mmCIF [default: NAME.METHOD.pdb].")
]
Method = Annotated[
    str, typer.Option(help="hybrid, cartesian, lbfgs, newton, kcm, openmm ...: an unknown one lists them.")
]
Restrain = Annotated[
    str, typer.Option(help="Restraints to the start, kJ/mol/nm^2, one after the other: '1000 100 0'.")
]
Starts = Annotated[
    int, typer.Option(help="Number of starts, from dihedrals perturbed at random; the best end is written.")
]
_DEGREES = f"{math.degrees(defaults.SPREAD):.1f}"
Spread = Annotated[
    float | None, typer.Option(help=f"Standard deviation of a perturbation, degrees [default: {_DEGREES}].")
]
Hop = Annotated[
    float | None, typer.Option(help="Basin hopping: start from the last minimum accepted at this K.")
]
Checkpoint = Annotated[Path | None, typer.Option(help="File for the state at the end, .npz.")]
Resume = Annotated[Path | None, typer.Option(help="Continue from a checkpoint.")]
Trace = Annotated[Path | None, typer.Option(help="CSV with a row for each iteration.")]
Trajectory = Annotated[Path | None, typer.Option(help="DCD or XTC with a frame for each iteration.")]
Force = Annotated[bool, typer.Option("--force", help="Allow an output to replace the input.")]


@with_setup()
def minimise(
    context: typer.Context,
    source: Input,
    output: Output = None,
    method: Method = defaults.METHOD,
    tolerance: Tolerance = defaults.TOLERANCE,
    max_evaluations: MaxEvaluations = defaults.MAX_EVALUATIONS,
    restrain: Restrain = "",
    max_rmsd: MaxRmsd = None,
    starts: Starts = 1,
    spread: Spread = None,
    hop: Hop = None,
    checkpoint: Checkpoint = None,
    resume: Resume = None,
    trace: Trace = None,
    trajectory: Trajectory = None,
    seed: Seed = defaults.SEED,
    as_json: AsJson = False,
    force: Force = False,
    *,
    setup: Setup,
) -> None:
    """Minimise the energy of one structure."""
    from protochain.minimisers.api import Minimisation
    from protochain.minimisers.recipes import recipe_of
    from protochain.minimisers.starts import check_starts

    limit = math.inf if max_rmsd is None else max_rmsd
    Minimisation(recipe_of(method), tolerance, max_evaluations, seed, restrain, limit, checkpoint, resume)
    if starts > 1 and (checkpoint or resume or trajectory):
        raise ProtochainError("starts: a checkpoint or trajectory belongs to one run; give one start")
    if starts == 1 and hop is not None:
        raise ProtochainError("hop: needs several minima; give --starts 2 or more")
    beside = [path for path in (trace, trajectory, checkpoint) if path]
    stem, suffix = named_after(source)
    output = output or Path(f"{stem}.{method}{suffix}")
    _check_formats(output, trajectory)
    runs = _runs(source, output, setup, bool(beside or resume))
    check_outputs(source, [*(path for _, path in runs), *beside], force)

    settings: dict[str, Any] = {
        "method": method, "tolerance": tolerance, "max_evaluations": max_evaluations, "seed": seed,
        "restraint": restrain, "max_rmsd": limit,
    }  # fmt: skip
    if starts == 1:
        solve = partial(_once, trajectory=trajectory, checkpoint=checkpoint, resume=resume, **settings)
    else:
        width = defaults.SPREAD if spread is None else math.radians(spread)
        check_starts(starts, width, hop, **settings)
        solve = partial(_often, n_starts=starts, spread=width, hop_temperature=hop, **settings)
    lengths = starts * typical_evaluations(method, max_evaluations), starts * max_evaluations
    records: list[dict[str, Any]] = []
    for own, path in runs:
        records.append(_solved(context, source, own, path, trace, solve, lengths))
        if records[-1]["status"] == "interrupted":
            break
    _print(records, as_json, setup.model == ALL_MODELS)
    done = len(records) == len(runs) and all(record["status"] == "converged" for record in records)
    raise typer.Exit(CONVERGED if done else UNCONVERGED)


def _check_formats(output: Path, trajectory: Path | None) -> None:
    from protochain.structure.trajectory import check_trajectory
    from protochain.structure.write import check_format

    check_format(output)
    if trajectory:
        check_trajectory(trajectory)


def _runs(source: Path, output: Path, setup: Setup, is_single: bool) -> list[tuple[Setup, Path]]:
    """Pair each model with its output; ``is_single`` where other files belong to one model."""
    from protochain.structure.read import model_numbers

    if setup.model != ALL_MODELS:
        return [(setup, output)]
    if is_single or str(source) == "-":
        raise ProtochainError(
            "model all: needs a file, and no trace, trajectory or checkpoint: these belong to one model"
        )
    return [
        (replace(setup, model=number), output.with_name(f"{output.stem}.{number}{output.suffix}"))
        for number in model_numbers(source)
    ]


def _solved(
    context: typer.Context,
    source: Path,
    setup: Setup,
    output: Path,
    trace: Path | None,
    solve: "Callable[[Chain, Energy], tuple[Solution, dict[str, Any]]]",
    lengths: tuple[int, int],
) -> dict[str, Any]:
    """Prepare and minimise one model, write its files, and return its record."""
    from protochain.storage import write_atomically
    from protochain.structure.write import check_fits

    chain, energy, preparation = prepare(source, setup)
    check_fits(chain.structure, output)
    foretell(source, chain, energy, *lengths)
    context.with_resource(held_interrupts())
    solution, starts = solve(chain, energy)
    if not solution.is_usable:
        raise SystemExit(
            fail(f"{source}: {solution.message}; nothing is better than the start: nothing is written")
        )
    solution.save(output)
    if trace:
        write_atomically(trace, lambda to: solution.trace.to_csv(to, index=False))
    record = solution.record() | starts | ({} if setup.model is None else {"model": setup.model})
    return record | {"input": str(source), "output": str(output), "seconds_preparation": preparation}


def _once(
    chain: "Chain", energy: "Energy", trajectory: Path | None, **settings: Any
) -> tuple["Solution", dict[str, Any]]:
    """Minimise from the structure as it is; write every accepted point to the trajectory."""
    from protochain.minimisers import minimise
    from protochain.structure.trajectory import TrajectoryFile

    with ExitStack() as stack:
        frames = stack.enter_context(TrajectoryFile(trajectory, chain.structure)) if trajectory else None
        also = frames.append if frames else None
        watch = stack.enter_context(run_progress(settings["method"], settings["max_evaluations"], also))
        return minimise(chain, energy, watch=watch, **settings), {}


def _often(chain: "Chain", energy: "Energy", **settings: Any) -> tuple["Solution", dict[str, Any]]:
    """Minimise from many starts; return the best solution, and what its record says of all."""
    from protochain.minimisers import explore

    with run_progress(settings["method"], settings["max_evaluations"]) as watch:
        found = explore(chain, energy, watch=watch, **settings)
    return found.best, found.overall()


def _print(records: list[dict[str, Any]], as_json: bool, of_models: bool) -> None:
    if as_json:
        print(json.dumps({"models": records} if of_models else records[0], allow_nan=False))
        return
    for record in records:
        if "starts_summary" in record:
            print_distribution(record["starts_summary"])
    print_table(records)
    for record in records:
        print_written(record)
