"""``protochain minimise``."""

import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

import typer

from protochain.chains.setup import ALL_MODELS, Setup, parse_models
from protochain.cli import options, terminal
from protochain.cli.lines import with_detail
from protochain.core import defaults
from protochain.core.errors import Argument, ProtochainError, WriteError, WriteWarning
from protochain.core.interrupts import held_interrupts
from protochain.core.storage import claimed_files
from protochain.core.timings import measure_run
from protochain.minimisers.minimise_settings import CheckpointSettings, MinimiseSettings, StartSettings

if TYPE_CHECKING:
    from protochain.chains.chain import Chain
    from protochain.core.arrays import Watcher
    from protochain.energies import Energy
    from protochain.minimisers import Recipe, Solution
    from protochain.structure import Structure

Output = Annotated[
    Path | None,
    typer.Option(
        "-o", "--output", help="PDB or mmCIF, plain or .gz. - is standard output [default: NAME.METHOD.pdb]."
    ),
]
Method = Annotated[
    str, typer.Option(help="cartesian, hybrid, lbfgs, newton, kcm, openmm ... An unknown name lists all.")
]
Angle = Annotated[float | None, typer.Option(help="Turn of hinges per step of kcm, rad [default: 0.0005].")]
Trace = Annotated[Path | None, typer.Option(help="CSV with a row for each iteration.")]
Trajectory = Annotated[Path | None, typer.Option(help="DCD or XTC with a frame for each iteration.")]
OneFile = Annotated[bool, typer.Option("--one-file", help="Write all models into one file.")]


@with_detail
@options.with_settings()
def minimise(
    context: typer.Context,
    source: options.Input,
    output: Output = None,
    method: Method = defaults.METHOD,
    angle: Angle = None,
    trace: Trace = None,
    trajectory: Trajectory = None,
    report: options.Report = None,
    ligand_out: options.LigandOut = None,
    restraint_csv: options.RestraintCsv = None,
    one_file: OneFile = False,
    timings: options.Timings = False,
    as_json: options.AsJson = False,
    force: options.Force = False,
    *,
    minimising: MinimiseSettings,
    saving: CheckpointSettings,
    starting: StartSettings,
    setup: Setup,
) -> None:
    """Minimise the energy of one structure.

    With NOEs: protochain minimise model.pdb --restraints noe.nef --restraint-csv noe.csv
    """
    from protochain.minimisers.minimise_structure import Minimisation
    from protochain.minimisers.recipes import at_angle, recipe_of
    from protochain.minimisers.restraints import Hold
    from protochain.minimisers.starts import refuse_restraints
    from protochain.structure.formats.trajectory import check_trajectory, part_of

    recipe = method if angle is None else at_angle(recipe_of(method), angle)
    Minimisation(recipe_of(recipe), **vars(minimising), **vars(saving))
    if starting.n_starts > 1:
        reason = "applies to a single start only"
        options.refuse(context, "checkpoint resume trajectory", reason)
    options.check_restraint_csv(restraint_csv, Hold.of(minimising.restraints).listed)
    extras = {"report": report, "ligands": ligand_out, "trace": trace, "restraints": restraint_csv}
    stem, suffix = options.named_after(source)
    output = output or Path(f"{stem}.{getattr(recipe, 'name', method)}{suffix}")
    options.check_names(output, report, ligand_out, as_json)
    if trajectory:
        check_trajectory(trajectory)
    if isinstance(setup.model, str):
        single = "timings trace trajectory checkpoint resume report ligand_out restraint_csv"
        options.refuse(context, single, "applies to a single model only")
    runs = _runs(source, output, setup, one_file)
    frames = [trajectory, part_of(trajectory)] if trajectory else []
    outputs = [*dict.fromkeys(path for _, path in runs), *frames, saving.checkpoint, *extras.values()]
    new = [] if force else [trajectory, saving.checkpoint, trace, ligand_out, restraint_csv]
    options.check_outputs([source, saving.resume], outputs, setup, force, new=new)
    context.with_resource(claimed_files(*frames))

    settings: dict[str, Any] = {"method": recipe, **vars(minimising)}
    if starting.n_starts == 1:
        solve: Any = partial(_once, trajectory=trajectory, **vars(saving), **settings)
    else:
        refuse_restraints(minimising.restraints, minimising.max_rmsd)
        solve = partial(_minimise_often, **vars(starting), **settings)
    limit = minimising.max_evaluations
    lengths = starting.n_starts * terminal.typical_evaluations(recipe, limit), starting.n_starts * limit
    records, files = list[dict[str, Any]](), extras | {"terms": as_json}
    with _writer(output, suffix, one_file) as write:
        for run_setup, path in runs:
            with measure_run(from_start=not records):
                run = _solve_and_write(context, source, run_setup, path, recipe, solve, lengths, write, files)
                records.append(run)
            if records[-1]["status"] == "interrupted":
                break
    with options.redirect_messages(output):
        lost = [line for record in records for line in record.get("not_written", ())]
        requested = [Path(p) for p in (trajectory, trace, saving.checkpoint, restraint_csv) if p]
        further = [p for p in requested if p.exists() and not any(s.startswith(f"{p}: ") for s in lost)]
        _print(records, as_json, isinstance(setup.model, str), further)
        if timings and not as_json:
            terminal.print_timings(records[0])
    raise typer.Exit(_status(records))


