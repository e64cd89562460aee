"""What one energy with forces costs: native kernels against OpenMM's CPU platform, on the same positions.

    python analysis/benchmarks/engines.py [STUDY ...] [-o DIR] [--quick] [--threads N]

Medians of calls taken in turn in one process, and their ratios; OpenMM's implicit solvents as its force field
builds them (CustomGBForce), OBC2 also as GBSAOBCForce. STUDY is any of energies, that comparison; accuracy,
error against seconds of a processor by trees and cutoffs, at growing sizes (copies of ubiquitin side by
side); and moving, what leaving out constant terms saves, and what the chain's sweeps add (all by default).
"""

import argparse
from collections.abc import Callable, Iterator
from functools import partial
from time import perf_counter, process_time

import made
import numba
import numpy as np
import pandas as pd
from made import SAMPLES
from openmm import app, unit
from race_openmm import system, with_gbsa_obc

import protochain as pc
from bench import in_turn
from protochain.energies import Energy, NativeEnergy, OpenMMEnergy

DEFAULT = ("1l2y", "4pti", "1ubq", "1hel")
COPIES = 4
"""Of ubiquitin, for the largest size of the first table: 4924 atoms."""
CUTOFF = 1.0


def medians(calls: dict[str, Callable[[], object]], seconds: float = 1.5) -> dict[str, float]:
    """Return the median time of each call in ms, taken in turn so that a slow moment strikes all.

    Three calls a turn, the first uncounted: idle threads of the other engine still spin during it.
    """
    found = in_turn(list(calls.values()), seconds * len(calls), 3, 3, perf_counter)
    return {name: 1e3 * each.median for name, each in zip(calls, found, strict=True)}


def copies(s: pc.Structure, n: int) -> tuple[app.Topology, np.ndarray]:
    """Return n copies of a structure, side by side on a grid."""
    many = app.Modeller(s.topology, s.positions * unit.nanometer)
    for bit in f"{n:b}"[1:]:
        many.add(many.topology, many.positions)
        if bit == "1":
            many.add(s.topology, s.positions * unit.nanometer)
    side = int(np.ceil(n ** (1 / 3)))
    places = np.array(np.unravel_index(range(n), (side, side, side))).T
    shifts = (np.ptp(s.positions, axis=0) + 0.3) * places
    return many.topology, (s.positions + shifts[:, None]).reshape(-1, 3)


def against_openmm(
    topology: app.Topology, x: np.ndarray, name: str, threads: int, seconds: float
) -> Iterator[dict[str, object]]:
    """One structure's row in each solvent."""
    n_pairs = len(x) * (len(x) - 1) / 2
    cases = {
        "vacuum": system(topology, None), "OBC2": system(topology, "obc2"),
        "OBC2, GBSAOBCForce": with_gbsa_obc(topology), "GBn2": system(topology, "gbn2"),
    }  # fmt: skip
    for solvent, built in cases.items():
        theirs = OpenMMEnergy(built, "CPU", threads)
        ours = NativeEnergy(theirs, threads)
        ms = medians({"native": partial(ours, x), "openmm": partial(theirs, x)}, seconds)
        floor = arithmetic_floor(n_pairs, solvent) / threads
        yield {
            "structure": name, "atoms": len(x), "solvent": solvent, "openmm_ms": ms["openmm"],
            "native_ms": ms["native"], "ratio": ms["openmm"] / ms["native"],
            "ns_a_pair": 1e6 * ms["native"] / n_pairs, "times_the_floor": ms["native"] / floor,
        }  # fmt: skip


@numba.njit(fastmath={"contract"}, error_model="numpy")
def multiply_adds(values: np.ndarray, sums: np.ndarray, times: int) -> None:
    """Thirty-two for each value, in four chains."""
    for _ in range(times):
        for i in range(len(values)):
            x = values[i]
            a, b, c, d = 0.1, 0.2, 0.3, 0.4
            for _ in range(8):
                a, b, c, d = a * x + 0.5, b * x + 0.5, c * x + 0.5, d * x + 0.5
            sums[i] += a + b + c + d


