"""``protochain validate``."""

import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from protochain.cli import frames as of_frames
from protochain.cli.frames import Chosen, Resume, Trajectory, Workers
from protochain.cli.options import (
    AsJson,
    check_outputs,
    exit_status,
    files_of,
    inputs_of,
    named_after,
    print_files,
    print_json,
    refuse,
    with_settings,
)
from protochain.cli.printable import printer
from protochain.core.errors import ProtochainError
from protochain.core.markup import counted
from protochain.setup import Setup

if TYPE_CHECKING:
    from pandas import DataFrame
    from rich.table import Table

    from protochain.structure import Structure
    from protochain.validation import Validation

_LISTS = ["findings", "ligands", "nucleotides", "changes", "bonds_changed"]
"""What JSON has of a structure, and a table of many cannot."""
_SHOWN = 10
"""Residues listed of each structure; the tables have all."""


@with_settings(
    setup="hinges move rigid_protein forcefield solvent engine cutoff accuracy precision threads "
    "trust_forcefield terms ligand_charges"
)
def validate(
    context: typer.Context,
    inputs: Annotated[
        list[str], typer.Argument(metavar="IN...", help="Files, folders or patterns; - is standard input.")
    ],
    reference: Annotated[
        Path | None, typer.Option(help="Structure to compare with: lDDT, TM-score and RMSDs to it.")
    ] = None,
    csv: Annotated[Path | None, typer.Option(help="CSV to write: a row for each structure.")] = None,
    residues: Annotated[
        Path | None, typer.Option(help="CSV to write: a row for each residue of each structure.")
    ] = None,
    posebusters: Annotated[
        bool, typer.Option("--posebusters", help="Run PoseBusters' tests on ligands; seconds for each.")
    ] = False,
    changes: Annotated[
        Path | None,
        typer.Option(help="CSV to write: torsions, rotamers and motion of each residue from the reference."),
    ] = None,
    trajectory: Trajectory = None,
    frames: Chosen = None,
    workers: Workers = None,
    resume: Resume = False,
    report: Annotated[Path | None, typer.Option(help="Of frames: page of distributions, FILE.html.")] = None,
    as_json: AsJson = False,
    *,
    setup: Setup,
) -> None:
    """Say what is wrong with structures: violations, clashes, outliers, cis and twisted peptide bonds.

    Heavy atoms are measured where the file has them; those that are missing, and hydrogens, are added first.
    Of frames of one file, a row for each goes to --csv.
    """
    from protochain.core.storage import write_atomically
    from protochain.structure.matching import measurable

    if of_frames.are_asked(trajectory, frames):
        refuse(context, "residues changes posebusters", "is none of frames")
        ways: dict[str, Any] = {
            "csv": csv,
            "report": report,
            "workers": workers,
            "resume": resume,
            "as_json": as_json,
        }
        with of_frames.started_early(setup, workers):
            status = _frames(inputs, trajectory, frames, reference, setup, **ways)
        raise typer.Exit(status)
    of_frames.refuse_without(context, "workers resume report")

    outputs = [path for path in (csv, residues, changes) if path]
    files = files_of(inputs, setup)
    check_outputs(inputs_of(setup, reference, *(path for _, path, _ in files)), outputs)
    if changes and not reference:
        raise ProtochainError(f"changes {changes}: changes are from a reference; give one")
    compared = measurable(reference) if reference else None
    rows: list[dict[str, Any]] = []
    tables: list[DataFrame] = []
    changed: list[DataFrame] = []
    notes: dict[str, list[str]] = {}
    # Structures are not kept: there may be thousands.
    for name, result in _validated(files, compared, posebusters):
        if isinstance(result, ProtochainError):
            print(" ".join(str(result).split()), file=sys.stderr)
            rows.append({"file": name, "message": str(result)})
            continue
        told: dict[str, Any] = {
            "added": result.added, "findings": result.listing(), "message": "",
            "ligands": [each.record() for each in result.ligands],
            "nucleotides": result.nucleotide_table.to_dict("records"),
        }  # fmt: skip
        notes[name] = [*map(str, result.ligands), *filter(None, [result.posebusters_missing])]
        if changes:
            from protochain.comparison.differences import differences

            between = differences(reference, result.structure)
            told |= {"changes": dict(between.totals), "bonds_changed": between.bonds.to_dict("records")}
            notes[name].append(repr(between).strip("<>"))
            changed.append(between.residues.assign(file=name, model=result.structure.model_number))
        rows.append({"file": name, **result.record(), **told})
        if residues:
            tables.append(result.residues.assign(file=name, model=result.structure.model_number))
    if outputs:
        import pandas as pd
    if csv:
        table = pd.DataFrame(rows).drop(columns=_LISTS, errors="ignore").convert_dtypes()
        write_atomically(csv, lambda to: table.to_csv(to, index=False))
    if residues:
        every = pd.concat(tables) if tables else pd.DataFrame()
        write_atomically(residues, lambda to: every.to_csv(to, index=False))
    if changes:
        of_all = pd.concat(changed) if changed else pd.DataFrame()
        write_atomically(changes, lambda to: of_all.to_csv(to, index=False))
    done = [row for row in rows if not row["message"]]
    if as_json:
        of = str(reference) if reference else None
        print_json({"reference": of, "results": rows, "files": [*map(str, outputs)]})
    else:
        if done:
            _print(done, notes)
        print_files(*outputs)
    raise typer.Exit(exit_status("refused" if row["message"] else "measured" for row in rows))


