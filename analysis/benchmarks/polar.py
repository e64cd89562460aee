"""What hinges that turn the hydrogens of O, S and N cost methods in torsions, and what they gain.

    python analysis/benchmarks/polar.py [STRUCTURE ...] [-o DIR] [--quick] [--methods NAME ...]

Every structure is minimised by each method with phi, psi and chi, and with polar rotors beside them, from the
same start, on one thread, until the largest torque is below 1 kJ/mol/rad. Hydrogen bonds are those of the end
by mdtraj's Baker-Hubbard criterion.
"""

import argparse
from pathlib import Path
from time import process_time

import made
import mdtraj
import pandas as pd
from made import SAMPLES

import protochain as pc

STRUCTURES = ("ala10", "1l2y", "1vii", "1ejg", "3i40", "4pti", "1ubq", "1hel")
HINGES = {"phi psi chi": "usual", "phi psi chi polar": "polar"}


def bonds(structure: pc.Structure, x: object) -> int:
    """Hydrogen bonds at some positions."""
    topology = mdtraj.Topology.from_openmm(structure.topology)
    return len(mdtraj.baker_hubbard(mdtraj.Trajectory([x], topology)))


def parser() -> argparse.ArgumentParser:
    own = made.parser(__doc__)
    own.add_argument("structures", nargs="*", type=Path, default=[SAMPLES / f"{n}.pdb" for n in STRUCTURES])
    own.add_argument("--methods", nargs="+", default=["lbfgs", "hybrid"])
    return own


def main() -> None:
    options = parser().parse_args()
    if options.quick:
        options.structures = [SAMPLES / "ala10.pdb"]
    rows = []
    for path in options.structures:
        structure = pc.load(path)
        energy = pc.energy(structure, threads=1)
        for method in options.methods:
            row: dict[str, object] = {"structure": path.name.partition(".")[0], "method": method}
            row |= {"residues": structure.n_residues, "bonds_start": bonds(structure, structure.positions)}
            for hinges, name in HINGES.items():
                chain = pc.build_chain(structure, hinges)
                # Kernels are compiled, and read from the disk, before the clock starts.
                pc.minimise(chain, energy, method, max_evaluations=3)
                began = process_time()
                found = pc.minimise(chain, energy, method, 1.0)
                row |= {
                    f"hinges_{name}": len(chain.hinges), f"end_{name}_kj_mol": found.end.energy,
                    f"evaluations_{name}": int(found.trace["evaluations"].iloc[-1]),
                    f"seconds_{name}": process_time() - began, f"status_{name}": str(found.status),
                    f"bonds_{name}": bonds(structure, found.x),
                }  # fmt: skip
            rows.append(row)
            print(*(f"{v:.5g}" if isinstance(v, float) else v for v in row.values()), flush=True)
    table = pd.DataFrame(rows)
    if options.output:
        made.write(table, options.output / "polar.csv", options.structures)
    gained = (table["end_polar_kj_mol"] - table["end_usual_kj_mol"]) / table["residues"]
    cost = table["evaluations_polar"] / table["evaluations_usual"]
    summary = table[["method"]].assign(kj_mol_a_residue=gained, evaluations=cost)
    print("\nWith polar rotors: energy gained, evaluations over those without; medians")
    print(summary.groupby("method").median().round(2))


if __name__ == "__main__":
    main()
