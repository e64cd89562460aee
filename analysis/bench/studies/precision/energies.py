"""Energy kernels: error of the forces by engine, cutoff and margin of the neighbour lists."""

from collections.abc import Iterator
from contextlib import contextmanager
from decimal import Decimal, localcontext
from functools import partial
from time import process_time
from typing import Any

import numpy as np

from bench.cases import Point
from bench.cost import least_seconds
from protochain.chains.articulate import build_chain
from protochain.chains.chain import pose
from protochain.core.arrays import Floats
from protochain.energies import Energy, NativeEnergy, OpenMMEnergy, build_system, energy
from protochain.energies.native import neighbours
from protochain.mechanics.multibody import integrate
from protochain.structure import from_sequence

CUTOFFS = (0.8, 1.0, 1.2, 1.5, 2.0, 2.5, 3.0)
MARGINS = (0.02, 0.05, 0.1, 0.2, 0.4)
"""nm."""
TRP_CAGE = "NLYIQWLKDGGPSSGRPPPS"
_COULOMB = Decimal("138.93545764438198")
"""kJ nm/mol/e^2, as OpenMM has it."""
_FRAMES, _TURN = 40, 5e-4
"""Positions on the way, and rad that a hinge turns from one to the next, as a standard deviation."""


def rms(difference: Floats) -> float:
    """Root mean square over the atoms of the length of a force, kJ/mol/nm."""
    return float(np.sqrt((difference**2).sum(axis=1).mean()))


def pair_forces(system: Any, x: Floats) -> Floats:
    """(na, 3) float, kJ/mol/nm: Coulomb and Lennard-Jones forces, each pair summed with 40 decimal digits."""
    (force,) = (each for each in system.getForces() if _is_nonbonded(each))
    own = [
        [given.value_in_unit(given.unit) for given in force.getParticleParameters(i)] for i in range(len(x))
    ]
    special = {}
    for k in range(force.getNumExceptions()):
        i, j, *given = force.getExceptionParameters(k)
        special[i, j] = special[j, i] = [each.value_in_unit(each.unit) for each in given]
    with localcontext() as context:
        context.prec = 40
        place = [[Decimal(float(each)) for each in row] for row in x]
        out = [[Decimal(0)] * 3 for _ in x]
        for i in range(len(x)):
            for j in range(i):
                (qi, si, ei), (qj, sj, ej) = own[i], own[j]
                qq, sigma, depth = special.get((i, j), (qi * qj, 0.5 * (si + sj), np.sqrt(ei * ej)))
                apart = [a - b for a, b in zip(place[i], place[j], strict=True)]
                r2 = sum((each * each for each in apart), Decimal(0))
                attraction = (Decimal(sigma) ** 2 / r2) ** 3
                slope = _COULOMB * Decimal(qq) / r2.sqrt()
                slope += 24 * Decimal(float(depth)) * attraction * (2 * attraction - 1)
                for axis in range(3):
                    out[i][axis] += slope / r2 * apart[axis]
                    out[j][axis] -= slope / r2 * apart[axis]
    return np.array([[float(each) for each in row] for row in out])


def _is_nonbonded(force: Any) -> bool:
    # By name: OpenMM itself is imported only where energies are built.
    return type(force).__name__ == "NonbondedForce"


def only_pairs(system: Any) -> Any:
    """The System without any force but the nonbonded one."""
    for k in reversed(range(system.getNumForces())):
        if not _is_nonbonded(system.getForce(k)):
            system.removeForce(k)
    return system


def measure(quick: bool) -> Iterator[Point]:
    """Errors of the smallest peptide, of cutoffs, of engines with a cutoff, and of lists."""
    yield from _digits("GG" if quick else "GAG")
    sequence = TRP_CAGE if quick else 3 * TRP_CAGE
    for solvent in ("vacuum", "obc2"):
        yield from _cutoffs(sequence, solvent, CUTOFFS[:: 3 if quick else 1])
    yield from _margins(sequence, MARGINS[:: 2 if quick else 1])


def _digits(sequence: str) -> Iterator[Point]:
    structure = from_sequence(sequence)
    system, x = only_pairs(build_system(structure, solvent="vacuum")), structure.positions
    exact, single = pair_forces(system, x), OpenMMEnergy(system, "CPU", 1)
    engines: dict[str, Energy] = {
        "native": NativeEnergy(single, 1), "OpenMM, Reference": single.reference, "OpenMM, CPU": single,
    }  # fmt: skip
    for name, engine in engines.items():
        seconds = least_seconds(partial(engine, x), 0.05)
        against = "a sum of 40 decimal digits"
        error = rms(engine(x)[1] - exact)
        yield Point(
            name, "", seconds, error, f"pairs of {sequence}", "kJ/mol/nm", against, 1, structure.n_atoms
        )


def _cutoffs(sequence: str, solvent: str, cutoffs: tuple[float, ...]) -> Iterator[Point]:
    structure = from_sequence(sequence)
    x, n = structure.positions, structure.n_atoms
    every: dict[str, tuple[Floats, float]] = {}
    for cutoff in (None, *cutoffs):
        native = energy(structure, solvent=solvent, engine="native", cutoff=cutoff, threads=1)
        single = energy(structure, solvent=solvent, engine="openmm", cutoff=cutoff, threads=1)
        where = "all pairs" if cutoff is None else f"{cutoff:g} nm"
        reference = native.reference(x)[1]
        if cutoff is None:
            every["exact"] = reference, 0.0
        for name, engine in (("native", native), ("OpenMM, CPU", single)):
            forces = engine(x)[1]
            seconds = least_seconds(partial(engine, x), 0.1)
            for case, against, held in (
                ("against all pairs", "Reference, all pairs", every["exact"][0]),
                ("against the same cutoff", "Reference, the same cutoff", reference),
            ):
                yield Point(
                    name, where, seconds, rms(forces - held), f"{solvent}, {case}", "kJ/mol/nm", against, 1, n
                )


@contextmanager
def _margin(nm: float) -> Iterator[None]:
    """Neighbour lists with another margin, for as long as this is entered."""
    usual = neighbours.SKIN
    neighbours.SKIN = nm
    try:
        yield
    finally:
        neighbours.SKIN = usual


def _margins(sequence: str, margins: tuple[float, ...]) -> Iterator[Point]:
    """Lists along a way on which all hinges turn: the margin decides how often they are made, no more."""
    structure = from_sequence(sequence)
    chain = build_chain(structure, root="fixed")
    along = np.random.default_rng(3).normal(scale=_TURN, size=chain.n_v)
    way = [pose(chain, integrate(chain.tree, chain.q0, k * along)).x for k in range(_FRAMES)]
    for margin in margins:
        engine = energy(structure, solvent="obc2", engine="native", cutoff=1.2, threads=1)
        with _margin(margin):
            engine(way[0] + 1.0)
            began = process_time()
            forces = [engine(x)[1] for x in way]
            seconds = (process_time() - began) / _FRAMES
        error = max(rms(forces[k] - engine.reference(way[k])[1]) for k in (0, _FRAMES // 2, _FRAMES - 1))
        where = f"obc2 at 1.2 nm on a way of {_FRAMES} positions"
        against = "Reference, the same cutoff"
        yield Point(
            "native", f"margin {margin:g} nm", seconds, error, where, "kJ/mol/nm", against, 1,
            structure.n_atoms,
        )  # fmt: skip
