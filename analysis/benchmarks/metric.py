"""What the metric of the force field's near terms gains over that of springs, which knows positions alone.

    python analysis/benchmarks/metric.py [STRUCTURE ...] [-o DIR] [--quick] [--methods NAME ...]

Every structure is minimised twice by each method, in one process and on one thread: with its energy, and with
the same energy given as a callable, of whose terms nothing is known. Evaluations and processor seconds until
the energy is within 10 and 1 kJ/mol per 100 residues of where the run itself ends; both may end in different
minima, whose energies are told. The last line is the median of the ratios.
"""

import argparse
from pathlib import Path
from time import process_time

import made
import numpy as np
import pandas as pd
from made import SAMPLES

import protochain as pc

STRUCTURES = ("1l2y", "1vii", "1ejg", "3i40", "4pti", "1ubq")
ABOVE = (10.0, 1.0)
"""kJ/mol per 100 residues."""


class Clock:
    """Processor time of every point of a run."""

    def __init__(self) -> None:
        self.seconds: list[float] = []

    def __call__(self, row: dict[str, float], x: np.ndarray) -> None:
        """Note the time."""
        self.seconds.append(process_time())


def needed(chain: pc.Chain, energy: object, method: str) -> dict[str, float]:
    """Evaluations and seconds of one run, and its end."""
    clock, began = Clock(), process_time()
    found = pc.minimise(chain, energy, method, 1.0, watch=clock)
    lowest = np.minimum.accumulate(found.trace["energy_kj_mol"].to_numpy())
    row: dict[str, float] = {"end_kj_mol": found.end.energy}
    for above in ABOVE:
        place = int(np.argmax(lowest <= lowest[-1] + above * chain.structure.n_residues / 100.0))
        row[f"evaluations_to_{above:g}"] = int(found.trace["evaluations"].iloc[place])
        row[f"seconds_to_{above:g}"] = clock.seconds[place] - began
    return row


def parser() -> argparse.ArgumentParser:
    own = made.parser(__doc__)
    own.add_argument("structures", nargs="*", type=Path, default=[SAMPLES / f"{n}.pdb" for n in STRUCTURES])
    own.add_argument("--methods", nargs="+", default=["lbfgs", "cartesian", "hybrid"])
    return own


def main() -> None:
    options = parser().parse_args()
    if options.quick:
        options.structures = [SAMPLES / "ala10.pdb"]
    rows = []
    for path in options.structures:
        structure = pc.load(path)
        chain, energy = pc.build_chain(structure), pc.energy(structure, threads=1)
        for method in options.methods:
            metrics = {"near terms": energy, "springs": lambda x, energy=energy: energy(x)}
            for own in metrics.values():
                # Kernels are compiled, and read from the disk, before the clock starts.
                pc.minimise(chain, own, method, max_evaluations=3)
            for metric, own in metrics.items():
                row = {"structure": path.stem, "method": method, "metric": metric}
                rows.append(row | needed(chain, own, method))
                print(*(f"{v:.4g}" if isinstance(v, float) else v for v in rows[-1].values()), flush=True)
    table = pd.DataFrame(rows)
    if options.output:
        made.write(table, options.output / "metric.csv", options.structures)
    costs = [name for name in table.columns if "_to_" in name]
    of = {name: part.set_index(["structure", "method"])[costs] for name, part in table.groupby("metric")}
    ratios = of["springs"] / of["near terms"]
    print("\nsprings / near terms, median\n", ratios.groupby("method").median().round(2))


if __name__ == "__main__":
    main()
