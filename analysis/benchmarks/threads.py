"""What one energy costs beside other work: on one thread and on two, while other processes keep cores busy.

    python analysis/benchmarks/threads.py [-o DIR] [--quick] [--seconds S] [STRUCTURE ...]

The process binds itself to two cores; others that do nothing but count are bound to none, one or both of
them. Calls on one thread and on two are made in turn, in bursts, so that a slow moment strikes both; the mean
of all calls counts, because a few that wait very long are what hurts. Ratio: two threads over one.
"""

import argparse
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter, process_time, sleep

import made
import numpy as np
import pandas as pd
from engines import copies
from made import SAMPLES
from race_openmm import with_gbsa_obc

import protochain as pc
from protochain.energies import NativeEnergy, OpenMMEnergy

BURST = 0.1
"""s. Some hundred energies of a small protein, and many turns of the operating system's scheduler."""
COPIES = 4
"""Of ubiquitin, for the largest size: 4924 atoms."""
FIELDS = (
    "structure", "atoms", "cores_busy", "one_thread_ms", "two_threads_ms", "ratio", "one_cpu_ms",
    "two_cpu_ms",
)  # fmt: skip


@contextmanager
def kept_busy(cores: list[int]) -> Iterator[None]:
    """Keep each of some cores busy with a process of its own."""
    count = "import os, sys; os.sched_setaffinity(0, {int(sys.argv[1])})\nwhile True: pass"
    others = [subprocess.Popen([sys.executable, "-c", count, str(core)]) for core in cores]
    try:
        sleep(0.3 if others else 0.0)
        yield
    finally:
        for other in others:
            other.kill()
            other.wait()


def means(energies: dict[int, NativeEnergy], x: np.ndarray, seconds: float) -> dict[int, tuple[float, float]]:
    """Return the mean ms of a call by the wall and in processor time, of each energy."""
    calls, wall, cpu = (dict.fromkeys(energies, 0.0) for _ in range(3))
    while min(wall.values()) < seconds:
        for threads, energy in energies.items():
            began, used = perf_counter(), process_time()
            while perf_counter() - began < BURST:
                energy(x)
                calls[threads] += 1
            wall[threads] += perf_counter() - began
            cpu[threads] += process_time() - used
    return {k: (1e3 * wall[k] / calls[k], 1e3 * cpu[k] / calls[k]) for k in energies}


def parser() -> argparse.ArgumentParser:
    own = made.parser(__doc__)
    own.add_argument("structures", nargs="*", type=Path)
    own.add_argument("--seconds", type=float, default=3.0, help="of each number of threads, in each place")
    return own


def main() -> None:
    given = parser().parse_args()
    if given.quick:
        given.structures, given.seconds = [SAMPLES / "1l2y.pdb"], 0.3
    cores = sorted(os.sched_getaffinity(0))[:2]
    if len(cores) < 2:
        sys.exit("two cores are needed to compare one thread with two")
    os.sched_setaffinity(0, cores)
    cases = []
    for path in given.structures or [SAMPLES / "1l2y.pdb", SAMPLES / "1ubq.pdb"]:
        s = pc.load(path)
        cases.append((s.name, s.topology, s.positions))
    if not given.structures:
        cases.append((f"{COPIES} x 1ubq", *copies(pc.load(SAMPLES / "1ubq.pdb"), COPIES)))
    rows = []
    print(",".join(FIELDS))
    for name, topology, x in cases:
        built = OpenMMEnergy(with_gbsa_obc(topology), "CPU")
        energies = {threads: NativeEnergy(built, threads) for threads in (1, 2)}
        for energy in energies.values():
            energy(x)
        for busy in range(3):
            with kept_busy(cores[:busy]):
                (one, one_cpu), (two, two_cpu) = means(energies, x, given.seconds).values()
            numbers = [round(v, 3) for v in (one, two, two / one, one_cpu, two_cpu)]
            rows.append(dict(zip(FIELDS, (name, len(x), busy, *numbers), strict=True)))
            print(",".join(map(str, rows[-1].values())), flush=True)
    if given.output:
        made.write(pd.DataFrame(rows), given.output / "threads.csv", [name for name, _, _ in cases], 2)


if __name__ == "__main__":
    main()
