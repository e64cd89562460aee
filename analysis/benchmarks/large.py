"""Large structures: copies of one side by side, minimised in all atoms from shell to shell.

    python analysis/benchmarks/large.py [-o DIR] [--structure FILE] [--atoms 1000,...,20000]
        [--tolerance 10] [--accuracy auto] [--threads N] [--quick]

`protochain minimise --method cartesian` to an RMS force of 10 kJ/mol/nm, in a process of its own for each
size: seconds in all and of the minimisation, evaluations, most memory. Then, by the library in one process,
the seconds of preparation (reading, hinges), of a first energy and of one more. The exponent of each with the
number of atoms is that of a straight line through the logarithms, of all sizes and of those
from 5,000 atoms on, where a tree sums far pairs by default.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter

import gemmi
import made
import numpy as np
import pandas as pd

import protochain as pc
from bench import exponent

GAP = 3.0
"""angstrom between the boxes around two copies."""
SIZES = "1000,3000,6000,10000,20000"
QUICK = "6000,7500"
FEWEST = 5000
"""Atoms from which a tree sums far pairs by default."""


def copies(one: gemmi.Structure, n: int, path: Path) -> None:
    """Write n copies of a structure on a grid as mmCIF, each with chains of its own."""
    x = np.array([list(atom.atom.pos) for atom in one[0].all()])
    step, side = np.ptp(x, axis=0) + GAP, int(np.ceil(n ** (1 / 3)))
    many = gemmi.Structure()
    many.name = "copies"
    model = gemmi.Model(1)
    for k in range(n):
        shift = gemmi.Position(*(step * np.unravel_index(k, (side, side, side))))
        for chain in one[0]:
            own = chain.clone()
            own.name = f"{chain.name}{k}"
            for residue in own:
                for atom in residue:
                    atom.pos += shift
            model.add_chain(own)
    many.add_model(model)
    many.setup_entities()
    many.make_mmcif_document().write_file(str(path))


def minimised(path: Path, options: argparse.Namespace) -> dict[str, object]:
    """What the command line says of one run, with its seconds and most memory."""
    command = [sys.executable, "-c", "from protochain.cli import main; main()", "minimise", str(path)]
    command += ["--method", "cartesian", "--tolerance", str(options.tolerance)]
    command += ["--accuracy", options.accuracy]
    command += ["--threads", str(options.threads), "--json", "-o", str(path.with_name("end.cif")), "--force"]
    began = perf_counter()
    run = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    assert run.stdout is not None
    told = run.stdout.read()
    _, status, used = os.wait4(run.pid, 0)
    if not told:
        raise SystemExit(f"{path.name}: exit status {os.waitstatus_to_exitcode(status)}")
    record = json.loads(told)
    return {
        "status": record["status"], "evaluations": record["evaluations"],
        "rms_force_kj_mol_nm": record["rms_force_end_kj_mol_nm"], "minimise_s": record["seconds"],
        "shell_s": perf_counter() - began, "memory_mb": used.ru_maxrss / 1024,
    }  # fmt: skip


def prepared(path: Path, options: argparse.Namespace) -> dict[str, object]:
    """Seconds of the library's steps."""
    seconds, began = [], perf_counter()

    def lap() -> None:
        nonlocal began
        seconds.append(perf_counter() - began)
        began = perf_counter()

    structure = pc.load(path)
    pc.build_chain(structure)
    lap()
    word = options.accuracy
    accuracy = word if word in ("auto", "exact") else float(word)
    energy = pc.energy(structure, accuracy=accuracy, threads=options.threads)
    energy(structure.positions)
    lap()
    for k in range(1, 4):
        energy(structure.positions + 1e-4 * k)
    lap()
    seconds[-1] /= 3
    of_step = zip(("prepare_s", "first_energy_s", "energy_s"), seconds, strict=True)
    return {"atoms": len(structure.positions), **dict(of_step)}


def exponents(table: pd.DataFrame) -> pd.DataFrame:
    """Slopes of the seconds with the atoms, in logarithms."""
    timed = [name for name in table if name.endswith("_s")]
    by_tree = table[table["atoms"] >= FEWEST]
    return pd.DataFrame(
        {
            "seconds_of": timed,
            "exponent": [exponent(table["atoms"], table[name]) for name in timed],
            "exponent_by_tree": [exponent(by_tree["atoms"], by_tree[name]) for name in timed],
        }
    )


def parser() -> argparse.ArgumentParser:
    own = made.parser(__doc__ or "")
    own.add_argument(
        "--structure", type=Path, default=made.SAMPLES / "1ubq.pdb", help="of which copies are made"
    )
    own.add_argument("--atoms", default=SIZES)
    own.add_argument("--tolerance", type=float, default=10.0)
    own.add_argument("--accuracy", default="auto", help="kJ/mol/nm of forces, exact or auto")
    own.add_argument("--threads", type=int, default=2)
    return own


def main() -> None:
    options = parser().parse_args()
    sizes = sorted(map(int, (QUICK if options.quick else options.atoms).split(",")))
    one = gemmi.read_structure(str(options.structure))
    one.remove_waters()
    each = pc.load(options.structure).n_atoms
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        copies(one, 1, Path(folder) / "copies.cif")
        prepared(Path(folder) / "copies.cif", options)  # Imports, and kernels compiled.
        for size in sizes:
            path = Path(folder) / "copies.cif"
            copies(one, max(1, round(size / each)), path)
            row = prepared(path, options) | minimised(path, options)
            row["evaluation_s"] = row["minimise_s"] / row["evaluations"]
            rows.append(row)
            print(pd.DataFrame(rows).to_string(index=False, float_format="%.3f"), flush=True)
    table = pd.DataFrame(rows)
    slopes = exponents(table)
    print(slopes.to_string(index=False, float_format="%.2f"))
    if options.output:
        inputs = [options.structure]
        made.write(table.round(4), options.output / "large.csv", inputs, options.threads)
        made.write(slopes.round(3), options.output / "large_exponents.csv", inputs, options.threads)


if __name__ == "__main__":
    main()
