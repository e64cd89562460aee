"""``protochain energy``."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from protochain.chains.setup import Setup
from protochain.cli import frames as of_frames
from protochain.cli import options
from protochain.cli.frames import Chosen, Resume, Trajectory, Workers
from protochain.core.errors import ProtochainError
from protochain.core.lazy_pandas import pd

if TYPE_CHECKING:
    from protochain.batches.frame_tasks import Task

_MOST_ROWS = 25  # Printed rows, with the largest totals.


@options.with_settings(setup="hinges root move rigid_protein engine device terms calculator")
def energy(
    context: typer.Context,
    source: options.Input,
    by: Annotated[str, typer.Option(help="term, residue, or pair of residues.")] = "term",
    between: Annotated[
        str | None,
        typer.Option(metavar="A:1-50,B", help="Interaction of two parts: chains, residues, or selections."),
    ] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="CSV to write.")] = None,
    report: Annotated[
        Path | None, typer.Option(help="Page of residues coloured by any term (FILE.html).")
    ] = None,
    trajectory: Trajectory = None,
    frames: Chosen = None,
    workers: Workers = None,
    resume: Resume = False,
    as_json: options.AsJson = False,
    *,
    setup: Setup,
) -> None:
    """Decompose the energy by term, residue or pair of residues.

    The energy is the total, or between two parts. Only missing atoms are added to structures. Minimise or
    relax them first. For frames, write a CSV with the terms of each frame.
    """
    from protochain.core.storage import write_atomically
    from protochain.energies.decomposed import energy_terms

    options.check_page(report)

    def task() -> "Task":
        from protochain.batches.frame_tasks import EnergyFrames

        return EnergyFrames(setup, between)

    of_frames.run_if_requested(
        context, [source], trajectory, frames, setup, task, output,
        excluded="by report", workers=workers, resume=resume, as_json=as_json,
    )  # fmt: skip
    files = [path for path in (output, report) if path]
    options.check_outputs([source], files, setup)
    structure = setup.load(source)
    energy = setup.energy(structure)
    try:
        table = energy_terms(structure, by, between=between, energy=energy)
    except ProtochainError as error:
        raise ProtochainError(f"{source}: ", *error.parts) from error
    if by == "term":
        table = table.rename_axis("of").reset_index()
    if output:
        write_atomically(output, lambda to: table.to_csv(to, index=False))
    if report:
        from protochain.comparison.energy_page import write_energies

        write_energies(structure, energy, report, between)
    if as_json:
        options.print_json({
            "input": str(source), "by": by, "between": between, "unit": "kJ/mol", "solvent": energy.solvent,
            "forcefield": setup.forcefield, "rows": table.to_dict("records"),
            "files": [*map(str, files)],
        })  # fmt: skip
    else:
        _print(table, by)
        options.print_files(*files)


def _print(table: "pd.DataFrame", by: str) -> None:
    """Print a line for each term, or for residues and pairs the rows with the largest totals."""
    if by == "term":
        shown = table.set_index("of").T
        print(shown[shown.any(axis=1)].rename_axis("kJ/mol").reset_index().to_string(**_FORMAT))
        return
    shown = table.loc[table["total"].abs().nlargest(_MOST_ROWS).index]
    print(shown.loc[:, shown.any()].to_string(**_FORMAT))
    if len(shown) < len(table):
        print(f"{len(shown)} of {len(table)} rows, those of the largest totals; -o and --json have all")


_FORMAT: dict[str, Any] = {"index": False, "float_format": "{:.2f}".format}
