"""``batch``: many structures in many processes. Results are written as they arrive."""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from itertools import islice
from pathlib import Path
from time import perf_counter
from typing import Any

from protochain.batches.batch_settings import store_settings
from protochain.batches.cluster import Processes, Submitted, Workers, open_workers
from protochain.batches.jobs import NAMES, BatchSettings, Job, Row, find_jobs, refuse_unknown
from protochain.batches.table import (
    OF_INTERFACE,
    OF_POSES,
    POSES,
    RELAXED,
    SUMMARY,
    Tables,
    earlier_rows,
    read_table,
)
from protochain.batches.task import Task
from protochain.chains.setup import Setup
from protochain.core import defaults
from protochain.core.checks import check_arguments, flag, function, number, path, several
from protochain.core.errors import ProtochainError
from protochain.core.interrupts import held_interrupts
from protochain.core.lazy_pandas import pd
from protochain.core.settings import document_fields
from protochain.core.storage import json_text, write_atomically, write_text
from protochain.relaxation.record import METHOD as RELAX
from protochain.relaxation.relax_settings import RelaxSettings
from protochain.results.provenance import of_run

_AHEAD = 4  # Submitted jobs for each worker, so that no worker waits.

_RECOUNT = 5.0  # s between counts of the workers, as a cluster may grow.


@document_fields
@dataclass(frozen=True)
class BatchProgress:
    """Progress of a batch, counted in structures."""

    total: int  # All structures.
    done: int  # Structures minimised in this call.
    failed: int  # Failures among these.
    skipped: int  # Structures finished by an earlier call.
    seconds: float  # Time since the first structure was submitted.
    dashboard: str  # Address of Dask's dashboard, if there is one.
    line: str = ""  # Result of the latest structure, as text.


@document_fields
@dataclass(frozen=True)
class Batch:
    """Results of a batch, read from its folder.

    Examples
    --------
    >>> pc.batch("structures/ala10.pdb", "out", "lbfgs", workers=1).table["status"].tolist()
    ['converged']
    """

    folder: Path  # Folder of the batch.
    interrupted: bool = False  # Whether it was stopped before all structures were done.
    name: str = SUMMARY  # Stem of the table's name: ``relaxed`` of :func:`relax_files`.

    @cached_property
    def table(self) -> "pd.DataFrame":
        """``summary.csv``: a row for each structure and method, also for failures."""
        return read_table(self.folder / f"{self.name}.csv")

    @cached_property
    def traces(self) -> "pd.DataFrame":
        """``traces.csv``: up to fifty points of every run."""
        return read_table(self.folder / "traces.csv")

    @property
    def report(self) -> Path:
        """Path of the page that summarises all structures."""
        return self.folder / "report.html"

    def counts(self) -> dict[str, int]:
        """Return the number of rows of each status."""
        return {str(status): int(n) for status, n in self.table["status"].value_counts().items()}

    def __repr__(self) -> str:
        counts = ", ".join(f"{n} {status}" for status, n in self.counts().items())
        return f"<Batch in {self.folder}: {counts}>"

    def _repr_html_(self) -> str:
        return self.table.iloc[:, :12].to_html(index=False, max_rows=20)


@check_arguments(
    output=path, methods=several, manifest=path, resume=flag, force=flag, watch=function("progress"),
    max_rmsd=number,
)  # fmt: skip
def batch(
    inputs: str | Path | Iterable[str | Path],
    output: str | Path,
    methods: str | Sequence[str] = (defaults.METHOD,),
    *,
    manifest: str | Path | None = None,
    resume: bool = False,
    force: bool = False,
    watch: Callable[[BatchProgress], None] | None = None,
    **settings: Any,
) -> Batch:
    """Minimise or relax many structures in worker processes. Write tables, structures and pages.

    Parameters
    ----------
    inputs : path-like or iterable of path-like
        Files, folders, patterns, or ``-`` for a list on standard input, with lines or NULs between the names.
    output : path-like
        Folder for ``summary.csv``, ``traces.csv``, structures and pages. Rows are appended as they arrive.
        At the end, ``summary.parquet``, ``summary.json``, plots and ``report.html`` are written.
    methods : str or sequence of str
        As in :func:`protochain.minimise`, and ``relax``, as :func:`protochain.relax`. With ``openmm`` among
        them, C-alpha RMSDs to its end are reported.
    manifest : path-like, optional
        CSV with a column ``path`` and columns named after settings, which apply to that structure.
    resume : bool
        Continue in a folder with the same settings. Finished, unchanged structures are skipped.
    force : bool
        Replace the batch in the folder. Files of structures that are not in the new batch remain.
    watch : callable, optional
        Called with a :class:`protochain.batches.BatchProgress` after each structure.
    **settings
        Fields of :class:`protochain.batches.BatchSettings` (``max_evaluations``, ``seed`` ...), of
        :class:`protochain.relaxation.RelaxSettings` (``preset``, ``repack`` ...), of
        :class:`protochain.Setup` (``solvent="gbn2"``, ``model="all"`` ...), and of
        :class:`protochain.batches.Processes` (``workers``, ``scheduler``, ``threads``, ``time_limit``).

    Returns
    -------
    Batch
        Tables and pages. A structure that fails has a row with a status and a message.

    Raises
    ------
    ProtochainError
        If there is nothing to do, a setting is unknown, invalid or different from the resumed batch, or the
        folder or cluster cannot be used.

    Examples
    --------
    >>> pc.batch(["structures/ala10.pdb"], "out", methods="lbfgs", workers=1)
    <Batch in out: 1 converged>
    """
    sources = [inputs] if isinstance(inputs, str) else several(inputs, "inputs")
    paths = [str(path(source, "inputs")) for source in sources]
    names = [field.name for field in fields(Processes)]
    refuse_unknown(settings, (*names, *NAMES))
    processes = Processes(**{name: settings.pop(name) for name in names if name in settings})
    common = BatchSettings(tuple(methods)).changed(**settings)
    locations = Path(output), Path(manifest) if manifest else None
    return run_batch(paths, common, *locations, resume, processes, watch, force=force)


