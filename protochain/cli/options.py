"""Shared options of the commands, preparation of inputs, and checks and writing of outputs."""

import inspect
import math
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext, redirect_stdout
from dataclasses import MISSING, Field, fields
from functools import partial, wraps
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

import typer

from protochain.chains.setup import Setup
from protochain.cli.lines import Kind, is_verbose, tell, warn
from protochain.core import defaults
from protochain.core.errors import Angle, Argument, ProtochainError, WriteError
from protochain.core.markup import plural
from protochain.core.settings import Made, Setting, settings_of
from protochain.core.timings import part, until_now
from protochain.dynamics.simulate_settings import RunSettings, SimulationSettings
from protochain.minimisers.minimise_settings import MinimiseSettings, StartSettings
from protochain.relaxation.relax_settings import RelaxSettings
from protochain.searching.search_settings import SearchRunSettings, SearchSettings

if TYPE_CHECKING:
    from protochain.batches import Batch
    from protochain.chains.chain import Chain
    from protochain.energies import Energy
    from protochain.structure import Structure

CONVERGED, FAILED, BAD_INPUT, UNCONVERGED, SOME_REFUSED, INTERRUPTED = 0, 1, 2, 3, 4, 130
"""Exit statuses: 1 without a usable result, 3 if a usable result is not converged, 4 if some of several
inputs were refused, 130 if a signal ended the command."""

STANDARD_OUTPUT = "-"
"""Name of an output that is printed instead of written to a file."""

_SHOWN_OVERLAPS = 5  # Overlaps reported before a run. ``info`` lists all.

Input = Annotated[
    Path, typer.Argument(metavar="IN", help="PDB or mmCIF file, plain or compressed. - is standard input.")
]
Inputs = Annotated[
    list[str], typer.Argument(metavar="IN...", help="Files, folders or patterns. - is standard input.")
]
Manifest = Annotated[Path | None, typer.Option(help="CSV with a column path, and any settings as columns.")]
Scheduler = Annotated[str | None, typer.Option(help="Address of a Dask cluster to use instead.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object on standard output.")]
Report = Annotated[Path | None, typer.Option(help="Page with tables, plots and 3-D view (FILE.html).")]
Timings = Annotated[
    bool, typer.Option("--timings", help="Print seconds by part, and the serial share of the loop.")
]
ProteinOut = Annotated[
    Path | None, typer.Option(help="PDB or mmCIF of the proteins without the poses, a model for each pose.")
]
RestraintCsv = Annotated[
    Path | None, typer.Option(help="CSV with value, bound and violation of each restraint at the end.")
]
FigureFile = Annotated[
    Path | None, typer.Option("--figure", metavar="FILE", help="Figure for a paper (FILE.svg, .pdf or .png).")
]
LigandOut = Annotated[
    Path | None,
    typer.Option(
        help="SDF of the added poses (--ligands POSE), or, without poses or with --keep all, of all ligands "
        "of known chemistry."
    ),
]
Force = Annotated[bool, typer.Option("--force", help="Allow outputs to replace files, also the input.")]


