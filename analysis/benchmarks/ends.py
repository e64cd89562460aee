"""Which method ends lower, told from chance: many starts of each structure, a little apart.

    python analysis/benchmarks/ends.py STRUCTURE ... [--starts N] [--kept FOLDER] [-o DIR] [--quick]

Every start is the structure as prepared, moved by Gaussian displacements of 0.001 nm. From each, every method
minimises the same energy (ff14SB, OBC2): `cartesian`, `hybrid`, `openmm`, and L-BFGS-B of scipy, which knows
nothing of proteins. A run ends at 1 kJ/mol/nm RMS; what is left of its way is gone by `cartesian` to 0.01,
for all alike, so that ends are minima. Starts that are in a folder (--kept) are not run again.
"""

import argparse
import tempfile
from functools import partial
from pathlib import Path
from time import process_time

import made
import numpy as np
import pandas as pd
from made import SAMPLES
from scipy.optimize import minimize

import protochain as pc
from protochain.energies import Energy

METHODS = ("cartesian", "hybrid", "openmm", "scipy")
TOLERANCE, POLISHED = 1.0, 0.01
"""kJ/mol/nm, RMS of the force: of a run, and of the end of its way."""
MOVED = 1e-3
"""nm, standard deviation of each coordinate."""
MOST = 20_000


def by_scipy(structure: pc.Structure, energy: Energy) -> np.ndarray:
    """End of scipy's L-BFGS-B, positions (na, 3), nm."""

    def value(x: np.ndarray) -> tuple[float, np.ndarray]:
        nonlocal gradient
        found, force = energy(x.reshape(-1, 3))
        gradient = -force.ravel()
        return found, gradient

    def stop(x: np.ndarray) -> None:
        # A line search ends with the point that it takes.
        if np.sqrt(np.mean(gradient**2)) <= TOLERANCE:
            raise StopIteration

    gradient = np.empty(0)

    options = {"maxiter": MOST, "maxfun": MOST, "ftol": 0.0, "gtol": 0.0}
    return minimize(
        value, structure.positions.ravel(), jac=True, method="L-BFGS-B", callback=stop, options=options
    ).x.reshape(-1, 3)


def end(structure: pc.Structure, method: str, energy: Energy) -> np.ndarray:
    """End of a method, positions (na, 3), nm."""
    if method == "scipy":
        return by_scipy(structure, energy)
    return pc.minimise(structure, energy, method, TOLERANCE, MOST, curvature=False).x


def rows(structure: pc.Structure, name: str, energy: Energy, seed: int) -> list[dict[str, object]]:
    """A row for each method from one start."""
    rng = np.random.default_rng(seed)
    start = structure.with_positions(structure.positions + MOVED * rng.normal(size=(structure.n_atoms, 3)))
    found: list[dict[str, object]] = []
    for method in METHODS:
        began = process_time()
        x = end(start, method, energy)
        seconds = process_time() - began
        last = pc.minimise(start.with_positions(x), energy, "cartesian", POLISHED, MOST, curvature=False)
        found.append({
            "structure": name, "atoms": structure.n_atoms, "residues": structure.n_residues,
            "start": seed, "method": method, "run_kj_mol": energy(x)[0], "end_kj_mol": last.end.energy,
            "status": str(last.status), "cpu_seconds": seconds,
        })  # fmt: skip
    return found


def parser() -> argparse.ArgumentParser:
    own = made.parser(__doc__)
    own.add_argument("structures", nargs="*", type=Path, default=[SAMPLES / "1l2y.pdb"])
    own.add_argument("--starts", type=int, default=5, help="of each structure")
    own.add_argument("--kept", type=Path, metavar="FOLDER", help="of starts, not to be run again")
    return own


def main() -> None:
    options = parser().parse_args()
    if options.quick:
        options.structures, options.starts = [SAMPLES / "ala10.pdb"], 2
    with tempfile.TemporaryDirectory() as scratch:
        kept, tables = options.kept or Path(scratch), []
        for file in options.structures:
            structure = pc.load(file)
            energy = pc.energy(structure, threads=1)
            for seed in range(options.starts):
                run = partial(rows, structure, file.stem, energy, seed)
                tables.append(made.kept_rows(kept / f"{file.stem}-{seed}.csv", run))
            of = pd.concat(tables[-options.starts :]).groupby("method")["end_kj_mol"]
            print(file.stem, of.median().round(1).to_dict(), flush=True)
    if options.output:
        made.write(pd.concat(tables), options.output / "ends.csv", options.structures)


if __name__ == "__main__":
    main()
