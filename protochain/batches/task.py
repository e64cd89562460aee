"""One job of a batch: run all methods, yield rows and traces, write files."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

from protochain.batches.jobs import BatchSettings, Job, Row, failure, origin
from protochain.batches.page import write_page
from protochain.batches.relaxed import SHOWN_RELAXED, RelaxSettings, relaxed
from protochain.batches.thinning import thinned
from protochain.errors import ProtochainError, WriteError
from protochain.minimisers.record import SHOWN

if TYPE_CHECKING:
    from protochain.chain import Chain
    from protochain.energies import Energy
    from protochain.minimisers import Solution
    from protochain.structure import Structure


def run(job: Job, folder: Path, threads: int) -> Iterator[Row]:
    """Minimise a structure by all methods of a job; write its structures and its page.

    Parameters
    ----------
    job : Job
        Structure and settings.
    folder : Path
        Folder for its files.
    threads : int
        Threads for the energy.

    Yields
    ------
    Row
        One a method, as it is done. Input that cannot be used is ``refused``; a bug is an ``error``.
    """
    began = perf_counter()
    done: list[Row] = []
    solve, shown = (relaxed, SHOWN_RELAXED) if isinstance(job.settings, RelaxSettings) else (_solve, SHOWN)
    try:
        for row, structure in solve(job, folder, threads):
            done.append(row)
            repairs = structure.repairs
            yield row
        write_page(folder, job, done, repairs, shown)
    except WriteError as error:  # With space it may be done: not what is wrong with this structure.
        yield from _rest(job, done, "killed", str(error), perf_counter() - began)
    except ProtochainError as error:
        yield from _rest(job, done, "refused", str(error), perf_counter() - began)
    except MemoryError:
        yield from _rest(job, done, "killed", "out of memory", perf_counter() - began)
    except OSError as error:
        why = f"{error.filename or job.path}: {error.strerror or error}"
        yield from _rest(job, done, "refused", why, perf_counter() - began)
    except Exception as error:  # A bug met by one structure must not stop the others.
        yield from _rest(job, done, "error", f"{type(error).__name__}: {error}", perf_counter() - began)


def _rest(job: Job, done: list[Row], status: str, message: str, seconds: float) -> Iterator[Row]:
    finished = {row.record["method"] for row in done}
    for method in job.settings.methods:
        if method not in finished:
            yield failure(job, method, status, message, seconds)


def _solve(job: Job, folder: Path, threads: int) -> Iterator[tuple[Row, "Structure"]]:
    from protochain.energies.shared import shared_energy
    from protochain.minimisers.record import flat
    from protochain.structure import ca_rmsd
    from protochain.structure.write import common_suffix

    s = job.settings
    assert isinstance(s, BatchSettings)
    began = perf_counter()
    setup = replace(s.setup, threads=threads)
    structure, chain, energy = setup.prepare(job.path, build_energy=shared_energy)
    preparation = perf_counter() - began
    ends: dict[str, Solution] = {}
    # OpenMM first: RMSDs to its end are reported for the others.
    for method in sorted(s.methods, key=lambda method: method != "openmm"):
        solution, of_starts = _run(chain, energy, method, s)
        ends[method] = solution
        reference = ends.get("openmm")
        record = {key: flat(value) for key, value in (solution.record() | of_starts).items()} | origin(job)
        record |= {"method": method, "seconds_preparation": preparation}
        if solution.is_usable:
            output = folder / f"{job.name}.{solution.method}{common_suffix([solution.structure])}"
            solution.save(output)
            record["output"] = output.name
        if reference and method != "openmm":
            apart = ca_rmsd(structure, solution.x, reference.x)
            record["ca_rmsd_to_openmm_angstrom"] = apart
        yield Row(record, thinned(solution.trace)), structure


def _run(
    chain: "Chain", energy: "Energy", method: str, s: BatchSettings
) -> tuple["Solution", dict[str, Any]]:
    """Minimise by one method; of several starts, return the best solution and what its row says of all."""
    from protochain.minimisers import explore, minimise

    if s.n_starts == 1:
        solution = minimise(
            chain, energy, method, s.tolerance, s.max_evaluations, s.seed,
            restraint=s.restraint, max_rmsd=s.max_rmsd, curvature=s.curvature,
        )  # fmt: skip
        return solution, {"n_starts": 1}
    found = explore(
        chain, energy, method, s.n_starts, seed=s.seed, spread=s.spread, hop_temperature=s.hop_temperature,
        tolerance=s.tolerance, max_evaluations=s.max_evaluations, curvature=s.curvature,
    )  # fmt: skip
    overall = found.overall()
    return found.best, overall.pop("starts_summary") | overall
