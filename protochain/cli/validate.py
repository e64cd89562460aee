"""``protochain validate``."""

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from protochain.chains.setup import Setup
from protochain.cli import frames as of_frames
from protochain.cli.frames import Chosen, Resume, Trajectory, Workers
from protochain.cli.options import AsJson, Inputs, check_outputs, check_page, files_of, with_settings
from protochain.cli.rows import Rows, concatenate, conclude, print_rows, refusal_row, table_of
from protochain.core.errors import ProtochainError
from protochain.core.lazy_pandas import pd
from protochain.core.markup import plural

if TYPE_CHECKING:
    from protochain.batches.frame_tasks import Task
    from protochain.comparison.differences import Differences
    from protochain.structure import Structure
    from protochain.validation import Validation

_LISTS = ["findings", "ligands", "nucleotides", "changes", "bonds_changed"]
"""Entries of the JSON of a structure that are not in tables."""
_SHOWN = 10  # Listed residues of each structure. The tables have all.


@with_settings(
    setup="hinges move rigid_protein forcefield solvent salt engine device cutoff accuracy threads "
    "trust_forcefield terms calculator ligand_charges"
)
def validate(
    context: typer.Context,
    inputs: Inputs,
    reference: Annotated[
        Path | None, typer.Option(help="Structure to compare with: lDDT, TM-score and RMSDs to it.")
    ] = None,
    csv: Annotated[Path | None, typer.Option(help="CSV to write: a row for each structure.")] = None,
    residues: Annotated[
        Path | None, typer.Option(help="CSV to write: a row for each residue of each structure.")
    ] = None,
    posebusters: Annotated[
        bool, typer.Option("--posebusters", help="Run PoseBusters' tests on ligands, in seconds for each.")
    ] = False,
    changes: Annotated[
        Path | None,
        typer.Option(help="CSV to write: torsions, rotamers and motion of each residue from the reference."),
    ] = None,
    trajectory: Trajectory = None,
    frames: Chosen = None,
    workers: Workers = None,
    resume: Resume = False,
    report: Annotated[Path | None, typer.Option(help="Page to write, of one structure or of frames.")] = None,
    as_json: AsJson = False,
    *,
    setup: Setup,
) -> None:
    """Report errors and outliers in structures.

    These are violations, clashes, cis and twisted peptide bonds, and others. Heavy atoms of the file are
    measured. Missing heavy atoms and hydrogens are added first. For frames of one file, write a row for each
    frame to --csv.
    """
    from protochain.structure.matching import structure_to_measure

    def task() -> "Task":
        from protochain.batches.frame_tasks import ValidateFrames

        return ValidateFrames(setup, structure_to_measure(reference) if reference else None)

    of_frames.run_if_requested(
        context, inputs, trajectory, frames, setup, task, csv, excluded="residues changes posebusters",
        alone="workers resume", report=report, workers=workers, resume=resume, as_json=as_json,
        reads=[reference] if reference else [],
    )  # fmt: skip
    files = files_of(inputs, setup)
    check_page(report)
    if report and len(files) > 1:
        raise ProtochainError("--report requires one structure, or frames")
    check_outputs([reference, *(path for _, path, _ in files)], [csv, residues, changes, report], setup)
    if changes and not reference:
        raise ProtochainError("--changes requires --reference")
    compared = structure_to_measure(reference) if reference else None
    rows: Rows = []
    notes: dict[str, list[str]] = {}
    of_residues: list[pd.DataFrame] = []
    change_tables: list[pd.DataFrame] = []
    # Structures are not stored, as there may be thousands.
    for name, result in _validate_files(files, compared, posebusters):
        if isinstance(result, ProtochainError):
            rows.append(refusal_row(result, file=name))
            continue
        if report:
            from protochain.comparison.validated import write_validated

            write_validated(result, report)
        change: Differences | None = None
        if changes:
            from protochain.comparison.differences import differences

            change = differences(reference, result.structure)
        rows.append({"file": name, **_row(result, change)})
        remarks = (result.posebusters_missing, repr(change).strip("<>") if change else "")
        notes[name] = [*map(str, result.ligands), *filter(None, remarks)]
        origin: dict[str, Any] = {"file": name, "model": result.structure.model_number}
        if residues:
            of_residues.append(result.residues.assign(**origin))
        if change:
            change_tables.append(change.residues.assign(**origin))
    tables = {
        csv: lambda: table_of(rows, _LISTS),
        residues: lambda: concatenate(of_residues),
        changes: lambda: concatenate(change_tables),
    }
    compared_with = str(reference) if reference else None
    pages = [report] if report and notes else []
    conclude(rows, tables, partial(_print, notes), as_json, pages, reference=compared_with)


def _row(result: "Validation", between: "Differences | None") -> dict[str, Any]:
    """JSON of a structure. Its lists are not in the table."""
    row = {
        **result.record(), "added": result.added, "findings": result.listing(), "message": "",
        "ligands": [ligand.record() for ligand in result.ligands],
        "nucleotides": result.nucleotide_table.to_dict("records"),
    }  # fmt: skip
    if between:
        row |= {"changes": dict(between.totals), "bonds_changed": between.bonds.to_dict("records")}
    return row


def _validate_files(
    files: Sequence[tuple[str, Path, Setup]], reference: "Structure | None", posebusters: bool
) -> Iterator[tuple[str, "Validation | ProtochainError"]]:
    """Yield the name and the validation of each structure, or the error."""
    from protochain.validation import validate

    for name, path, file_setup in files:
        title = f"{name}, model {file_setup.model}" if file_setup.model is not None else name
        try:
            yield title, validate(file_setup.load(path), reference, posebusters)
        except ProtochainError as error:
            yield title, error


def _print(notes: Mapping[str, Sequence[str]], rows: Rows) -> None:
    """Print the numbers of all structures, then ligands and residues as text."""
    from protochain.validation import LIKENESS, MEASURES

    tables = [{key: measure.heading for key, measure in MEASURES.items() if measure.heading}]
    if LIKENESS.keys() & rows[0].keys():
        tables.append({key: heading for key, (heading, _) in LIKENESS.items()})
    for shown in tables:
        cells = ([Path(row["file"]).name, *(row[key] for key in shown)] for row in rows)
        print_rows(["file", *shown.values()], cells)
    legend = "; ".join(f"{title}: {MEASURES[key].what}" for key, title in tables[0].items())
    print(*textwrap.wrap(legend, 80), sep="\n")
    for row in rows:
        lines = row["findings"]
        further = f"and {plural(len(lines) - _SHOWN, 'more residue')}; --residues FILE lists all"
        mapping = row.get("chain_mapping") if row["n_chains"] > 1 else None
        chains = mapping and f"chains of the reference and their match: {mapping}"
        parts = [row["added"], chains, *notes[row["file"]], *lines[:_SHOWN], len(lines) > _SHOWN and further]
        if any(parts):
            print(f"{row['file']}:", *filter(None, parts), sep="\n  ")
