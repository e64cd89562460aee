"""Tables of a batch. Rows are appended as results arrive. Incomplete rows are removed on resuming."""

import csv
import errno
import os
import re
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path, PurePath
from typing import get_origin

from protochain.batches.batch_settings import NAME as SETTINGS
from protochain.batches.jobs import Job, Row, origin
from protochain.batches.naming import Earlier
from protochain.core.errors import ProtochainError, WriteError
from protochain.core.lazy_pandas import pd
from protochain.core.storage import check_writable, claim_folder, regular, write_text
from protochain.minimisers import record
from protochain.relaxation.poses import COLUMNS as OF_POSE
from protochain.relaxation.record import COLUMNS as OF_RELAXING
from protochain.relaxation.record import INTERFACE_COLUMNS
from protochain.relaxation.record import METHOD as RELAX
from protochain.results.columns import Kind
from protochain.results.run_folder import REPLACE, csv_text, refuse_earlier, remove_files, saving

_LISTS = ("rounds", "ligands", "restraint_violations", "timings")
"""Entries of records that are not columns of a table."""

COLUMNS = (
    *(column.key for column in record.COLUMNS if column.key not in _LISTS), "ca_rmsd_to_openmm_angstrom",
    "n_starts", "energy_median_kj_mol", "energy_highest_kj_mol", "n_within_1_kj_mol_of_lowest",
    "seconds_preparation", "input", "model", "output", "confidences", "key",
)  # fmt: skip
"""Columns of ``summary.csv``: the record of a minimisation, and columns of a batch."""
RELAXED_COLUMNS = (
    *(column.key for column in OF_RELAXING if column.key not in _LISTS),
    "seconds_preparation", "input", "model", "output", "confidences", "key",
)  # fmt: skip
"""Columns of ``relaxed.csv``."""
OF_POSES = tuple(OF_POSE)
"""Columns of an added pose, and with ``structure``, ``status`` and ``message`` of ``poses.csv``."""
OF_INTERFACE = tuple(column.key for column in INTERFACE_COLUMNS)
"""Columns of the scores of an interface."""

_WHOLE = {"iteration": "Int64", "n_starts": "Int64", "n_within_1_kj_mol_of_lowest": "Int64", "model": "Int64"}
_TYPES = dict.fromkeys(("structure", "message", "key", "output"), "string") | _WHOLE
_TYPES |= {
    column.key: "string" if get_origin(column.kind) in (list, dict) else "Int64"
    for column in (*record.COLUMNS, *OF_RELAXING, *INTERFACE_COLUMNS)
    if column.kind in (int, int | None) or get_origin(column.kind) in (list, dict)
}
_OF_KINDS: dict[Kind, str] = {bool | None: "boolean", int | None: "Int64", str: "string"}
_TYPES |= {name: _OF_KINDS[kind] for name, kind in OF_POSE.items() if kind in _OF_KINDS}
"""Types of columns for pandas. Names that look like numbers remain text. Integers may be missing."""
_OF_ROWS = ("structure", "method", "status", "input", "model", "output", "key")
"""Columns of ``summary.csv`` that resuming requires."""

CIRCUMSTANCES = ("killed", "time-limit", "interrupted")
"""Statuses that may differ in another run. Such runs are repeated on resuming."""

TRACE_COLUMNS = (
    "structure", "method", "iteration", "evaluations", "seconds", "energy_kj_mol", "rms_torque_kj_mol_rad",
    "max_torque_kj_mol_rad", "rms_force_kj_mol_nm", "max_force_kj_mol_nm", "ca_rmsd_angstrom", "key",
)  # fmt: skip
_FLOATS = [c.key for c in (*record.COLUMNS, *OF_RELAXING) if c.kind in (float, float | None)]
_NUMBERS: dict[str, Callable[[str], float]] = {
    **dict.fromkeys((*TRACE_COLUMNS[3:-1], *_FLOATS), float),
    **{key: int for key, kind in _TYPES.items() if kind == "Int64"},
}
"""Readers of numeric columns."""


SUMMARY, RELAXED, _TRACES, POSES = "summary", "relaxed", "traces.csv", "poses.csv"
"""Stems of the tables of a batch and of relaxed structures, and names of the tables of traces and poses."""