def _status(records: list[dict[str, Any]]) -> int:
    lost = any("not_written" in record for record in records)
    status = options.exit_status(record["status"] for record in records)
    return options.UNCONVERGED if status == options.CONVERGED and lost else status


def _runs(source: Path, output: Path, setup: Setup, one_file: bool) -> list[tuple[Setup, Path]]:
    """Pair each model with its output."""
    from protochain.structure.formats.files import split_name
    from protochain.structure.preparation.model_choice import refuse_absent
    from protochain.structure.preparation.read import model_numbers

    if not isinstance(setup.model, str):
        if one_file:
            raise ProtochainError(
                Argument("one_file"), " requires several models, as by --model all or --model 1-5"
            )
        return [(setup, output)]
    if str(source) == "-":
        raise ProtochainError(Argument("model"), f" {setup.model} requires a file, not standard input")
    if str(output) == options.STANDARD_OUTPUT and not one_file:
        raise ProtochainError("output -: give --one-file for several models")
    numbers = tuple(model_numbers(source))
    models = numbers if setup.model == ALL_MODELS else parse_models(setup.model)
    refuse_absent(str(source), numbers, models)
    stem, suffix, packing = split_name(output)
    return [
        (replace(setup, model=n), output if one_file else output.with_name(f"{stem}.{n}{suffix}{packing}"))
        for n in models
    ]


@contextmanager
def _writer(output: Path, suffix: str, one_file: bool) -> Iterator["Callable[[Solution, Path], None]"]:
    """Writer of structures, to separate files, or at the end to one file, also if a later model failed."""
    stored: list[Solution] = []

    def write(solution: "Solution", path: Path) -> None:
        if one_file:
            stored.append(solution)
        else:
            options.write_models([solution.structure], path, suffix, solution.provenance())

    try:
        yield write
    finally:
        if stored:
            lines = [(s.structure.model_number, line) for s in stored for line in s.provenance()]
            remarks = (f"MODEL {number}: {line}" for number, line in lines)
            options.write_models([solution.structure for solution in stored], output, suffix, remarks)


