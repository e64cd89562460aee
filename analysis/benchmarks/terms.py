"""What the terms of an energy cost, by residue and by pair of residues, in evaluations.

    python analysis/benchmarks/terms.py [-o DIR] [--quick] [--rounds N] [STRUCTURE ...]

On one thread. An evaluation, the terms with their shares by residue, and those of pairs are timed in turn, so
that a slow moment strikes all; the least of all rounds counts. Terms are those of a record and the shares of
``pc.energy_terms``. The largest deviation of their sum from the energy is relative to the largest term.
"""

import argparse
from pathlib import Path
from time import process_time

import made
import pandas as pd
from made import SAMPLES

import protochain as pc
from protochain.energies import decomposed

STRUCTURES = ("1l2y", "1ubq", "1hel", "4ake")
SETTINGS = (("amber14", "obc2"), ("amber19", "gbn2"), ("charmm36", "vacuum"))
BURST = 5
"""Calls of each in a round."""


def parser() -> argparse.ArgumentParser:
    own = made.parser(__doc__)
    paths = [next(SAMPLES.glob(f"{name}.pdb*")) for name in STRUCTURES]
    own.add_argument("structures", nargs="*", type=Path, default=paths)
    own.add_argument("--rounds", type=int, default=8)
    return own


def row_of(path: Path, forcefield: str, solvent: str, rounds: int) -> dict[str, object]:
    """Times of one structure and energy."""
    structure = pc.load(path, forcefield=forcefield)
    energy = pc.energy(structure, forcefield, solvent, "native", threads=1)
    x = structure.positions
    calls = {
        "evaluation": lambda: energy(x),
        "shares": lambda: decomposed(structure, energy, x),
        "pairs": lambda: decomposed(structure, energy, x, pairs=True),
    }
    for call in calls.values():
        call()
    least = dict.fromkeys(calls, float("inf"))
    for _ in range(rounds):
        for name, call in calls.items():
            began = process_time()
            for _ in range(BURST):
                call()
            least[name] = min(least[name], (process_time() - began) / BURST)
    terms = decomposed(structure, energy, x).terms
    off = abs(sum(terms.values()) - energy(x)[0]) / max(map(abs, terms.values()))
    return {
        "structure": path.name.partition(".")[0], "atoms": structure.n_atoms, "forcefield": forcefield,
        "solvent": solvent, "evaluation_ms": 1e3 * least["evaluation"],
        "shares_evaluations": least["shares"] / least["evaluation"],
        "pairs_evaluations": least["pairs"] / least["evaluation"], "deviation": off,
    }  # fmt: skip


def main() -> None:
    options = parser().parse_args()
    if options.quick:
        options.structures, options.rounds = options.structures[:1], 2
    rows = []
    for path in options.structures:
        for forcefield, solvent in SETTINGS:
            rows.append(row_of(path, forcefield, solvent, options.rounds))
            print(*(f"{v:.4g}" if isinstance(v, float) else v for v in rows[-1].values()), flush=True)
    if options.output:
        made.write(pd.DataFrame(rows), options.output / "terms.csv", options.structures)


if __name__ == "__main__":
    main()
