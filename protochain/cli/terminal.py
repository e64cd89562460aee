"""Output of the command line: a progress bar, and tables of results."""

import math
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from time import monotonic
from typing import TYPE_CHECKING, Any

from protochain.cli.lines import OVERLAPPING, Kind, energy_text, prints, residues_shown, tell, warn
from protochain.cli.options import print_lost, print_violations
from protochain.cli.printable import printable, printer
from protochain.core.lazy_pandas import pd
from protochain.core.timings import PARTS

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from protochain.batches.batch_structures import BatchProgress
    from protochain.batches.frame_files import Watch
    from protochain.batches.frames import FrameResult
    from protochain.batches.jobs import Job
    from protochain.chains.chain import Chain
    from protochain.core.arrays import Watcher
    from protochain.energies import Energy
    from protochain.minimisers import Recipe
    from protochain.results.columns import Column
    from protochain.searching import Search, SearchProgress
    from protochain.structure import Structure

_WIDTH = 80  # Least width, in characters, for the table of results.

_SHOWN_FAILURES = 10  # Listed structures or frames without a result. The table and the page have all.

_SHOWN_MINIMA = 5  # Listed lowest minima of a search. The table and the page have more.

_LINE_EVERY = 60.0  # s between lines without a terminal.
_LONG = 30.0  # s. The expected time of longer runs is reported at the start.


class _Progress:
    """Bar on a terminal, or a line a minute. ``total`` is the number of steps, None if it is not known."""

    def __init__(self, name: str, total: int | None) -> None:
        from rich.progress import BarColumn, Progress, TextColumn

        self.name, self.total = printable(name), total
        self.console = printer(stderr=True)
        columns = (
            TextColumn("{task.description}", markup=False), BarColumn(16), TextColumn("{task.fields[now]}"),
            TextColumn("{task.fields[left]}"),
        )  # fmt: skip
        self.bar = Progress(
            *columns, console=self.console, disable=not (self.console.is_terminal and prints(Kind.PROGRESS))
        )
        self.task = self.bar.add_task(self.name, total=total, now="", left="")
        self.stage = self.now = ""
        self.n_done, self.first = 0.0, 0.0
        self.began = self.printed_at = monotonic()

    def show(self, n_done: float, now: str | None = None) -> None:
        """Show the number of steps or evaluations, and the current state."""
        if n_done < self.n_done or not self.first:
            # A further start, or a resumed run.
            self.began, self.first = monotonic(), n_done
        self.n_done, self.now = n_done, self.now if now is None else now
        name = f"{self.name}: {self.stage}" if self.stage else self.name
        left = self._left()
        self.bar.update(
            self.task, description=name, total=self.total, completed=n_done, now=self.now, left=left
        )
        if not self.console.is_terminal and monotonic() - self.printed_at >= _LINE_EVERY:
            self.printed_at = monotonic()
            self.say(", ".join(part for part in (f"{name}: {self.now}", left) if part))

    def say(self, line: str) -> None:
        """Print a line, above the bar if there is one."""
        if prints(Kind.PROGRESS):
            self.console.print(line, markup=False, highlight=False, soft_wrap=True)

    def _left(self) -> str:
        """Text of the remaining time, empty if it cannot be estimated."""
        elapsed = monotonic() - self.began
        if self.total is None or self.n_done <= self.first or not elapsed:
            return ""
        seconds = elapsed / (self.n_done - self.first) * (self.total - self.n_done)
        return f"about {_clock(seconds)} left"