def _solve_and_write(
    context: typer.Context,
    source: Path,
    setup: Setup,
    output: Path,
    method: "str | Recipe",
    solve: "Callable[[Chain, Energy], tuple[Solution, dict[str, Any]]]",
    lengths: tuple[int, int],
    write: "Callable[[Solution, Path], None]",
    extras: Mapping[str, Any],
) -> dict[str, Any]:
    """Prepare and minimise one model, write it, and return its record."""
    chain, energy, preparation = options.prepare(source, setup)
    options.check_structure(chain.structure, output, extras["ligands"])
    times = terminal.print_outlook(chain.structure, method)
    typical, longest = lengths
    terminal.foretell(chain, energy, min(longest, times * typical), longest)
    context.with_resource(held_interrupts())
    solution, record = solve(chain, energy)
    model = {} if setup.model is None else {"model": setup.model}
    origin = {"input": str(source), "output": str(output), "seconds_preparation": preparation}
    finish = partial(write, solution, output)
    return options.write_outputs(solution, record | model | origin, finish, setup, _write_page, **extras)


def _write_page(solution: "Solution", record: dict[str, Any], path: Path) -> None:
    from protochain.comparison import Comparison

    origin = {key: record[key] for key in ("input", "output", "seconds_preparation")}
    Comparison(solution.chain.structure, (solution,), origin).write_page(path)


def _run_progress(
    settings: Mapping[str, Any], use_positions: Callable[[Any], None] | None = None
) -> AbstractContextManager["Watcher"]:
    """Show the progress of a run with these settings."""
    method, limit, tolerance = settings["method"], settings["max_evaluations"], settings["tolerance"]
    return terminal.run_progress(method, limit, tolerance, use_positions)


def _once(
    chain: "Chain", energy: "Energy", trajectory: Path | None, **settings: Any
) -> tuple["Solution", dict[str, Any]]:
    """Minimise from the input structure. Write every accepted point to the trajectory."""
    from protochain.minimisers import minimise

    lost: list[str] = []
    with (
        _Frames(trajectory, chain.structure, lost) as frames,
        _run_progress(settings, frames if trajectory else None) as watch,
        _warnings(lost),
    ):
        solution = minimise(chain, energy, watch=watch, **settings)
        frames.is_complete = solution.is_usable
    return solution, {"not_written": lost} if lost else {}


@contextmanager
def _warnings(lost: list[str]) -> Iterator[None]:
    """Collect warnings about unwritten files. Show all other warnings."""
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always", WriteWarning)
        yield
    for warning in warned:
        if warning.category is WriteWarning:
            lost.append(str(warning.message))
        else:
            warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)


class _Frames:
    """Trajectory, if requested. A full disk is reported in ``lost`` and ends it, to leave space."""

    is_complete = False
    """Whether the run has a usable result. Otherwise the trajectory is discarded."""

    def __init__(self, path: Path | None, structure: "Structure", lost: list[str]) -> None:
        from protochain.structure.formats.trajectory import TrajectoryFile

        self.file, self.lost = TrajectoryFile(path, structure) if path else None, lost

    def __call__(self, x: Any) -> None:
        if self.file is None or self.lost:
            return
        try:
            self.file.append(x)
        except WriteError as error:
            self.file.discard()
            self.lost.append(str(error))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self.file is None:
            return
        try:
            if self.is_complete and not self.lost:
                self.file.finish()
        except WriteError as error:
            self.lost.append(str(error))
        finally:
            self.file.discard()


def _minimise_often(chain: "Chain", energy: "Energy", **settings: Any) -> tuple["Solution", dict[str, Any]]:
    """Minimise from many starts. Return the best solution, and entries of its record about all starts."""
    from protochain.minimisers import explore

    with _run_progress(settings) as watch:
        search = explore(chain, energy, watch=watch, **settings)
    return search.best, search.overall()


def _print(records: list[dict[str, Any]], as_json: bool, of_models: bool, further: list[Path]) -> None:
    if as_json:
        options.print_json({"models": records} if of_models else records[0])
        return
    for record in records:
        if "starts_summary" in record:
            terminal.print_distribution(record["starts_summary"])
    terminal.print_table(records)
    options.print_lost(
        [r | {"structure": f"{r['structure']} model {r['model']}"} for r in records] if of_models else records
    )
    for record in records:
        terminal.print_written(record)
        options.print_files(
            *record.get("confidences", ()), record.get("ligands_written"), record.get("report"), *further
        )
