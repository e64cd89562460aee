"""Freedoms to minimise in: the hinges of a chain, or all atoms."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from protochain.chains.chain import Chain, Pose, pose, pull_back
from protochain.core.arrays import Floats, Integers
from protochain.core.interrupts import run_interruptible
from protochain.core.settings import document_fields
from protochain.mechanics import multibody
from protochain.mechanics.multibody import HingeKind
from protochain.mechanics.multibody.articulated import solve_at_once
from protochain.minimisers import curvature, spring_model
from protochain.minimisers.bond_frames import apply_step, inward, legs_of, outward
from protochain.minimisers.curvature import NearTerms
from protochain.minimisers.problem import Evaluation, Placement
from protochain.structure.molecule.model import Structure

ROOT_LEVER = 0.1
"""nm. Translation of a free root that counts like one radian, to make forces and torques comparable."""
SOFT_TORSIONS, SOFT_DECAY = 1.0, 8.0
"""kJ/mol/rad^2, floor of the stiffness of contacts that ranks soft turns, and its decay rate per contact
distance. Minimisers have a higher floor and a steeper decay, to avoid long steps in soft directions. In the
search for the softest direction, these values need the fewest products with the Hessian."""

SOFT_ATOMS = 3.0
"""kJ/mol/nm^2, added for every atom to rank soft directions. Lowest eigenvalues of proteins are 2 to 20. With
the minimisers' floor, and few pairs coupled, the search needs twice as many products."""

_RANK = 1e-6  # nm per atom. Smaller total displacements are rounding, not motion.
_LARGE = 500  # Freedoms or atoms from which a stiffness is computed in a thread, so that Ctrl-C still works.