class _RunProgress(_Progress):
    """Watcher of a minimisation: its stage, energy, torque, evaluations and their rate.

    The remaining time follows from the decrease of the residual ``key`` of the rows to the tolerance.
    """

    key, tolerance, limit = "", 0.0, math.inf
    shown_seconds = math.inf
    text, estimated_at = "", -math.inf

    def __init__(self, name: str) -> None:
        super().__init__(name, None)
        self.residuals: list[tuple[float, float]] = []

    use_positions: "Callable[[Any], None] | None" = None
    writes = True
    """Whether the result will be written."""
    counts = True
    """Whether to show only evaluations, as the energy of the stage is not the energy of the force field."""

    @property
    def wants_positions(self) -> bool:
        return self.use_positions is not None

    def at_stage(self, name: str, evaluations: int) -> None:
        from protochain.minimisers.loop import Stop

        if name != self.stage:
            self.stage, self.counts, self.residuals = name, True, []
            if name == Stop.INTERRUPTED.value:
                ending = "; the best so far will be written" if self.writes else ""
                self.say(f"{self.name}: {name}{ending}")
        self.show(evaluations, f"{evaluations} evaluations" if self.counts else None)

    def at_warning(self, line: str) -> None:
        self.say(f"{self.name}: {line}")

    def __call__(self, row: "Mapping[str, float]", x: Any) -> None:
        torque = row["max_torque_kj_mol_rad"]
        size = "" if torque != torque else f", torque {torque:.3g} kJ/mol/rad"
        now = f"{row['evaluations']:.0f} evaluations, {row['energy_kj_mol']:.2f} kJ/mol{size}"
        self.counts = False
        if row["evaluations"] < self.n_done:
            # A further start.
            self.residuals, self.shown_seconds = [], math.inf
        if (residual := row.get(self.key, math.nan)) > 0.0:
            lowest = self.residuals[-1][1] if self.residuals else math.inf
            self.residuals.append((row["evaluations"], min(residual, lowest)))
        self.show(row["evaluations"], now)
        if self.use_positions:
            self.use_positions(x)

    def _left(self) -> str:
        now = monotonic()
        if self.n_done <= self.first or now <= self.began:
            return ""
        if now - self.estimated_at >= _ESTIMATE_EVERY:
            self.estimated_at = now
            rate = (self.n_done - self.first) / (now - self.began)
            self.text = f"{_clock(now - self.began)}, {rate:.3g} evaluations/s"
            remaining = remaining_evaluations(self.residuals, self.tolerance)
            if remaining is not None:
                # An estimate grows by steps.
                most = min(self.limit - self.n_done, 2.0 * self.shown_seconds * rate)
                self.shown_seconds = min(remaining, most) / rate
                self.total = round(self.n_done + min(remaining, most))
                self.text += f", about {_clock(self.shown_seconds)} left"
        return self.text


_ESTIMATE_EVERY = 0.5  # s between estimates.
_TREND, _CORRELATION = 8, -0.9  # Fewest points of a trend, and its correlation.


