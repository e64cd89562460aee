"""Work against precision: what each method makes of many structures, by evaluations and by seconds.

    python analysis/benchmarks/precision.py -o DIR [--more DIR] [--methods a,b,...]

For every structure the lowest end of all methods with the same freedoms is the best known: torsion methods
keep bond lengths and angles, the others do not. Tables show medians with quartiles; a method that never came
that near counts as endless. All energies are those of the run's own double-precision engine (for openmm, of
its CPU platform).
"""

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

import protochain as pc

SAMPLES = Path(__file__).parents[2] / "structures"
DEFAULT = ("ala10", "1l2y", "1vii", "1ejg", "3i40", "4pti", "1ubq", "1hel")
MORE = (
    "1le1_trpzip2.pdb", "a6pa6_alpha.pdb", "trpcage_d9e_missing.pdb", "1ajj_ldlr.pdb",
    "1bx8_hirustasin.pdb", "1fas_fasciculin.cif", "1orc_icode.pdb", "2sdf_sdf1_nmr30.pdb", "1a8o_mse.pdb",
    "2k39_ubiquitin_nmr15.pdb", "1bta_barstar.pdb", "4cup_missing.cif", "t4l_l99a_amber.pdb",
    "1ake_A.pdb", "boltz2_5ht2c.cif", "3enl_enolase.pdb",
)  # fmt: skip
"""Of a larger collection: crystal, NMR and predicted, 12 to 436 residues."""

IN_TORSIONS = ("kcm", "kcm-adaptive", "kcm-metric", "kcm-stiffness", "newton", "lbfgs")
FREE = ("cartesian", "hybrid", "openmm")
ABOVE = (100.0, 10.0, 1.0)
"""kJ/mol per 100 residues above the best known."""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--more", type=Path, help="folder of further structures")
    parser.add_argument("--methods", default=",".join(IN_TORSIONS + FREE))
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    paths = [SAMPLES / f"{name}.pdb" for name in DEFAULT]
    paths += [options.more / name for name in MORE if options.more and (options.more / name).exists()]
    traces, ends = [], []
    for path in paths:
        structure = pc.load(path)
        chain, energy = pc.build_chain(structure), pc.energy(structure)
        for method in options.methods.split(","):
            # The steady ones need no more; the others would creep for hours on a large protein.
            budget = int(np.clip(2e6 / structure.n_atoms, 200, 1000)) * (2 if method == "openmm" else 1)
            solution = pc.minimise(chain, energy, method, max_evaluations=budget)
            print(f"{structure.name} {structure.n_residues} residues: {solution}", flush=True)
            traces.append(solution.trace.assign(structure=structure.name, method=method))
            record = solution.record()
            ends.append({key: value for key, value in record.items() if not isinstance(value, list | dict)})
            pd.concat(traces).to_csv(options.output / "traces.csv", index=False)
            pd.DataFrame(ends).to_csv(options.output / "ends.csv", index=False)
    show(pd.concat(traces), pd.DataFrame(ends), options.output)


def show(traces: pd.DataFrame, ends: pd.DataFrame, output: Path) -> None:
    """Print the tables and draw the plot."""
    residues = ends.groupby("structure")["n_residues"].first()
    figure, axes = plt.subplots(2, 2, figsize=(11, 8), sharey=True)
    for row, (group, name) in enumerate(((IN_TORSIONS, "torsions only"), (FREE, "all atoms free"))):
        own, last = traces[traces.method.isin(group)], ends[ends.method.isin(group)]
        if own.empty:
            continue
        best = last.groupby("structure")["energy_end_reference_kj_mol"].min()
        print(f"\n{name}: {len(best)} structures, {residues.min()} to {residues.max()} residues\n")
        for unit in ("evaluations", "seconds"):
            print(
                f"| {unit} to within | "
                + " | ".join(f"{x:g} kJ/mol" for x in ABOVE)
                + " | converged | RMSD |"
            )
            print("|---" * (len(ABOVE) + 3) + "|")
            for method in [m for m in group if m in set(own.method)]:
                cells = []
                for above in ABOVE:
                    need = []
                    for structure, trace in own[own.method == method].groupby("structure"):
                        limit = best[structure] + above * residues[structure] / 100.0
                        met = trace[trace.energy_kj_mol <= limit]
                        need.append(met[unit].iloc[0] if len(met) else np.inf)
                    first, middle, third = np.quantile(need, [0.25, 0.5, 0.75], method="higher")
                    quartiles = f"{middle:.3g} ({first:.3g} to {third:.3g})"
                    cells.append(quartiles.replace("inf", "never").replace("never (never to never)", "never"))
                mine = last[last.method == method]
                cells.append(f"{(mine.status == 'converged').sum()} of {len(mine)}")
                cells.append(f"{mine.ca_rmsd_angstrom.median():.2f}")
                print(f"| {method} | " + " | ".join(cells) + " |")
            print()
        for column, unit in enumerate(("evaluations", "seconds")):
            draw(axes[row, column], own, best, residues, group, unit)
            axes[row, column].set_title(name)
    axes[0, 0].set_ylabel("median energy above the best known,\nkJ/mol per 100 residues")
    axes[1, 0].set_ylabel("median energy above the best known,\nkJ/mol per 100 residues")
    figure.tight_layout()
    figure.savefig(output / "precision.png", dpi=150)


def draw(axis, own, best, residues, group, unit) -> None:
    """Draw the median energy above the best known against one measure of work."""
    styles = ("-", "--", ":", "-.", (0, (5, 1)), (0, (1, 1)))
    grid = np.geomspace(1 if unit == "evaluations" else 1e-3, own[unit].max(), 200)
    for k, method in enumerate(m for m in group if m in set(own.method)):
        curves = []
        for structure, trace in own[own.method == method].groupby("structure"):
            lowest = np.minimum.accumulate(trace.energy_kj_mol.to_numpy())
            place = np.searchsorted(trace[unit].to_numpy(), grid, side="right") - 1
            above = (lowest[np.maximum(place, 0)] - best[structure]) * 100.0 / residues[structure]
            curves.append(above)
        axis.plot(grid, np.maximum(np.median(curves, axis=0), 1e-2), label=method, linestyle=styles[k % 6])
    axis.set(xscale="log", yscale="log", xlabel=unit)
    axis.legend(fontsize=8)


if __name__ == "__main__":
    main()
