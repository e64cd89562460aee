"""``protochain validate``."""

import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from protochain.cli.options import BAD_INPUT, CONVERGED, AsJson, check_outputs, with_setup
from protochain.errors import ProtochainError
from protochain.setup import Setup

if TYPE_CHECKING:
    from protochain.structure import Structure
    from protochain.validation import Validation

_SHOWN = 10
"""Residues listed of each structure; the tables have all."""


@with_setup(without="hinges move forcefield solvent engine threads trust_forcefield")
def validate(
    inputs: Annotated[
        list[str], typer.Argument(metavar="IN...", help="Files, folders or patterns; - is standard input.")
    ],
    reference: Annotated[
        Path | None, typer.Option(help="Structure to compare with: lDDT, TM-score and RMSDs to it.")
    ] = None,
    csv: Annotated[
        Path | None, typer.Option("--csv", "-o", help="CSV to write: a row for each structure.")
    ] = None,
    residues: Annotated[
        Path | None, typer.Option(help="CSV to write: a row for each residue of each structure.")
    ] = None,
    as_json: AsJson = False,
    *,
    setup: Setup,
) -> None:
    """Say what is wrong with structures: violations, clashes, outliers, cis and twisted peptide bonds.

    Heavy atoms are measured where the file has them; those that are missing, and hydrogens, are added first.
    """
    from protochain.storage import write_atomically
    from protochain.structure.matching import measurable

    outputs = [path for path in (csv, residues) if path]
    if outputs:
        check_outputs(Path(inputs[0]), outputs, force=False)
    compared = measurable(reference) if reference else None
    done: list[tuple[str, Validation]] = []
    rows: list[dict[str, Any]] = []
    for name, result in _validated(inputs, setup, compared):
        if isinstance(result, ProtochainError):
            print(result, file=sys.stderr)
            rows.append({"file": name, "message": str(result)})
            continue
        done.append((name, result))
        rows.append({"file": name, **result.record(), "message": ""})
    if outputs:
        import pandas as pd
    if csv:
        table = pd.DataFrame(rows).convert_dtypes()
        write_atomically(csv, lambda to: table.to_csv(to, index=False))
    if residues:
        every = [each.residues.assign(file=name, model=each.structure.model_number) for name, each in done]
        whole = pd.concat(every) if every else pd.DataFrame()
        write_atomically(residues, lambda to: whole.to_csv(to, index=False))
    if as_json:
        said = {name: {"added": each.added, "findings": each.listing()} for name, each in done}
        results = [row | said.get(row["file"], {}) for row in rows]
        print(json.dumps({"reference": str(reference) if reference else None, "results": results}))
    elif done:
        _print(done)
    raise typer.Exit(CONVERGED if len(done) == len(rows) else BAD_INPUT)


def _validated(
    inputs: Sequence[str], setup: Setup, reference: "Structure | None"
) -> Iterator[tuple[str, "Validation | ProtochainError"]]:
    """Name and validation of each structure, or why there is none."""
    from protochain.batches.jobs import BatchSettings, find_jobs
    from protochain.validation import validate

    given = [each for each in inputs if each != "-"]
    jobs = find_jobs(given, BatchSettings(setup=setup)) if given else []
    of_file = [(_name(job.path), job.path, job.settings.setup) for job in jobs]
    if len(given) < len(inputs):
        of_file.append(("standard input", Path("-"), setup))
    for name, path, own in of_file:
        named = f"{name}, model {own.model}" if own.model is not None else name
        try:
            yield named, validate(own.load(path), reference)
        except ProtochainError as error:
            yield named, error


def _name(path: Path) -> str:
    """Path as a user would write it: relative to the folder he is in, if it lies there."""
    return str(path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path)


def _print(done: Sequence[tuple[str, "Validation"]]) -> None:
    """Print the numbers of all structures, then the residues concerned in words."""
    from rich.console import Console

    from protochain.validation import LIKENESS, MEASURES

    console = Console()
    headings = {key: measure.heading for key, measure in MEASURES.items() if measure.heading}
    console.print(_table(done, headings), crop=False)
    if set(LIKENESS) & set(done[0][1].measures):
        console.print(_table(done, {key: heading for key, (heading, _) in LIKENESS.items()}), crop=False)
    for name, each in done:
        lines = each.listing()
        more = [f"and {len(lines) - _SHOWN} more residues; --residues FILE lists all"] * (len(lines) > _SHOWN)
        told = [f"  {line}" for line in [*filter(None, [each.added]), *lines[:_SHOWN], *more]]
        for line in [f"{name}:", *told] if told else []:
            console.print(line, markup=False, highlight=False, soft_wrap=True)


def _table(done: Sequence[tuple[str, "Validation"]], headings: dict[str, str]) -> Any:
    from rich.markup import escape
    from rich.table import Table

    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column("file", overflow="fold", min_width=14)
    for heading in headings.values():
        table.add_column(heading, justify="right")
    for name, each in done:
        table.add_row(escape(Path(name).name), *(_number(each.measures[key]) for key in headings))
    return table


def _number(value: Any) -> str:
    return (
        "-"
        if value is None
        else f"{value:.2f}"
        if isinstance(value, float) and value < 10
        else f"{value:.0f}"
    )
