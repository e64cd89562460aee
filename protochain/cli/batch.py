"""``protochain batch``."""

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from protochain.chains.setup import Setup
from protochain.cli import options
from protochain.cli.terminal import batch_progress, print_batch, print_jobs
from protochain.core import defaults
from protochain.core.checks import words
from protochain.minimisers.minimise_settings import MinimiseSettings, StartSettings
from protochain.relaxation.relax_settings import RelaxSettings

Inputs = Annotated[
    list[str] | None,
    typer.Argument(metavar="IN...", help="Files, folders or patterns. - lists them on standard input."),
]
Output = Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Folder for the results.")]
Methods = Annotated[str, typer.Option(help="Methods, separated by commas, also relax.")]
Workers = Annotated[int | None, typer.Option(help="Processes on this machine [default: all cores].")]
Threads = Annotated[int, typer.Option(help="Threads for each structure.")]
TimeLimit = Annotated[float, typer.Option(help="Seconds after which a structure is stopped.")]
ByNul = Annotated[
    bool, typer.Option("--null", "-0", help="Names on standard input are separated by NULs (find -print0).")
]
Resume = Annotated[bool, typer.Option("--resume", help="Continue in the folder, with the same settings.")]
DryRun = Annotated[bool, typer.Option("--dry-run", help="List the structures and stop.")]


@options.with_settings(setup="trust_forcefield", relaxing="restraints")
def batch(
    context: typer.Context,
    inputs: Inputs = None,
    output: Output = Path("batch"),
    methods: Methods = defaults.METHOD,
    manifest: options.Manifest = None,
    workers: Workers = None,
    scheduler: options.Scheduler = None,
    threads: Threads = defaults.BATCH_THREADS,
    time_limit: TimeLimit = defaults.TIME_LIMIT,
    null: ByNul = False,
    resume: Resume = False,
    force: Annotated[bool, typer.Option("--force", help="Replace the batch in DIR.")] = False,
    dry_run: DryRun = False,
    figure: options.FigureFile = None,
    as_json: options.AsJson = False,
    *,
    minimising: MinimiseSettings,
    starting: StartSettings,
    relaxing: RelaxSettings,
    setup: Setup,
) -> None:
    """Minimise or relax many structures in many processes. Failures are reported and skipped."""
    from protochain.batches import BatchSettings, find_jobs
    from protochain.batches import batch as run
    from protochain.batches.cluster import Processes
    from protochain.batches.jobs import read_names
    from protochain.batches.report import plot_distributions
    from protochain.batches.table import SUMMARY, replaceable_files
    from protochain.results.figures import check_figure, write_figure

    settings = BatchSettings(
        words(methods), setup=setup, relaxing=relaxing, **vars(minimising), **vars(starting)
    )
    if "-" not in (inputs or ()):
        options.refuse(context, "null", "applies to names on standard input (-) only")
    # Standard input can be read only once.
    lines = [line for source in inputs or () for line in (read_names(null) if source == "-" else [source])]
    if dry_run:
        jobs = find_jobs(lines, settings, manifest, output)
        if as_json:
            rows = [{"structure": j.name, "methods": j.settings.methods, "input": str(j.path)} for j in jobs]
            options.print_json({"structures": rows})
        else:
            print_jobs(jobs)
        raise typer.Exit(options.CONVERGED)
    check_figure(figure)
    options.check_outputs([manifest], [*replaceable_files(output, SUMMARY, resume, force), figure], setup)
    with Processes(workers, scheduler, threads, time_limit).started_early(), batch_progress() as watch:
        result = run(
            lines, output, manifest=manifest, resume=resume, force=force, watch=watch,
            workers=workers, scheduler=scheduler, threads=threads, time_limit=time_limit, **vars(settings),
        )  # fmt: skip
    if figure:
        write_figure(figure, partial(plot_distributions, result.table))

    def show() -> None:
        print_batch(result.table, str(result.report))
        options.print_files(figure)

    options.end_folder(output, show, as_json, result.interrupted, options.batch_status(result))
