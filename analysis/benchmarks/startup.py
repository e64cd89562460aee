"""The first minute: from an installation to its first result, and how long a small structure takes later.

    python analysis/benchmarks/startup.py [STRUCTURE] [-o DIR] [--quick] [--repeats N] [--install]

`protochain minimise` and `protochain relax` of one structure (Trp-cage), from shell to shell: cold, with an
empty folder of compiled kernels, on all cores and on one; warm, minima of the repeats. Seconds of the wall
and of the processors, those of processes that help to compile included. Then the parts of a warm run, minima
too: imports by package (Python's own measure of each module, without what it imports), and the library's
steps.
With --install, the wheel is installed into a fresh environment, which is timed (by pip's own cache what was
downloaded before is not downloaded again), and the commands are those installed there.
"""

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path
from time import perf_counter

import made
import pandas as pd
from made import ROOT, SAMPLES

COMMANDS = ("minimise", "relax")
STEPS = """
import json, sys
from time import perf_counter
began, seconds = perf_counter(), {}
def done(name):
    global began
    seconds[name] = perf_counter() - began
    began = perf_counter()
import numpy
done("import numpy")
import numba
done("import numba")
import openmm.app
done("import openmm")
import scipy.linalg, scipy.optimize, scipy.spatial
done("import scipy")
import protochain as pc
from protochain import minimisers
done("import protochain")
structure = pc.load(sys.argv[1])
done("read and prepare")
chain = pc.build_chain(structure)
done("hinges")
energy = pc.energy(structure)
done("force field")
energy(structure.positions)
done("first energy, kernels loaded")
solution = pc.minimise(chain, energy)
done("minimise, judged")
print(json.dumps(seconds))
"""


def timed(command: list[str], cache: Path, cores: set[int] | None = None) -> tuple[float, float]:
    """Seconds of the wall and of the processors of a command; helpers that it ends count."""
    surroundings = made.surroundings(NUMBA_CACHE_DIR=str(cache), OMP_WAIT_POLICY="passive")
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), perf_counter()
    limit = None if cores is None else lambda: os.sched_setaffinity(0, cores)
    run = subprocess.run(command, env=surroundings, capture_output=True, text=True, preexec_fn=limit)
    seconds, after = perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    if run.returncode:
        raise SystemExit(f"{' '.join(command)}: {run.stderr}")
    return seconds, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def imports(program: str, arguments: list[str], cache: Path) -> Counter[str]:
    """Seconds that the modules of each package take to load, without those that they import."""
    command = [str(Path(program).with_name("python")), "-X", "importtime", program, *arguments]
    surroundings = made.surroundings(NUMBA_CACHE_DIR=str(cache))
    told = subprocess.run(command, env=surroundings, capture_output=True, text=True, check=True).stderr
    found: Counter[str] = Counter()
    for line in told.splitlines():
        if line.startswith("import time:") and "self [us]" not in line:
            own, _, name = line.removeprefix("import time:").split("|")
            package = name.strip().split(".")[0]
            found["other" if package in sys.stdlib_module_names else package] += int(own) / 1e6
    return found


def installed(folder: Path) -> tuple[str, list[tuple[str, str, float, float]]]:
    """Program of a fresh environment with the wheel, and rows of what that took."""
    pip = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", str(folder), str(ROOT)]
    subprocess.run(pip, check=True)
    (wheel,) = folder.glob("*.whl")
    there = folder / "env"
    begin = timed([sys.executable, "-m", "venv", str(there)], folder)
    seconds = timed([str(there / "bin" / "pip"), "install", "-q", str(wheel)], folder)
    rows = [("python -m venv", "", *begin), ("pip install WHEEL", "", *seconds)]
    return str(there / "bin" / "protochain"), rows


def parser() -> argparse.ArgumentParser:
    own = made.parser(__doc__)
    own.add_argument("structure", nargs="?", default=str(SAMPLES / "1l2y.pdb"))
    own.add_argument("--repeats", type=int, default=5)
    own.add_argument("--install", action="store_true", help="from a wheel, into a fresh environment")
    return own


def main() -> None:
    options = parser().parse_args()
    if options.quick:
        options.structure, options.repeats = str(SAMPLES / "ala10.pdb"), 1
    names = COMMANDS[: 1 if options.quick else None]
    rows: list[tuple[str, str, float, float]] = []
    with tempfile.TemporaryDirectory() as folder:
        scratch = Path(folder)
        program = shutil.which("protochain") or "protochain"
        if options.install:
            os.environ.pop("PYTHONPATH", None)  # the installed package, not the repository's
            program, rows = installed(scratch / "installed")
        python = str(Path(program).with_name("python"))
        subprocess.run([python, "-m", "compileall", "-q", str(ROOT / "protochain")], check=True)
        one = {min(os.sched_getaffinity(0))}
        arguments = {name: [name, options.structure, "-o", str(scratch / f"{name}.pdb")] for name in names}
        for name in names:
            command = [program, *arguments[name]]
            rows.append((name, "cold", *timed(command, scratch / name)))
            if not options.quick:
                rows.append((name, "cold, one core", *timed(command, scratch / f"{name}_one", one)))
        cache = scratch / COMMANDS[0]
        # The repeats of all are interleaved: other work on the machine then strikes them alike.
        runs: dict[str, list[tuple[float, float]]] = {name: [] for name in names}
        loaded: list[Counter[str]] = []
        steps: list[dict[str, float]] = []
        for _ in range(options.repeats):
            for name in names:
                runs[name].append(timed([program, *arguments[name]], cache))
            loaded.append(imports(program, arguments["minimise"], cache))
            surroundings = made.surroundings(NUMBA_CACHE_DIR=str(cache))
            command = [python, "-c", STEPS, options.structure]
            told = subprocess.run(command, env=surroundings, capture_output=True, text=True, check=True)
            steps.append(json.loads(told.stdout))
    for name, found in runs.items():
        rows.append((name, "warm", min(wall for wall, _ in found), min(cpu for _, cpu in found)))
    table = pd.DataFrame(rows, columns=["command", "state", "seconds", "cpu_seconds"])
    parts = [(name, min(each[name] for each in steps)) for name in steps[0]]
    packages = {name: min(each[name] for each in loaded) for name in set().union(*loaded)}
    for name, seconds in sorted(packages.items(), key=lambda item: -item[1])[:15]:
        parts.append((f"modules of {name}", seconds))
    split = pd.DataFrame(parts, columns=["part", "seconds"])
    if options.output:
        made.write(table.round(3), options.output / "startup.csv", [options.structure], 2)
        made.write(split.round(4), options.output / "startup_parts.csv", [options.structure], 2)
    print(table.to_string(index=False, float_format="%.2f"))
    print(split.to_string(index=False, float_format="%.3f"))


if __name__ == "__main__":
    main()
