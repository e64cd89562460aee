"""Runs over frames, by ``--trajectory`` and ``--frames``, with a row for each frame."""

import sys
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from protochain.cli import options
from protochain.core import defaults
from protochain.core.errors import Argument, ProtochainError
from protochain.core.lazy_pandas import pd
from protochain.core.markup import plural
from protochain.core.storage import claimed_files

if TYPE_CHECKING:
    from protochain.batches.cluster import Processes
    from protochain.batches.frame_files import FramesRun
    from protochain.batches.frame_tasks import Task
    from protochain.chains.setup import Setup
    from protochain.structure.ensemble import Ensemble
    from protochain.structure.formats.frames import Frames

Trajectory = Annotated[
    Path | None,
    typer.Option(
        metavar="FRAMES",
        help="Frames of IN, with a row for each: XTC, TRR, DCD, NetCDF, NPZ, or a file of models.",
    ),
]
Chosen = Annotated[
    str | None,
    typer.Option(
        "--frames", metavar="START:STOP:STEP",
        help="Selected frames, from 0, or 0,2,5, or all. Without --trajectory, models of IN.",
    ),
]  # fmt: skip
Workers = Annotated[int | None, typer.Option(help="Processes for frames [default: all cores].")]
Resume = Annotated[bool, typer.Option("--resume", help="Continue an interrupted run over frames.")]


def are_requested(trajectory: Path | None, frames: str | None) -> bool:
    """Whether a command runs over frames."""
    return trajectory is not None or frames is not None


def single_structure(inputs: Sequence[str | Path]) -> Path:
    """Structure of the frames. Raise unless there is exactly one."""
    if len(inputs) != 1 or not options.is_one_file(str(inputs[0])):
        raise ProtochainError("frames: give exactly one structure file before ", Argument("trajectory"))
    return Path(inputs[0])


def run_if_requested(
    context: typer.Context,
    inputs: Sequence[str | Path],
    trajectory: Path | None,
    frames: str | None,
    setup: "Setup",
    task: "Callable[[], Task]",
    table: Path | None,
    *,
    excluded: str = "",
    alone: str = "workers resume",
    **how: Any,
) -> None:
    """Run over frames if requested, and exit. Options ``excluded`` exclude frames, ``alone`` require them."""
    if not are_requested(trajectory, frames):
        return options.refuse(context, alone, "requires frames. Give ", Argument("trajectory"))
    options.refuse(context, excluded, "does not apply to frames")
    source = single_structure(inputs)
    with _processes(setup, how["workers"]).started_early():  # Their imports take a second.
        frame_task = task()
        # The ending of a table is the name of the task, but for validation.
        ending = "validated" if frame_task.name == "validate" else frame_task.name
        table = table or Path(f"{options.named_after(source)[0]}.{ending}.csv")
        how.setdefault("force", not how["resume"])
        raise typer.Exit(run(source, trajectory, frames, setup, frame_task, table, **how))


def _processes(setup: "Setup", workers: int | None, time_limit: float = defaults.TIME_LIMIT) -> "Processes":
    """Processes for the frames, as a damaged file may end the process that reads it."""
    from protochain.batches.cluster import Processes

    return Processes(workers, threads=setup.threads or 1, time_limit=time_limit)


def open_ensemble(
    source: Path, trajectory: Path | None, frames: str | None, setup: "Setup"
) -> "tuple[Ensemble, Frames]":
    """Prepare the structure, and open its frames. Print the changes."""
    from protochain.batches.frames import ensemble_of
    from protochain.structure.molecule.repairs import Kind

    if trajectory is None and str(source) == "-":
        raise ProtochainError("frames: give a file, as standard input is read only once")
    ensemble, chosen = ensemble_of(source, trajectory, frames, setup)
    repairs = [repair for repair in ensemble.structure.repairs if repair.kind is not Kind.MODELS_LEFT_OUT]
    options.print_changes(source, replace(ensemble.structure, repairs=tuple(repairs)))
    return ensemble, chosen