def replaceable_files(folder: Path, name: str, resume: bool, force: bool) -> list[Path]:
    """Files of a folder that a new batch may replace. None if it resumes or is refused."""
    is_refused = not force and any((folder / f"{table}.csv").exists() for table in (SUMMARY, RELAXED))
    return [] if resume or is_refused else files_of(folder, name)


def files_of(folder: Path, name: str = SUMMARY) -> list[Path]:
    """Files of a batch in its folder, except structures, pages and plots."""
    names = (f"{name}.csv", f"{name}.parquet", _TRACES, "summary.json", "report.html", SETTINGS)
    return [folder / file_name for file_name in names]


class Tables:
    """``summary.csv`` and ``traces.csv`` of a folder, written by one process."""

    # All rows of a structure are appended by one system call, after its traces: a process that is killed has
    # written all of them or none. A loss of power may leave an incomplete row, discarded on resuming.

    def __init__(
        self,
        folder: Path,
        resume: bool,
        name: str = SUMMARY,
        methods: Collection[str] = (),
        further: Sequence[str] = (),
        force: bool = False,
    ) -> None:
        self.name = name
        self.summary, self.traces = folder / f"{name}.csv", folder / _TRACES
        for file in files_of(folder, name):
            check_writable(file)
        self.folder, self._claim = folder, ExitStack()
        self._claim.enter_context(claim_folder(folder, "batch", resume))
        other_table = folder / f"{RELAXED if name == SUMMARY else SUMMARY}.csv"
        files = self.summary, self.traces, folder / SETTINGS
        if force and not resume:
            remove_files((*files, folder / POSES, other_table, other_table.with_suffix(".parquet")))
        self._new = [file for file in files if not file.exists()]
        # Two tables in a folder would share settings and traces.
        if other_table.exists():
            self.close()
            raise ProtochainError(f"{other_table}: contains a batch; give another folder; ", *REPLACE)
        if not (self.summary in self._new or resume):
            self.close()
            raise refuse_earlier(self.summary, "a batch")
        minimised = COLUMNS if {*methods} != {RELAX} else ()
        of_relaxed = RELAXED_COLUMNS if RELAX in methods else ()
        self.columns = tuple(dict.fromkeys((*minimised, *of_relaxed, *further)))

    def check(self) -> None:
        """Raise for damaged tables, before any output."""
        for path in (self.summary, self.traces):
            for _ in _whole_lines(path):
                pass

    def select_finished(self, jobs: Sequence[Job]) -> set[tuple[str, str]]:
        """Remove incomplete rows and rows of superseded inputs. Return the identities of finished jobs."""
        jobs_by_identity = {job.identity: job for job in jobs}
        names, sources = {job.name for job in jobs}, {_source(origin(job)) for job in jobs}
        groups = defaultdict(list)
        for row in _whole_lines(self.summary):
            groups[row["structure"], row["key"]].append(row)
        finished_jobs, rows_of_table = set(), []
        for identity, rows in groups.items():
            job = jobs_by_identity.get(identity)
            if job is not None:
                if {row["method"] for row in rows} != set(job.settings.methods):
                    continue
                if any(row["status"] in CIRCUMSTANCES for row in rows):
                    continue
                finished_jobs.add(identity)
            elif identity[0] in names or _source(rows[0]) in sources:
                continue
            rows_of_table += rows
        self.columns = tuple(dict.fromkeys((*self.columns, *(rows_of_table[0] if rows_of_table else ()))))
        complete = {(row["structure"], row["key"]) for row in rows_of_table}
        traces = [row for row in _whole_lines(self.traces) if (row["structure"], row["key"]) in complete]
        _replace(self.summary, self.columns, rows_of_table)
        _replace(self.traces, TRACE_COLUMNS, traces)
        return finished_jobs

    def append(self, rows: Iterable[Row]) -> None:
        """Append all rows of a structure."""
        rows = list(rows)
        identity = {name: rows[0].record[name] for name in ("structure", "key")}
        traces = [identity | {"method": row.record["method"]} | point for row in rows for point in row.trace]
        _append(self.traces, csv_text(TRACE_COLUMNS, traces))
        _append(self.summary, csv_text(self.columns, [row.record for row in rows]))

    def sort(self, jobs: Sequence[Job]) -> None:
        """Sort the rows by job and method, as they were appended in the order of arrival."""
        order = {
            (*job.identity, method): (k, m)
            for k, job in enumerate(jobs)
            for m, method in enumerate(job.settings.methods)
        }
        last = (len(jobs), 0)
        for path, columns in ((self.summary, self.columns), (self.traces, TRACE_COLUMNS)):
            rows = list(_whole_lines(path))
            rows.sort(key=lambda row: order.get((row["structure"], row["key"], row["method"]), last))
            _replace(path, columns, rows)

    def read(self) -> "pd.DataFrame":
        """Return ``summary.csv``. Failures have missing values."""
        return read_table(self.summary)

    def abandon(self) -> None:
        """Remove the files of a new batch without rows, as they would block the next batch."""
        if self.summary in self._new and not next(iter(_whole_lines(self.summary)), None):
            remove_files(self._new)

    def close(self) -> None:
        """Release the folder."""
        self._claim.close()


