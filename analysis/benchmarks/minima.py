"""Do the methods reach the same minima? Ends of kcm, md, lbfgs and openmm; many starts of two peptides.

    python analysis/benchmarks/minima.py [STUDY ...] [-o DIR] [--quick] [--starts N]

STUDY is any of peptides: how the ends of N starts (dihedrals perturbed by 30 degrees) are distributed, and
how often two methods end in one minimum from the same start; and proteins: the energy at which each method
ends, and the C-alpha RMSD in angstrom between the ends (both by default).
"""

import argparse
from itertools import combinations
from pathlib import Path

import made
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from made import SAMPLES

import protochain as pc

PROTEINS = ("1l2y", "1vii", "3i40", "4pti", "1ubq")
PEPTIDES = {"Met-enkephalin": "YGGFM", "Ala-10": "AAAAAAAAAA"}
STUDIES = ("peptides", "proteins")
METHODS = ("kcm", "kcm-adaptive", "md", "anneal", "lbfgs", "openmm")
SAME = 0.1
"""angstrom of C-alpha RMSD, and kJ/mol times ten: below both, two ends are one minimum."""


COMPARED = ("kcm", "md", "lbfgs", "openmm")


def proteins(names: tuple[str, ...]) -> pd.DataFrame:
    """Ends of each method on each protein, and RMSDs between start and ends."""
    rows = []
    for name in names:
        k = pc.compare(SAMPLES / f"{name}.pdb", methods=COMPARED)
        row: dict[str, object] = {"structure": name, "start_kj_mol": k.solutions[0].start.energy}
        for s in k.solutions:
            row |= {f"{s.method}_kj_mol": s.end.energy, f"{s.method}_status": str(s.status)}
        rmsd = k.rmsd.to_numpy()
        for (i, a), (j, b) in combinations(enumerate(("start", *COMPARED)), 2):
            row[f"{a}_{b}_angstrom"] = rmsd[i, j]
        rows.append(row)
        print(row, flush=True)
    return pd.DataFrame(rows)


def peptide(name: str, sequence: str, n_starts: int) -> pd.DataFrame:
    """Tell the ends of every method from the same starts, a row each, with their C-alphas."""
    structure = pc.from_sequence(sequence)
    chain, energy = pc.build_chain(structure), pc.energy(structure, threads=1)
    relaxed = pc.minimise(chain, energy, "lbfgs", 1.0)
    rng = np.random.default_rng(0)
    rows = []
    for k in range(n_starts):
        q = relaxed.q + np.deg2rad(30.0) * rng.standard_normal(chain.n_q)
        start = pc.build_chain(structure.with_positions(pc.pose(chain, q).x))
        for method in METHODS:
            r = pc.minimise(start, energy, method, 1.0, seed=k)
            rows.append({"peptide": name, "start": k, "method": method, "energy_kj_mol": r.end.energy,
                         "status": str(r.status), "evaluations": r.n_evaluations, "x": r.x})  # fmt: skip
    return pd.DataFrame(rows)


def shares(table: pd.DataFrame, structure: pc.Structure) -> pd.DataFrame:
    """How ends are distributed, and the share of starts from which two methods reach one minimum."""
    ends = {(row.method, row.start): row for row in table.itertuples()}
    starts = sorted(set(table["start"]))
    rows = []
    for method, part in table.groupby("method", sort=False):
        e = part["energy_kj_mol"]
        row: dict[str, object] = {
            "peptide": table["peptide"].iloc[0], "method": method, "starts": len(starts),
            "converged_percent": 100 * (part["status"] == "converged").mean(),
            "lowest_kj_mol": e.min(), "median_kj_mol": e.median(), "highest_kj_mol": e.max(),
            "median_evaluations": part["evaluations"].median(),
        }  # fmt: skip
        for other in METHODS:
            same = [
                pc.ca_rmsd(structure, ends[method, k].x, ends[other, k].x) < SAME
                and abs(ends[method, k].energy_kj_mol - ends[other, k].energy_kj_mol) < 10 * SAME
                for k in starts
            ]
            row[f"same_as_{other}_percent"] = 100 * np.mean(same)
        rows.append(row)
    return pd.DataFrame(rows)


def draw(tables: list[pd.DataFrame], path: Path) -> None:
    """Draw the distributions of energies at the end."""
    figure, axes = plt.subplots(1, len(tables), figsize=(9, 3.6), layout="constrained", squeeze=False)
    for axis, table in zip(axes[0], tables, strict=True):
        data = [table[table["method"] == m]["energy_kj_mol"] for m in METHODS]
        axis.boxplot(data, tick_labels=METHODS, whis=(0, 100), medianprops={"color": "black"})
        axis.tick_params(axis="x", rotation=40)
        axis.set(title=table["peptide"].iloc[0], ylabel="energy at the end, kJ/mol")
    figure.savefig(path, dpi=150)


def parser() -> argparse.ArgumentParser:
    own = made.parser(__doc__, STUDIES)
    own.add_argument("--starts", type=int, default=50)
    return own


def main() -> None:
    options = parser().parse_args()
    wanted = options.studies or STUDIES
    output = options.output
    if "peptides" in wanted:
        found = list(PEPTIDES.items())[: 1 if options.quick else None]
        n = 1 if options.quick else options.starts
        ends = [peptide(name, sequence, n) for name, sequence in found]
        table = pd.concat(shares(t, pc.from_sequence(s)) for t, (_, s) in zip(ends, found, strict=True))
        print(table.to_string(index=False), flush=True)
        if output:
            made.write(table, output / "minima_peptides.csv", dict(found).values())
            each = pd.concat(ends).drop(columns="x")
            made.write(each, output / "minima_starts.csv", dict(found).values())
            draw(ends, output / "minima_starts.png")
    if "proteins" in wanted:
        table = proteins(("ala10",) if options.quick else PROTEINS)
        if output:
            made.write(table, output / "minima_proteins.csv", [f"{p}.pdb" for p in table["structure"]], 2)


if __name__ == "__main__":
    main()
