"""``protochain score``."""

from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from protochain.chains.setup import Setup
from protochain.cli import frames as of_frames
from protochain.cli import options
from protochain.cli.frames import Chosen, Resume, Trajectory
from protochain.cli.lines import Kind, is_verbose, tell, warn, with_detail
from protochain.cli.rows import Rows, concatenate, conclude, print_rows, refusal_row, table_of
from protochain.core.checks import refuse_unknown
from protochain.core.errors import Argument, ProtochainError
from protochain.core.markup import plural
from protochain.core.optional_libraries import library

if TYPE_CHECKING:
    from protochain.batches.frame_tasks import Task
    from protochain.structure import Structure
    from protochain.validation import Interface

_SHOWN = {
    "energy_kj_mol": "energy", "buried_area_angstrom2": "area", "shape_complementarity": "Sc",
    "hydrogen_bonds": "H bonds", "salt_bridges": "salt", "packing": "pack.",
    "unsatisfied_polar_atoms": "unsat.", "clashes": "clashes", "contacts": "contacts",
    "interface_plddt": "pLDDT", "iptm": "ipTM", "pae_angstrom": "PAE",
    "ipsae": "ipSAE", "pdockq": "pDockQ", "pdockq2": "pDockQ2",
}  # fmt: skip
"""Columns of the terminal, in kJ/mol and square angstrom. Columns of a reference follow."""
_OTHER_PROGRAMS = {
    "dG": "energy_kj_mol", "dSASA": "buried_area_angstrom2", "ShapeComplementarity": "shape_complementarity",
    "PackStat": "packing", "n_InterfaceHbonds": "hydrogen_bonds", "i_pTM": "iptm", "i_pAE": "pae_angstrom",
}  # fmt: skip
"""Columns by the names of InterfaceAnalyzer and BindCraft, for ``--rank``."""


@with_detail
@options.with_settings(setup="hinges root move rigid_protein engine device terms calculator")
def score(
    context: typer.Context,
    inputs: options.Inputs,
    interface: Annotated[
        list[str] | None,
        typer.Option(
            metavar="A,B:C",
            help="Two sides, as chains or selections. Repeat for more [default: all chains in contact].",
        ),
    ] = None,
    rank: Annotated[
        str | None,
        typer.Option(metavar="COLUMN", help="Column to sort by, the best first: energy, ipTM, DockQ."),
    ] = None,
    csv: Annotated[Path | None, typer.Option(help="CSV to write: a row for each interface.")] = None,
    residues: Annotated[
        Path | None, typer.Option(help="CSV to write: a row for each residue of each interface.")
    ] = None,
    report: Annotated[
        Path | None, typer.Option(help="Page of the table, and residues coloured by their share (FILE.html).")
    ] = None,
    workers: Annotated[
        int | None, typer.Option(help="Processes for several files [default: all cores].")
    ] = None,
    relax: Annotated[
        bool, typer.Option("--relax", help="Relax each complex first, like protochain relax.")
    ] = False,
    reference: Annotated[
        Path | None, typer.Option(help="Complex to compare with: DockQ, lDDT, RMSDs of sides and ligands.")
    ] = None,
    trajectory: Trajectory = None,
    frames: Chosen = None,
    resume: Resume = False,
    as_json: options.AsJson = False,
    *,
    setup: Setup,
) -> None:
    """Score the interfaces of complexes.

    Scores are energy, area, bonds, shape complementarity, clashes and confidence. Only missing atoms are
    added to complexes. Relax them first, or with --relax. For frames of one complex, write a CSV with a row
    for each frame.
    """
    from protochain.batches.cluster import Processes
    from protochain.chains.contacts import overlapping
    from protochain.structure.matching import structure_to_measure

    if reference:
        library("peppr", "quality")
    reads = [reference] if reference else []

    def task() -> "Task":
        from protochain.batches.frame_tasks import ScoreFrames

        if len(interface or ()) > 1:
            raise ProtochainError("frames: give one ", Argument("interface"))
        origin = structure_to_measure(reference, setup.keep) if reference else None
        return ScoreFrames(setup, interface[0] if interface else None, relax, origin)

    of_frames.run_if_requested(
        context, inputs, trajectory, frames, setup, task, csv, excluded="rank residues report",
        alone="resume", workers=workers, resume=resume, as_json=as_json, reads=reads,
    )  # fmt: skip
    ranking = None if rank is None else _column(rank, reference)
    options.check_page(report)
    files = options.files_of(inputs, setup)
    options.check_outputs([*reads, *(path for _, path, _ in files)], [csv, residues, report], setup)
    # Another process cannot read the standard input of this one.
    alone = len(files) == 1 or any(str(path) == "-" for _, path, _ in files)
    if alone:
        options.refuse(context, "workers", "applies to several files, none of them standard input")
    processes = None if alone else Processes(workers, threads=setup.threads or 1)
    with nullcontext() if processes is None else processes.started_early():
        from protochain.batches.scoring import ScoreJob, score_files

        origin = structure_to_measure(reference, setup.keep) if reference else None
        jobs = [ScoreJob(*entry, (*(interface or ()),), relax, origin) for entry in files]
        results = score_files(jobs, processes)
    # Rows with their interfaces, or with the reason for a missing one.
    pairs: list[tuple[dict[str, Any], Interface | None]] = [
        (refusal_row(result, file=name), None)
        if isinstance(result, str)
        else ({"file": name, **result.record(), "message": ""}, result)
        for name, result in results
    ]
    if ranking:
        pairs.sort(key=lambda entry: _place(entry[0].get(ranking[0]), ranking[1]))
    rows, usable = [row for row, _ in pairs], [(row, scores) for row, scores in pairs if scores]
    rank = ranking and ranking[0]
    if usable and rank and all(row[rank] is None for row, _ in usable):
        warn([f"no interface has {rank}, so that the order is as read"])
    structures = {id(scores.structure): (Path(row["file"]), scores.structure) for row, scores in usable}
    warnings = [
        f"{structure.name}: {plural(n, 'pair')} of atoms overlap{'s' * (n == 1)}, energies are meaningless. "
        "Relax first, with --relax"
        for _, structure in structures.values()
        if (n := len(overlapping(structure, structure.positions)[0]))
    ]
    _print_changes([*structures.values()], warnings)
    of_residues = [scores.residues.assign(file=row["file"], interface=scores.name) for row, scores in usable]
    if report:
        from protochain.comparison.scored import write_scored

        write_scored([scores for _, scores in usable], [row for row, _ in usable], report, setup, rank or "")
    conclude(
        rows, {csv: lambda: table_of(rows), residues: lambda: concatenate(of_residues)}, _print, as_json,
        [report] if report else [], not warnings, interface=interface, rank=rank, solvent=setup.solvent_label,
        forcefield=setup.forcefield,
    )  # fmt: skip


