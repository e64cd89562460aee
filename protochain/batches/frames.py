"""Relax or measure every frame of an ensemble in order, in this process or several."""

from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

from protochain.batches.cluster import Processes, Submitted, open_workers, shared_file
from protochain.batches.frame_tasks import EnergyFrames, FrameJob, FrameRow, RelaxFrames, Task, row_of
from protochain.chains.setup import OF_ENERGY, Setup
from protochain.core.arrays import Value
from protochain.core.checks import at_least, check_arguments, optional, text
from protochain.core.lazy_pandas import pd
from protochain.core.settings import document_fields
from protochain.energies import Energy, as_energy
from protochain.energies.factory import has_energy
from protochain.energies.requested import cached_energy
from protochain.relaxation.relax_settings import fixed_options, split
from protochain.structure import Structure
from protochain.structure.convert import as_frames
from protochain.structure.ensemble import Ensemble
from protochain.structure.formats.frames import Frame, Frames, open_frames
from protochain.structure.select import move_argument

_AHEAD = 3  # Submitted jobs for each worker, so that no worker waits.


@document_fields
@dataclass(frozen=True, eq=False)
class FrameResult(Value):
    """Result of a frame.

    Examples
    --------
    >>> s = pc.load("structures/ala10.pdb")
    >>> next(pc.relax_frames(s, s.positions[None])).record["status"]
    'converged'
    """

    frame: int  # Index in the source, from 0.
    # Row of the frame: ``frame``, ``time_ps``, ``status``, ``message`` and the columns of the task.
    record: Mapping[str, Any]
    structure: Structure | None  # Relaxed or measured structure. None if the frame cannot be used.
    task: Task  # Task of the run.

    @property
    def energy_function(self) -> Energy | None:
        """Energy of the relaxation, shared by all frames. None if this frame was not relaxed or failed."""
        if self.structure is None or not isinstance(self.task, RelaxFrames):
            return None
        return self.task.energy or self.task.setup.energy(self.structure, cached_energy)

    @property
    def move(self) -> str | None:
        """Selection of the moving atoms."""
        return self.task.setup.move if isinstance(self.task, RelaxFrames) else None

    def __repr__(self) -> str:
        state = self.record.get("message") or self.record.get("status") or "measured"
        return f"<Frame {self.frame}: {state}>"


@check_arguments(workers=optional(at_least(1)))
def relax_frames(
    top: Any, frames: Any = None, select: Any = None, *, workers: int | None = None, **options: Any
) -> Iterator[FrameResult]:
    """Relax every frame of an ensemble. The structure is prepared once, and its energy is shared.

    Parameters
    ----------
    top : Structure, path, or anything that :func:`protochain.as_structure` accepts
        Structure with the atoms of the frames. It provides hydrogens and other atoms that frames lack. If it
        is a result, its energy and selection are used as in :func:`protochain.relax`.
    frames : path-like, (n, atoms, 3) float, nm, mdtraj.Trajectory, MDAnalysis Universe or AtomGroup, optional
        Trajectory (``.xtc``, ``.trr``, ``.dcd``, ``.nc``), PDB or mmCIF file with models, or ``.npz`` with
        ``positions`` or ``pos`` and their ``unit``. Its atoms are the atoms of the file ``top``, or of the
        prepared ``top``. It is read frame by frame. A result has its frames, or its final structure. By
        default, the models of the file ``top``, or the frames of the result ``top``.
    select : int, str, slice or list, optional
        Frames: a number, ``"START:STOP:STEP"``, or a list, as ``"0,2,5"``. By default, all frames.
    workers : int, optional
        Processes. By default, this process runs all frames on ``threads`` threads.
    **options
        As for :func:`protochain.relax`.

    Returns
    -------
    iterator of FrameResult
        Results in the order of the frames, for any number of processes. A frame that cannot be used has a
        row with the reason. The other frames continue.

    Raises
    ------
    ProtochainError
        If an option is invalid, or the structure or the frames cannot be used.

    Examples
    --------
    >>> s = pc.load("structures/ala10.pdb")
    >>> [frame.record["frame"] for frame in pc.relax_frames(s, np.array([s.positions, s.positions]))]
    [0, 1]
    """
    relaxing, setup = split({**move_argument(top), **options})
    ensemble, chosen = ensemble_of(top, frames, select, setup)
    processes = Processes(workers, threads=setup.threads or 1) if workers else None
    energy = None
    if has_energy(top):
        setup = setup if processes is None else replace(setup, threads=processes.threads)
        arguments = fixed_options(relaxing, (*options, *(["threads"] if processes else [])))
        energy = setup.energy_of(top, ensemble.structure, arguments)
    return over_frames(ensemble, chosen, RelaxFrames(relaxing, setup, energy), processes)


