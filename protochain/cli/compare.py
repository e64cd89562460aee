"""``protochain compare``."""

import json
import sys
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

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
    MaxEvaluations,
    Model,
    NoDisulfide,
    Seed,
    Solvent,
    Strict,
    Threads,
    Tolerance,
    Trust,
    fail,
    named_after,
    prepare,
    reading,
)  # fmt: skip
from protochain.cli.terminal import print_table, progress
from protochain.interrupts import held_interrupts

if TYPE_CHECKING:
    from protochain.minimisers.solution import Watcher


def compare(
    context: typer.Context,
    source: Input,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="DIR", help="Folder [default: NAME-comparison].")
    ] = None,
    methods: Annotated[
        str, typer.Option(help="Methods, with commas between.")
    ] = "kcm,md,lbfgs,hybrid,openmm",
    repeats: Annotated[int, typer.Option(help="Runs of each method that does not repeat exactly.")] = 3,
    reference: Annotated[
        Path | None, typer.Option(help="Measure the ends against this structure too.")
    ] = None,
    solvent: Solvent = "obc2",
    forcefield: Forcefield = "amber14",
    hinges: Hinges = "phi psi chi",
    engine: Engine = "auto",
    tolerance: Tolerance = 1.0,
    max_evaluations: MaxEvaluations = 5000,
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
    """Minimise one structure by several methods; write tables, plots, structures and report.html."""
    from protochain.analysis import compare as run
    from protochain.minimisers.api import Minimisation
    from protochain.minimisers.recipes import recipe_of
    from protochain.storage import check_writable
    from protochain.structure import load

    chosen = tuple(dict.fromkeys(name.strip() for name in methods.split(",")))
    for method in chosen:
        Minimisation(recipe_of(method), tolerance, max_evaluations)
    taken = reading(model, altloc, keep, disulfide, no_disulfide, ph, strict)
    output = output or Path(f"{named_after(source)[0]}-comparison")
    # A name with the method's added cannot be the input's own.
    check_writable(output / "report.html")
    known = load(reference) if reference else None
    chain, energy, preparation = prepare(
        source, taken, hinges, forcefield, solvent, engine, threads, trust_forcefield
    )
    context.with_resource(held_interrupts())
    with ExitStack() as shown:

        def watch(method: str) -> "Watcher":
            shown.close()
            return shown.enter_context(progress(method, max_evaluations))

        comparison = run(
            chain,
            chosen,
            energy,
            tolerance,
            max_evaluations,
            seed,
            reference=known,
            repeats=repeats,
            watch=watch,
        )
    comparison = replace(comparison, origin={"input": str(source), "seconds_preparation": preparation})
    page = comparison.report(output)
    summary = comparison.summary()
    missing = chosen[len(comparison.solutions) :]
    if missing:
        print(f"protochain: interrupted: {', '.join(missing)} left out", file=sys.stderr)
    if as_json:
        print(json.dumps(summary | {"output": str(output)}, allow_nan=False))
    else:
        print_table(summary["results"])
        print(f"written: {page} and the tables, plots and structures beside it")
    if not any(solution.is_usable for solution in comparison.solutions):
        raise SystemExit(fail(f"{source}: no method made anything usable; the page says why"))
    converged = all(solution.status == "converged" for solution in comparison.solutions)
    raise typer.Exit(CONVERGED if converged else UNCONVERGED)
