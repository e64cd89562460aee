"""Model of the Hessian from the force field's own near terms, each made positive by itself.

Bonds, angles, dihedrals, and Lennard-Jones pairs up to :data:`REACH` cause nearly all of the stiffness that
slows minimisation. A pair contributes its curvature along its line if this is positive, and its curvature
across the line if it is stretched: max(0, U'') u u^T + max(0, U'/r) (1 - u u^T). Angles and dihedrals
contribute the Gauss-Newton part, U'' g g^T with g the gradient of the angle, and |U''| for dihedrals. Any sum
of these terms is positive. This is the preconditioner of Mones, Ortner, Csanyi, Sci. Rep. 8:13991 (2018),
with the force field's own constants.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from protochain.core.arrays import Floats, Integers
from protochain.energies.native.neighbours import partners
from protochain.energies.native.reading import UnsupportedForceError
from protochain.energies.native.terms import Bonded, Terms, compile_system
from protochain.energies.protocol import Energy
from protochain.minimisers import near_kernels as kernels
from protochain.minimisers.cholesky import elimination_order, factorise
from protochain.minimisers.spring_model import CARTESIAN_FLOOR, Gradients, Near, Springs, contacts
from protochain.structure.molecule.model import Structure

REACH = 0.4  # nm, longest Lennard-Jones pair. Pairs up to 0.5 nm, and Coulomb forces, save no evaluations.
COUPLED = 1000.0
"""kJ/mol/nm^2, smallest stiffness of a Lennard-Jones pair that couples its atoms. Softer pairs, nine of ten,
contribute to diagonal blocks only. All pairs would make the factor four times larger, with no gain."""

FLOOR = 500.0  # kJ/mol/nm^2, added for every atom. Values between 200 and 2000 perform alike.
TORSION_FLOOR = 50.0  # kJ/mol/rad^2, added for every freedom, for long-range forces.
Stretches = tuple[Integers, Floats, Floats]
"""Pairs (n, 2), and their curvatures (n,) along and across, kJ/mol/nm^2."""


@dataclass(frozen=True, eq=False)
class NearTerms:
    """Near terms of a force field."""

    n_atoms: int
    bonds: Bonded  # Pairs, with (r0, k).
    angles: Bonded  # Three atoms, with (theta0, k).
    dihedrals: Integers  # (n, 4) int: Each once.
    # (m, 3): Cosines (n, phi0, k), grouped by dihedral; n = 0 is a constant stiffness k.
    waves: Floats
    first_wave: Integers  # (n + 1,) int: Of each dihedral.
    contacts: Bonded  # 1-4 pairs, with (A, B) of A/r^12 - B/r^6.
    lj_type: Integers  # (na,) int.
    a12: Floats  # a12, b6: (types, types): A and B of free pairs.
    b6: Floats
    # Excluded partners of higher index: start of each atom's partners, and the partners.
    partners: tuple[Integers, Integers]

    @cached_property
    def pairs(self) -> Integers:
        """(n, 2) int: pairs of atoms that bonded terms and 1-4 pairs couple, sorted, lower index first."""
        return np.column_stack(np.divmod(self._keys, self.n_atoms))

    @cached_property
    def slots(self) -> tuple[Integers, ...]:
        """Places in ``pairs`` of the pairs of each bond, 1-4 pair, angle and dihedral."""
        return tuple(np.searchsorted(self._keys, self._keys_of(atoms)) for atoms in self._atoms)

    @cached_property
    def _keys(self) -> Integers:
        return np.unique(np.concatenate([self._keys_of(atoms).ravel() for atoms in self._atoms]))

    @property
    def _atoms(self) -> tuple[Integers, ...]:
        return self.bonds.atoms, self.contacts.atoms, self.angles.atoms, self.dihedrals

    def _keys_of(self, atoms: Integers) -> Integers:
        """(n, pairs) int: keys of the pairs of each term."""
        first, second = np.triu_indices(atoms.shape[1], 1)
        i, j = atoms[:, first], atoms[:, second]
        return np.asarray(np.minimum(i, j) * self.n_atoms + np.maximum(i, j))


def near_terms(energy: Energy) -> NearTerms | None:
    """Near terms of an energy, for the metric of :class:`Torsions` or :class:`Cartesian`.

    Parameters
    ----------
    energy : Energy
        Any energy function.

    Returns
    -------
    NearTerms or None
        None if its terms are not known, e.g. for a callable. The metric then consists of springs.
    """
    terms = terms_of(energy)
    return None if terms is None else _near(terms)


def terms_of(energy: Any) -> Terms | None:
    """Terms of an energy as arrays, or None if they are not known, e.g. for a callable."""
    terms: Terms | None = getattr(energy, "terms", None)
    return _read(energy) if terms is None and getattr(energy, "system", None) is not None else terms


@lru_cache(maxsize=4)
def _read(energy: Any) -> Terms | None:
    try:
        return compile_system(energy.system)
    except UnsupportedForceError:
        return None


@lru_cache(maxsize=4)
def _near(terms: Terms) -> NearTerms:
    kinds, exceptions = terms.bonded, terms.nonbonded.exceptions
    wells = exceptions.parameters[:, 1] > 0.0
    return NearTerms(
        terms.n_atoms, _concatenate(kinds["bonds"], kinds["ties"]),
        _concatenate(kinds["angles"], kinds["tie angles"]),
        *_dihedrals(kinds["torsions"], kinds["impropers"]),
        Bonded(exceptions.atoms[wells], exceptions.parameters[wells, :2]), terms.nonbonded.lj_type,
        terms.nonbonded.a12, terms.nonbonded.b6, partners(exceptions.atoms, terms.n_atoms),
    )  # fmt: skip


def _concatenate(*groups: Bonded) -> Bonded:
    atoms, parameters = zip(*((group.atoms, group.parameters) for group in groups), strict=True)
    return Bonded(np.concatenate(atoms), np.concatenate(parameters))


def _dihedrals(torsions: Bonded, impropers: Bonded) -> tuple[Integers, Floats, Integers]:
    """Unique dihedrals, their cosines, and the first cosine of each."""
    atoms = np.concatenate([torsions.atoms, impropers.atoms])
    # k (phi - phi0)^2 has the same curvature everywhere.
    constant = np.zeros((len(impropers.atoms), 3))
    constant[:, 2] = 2.0 * impropers.parameters[:, 1]
    waves = np.concatenate([torsions.parameters, constant])
    # A dihedral read backwards is the same.
    backwards = atoms[:, 0] > atoms[:, 3]
    atoms[backwards] = atoms[backwards, ::-1]
    unique, index = np.unique(atoms, axis=0, return_inverse=True)
    index = index.reshape(-1)
    order = np.argsort(index, kind="stable")
    return unique, waves[order], np.searchsorted(index[order], np.arange(len(unique) + 1))


@dataclass(frozen=True, eq=False)
class Curvature:
    """Blocks of the Hessian's model."""

    atom_blocks: Floats  # (na, 9): Diagonal blocks, row by row.
    pairs: Integers  # (n, 2) int: Coupled atoms, lower index first.
    pair_blocks: Floats  # (n, 9): Their blocks.