@check_arguments(between=optional(text), workers=optional(at_least(1)))
def frame_energies(
    top: Any, frames: Any = None, select: Any = None, *, energy: Any = None, between: str | None = None,
    workers: int | None = None, **settings: Any,
) -> "pd.DataFrame":  # fmt: skip
    """Compute the energy of every frame of an ensemble. The structure is prepared once.

    Parameters
    ----------
    top, frames, select : as of :func:`protochain.relax_frames`
        Structure, its frames, and a selection of frames.
    energy : Energy or callable, optional
        As in :func:`protochain.minimise`.
    between : str, optional
        Two parts of the structure, as in :func:`protochain.energy_terms`, for their interaction by term.
    workers : int, optional
        Processes.
    **settings
        Fields of :class:`protochain.Setup`.

    Returns
    -------
    pandas.DataFrame
        A row for each frame: ``frame``, ``time_ps``, ``status``, ``message``, ``energy_kj_mol`` and
        ``rms_force_kj_mol_nm``, or the terms between two parts. Unusable frames have a message.

    Raises
    ------
    ProtochainError
        If a setting is invalid, or the structure, the frames or the energy cannot be used.

    Examples
    --------
    >>> s = pc.load("structures/ala10.pdb")
    >>> table = pc.frame_energies(s, np.array([s.positions, s.positions]))
    >>> bool(np.isclose(table["energy_kj_mol"][1], pc.energy(s)(s.positions)[0]))
    True
    """
    setup = Setup(**settings)
    ensemble, chosen = ensemble_of(top, frames, select, setup)
    frame_energy = None
    if energy is not None or has_energy(top):
        options = {name: getattr(setup, name) for name in OF_ENERGY if name in settings}
        frame_energy = as_energy(energy, ensemble.structure, top, **options)
    task = EnergyFrames(setup, between, frame_energy, whole=between is None)
    processes = Processes(workers, threads=setup.threads or 1) if workers else None
    return pd.DataFrame([dict(row.record) for row in over_frames(ensemble, chosen, task, processes)])


def ensemble_of(top: Any, frames: Any, select: Any, setup: Setup) -> tuple[Ensemble, Frames]:
    """Open frames, prepare their structure, and map its atoms to the atoms of the frames."""
    frames_read = open_frames(as_frames(top if frames is None else frames), select)
    structure = setup.load(top)
    names = ("ph", "disulfide", "forcefield", "ligands", "ligand_charges", "standard_residues", "cap")
    settings = {name: getattr(setup, name) for name in names}
    return Ensemble.of(structure, frames_read, settings), frames_read


def over_frames(
    ensemble: Ensemble, frames: Frames, task: Task, processes: Processes | None = None
) -> Iterator[FrameResult]:
    """Run a task on every frame, in order."""
    if processes is None:
        act = task.begin(ensemble.structure, None)
        for frame in frames:
            yield _result(ensemble, task, frame.index, row_of(ensemble, act, frame))
        return
    arguments = ensemble, task, frames.path and frames.path.absolute()
    with shared_file(arguments) as path, open_workers(processes) as workers:
        waiting: Iterator[Frame | int] = iter(frames if frames.path is None else frames.chosen)
        jobs = deque[FrameJob]()
        rows: dict[int, FrameRow] = {}
        running, retried = Submitted(workers, processes), set[int]()
        while True:
            # Counted from the oldest unfinished job, so that finished results do not accumulate.
            while len(jobs) < _AHEAD * max(1, workers.count()):
                if not (chunk := tuple(islice(waiting, task.at_a_time))):
                    break
                jobs.append(FrameJob(path, chunk))
                running.submit(jobs[-1])
            if not jobs:
                return
            job, future = running.wait_for_next()
            future_rows = future.result()
            # A damaged frame may corrupt memory, so that the process ends at a later, valid frame.
            if future_rows[-1].process_ended and future_rows[-1].index not in retried:
                retried.add(future_rows.pop().index)
            rows |= {row.index: row for row in future_rows}
            if len(future_rows) < len(job.frames):  # From or after the one at which the process ended.
                running.submit(FrameJob(path, job.frames[len(future_rows) :]))
            while jobs and all(index in rows for index in jobs[0].indices):
                for index in jobs.popleft().indices:
                    yield _result(ensemble, task, index, rows.pop(index))


def _result(ensemble: Ensemble, task: Task, index: int, row: FrameRow) -> FrameResult:
    structure = None if row.x is None else ensemble.structure.with_positions(row.x)
    return FrameResult(index, row.record, structure, task)