@document_fields
@dataclass(frozen=True, eq=False)
class Torsions:
    """Hinge angles and free roots of a chain. A free root moves by ``ROOT_LEVER`` per unit."""

    chain: Chain  # Its structure is the start.
    terms: NearTerms | None = None  # Of the force field, for its stiffness.
    longest = 0.5
    first = 0.01
    unit = "largest torque {:.4g} kJ/mol/rad"
    eigenvalue_unit = "kJ/mol/rad^2"
    lever = 1.0

    @cached_property
    def scale(self) -> Floats:
        """(n_v,) float: 1 for angles, ``ROOT_LEVER`` for the translation of a free root."""
        scale = np.ones(self.chain.n_v)
        for body in np.flatnonzero(self.chain.tree.kind == HingeKind.FREE):
            start = self.chain.tree.v_start[body]
            scale[start + 3 : start + 6] = ROOT_LEVER
        return scale

    def start(self, x: Floats) -> Floats:
        """Coordinates of the chain's own positions. Raise a ValueError if x differs from them."""
        # Bond lengths and angles of x may not fit the chain.
        if not np.array_equal(x, self.chain.structure.positions):
            raise ValueError("a chain starts at its own positions")
        return self.chain.q0

    def place(self, q: Floats) -> Pose:
        """Pose of the chain at q."""
        return pose(self.chain, q)

    def torque(self, at: Placement, forces: Floats) -> Floats:
        """Scaled torques J^T f (n_v,) of forces (na, 3) at a pose."""
        return np.asarray(self.scale * pull_back(self.chain, _pose(at), forces))

    def transport_torque(self, torque: Floats, at: Placement, to: Placement) -> Floats:
        """Torques (n_v,) unchanged, as freedoms are the same everywhere."""
        return torque

    def residual(self, torque: Floats) -> float:
        """Largest torque, kJ/mol/rad."""
        return float(np.max(np.abs(torque), initial=0.0))

    def sizes(self, torque: Floats) -> dict[str, float]:
        """RMS and largest torque, kJ/mol/rad."""
        with np.errstate(over="ignore"):
            rms = float(np.sqrt(torque @ torque / max(1, len(torque))))
        return {"rms_torque_kj_mol_rad": rms, "max_torque_kj_mol_rad": self.residual(torque)}

    def move(self, q: Floats, step: Floats) -> Floats:
        """Coordinates after a step (n_v,)."""
        return multibody.integrate(self.chain.tree, q, self.scale * step)

    def stiffness(
        self, at: Evaluation, near_by: spring_model.Near | None = None, tether: Floats | None = None
    ) -> Callable[[Floats], Floats]:
        """Solver for J^T C J, by Cholesky factorisation.

        C contains the force field's near terms, or given springs, or else contacts, and the tethers.
        """
        by_terms = self.terms is not None and near_by is None
        floor = curvature.TORSION_FLOOR if by_terms else spring_model.TORSION_FLOOR
        return self._solver(partial(self.model, _pose(at.pose), near_by, tether), floor)

    def model(
        self, at: Pose, near_by: spring_model.Near | None = None, tether: Floats | None = None
    ) -> Floats:
        """(n_v, n_v) float: J^T C J of :meth:`stiffness` at a pose, not scaled."""
        if self.terms is None or near_by is not None:
            near = near_by or spring_model.contacts
            return spring_model.torsion_stiffness(self.chain, at, near, tether)
        springs = curvature.springs_of(self.terms, at.x, ~self.chain.structure.obstacle)
        angles = curvature.bonded_gradients(self.terms, at.x)
        return spring_model.torsion_stiffness(self.chain, at, lambda *_: springs, tether, angles)

    def softness(self, at: Evaluation) -> Callable[[Floats], Floats]:
        """Solver for the stiffness of contacts with a tiny floor."""
        soft = partial(spring_model.torsion_stiffness, self.chain, _pose(at.pose), _soft_springs)
        return self._solver(soft, SOFT_TORSIONS)

    def _solver(self, make: Callable[[], Floats], floor: float) -> Callable[[Floats], Floats]:
        def scaled_matrix() -> Floats:
            matrix = make()
            matrix *= np.outer(self.scale, self.scale)
            matrix[np.diag_indices_from(matrix)] += floor
            return matrix

        return solver(scaled_matrix, self.chain.n_v)

    def motions_of_whole(self, at: Evaluation) -> Floats:
        """Orthonormal rigid motions (k, n_v), or none if a root or an atom is fixed."""
        if not self.chain.moving.all():
            return np.empty((0, self.chain.n_v))
        motions = motions_of_whole(self.chain, _pose(at.pose))
        return np.linalg.qr((motions / self.scale).T)[0].T

    def inertia(self, at: Evaluation) -> Callable[[Floats], Floats]:
        """Solver for the mass matrix, by the articulated-body algorithm."""
        posed = _pose(at.pose)
        # Torques that are not finite are allowed: the run then ends with a status.
        tree = self.chain.tree
        return lambda torque: solve_at_once(tree, posed.frames, torque / self.scale) / self.scale


def solver(make: Callable[[], Floats], n: int) -> Callable[[Floats], Floats]:
    """Solver for a positive definite matrix (n, n), by Cholesky factorisation."""

    def factorise() -> Any:
        return cho_factor(make(), lower=True, check_finite=False)

    # For a large protein this lasts seconds.
    factor = factorise() if n < _LARGE else run_interruptible(factorise, is_deferred=True)
    return lambda torque: np.asarray(cho_solve(factor, torque, check_finite=False))


def _soft_springs(structure: Structure, x: Floats, bonds: int) -> spring_model.Springs:
    """Springs of contacts, bonds and angles. Closures of rings and disulfides stretch the latter."""
    soft = spring_model.contacts(structure, x, bonds, SOFT_DECAY)
    covalent = spring_model.covalent(structure)
    firm = covalent.stiffness >= spring_model.ANGLE
    return spring_model.Springs(
        np.concatenate([soft.pairs, covalent.pairs[firm]]),
        np.concatenate([soft.stiffness, covalent.stiffness[firm]]),
    )


