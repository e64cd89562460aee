"""Do the methods reach the same minima? Ends of kcm, md, lbfgs and openmm; many starts of two peptides.

    python analysis/benchmarks/minima.py [-o DIR] [--starts N] [STRUCTURE ...]

Without -o it only prints: for each protein the energy each method ends at, and the C-alpha RMSD in angstrom
between the ends; for the peptides, how the ends of N starts (dihedrals perturbed by 30 degrees) are
distributed and how often two methods end in one minimum from the same start. With -o a report of each
comparison and a picture of the distributions are written.
"""

import argparse
from itertools import combinations
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

import protochain as pc

SAMPLES = Path(__file__).parents[2] / "structures"
PROTEINS = ("1l2y", "1vii", "3i40", "4pti", "1ubq")
PEPTIDES = {"Met-enkephalin": "YGGFM", "Ala-10": "AAAAAAAAAA"}
METHODS = ("kcm", "kcm-adaptive", "md", "anneal", "lbfgs", "openmm")
SAME = 0.1
"""angstrom of C-alpha RMSD, and kJ/mol times ten: below both, two ends are one minimum."""


def proteins(paths: list[Path], output: Path | None) -> None:
    """Print ends and RMSDs of each protein."""
    for path in paths:
        k = pc.compare(path, methods=("kcm", "md", "lbfgs", "openmm"))
        print(f"\n{path.stem}: energies at the end, kJ/mol, and C-alpha RMSD between ends, angstrom\n")
        ends = ["start", *(s.method for s in k.solutions)]
        energies = [k.solutions[0].start.energy, *(s.end.energy for s in k.solutions)]
        status = ["", *(str(s.status) for s in k.solutions)]
        print("| | energy | status | " + " | ".join(ends) + " |")
        print("|---|--:|---" + "|--:" * len(ends) + "|")
        for name, energy, how, row in zip(ends, energies, status, k.rmsd.to_numpy(), strict=True):
            print(
                f"| {name} | {energy:.1f} | {how} | " + " | ".join(f"{v:.2f}" for v in row) + " |", flush=True
            )
        if output:
            k.report(output / path.stem)


def peptide(name: str, sequence: str, n_starts: int) -> pd.DataFrame:
    """Tell the ends of every method from the same starts, a row each, with their C-alphas."""
    structure = pc.from_sequence(sequence)
    chain, energy = pc.build_chain(structure), pc.energy(structure)
    relaxed = pc.minimise(chain, energy, "lbfgs", 1.0)
    rng = np.random.default_rng(0)
    rows = []
    for k in range(n_starts):
        q = relaxed.q + np.deg2rad(30.0) * rng.standard_normal(chain.n_q)
        start = pc.build_chain(structure.with_positions(pc.pose(chain, q).x))
        for method in METHODS:
            r = pc.minimise(start, energy, method, 1.0, seed=k)
            rows.append({"peptide": name, "start": k, "method": method, "energy": r.end.energy,
                         "status": str(r.status), "evaluations": r.n_evaluations, "x": r.x})  # fmt: skip
    return pd.DataFrame(rows)


def describe(table: pd.DataFrame, structure: pc.Structure) -> None:
    """Print how ends are distributed, and the share of starts from which two methods reach one minimum."""
    print("\n| method | converged | lowest | median | highest kJ/mol | median evaluations |")
    print("|---|--:|--:|--:|--:|--:|")
    for method, part in table.groupby("method", sort=False):
        e = part["energy"]
        done = 100 * (part["status"] == "converged").mean()
        print(
            f"| {method} | {done:.0f} % | {e.min():.1f} | {e.median():.1f} | {e.max():.1f} "
            f"| {part['evaluations'].median():.0f} |"
        )
    ends = {(row.method, row.start): row for row in table.itertuples()}
    starts = sorted(set(table["start"]))
    print("\nStarts from which two methods end in one minimum:\n")
    print("| | " + " | ".join(METHODS) + " |\n|---" + "|--:" * len(METHODS) + "|")
    share = pd.DataFrame(100.0, index=METHODS, columns=METHODS)
    for a, b in combinations(METHODS, 2):
        same = [
            pc.ca_rmsd(structure, ends[a, k].x, ends[b, k].x) < SAME
            and abs(ends[a, k].energy - ends[b, k].energy) < 10 * SAME
            for k in starts
        ]
        share.loc[a, b] = share.loc[b, a] = 100 * np.mean(same)
    for a in METHODS:
        print(f"| {a} | " + " | ".join(f"{share.loc[a, b]:.0f} %" for b in METHODS) + " |", flush=True)


def draw(tables: list[pd.DataFrame], path: Path) -> None:
    """Draw the distributions of energies at the end."""
    figure, axes = plt.subplots(1, len(tables), figsize=(9, 3.6), layout="constrained")
    for axis, table in zip(axes, tables, strict=True):
        data = [table[table["method"] == m]["energy"] for m in METHODS]
        axis.boxplot(data, tick_labels=METHODS, whis=(0, 100), medianprops={"color": "black"})
        axis.tick_params(axis="x", rotation=40)
        axis.set(title=table["peptide"].iloc[0], ylabel="energy at the end, kJ/mol")
    figure.savefig(path, dpi=150)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("structures", nargs="*", type=Path, default=[SAMPLES / f"{n}.pdb" for n in PROTEINS])
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--starts", type=int, default=50)
    options = parser.parse_args()
    tables = []
    for name, sequence in PEPTIDES.items():
        table = peptide(name, sequence, options.starts)
        print(f"\n{name}, {options.starts} starts")
        describe(table, pc.from_sequence(sequence))
        tables.append(table)
    if options.output:
        options.output.mkdir(parents=True, exist_ok=True)
        pd.concat(tables).drop(columns="x").to_csv(options.output / "starts.csv", index=False)
        draw(tables, options.output / "starts.png")
    proteins(options.structures, options.output)


if __name__ == "__main__":
    main()