def earlier_rows(folder: Path, name: str = SUMMARY) -> list[Earlier]:
    """Return the names and sources of the results in a folder."""
    return [
        Earlier(
            row["structure"], row["input"], row["model"], row["key"], row["output"],
            is_gone=not Path(row["input"]).exists(),
        )
        for row in _whole_lines(folder / f"{name}.csv")
    ]  # fmt: skip


def _source(row: Mapping[str, object]) -> tuple[str, str]:
    return str(row["input"]), str(row["model"])


def read_table(path: Path, types: Mapping[str, str] = _TYPES) -> "pd.DataFrame":
    """Read a table of a batch or of frames with types of columns. Structures may be named NA or null."""
    names = pd.read_csv(path, nrows=0).columns
    missing = {name: [""] if types.get(name) == "string" else ["", "nan"] for name in names}
    table = pd.read_csv(path, dtype={**types}, keep_default_na=False, na_values=missing)
    return table.copy()  # Joins the blocks of a hundred columns, which would be slow.


def _append(path: Path, text: str) -> None:
    file = os.open(path, os.O_WRONLY | os.O_APPEND)
    # Names of files need not be UTF-8.
    size, data = os.fstat(file).st_size, text.encode(errors="backslashreplace")
    try:
        with saving(path, "the structures done before"):
            if os.write(file, data) < len(data):  # On a full disk a part is written.
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    except WriteError:
        os.ftruncate(file, size)
        raise
    finally:
        os.close(file)


def _replace(path: Path, columns: Sequence[str], rows: Iterable[Mapping[str, object]]) -> None:
    write_text(path, csv_text(columns, rows, header=True))


def _whole_lines(path: Path) -> Iterable[dict[str, str]]:
    """Complete, undamaged rows of a table."""
    if not path.exists():
        return
    with regular(path).open(newline="", encoding="utf-8", errors="replace") as file:
        columns, seen, numbers = None, set[tuple[str, ...]](), list[tuple[int, Callable[[str], float]]]()
        complete = (line for line in file if line.endswith("\n"))
        for cells in csv.reader(complete):
            if columns is None:
                columns = cells
                numbers = [(i, _NUMBERS[name]) for i, name in enumerate(columns) if name in _NUMBERS]
                if not {*(TRACE_COLUMNS if path.name == _TRACES else _OF_ROWS)} <= {*columns}:
                    raise ProtochainError(f"{path}: is not a table of a batch; give another folder")
            elif len(cells) == len(columns) and cells != columns and tuple(cells) not in seen:
                seen.add(tuple(cells))  # Skips the duplicates of a table that was appended to itself.
                with suppress(ValueError):
                    for i, read in numbers:
                        read(cells[i] or "0")
                    row = dict(zip(columns, cells, strict=True))
                    if all(_is_below(row.get(name, "")) for name in ("structure", "output")):
                        yield row


def _is_below(name: str) -> bool:
    """Whether a name of a table is a path in its folder, as results are written to these paths."""
    return not PurePath(name).is_absolute() and os.pardir not in re.split(r"[/\\]", name) and "\0" not in name