def run(
    source: Path,
    trajectory: Path | None,
    frames: str | None,
    setup: "Setup",
    task: "Task",
    table: Path,
    output: Path | None = None,
    *,
    report: Path | None = None,
    workers: int | None = None,
    time_limit: float = defaults.TIME_LIMIT,
    resume: bool = False,
    force: bool = False,
    hydrogens: bool = True,
    as_json: bool = False,
    reads: Sequence[Path] = (),
) -> int:
    """Run over frames. Write table, trajectory and page, print the results, and return the exit status."""
    from protochain.batches.frame_files import files_of, run_frames
    from protochain.cli.terminal import frames_progress

    processes = _processes(setup, workers, time_limit)
    files = files_of(table, output)
    replaces = not resume and (force or not files[1].exists())  # A checkpoint is refused otherwise.
    options.check_outputs([source, trajectory, *reads], [*files, report], setup, force, replaces)
    options.check_page(report)
    with claimed_files(*files):
        ensemble, chosen = open_ensemble(source, trajectory, frames, setup)
        with frames_progress(task.name, len(chosen)) as watch:
            result = run_frames(
                ensemble, chosen, task, table, output, hydrogens=hydrogens, processes=processes,
                resume=resume, force=force, watch=watch,
            )  # fmt: skip
    if result.was_complete:
        note = "settings are not compared; --force starts again"
        print(f"{result.csv}: is complete, nothing to do ({note})", file=sys.stderr)
    if report:
        from protochain.batches.frame_report import write_report

        write_report(result, task.name, chosen.source, report)
    if as_json:
        options.print_json({
            "input": str(source), "trajectory": str(trajectory or source),
            "frames": sum(result.counts.values()), "counts": dict(result.counts), "csv": str(result.csv),
            "output": str(result.trajectory) if result.trajectory else None, "written": result.written,
            "topology": str(result.topology) if result.topology else None,
            "interrupted": result.interrupted, "report": str(report) if report else None,
        })  # fmt: skip
    else:
        _print(result, report)
    if result.interrupted:
        options.fail("interrupted. Continue with --resume")
    usable = bool(result.counts.get("measured") or result.counts.get("converged") or result.written)
    statuses = Counter(result.counts).elements()
    return options.exit_status(statuses, usable=usable, interrupted=result.interrupted)


def _print(result: "FramesRun", report: Path | None) -> None:
    """Print the statuses of the frames, medians, and the written files."""
    counts = ", ".join(f"{n} {status}" for status, n in result.counts.items())
    print(f"{plural(sum(result.counts.values()), 'frame')}: {counts or 'none done'}")
    if result.counts:
        print(_medians(result))
        if warning := _count_split_frames(result):
            print(warning)
    trajectory = result.trajectory if result.written and not result.interrupted else None
    options.print_files(trajectory, result.topology, result.csv, report)


_PARTED = 10.0
"""Angstrom. Molecules in contact in the structure but this far apart in a frame may be in two images."""


def _count_split_frames(result: "FramesRun") -> str:
    """Message on the frames in which molecules that touch in the structure are far apart."""
    from protochain.batches.frame_tasks import GAP

    gap = pd.read_csv(result.csv, usecols=[GAP])[GAP]
    if not (many := int((gap > _PARTED).sum())):
        return ""
    return (
        f"{plural(many, 'frame')} with molecules up to {gap.max():.0f} angstrom apart that touch in the "
        f"structure ({GAP}). If they cross a periodic box, unwrap the trajectory first"
    )


def _medians(result: "FramesRun") -> str:
    """Medians of a few columns, as text. Only these columns are read."""
    from protochain.results.columns import heading

    existing = pd.read_csv(result.csv, nrows=0).columns
    columns = [name for name in _SHOWN_COLUMNS if name in existing]
    table = pd.read_csv(result.csv, usecols=columns)
    sums = []
    if "violations_end" in columns:
        before, after = table["violations_start"].sum(), table["violations_end"].sum()
        sums = [f"residues with violations {before:.0f} before, {after:.0f} after"]
    measures = [name for name in columns if name not in ("violations_start", "violations_end")]
    medians = [f"{heading(name).replace(', ', ' ')} {table[name].median():.4g}" for name in measures]
    highest = []
    for name in [name for name in _WORST if name in columns and table[name].nunique() > 1][:1]:
        rows = pd.read_csv(result.csv, usecols=["frame", name]).nlargest(3, name)
        frames = ", ".join(f"{row['frame']:.0f} ({row[name]:.4g})" for row in rows.to_dict("records"))
        highest.append(f"highest {heading(name).replace(', ', ' ')}: frames {frames}")
    return "; ".join([*sums, f"medians: {', '.join(medians)}", *highest])


_WORST = (
    "violations_end", "violations", "energy_end_reference_kj_mol", "total_kj_mol", "rmsd_angstrom",
    "energy_kj_mol",
)  # fmt: skip
"""Measures of the worst frames. The first one that differs between frames is used."""


_SHOWN_COLUMNS = (
    "violations_start", "violations_end", "energy_start_kj_mol", "energy_end_reference_kj_mol",
    "ca_rmsd_angstrom", "seconds", "violations", "clashscore_per_1000_atoms", "ramachandran_outliers",
    "rotamer_outliers", "lddt", "total_kj_mol", "sum_total_kj_mol", "rmsd_angstrom", "tm_score",
    "energy_kj_mol", "buried_area_angstrom2", "packing",
)  # fmt: skip
"""Columns whose medians are printed, if a table has them."""