def with_settings(**without: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Replace keyword-only parameters of settings classes by options of their fields, except ``without``."""

    # An option of two classes is passed to both. Options of the command itself are not passed.
    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        parameters = inspect.signature(command).parameters.values()
        plain = [p for p in parameters if p.kind is not p.KEYWORD_ONLY]
        kinds = {p.name: p.annotation for p in parameters if p.kind is p.KEYWORD_ONLY}
        options: dict[str, inspect.Parameter] = {}
        for name, kind in kinds.items():
            excluded = {*without.get(name, "").split(), *(parameter.name for parameter in plain)}
            for field in fields(kind):
                for option in _options(field):
                    if field.name not in excluded:
                        options.setdefault(option.name, option)

        @wraps(command)
        def run(**arguments: Any) -> None:
            chosen = {name: arguments.pop(name) for name in options}
            for name, kind in kinds.items():
                given = {k: v for k, v in chosen.items() if k not in without.get(name, "").split()}
                arguments[name] = _build_settings(kind, given)
            command(**arguments)

        run.__signature__ = inspect.Signature([*plain, *options.values()])  # type: ignore[attr-defined]  # known at run time only
        return run

    return decorate


def _options(field: Field[Any]) -> Iterator[inspect.Parameter]:
    setting: Setting | None = field.metadata.get("setting")
    if setting is None or not setting.help:
        return
    # Other defaults are in the help.
    plain = type(field.default) in (bool, int, float, str) and field.default != math.inf and not setting.read
    usual = (not setting.turns_off and field.default) if plain else None
    kind = setting.kind if plain else setting.kind | None
    yield _option(field.name, kind, usual, setting.names(field.name), setting)
    if setting.word:
        name, help_text, _ = setting.word
        yield _option(name, bool, False, [f"--{name.replace('_', '-')}"], Setting(setting.check, help_text))


def _option(name: str, kind: Any, usual: Any, names: list[str], setting: Setting) -> inspect.Parameter:
    option = typer.Option(*names, help=setting.help, metavar=setting.metavar)
    return inspect.Parameter(
        name, inspect.Parameter.KEYWORD_ONLY, default=usual, annotation=Annotated[kind, option]
    )


def _build_settings(kind: type[Made], options: Mapping[str, Any]) -> Made | None:
    """Settings from options. Missing options have their defaults. None if a required option is missing."""
    arguments = {}
    for name, setting in settings_of(kind):
        value: Any = options.get(name)
        if setting.turns_off and name in options:
            value = not value
        if setting.word and options.get(setting.word[0]):
            value = [setting.word[2], *(value or ())]
        if value not in (None, []):
            arguments[name] = setting.read(value) if setting.read else value
    field_defaults = {field.name: field.default for field in fields(kind)}  # type: ignore[arg-type]  # a dataclass
    setting_of = dict(settings_of(kind))
    missing = [name for name in setting_of if field_defaults[name] is MISSING and name not in arguments]
    if not missing:
        return kind(**arguments)
    for name, value in arguments.items():
        if value != field_defaults[name]:
            option, requirement = (setting_of[key].names(key)[0] for key in (name, missing[0]))
            raise ProtochainError(f"{option} requires {requirement}")
    return None


def refuse(context: typer.Context, names: str, *reason: object) -> None:
    """Raise for the first of some options on the command line, as it would have no effect."""
    for name in names.split():
        source = context.get_parameter_source(name)
        if source is not None and source.name == "COMMANDLINE":
            raise ProtochainError(Argument(name), " ", *reason)


def exit_status(statuses: Iterable[str], *, usable: bool = True, interrupted: bool = False) -> int:
    """Exit status of a command of several results. ``usable`` is true if at least one was written."""
    count = Counter(statuses)
    if interrupted or count["interrupted"]:
        return INTERRUPTED
    if {*count} == {"refused"}:
        return BAD_INPUT
    if not (count and usable):
        return FAILED
    if count["refused"]:
        return SOME_REFUSED
    return CONVERGED if {*count} <= {"converged", "measured"} else UNCONVERGED


def batch_status(result: "Batch") -> int:
    """Exit status of a batch."""
    table = result.table
    usable = bool(table["output"].notna().any())
    return exit_status(table["status"], usable=usable, interrupted=result.interrupted)


def end_folder(
    folder: Path, show: Callable[[], object], as_json: bool, interrupted: bool, status: int
) -> None:
    """Print the contents of a folder of results, and exit."""
    if as_json:
        print((folder / "summary.json").read_text())
    else:
        show()
    if interrupted:
        fail("interrupted. Continue with --resume")
    raise typer.Exit(status)


def fail(message: str, status: int = FAILED) -> int:
    """Report an error on standard error in one line, and return the exit status."""
    print(f"protochain: {' '.join(message.split())}", file=sys.stderr)
    return status


def print_json(record: Mapping[str, Any]) -> None:
    """Print one object on one line. Numbers that are not finite are null."""
    from protochain.core.storage import json_text

    print(json_text(record, None))


def print_files(*paths: str | Path | None) -> None:
    """Print the names of written files, one a line. None is skipped."""
    tell(Kind.WRITTEN, *(f"written: {path}" for path in filter(None, paths)))


def named_after(source: Path) -> tuple[str, str]:
    """Return stem and suffix for outputs named after an input."""
    from protochain.structure.formats.files import split_name, suffix_of

    return ("stdin" if str(source) == "-" else split_name(source)[0]), suffix_of(source)


def prepare(source: Path, setup: Setup) -> tuple["Chain", "Energy", float]:
    """Prepare a file. Report changes and overlaps on standard error. Return also the time in seconds."""
    from protochain.chains.contacts import overlaps

    began = perf_counter()
    structure, chain, energy = setup.prepare(source)
    overlapping = overlaps(structure, structure.positions, chain)
    shown = overlapping[:_SHOWN_OVERLAPS] if is_verbose() else overlapping
    warnings = [f"{overlap}; {overlap.remedy}" for overlap in shown]
    if len(overlapping) > len(shown):
        warnings.append(f"and {plural(len(overlapping) - len(shown), 'more overlap')}")
    print_changes(source, structure, describe_move(structure, setup.move, chain), warnings)
    return chain, energy, perf_counter() - began


def describe_move(structure: "Structure", move: str, chain: "Chain | None" = None) -> list[str]:
    """Describe the moving atoms, residues and hinges of a selection. Empty if all atoms move."""
    from protochain.chains.articulate import turned_atoms
    from protochain.structure.select import moving_mask

    if move == defaults.MOVE:
        return []
    free = moving_mask(structure, move)
    others_fixed = f"the other {_count_atoms(structure, ~free)} are fixed"
    if chain is None:
        return [f"{_count_atoms(structure, free)} move, {others_fixed}"]
    hinges = plural(chain.n_hinges, "hinge turns", "hinges turn")
    turned = f"{hinges}, which moves {_count_atoms(structure, turned_atoms(chain))}"
    return [f"{turned}, or {_count_atoms(structure, free)} if all atoms move, and {others_fixed}"]


def _count_atoms(structure: "Structure", atoms: Any) -> str:
    residues = len({*structure.atom_residue[atoms].tolist()})
    return f"{plural(int(atoms.sum()), 'atom')} of {plural(residues, 'residue')}"


def print_changes(
    source: Path, structure: "Structure", read: Sequence[str] = (), warnings: Sequence[str] = ()
) -> None:
    """Print the size of a prepared file, its changes, losses first, and warnings on standard error."""
    from protochain.structure.molecule.repairs import counts_of_changes, needs_action, summarise

    repairs = structure.repairs
    sizes = plural(structure.n_protein_residues, "residue"), plural(structure.n_atoms, "atom")
    tell(Kind.READ, "; ".join([f"{source}: {', '.join(sizes)}", *read]))
    listed = f"protochain info lists all {plural(len(repairs), 'change')}"
    if is_verbose():
        changes = summarise(repairs, as_option)
        tell(Kind.CHANGE, *changes, *([listed] if len(changes) < len(repairs) else []))
        warn(warnings)
    else:
        if len(repairs) > 1:
            tell(Kind.READ, "; ".join(filter(None, [counts_of_changes(repairs), listed])))
            repairs = tuple(filter(needs_action, repairs))
        warn([*summarise(repairs, as_option), *warnings])


def check_restraint_csv(path: Path | None, restraints: Sequence[object]) -> None:
    """Raise if a table of restraints is requested without restraints."""
    if path and not restraints:
        requirement = " requires distances or dihedrals by ", Argument("restraints")
        raise ProtochainError(Argument("restraint_csv"), *requirement)


VIOLATIONS_SHOWN = 5
"""Most violated restraints that a command prints."""


def print_violations(record: "Mapping[str, Any]") -> None:
    """Print the violated restraints of a result, worst first."""
    from protochain.chains.restraint_list import RestraintValue

    violated = record.get("restraint_violations") or []
    if not violated:
        return
    number = plural(len(violated), "restraint")
    tell(Kind.RESULT, f"{number} violated by more than 0.5 angstrom or 10 degrees:")
    tell(Kind.RESULT, *(f"  {RestraintValue(**value)}" for value in violated[:VIOLATIONS_SHOWN]))
    if len(violated) > VIOLATIONS_SHOWN:
        further = len(violated) - VIOLATIONS_SHOWN
        tell(Kind.RESULT, f"  and {further} more, which --restraint-csv and --json list")


def print_lost(rows: "Iterable[Mapping[Any, Any]]") -> None:
    """Print the losses of the structures of records, or of rows of a table."""
    from protochain.structure.molecule.repairs import loss_lines

    tell(Kind.RESULT, *loss_lines(rows, as_option))


RENAMED = {"between": "pull", "charges": "ligand_charges"} | {
    name: setting.columns(name)[0]
    for kind in (
        *(Setup, MinimiseSettings, StartSettings, RelaxSettings, SimulationSettings, RunSettings),
        *(SearchSettings, SearchRunSettings),
    )
    for name, setting in settings_of(kind)
    if setting.option
}
"""Options whose names differ from the arguments of the library."""


def as_option(part: Argument | Angle) -> str:
    """Part of a message for the command line: an option for an argument, degrees for an angle."""
    if isinstance(part, Angle):
        return f"{math.degrees(part.radians):g} degrees"
    option = f"--{RENAMED.get(part.name, part.name).replace('_', '-')}"
    return option if part.value in (None, True) else f"{option} {part.value}"


def has_poses(setup: Setup) -> bool:
    """Whether there are several poses of a ligand, which are added separately."""
    if not setup.poses:
        return False
    from protochain.core.checks import MOLECULE_SUFFIXES
    from protochain.structure.ligand_files import has_poses, poses

    # A file that cannot be read is refused here, not counted as one pose.
    files = [Path(source) for source in setup.poses if source.lower().endswith(MOLECULE_SUFFIXES)]
    return any(len(poses(file)) > 1 for file in files) or any(map(has_poses, setup.poses))


def files_of(inputs: Sequence[str], setup: Setup) -> list[tuple[str, Path, Setup]]:
    """Name, path and setup of each structure."""
    names = [name for name in inputs if name != "-"]
    poses = has_poses(setup)
    if all(Path(name).is_file() for name in names) and not isinstance(setup.model, str) and not poses:
        rows = [(name, Path(name), setup) for name in names]
    else:
        # Imported only here, as it takes a second.
        from protochain.batches.jobs import BatchSettings, find_jobs

        jobs = find_jobs(names, BatchSettings(setup=setup))
        paths = [_name(job.path) for job in jobs]
        rows = [
            (job.name if poses else path, Path(path), job.settings.setup)
            for job, path in zip(jobs, paths, strict=True)
        ]
    return rows + [("standard input", Path("-"), setup)] * (len(names) < len(inputs))


def is_one_file(source: str) -> bool:
    """Whether an input is a file, or a missing one, rather than a folder or a pattern."""
    return source == "-" or Path(source).is_file() or not (Path(source).is_dir() or set("*?[") & set(source))


def _name(path: Path) -> str:
    """Path, relative to the current folder if it is inside."""
    return str(path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path)


def check_outputs(
    reads: Sequence[str | Path | None],
    writes: Sequence[str | Path | None],
    setup: Setup | None = None,
    force: bool | None = None,
    replaces: bool = True,
    new: Sequence[str | Path | None] = (),
) -> None:
    """Raise before any work if outputs would replace an input, another or ``new``, or cannot be written."""
    from protochain.core.storage import check_writable
    from protochain.results.run_folder import refuse_existing
    from protochain.structure.preparation.prepare import user_files

    inputs = [*(Path(path) for path in reads if path), *(user_files(setup.forcefield) if setup else ())]
    outputs = [Path(path) for path in writes if path and str(path) != STANDARD_OUTPUT]
    for output, count in Counter(path.absolute() for path in outputs).items():
        if count > 1:
            raise ProtochainError(f"{output}: is given for two outputs. Give each a separate name")
    for output in outputs:
        is_input = output.exists() and any(path.exists() and output.samefile(path) for path in inputs)
        if is_input and not force:
            instead = "" if force is None else ", or --force to replace it"
            raise ProtochainError(f"{output}: is the input. Give another name{instead}")
        check_writable(output)
    refuse_existing(Path(path) for path in new if path)
    if existing := [str(output) for output in outputs if replaces and output.is_file()]:
        further = f" and {len(existing) - 1} more" if len(existing) > 1 else ""
        tell(Kind.CHANGE, f"{existing[0]}{further}: will be replaced")


def check_folder(folder: Path, contents: str) -> None:
    """Raise if the output of several results is named like a file, or is standard output."""
    from protochain.structure.formats.files import format_of

    is_file = folder.is_file() or format_of(folder) or folder.suffix == ".csv"
    if is_file or str(folder) == STANDARD_OUTPUT:
        raise ProtochainError(f"{folder}: several {contents} require an output folder")


def check_names(
    output: Path, report: Path | None, ligands: Path | None, as_json: bool, proteins: Path | None = None
) -> None:
    """Raise for outputs with a wrong or unknown suffix, and for two outputs on standard output."""
    from protochain.structure.ligand_files import check_ligand_file
    from protochain.structure.write import check_format

    if str(output) != STANDARD_OUTPUT:
        check_format(output)
    elif as_json:
        raise ProtochainError("output -: structure and --json both go to standard output. Give a file")
    check_page(report)
    if proteins:
        check_format(proteins)
    if ligands:
        check_ligand_file(ligands)


def check_page(report: Path | None) -> None:
    """Raise if the name of a page does not end in .html."""
    if report and report.suffix.lower() != ".html":
        raise ProtochainError(f"{report}: give a name that ends in .html")


def write_models(
    models: "list[Structure]", output: Path, suffix: str, remarks: Iterable[str], hydrogens: bool = True
) -> None:
    """Write to a file, or to standard output in the format of a suffix, or mmCIF if PDB is too small."""
    from protochain.structure import save
    from protochain.structure.write import as_text, common_suffix

    if str(output) != STANDARD_OUTPUT:
        return save(models, output, remarks, hydrogens=hydrogens)
    suffix = suffix if suffix != ".pdb" else common_suffix(models)
    sys.stdout.write(as_text(models, suffix, remarks, hydrogens=hydrogens))


def check_structure(structure: "Structure", output: Path, ligands: Path | None) -> None:
    """Raise if an output cannot store a structure. Warn about changed names."""
    from protochain.structure.ligand_files import check_ligands
    from protochain.structure.write import check_fits

    if ligands:
        check_ligands(structure)
    tell(Kind.WARNING, *check_fits(structure, output))


@part("writing")
def write_outputs(
    result: Any,
    entries: Mapping[str, Any],
    write: Callable[[], object],
    setup: Setup,
    write_report: Callable[[Any, dict[str, Any], Path], object],
    report: Path | None,
    ligands: Path | None,
    trace: Path | None = None,
    restraints: Path | None = None,
    terms: bool = True,
) -> dict[str, Any]:
    """Write a structure and its further files. Report a full disk. Return the record, or exit without one.

    Without ``terms`` and a report the record lacks the energies of single terms.
    """
    from protochain.core.storage import write_atomically
    from protochain.structure.formats.confidences import copy_confidences

    if not result.is_usable:
        reason = f"{entries['input']}: {result.message}. No file is written, as the start was not improved"
        raise SystemExit(fail(reason))
    write()
    with part("measuring"):
        record = {**result.record(terms or report is not None), **entries}
    try:
        if trace:
            write_atomically(trace, partial(result.trace.to_csv, index=False))
        if restraints:
            write_atomically(restraints, partial(result.restraint_table.to_csv, index=False))
        if report:
            write_report(result, record, report)
            record["report"] = str(report)
        confidences = copy_confidences(Path(record["input"]), Path(record["output"]))
        tell(Kind.WARNING, *confidences.left)
        record["confidences"] = [str(path) for path in confidences.written]
        if ligands:
            setup.save_ligands(result, ligands)
            record["ligands_written"] = str(ligands)
    except WriteError as error:
        record.setdefault("not_written", []).append(str(error))
    record["timings"] = until_now()
    for line in record.get("not_written", ()):
        fail(f"{line}. Saved: {record['output']}")
    return record


def redirect_messages(output: Path) -> AbstractContextManager[Any]:
    """Redirect messages to standard error if the structure is on standard output."""
    return redirect_stdout(sys.stderr) if str(output) == STANDARD_OUTPUT else nullcontext()
