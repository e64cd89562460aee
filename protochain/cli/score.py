"""``protochain score``."""

import sys
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from protochain.cli.options import (
    AsJson,
    check_outputs,
    exit_status,
    files_of,
    inputs_of,
    print_files,
    print_json,
    refuse,
    with_settings,
)
from protochain.cli.printable import printer
from protochain.core.checks import refuse_unknown
from protochain.core.errors import ProtochainError
from protochain.setup import Setup

if TYPE_CHECKING:
    from protochain.validation import Interface

_SHOWN = {
    "energy_kj_mol": "energy", "buried_area_angstrom2": "area", "shape_complementarity": "Sc",
    "hydrogen_bonds": "H bonds", "salt_bridges": "salt", "unsatisfied_polar_atoms": "unsat.",
    "clashes": "clashes", "contacts": "contacts",
    "interface_plddt": "pLDDT", "iptm": "ipTM", "pae_angstrom": "PAE",
    "ipsae": "ipSAE", "pdockq": "pDockQ", "pdockq2": "pDockQ2",
}  # fmt: skip
"""Columns of the terminal; kJ/mol and square angstrom."""


@with_settings(setup="hinges root move rigid_protein engine terms")
def score(
    context: typer.Context,
    inputs: Annotated[
        list[str], typer.Argument(metavar="IN...", help="Files, folders or patterns; - is standard input.")
    ],
    interface: Annotated[
        list[str] | None,
        typer.Option(
            metavar="A,B:C",
            help="Its two sides, chains or selections; repeat for more [default: all chains in contact].",
        ),
    ] = None,
    rank: Annotated[
        str | None, typer.Option(metavar="COLUMN", help="Column to sort by, the best first.")
    ] = None,
    csv: Annotated[Path | None, typer.Option(help="CSV to write: a row for each interface.")] = None,
    residues: Annotated[
        Path | None, typer.Option(help="CSV to write: a row for each residue of each interface.")
    ] = None,
    report: Annotated[
        Path | None, typer.Option(help="Page: the table, and residues coloured by their share; FILE.html.")
    ] = None,
    workers: Annotated[
        int | None, typer.Option(help="Of several files: processes [default: all cores].")
    ] = None,
    as_json: AsJson = False,
    *,
    setup: Setup,
) -> None:
    """Score the interfaces of complexes: energy, area, bonds, fit of the surfaces, clashes, confidence.

    Complexes are taken as they are, with what they lack added; relax them first.
    """
    from protochain.batches.cluster import Processes
    from protochain.core.storage import write_atomically
    from protochain.validation.interface import CONFIDENCES, SCORES

    known = {**SCORES, **CONFIDENCES}
    if rank is not None:
        refuse_unknown(rank, "rank", known)
    if report and report.suffix.lower() != ".html":
        raise ProtochainError(f"{report}: give a name that ends in .html")
    files = files_of(inputs, setup)
    outputs = [path for path in (csv, residues, report) if path]
    check_outputs(inputs_of(setup, *(path for _, path, _ in files)), outputs)
    rows: list[dict[str, Any]] = []
    found: list[Interface | None] = []
    # A process cannot read this one's standard input.
    alone = len(files) == 1 or any(str(path) == "-" for _, path, _ in files)
    if alone:
        refuse(context, "workers", "is of several files, none of them standard input")
    processes = None if alone else Processes(workers, threads=setup.threads or 1)
    with nullcontext() if processes is None else processes.started_early():
        from protochain.batches.scoring import ScoreJob, score_files

        results = [*score_files([ScoreJob(*each, (*(interface or ()),)) for each in files], processes)]
    for name, result in results:
        if isinstance(result, str):
            print(" ".join(result.split()), file=sys.stderr)
            rows.append({"file": name, "message": result})
            found.append(None)
        else:
            rows.append({"file": name, **result.record(), "message": ""})
            found.append(result)
    order = _ranked(rows, rank, known[rank].better if rank else 0)
    rows, found = [rows[k] for k in order], [found[k] for k in order]
    done = [row for row in rows if not row["message"]]
    if csv or residues:
        import pandas as pd
    if csv:
        table = pd.DataFrame(rows).convert_dtypes()
        write_atomically(csv, lambda to: table.to_csv(to, index=False))
    if residues:
        tables = [
            each.residues.assign(file=row["file"], interface=each.name)
            for row, each in zip(rows, found, strict=True)
            if each
        ]
        every = pd.concat(tables) if tables else pd.DataFrame()
        write_atomically(residues, lambda to: every.to_csv(to, index=False))
    if report:
        from protochain.comparison.scored import write_scored

        write_scored([each for each in found if each], done, report, setup, rank or "")
    if as_json:
        print_json({
            "interface": interface, "rank": rank, "solvent": setup.solvent, "forcefield": setup.forcefield,
            "results": rows, "files": [*map(str, outputs)],
        })  # fmt: skip
    else:
        if done:
            _print(done)
        print_files(*outputs)
    raise typer.Exit(exit_status("refused" if row["message"] else "measured" for row in rows))


def _ranked(rows: Sequence[Mapping[str, Any]], column: str | None, better: int) -> list[int]:
    """Places of the rows, the best first; those without a number last, the others as they are."""
    if column is None:
        return [*range(len(rows))]
    values = [row.get(column) for row in rows]
    return sorted(range(len(rows)), key=lambda k: (values[k] is None, -(better or 1) * (values[k] or 0.0)))


def _print(rows: Sequence[Mapping[str, Any]]) -> None:
    """Print a row for each interface."""
    from rich.markup import escape
    from rich.table import Table

    shown = {key: said for key, said in _SHOWN.items() if any(row[key] is not None for row in rows)}
    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column("file", overflow="fold", min_width=12)
    table.add_column("sides", overflow="fold")
    for said in shown.values():
        table.add_column(said, justify="right")
    for row in rows:
        numbers = (_number(row[key]) for key in shown)
        table.add_row(escape(Path(row["file"]).name), escape(row["interface"]), *numbers)
    console = printer()
    console.print(table, crop=False)
    console.print("energies in kJ/mol, areas in square angstrom; --csv and --json have all columns")


def _number(value: Any) -> str:
    if not isinstance(value, float):
        return "-" if value is None else str(value)
    return f"{value:.2f}" if abs(value) < 10 else f"{value:.0f}"
