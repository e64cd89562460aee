"""``search``: search for low minima by pieces in processes, from settings to a folder and a result."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from queue import Empty
from time import perf_counter
from typing import Any

from protochain.batches.cluster import Processes, Submitted, open_workers, shared_file
from protochain.chains.articulate import run_identity, with_energy
from protochain.core import defaults
from protochain.core.checks import at_least, check_arguments, function, optional, path, text
from protochain.core.errors import Argument, ProtochainError
from protochain.core.interrupts import held_interrupts
from protochain.core.settings import document_fields, document_settings, settings_from
from protochain.core.storage import check_writable, claim_folder
from protochain.results.run_folder import refuse_earlier, remove_files
from protochain.searching import walker_steps
from protochain.searching.csa import Crossings
from protochain.searching.hopping import Hops
from protochain.searching.landscape import Landscape
from protochain.searching.result import Search
from protochain.searching.search_settings import SearchRunSettings, SearchSettings
from protochain.searching.tempering import Replicas
from protochain.searching.walker_steps import SECONDS, Finding, Method, Piece, PieceEnd

_ATTEMPTS = 5  # Attempts at a piece whose process ends: more memory may be available the next time.
_POLL = 0.2  # s between checks for interrupts.
_LONG = 600.0  # s. Time limit of a piece, whose single steps may be long.


@document_fields
@dataclass(frozen=True)
class SearchProgress:
    """Progress of a search."""

    evaluations: int  # Evaluations of all walkers so far.
    budget: float  # Total evaluations, infinite if only the time is limited.
    share: float  # Spent share of the evaluations or of the time, whichever is larger.
    lowest: float  # kJ/mol: Lowest energy so far.
    acceptance: float  # Mean acceptance over walkers.


@document_settings(SearchSettings, SearchRunSettings)
@check_arguments(
    output=optional(path), workers=optional(at_least(1)), scheduler=optional(text), watch=function("progress")
)
def search(
    chain: Any,
    energy: Any = None,
    method: str = defaults.SEARCH,
    evaluations: int | None = None,
    *,
    hours: float | None = None,
    temperatures: Any = defaults.SEARCH_TEMPERATURES,
    n_walkers: int = defaults.N_WALKERS,
    n_replicas: int = defaults.N_REPLICAS,
    pilot: int = defaults.PILOT,
    seed: int = defaults.SEED,
    restraints: Any = (),
    output: str | Path | None = None,
    resume: bool = False,
    force: bool = False,
    workers: int | None = None,
    scheduler: str | None = None,
    watch: Callable[[SearchProgress], None] | None = None,
) -> Search:
    """Search for low minima of one chain in its torsions, or sample them at several temperatures.

    Parameters
    ----------
    chain : Chain, Structure, path, or anything that :func:`protochain.as_structure` accepts
        A single chain at which all walks begin. :func:`protochain.from_sequence` builds one.
    energy : Energy, optional
        As in :func:`protochain.minimise`.
    output : path-like, optional
        Folder for pieces to resume from, tables, structures, ``summary.json`` and ``report.html``.
    workers : int, optional
        Number of processes of one thread. By default the search runs in this process.
    scheduler : str, optional
        Address of a Dask cluster to use instead, as in :func:`protochain.batch`.
    watch : callable, optional
        Called with a :class:`SearchProgress` after every piece.

    Returns
    -------
    Search
        Minima and samples. After an interrupt it contains all complete pieces.

    Raises
    ------
    ProtochainError
        If a setting is unknown or out of range, or the input or the folder cannot be used.

    Examples
    --------
    >>> c = pc.build_chain(pc.from_sequence("GAG"))
    >>> found = pc.search(c, method="hopping", evaluations=500)
    >>> len(found.minima) > 0
    True
    """
    arguments = locals()
    settings, running = settings_from(SearchSettings, arguments), settings_from(SearchRunSettings, arguments)
    folder = None if output is None else Path(output)
    if folder is None and resume:
        raise ProtochainError(Argument("resume", True), ": give the folder of the search as output")
    if folder is not None:
        check_folder(folder, resume, force)
    landscape = Landscape.of(*with_energy(chain, energy), settings.restraints)
    processes = Processes(workers, scheduler, 1, _LONG) if workers or scheduler else None
    with nullcontext() if folder is None else claim_folder(folder, "search", resume=True):
        walks = _Walks(landscape, settings, folder, running)
        began = perf_counter()
        interrupted = _work(walks, running, processes, watch)
        if not walks.have_begun:
            raise KeyboardInterrupt
        result = Search(
            landscape, settings, tuple(walks.states), tuple(map(Finding.concatenate, walks.findings)),
            perf_counter() - began, interrupted,
        )  # fmt: skip
        if not len(result.q):
            raise ProtochainError(
                f"{landscape.chain.structure.name}: no descent ended at a finite energy; "
                "give another start or energy"
            )
        if folder is not None:
            with held_interrupts():
                result.save(folder)
    return result


def method_of(settings: SearchSettings, walker: int) -> Method:
    """Return the method of a walker."""
    if settings.method == "csa":
        return Crossings(settings.seed, walker)
    if settings.method == "hopping":
        return Hops(settings.temperatures[0], settings.seed, walker)
    return Replicas(settings.temperatures, settings.n_replicas, settings.pilot, settings.seed, walker)


def check_folder(folder: Path, resume: bool, force: bool) -> None:
    """Check the output folder before any work is done."""
    check_writable(folder / "summary.json")
    has_pieces = next(_pieces(folder), None) is not None
    if has_pieces and not (resume or force):
        raise refuse_earlier(folder, "a search")
    if resume and not has_pieces:
        raise ProtochainError(f"{folder}: contains no search to resume; remove ", Argument("resume", True))


def _pieces(folder: Path, walker: str = "*") -> Iterator[Path]:
    return iter(sorted((folder / "pieces").glob(f"walker-{walker}/*.npz")))


class _Walks:
    """States and findings of all walkers, in memory and, piece by piece, in a folder."""

    def __init__(
        self, landscape: Landscape, settings: SearchSettings, folder: Path | None, running: SearchRunSettings
    ) -> None:
        self.landscape, self.folder = landscape, folder
        self.methods = tuple(method_of(settings, k) for k in range(settings.n_walkers))
        self.states: list[Any] = [None] * settings.n_walkers
        self.findings: list[list[Finding]] = [
            [Finding.empty(landscape.chain.n_hinges, settings.n_replicas * (settings.method == "tempering"))]
            for _ in self.methods
        ]
        self.identity: dict[str, Any] = {}
        if folder is not None:  # Only pieces in a folder have it. The fingerprint builds a System.
            others = {name: value for name, value in settings.record().items() if name != "method"}
            identity = run_identity(landscape.chain, landscape.energy)
            self.identity = {"search": settings.method, **others, **identity}
        self.n_pieces = [0] * settings.n_walkers
        if folder is not None and running.resume:
            for walker in range(settings.n_walkers):
                self._read(folder, walker)
        elif folder is not None:
            remove_files(_pieces(folder))

    def _read(self, folder: Path, walker: int) -> None:
        kind = self.methods[walker].state
        for number, piece in enumerate(_pieces(folder, str(walker))):
            if piece != self._path(folder, walker, number):
                raise ProtochainError(
                    f"{piece}: the piece before it is missing; put it back, or search again with ",
                    Argument("force", True),
                )
            state, finding = walker_steps.read_piece(piece, kind, self.identity)
            self.states[walker] = state
            self.findings[walker].append(finding)
            self.n_pieces[walker] = number + 1

    @staticmethod
    def _path(folder: Path, walker: int, number: int) -> Path:
        return folder / "pieces" / f"walker-{walker}" / f"{number:06d}.npz"

    def add_piece(self, walker: int, state: Any, finding: Finding) -> None:
        """Store a piece. Files on the disk are always complete."""
        if state is None or state is self.states[walker]:
            return
        if self.folder is not None:
            path = self._path(self.folder, walker, self.n_pieces[walker])
            walker_steps.write_piece(path, state, finding, self.identity)
        self.states[walker] = state
        self.findings[walker].append(finding)
        self.n_pieces[walker] += 1

    @property
    def have_begun(self) -> bool:
        """Whether any walk has a state."""
        return any(state is not None for state in self.states)

    def wants(self, walker: int, budget: float) -> bool:
        """Whether a walker has evaluations left."""
        state = self.states[walker]
        return state is None or state.n_evaluations < budget

    def progress(self, budget: float, share_of_time: float) -> SearchProgress:
        """Progress of all walks."""
        states = [state for state in self.states if state is not None]
        evaluations = sum(state.n_evaluations for state in states)
        energies = [piece.minima[:, 1].min() for walk in self.findings for piece in walk if len(piece.minima)]
        return SearchProgress(
            evaluations, budget, max(share_of_time, evaluations / budget), float(min(energies)),
            sum(state.acceptance for state in states) / len(states),
        )  # fmt: skip


def _work(
    walks: _Walks,
    run_settings: SearchRunSettings,
    processes: Processes | None,
    watch: Callable[[SearchProgress], None] | None,
) -> bool:
    """Run pieces until evaluations or time are spent. Return whether there was an interrupt."""
    began, seconds = perf_counter(), 3600.0 * run_settings.hours if run_settings.hours else float("inf")
    share = run_settings.budget / len(walks.states)

    def time_left() -> float:
        return seconds - (perf_counter() - began)

    def store(walker: int, state: Any, finding: Finding) -> None:
        walks.add_piece(walker, state, finding)
        if watch and walks.have_begun:
            watch(walks.progress(run_settings.budget, (perf_counter() - began) / seconds))

    with held_interrupts() as interrupts:
        if processes is None:
            while unfinished := [k for k in range(len(walks.states)) if walks.wants(k, share)]:
                for walker in unfinished:
                    if time_left() <= 0.0 and walks.have_begun:
                        return False
                    span = min(SECONDS, time_left())
                    method, state = walks.methods[walker], walks.states[walker]
                    store(walker, *walker_steps.advance(walks.landscape, method, state, share, span))
                    if interrupts:
                        return True
            return False
        shared = walks.landscape, walks.methods
        with shared_file(shared, walks.folder) as task, open_workers(processes) as workers:
            pieces = Submitted(workers, processes)
            return _submit_pieces(walks, task, pieces, share, time_left, store, interrupts)


def _submit_pieces(
    walks: _Walks,
    task: Path,
    pieces: Submitted,
    share: float,
    time_left: Callable[[], float],
    store: Callable[[int, Any, Finding], None],
    interrupts: Sequence[int],
) -> bool:
    """Run the pieces of each walker in turn in processes. Return whether there was an interrupt."""
    idle = {*range(len(walks.states))}
    failures = [0] * len(walks.states)
    while True:
        for walker in sorted(idle):
            has_time = time_left() > 0.0 or not (len(pieces) or walks.have_begun)
            if walks.wants(walker, share) and has_time:
                pieces.submit(Piece(task, walker, walks.states[walker], share, min(SECONDS, time_left())))
                idle.remove(walker)
        if not len(pieces):
            return False
        while True:
            if interrupts:
                return True
            try:
                piece, future = pieces.wait_for_next(_POLL)
                break
            except Empty:
                continue
        walker = piece.walker
        idle.add(walker)
        rows: list[PieceEnd] = future.result()
        (end,) = rows
        if end.finding is not None:
            failures[walker] = 0
            store(walker, end.state, end.finding)
        elif failures[walker] + 1 >= _ATTEMPTS:
            raise ProtochainError(
                f"walker {walker}: {end.message}; earlier results are in the folder, ",
                Argument("resume", True), " continues",
            )  # fmt: skip
        else:
            failures[walker] += 1
