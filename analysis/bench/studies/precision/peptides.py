"""Small peptides of rigid bodies, with an energy on one thread, at a minimum in their torsions."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from protochain.chains.articulate import build_chain
from protochain.chains.chain import Chain
from protochain.core.arrays import Floats
from protochain.core.units import MOLAR_GAS
from protochain.dynamics import System, chain_potential
from protochain.energies import energy
from protochain.mechanics.multibody import pose, sample_velocities
from protochain.mechanics.multibody.articulated import Articulated
from protochain.minimisers import minimise
from protochain.structure import from_sequence

KT = 300.0 * MOLAR_GAS
"""kJ/mol."""


@dataclass(eq=False)
class Counted:
    """Potential that counts its evaluations."""

    of: Callable[[Floats, Articulated], tuple[float, Floats]]
    n: int = 0

    def __call__(self, q: Floats, factors: Articulated) -> tuple[float, Floats]:
        """Energy and torques."""
        self.n += 1
        return self.of(q, factors)


@dataclass(frozen=True, eq=False)
class Peptide:
    """A chain at its minimum, with velocities of 300 K."""

    name: str
    chain: Chain
    system: System
    potential: Counted
    q: Floats
    qd: Floats

    @property
    def angles(self) -> np.ndarray:
        """Places of the hinges' angles among the coordinates."""
        return np.asarray(self.chain.tree.q_start[self.chain.hinge_body])


def peptide(sequence: str, solvent: str, root: str, move: str = "all", settle: bool = True) -> Peptide:
    """Build an extended peptide, minimised by turning its hinges."""
    structure = from_sequence(sequence)
    chain = build_chain(structure, "phi psi chi" if move == "all" else "phi psi", root, move=move)
    whole = energy(structure, solvent=solvent, engine="native", threads=1)
    potential = Counted(
        chain_potential(chain, whole.without_constants(chain.rigid_groups, structure.positions))
    )
    q = minimise(chain, whole, "lbfgs", max_evaluations=2000, curvature=False).q if settle else chain.q0
    qd = sample_velocities(chain.tree, pose(chain.tree, q), KT, np.random.default_rng(1))
    named = f"{sequence}, {solvent}"
    return Peptide(named, chain, System(chain.tree, potential), potential, np.asarray(q), qd)