def _print_changes(structures: Sequence[tuple[Path, "Structure"]], warnings: Sequence[str]) -> None:
    """Print the changes of one complex. Of several, print the changes that need action."""
    from protochain.structure.molecule.repairs import needs_action, summarise

    if len(structures) == 1:
        options.print_changes(*structures[0], warnings=warnings)
        return
    changed = [(name, structure.repairs) for name, structure in structures if structure.repairs]
    if changed and not is_verbose():
        tell(Kind.READ, f"{len(changed)} of {len(structures)} structures changed; --verbose lists changes")
    changes = [
        f"{name}: {change}"
        for name, repairs in changed
        for change in summarise(repairs if is_verbose() else filter(needs_action, repairs), options.as_option)
    ]
    if is_verbose():
        tell(Kind.CHANGE, *changes)
        changes.clear()
    warn([*changes, *warnings])


def _column(name: str, reference: Path | None) -> tuple[str, int]:
    """Key of a column by its key, heading or name in other programs, and whether more is better."""
    from protochain.comparison.docking import DOCKING, HEADINGS
    from protochain.validation.interface import CONFIDENCES, MAKEUP, SCORES

    columns = {**SCORES, **MAKEUP, **CONFIDENCES, **DOCKING}
    headings = {shown: key for key, shown in {**_SHOWN, **HEADINGS}.items()} | _OTHER_PROGRAMS
    keys = {text.lower(): key for text, key in [*headings.items(), *((key, key) for key in columns)]}
    if name.lower() not in keys:
        refuse_unknown(name, "rank", [*headings, *columns])
    key = keys[name.lower()]
    if key in DOCKING and reference is None:
        raise ProtochainError(Argument("rank"), f" {name} requires ", Argument("reference"))
    return key, columns[key].better


def _place(value: Any, better: int) -> tuple[bool, float]:
    """Sort key of a ranking: the best first, missing values last."""
    return value is None, -(better or 1) * (value or 0.0)


def _print(rows: Rows) -> None:
    from protochain.comparison.docking import HEADINGS

    columns = {**_SHOWN, **HEADINGS}
    shown = {key: stated for key, stated in columns.items() if any(row.get(key) is not None for row in rows)}
    # Predictors call many models by one name, in folders of their designs.
    is_unique = len({Path(row["file"]).name for row in rows}) == len({row["file"] for row in rows})
    cells = (
        [Path(row["file"]).name if is_unique else row["file"], row["interface"], *(row[key] for key in shown)]
        for row in rows
    )
    print_rows(["file", "sides", *shown.values()], cells, texts=2)
    tell(Kind.RESULT, "energies in kJ/mol, areas in square angstrom; --csv and --json have all columns")
