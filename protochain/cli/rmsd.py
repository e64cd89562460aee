"""``protochain rmsd``."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from protochain.chains.setup import Setup
from protochain.cli import frames as of_frames
from protochain.cli.frames import Chosen, Resume, Trajectory, Workers
from protochain.cli.options import AsJson, check_outputs
from protochain.cli.rows import Rows, conclude, print_rows, refusal_row

if TYPE_CHECKING:
    from protochain.batches.frame_tasks import Task


def rmsd(
    context: typer.Context,
    reference: Annotated[
        Path, typer.Argument(metavar="REFERENCE", help="PDB or mmCIF file. - is standard input.")
    ],
    models: Annotated[
        list[Path], typer.Argument(metavar="IN...", help="Files, with all their models. - is standard input.")
    ],
    align: Annotated[
        str, typer.Option(help="Atoms to superpose, in MDAnalysis's selection language.")
    ] = "name CA",
    measure: Annotated[
        str | None, typer.Option(help="Atoms for the RMSD [default: the superposed atoms].")
    ] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="CSV to write.")] = None,
    trajectory: Trajectory = None,
    frames: Chosen = None,
    workers: Workers = None,
    resume: Resume = False,
    as_json: AsJson = False,
) -> None:
    """Measure RMSD, TM-score and, of complexes, DockQ of models to a reference.

    Files may have only C-alpha atoms. Chains may be in any order and have any names. For frames of one file,
    write a CSV with a row for each frame.
    """
    from protochain.comparison.deviation import rmsd_table

    measure = measure or align

    def task() -> "Task":
        from protochain.batches.frame_tasks import RmsdFrames
        from protochain.structure.matching import structure_to_measure

        return RmsdFrames(structure_to_measure(reference), align, measure)

    of_frames.run_if_requested(
        context, models, trajectory, frames, Setup(), task, output,
        workers=workers, resume=resume, as_json=as_json, reads=[reference],
    )  # fmt: skip
    if output:
        check_outputs([reference, *models], [output])
    table = rmsd_table(reference, models, align, measure)
    rows = json.loads(table.to_json(orient="records", double_precision=15))
    for row in rows:
        if row["message"]:
            refusal_row(row["message"])
    tables = {output: lambda: table}
    conclude(rows, tables, print_deviations, as_json, reference=str(reference), align=align, measure=measure)


def print_deviations(rows: Rows) -> None:
    """Print a row for each model."""
    from protochain.comparison.docking import HEADINGS

    quality = {key: shown for key, shown in HEADINGS.items() if any(row.get(key) is not None for row in rows)}
    headings = ("file", "model", "RMSD angstrom", "TM-score", "matched residues", "chains")
    print_rows([*headings, *quality.values()], [
        (
            row["file"], f"{row['model']:.0f}", f"{row['rmsd_angstrom']:.3f}",
            None if row["tm_score"] is None else f"{row['tm_score']:.4f}",
            f"{row['matched_residues']:.0f} ({100 * row['coverage']:.0f} %) by {row['matched_by']}",
            row["chain_mapping"], *(row.get(key) for key in quality),
        )
        for row in rows
    ])  # fmt: skip
