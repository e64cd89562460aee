"""``protochain rmsd``."""

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from protochain.cli import frames as of_frames
from protochain.cli.frames import Chosen, Resume, Trajectory, Workers
from protochain.cli.options import (
    AsJson,
    check_outputs,
    exit_status,
    named_after,
    print_files,
    print_json,
)
from protochain.cli.terminal import print_deviations


def rmsd(
    context: typer.Context,
    reference: Annotated[
        Path, typer.Argument(metavar="REFERENCE", help="PDB or mmCIF file; - is standard input.")
    ],
    models: Annotated[
        list[Path], typer.Argument(metavar="IN...", help="Files, with all their models; - is standard input.")
    ],
    align: Annotated[
        str, typer.Option(help="Atoms to superpose, in MDAnalysis's selection language.")
    ] = "name CA",
    measure: Annotated[
        str | None, typer.Option(help="Atoms for the RMSD [default: those superposed].")
    ] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="CSV to write.")] = None,
    trajectory: Trajectory = None,
    frames: Chosen = None,
    workers: Workers = None,
    resume: Resume = False,
    as_json: AsJson = False,
) -> None:
    """Measure deviations of models from a reference: RMSD, TM-score and matched residues.

    Files of C-alpha atoms only are measured too. Of frames of one file, a row for each goes to a CSV.
    """
    from protochain.comparison.deviation import rmsd_table
    from protochain.core.storage import write_atomically

    if of_frames.are_asked(trajectory, frames):
        whole = {"workers": workers, "resume": resume, "as_json": as_json}
        ends = align, measure or align
        raise typer.Exit(_frames(reference, models, trajectory, frames, *ends, output, whole))
    of_frames.refuse_without(context, "workers resume")
    if output:
        check_outputs([reference, *models], [output])
    table = rmsd_table(reference, models, align, measure or align)
    if output:
        write_atomically(output, lambda to: table.to_csv(to, index=False))
    rows = json.loads(table.to_json(orient="records", double_precision=15))
    for row in rows:
        if row["message"]:
            print(" ".join(row["message"].split()), file=sys.stderr)
    if as_json:
        print_json({
            "reference": str(reference), "align": align, "measure": measure or align, "results": rows,
            "files": [str(output)] if output else [],
        })  # fmt: skip
    else:
        print_deviations(rows)
        print_files(output)
    raise typer.Exit(exit_status("refused" if row["message"] else "measured" for row in rows))


def _frames(
    reference: Path,
    models: list[Path],
    trajectory: Path | None,
    frames: str | None,
    align: str,
    measure: str,
    output: Path | None,
    whole: dict[str, Any],
) -> int:
    """Measure every frame; return the exit status."""
    from protochain.comparison.deviation import RmsdFrames
    from protochain.setup import Setup
    from protochain.structure.matching import measurable

    source = of_frames.only(models)
    task = RmsdFrames(measurable(reference), align, measure)
    table = output or Path(f"{named_after(source)[0]}.rmsd.csv")
    reads, force = [reference], not whole["resume"]
    done = of_frames.run(source, trajectory, frames, Setup(), task, table, reads=reads, force=force, **whole)
    return of_frames.status_of(done)
