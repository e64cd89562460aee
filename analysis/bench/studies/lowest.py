"""Lowest minima of peptides by conformational space annealing, in the bodies and energy of the study of KCM.

A row of ``lowest.csv`` is one search of one walk. Rows are added one by one, and those already in the table
are not repeated. The structure of lowest energy is polished as the ends of all other methods are.
"""

from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path
from time import monotonic, perf_counter
from typing import Any

import pandas as pd

from bench.studies import kcm_cases
from bench.studies.kcm_cases import MODELS, SMALL, Case
from protochain.core.errors import ProtochainError
from protochain.core.storage import writing
from protochain.searching import search

MINUTES = 20.0
EVALUATIONS = (4000, 40_000, 120_000)
"""Of one search: short ones of all peptides first."""
QUICK = ("ala2", "rgds")
KEY = ("protein", "seed", "max_evaluations")
COLUMNS = (*KEY, "residues", "hinges", "minima", "evaluations", "seconds", "energy_kj_mol", "torsions_deg")


def run(
    output: Path,
    inputs: Sequence[Path] = (),
    *,
    quick: bool = False,
    minutes: float = MINUTES,
    starts: int = 1,
) -> Iterator[pd.DataFrame]:
    """Add searches to ``lowest.csv``: ``starts`` is the number of seeds."""
    path = output / "lowest.csv"
    done = set(stored(path)[list(KEY)].itertuples(index=False, name=None))
    until = monotonic() + 60.0 * minutes
    cases = [case for case in peptides(tuple(inputs)) if not quick or case.protein in QUICK]
    for evaluations, seed, case in product((2000,) if quick else EVALUATIONS, range(starts), cases):
        if (case.protein, seed, evaluations) in done:
            continue
        if monotonic() >= until:
            return
        row = searched(case, seed, evaluations)
        append(path, row)
        yield pd.DataFrame([row]).drop(columns="torsions_deg")


def peptides(inputs: tuple[Path, ...] = ()) -> list[Case]:
    """Extended starts of at most ``SMALL`` residues, in solvent and with all hinges, small ones first."""
    cases = [
        case
        for case, _ in kcm_cases.cases(kcm_cases.proteins(inputs), MODELS[:1], ("obc2",), 0)
        if case.start == "extended"
    ]
    return [case for case in cases if kcm_cases.started(case).chain.structure.n_residues <= SMALL]


def searched(case: Case, seed: int, evaluations: int) -> dict[str, Any]:
    """One search, and its lowest minimum after the polish, as a row of the table."""
    start = kcm_cases.started(case)
    began = perf_counter()
    result = search(start.chain, start.energy, "csa", evaluations, n_walkers=1, seed=seed)
    seconds = perf_counter() - began
    if result.interrupted:
        raise KeyboardInterrupt
    end = kcm_cases.polish(start, result.q[0])
    torsions = " ".join(f"{torsion:.1f}" for torsion in kcm_cases.torsions(end))
    values = (
        case.protein, seed, evaluations, start.chain.structure.n_residues, start.chain.n_hinges,
        len(result.energies), result.n_evaluations, round(seconds, 1), end.end.energy, torsions,
    )  # fmt: skip
    return dict(zip(COLUMNS, values, strict=True))


def stored(path: Path, columns: Sequence[str] = COLUMNS) -> pd.DataFrame:
    """Rows of a table of a study with these columns; empty if there is no table."""
    if not path.exists():
        return pd.DataFrame(columns=list(columns))
    rows = pd.read_csv(path, converters={"protein": str})
    if list(rows.columns) != list(columns):
        raise ProtochainError(f"{path}: is not a table of this study; give another folder")
    return rows


def append(path: Path, row: dict[str, Any]) -> None:
    """Add a row to a table, which is made if it does not exist."""
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        pd.DataFrame([row]).to_csv(path, mode="a", header=not path.exists(), index=False)