def remaining_evaluations(residuals: "Sequence[tuple[float, float]]", tolerance: float) -> float | None:
    """Estimate the evaluations until a residual reaches a tolerance, None without a clear trend.

    Residuals are pairs of evaluations and the lowest residual so far. A line through the later half of their
    logarithms is extended.
    """
    import numpy as np

    points = np.array(residuals[len(residuals) // 2 :])
    if len(points) < _TREND or tolerance <= 0.0 or points[-1, 1] == points[0, 1]:
        return None
    n, logarithms = points[:, 0], np.log(points[:, 1])
    if np.corrcoef(n, logarithms)[0, 1] > _CORRELATION:
        return None
    slope, intercept = np.polyfit(n, logarithms, 1)
    return max(0.0, float((math.log(tolerance) - intercept) / slope - n[-1]))


@contextmanager
def run_progress(
    method: "str | Recipe",
    max_evaluations: int,
    tolerance: float | None,
    use_positions: "Callable[[Any], None] | None" = None,
    writes: bool = True,
) -> Iterator["Watcher"]:
    """Show the progress of a run. ``use_positions`` receives all positions. ``writes`` affects messages."""
    from protochain.minimisers.recipes import recipe_of

    recipe = recipe_of(method)
    progress = _RunProgress(recipe.name)
    progress.key = "max_torque_kj_mol_rad" if recipe.keeps_geometry else "rms_force_kj_mol_nm"
    progress.tolerance, progress.limit = recipe.tolerance(tolerance), max_evaluations
    progress.use_positions, progress.writes = use_positions, writes
    with progress.bar:
        yield progress


@contextmanager
def evaluations_progress(name: str) -> Iterator["Watcher"]:
    """Show stage, energy, evaluations and their rate."""
    progress = _RunProgress(name)
    with progress.bar:
        yield progress


@contextmanager
def simulation_progress(name: str, n_steps: int, time_step: float) -> Iterator["Watcher"]:
    """Show time, temperature, ns/day and remaining time of a simulation."""
    progress = _Progress(name, n_steps)

    def watch(row: "Mapping[str, float]", x: Any) -> None:
        elapsed, n_done = monotonic() - progress.began, row["step"] - progress.first
        rate = 86.4 * time_step * n_done / elapsed if elapsed and progress.first else 0.0
        speed = f", {rate:.1f} ns/day" if rate else ""
        progress.show(row["step"], f"{row['time_ps']:.1f} ps, {row['temperature_k']:.0f} K{speed}")

    with progress.bar:
        yield watch


def typical_evaluations(method: "str | Recipe", max_evaluations: int) -> int:
    """Typical number of evaluations of a method, or the limit if unknown."""
    from protochain.minimisers.recipes import recipe_of

    return min(recipe_of(method).typical or max_evaluations, max_evaluations)


def print_outlook(structure: "Structure", method: "str | Recipe") -> int:
    """Print the problems of a start and their treatment on standard error. Return a factor of evaluations."""
    from protochain.minimisers.recipes import recipe_of
    from protochain.minimisers.start_warnings import describe_start

    lines = describe_start(structure, recipe_of(method))
    warn(lines)
    return 3 if lines else 1  # Starts with overlaps or violations, such as predicted models, need more.


def foretell(chain: "Chain", energy: "Energy", evaluations: int, limit: int) -> None:
    """Report the expected time before a long run."""
    x = chain.structure.positions
    # The first call loads kernels and builds neighbour lists. The quickest is used, as others may wait.
    energy(x)
    seconds = math.inf
    for _ in range(2):
        began = monotonic()
        energy(x)
        seconds = min(seconds, monotonic() - began)
        if seconds * evaluations < _LONG:
            return
    usual = f"typically {evaluations} of at most {limit}" if evaluations < limit else f"at most {limit}"
    work = f"{chain.n_atoms} atoms, {seconds:.2g} s an energy, {usual} evaluations"
    tell(Kind.PROGRESS, f"{work}: about {_clock(seconds * evaluations)}")


def _clock(seconds: float) -> str:
    """Text of a time, in seconds, minutes or hours."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"


@contextmanager
def frames_progress(name: str, total: int) -> Iterator["Watch"]:
    """Show the number of finished frames and the remaining time. List the first unusable frames."""
    progress, lines = _Progress(name, total), list[str]()

    def watch(n_done: int, failed: int, last: "FrameResult") -> None:
        if last.structure is None and len(lines) < _SHOWN_FAILURES:
            lines.append(str(last.record["message"]))
            progress.say(lines[-1] + ("; more are in the table" if len(lines) == _SHOWN_FAILURES else ""))
        progress.show(n_done, f"{n_done} of {total} frames, {failed} failed")

    with progress.bar:
        yield watch


@contextmanager
def count_progress(name: str) -> Iterator["Callable[[int, int], None]"]:
    """Show the number of finished jobs and the remaining time."""
    progress = _Progress(name, 100)
    with progress.bar:
        yield lambda n_done, total: progress.show(100.0 * n_done / total, f"{n_done} of {total}")


@contextmanager
def search_progress(name: str) -> Iterator["Callable[[SearchProgress], None]"]:
    """Show lowest energy, acceptance, evaluations and remaining time of a search."""
    progress = _Progress(name, 100)

    def watch(so_far: "SearchProgress") -> None:
        now = f"lowest {so_far.lowest:.2f} kJ/mol, {100.0 * so_far.acceptance:.0f} % accepted"
        progress.show(100.0 * min(so_far.share, 1.0), f"{now}, {so_far.evaluations} evaluations")

    with progress.bar:
        yield watch


def print_search(result: "Search", output: object) -> None:
    """Print the lowest minima of a search, and the populations of replicas."""
    print(f"{result.chain.structure.name}: {result.energy:.2f} kJ/mol, the lowest of {len(result.q)} minima")
    print(f"  {result.agreement}")
    for row in result.minima.head(_SHOWN_MINIMA).to_dict("records"):
        free = row["free_energy_kj_mol"]
        free_text = "" if math.isnan(free) else f", free energy {free:+.2f}"
        conformer = f", {row['conformer']}" if row["conformer"] else ""
        print(
            f"  {row['minimum']}: {row['above_lowest_kj_mol']:+.2f} kJ/mol{free_text}{conformer}, "
            f"C-alpha RMSD {_distance(row['ca_rmsd_to_lowest_angstrom'])} angstrom"
        )
    for row in result.populations.to_dict("records"):
        energy = f"{row['energy_kj_mol']:.1f} +- {row['energy_error_kj_mol']:.1f} kJ/mol"
        share, error = 100.0 * row["helix_share"], 100.0 * row["helix_share_error"]
        helix = "" if math.isnan(share) else f", helix {share:.1f} +- {error:.1f} %"
        print(f"  {row['temperature_k']:.0f} K: {energy}{helix}")
    print(f"written: {output}")


@contextmanager
def batch_progress() -> Iterator["Callable[[BatchProgress], None]"]:
    """Show a line for each structure, and on a terminal a bar with counts, rate and remaining time."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    console = printer(stderr=True)
    columns = (BarColumn(), TextColumn("{task.fields[now]}"), TimeRemainingColumn())
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=None, now="starting workers")
        shown: list[str] = []

        def watch(so_far: "BatchProgress") -> None:
            if so_far.dashboard and not shown:
                shown.append(so_far.dashboard)
                console.print(f"dashboard: {so_far.dashboard}", highlight=False)
            rate = 60.0 * so_far.done / so_far.seconds
            now = f"{so_far.skipped + so_far.done} of {so_far.total}, {so_far.failed} failed, {rate:.0f}/min"
            if so_far.line and prints(Kind.PROGRESS):
                number = f"[{so_far.skipped + so_far.done} of {so_far.total}]"
                console.print(f"{number} {so_far.line}", markup=False, highlight=False, soft_wrap=True)
            bar.update(task, total=so_far.total, completed=so_far.skipped + so_far.done, now=now)

        yield watch


def _distance(angstrom: float | None) -> str:
    """Text of a distance. Nucleic acids without protein have no C-alpha distance."""
    return "-" if angstrom is None else f"{angstrom:.2f}"


def print_simulation(record: dict[str, Any]) -> None:
    """Print a short summary of a simulation."""
    drift = record["conserved_drift_kj_mol_ps_per_100_atoms"]
    drifts = "" if drift is None else f", conserved energy drifts {drift:.2g} kJ/mol/ps for 100 atoms"
    share = "" if record["accepted"] is None else f", {100 * record['accepted']:.0f} % of trajectories kept"
    speed = record["ns_per_day"]
    duration = "nothing was left to do" if speed is None else f"{speed:.1f} ns/day"
    tell(Kind.VERDICT, f"{record['structure']}: {record['message']}, {duration}")
    tell(
        Kind.RESULT,
        f"temperature {record['mean_temperature_second_half_k']:.1f} K over the second half{drifts}{share}\n"
        f"{_pull_line(record)}"
        f"C-alpha RMSD to the start {_distance(record['ca_rmsd_angstrom'])} angstrom, "
        f"to the input {_distance(record['ca_rmsd_input_angstrom'])} angstrom",
    )
    filed = _distance(record["ca_rmsd_input_as_filed_angstrom"])
    tell(Kind.MORE, f"to the input without superposition {filed} angstrom; frames: {record['frame']}")
    print_violations(record)
    print_lost([record])
    tell(Kind.WRITTEN, f"written: {record['output']}")


def _pull_line(record: dict[str, Any]) -> str:
    if record.get("pull") is None:
        return ""
    return (
        f"pulled {record['pull']}: {record['pull_distance_start_nm']:.3f} -> "
        f"{record['pull_distance_end_nm']:.3f} nm, work {record['pull_work_end_kj_mol']:.1f} kJ/mol, "
        f"largest force {record['pull_force_largest_kj_mol_nm']:.0f} kJ/mol/nm\n"
    )


def print_table(records: list[dict[str, Any]]) -> None:
    """Print a table with a row for each record, and below it their messages."""
    from rich.table import Table

    from protochain.minimisers.record import short_columns

    columns_shown = short_columns(records)
    rows = [[_cell(column, record[column.key]) for column in columns_shown] for record in records]
    console = printer()
    headings = [f"{c.short or c.heading} {c.unit}".strip() for c in columns_shown]
    columns = [list(cells) for cells in zip(headings, *rows, strict=True)]
    if sum(max(map(len, column)) + 1 for column in columns) > max(_WIDTH, console.width):
        # Headings wrap at blanks, numbers do not. Names of methods may be long, and wrap anywhere.
        headings = [heading.replace("/mol/", "/mol /") for heading in headings]
        columns = [[*heading.split(), *cells[1:]] for heading, cells in zip(headings, columns, strict=True)]
    widths = [max(map(len, column)) for column in columns]
    room = max(_WIDTH, console.width) - sum(widths[1:]) - len(widths) + 1
    widths[0] = max(len(headings[0]), min(widths[0], room))
    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
    for heading, width in zip(headings, widths, strict=True):
        table.add_column(heading, min_width=width, max_width=width, justify="right", overflow="fold")
    for row in rows:
        table.add_row(*row)
    # On narrow terminals, rich would cut off numbers.
    if prints(Kind.RESULT):
        console.print(table, crop=False)
    if any(OVERLAPPING.startswith(cell) for row in rows for cell in row if cell.startswith(">")):
        tell(Kind.RESULT, f"energies {OVERLAPPING.replace('1e6', '1e6 kJ/mol')}")
    for record in records:
        console.print(f"{record['method']}: {record['message']}", markup=False, highlight=False)


def _cell(column: "Column", value: Any) -> str:
    text = column.short_text(value)
    return energy_text(text, value).partition(" (")[0] if column.unit == "kJ/mol" else text


def print_timings(record: dict[str, Any]) -> None:
    """Print seconds by part, their sum, and the serial share of the loop."""
    parts = {name: seconds for name, seconds in record["timings"].items() if name in PARTS}
    total = sum(parts.values())
    for name, seconds in {**parts, "all": total}.items():
        print(f"{name:12}{seconds:9.3f} s{seconds / total:6.0%}")
    if (serial := record["timings"]["serial_share_of_loop"]) is not None:
        print(f"{record['evaluations']} evaluations; {serial:.0%} of the loop is serial")


def print_written(record: dict[str, Any]) -> None:
    """Print the remaining violations of a result, its file, and its RMSD to the start."""
    from protochain.validation.findings import describe_remains

    print_violations(record)
    tell(Kind.RESULT, *describe_remains(record, residues_shown()))
    superposed, filed = (_distance(record[f"ca_rmsd_{name}angstrom"]) for name in ("", "as_filed_"))
    tell(Kind.RESULT, f"C-alpha RMSD to the start {superposed} angstrom")
    tell(Kind.MORE, f"without superposition {filed} angstrom; coordinates: {record['frame']}")
    tell(Kind.WRITTEN, f"written: {'standard output' if record['output'] == '-' else record['output']}")


def print_jobs(jobs: "Sequence[Job]") -> None:
    """Print a line for each structure: name, methods, path."""
    for job in jobs:
        print(f"{job.name}  {','.join(job.settings.methods)}  {job.path}")
    print(f"{len(jobs)} structures", file=sys.stderr)


def count_violations(usable: "pd.DataFrame") -> str:
    """Violations of relaxed structures before and after, as text."""
    before, after = (int(usable[f"violations_{stage}"].sum()) for stage in ("start", "end"))
    return f"residues with violations {before} before, {after} after"


def ligands_moved(usable: "pd.DataFrame") -> str:
    """Displacements of ligands, as text. Empty without ligands."""
    rmsd, farthest = (usable.get(f"ligand_{name}_angstrom") for name in ("rmsd", "displacement_max"))
    if rmsd is None or farthest is None or not rmsd.notna().any():
        return ""
    return (
        f"; ligands: median RMSD {rmsd.median():.2f}, largest {rmsd.max():.2f}, "
        f"largest displacement {farthest.max():.2f} angstrom"
    )


def print_batch(table: "pd.DataFrame", report: str) -> None:
    """Print the number of each status for each method, failures, and unconverged relaxations."""
    from protochain.relaxation.record import METHOD as RELAX

    console = printer()
    for method, rows in table.groupby("method", sort=False):
        counts = ", ".join(f"{n} {status}" for status, n in rows["status"].value_counts().items())
        usable = rows[rows["output"].notna()]
        rmsd, seconds = usable["ca_rmsd_angstrom"].median(), usable["seconds"].median()
        ending = f"; medians: RMSD {rmsd:.2f} angstrom, {seconds:.2f} s" if rmsd == rmsd else ""
        ending = f"; {count_violations(usable)}{ending}" if ending and method == RELAX else ending
        ending += ligands_moved(usable)
        console.print(f"{method}: {counts}{ending}", markup=False, highlight=False)
    unconverged = table["method"].eq(RELAX) & table["status"].ne("converged")
    failed = table[table["output"].isna() | unconverged].drop_duplicates("structure")
    for row in failed.head(_SHOWN_FAILURES).itertuples():
        line = f"{row.structure}: {row.status}: {row.message}"
        console.print(line, markup=False, highlight=False, soft_wrap=True)
    if len(failed) > _SHOWN_FAILURES:
        console.print(f"and {len(failed) - _SHOWN_FAILURES} more, in the table")
    print_lost(table.to_dict("records"))
    console.print(f"written: {report} with tables, structures and pages in its folder", soft_wrap=True)


def print_distribution(summary: dict[str, float]) -> None:
    """Print the distribution of final energies of many starts."""
    low, middle, high = (summary[f"energy_{name}_kj_mol"] for name in ("lowest", "median", "highest"))
    tell(
        Kind.RESULT,
        f"{summary['n_starts']} starts: lowest {low:.2f}, median {middle:.2f}, highest {high:.2f} kJ/mol; "
        f"{summary['n_within_1_kj_mol_of_lowest']} within 1 kJ/mol of the lowest",
    )
