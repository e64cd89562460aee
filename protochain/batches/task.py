"""One job of a batch: run all methods, yield rows and traces, and write files."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from protochain.batches.cluster import reason
from protochain.batches.jobs import BatchSettings, Job, Row, failure, origin
from protochain.batches.naming import output_stem, poses_name
from protochain.batches.page import write_page
from protochain.chains.setup import Setup
from protochain.core.lazy_pandas import pd
from protochain.core.storage import regular
from protochain.relaxation.poses import pose_record
from protochain.relaxation.record import METHOD as RELAX
from protochain.structure.formats.confidences import copy_confidences
from protochain.structure.formats.files import suffix_of
from protochain.structure.ligand_files import title_of_last

if TYPE_CHECKING:
    from protochain.chains.chain import Chain
    from protochain.core.arrays import Floats
    from protochain.energies import Energy
    from protochain.minimisers import Solution
    from protochain.relaxation import Relaxation
    from protochain.structure import Structure


TRACE_POINTS = 50
"""Rows of a thinned trace: the first, the last, and others at even spacing in the logarithm of the index."""


def thin_trace(trace: "pd.DataFrame") -> list[dict[str, float]]:
    """Return some rows of a trace, without missing values."""
    n = len(trace)
    if n > TRACE_POINTS:
        places = np.unique(np.geomspace(1, n, TRACE_POINTS).astype(int)) - 1
        trace = trace.iloc[places]
    return [
        {str(key): value for key, value in row.items() if not np.isnan(value)}
        for row in trace.to_dict("records")
    ]


@dataclass(frozen=True)
class Task:
    """Job of a batch, and the folder of its files."""

    job: Job
    folder: Path

    def run(self, threads: int) -> Iterator[Row]:
        """Minimise or relax a structure by all methods. Write its structures and its page."""
        job, began = self.job, perf_counter()
        rows: list[Row] = []
        ends: dict[str, tuple[Structure, Structure | None]] = {}
        try:
            for row, structure, end in _solve(job, self.folder, threads):
                rows.append(row)
                ends[row.record["method"]] = structure, end
                if len(rows) == len(job.settings.methods):
                    try:
                        write_page(self.folder, job, rows, structure.repairs, ends)
                    except Exception as error:  # The result is saved. The page may work with more space.
                        row.record["status"], row.record["message"] = reason(error, job.path)
                yield row
        except Exception as error:
            yield from self.lost(rows, *reason(error, job.path), perf_counter() - began)

    def lost(self, finished_rows: Sequence[Row], status: str, message: str, seconds: float) -> list[Row]:
        """Rows of the methods that were unfinished when the process ended."""
        title = title_of_last(self.job.settings.setup.poses)
        message = f"{title}: {message}" if title else message
        finished = {row.record["method"] for row in finished_rows}
        missing = [method for method in self.job.settings.methods if method not in finished]
        rows = [failure(self.job, method, status, message, seconds) for method in missing]
        return [replace(row, record=row.record | {"pose_title": title}) for row in rows] if title else rows


def _solve(job: Job, folder: Path, threads: int) -> Iterator[tuple[Row, "Structure", "Structure | None"]]:
    """Yield the row, the start and the usable end, or None, of each method."""
    from protochain.results.columns import flat
    from protochain.structure import ca_rmsd
    from protochain.structure.write import common_suffix

    s = job.settings
    began = perf_counter()
    setups = {method: s.of_relaxing if method == RELAX else s.setup for method in s.methods}
    inputs = {setup: _prepare(job.path, replace(setup, threads=threads)) for setup in {*setups.values()}}
    chain = None if s.methods == (RELAX,) else s.setup.chain(inputs[s.setup][0])
    preparation = perf_counter() - began
    reference: tuple[Structure, Floats] | None = None
    # OpenMM first: RMSDs to its end are reported for the others.
    for method in sorted(s.methods, key=lambda method: method != "openmm"):
        structure, energy = inputs[setups[method]]
        result: Solution | Relaxation
        further: dict[str, Any] = {}
        if method == RELAX:
            result, trace = _relax(structure, energy, s)
            further = pose_record(result)
            suffix = suffix_of(job.path)
        else:
            assert chain
            result, further = _run(chain, energy, method, s)
            trace, suffix = result.trace, ".pdb"
        record = {key: flat(value) for key, value in (result.record() | further).items()} | origin(job)
        record |= {"method": method, "seconds_preparation": preparation}
        if result.is_usable:
            suffix = common_suffix([result.structure]) if suffix == ".pdb" else suffix
            record["output"] = f"{output_stem(job.name, method)}{suffix}"
            result.save(folder / record["output"])
            if s.setup.poses:
                s.setup.save_ligands(result, folder / poses_name(job.name, method))
            confidences = copy_confidences(job.path, folder / record["output"])
            record["confidences"] = flat([*(path.name for path in confidences.written), *confidences.left])
        if method == "openmm":
            reference = structure, result.x
        elif reference and reference[0] is structure:
            record["ca_rmsd_to_openmm_angstrom"] = ca_rmsd(structure, result.x, reference[1])
        yield Row(record, thin_trace(trace)), structure, result.structure if result.is_usable else None


def _prepare(path: Path, setup: Setup) -> tuple["Structure", "Energy"]:
    from protochain.energies.requested import cached_energy

    # Standard input of this process carries the jobs.
    structure = setup.load(regular(path))
    return structure, setup.energy(structure, cached_energy)


def _relax(structure: "Structure", energy: "Energy", s: BatchSettings) -> tuple["Relaxation", "pd.DataFrame"]:
    """Relax a structure. Return the result, and its trace as a table."""
    from protochain.relaxation.relax_structure import relax_structure
    from protochain.relaxation.result import TRACE_COLUMNS

    result = relax_structure(structure, energy, s.relaxing, move=s.setup.move)
    trace = pd.DataFrame(result.trace, columns=list(TRACE_COLUMNS))
    return result, trace.astype({"iteration": int, "evaluations": int})


def _run(
    chain: "Chain", energy: "Energy", method: str, s: BatchSettings
) -> tuple["Solution", dict[str, Any]]:
    """Minimise by one method. Return the best solution, and columns of its row about all starts."""
    from protochain.minimisers import explore, minimise

    if s.n_starts == 1:
        return minimise(chain, energy, method, **s.minimising), {"n_starts": 1}
    search = explore(chain, energy, method, s.n_starts, spread=s.spread, **s.minimising)
    overall = search.overall()
    return search.best, overall.pop("starts_summary") | overall
