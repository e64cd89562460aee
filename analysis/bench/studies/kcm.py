"""Whether kineto-static compliance (KCM) and constrained dynamics end in different minima, and why.

Every method runs from the same starts of the same chains; a row of ``runs.csv`` is one run, with the minimum
that it leads to and whether it had got there. Runs are added one by one, first starts first, those of one
start together, and those there already are not repeated: the study can be stopped, and goes on when it is
called again. All else is computed from ``runs.csv`` alone, but for the traces of a few runs.
"""

import multiprocessing
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from itertools import islice
from pathlib import Path
from time import monotonic
from typing import Any

import pandas as pd

from bench.studies import kcm_cases, kcm_summary, lowest
from bench.studies.kcm_cases import ENERGIES, MODELS, MOST, N_STARTS, Case, measured
from bench.studies.kcm_plots import SHOWN as TRACED_METHODS
from protochain.core.errors import ProtochainError
from protochain.core.storage import regular, write_text, writing
from protochain.results.figures import check_figure
from protochain.results.tables import save

MINUTES = 60.0
QUICK: dict[str, Any] = {"peptides": ("rgds", "met-enkephalin"), "starts": 0, "evaluations": 4000}
"""Two peptides, phi psi chi, OBC2: a minute on one core."""
SHOWN = (
    "protein", "model", "energy", "start", "seed", "method", "status", "evaluations", "seconds",
    "left_kj_mol", "energy_kj_mol",
)  # fmt: skip

TRACED = 10_000
"""Evaluations of the traces."""

Task = tuple[Case, str, int]


def run(
    output: Path,
    inputs: Sequence[Path] = (),
    *,
    quick: bool = False,
    minutes: float = MINUTES,
    jobs: int = 1,
    starts: int = N_STARTS,
    evaluations: int = MOST,
    figure: Path | None = None,
) -> Iterator[pd.DataFrame]:
    """Add runs to ``runs.csv``, then write the tables, figures and ``summary.md`` that follow from it.

    The study ``lowest`` adds searches to ``lowest.csv``, from which the ends' distance to them follows.
    """
    _check(minutes, jobs, starts, evaluations)
    check_figure(figure)
    path = output / "runs.csv"
    for table in (each for each in inputs if each.suffix == ".csv"):
        _adopt(table, output)
    inputs = [each for each in inputs if each.suffix != ".csv"]
    tasks = list(planned(inputs, quick, starts, evaluations))
    done = _keys(stored(path))
    left = [task for task in tasks if _key(task) not in done]
    for row in _rows(left, jobs, monotonic() + 60.0 * minutes):
        append(path, row)
        yield pd.DataFrame([{name: row.get(name) for name in SHOWN}])
    _add_traces(output, [task[0] for task in tasks])
    yield from kcm_summary.write(output, stored(path), {_key(task) for task in tasks}, figure)


def planned(
    inputs: Sequence[Path], quick: bool = False, starts: int = N_STARTS, evaluations: int = MOST
) -> Iterator[Task]:
    """All runs of the study, in their order: case, method and evaluations at most."""
    chosen = kcm_cases.proteins(tuple(inputs))
    models: tuple[str, ...] = MODELS
    energies = tuple(ENERGIES)
    if quick:
        chosen = [each for each in chosen if each[0] in QUICK["peptides"]]
        models, energies = MODELS[:1], ("obc2",)
        starts, evaluations = min(starts, QUICK["starts"]), min(evaluations, QUICK["evaluations"])
    names = [name for name, _, _ in chosen]
    for name in names:
        if names.count(name) > 1:
            raise ProtochainError(f"{name}: two proteins of this name; rename a file")
    for case, methods in kcm_cases.cases(chosen, models, energies, starts):
        for method in methods:
            yield case, method, evaluations