def free_wells(terms: NearTerms, x: Floats, moving: NDArray[np.bool_]) -> Stretches:
    """Free Lennard-Jones pairs within :data:`REACH` with a moving atom, and their curvatures."""
    x = np.array(x)
    pairs = kernels.free_pairs(x, *terms.partners, np.array(moving), REACH)
    i, j = terms.lj_type[pairs.T]
    return pairs, *kernels.well_stiffness(x, pairs, terms.a12[i, j], terms.b6[i, j])


def bonded_springs(terms: NearTerms, x: Floats) -> tuple[Stretches, Stretches]:
    """Bonds and 1-4 pairs, with their curvatures."""
    length, k = np.ascontiguousarray(terms.bonds.parameters.T)
    a12, b6 = np.ascontiguousarray(terms.contacts.parameters.T)
    pairs, close = terms.bonds.atoms, terms.contacts.atoms
    return (pairs, *kernels.bond_stiffness(x, pairs, length, k)), (
        close, *kernels.well_stiffness(x, close, a12, b6),
    )  # fmt: skip


def bonded_gradients(terms: NearTerms, x: Floats) -> tuple[Gradients, Gradients]:
    """Angles and dihedrals, with their gradients and curvatures."""
    angles = terms.angles.atoms
    return (angles, kernels.bends(x, angles), terms.angles.parameters[:, 1].copy()), (
        terms.dihedrals, *kernels.turns(x, terms.dihedrals, terms.waves, terms.first_wave),
    )  # fmt: skip