def motions_of_whole(chain: Chain, pose: Pose) -> Floats:
    """Rotations and translations (6, n_v) about the world origin, or (0, n_v) if a root is fixed."""
    tree, frames = chain.tree, pose.frames
    roots = np.flatnonzero(tree.parent < 0)
    if not (tree.kind[roots] == HingeKind.FREE).all():
        return np.empty((0, chain.n_v))
    motions = np.zeros((6, chain.n_v))
    for root in roots:
        freedoms = slice(tree.v_start[root], tree.v_start[root] + 6)
        twists = np.empty((6, 6))
        for k, unit in enumerate(np.eye(chain.n_v)[freedoms]):
            twists[:, k] = multibody.velocities(tree, frames, unit)[root]
        root_twists = np.eye(6)
        # A turn about the world origin also moves this body's origin.
        root_twists[3:, :3] = np.cross(np.eye(3), frames.origin[root]).T
        motions[:, freedoms] = np.linalg.solve(twists, root_twists).T
    return motions


def _pose(at: Placement) -> Pose:
    assert isinstance(at, Pose)
    return at


@dataclass(frozen=True, eq=False)
class Positions:
    """Free atoms at one point."""

    q: Floats  # (3 na,) nm.

    @property
    def x(self) -> Floats:
        """(na, 3) float, nm."""
        return self.q.reshape(-1, 3)


