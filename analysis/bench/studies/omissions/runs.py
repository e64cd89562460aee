"""Scenes of dynamics, several chains and whole runs: sweeps, random numbers, constraints and imports."""

import subprocess
from collections.abc import Mapping
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from bench.studies.omissions.cells import Answer, Material, Omission, TwoWays
from bench.studies.omissions.energies import chains, counted, sizes_of, turned
from bench.studies.stability.energies import copies
from protochain.chains.articulate import build_chain
from protochain.chains.chain import Chain, pose
from protochain.core.arrays import Floats
from protochain.core.errors import ProtochainError
from protochain.core.processors import own_python
from protochain.core.units import MOLAR_GAS
from protochain.dynamics import Closure, System, chain_potential
from protochain.dynamics.closure import closure_of
from protochain.dynamics.loop import Propagator, State, advance, initial
from protochain.dynamics.thermostats import Isolated, Langevin
from protochain.mechanics.motion.leapfrog import Leapfrog
from protochain.mechanics.multibody import Frames, mass_matrix, operational_inverse, row_matrix
from protochain.mechanics.multibody import pose as frames_of
from protochain.minimisers import minimise
from protochain.minimisers.problem import evaluate
from protochain.minimisers.spaces import Torsions
from protochain.structure import from_sequence
from protochain.structure.write import as_text

PEPTIDE, CHAINS = "AAAAAAAAAA", 10
_TIME_STEP, _KELVIN = 0.001, 300.0
"""ps; K."""
_LOADED = ("matplotlib.figure", "pandas", "jinja2", "mdtraj", "MDAnalysis")
"""What plots, tables, pages, trajectories and selections import."""


def no_velocities(material: Material) -> TwoWays:
    """An evaluation of a minimiser, and one with momenta and the factors of the mass matrix."""
    s = material.structure
    chain, whole = build_chain(s), material.energy("vacuum")
    space = Torsions(chain)
    system, at_rest = System(chain.tree, chain_potential(chain, whole)), np.zeros(chain.n_v)

    def moving(q: Floats) -> Answer:
        at = system.at(q, at_rest)
        return at.potential, space.scale * at.torque

    def still(q: Floats) -> Answer:
        at = evaluate(space, whole, q)
        return at.energy, at.torque

    count = counted(whole, chain)
    return TwoWays(
        moving, still, turned(chain), lambda q: sizes_of(whole, pose(chain, q).x), (count, count),
        "momenta, factors of the mass matrix",
    )  # fmt: skip


def propagator(material: Material, thermostat: Any) -> Propagator:
    """Leapfrog of a chain in vacuum."""
    chain = calm(material)
    system = System(chain.tree, chain_potential(chain, material.energy("vacuum")))
    return Propagator(system, Leapfrog(), thermostat, _TIME_STEP, MOLAR_GAS * _KELVIN, 3, False)


@cache
def calm(material: Material) -> Chain:
    """Chain after some steps of a minimiser: dynamics needs a calm start."""
    chain = build_chain(material.structure, root="free")
    found = minimise(chain, material.energy("vacuum"), "lbfgs", 1.0, 60, curvature=False)
    return build_chain(material.structure.with_positions(found.x), root="free")


def begun(of: Propagator, chain: Chain) -> State:
    """State of a run after ten steps."""
    state = initial(of, chain.q0)
    for _ in range(10):
        state = advance(of, state)
    return state


def constant_energy(material: Material) -> TwoWays:
    """A step at constant energy: with a thermostat of no friction, and with none."""
    ours = propagator(material, Isolated())
    idle = replace(ours, thermostat=Langevin(ours.thermal_energy, 0.0))
    start = begun(ours, calm(material))
    states = [start, advance(ours, start)]

    def step(of: Propagator, state: State) -> Answer:
        at = advance(of, state).at
        return at.q, at.qd, at.potential

    def sizes(state: State) -> tuple[float, ...]:
        x = pose(calm(material), state.at.q).x
        energy = sizes_of(material.energy("vacuum"), x)[0]
        return float(np.linalg.norm(state.at.q)), float(np.linalg.norm(state.at.qd)), energy

    return TwoWays(partial(step, idle), partial(step, ours), states, sizes, what="noise, momenta for it")


