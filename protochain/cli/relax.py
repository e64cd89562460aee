"""``protochain relax``."""

import os
import shlex
import sys
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

import typer

from protochain.chains.setup import Setup
from protochain.cli import frames as of_frames
from protochain.cli import options
from protochain.cli.frames import Chosen, Trajectory
from protochain.cli.lines import with_detail
from protochain.core import defaults
from protochain.core.checks import designs
from protochain.core.errors import Argument, ProtochainError
from protochain.relaxation.relax_settings import RelaxSettings

if TYPE_CHECKING:
    from protochain.batches.frame_tasks import RelaxFrames
    from protochain.relaxation import Relaxation

Inputs = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="IN...", help="PDB or mmCIF files, also compressed, folders, patterns. - is standard input."
    ),
]
Output = Annotated[
    Path | None,
    typer.Option(
        "-o",
        "--output",
        help="File, or folder for several inputs [default: NAME.relaxed.pdb, or the folder relaxed].",
    ),
]
Workers = Annotated[
    int | None, typer.Option(help="Processes for several inputs or frames [default: all cores].")
]
TimeLimit = Annotated[float, typer.Option(help="Seconds for each of several inputs or frames.")]
Resume = Annotated[
    bool, typer.Option("--resume", help="Continue an interrupted run of several inputs or frames.")
]


@with_detail
@options.with_settings(setup="hinges terms")
def relax(
    context: typer.Context,
    inputs: Inputs = None,
    output: Output = None,
    manifest: options.Manifest = None,
    report: options.Report = None,
    ligand_out: options.LigandOut = None,
    protein_out: options.ProteinOut = None,
    restraint_csv: options.RestraintCsv = None,
    workers: Workers = None,
    scheduler: options.Scheduler = None,
    time_limit: TimeLimit = defaults.TIME_LIMIT,
    resume: Resume = False,
    trajectory: Trajectory = None,
    frames: Chosen = None,
    timings: options.Timings = False,
    as_json: options.AsJson = False,
    force: options.Force = False,
    *,
    relaxing: RelaxSettings,
    setup: Setup,
) -> None:
    """Remove overlaps and broken bonds from models within their fold.

    Several files, a folder, a pattern, a manifest, one file with several poses (--ligands POSES) or designs
    (--sequence FASTA), or a run on a cluster write a folder with the table relaxed.csv. With --trajectory, or
    --frames of a file with models, every frame is relaxed into one trajectory and a table.

    Poses: protochain relax receptor.pdb --ligand-poses poses.sdf --score-only -o scores
    """
    setup = relaxing.setup(setup)
    options.check_restraint_csv(restraint_csv, relaxing.restraints)
    if protein_out and not setup.poses:
        raise ProtochainError(Argument("protein_out"), " requires --ligands POSES")
    several = manifest or options.has_poses(setup) or isinstance(setup.model, str) or designs(setup.sequence)
    if of_frames.are_requested(trajectory, frames):
        if several:
            exclusive = Argument("manifest"), ", ", Argument("model"), " all or poses"
            options.refuse(context, "trajectory frames", "applies to one structure, not to ", *exclusive)
        if output is None:
            output = _output_of_frames(trajectory or of_frames.single_structure(inputs or []))
        of_frames.run_if_requested(
            context, inputs or [], trajectory, frames, setup, partial(_task, relaxing, setup, output),
            output.with_suffix(".csv"), output=output,
            excluded="scheduler ligand_out protein_out restraint_csv posebusters timings",
            report=report, workers=workers, time_limit=time_limit, resume=resume, force=force,
            hydrogens=relaxing.keep_hydrogens, as_json=as_json,
        )  # fmt: skip
    if inputs and len(inputs) == 1 and options.is_one_file(inputs[0]) and not (several or scheduler):
        options.refuse(context, "workers time_limit resume", f"requires several inputs, not {inputs[0]}")
        shown = report, ligand_out, protein_out, restraint_csv, timings, as_json
        raise typer.Exit(_one(Path(inputs[0]), output, relaxing, setup, *shown, force))
    options.refuse(context, "report", "applies to one structure. Several have report.html in their folder")
    options.refuse(context, "timings restraint_csv", "applies to one structure only")
    if ligand_out and not setup.poses:
        raise ProtochainError(Argument("ligand_out"), " of several structures requires --ligands POSES")
    from protochain.batches.cluster import Processes

    processes: dict[str, Any] = {"workers": workers, "scheduler": scheduler, "time_limit": time_limit}
    processes |= {} if setup.threads is None else {"threads": setup.threads}
    with Processes(**processes).started_early():
        outputs = output, ligand_out, protein_out
        _several(inputs or [], manifest, outputs, relaxing, setup, processes, as_json, resume, force)


def _task(relaxing: RelaxSettings, setup: Setup, output: Path) -> "RelaxFrames":
    """Task that relaxes every frame. Raise if the name of the output is invalid."""
    from protochain.batches.frame_files import check_output
    from protochain.batches.frame_tasks import RelaxFrames

    check_output(output)
    return RelaxFrames(relaxing, setup)


def _output_of_frames(frames: Path) -> Path:
    """Name of the relaxed frames, with the format of the input, or DCD, which does not round."""
    from protochain.relaxation.names import relaxed_name, relaxed_stem
    from protochain.structure.formats.files import format_of
    from protochain.structure.formats.trajectory import FORMATS

    if format_of(frames):
        return Path(relaxed_name(frames))
    suffix = frames.suffix.lower()
    return Path(f"{relaxed_stem(frames.stem)}{suffix if suffix in FORMATS else FORMATS[0]}")