def curvature(terms: NearTerms, x: Floats, near: Stretches, coupled_from: float = COUPLED) -> Curvature:
    """Blocks of the bonded terms, and of springs between near atoms."""
    # x (na, 3) nm, coupled_from kJ/mol/nm^2.
    # Copies are writable, and kernels compiled once.
    x = np.array(x)
    atom_blocks, pair_blocks = np.zeros((terms.n_atoms, 9)), np.zeros((len(terms.pairs), 9))
    springs, gradients = bonded_springs(terms, x), bonded_gradients(terms, x)
    for (pairs, along, across), slots in zip(springs, terms.slots[:2], strict=True):
        kernels.add_springs(x, pairs, along, across, slots.ravel(), atom_blocks, pair_blocks)
    for (atoms, g, stiffness), slots in zip(gradients, terms.slots[2:], strict=True):
        kernels.add_gradients(atoms, g, stiffness, slots, atom_blocks, pair_blocks)
    pairs, along, across = near
    coupled = along > coupled_from
    slots = np.where(coupled, np.cumsum(coupled) - 1, -1)
    added = np.zeros((int(coupled.sum()), 9))
    kernels.add_springs(x, pairs, along, across, slots, atom_blocks, added)
    return Curvature(
        atom_blocks, np.concatenate([terms.pairs, pairs[coupled]]), np.concatenate([pair_blocks, added])
    )


def springs_of(terms: NearTerms, x: Floats, moving: NDArray[np.bool_]) -> Springs:
    """Bonds, 1-4 pairs and free pairs as springs along their lines, for :func:`springs.torsion_stiffness`."""
    # Curvature across a line would also stiffen turns of rigid groups, which change no length.
    parts = [*bonded_springs(terms, x), free_wells(terms, x, moving)]
    return Springs(np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts]))


def near_solver(
    terms: NearTerms, x: Floats, moving: NDArray[np.bool_], near: Springs | None = None,
    tether: Floats | None = None, coupled_from: float = COUPLED, floor: float = FLOOR,
) -> Callable[[Floats], Floats]:  # fmt: skip
    """Solver for the model of the Hessian in Cartesian coordinates."""
    # x (na, 3) nm, moving (na,) bool, tether (na,).
    if near is None:
        wells = free_wells(terms, x, moving)
    else:
        wells = near.pairs, near.stiffness, np.zeros(len(near.pairs))
    return _solver(curvature(terms, x, wells, coupled_from), moving, floor, tether)


def springs_solver(
    structure: Structure, bonded: Springs, x: Floats, moving: NDArray[np.bool_], near_by: Near = contacts,
    tether: Floats | None = None, floor: float = CARTESIAN_FLOOR,
) -> Callable[[Floats], Floats]:  # fmt: skip
    """Solver like :func:`near_solver`, for springs of bonds, angles, dihedrals and contacts."""
    near, x = near_by(structure, x, 3), np.array(x)
    atom_blocks, pair_blocks = np.zeros((len(x), 9)), np.zeros((len(bonded.pairs), 9))
    for springs, slots in ((bonded, np.arange(len(pair_blocks))), (near, np.full(len(near.pairs), -1))):
        across = np.zeros(len(springs.pairs))
        kernels.add_springs(x, springs.pairs, springs.stiffness, across, slots, atom_blocks, pair_blocks)
    return _solver(Curvature(atom_blocks, bonded.pairs, pair_blocks), moving, floor, tether)


def _solver(
    model: Curvature, moving: NDArray[np.bool_], floor: float, tether: Floats | None
) -> Callable[[Floats], Floats]:
    model.atom_blocks[:, ::4] += floor if tether is None else (floor + tether)[:, None]
    # Pairs of atoms that both move, as indices among the moving atoms.
    is_coupled = moving[model.pairs].all(axis=1)
    pairs = (np.cumsum(moving) - 1)[model.pairs[is_coupled]]
    order = elimination_order(int(moving.sum()), pairs)
    factor = factorise(order, model.atom_blocks[moving], pairs, model.pair_blocks[is_coupled])

    def solve(torque: Floats) -> Floats:
        step = np.zeros((len(moving), 3))
        step[moving] = factor.solve(torque.reshape(-1, 3)[moving].ravel()).reshape(-1, 3)
        return step.ravel()

    return solve