def stored(path: Path) -> pd.DataFrame:
    """Runs of a table, without a last line that was cut off; empty if there is no table."""
    if not path.exists():
        return pd.DataFrame(columns=list(kcm_cases.KEY))
    text = path.read_text(encoding="utf-8")
    if not text.endswith("\n"):
        with writing(path):
            path.write_text(text[: text.rfind("\n") + 1], encoding="utf-8")
    try:
        # A protein may be called 1e10.
        runs = pd.read_csv(path, converters={"protein": str})
    except (ValueError, pd.errors.ParserError):
        runs = pd.DataFrame()
    if list(runs.columns) != list(kcm_cases.COLUMNS):
        raise ProtochainError(
            f"{path}: is no table of this study, or of another version; give another folder"
        )
    return runs


def _adopt(table: Path, folder: Path) -> None:
    """Copy a table of runs, traces, searches or paths to the folder, unless it has one."""
    text = regular(table).read_text(encoding="utf-8")
    columns = text.partition("\n")[0].split(",")
    names = {
        kcm_cases.COLUMNS[-1]: "runs.csv", lowest.COLUMNS[5]: "lowest.csv",
        "entropy_loss_j_mol_k": "paths.csv", "path_nm": "path_points.csv",
    }  # fmt: skip
    own = folder / next((name for column, name in names.items() if column in columns), "traces.csv")
    if not own.exists():
        write_text(own, text)


def append(path: Path, row: dict[str, Any]) -> None:
    """Add a run to a table, which is made if it is not there."""
    table = pd.DataFrame([row], columns=list(kcm_cases.COLUMNS))
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        table.to_csv(path, mode="a", header=not path.exists() or not path.stat().st_size, index=False)


def _add_traces(output: Path, cases: Sequence[Case]) -> None:
    """Write traces of one start, once: the first deposited one, in solvent, with all hinges, if any is."""
    path = output / "traces.csv"
    wanted = {"start": "deposited", "energy": "obc2", "model": MODELS[0]}

    def fits(case: Case) -> list[bool]:
        return [getattr(case, name) == value for name, value in wanted.items()]

    chosen = max(cases, key=fits, default=None)
    if chosen is None or path.exists() or not (output / "runs.csv").exists():
        return
    rows = [row for method in TRACED_METHODS for row in kcm_cases.traced(chosen, method, TRACED)]
    save(output, {path.name: pd.DataFrame(rows)})


def _rows(tasks: Sequence[Task], jobs: int, until: float) -> Iterator[dict[str, Any]]:
    """Rows of runs as they end; none is started after a time."""
    if jobs == 1:
        for task in tasks:
            if monotonic() >= until:
                return
            yield measured(*task)
        return
    context = multiprocessing.get_context("spawn")
    waiting = iter(tasks)
    with ProcessPoolExecutor(jobs, mp_context=context) as pool:
        first = islice(waiting, jobs if monotonic() < until else 0)
        running = {_submitted(pool, task) for task in first}
        while running:
            ended, running = wait(running, return_when=FIRST_COMPLETED)
            for each in ended:
                following = next(waiting, None) if monotonic() < until else None
                if following is not None:
                    running.add(_submitted(pool, following))
                yield each.result()


def _submitted(pool: Executor, task: Task) -> Future[dict[str, Any]]:
    return pool.submit(measured, *task)


def _key(task: Task) -> tuple[Any, ...]:
    case, method, evaluations = task
    return (*case.key().values(), method, evaluations)


def _keys(runs: pd.DataFrame) -> set[tuple[Any, ...]]:
    return set(runs[list(kcm_cases.KEY)].itertuples(index=False, name=None))


def _check(minutes: float, jobs: int, starts: int, evaluations: int) -> None:
    if not minutes >= 0.0:
        raise ProtochainError(f"minutes {minutes:g}: give 0 or more; 0 makes the summary of the runs there")
    for name, value, least in (("jobs", jobs, 1), ("starts", starts, 0), ("evaluations", evaluations, 1)):
        if value < least:
            raise ProtochainError(f"{name} {value}: give at least {least}")
