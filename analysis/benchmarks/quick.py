"""The claims of README on structures of the repository, in about five minutes.

    python analysis/bench quick [-o DIR]

Each claim is measured here, beside the published figure. Exit status 1 if one is not met. The published
ratios are medians over other structures, which the repository does not contain. Expect the same order only.
"""

import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import made
import numpy as np
import pandas as pd
from made import RESULTS, ROOT, SAMPLES

import protochain as pc

RACED = ("1l2y", "1vii", "4pti", "1ubq")
EQUAL = 1e-9
"""Largest relative difference of energies and forces from OpenMM's Reference platform."""


def benchmark(name: str, *arguments: str) -> None:
    """Run a benchmark in a process, as the published tables are made."""
    subprocess.run([sys.executable, str(Path(__file__).with_name(name)), *arguments], cwd=ROOT, check=True,
                   stdout=subprocess.DEVNULL)  # fmt: skip


def energies(_: Path) -> list[dict[str, object]]:
    """Compare native energies with OpenMM's Reference platform, and two runs on one and two threads."""
    rows, largest, equal = [], 0.0, True
    for name in RACED:
        structure = pc.load(SAMPLES / f"{name}.pdb")
        native, single = (pc.energy(structure, engine="native", threads=threads) for threads in (2, 1))
        (energy, forces), reference = native(structure.positions), native.reference(structure.positions)
        expected, expected_forces = reference
        apart = np.abs(forces - expected_forces).max() / np.abs(expected_forces).max()
        largest = max(largest, abs(energy - expected) / abs(expected), apart)
        repeated = single(structure.positions)
        equal = equal and repeated[0] == energy and np.array_equal(repeated[1], forces)
    rows.append({"claim": "energies and forces equal OpenMM's Reference platform", "published": "1e-10",
                 "here": f"{largest:.0e}", "met": largest < EQUAL})  # fmt: skip
    rows.append({"claim": "energies repeat bit for bit on one and two threads", "published": "equal",
                 "here": "equal" if equal else "different", "met": equal})  # fmt: skip
    return rows


def race(folder: Path) -> list[dict[str, object]]:
    """Compare the default minimiser with OpenMM's, from one start to one energy."""
    files = [str(SAMPLES / f"{name}.pdb") for name in RACED]
    benchmark("race.py", *files, "--forces", "gbsa", "-o", str(folder))

    def ratios(table: pd.DataFrame) -> pd.Series:
        rows = table[(table["method"] == "cartesian") & (table["tolerance"] == 10.0)]
        return rows["openmm_whole_s"] / rows["energy_whole_s"]

    here, published = (ratios(pd.read_csv(place / "race_gbsa.csv")) for place in (folder, RESULTS))
    return [{
        "claim": f"minimise to OpenMM's energy, whole calls, {len(here)} structures",
        "published": f"{published.median():.0f} times sooner", "here": f"{here.median():.0f} times sooner",
        "met": here.median() > 1.0,
    }]  # fmt: skip


def relaxation(folder: Path) -> list[dict[str, object]]:
    """Compare `relax` with AlphaFold's protocol on a damaged copy of lysozyme."""
    benchmark("relax.py", "--made", "1", "--repeats", "1", "-o", str(folder))
    here, published = (pd.read_csv(place / "relax.csv") for place in (folder, RESULTS))
    return [
        {
            "claim": "relax a damaged model, against AlphaFold's protocol",
            "published": f"{published['times_sooner'].median():.1f} times sooner",
            "here": f"{here['times_sooner'].median():.1f} times sooner",
            "met": here["times_sooner"].median() > 1.0,
        },
        {
            "claim": "violations left by relax", "published": f"{published['violations_relax'].sum():.0f}",
            "here": f"{here['violations_relax'].sum():.0f}",
            "met": here["violations_relax"].sum() <= here["violations_openmm"].sum(),
        },
    ]  # fmt: skip


def compliance(_: Path) -> list[dict[str, object]]:
    """Compare evaluations of KCM by fixed angles with those of KCM with the stiffness metric."""
    structure = pc.load(SAMPLES / "1l2y.pdb")
    ends = {
        method: pc.minimise(structure, method=method, tolerance=1.0, max_evaluations=2000)
        for method in ("kcm", "kcm-stiffness")
    }
    fixed, stiff = ends.values()
    return [{
        "claim": "KCM converges with the stiffness metric, not by fixed angles",
        "published": "converged, budget", "here": f"{stiff.status}, {fixed.status}",
        "met": (str(stiff.status), str(fixed.status)) == ("converged", "budget"),
    }]  # fmt: skip


CLAIMS: tuple[Callable[[Path], list[dict[str, object]]], ...] = (energies, compliance, relaxation, race)


def main(arguments: list[str] | None = None) -> int:
    """Measure every claim, print and write the table, and return the exit status."""
    parser = made.parser(__doc__ or "")
    output = parser.parse_args(arguments).output
    rows: list[dict[str, object]] = []
    with tempfile.TemporaryDirectory() as scratch:
        folder = output or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        for claim in CLAIMS:
            rows += claim(folder)
            print(f"{len(rows)}: {rows[-1]['claim']}: {rows[-1]['here']}", flush=True)
        table = pd.DataFrame(rows)
        table.to_csv(folder / "quick.csv", index=False)
    print(f"\n{made.markdown(table)}")
    return int(not table["met"].all())


if __name__ == "__main__":
    sys.exit(main())
