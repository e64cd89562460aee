"""What one evaluation costs: the energy by each kernel, and the sweeps that turn it into torques.

    python analysis/benchmarks/evaluations.py [STRUCTURE ...]

Medians of repeated calls in one process, and their ratios.
"""

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path
from statistics import median
from time import perf_counter

import numpy as np
from openmm import app

import protochain as pc

SAMPLES = Path(__file__).parents[2] / "structures"
DEFAULT = ("1l2y", "4pti", "1ubq", "1hel")


def seconds(call: Callable[[], object], repeats: int = 7) -> float:
    """Return the median time of a call, after one that is not counted."""
    call()
    times = []
    for _ in range(repeats):
        began = perf_counter()
        call()
        times.append(perf_counter() - began)
    return median(times)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("structures", nargs="*", type=Path, default=[SAMPLES / f"{n}.pdb" for n in DEFAULT])
    force_field = app.ForceField("amber14/protein.ff14SB.xml", "implicit/obc2.xml")
    print(
        "| structure | atoms | hinges | CustomGBForce ms | GBSAOBCForce ms | ratio "
        "| Reference ms | pose + pull_back ms | share |"
    )
    print("|---|--:|--:|--:|--:|--:|--:|--:|--:|")
    for path in parser.parse_args().structures:
        s = pc.load(path)
        c, e, x = pc.build_chain(s), pc.energy(s), s.positions
        custom = pc.energy(s, system=force_field.createSystem(s.topology))
        _, f = e(x)
        slow, fast, exact = (seconds(partial(engine, x)) for engine in (custom, e, e.reference))
        sweeps = seconds(partial(torques, c, f), 50)
        print(
            f"| {s.name} | {s.n_atoms} | {c.n_hinges} | {1e3 * slow:.1f} | {1e3 * fast:.1f} "
            f"| {slow / fast:.1f} | {1e3 * exact:.1f} | {1e3 * sweeps:.3f} | {100 * sweeps / fast:.1f} % |"
        )


def torques(c: pc.Chain, f: np.ndarray) -> np.ndarray:
    """Return the torques of forces at the chain's start: both sweeps."""
    return pc.pull_back(c, pc.pose(c, c.q0), f)


if __name__ == "__main__":
    main()
