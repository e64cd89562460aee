"""Files of all kinds: what each is taken as and how long that takes; closures of rings and bridges.

    python analysis/benchmarks/files.py [-o DIR] [STUDY ...] [--structures DIR]

STUDY is any of table, speed, closures (all by default). Each prints a table; with -o they are written too.
"""

import argparse
import io
import resource
from pathlib import Path
from time import perf_counter

import numpy as np
import pandas as pd
from dynamics import markdown
from openmm import app
from pdbfixer import PDBFixer

import protochain as pc

ROOT = Path(__file__).parents[2]
CLOSED = (
    "1ejg_crambin.pdb",
    "3i40_insulin.pdb",
    "1v6p_cobrotoxin_amber.pdb",
    "5vav_cyclic.pdb",
    "1a1p_compstatin.pdb",
)
METHODS = ("kcm", "kcm-adaptive", "lbfgs", "md", "hybrid", "cartesian", "openmm")


def table(folder: Path) -> pd.DataFrame:
    """Files: what each is taken as, or which line refuses it."""
    rows = []
    for path in sorted(folder.rglob("*")):
        if path.suffix not in (".pdb", ".cif"):
            continue
        began = perf_counter()
        row: dict[str, object] = {"file": str(path.relative_to(folder))}
        try:
            s = pc.load(path)
            row |= {
                "chains": s.n_chains,
                "residues": s.n_residues,
                "atoms": s.n_atoms,
                "repairs": len(s.repairs),
            }
            row["first repair"] = next(iter(s.repairs), "")
        except pc.ProtochainError as error:
            row["refused"] = str(error).removeprefix(f"{path}: ")
        rows.append(row | {"seconds": perf_counter() - began})
    return pd.DataFrame(rows).fillna("")


def speed(folder: Path) -> pd.DataFrame:
    """Seconds of preparation, warm, against PDBFixer and Modeller.addHydrogens; memory in all so far."""
    rows = []
    for name in ("4pti_bpti.pdb", "1ubq_ubiquitin.pdb", "1hel_lysozyme.pdb", "1ake_A.pdb", "4jsv_2750.pdb"):
        path = folder / name
        ours, theirs = [], []
        for _ in range(3):
            began = perf_counter()
            s = pc.load(path)
            ours.append(perf_counter() - began)
            if s.n_residues < 1000:
                began = perf_counter()
                _by_openmm(path)
                theirs.append(perf_counter() - began)
        rows.append(
            {
                "structure": path.stem,
                "residues": s.n_residues,
                "atoms": s.n_atoms,
                "seconds": min(ours),
                "PDBFixer and addHydrogens": min(theirs) if theirs else np.nan,
                "peak memory, MB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
            }
        )
    return pd.DataFrame(rows)


def _by_openmm(path: Path) -> None:
    fixer = PDBFixer(pdbfile=io.StringIO(path.read_text()))
    fixer.removeHeterogens(keepWater=False)
    fixer.missingResidues = {}
    fixer.findMissingAtoms()
    fixer.addMissingAtoms(seed=1)
    modeller = app.Modeller(fixer.topology, fixer.positions)
    modeller.addHydrogens(app.ForceField("amber14/protein.ff14SB.xml"), pH=7.0)


def closures(folder: Path) -> pd.DataFrame:
    """Lengths of the bonds that close loops, before and after each method, OBC2."""
    rows = []
    for name in CLOSED:
        s = pc.load(folder / name)
        chain, energy = pc.build_chain(s), pc.energy(s)
        first, second = chain.loops.T
        row: dict[str, object] = {
            "structure": s.name,
            "loops": len(chain.loops),
            "start": _range(s.positions, first, second),
        }
        for method in METHODS:
            r = pc.minimise(chain, energy, method, max_evaluations=3000)
            row[method] = _range(r.x, first, second)
        rows.append(row)
    return pd.DataFrame(rows)


def _range(x: np.ndarray, first: np.ndarray, second: np.ndarray) -> str:
    lengths = 10.0 * np.linalg.norm(x[first] - x[second], axis=1)
    return f"{lengths.min():.3f} to {lengths.max():.3f}"


STUDIES = {"table": table, "speed": speed, "closures": closures}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("studies", nargs="*", metavar="STUDY", default=list(STUDIES))
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--structures", type=Path, default=ROOT.parent / "shared" / "structures")
    options = parser.parse_args()
    for name in options.studies:
        found = STUDIES[name](options.structures)
        print(f"\n{STUDIES[name].__doc__}\n\n{markdown(found)}", flush=True)
        if options.output:
            options.output.mkdir(parents=True, exist_ok=True)
            found.to_csv(options.output / f"{name}.csv", index=False)


if __name__ == "__main__":
    main()
