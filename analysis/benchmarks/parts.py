"""Where `protochain minimise` spends its time: at about 2,500, 7,500 and 19,500 atoms.

    python analysis/benchmarks/parts.py [-o DIR] [--quick] [--structure FILE]

Copies of ubiquitin side by side (large.py), by the command line with its defaults on 2 threads, each in a
process of its own, kernels compiled beforehand, as its record tells them (`timings`). "imports" has the
start of Python, modules, and kernels read from their files; "reading" what is added to the file, "system" the
native terms. Judging is of start and end together, the metric is made anew every few iterations, and
evaluations and metric are parts of the loop. "shell" is the whole command.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter

import gemmi
import made
import pandas as pd
from large import copies
from made import SAMPLES

import protochain as pc

SIZES = (2462, 7386, 19696)
THREADS = 2
COLUMNS = {
    "imports": ("imports", "kernels"), "reading": ("reading", "preparing"), "system": ("energy",),
    "chain": ("chain",), "judging": ("judging",), "loop": ("loop", "evaluations", "metric"),
    "evaluations": ("evaluations",), "metric": ("metric",), "writing": ("writing",),
    "others": ("measuring", "rest"),
}  # fmt: skip
"""Parts of the record that make up each column."""


def parts(file: Path, end: Path) -> dict[str, float]:
    """Seconds of each part of a command from shell to shell."""
    began = perf_counter()
    words = [
        sys.executable,
        "-m",
        "protochain",
        "minimise",
        file,
        "-o",
        end,
        "--threads",
        str(THREADS),
        "--json",
    ]
    done = subprocess.run(words, env=made.surroundings(), capture_output=True, text=True)
    shell = perf_counter() - began
    if done.returncode not in (0, 3):
        raise SystemExit(f"{file.name}: {done.stderr}")
    told = json.loads(done.stdout)["timings"]
    del told["serial_share_of_loop"]
    # Those of the record are of processors: the start and end of Python are between shell and record.
    told["imports"] += shell - sum(told.values())
    return {name: sum(told[each] for each in of) for name, of in COLUMNS.items()} | {"shell": shell}


def parser() -> argparse.ArgumentParser:
    own = made.parser(__doc__)
    own.add_argument("--structure", type=Path, default=SAMPLES / "1ubq.pdb", help="of which copies are made")
    return own


def main() -> None:
    options = parser().parse_args()
    one = gemmi.read_structure(str(options.structure))
    one.remove_waters()
    each = pc.load(options.structure).n_atoms
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        file, end = Path(folder) / "copies.cif", Path(folder) / "end.cif"
        parts(SAMPLES / "ala10.pdb", end)  # It compiles kernels, if a run has not yet.
        for size in (each,) if options.quick else SIZES:
            copies(one, round(size / each), file)
            rows.append({"atoms": pc.load(file).n_atoms} | parts(file, end))
            print(rows[-1], flush=True)
    table = pd.DataFrame(rows).rename(columns=lambda name: name if name == "atoms" else f"{name}_s")
    if options.output:
        made.write(table.round(3), options.output / "minimise_parts.csv", [options.structure], THREADS)


if __name__ == "__main__":
    main()