def loops(material: Material) -> TwoWays:
    """Closed loops: G M^-1 G^T of disulfides by the whole mass matrix, and by one sweep between their bodies.

    Where a structure has none, three distances between its ends are taken as one.
    """
    chain = build_chain(material.structure)
    closure = closure_of(chain) if len(chain.loops) else between_ends(chain)
    tree = chain.tree

    def dense(q: Floats) -> Answer:
        frames = frames_of(tree, q)
        g = row_matrix(tree, frames, closure.rows(frames))
        return (np.asarray(g @ np.linalg.solve(mass_matrix(tree, frames), g.T)),)

    def sparse(q: Floats) -> Answer:
        frames: Frames = frames_of(tree, q)
        return (operational_inverse(tree, frames, closure.rows(frames)),)

    size = float(np.linalg.norm(sparse(chain.q0)[0]))
    what = f"mass matrix of {chain.n_v} freedoms, for {len(closure.length)} constraints"
    return TwoWays(dense, sparse, turned(chain), lambda _: (size,), what=what)


def between_ends(chain: Chain) -> Closure:
    """Three distances between the first and the last C-alphas of a chain."""
    alpha = chain.structure.alpha_carbons
    atoms = np.array([[alpha[0], alpha[-1]], [alpha[1], alpha[-1]], [alpha[0], alpha[-2]]])
    x = pose(chain, chain.q0).x
    length = np.linalg.norm(x[atoms[:, 1]] - x[atoms[:, 0]], axis=1)
    return Closure(chain.tree, chain.atom_body[atoms], chain.atom_local[atoms], length)


def ten_chains(material: Material) -> TwoWays:
    """Ten peptides side by side, across an extended chain."""
    return chains(copies(from_sequence(PEPTIDE), CHAINS))


_RUN = """
import sys, time
for name in {first}:
    __import__(name)
from protochain.cli import app
sys.stdout = sys.stderr
code = app(["minimise", {path!r}, "-o", {out!r}, "--method", "lbfgs", "--solvent", "vacuum", "--force",
            "--threads", "1"], standalone_mode=False)
sys.stdout = sys.__stdout__
print(len(sys.modules), time.process_time())
"""


def imports(material: Material) -> TwoWays:
    """A run of ``protochain minimise`` in a process of its own: modules loaded, and the file it writes."""
    modules: dict[bool, int] = {}

    def program(loads: bool, _: object) -> Answer:
        with TemporaryDirectory() as folder:
            path, out = Path(folder) / "in.pdb", Path(folder) / "out.pdb"
            path.write_text(as_text(from_sequence("AAAA"), ".pdb"))
            code = _RUN.format(first=_LOADED if loads else (), path=str(path), out=str(out))
            done = subprocess.run(own_python(code), capture_output=True, text=True)
            if done.returncode:
                raise ProtochainError(f"minimise: {done.stderr.strip().splitlines()[-1]}")
            modules[loads] = int(done.stdout.split()[-2])
            atoms = [line for line in out.read_text().splitlines() if line.startswith("ATOM")]
            return (np.array([[float(line[k : k + 8]) for k in (30, 38, 46)] for line in atoms]),)

    def count(loads: bool) -> Mapping[str, int]:
        return {"imports": modules[loads]}

    what = "plots, tables, pages, trajectories, selections"
    return TwoWays(
        partial(program, True), partial(program, False), [None], lambda _: (1.0,),
        (partial(count, True), partial(count, False)), what,
    )  # fmt: skip


OMISSIONS = (
    Omission("ten chains, OBC2 and a cutoff", "all pairs of blocks", ten_chains),
    Omission("closed loops", "the mass matrix", loops),
    Omission("no velocities", "those of dynamics", no_velocities),
    Omission("constant energy", "a thermostat of no friction", constant_energy),
    Omission("protochain minimise", "all libraries loaded", imports),
)
