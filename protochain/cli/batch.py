"""``protochain batch``."""

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from protochain.cli.options import (
    CONVERGED,
    FAILED,
    PH,
    UNCONVERGED,
    Altloc,
    AsJson,
    Engine,
    Forcefield,
    Hinges,
    Keep,
    MaxEvaluations,
    MaxRmsd,
    Move,
    Seed,
    Solvent,
    Strict,
    Tolerance,
)
from protochain.cli.terminal import batch_progress, print_batch, print_jobs


def batch(
    inputs: Annotated[
        list[str] | None,
        typer.Argument(metavar="IN...", help="Files, folders, patterns; - lists them on standard input."),
    ] = None,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="DIR", help="Folder for the results.")
    ] = Path("batch"),
    methods: Annotated[str, typer.Option(help="Methods, with commas between.")] = "hybrid",
    manifest: Annotated[
        Path | None, typer.Option(help="CSV with a column path and any settings, one structure a line.")
    ] = None,
    workers: Annotated[
        int | None, typer.Option(help="Processes on this machine [default: all cores].")
    ] = None,
    scheduler: Annotated[str | None, typer.Option(help="Address of a Dask cluster to use instead.")] = None,
    threads: Annotated[int, typer.Option(help="Threads for each structure.")] = 1,
    time_limit: Annotated[
        float, typer.Option(help="Seconds for each structure; then it is given up.")
    ] = 3600.0,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on in the folder: skip what is finished.")
    ] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="List the work and do nothing.")] = False,
    solvent: Solvent = "obc2",
    forcefield: Forcefield = "amber14",
    hinges: Hinges = "phi psi chi",
    engine: Engine = "auto",
    move: Move = "all",
    tolerance: Tolerance = 1.0,
    max_evaluations: MaxEvaluations = 5000,
    max_rmsd: MaxRmsd = None,
    seed: Seed = 0,
    model: Annotated[str, typer.Option(help="Number of the model [default: the first], or all.")] = "",
    altloc: Altloc = "",
    keep: Keep = "",
    ph: PH = 7.0,
    strict: Strict = False,
    as_json: AsJson = False,
) -> None:
    """Minimise many structures in many processes; failures are rows, and nothing stops the rest."""
    from protochain.batches import Settings, find_jobs
    from protochain.batches import batch as run

    chosen = tuple(name.strip() for name in methods.split(",") if name.strip())
    settings: dict[str, Any] = {
        "solvent": solvent, "forcefield": forcefield, "hinges": hinges, "engine": engine, "move": move,
        "tolerance": tolerance, "max_evaluations": max_evaluations, "seed": seed, "model": model,
        "altloc": altloc, "keep": keep, "ph": ph, "strict": strict,
    }  # fmt: skip
    if max_rmsd is not None:
        settings["max_rmsd"] = max_rmsd
    # A list on standard input can be read once only.
    given = [line for each in inputs or () for line in (_lines() if each == "-" else [each])]
    if dry_run:
        print_jobs(find_jobs(given, Settings(methods=chosen, **settings), manifest, output))
        raise typer.Exit(CONVERGED)
    with batch_progress() as watch:
        done = run(
            given, output, chosen, manifest=manifest, workers=workers, scheduler=scheduler, threads=threads,
            time_limit=time_limit, resume=resume, watch=watch, **settings,
        )  # fmt: skip
    if as_json:
        print((output / "summary.json").read_text())
    else:
        print_batch(done.table, str(done.report))
    if done.interrupted:
        print("protochain: interrupted; --resume goes on with the rest", file=sys.stderr)
    counts = done.counts()
    usable = bool(done.table["output"].notna().any())
    complete = set(counts) == {"converged"} and not done.interrupted
    raise typer.Exit(CONVERGED if complete else UNCONVERGED if usable else FAILED)


def _lines() -> list[str]:
    return [line.strip() for line in sys.stdin if line.strip()]