OPERATIONS = {"vacuum": 45, "solvent": 151}
"""Additions, multiplications and multiply-adds of the kernels for a pair of atoms far from each other.

In solvent 25 for Born integrals, 62 for the polar energy, 64 for the rest and the chain rule. Divisions,
which run beside them, and necks are not in it.
"""


def arithmetic_floor(n_pairs: float, solvent: str) -> float:
    """Return the ms that one thread needs for the arithmetic of all pairs and nothing else, at full speed."""
    values, sums, times = np.linspace(0.0, 1.0, 512), np.zeros(512), 1000
    ms = medians({"arithmetic": partial(multiply_adds, values, sums, times)}, 0.2)["arithmetic"]
    each = ms / (32 * len(values) * times)
    return each * n_pairs * OPERATIONS["vacuum" if solvent == "vacuum" else "solvent"]


def energies(threads: int, quick: bool) -> Iterator[dict[str, object]]:
    """Native against OpenMM, on samples and four copies of ubiquitin."""
    for name in DEFAULT[: 1 if quick else None]:
        s = pc.load(SAMPLES / f"{name}.pdb")
        yield from against_openmm(s.topology, s.positions, s.name, threads, 0.2 if quick else 1.5)
    if not quick:
        several = copies(pc.load(SAMPLES / "1ubq.pdb"), COPIES)
        yield from against_openmm(*several, f"{COPIES} x 1ubq", threads, 1.5)


ACCURACIES = (1e-2, 1e-3, 1e-4)
"""kJ/mol/nm, RMS error of the forces asked of a tree."""
CUTOFFS = (1.0, 2.0, 3.0)
ASKED = {
    1: ("obc2", "gbn2", "vacuum"), 4: ("obc2", "gbn2", "vacuum"), 16: ("obc2", "gbn2", "vacuum"),
    41: ("obc2", "vacuum"),
}  # fmt: skip
"""Solvents by copies of ubiquitin."""


def by_accuracy(threads: int, quick: bool) -> Iterator[dict[str, object]]:
    """Error of energy and forces against seconds of a processor, on one thread, by trees and cutoffs."""
    s = pc.load(SAMPLES / "1ubq.pdb")
    for n, solvents in {3: ("obc2",)}.items() if quick else ASKED.items():
        topology, x = copies(s, n)
        for solvent in solvents:
            exact, to_cutoff = in_solvent(topology, solvent)
            against = Against(exact, x)
            yield against.row(solvent, "all pairs", exact)
            # Each accuracy is measured against all pairs.
            for accuracy in ACCURACIES:
                tree = exact.to_accuracy(accuracy, x)
                if tree is not exact:
                    yield against.row(solvent, f"tree, {accuracy:g} asked", tree)
            # By OpenMM, GBn2 takes minutes.
            if n <= (4 if solvent == "gbn2" else 16):
                yield against.row(solvent, "OpenMM CPU, all pairs", exact.by_openmm)
            for cutoff in CUTOFFS if n <= 4 else CUTOFFS[1:2]:
                cut = to_cutoff(cutoff)
                yield against.row(solvent, f"cutoff {cutoff:g} nm", cut)
                if n <= 16 and solvent != "gbn2" and cutoff == CUTOFFS[1]:
                    yield against.row(solvent, f"OpenMM CPU, cutoff {cutoff:g} nm", cut.by_openmm)


def in_solvent(topology: app.Topology, solvent: str) -> tuple[NativeEnergy, Callable[[float], NativeEnergy]]:
    """Energy over all pairs, on one thread, and what makes one with a cutoff."""
    named = None if solvent == "vacuum" else solvent
    built = with_gbsa_obc(topology) if solvent == "obc2" else system(topology, named)

    def to_cutoff(cutoff: float) -> NativeEnergy:
        return NativeEnergy(OpenMMEnergy(system(topology, named, cutoff), threads=1), 1)

    return NativeEnergy(OpenMMEnergy(built, threads=1), 1), to_cutoff


