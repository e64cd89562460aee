"""Output of the command line: a bar while it computes, a table when it is done."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from pandas import DataFrame

    from protochain.arrays import Watcher
    from protochain.batches.api import BatchProgress
    from protochain.batches.jobs import Job

_SHOWN_FAILURES = 10
"""Structures without a result to list; the table and the page have all."""


@contextmanager
def run_progress(method: str, max_evaluations: int) -> Iterator["Watcher"]:
    """Show a bar with energy, torque and evaluations on standard error, if that is a terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[now]}"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task(method, total=max_evaluations, now="")

        def watch(row: "Mapping[str, float]", x: Any) -> None:
            torque = row["max_torque_kj_mol_rad"]
            size = "" if torque != torque else f", torque {torque:.3g} kJ/mol/rad"
            now = f"{row['evaluations']:.0f} evaluations, {row['energy_kj_mol']:.2f} kJ/mol{size}"
            bar.update(task, completed=row["evaluations"], now=now)

        yield watch


@contextmanager
def simulation_progress(name: str, n_steps: int, time_step: float) -> Iterator["Watcher"]:
    """Show a bar with time, temperature, nanoseconds a day and the time left, if that is a terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[now]}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task(name, total=n_steps, now="")

        def watch(row: "Mapping[str, float]", x: Any) -> None:
            speed = bar.tasks[0].speed
            rate = "" if speed is None else f", {86.4 * speed * time_step:.1f} ns/day"
            now = f"{row['time_ps']:.1f} ps, {row['temperature_k']:.0f} K{rate}"
            bar.update(task, completed=row["step"], now=now)

        yield watch


@contextmanager
def batch_progress() -> Iterator["Callable[[BatchProgress], None]"]:
    """Show a bar with done, failed, structures a minute and the time left, if that is a terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = (BarColumn(), TextColumn("{task.fields[now]}"), TimeRemainingColumn())
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=None, now="starting workers")
        told: list[str] = []

        def watch(so_far: "BatchProgress") -> None:
            if so_far.dashboard and not told:
                told.append(so_far.dashboard)
                console.print(f"dashboard: {so_far.dashboard}", highlight=False)
            rate = 60.0 * so_far.done / so_far.seconds
            now = f"{so_far.skipped + so_far.done} of {so_far.total}, {so_far.failed} failed, {rate:.0f}/min"
            bar.update(task, total=so_far.total, completed=so_far.skipped + so_far.done, now=now)

        yield watch


def print_simulation(record: dict[str, Any]) -> None:
    """Print a short summary of a simulation."""
    kept = "" if record["accepted"] is None else f", {100 * record['accepted']:.0f} % of trajectories kept"
    print(
        f"{record['structure']}: {record['message']}, {record['ns_per_day']:.1f} ns/day\n"
        f"temperature {record['mean_temperature_second_half_k']:.1f} K over the second half, "
        f"conserved energy drifts {record['conserved_drift_kj_mol_ps_per_100_atoms']:.2g} kJ/mol/ps "
        f"for 100 atoms{kept}\n"
        f"C-alpha RMSD to the start {record['ca_rmsd_angstrom']:.2f} angstrom\n"
        f"written: {record['output']}"
    )


def print_table(records: list[dict[str, Any]]) -> None:
    """Print a table with a row for each record, and below it their messages."""
    from rich.console import Console
    from rich.table import Table

    from protochain.minimisers.record import SHOWN

    rows = [
        [
            f"{r[c.key]:.2f}" if isinstance(r[c.key], float) else str("-" if r[c.key] is None else r[c.key])
            for c in SHOWN
        ]
        for r in records
    ]
    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
    for column, cells in zip(SHOWN, zip(*rows, strict=True), strict=True):
        # Headings may wrap at blanks; numbers may not.
        words = f"{column.short or column.heading} {column.unit}".replace("/mol/", "/mol /").strip()
        table.add_column(words, min_width=max(map(len, cells)), justify="right")
    for row in rows:
        table.add_row(*row)
    console = Console()
    # In less room than the numbers take rich would cut the last ones off.
    console.print(table, crop=False)
    for record in records:
        console.print(f"{record['method']}: {record['message']}", markup=False, highlight=False)


def print_jobs(jobs: "Sequence[Job]") -> None:
    """Print a line for each structure: name, methods, path."""
    for job in jobs:
        print(f"{job.name}  {','.join(job.settings.methods)}  {job.path}")
    print(f"{len(jobs)} structures", file=sys.stderr)


def print_batch(table: "DataFrame", report: str) -> None:
    """Print the number of runs of each status for each method, and the failures."""
    from rich.console import Console

    console = Console()
    for method, rows in table.groupby("method", sort=False):
        counts = ", ".join(f"{n} {status}" for status, n in rows["status"].value_counts().items())
        usable = rows[rows["output"].notna()]
        rmsd, seconds = usable["ca_rmsd_angstrom"].median(), usable["seconds"].median()
        told = f"; medians: RMSD {rmsd:.2f} angstrom, {seconds:.2f} s" if rmsd == rmsd else ""
        console.print(f"{method}: {counts}{told}", markup=False, highlight=False)
    failed = table[table["output"].isna()].drop_duplicates("structure")
    for row in failed.head(_SHOWN_FAILURES).itertuples():
        console.print(
            f"{row.structure}: {row.status}: {row.message}", markup=False, highlight=False, soft_wrap=True
        )
    if len(failed) > _SHOWN_FAILURES:
        console.print(f"and {len(failed) - _SHOWN_FAILURES} more without a result")
    console.print(f"written: {report} and the tables, structures and pages beside it", soft_wrap=True)


def print_distribution(summary: dict[str, float]) -> None:
    """Print the distribution of final energies of many starts."""
    low, middle, high = (summary[f"energy_{name}_kj_mol"] for name in ("lowest", "median", "highest"))
    print(
        f"{summary['n_starts']} starts: lowest {low:.2f}, median {middle:.2f}, highest {high:.2f} kJ/mol; "
        f"{summary['n_within_1_kj_mol_of_lowest']} within 1 kJ/mol of the lowest"
    )


def print_deviations(rows: list[dict[str, Any]]) -> None:
    """Print a row for each model measured, and a line for each that cannot be."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column("file", overflow="fold", min_width=24)
    for heading in ("model", "RMSD angstrom", "TM-score", "matched residues"):
        table.add_column(heading, justify="right")
    measured = [row for row in rows if not row["message"]]
    for row in measured:
        score = row["tm_score"]
        table.add_row(
            escape(row["file"]), f"{row['model']:.0f}", f"{row['rmsd_angstrom']:.3f}",
            "-" if score is None else f"{score:.4f}",
            f"{row['matched_residues']:.0f} ({100 * row['coverage']:.0f} %) by {row['matched_by']}",
        )  # fmt: skip
    console = Console()
    if measured:
        console.print(table)
    for row in rows:
        if row["message"]:
            console.print(row["message"], markup=False, highlight=False, soft_wrap=True)
