"""Repacking: side chains are put into the best of their rotamers."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from protochain.chains.contacts import near_pairs
from protochain.core.arrays import Floats, Integers
from protochain.core.errors import StructureError
from protochain.energies import Energy
from protochain.energies import energy as energy_of
from protochain.energies.native.terms import Terms, compile_system
from protochain.minimisers.curvature import terms_of
from protochain.relaxation.rotamer_energies import Interactions
from protochain.relaxation.rotamers import Rotamers, rotamers_of
from protochain.structure.molecule.model import Structure
from protochain.structure.molecule.repairs import Kind, Repair
from protochain.structure.sidechains.assignment import assign_states
from protochain.validation.clashes import clashes
from protochain.validation.rings import threaded_rings
from protochain.validation.rotamers import side_chains
from protochain.validation.violations import violations

_NEAR = 0.6
"""Share of the sum of the van der Waals radii. Closer atoms are in conflict. Hydrogen bonds are longer."""
_STAYING = ("N", "H", "H1", "H2", "H3", "CA", "HA", "HA2", "HA3", "CB", "C", "O", "OXT")
"""Atoms of a residue that no chi turns."""
_ROUNDS = 3  # Repetitions, with the residues that are still in conflict.


def repack_side_chains(
    structure: Structure,
    residues: Iterable[int] | None = None,
    *,
    energy: Energy | None = None,
    moving: NDArray[np.bool_] | None = None,
) -> Structure:
    """Put side chains into the best of their rotamers, all at once.

    Candidates are the input's dihedrals and the rotamers, turned by up to 12 degrees. Bond lengths, bond
    angles and the backbone do not change. The choice is the global minimum of the force field's energy of the
    side chains, softened as is usual for rigid rotamers. moving (na,) bool.
    Rotamers depend on the backbone: Shapovalov, Dunbrack, Structure 19:844 (2011).
    """
    chosen = conflicting_residues(structure) if residues is None else _check_residues(structure, residues)
    x, repairs = structure.positions, tuple[Repair, ...]()
    terms = None
    for _ in range(_ROUNDS):
        rotamers = rotamers_of(structure, structure.positions, chosen.tolist(), moving)
        if not rotamers:
            return structure
        terms = terms or _terms(structure, energy)
        x, repairs = _assign_rotamers(structure, terms, rotamers)
        extended = np.union1d(chosen, _crowding_residues(structure, x, chosen))
        if residues is not None or len(extended) == len(chosen):
            break
        chosen = extended
    return replace(structure, positions=x, repairs=(*structure.repairs, *repairs)) if repairs else structure


def conflicting_residues(structure: Structure) -> Integers:
    """Residues (n,) whose side chain overlaps, clashes, is too close, threads a ring, or fits no rotamer."""
    x = structure.positions
    outliers = violations(structure, x)
    crowded = near_pairs(structure, x, _NEAR)[0], clashes(structure, x).pairs
    threaded = [(*ring.atoms, *ring.bond) for ring in threaded_rings(structure, x)]
    atoms = np.concatenate(
        [pairs.ravel() for pairs in (*crowded, outliers.clashes, outliers.within)]
        + [np.array(ring_atoms, dtype=np.int64) for ring_atoms in threaded]
    )
    turning = atoms[~np.isin(structure.atom_name[atoms], _STAYING) & ~structure.kept[atoms]]
    return np.union1d(structure.atom_residue[turning], side_chains(structure, x).outliers)


def _check_residues(structure: Structure, residues: Iterable[int]) -> Integers:
    chosen = np.unique(np.array([int(residue) for residue in residues], dtype=np.int64))
    invalid = chosen[(chosen < 0) | (chosen >= structure.n_residues)]
    if len(invalid):
        raise StructureError(
            f"{structure.name}: there is no residue of index {invalid[0]}; "
            f"give indices from 0 to {structure.n_residues - 1}"
        )
    return chosen


def _terms(structure: Structure, energy: Energy | None) -> Terms:
    """Terms of an energy, or of the default force field if that energy cannot be decomposed."""
    terms = terms_of(energy)
    return terms or compile_system(energy_of(structure, solvent="vacuum", engine="openmm").system)


def _assign_rotamers(
    structure: Structure, terms: Terms, rotamers: list[Rotamers]
) -> tuple[Floats, tuple[Repair, ...]]:
    """Positions with the best rotamers, and repairs of the turned side chains."""
    x = np.array(structure.positions)
    interactions = Interactions(terms, structure.positions, rotamers)
    best = assign_states([interactions.self_energies(i) for i in range(len(rotamers))], interactions.pairs())
    repairs = []
    for side_chain, state in zip(rotamers, best.states.tolist(), strict=True):
        if state:
            x[side_chain.atoms] = side_chain.x[state]
            repairs.append(side_chain.repair(state, structure.residue(side_chain.residue)))
    if repairs and not best.is_proven:
        repairs.append(Repair(Kind.NOT_PROVEN))
    return x, tuple(repairs)


def _crowding_residues(structure: Structure, x: Floats, chosen: Integers) -> Integers:
    """Residues with atoms too close to atoms of the chosen residues."""
    pairs = structure.atom_residue[near_pairs(structure, x, _NEAR)[0]]
    return np.unique(pairs[np.isin(pairs, chosen).any(axis=1)])