def relax_files(
    inputs: Iterable[str | Path],
    output: str | Path,
    relaxing: RelaxSettings | None = None,
    setup: Setup | None = None,
    *,
    manifest: str | Path | None = None,
    resume: bool = False,
    force: bool = False,
    watch: Callable[[BatchProgress], None] | None = None,
    **processes: Any,
) -> Batch:
    """Relax many structures. Like :func:`protochain.batch` with the method ``relax``.

    Parameters
    ----------
    inputs : iterable of path-like
        Files, folders, patterns.
    output : path-like
        Folder for the structures, their table ``relaxed.csv`` and pages.
    relaxing : RelaxSettings, optional
        Settings of the relaxation.
    setup : Setup, optional
        Settings for reading the structures and for their energy. ``threads`` is per structure, 1 by default.
    manifest : path-like, optional
        CSV with a column ``path`` and columns named after fields of ``relaxing`` and ``setup``.
    resume, force : bool
        As of :func:`protochain.batch`.
    watch : callable, optional
        As of :func:`protochain.batch`.
    **processes
        Fields of :class:`protochain.batches.Processes`: ``workers``, ``scheduler``, ``time_limit``.

    Returns
    -------
    Batch
        Its table is ``relaxed.csv``.

    Raises
    ------
    ProtochainError
        If there is nothing to do, the settings differ from the resumed folder, or the folder cannot be used.
    """
    setup = setup or Setup()
    if setup.threads is not None:
        processes = {"threads": setup.threads} | processes
    settings = BatchSettings((RELAX,), setup=setup, relaxing=relaxing or RelaxSettings())
    return run_batch(
        list(inputs), settings, Path(output), Path(manifest) if manifest else None, resume,
        Processes(**processes), watch, RELAXED, force,
    )  # fmt: skip


def run_batch(
    inputs: Sequence[str | Path],
    common: BatchSettings,
    folder: Path,
    manifest: Path | None,
    resume: bool,
    processes: Processes,
    watch: Callable[[BatchProgress], None] | None,
    name: str = SUMMARY,
    force: bool = False,
) -> Batch:
    """Find the structures and run the unfinished ones. Write tables, structures and pages."""
    jobs = find_jobs(inputs, common, manifest, folder, earlier_rows(folder, name) if resume else ())
    differing = next((job for job in jobs if job.settings.methods != common.methods), None)
    if differing and name != SUMMARY:
        raise ProtochainError(
            f"{manifest}: {differing.path}: methods {','.join(differing.settings.methods)}: {name}.csv "
            f"is for {','.join(common.methods)} only; use protochain batch for a manifest with methods"
        )
    scores = any(RELAX in job.settings.methods and job.settings.relaxing.interface for job in jobs)
    methods = {method for job in jobs for method in job.settings.methods}
    has_poses = any(RELAX in job.settings.methods and job.settings.setup.poses for job in jobs)
    further = (*(OF_INTERFACE if scores else ()), *(OF_POSES if has_poses else ()))
    tables = Tables(folder, resume, name, methods, further, force)
    try:
        tables.check()
        store_settings(folder, common, jobs, tables.summary.name)
        finished_keys = tables.select_finished(jobs)
        todo = [job for job in jobs if job.identity not in finished_keys]
        interrupted = False
        if todo:
            with open_workers(processes) as workers:
                interrupted = _work(workers, todo, tables, processes, len(finished_keys), watch)
        with held_interrupts():
            tables.sort(jobs)
            _finish(tables, jobs)
    except BaseException:
        tables.abandon()
        raise
    finally:
        tables.close()
    return Batch(folder, interrupted, tables.name)


