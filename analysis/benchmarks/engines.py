"""What one energy with forces costs: native kernels against OpenMM's CPU platform, on the same positions.

    python analysis/benchmarks/engines.py [STUDY ...] [-o DIR] [--quick] [--threads N]

Medians of calls taken in turn in one process, and their ratios; OpenMM's implicit solvents as its force field
builds them (CustomGBForce), OBC2 also as GBSAOBCForce. STUDY is any of energies, that comparison; cutoff, at
growing sizes (copies of ubiquitin side by side); accuracy, error against seconds of a processor by trees and
cutoffs, at growing sizes; and moving, what leaving out constant terms saves, and what
the chain's sweeps add (all by default).
"""

import argparse
from collections.abc import Callable, Iterator
from functools import partial
from itertools import cycle
from time import perf_counter, process_time

import made
import numba
import numpy as np
import openmm
import pandas as pd
from made import SAMPLES
from openmm import app, unit

import protochain as pc
from protochain.energies import Energy, NativeEnergy, OpenMMEnergy
from protochain.lab import in_turn

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
    both = app.Modeller(s.topology, s.positions * unit.nanometer)
    side = int(np.ceil(n ** (1 / 3)))
    step = np.ptp(s.positions, axis=0) + 0.3
    places = [step * np.array(np.unravel_index(i, (side, side, side))) for i in range(n)]
    for place in places[1:]:
        both.add(s.topology, (s.positions + place) * unit.nanometer)
    return both.topology, np.array(both.positions.value_in_unit(unit.nanometer))


def system(topology: app.Topology, solvent: str | None, cutoff: float | None = None) -> openmm.System:
    """Return ff14SB with a solvent, as OpenMM's force field builds it."""
    files = ["amber14/protein.ff14SB.xml", *([f"implicit/{solvent}.xml"] if solvent else [])]
    method = {"nonbondedMethod": app.NoCutoff}
    if cutoff:
        method = {"nonbondedMethod": app.CutoffNonPeriodic, "nonbondedCutoff": cutoff * unit.nanometer}
    return app.ForceField(*files).createSystem(topology, **method)


def with_gbsa_obc(topology: app.Topology) -> openmm.System:
    """Return ff14SB in OBC2 by OpenMM's own force, with the radii of its implicit files."""
    built, custom = system(topology, None), system(topology, "obc2")
    (of,) = (force for force in custom.getForces() if isinstance(force, openmm.CustomGBForce))
    force = openmm.GBSAOBCForce()
    for i in range(of.getNumParticles()):
        charge, offset_radius, scaled_radius = of.getParticleParameters(i)
        force.addParticle(charge, offset_radius + 0.009, scaled_radius / offset_radius)
    built.addForce(force)
    return built


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


def with_cutoff(threads: int, quick: bool) -> Iterator[dict[str, object]]:
    """Time for each atom at growing sizes."""
    s = pc.load(SAMPLES / "1ubq.pdb")
    seconds = 0.2 if quick else 3.0
    for n in (2,) if quick else (2, 4, 8, 16, 41):
        topology, x = copies(s, n)
        vacuum, obc2 = (
            NativeEnergy(OpenMMEnergy(system(topology, solvent, CUTOFF)), threads)
            for solvent in (None, "obc2")
        )
        # Everything moved by 1 nm and back: no list holds.
        there_and_back = cycle([x, x + 1.0])
        ms = medians({"vacuum": partial(vacuum, x), "obc2": partial(obc2, x)}, seconds)
        ms |= medians({"anew": lambda e=obc2, moved=there_and_back: e(next(moved))}, seconds)
        yield {"atoms": len(x)} | {f"{name}_us_an_atom": 1e3 * taken / len(x) for name, taken in ms.items()}


ACCURACIES = (1e-2, 1e-3, 1e-4)
"""kJ/mol/nm, RMS error of the forces asked of a tree."""
CUTOFFS = (1.0, 2.0, 3.0)


def by_accuracy(threads: int, quick: bool) -> Iterator[dict[str, object]]:
    """Error of energy and forces against seconds of a processor, on one thread, by trees and cutoffs."""
    s = pc.load(SAMPLES / "1ubq.pdb")
    for n in (3,) if quick else (4, 16):
        topology, x = copies(s, n)
        # GBn2 differs from OBC2 in what is near; by OpenMM it takes minutes.
        for solvent in ("obc2",) if quick else ("obc2", "gbn2", "vacuum") if n == 4 else ("obc2", "vacuum"):
            named = None if solvent == "vacuum" else solvent
            built = with_gbsa_obc(topology) if solvent == "obc2" else system(topology, named)
            exact = NativeEnergy(OpenMMEnergy(built, threads=1), 1)
            energies: dict[str, Energy] = {"all pairs": exact}
            for accuracy in ACCURACIES:
                energies[f"tree, {accuracy:g} asked"] = exact.to_accuracy(accuracy, x)
            if n <= 4:
                energies["OpenMM CPU, all pairs"] = exact.by_openmm
            for cutoff in CUTOFFS if n <= 4 else CUTOFFS[1:2]:
                cut = NativeEnergy(OpenMMEnergy(system(topology, named, cutoff), threads=1), 1)
                energies[f"cutoff {cutoff:g} nm"] = cut
            (expected, forces), all_ms = exact(x), 1.0
            for name, energy in energies.items():
                if name.startswith("tree") and energy is exact:
                    continue
                value, its = energy(x)
                taken = processor_ms(partial(energy, x))
                all_ms = taken if energy is exact else all_ms
                yield {
                    "atoms": len(x), "solvent": solvent, "by": name, "processor_ms": taken,
                    "of_all_pairs": taken / all_ms, "energy_off_kj_mol": abs(value - expected),
                    "rms_force_off_kj_mol_nm": np.sqrt(((its - forces) ** 2).sum(axis=1).mean()),
                }  # fmt: skip


def processor_ms(run: Callable[[], object]) -> float:
    """Least of three: seconds of a processor, which other work on the machine changes little."""
    found = []
    for _ in range(3):
        began = process_time()
        run()
        found.append(1e3 * (process_time() - began))
    return min(found)


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
    "cutoff": ("engines_cutoff", with_cutoff),
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