class Against:
    """What differs from the energy over all pairs, and what it costs beside it."""

    def __init__(self, exact: NativeEnergy, x: np.ndarray) -> None:
        self.x = x
        self.all_ms, (self.energy, self.forces) = processor_ms(exact, x)

    def row(self, solvent: str, by: str, energy: Energy) -> dict[str, object]:
        """Of an energy: ms, and how far it is off."""
        is_exact = by == "all pairs"
        known = self.all_ms, (self.energy, self.forces)
        taken, (value, forces) = known if is_exact else processor_ms(energy, self.x)
        return {
            "atoms": len(self.x), "solvent": solvent, "by": by, "processor_ms": taken,
            "of_all_pairs": taken / self.all_ms, "energy_off_kj_mol": abs(value - self.energy),
            "rms_force_off_kj_mol_nm": np.sqrt(((forces - self.forces) ** 2).sum(axis=1).mean()),
        }  # fmt: skip


COMPILED_BY = 2000
"""Atoms of the smallest system, whose first energies may compile kernels."""


def processor_ms(energy: Energy, x: np.ndarray) -> tuple[float, tuple[float, np.ndarray]]:
    """Least of up to four: ms of a processor, which other work on the machine changes little; and energy."""
    found: list[float] = []
    if len(x) < COMPILED_BY:
        energy(x)
    while len(found) < 4 and sum(found) < 1e4:
        began = process_time()
        its = energy(x)
        found.append(1e3 * (process_time() - began))
    return min(found), its


MOVING = (
    ("phi psi", "all"), ("phi psi chi", "all"), ("phi psi chi omega rotors", "all"),
    ("phi psi chi", "resid 10"), ("phi psi chi", "resid 5:14 and not backbone"), ("", "resid 10"),
)  # fmt: skip
"""Hinges, none for all atoms, and what moves."""


def left_out(threads: int, quick: bool) -> Iterator[dict[str, object]]:
    """What leaving out constant terms saves, and what the sweeps of the chain add."""
    for name in ("1l2y",) if quick else ("1l2y", "1hel"):
        s = pc.load(SAMPLES / f"{name}.pdb")
        for solvent in ("vacuum", "obc2"):
            whole = pc.energy(s, solvent=solvent, engine="native", threads=threads)
            for hinges, move in MOVING:
                c = pc.build_chain(s, hinges or "phi psi chi", move=move)
                x = pc.pose(c, c.q0).x
                alone = np.where(c.moving, -1, 0)[:, None]
                less: Energy = whole.without_constants(c.rigid_groups if hinges else alone, x)
                _, f = whole(x)
                ms = medians(
                    {"all": partial(whole, x), "moving": partial(less, x), "sweeps": partial(torques, c, f)},
                    0.1 if quick else 0.7,
                )
                yield {
                    "structure": s.name, "solvent": solvent, "hinges": hinges or "none: atoms", "move": move,
                    "freedoms": c.n_v if hinges else 3 * int(c.moving.sum()),
                    "all_ms": ms["all"], "moving_ms": ms["moving"], "ratio": ms["all"] / ms["moving"],
                    "sweeps_ms": ms["sweeps"],
                    "sweeps_percent": 100 * ms["sweeps"] / (ms["moving"] + ms["sweeps"]),
                }  # fmt: skip


def torques(c: pc.Chain, f: np.ndarray) -> np.ndarray:
    """Return the torques of forces at the chain's start: both sweeps."""
    return pc.pull_back(c, pc.pose(c, c.q0), f)


STUDIES = {
    "energies": ("engines", energies),
    "accuracy": ("engines_accuracy", by_accuracy),
    "moving": ("engines_moving", left_out),
}


def parser() -> argparse.ArgumentParser:
    own = made.parser(__doc__, STUDIES)
    own.add_argument("--threads", type=int, default=2)
    return own


def main() -> None:
    options = parser().parse_args()
    for study in options.studies or STUDIES:
        name, measure = STUDIES[study]
        rows = []
        print(f"\n{measure.__doc__}\n")
        for row in measure(options.threads, options.quick):
            rows.append(row)
            shown = (f"{value:.3g}" if isinstance(value, float) else str(value) for value in row.values())
            print(f"| {' | '.join(shown)} |", flush=True)
        if options.output:
            table = pd.DataFrame(rows)
            of = table["structure"].unique() if "structure" in table else ["copies of 1ubq"]
            threads = 1 if measure is by_accuracy else options.threads
            made.write(table, options.output / f"{name}.csv", of, threads)


if __name__ == "__main__":
    main()
