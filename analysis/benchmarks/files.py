"""Files of all kinds: what each is read as, and how long that takes.

    python analysis/benchmarks/files.py [STUDY ...] [-o DIR] [--quick] [--more FOLDER]

STUDY is table or speed (both by default). Each prints a table; with -o they are written too, as
files_STUDY.csv. Files are those of --more; with --quick, samples.
"""

import argparse
import io
import resource
from pathlib import Path
from time import perf_counter

import made
import numpy as np
import openmm
import pandas as pd
from made import SAMPLES
from openmm import app
from pdbfixer import PDBFixer

import protochain as pc

MEASURED = ("4pti_bpti.pdb", "1ubq_ubiquitin.pdb", "1hel_lysozyme.pdb", "1ake_A.pdb", "4jsv_2750.pdb")


def table(options: argparse.Namespace) -> pd.DataFrame:
    """Files: what each is taken as, or which line refuses it."""
    rows, folder = [], options.more
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
            row["first repair"] = next(map(str, s.repairs), "")
        except pc.ProtochainError as error:
            row["refused"] = str(error).removeprefix(f"{path}: ")
        rows.append(row | {"seconds": perf_counter() - began})
    return pd.DataFrame(rows).fillna("")


def speed(options: argparse.Namespace) -> pd.DataFrame:
    """Seconds of preparation, warm, against PDBFixer and Modeller.addHydrogens; memory in all so far."""
    rows = []
    for name in ("4pti.pdb",) if options.quick else MEASURED:
        path = options.more / name
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
                "structure": path.stem, "residues": s.n_residues, "atoms": s.n_atoms, "seconds": min(ours),
                "openmm_seconds": min(theirs) if theirs else np.nan,
                "peak_memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
            }
        )  # fmt: skip
    return pd.DataFrame(rows)


def _by_openmm(path: Path) -> None:
    platform = openmm.Platform.getPlatform("CPU")
    fixer = PDBFixer(pdbfile=io.StringIO(path.read_text()), platform=platform)
    fixer.removeHeterogens(keepWater=False)
    fixer.missingResidues = {}
    fixer.findMissingAtoms()
    fixer.addMissingAtoms(seed=1)
    modeller = app.Modeller(fixer.topology, fixer.positions)
    modeller.addHydrogens(app.ForceField("amber14/protein.ff14SB.xml"), pH=7.0, platform=platform)


STUDIES = {"table": table, "speed": speed}


def parser() -> argparse.ArgumentParser:
    return made.parser(__doc__, STUDIES, more=True)


def main() -> None:
    options = parser().parse_args()
    options.more = SAMPLES if options.quick else options.more
    made.study(options, STUDIES, "files", lambda name, _: MEASURED if name == "speed" else ())


if __name__ == "__main__":
    main()