@document_fields
@dataclass(frozen=True, eq=False)
class Cartesian:
    """All atoms free. q is x, flattened. Steps and torques are in frames that turn with each atom's bonds."""

    structure: Structure  # Its bonds and masses are used.
    moving: NDArray[np.bool_]  # (na,) bool: Atoms that may move.
    terms: NearTerms | None = None  # Of the force field, for its stiffness.
    longest = 0.03
    first = 0.005
    unit = "RMS force {:.4g} kJ/mol/nm"
    eigenvalue_unit = "kJ/mol/nm^2"
    lever = ROOT_LEVER

    @cached_property
    def _legs(self) -> Integers:
        return legs_of(self.structure.bonds, self.structure.atom_mass)

    @cached_property
    def _bonds(self) -> tuple[Integers, Floats]:
        """Bonds, and the inverse mass of each atom, 0 if fixed."""
        return np.array(self.structure.bonds), np.where(self.moving, 1.0 / self.structure.atom_mass, 0.0)

    def inward(self, x: Floats, vectors: Floats) -> Floats:
        """Convert vectors (3 na,) from world axes to the frames of the atoms at x (na, 3), nm."""
        return inward(np.array(x), self._legs, vectors.reshape(-1, 3)).ravel()

    def outward(self, x: Floats, vectors: Floats) -> Floats:
        """Convert vectors (3 na,) from the frames of the atoms at x (na, 3), nm, to world axes."""
        return outward(np.array(x), self._legs, vectors.reshape(-1, 3)).ravel()

    def start(self, x: Floats) -> Floats:
        """Coordinates at x."""
        return x.flatten()

    def place(self, q: Floats) -> Positions:
        """Positions at q."""
        return Positions(q)

    def torque(self, at: Placement, forces: Floats) -> Floats:
        """Forces (3 na,) on the moving atoms, in their frames, and zero on the others."""
        return self.inward(at.x, np.where(self.moving[:, None], forces, 0.0))

    def transport_torque(self, torque: Floats, at: Placement, to: Placement) -> Floats:
        """Convert forces (3 na,) from the frames at one placement to the frames at another."""
        return self.inward(to.x, self.outward(at.x, torque))

    def residual(self, torque: Floats) -> float:
        """RMS force over the components of moving atoms, kJ/mol/nm."""
        # The squared forces of coinciding atoms may overflow.
        with np.errstate(over="ignore"):
            return float(np.sqrt(torque @ torque / (3 * max(1, self.moving.sum()))))

    def sizes(self, torque: Floats) -> dict[str, float]:
        """RMS force over the components of moving atoms, and largest force on an atom, kJ/mol/nm."""
        force = torque.reshape(-1, 3)
        with np.errstate(over="ignore"):
            largest = float(np.sqrt(np.max(np.einsum("ij,ij->i", force, force), initial=0.0)))
        return {"rms_force_kj_mol_nm": self.residual(torque), "max_force_kj_mol_nm": largest}

    def move(self, q: Floats, step: Floats) -> Floats:
        """Coordinates after a step (3 na,) that turns bonds on arcs."""
        x = q.reshape(-1, 3)
        return apply_step(x, self.outward(x, step).reshape(-1, 3), *self._bonds).ravel()

    def stiffness(
        self, at: Evaluation, near_by: spring_model.Near | None = None, tether: Floats | None = None
    ) -> Callable[[Floats], Floats]:
        """Solver for a sparse model of the Hessian.

        It has the near terms of the force field, optionally with springs instead of its Lennard-Jones pairs.
        Otherwise it has springs for bonds, angles, dihedrals and contacts. Tethers are added.
        """
        if self.terms is None:
            near = near_by or spring_model.contacts
            springs = spring_model.covalent(self.structure)
            make = partial(curvature.springs_solver, self.structure, springs, at.x, self.moving, near, tether)
        else:
            near_springs = None if near_by is None else near_by(self.structure, at.x, 3)
            make = partial(curvature.near_solver, self.terms, at.x, self.moving, near_springs, tether)
        solve = make() if len(self.moving) < _LARGE else run_interruptible(make, is_deferred=True)
        return self._in_frames(at.x, solve)

    def _in_frames(self, x: Floats, solve: Callable[[Floats], Floats]) -> Callable[[Floats], Floats]:
        """Convert a solver in world axes to the frames of the atoms."""
        return lambda torque: self.inward(x, solve(self.outward(x, torque)))

    def softness(self, at: Evaluation) -> Callable[[Floats], Floats]:
        """Solver for the same model with all its pairs coupled, and a tiny floor."""
        if self.terms is None:
            springs = spring_model.covalent(self.structure)
            solve = curvature.springs_solver(self.structure, springs, at.x, self.moving, floor=SOFT_ATOMS)
        else:
            solve = curvature.near_solver(self.terms, at.x, self.moving, coupled_from=0.0, floor=SOFT_ATOMS)
        return self._in_frames(at.x, solve)

    def motions_of_whole(self, at: Evaluation) -> Floats:
        """Orthonormal rigid motions (k, 3 na): six, or fewer if atoms are fixed or all are on a line."""
        x = at.x - at.x[self.moving].mean(axis=0)
        axes = np.eye(3)[:, None]
        motions = np.concatenate([np.broadcast_to(axes, (3, *x.shape)), np.cross(axes, x)])
        # Motions that do not move the fixed atoms.
        _, size, among = np.linalg.svd(motions[:, ~self.moving].reshape(6, 3 * int((~self.moving).sum())).T)
        motions = among[np.sum(size > _RANK * len(x)) :] @ motions.reshape(6, -1)
        _, size, along = np.linalg.svd(motions, full_matrices=False)
        rigid = along[size > _RANK * len(x)]
        return np.array([self.inward(at.x, motion) for motion in rigid]).reshape(rigid.shape)

    def inertia(self, at: Evaluation) -> Callable[[Floats], Floats]:
        """Solver for the diagonal mass matrix."""
        mass = np.repeat(self.structure.atom_mass, 3)
        return lambda torque: np.asarray(torque / mass)


def spaces(chain: Chain, terms: NearTerms | None = None) -> tuple[Torsions, Cartesian]:
    """Both spaces of a chain, with near terms of its force field, cached with all derived data."""
    return _spaces(chain, terms)


@lru_cache(maxsize=4)
def _spaces(chain: Chain, terms: NearTerms | None) -> tuple[Torsions, Cartesian]:
    return Torsions(chain, terms), Cartesian(chain.structure, chain.moving, terms)
