"""``protochain mutate``."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

import typer

from protochain.chains.setup import Setup
from protochain.cli import options
from protochain.cli.lines import Kind, tell, with_detail
from protochain.cli.relax import Resume, Workers
from protochain.cli.rows import print_rows
from protochain.core import defaults
from protochain.core.checks import designs, sequences
from protochain.core.errors import ProtochainError
from protochain.core.storage import claimed_files
from protochain.relaxation.relax_settings import RelaxSettings

if TYPE_CHECKING:
    from protochain.batches.cluster import Processes
    from protochain.relaxation.mutations import Mutation

_SHOWN = (
    "mutations", "status", "ddg_kj_mol", "energy_change_kj_mol", "interface_change_kj_mol",
    "clashscore_per_1000_atoms", "seconds",
)  # fmt: skip
"""Columns of the terminal."""
_MEANING = "ddg is an energy difference of minimised structures, not a free energy."
_TEXT = (
    "Change of stability (ddg) of each mutant: its energy less that of the wild type, less the same in "
    f"pentapeptides GGXGG. Side chains near the site are rebuilt and relaxed alike on both sides. {_MEANING} "
    "Red is less stable, blue more."
)
_WITHOUT = "hinges root move rigid_protein terms calculator rebuild_side_chains sequence"
_SHARED = "preset tolerance interface"
_OF_RELAX = " ".join(name for name in vars(RelaxSettings()) if name not in _SHARED.split())


@with_detail
@options.with_settings(setup=_WITHOUT, relaxing=f"{_OF_RELAX} {_SHARED.replace(' interface', '')}")
def mutate(
    context: typer.Context,
    source: options.Input,
    mutations: Annotated[
        str | None, typer.Argument(metavar="A:L45F,B:...", help="Mutations, all in one mutant.")
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Mutant, or CSV of a scan [default: NAME.mutant.pdb, .csv]."),
    ] = None,
    scan: Annotated[
        str | None, typer.Option(metavar="A:1-50", help="Residues to mutate one at a time.")
    ] = None,
    sequence: Annotated[
        str | None,
        typer.Option(metavar="FASTA", help="Letters, or a FASTA file, with a mutant for each design."),
    ] = None,
    into: Annotated[str, typer.Option(metavar="A|AVL|all", help="New residues of a scan.")] = "A",
    report: options.Report = None,
    workers: Workers = None,
    scheduler: options.Scheduler = None,
    time_limit: Annotated[float, typer.Option(help="Seconds for each site of a scan.")] = defaults.TIME_LIMIT,
    resume: Resume = False,
    as_json: options.AsJson = False,
    force: options.Force = False,
    *,
    relaxing: RelaxSettings,
    setup: Setup,
) -> None:
    """Mutate residues and report the energy change.

    Side chains within 10 angstrom are rebuilt on rotamers and relaxed, also in the wild type. The backbone
    is fixed. With --scan, residues are mutated one at a time, for a table and a page with a heat map. With
    --sequence FASTA, the mutant of each design is written to a folder, with a table.
    """
    from protochain.batches.cluster import Processes
    from protochain.relaxation.mutations import PROTOCOL, mutate_at, places_of
    from protochain.structure.substitute import thread_sequence

    if [mutations, scan, sequence].count(None) != 2:
        raise ProtochainError("mutate: give one of mutations, as A:L45F, --scan SITES, or --sequence FASTA")
    relaxing = replace(relaxing, **PROTOCOL)
    if scan is not None:
        raise typer.Exit(
            _scan(source, scan, into, output, relaxing, setup, (workers, scheduler, time_limit), report,
                  resume=resume, as_json=as_json, force=force)
        )  # fmt: skip
    letters = sequences(sequence or "", "sequence")
    if several := designs(letters):
        options.refuse(context, "into resume report", "applies to scans only")
        processes = Processes(workers, scheduler, setup.threads or 1, time_limit)
        raise typer.Exit(_designs(source, several, output, relaxing, setup, processes, as_json, force))
    options.refuse(context, "into workers scheduler time_limit resume report", "applies to scans only")
    stem, suffix = options.named_after(source)
    output = output or Path(f"{stem}.mutant{suffix}")
    options.check_names(output, None, None, as_json)
    options.check_outputs([source], [output], setup, force)
    began = perf_counter()
    structure = setup.load(source)
    options.check_structure(structure, output, None)
    options.print_changes(source, structure)
    names = places_of(structure, mutations) if mutations else thread_sequence(structure, letters)
    if not names:
        raise ProtochainError(f"{source}: has this sequence already; give another")
    origin = {"input": str(source), "output": str(output), "seconds_preparation": perf_counter() - began}
    mutation = mutate_at(structure, names, relaxing, setup, {})

    if not mutation.mutant.is_usable:
        raise SystemExit(options.fail(f"{source}: {mutation.mutant.message}, so that nothing is written"))
    options.write_models([mutation.structure], output, suffix, mutation.mutant.provenance())
    if as_json:
        options.print_json(mutation.record() | origin)
    else:
        with options.redirect_messages(output):
            _print(mutation)
            options.print_files(output)
    raise typer.Exit(_status([mutation.record()]))


def _print(mutation: "Mutation") -> None:
    ddg, bound, unfolded = mutation.ddg, mutation.interface_change, mutation.unfolded
    peptide = "" if unfolded is None else f", minus {unfolded:.1f} in the peptide GGXGG"
    stability = "not known" if ddg is None else f"{ddg:+.1f} kJ/mol (above 0: less stable)"
    tell(
        Kind.VERDICT,
        f"{','.join(mutation.mutations)}: change of stability (ddg) {stability}: "
        f"energy {mutation.change:+.1f} kJ/mol in the protein{peptide}",
        *([] if bound is None else [f"change of the energy of binding: {bound:+.1f} kJ/mol"]),
    )
    tell(Kind.RESULT, f"wild type: {mutation.wild.message}", f"mutant: {mutation.mutant.message}", _MEANING)


def _print_rows(columns: Sequence[str], rows: Sequence[dict[str, Any]], *files: Path | None) -> None:
    """Print the columns of mutants that have a value, and the written files."""
    shown = [key for key in columns if any(row[key] is not None for row in rows)]
    print_rows(shown, ([row[key] for key in shown] for row in rows), texts=2)
    tell(Kind.RESULT, _MEANING)
    options.print_files(*files)


def _status(rows: Sequence[dict[str, Any]]) -> int:
    """Exit status of mutants. An energy difference has converged if both sides have."""
    statuses = [row[side] for row in rows for side in ("status", "status_wild") if row[side]]
    return options.exit_status(statuses, usable=any(row["energy_mutant_kj_mol"] is not None for row in rows))


def _designs(
    source: Path, several: list[tuple[str, str]], output: Path | None, relaxing: RelaxSettings, setup: Setup,
    processes: "Processes", as_json: bool, force: bool,
) -> int:  # fmt: skip
    """Write the mutant of each design, and a table of all, to a folder. Return the exit status."""
    from protochain.batches.mutation_scan import mutate_designs
    from protochain.cli.terminal import count_progress

    stem, suffix = options.named_after(source)
    folder = output or Path(f"{stem}.mutants")
    options.check_folder(folder, "designs")
    outputs = {folder / f"{name}{suffix}": (name, letters) for name, letters in several}
    table = folder / "mutants.csv"
    options.check_outputs([source], [*outputs, table], setup, force, new=[] if force else [*outputs, table])
    folder.mkdir(parents=True, exist_ok=True)
    with claimed_files(table), processes.started_early():
        structure = setup.load(source)
        options.print_changes(source, structure)
        for path in filter(Path.exists, outputs):  # A refused design has no structure of an earlier run.
            if not (source.exists() and path.samefile(source)):
                path.unlink()
        with count_progress("mutate") as watch:
            rows = mutate_designs(structure, outputs, relaxing, setup, table, processes, watch)
    files = [*filter(Path.exists, outputs), table]
    if as_json:
        options.print_json({"input": str(source), "results": rows, "files": [*map(str, files)]})
    else:
        _print_rows(["record", *_SHOWN[1:]], rows, table)
    return _status(rows)


def _scan(
    source: Path, sites: str, into: str, output: Path | None, relaxing: RelaxSettings, setup: Setup,
    cluster_options: tuple[int | None, str | None, float], report: Path | None, *,
    resume: bool, as_json: bool, force: bool,
) -> int:  # fmt: skip
    """Scan sites. Write the table, and the page with the heat map."""
    from protochain.batches.cluster import Processes
    from protochain.batches.mutation_scan import heat_map, run_scan
    from protochain.cli.terminal import count_progress

    table = output or Path(f"{options.named_after(source)[0]}.mutations.csv")
    options.check_page(report)
    options.check_outputs([source], [table, report], setup, force, not resume)
    processes = Processes(cluster_options[0], cluster_options[1], setup.threads or 1, cluster_options[2])
    with claimed_files(table), processes.started_early():
        structure = setup.load(source)
        options.print_changes(source, structure)
        with count_progress("mutate") as watch:
            mutations, interrupted = run_scan(
                structure, sites, into, relaxing, setup, table, processes, resume, watch
            )  # fmt: skip
    report = report if len(mutations) else None  # There is nothing to draw.
    if report:
        from protochain.results.page import write_scan

        reasons = mutations["message"].where(mutations["status"] != "converged")
        measures = mutations.drop(columns=["structure", "chain", "residue", "wild", "mutant"])
        shown_columns = measures.assign(message=reasons).dropna(axis="columns", how="all")
        ranked = mutations.dropna(subset="ddg_kj_mol").sort_values("ddg_kj_mol", kind="stable")
        ends = {"most stable, kJ/mol": ranked.head(1), "least stable, kJ/mol": ranked.tail(1)}
        numbers = {"mutants": f"{len(mutations)}"} | {
            label: f"{row.mutations} {row.ddg_kj_mol:+.1f}"
            for label, end in ends.items() for row in end.itertuples()
        }  # fmt: skip
        write_scan(
            report, f"Mutations of {structure.name}", _TEXT, numbers, heat_map(mutations), shown_columns
        )  # fmt: skip
    rows: Any = mutations.astype(object).where(mutations.notna(), None).to_dict("records")
    if as_json:
        files = [str(path) for path in (table, report) if path]
        entries = {"input": str(source), "sites": sites, "into": into}
        options.print_json(entries | {"results": rows, "files": files})
    elif rows:
        _print_rows(_SHOWN, rows, table, report)
    if interrupted:
        return options.fail("interrupted. Continue with --resume", options.INTERRUPTED)
    return _status(rows)
