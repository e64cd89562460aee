"""``protochain compare``."""

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from protochain.chains.setup import Setup
from protochain.cli import options
from protochain.cli.lines import Kind, tell, with_detail
from protochain.cli.terminal import foretell, print_table, run_progress, typical_evaluations
from protochain.core import defaults
from protochain.core.checks import at_least, words
from protochain.core.interrupts import held_interrupts
from protochain.minimisers.minimise_settings import MinimiseSettings

if TYPE_CHECKING:
    from protochain.core.arrays import Watcher


_NOT_COMPARED = "tolerance restraints max_rmsd"
"""Settings of a minimisation that a comparison does not have, or for which it has another default."""


@with_detail
@options.with_settings(minimising=_NOT_COMPARED, setup="move rigid_protein")
def compare(
    context: typer.Context,
    source: options.Input,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="DIR", help="Folder [default: NAME-comparison].")
    ] = None,
    methods: Annotated[str, typer.Option(help="Methods, separated by commas.")] = ",".join(defaults.COMPARED),
    repeats: Annotated[
        int, typer.Option(help="Runs of each method that is not deterministic.")
    ] = defaults.REPEATS,
    reference: Annotated[Path | None, typer.Option(help="Also compare the ends with this structure.")] = None,
    tolerance: Annotated[
        float,
        typer.Option(
            help="Largest torque (kJ/mol/rad) at convergence, or RMS force (kJ/mol/nm) if all atoms move."
        ),
    ] = defaults.TOLERANCE,
    figure: options.FigureFile = None,
    as_json: options.AsJson = False,
    force: Annotated[bool, typer.Option("--force", help="Replace the comparison in DIR.")] = False,
    *,
    minimising: MinimiseSettings,
    setup: Setup,
) -> None:
    """Minimise one structure by several methods. Write tables, plots, structures and report.html."""
    from protochain.comparison import compare as run
    from protochain.comparison.comparing import SETTINGS
    from protochain.comparison.folder import check_folder, files_of
    from protochain.core.storage import claim_folder
    from protochain.results.figures import check_figure, write_figure
    from protochain.structure import load

    limit = minimising.max_evaluations
    chosen = _check_methods(methods, tolerance, limit)
    at_least(1)(repeats, "repeats")
    output = output or Path(f"{options.named_after(source)[0]}-comparison")
    check_folder(output, force)
    check_figure(figure)
    outputs = [*files_of(output, options.named_after(source)[0], chosen), figure]
    options.check_outputs([source, reference], outputs, setup, new=[] if force else outputs[:-1])
    context.with_resource(claim_folder(output, "comparison"))
    reference_structure = load(reference) if reference else None
    chain, energy, preparation = options.prepare(source, setup)
    typical = sum(typical_evaluations(method, limit) for method in chosen)
    foretell(chain, energy, typical, len(chosen) * limit)
    context.with_resource(held_interrupts())
    with _one_bar_each(limit, tolerance) as watch:
        comparison = run(
            chain, chosen, energy, tolerance, reference=reference_structure, repeats=repeats, watch=watch,
            **{name: value for name, value in vars(minimising).items() if name in SETTINGS},
        )  # fmt: skip
    comparison = replace(comparison, origin={"input": str(source), "seconds_preparation": preparation})
    page = comparison.report(output)
    if figure:
        write_figure(figure, comparison.plot_energy)
    summary = comparison.summary()
    missing = chosen[len(comparison.solutions) :]
    if missing:
        print(f"protochain: interrupted before {', '.join(missing)}", file=sys.stderr)
    if as_json:
        options.print_json(summary | {"output": str(output)})
    else:
        print_table(summary["results"])
        options.print_lost(summary["results"])
        tell(Kind.WRITTEN, f"written: {page} with tables, plots and structures in its folder")
        options.print_files(figure)
    if not any(solution.is_usable for solution in comparison.solutions):
        raise SystemExit(options.fail(f"{source}: no method returned a usable structure. See {page}"))
    statuses = [str(solution.status) for solution in comparison.solutions]
    raise typer.Exit(options.exit_status(statuses, interrupted=bool(missing)))


def _check_methods(methods: str, tolerance: float, max_evaluations: int) -> tuple[str, ...]:
    """Names of methods, without duplicates. Raise if settings are invalid for one of them."""
    from protochain.minimisers.minimise_structure import Minimisation
    from protochain.minimisers.recipes import recipe_of

    chosen = tuple(dict.fromkeys(words(methods)))
    for method in chosen:
        Minimisation(recipe_of(method), tolerance=tolerance, max_evaluations=max_evaluations)
    return chosen


@contextmanager
def _one_bar_each(max_evaluations: int, tolerance: float) -> Iterator[Callable[[str], "Watcher"]]:
    """Show the bar of one method at a time, as a terminal draws only one."""
    with ExitStack() as shown:

        def watch(method: str) -> "Watcher":
            shown.close()
            return shown.enter_context(run_progress(method, max_evaluations, tolerance))

        yield watch