def _one(
    source: Path, output: Path | None, relaxing: RelaxSettings, setup: Setup, report: Path | None,
    ligand_out: Path | None, protein_out: Path | None, restraint_csv: Path | None, timings: bool,
    as_json: bool, force: bool,
) -> int:  # fmt: skip
    """Relax one file. Return the exit status."""
    from protochain.cli.relaxing import print_plan, print_relaxed, progress
    from protochain.cli.terminal import print_timings
    from protochain.core.interrupts import held_interrupts
    from protochain.core.timings import measure_run
    from protochain.relaxation.names import relaxed_name
    from protochain.relaxation.relax_structure import relax_structure
    from protochain.structure.formats.files import suffix_of
    from protochain.structure.write import save_proteins

    if str(source) != "-" and not source.exists():
        raise ProtochainError(f"{source}: not found; check the name")
    output = Path(relaxed_name(source)) if output is None else output
    if output.is_dir():
        output = output / relaxed_name(source)
    options.check_names(output, report, ligand_out, as_json, protein_out)
    if protein_out and str(output) == options.STANDARD_OUTPUT:
        raise ProtochainError(
            Argument("protein_out"), " requires a file for the complex, not standard output"
        )
    extras = [ligand_out, protein_out, restraint_csv]
    new = [] if force else extras
    options.check_outputs([source], [output, report, *extras], setup, force, new=new)
    with measure_run(from_start=True):
        began = perf_counter()
        structure = setup.load(source)
        options.check_structure(structure, output, ligand_out)
        energy = setup.energy(structure)
        preparation = perf_counter() - began
        seconds = print_plan(source, structure, energy, setup.move)
        with held_interrupts():
            with progress(seconds) as watch:
                result = relax_structure(structure, energy, relaxing, watch, setup.move)
            origin = {"input": str(source), "output": str(output), "seconds_preparation": preparation}

            def write() -> None:
                arguments = result.provenance(), relaxing.keep_hydrogens
                options.write_models([result.structure], output, suffix_of(source), *arguments)

            record = options.write_outputs(
                result, origin, write, setup, _write_page, report, ligand_out, restraints=restraint_csv,
                terms=as_json,
            )  # fmt: skip
    if protein_out:
        atoms = [int(ligand.atoms[0]) for ligand in structure.ligands if ligand.posed]
        residues = [structure.residue(int(structure.atom_residue[atom])) for atom in atoms]
        save_proteins([(output, [f"{res.chain}/{res.number}" for res in residues])], protein_out)
    if as_json:
        options.print_json(record)
    else:
        with options.redirect_messages(output):
            print_relaxed(result, record)
            options.print_files(protein_out, restraint_csv)
            if timings:
                print_timings(record)
    return options.UNCONVERGED if "not_written" in record else options.exit_status([record["status"]])


def _write_page(result: "Relaxation", record: dict[str, Any], path: Path) -> None:
    from protochain.comparison.relaxed import write_relaxed

    write_relaxed(result, record, path)


def _report_trajectories(inputs: list[str]) -> None:
    """Report skipped trajectories in folders, with the commands that relax them."""
    from protochain.structure.formats.files import format_of
    from protochain.structure.formats.frames import trajectories

    for folder in filter(os.path.isdir, inputs):
        for path in trajectories(Path(folder)):
            models = [candidate for candidate in path.parent.iterdir() if format_of(candidate)]
            topology = str(models[0]) if len(models) == 1 else "TOPOLOGY"
            command = shlex.join(["protochain", "relax", topology, "--trajectory", str(path)])
            print(f"{path}: is skipped. To relax its frames: {command}", file=sys.stderr)


def _several(
    inputs: list[str], manifest: Path | None, outputs: tuple[Path | None, ...], relaxing: RelaxSettings,
    setup: Setup, processes: dict[str, Any], as_json: bool, resume: bool, force: bool,
) -> None:  # fmt: skip
    """Relax many files into a folder, write poses and proteins to a file each, and exit with the status."""
    from protochain.batches.batch_structures import relax_files
    from protochain.batches.naming import poses_name
    from protochain.batches.table import RELAXED, replaceable_files
    from protochain.cli.relaxing import print_folder
    from protochain.cli.terminal import batch_progress
    from protochain.core.storage import write_text
    from protochain.structure.ligand_files import check_ligand_file
    from protochain.structure.write import check_format, save_proteins

    output, *extras = outputs
    ligand_out, protein_out = extras
    folder = Path("relaxed") if output is None else output
    options.check_folder(folder, "structures")
    if ligand_out:
        check_ligand_file(ligand_out)
    if protein_out:
        check_format(protein_out)
    files = replaceable_files(folder, RELAXED, resume, force)
    options.check_outputs([manifest], [*files, *extras], setup, new=[] if resume or force else extras)
    _report_trajectories(inputs)
    with batch_progress() as watch:
        result = relax_files(
            inputs, folder, relaxing, setup, manifest=manifest, resume=resume, force=force, watch=watch,
            **processes,
        )  # fmt: skip
    done = result.table.dropna(subset="output")
    if ligand_out:
        text = "".join((folder / poses_name(name)).read_text() for name in done["structure"])
        write_text(ligand_out, text)
    if protein_out and not len(done):
        extras = [ligand_out]
    elif protein_out:
        rows = done[["output", "pose_chain", "pose_residue"]].itertuples(index=False)
        complexes = ((folder / file, [f"{chain}/{number}"]) for file, chain, number in rows)
        save_proteins(complexes, protein_out)

    def show() -> None:
        print_folder(result.table, folder)
        options.print_files(*extras)

    options.end_folder(folder, show, as_json, result.interrupted, options.batch_status(result))