def _work(
    workers: Workers, todo: Sequence[Job], tables: Tables, processes: Processes, skipped: int,
    watch: Callable[[BatchProgress], None] | None,
) -> bool:  # fmt: skip
    """Run the jobs and append their rows as they arrive. Return whether the batch was interrupted."""
    began = perf_counter()
    waiting, window = iter(todo), _Window(workers)
    running, folder = Submitted(workers, processes), tables.folder.absolute()
    n_done = failed = 0
    try:
        while True:
            for job in islice(waiting, max(0, window.size() - len(running))):
                running.submit(Task(job.anywhere(), folder))
            if not len(running):
                return False
            task, future = running.wait_for_next()
            if future.cancelled():
                return True  # The connection to the scheduler is lost.
            with held_interrupts() as interrupts:
                message = f"no worker finished this structure: {future.exception()}"
                rows = task.lost([], "killed", message, 0.0) if future.exception() else future.result()
                tables.append(rows)
            n_done += 1
            failed += all("output" not in row.record for row in rows)
            if watch:
                counts = skipped + len(todo), n_done, failed, skipped
                watch(BatchProgress(*counts, perf_counter() - began, workers.dashboard, _line(rows)))
            if interrupts:
                raise KeyboardInterrupt
    except KeyboardInterrupt:
        return True


def _line(rows: Sequence[Row]) -> str:
    """One line for a structure: the result of each method, or the message of a failure."""
    lines: list[str] = []
    for record in (row.record for row in rows):
        if "output" in record and record["status"] not in ("killed", "error"):  # These come from the page.
            is_relaxed = "n_rounds" in record
            before, after = (record.get(f"violations_{stage}") for stage in ("start", "end"))
            violations = f"violations {before} to {after}, " if is_relaxed else ""
            rmsd = record["ca_rmsd_angstrom"]  # none without C-alphas, as of DNA
            displacement = "" if rmsd is None else f"RMSD {rmsd:.2f} angstrom, "
            motion = record.get("ligand_rmsd_angstrom")
            displacement += "" if motion is None else f"ligand RMSD {motion:.2f} angstrom, "
            line = (
                f"{record['method']} {record['status']}, {violations}"
                f"{record['energy_end_reference_kj_mol']:.2f} kJ/mol, {displacement}{record['seconds']:.1f} s"
            )
            n = record.get("n_lost_atoms", 0)
            line += f", lost {n} atom{'s' * (n > 1)}" if n else ""
        else:
            line = f"{record['status']}: {record['message']}"
        lines += [] if line in lines else [line]
    return f"{rows[0].record['structure']}: {'; '.join(lines)}"


class _Window:
    """Number of jobs to submit at a time, so that memory does not grow with the batch."""

    def __init__(self, workers: Workers) -> None:
        self.workers, self.counted, self.count = workers, -_RECOUNT, 0

    def size(self) -> int:
        if perf_counter() - self.counted > _RECOUNT:
            self.count, self.counted = self.workers.count(), perf_counter()
        return _AHEAD * max(self.count, 1)


def _texts(table: "pd.DataFrame", key: str) -> dict[str, str]:
    """Text of a column by structure. Empty cells are skipped."""
    texts = dict(zip(table["structure"], table[key], strict=True))
    return {str(name): text for name, text in texts.items() if isinstance(text, str) and text}


def _finish(tables: Tables, jobs: Sequence[Job]) -> None:
    from protochain.batches.report import write_report

    folder, table = tables.folder, tables.read()
    write_atomically(folder / f"{tables.name}.parquet", lambda to: table.to_parquet(to, index=False))
    if {*OF_POSES} <= {*table}:
        poses = table[table["method"] == RELAX][["structure", "status", "message", *OF_POSES]]
        poses.columns = poses.columns.str.removeprefix("pose_")
        write_text(folder / POSES, poses.to_csv(index=False))
    summary = {
        "n_structures": len(jobs),
        "table": f"{tables.name}.csv",
        "n_rows": len(table),
        "status": {str(name): int(n) for name, n in Counter(table["status"]).items()},
        **{key: _texts(table, key) for key in ("lost_atoms", "far_molecules")},
        **of_run("openmm", "gemmi", "numpy", "scipy", "numba", "pandas"),
        "settings": jobs[0].settings.record(),
    }
    write_text(folder / "summary.json", json_text(summary))
    write_report(folder, table, summary)
