"""Freedoms to minimise in: the hinges of a chain, or all atoms."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from protochain import multibody
from protochain.arrays import Floats, Integers
from protochain.chain import Chain, pose, pull_back, solve_mass
from protochain.minimisers import springs
from protochain.minimisers.problem import Evaluation
from protochain.multibody import HingeKind
from protochain.structure.model import Structure

ROOT_LEVER = 0.1
"""nm moved by a free root for one radian: makes its forces and the hinges' torques one kind of number."""


@dataclass(frozen=True, eq=False)
class Torsions:
    """The coordinates of a chain; a free root moves by ``ROOT_LEVER`` for each unit.

    Parameters
    ----------
    chain : Chain
    """

    chain: Chain
    longest = 0.5
    first = 0.01
    unit = "largest torque {:.4g} kJ/mol/rad"

    @cached_property
    def scale(self) -> Floats:
        """(n_v,) float: 1 for angles, ``ROOT_LEVER`` for the translation of a free root."""
        scale = np.ones(self.chain.n_v)
        for body in np.flatnonzero(self.chain.tree.kind == HingeKind.FREE):
            start = self.chain.tree.v_start[body]
            scale[start + 3 : start + 6] = ROOT_LEVER
        return scale

    @cached_property
    def _groups(self) -> Integers:
        return self.chain.rigid_groups

    def start(self, x: Floats) -> Floats:
        """Coordinates of the chain as it is.

        Raises
        ------
        ValueError
            If x are other positions: a chain has no others that it could be at for sure.
        """
        if not np.array_equal(x, self.chain.structure.positions):
            raise ValueError("a chain starts at its own positions")
        return self.chain.q0

    def place(self, q: Floats) -> tuple[Floats, Callable[[Floats], Floats]]:
        """Positions (na, 3) in nm at q, and J^T f of forces there."""
        at = pose(self.chain, q)
        return at.x, lambda forces: self.scale * pull_back(self.chain, at, forces)

    def residual(self, torque: Floats) -> float:
        """Largest torque, kJ/mol/rad."""
        return float(np.max(np.abs(torque)))

    def move(self, q: Floats, step: Floats) -> Floats:
        """Coordinates after a step (n_v,)."""
        return multibody.integrate(self.chain.tree, q, self.scale * step)

    def stiffness(self, at: Evaluation) -> Callable[[Floats], Floats]:
        """Solve with J^T C J of the contacts, by Cholesky's method."""
        matrix = springs.torsion_stiffness(self.chain, self._groups, pose(self.chain, at.q))
        matrix *= np.outer(self.scale, self.scale)
        matrix[np.diag_indices_from(matrix)] += springs.TORSION_FLOOR
        factor = cho_factor(matrix, lower=True, check_finite=False)
        return lambda torque: np.asarray(cho_solve(factor, torque, check_finite=False))

    def inertia(self, at: Evaluation) -> Callable[[Floats], Floats]:
        """Solve with the mass matrix, by articulated bodies."""
        posed = pose(self.chain, at.q)
        return lambda torque: solve_mass(self.chain, posed, torque / self.scale) / self.scale


@dataclass(frozen=True, eq=False)
class Cartesian:
    """All atoms free: q is x, row after row.

    Parameters
    ----------
    structure : Structure
    moving : (na,) bool
        Atoms that may move.
    """

    structure: Structure
    moving: NDArray[np.bool_]
    longest = 0.03
    first = 0.005
    unit = "RMS force {:.4g} kJ/mol/nm"

    @cached_property
    def _springs(self) -> springs.Springs:
        return springs.covalent(self.structure)

    def start(self, x: Floats) -> Floats:
        """Coordinates at x."""
        return x.flatten()

    def place(self, q: Floats) -> tuple[Floats, Callable[[Floats], Floats]]:
        """Positions (na, 3) in nm at q, and the forces on atoms that may move, row after row."""
        return q.reshape(-1, 3), lambda forces: np.where(self.moving[:, None], forces, 0.0).ravel()

    def residual(self, torque: Floats) -> float:
        """RMS force over the components that may move, kJ/mol/nm."""
        # Forces of atoms on top of one another may have no representable square.
        with np.errstate(over="ignore"):
            return float(np.sqrt(torque @ torque / (3 * max(1, self.moving.sum()))))

    def move(self, q: Floats, step: Floats) -> Floats:
        """Coordinates after a step (3 na,)."""
        return np.asarray(q + step)

    def stiffness(self, at: Evaluation) -> Callable[[Floats], Floats]:
        """Solve with a sparse matrix of bonds, angles, dihedrals and contacts."""
        return springs.cartesian_solver(self.structure, self._springs, at.x, self.moving)

    def inertia(self, at: Evaluation) -> Callable[[Floats], Floats]:
        """Divide by the masses."""
        mass = np.repeat(self.structure.atom_mass, 3)
        return lambda torque: np.asarray(torque / mass)
