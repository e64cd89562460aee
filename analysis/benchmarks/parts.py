"""Where `protochain minimise` spends its time: at about 2,500, 7,500 and 19,500 atoms.

    python analysis/benchmarks/parts.py [-o DIR] [--quick] [--structure FILE]

Copies of ubiquitin side by side (large.py), by the command line with its defaults on 2 threads, each in a
process of its own, whose main function runs under Python's profiler, kernels compiled beforehand. "imports"
is the start of Python, and what a first run of ten residues takes longer than a second one: modules, and
kernels read from their files. The others are seconds of functions with all that they call; judging is of
start and end together, the metric is made anew every few iterations, and evaluations and metric are parts of
the loop.
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
CHILD = """
import cProfile, json, operator, pstats, sys
from importlib import import_module
from time import perf_counter
from protochain.cli import main
threads, small, file, functions = sys.argv[1:]

def run(file):
    began = perf_counter()
    sys.argv = ["protochain", "minimise", file, "-o", file + ".end.cif", "--force", "--threads", threads]
    try:
        main()
    except SystemExit as end:
        assert end.code in (0, 3, None), end
    return perf_counter() - began

began = perf_counter()
first, second = run(small), run(small)
profile = cProfile.Profile()
profile.enable()
seconds = run(file)
profile.disable()
stats, parts = pstats.Stats(profile).stats, {}
for part, place in json.loads(functions).items():
    module, _, name = place.partition(":")
    code = operator.attrgetter(name + ".__code__")(import_module(module))
    parts[part] = stats[code.co_filename, code.co_firstlineno, code.co_name][3]
told = {"first": first, "second": second, "run": seconds, "all": perf_counter() - began, "parts": parts}
print(json.dumps(told), file=sys.__stdout__)
"""
FUNCTIONS = {
    "reading": "protochain.chains.setup:Setup.load",
    "system": "protochain.chains.setup:Setup.energy",
    "chain": "protochain.chains.setup:Setup.chain",
    "judging": "protochain.minimisers.judging:Known.judged",
    "loop": "protochain.minimisers.stages:walk",
    "evaluations": "protochain.minimisers.problem:Problem.evaluate",
    "metric": "protochain.minimisers.metrics:Preconditioner.first",
    "writing": "protochain.cli.minimise:_Writer.__call__",
}
"""Function of each part."""
OF_LOOP = ("evaluations", "metric")


def parts(small: Path, file: Path) -> dict[str, float]:
    """Seconds of each part of a command from shell to shell."""
    began = perf_counter()
    words = [sys.executable, "-c", CHILD, str(THREADS), str(small), str(file), json.dumps(FUNCTIONS)]
    done = subprocess.run(words, env=made.surroundings(), capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{file.name}: {done.stderr}")
    told = json.loads(done.stdout.splitlines()[-1])
    found = {"imports": perf_counter() - began - told["all"] + told["first"] - told["second"]}
    found |= told["parts"]
    found["others"] = told["run"] - sum(found[part] for part in FUNCTIONS if part not in OF_LOOP)
    return found | {"shell": found["imports"] + told["run"]}


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
        small, file = Path(folder) / "small.pdb", Path(folder) / "copies.cif"
        small.write_bytes((SAMPLES / "ala10.pdb").read_bytes())
        for size in (each,) if options.quick else SIZES:
            copies(one, round(size / each), file)
            rows.append({"atoms": pc.load(file).n_atoms} | parts(small, file))
            print(rows[-1], flush=True)
    table = pd.DataFrame(rows).rename(columns=lambda name: name if name == "atoms" else f"{name}_s")
    if options.output:
        made.write(table.round(3), options.output / "minimise_parts.csv", [options.structure], THREADS)


if __name__ == "__main__":
    main()