def _frames(
    inputs: list[str],
    trajectory: Path | None,
    frames: str | None,
    reference: Path | None,
    setup: Setup,
    csv: Path | None,
    report: Path | None,
    workers: int | None,
    resume: bool,
    as_json: bool,
) -> int:
    """Measure every frame; return the exit status."""
    from protochain.batches.frame_tasks import ValidateFrames
    from protochain.structure.matching import measurable

    source = of_frames.only(inputs)
    task = ValidateFrames(setup, measurable(reference) if reference else None)
    done = of_frames.run(
        source, trajectory, frames, setup, task, csv or Path(f"{named_after(source)[0]}.validated.csv"),
        report=report, workers=workers, resume=resume, force=not resume,
        as_json=as_json, reads=[reference] if reference else [],
    )  # fmt: skip
    return of_frames.status_of(done)


def _validated(
    files: Sequence[tuple[str, Path, Setup]], reference: "Structure | None", posebusters: bool
) -> Iterator[tuple[str, "Validation | ProtochainError"]]:
    """Name and validation of each structure, or why there is none."""
    from protochain.validation import validate

    for name, path, own in files:
        named = f"{name}, model {own.model}" if own.model is not None else name
        try:
            yield named, validate(own.load(path), reference, posebusters)
        except ProtochainError as error:
            yield named, error


def _print(rows: Sequence[dict[str, Any]], notes: Mapping[str, Sequence[str]]) -> None:
    """Print the numbers of all structures, then the ligands and the residues concerned in words."""
    from protochain.validation import LIKENESS, MEASURES

    console = printer()
    headings = {key: measure.heading for key, measure in MEASURES.items() if measure.heading}
    console.print(_table(rows, headings), crop=False)
    if LIKENESS.keys() & rows[0].keys():
        console.print(_table(rows, {key: heading for key, (heading, _) in LIKENESS.items()}), crop=False)
    for row in rows:
        lines = row["findings"]
        more = [f"and {counted(len(lines) - _SHOWN, 'more residue')}; --residues FILE lists all"] * (
            len(lines) > _SHOWN
        )
        mapping = row.get("chain_mapping") if row["n_chains"] > 1 else None
        chains = [f"chains of the reference and their match: {mapping}"] if mapping else []
        told = [
            f"  {line}"
            for line in [*filter(None, [row["added"]]), *chains, *notes[row["file"]], *lines[:_SHOWN], *more]
        ]
        for line in [f"{row['file']}:", *told] if told else []:
            console.print(line, markup=False, highlight=False, soft_wrap=True)


def _table(rows: Sequence[dict[str, Any]], headings: dict[str, str]) -> "Table":
    from rich.markup import escape
    from rich.table import Table

    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column("file", overflow="fold", min_width=14)
    for heading in headings.values():
        table.add_column(heading, justify="right")
    for row in rows:
        table.add_row(escape(Path(row["file"]).name), *(_number(row[key]) for key in headings))
    return table


def _number(value: Any) -> str:
    return (
        "-"
        if value is None
        else f"{value:.2f}"
        if isinstance(value, float) and value < 10
        else f"{value:.0f}"
    )
