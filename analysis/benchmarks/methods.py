"""What each method makes of each sample: energy, evaluations, seconds, verdict.

    python analysis/benchmarks/methods.py [-o DIR] [STRUCTURE ...]

Prints a table in Markdown and, with -o, writes it as CSV. All methods start from the same prepared
structure; every energy is that of OpenMM's Reference platform.
"""

import argparse
from pathlib import Path

import pandas as pd

import protochain as pc

SAMPLES = Path(__file__).parents[2] / "structures"
DEFAULT = ("ala10", "1l2y", "1vii", "1ejg", "3i40", "4pti", "1ubq", "1hel")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("structures", nargs="*", type=Path, default=[SAMPLES / f"{n}.pdb" for n in DEFAULT])
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--max-evaluations", type=int, default=5000)
    options = parser.parse_args()
    tables = []
    for path in options.structures:
        comparison = pc.compare(path, max_evaluations=options.max_evaluations)
        tables.append(comparison.table)
        print(f"# {comparison}", flush=True)
        if options.output:
            comparison.report(options.output / comparison.structure.name)
    table = pd.concat(tables, ignore_index=True)
    if options.output:
        table.to_csv(options.output / "methods.csv", index=False)
    print(
        "| structure | atoms | hinges | method | status | start kJ/mol | end kJ/mol "
        "| evaluations | seconds | RMSD angstrom |"
    )
    print("|---|--:|--:|---|---|--:|--:|--:|--:|--:|")
    for row in table.itertuples():
        print(
            f"| {row.structure} | {row.n_atoms} | {row.n_hinges} | {row.method} | {row.status} "
            f"| {row.energy_start_kj_mol:.1f} | {row.energy_end_reference_kj_mol:.1f} "
            f"| {row.evaluations} | {row.seconds:.1f} | {row.ca_rmsd_angstrom:.2f} |"
        )


if __name__ == "__main__":
    main()
