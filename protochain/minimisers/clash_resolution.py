"""Separation of overlapping atoms by local moves, before minimisation in the force field.

In the force field alone the chain flies apart. Forces of 1e11 kJ/mol/nm at one contact turn a dihedral and
all atoms beyond it. Therefore soft repulsion separates the atoms first, while all others are tethered. Then
springs restrain the chain while the force field resolves the remaining strain.
"""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from protochain.chains.contacts import near_pairs, overlaps
from protochain.core.arrays import Floats, read_only
from protochain.energies.factory import bonded_part
from protochain.energies.protocol import Energy
from protochain.minimisers import restraints
from protochain.minimisers.descent import Descent
from protochain.minimisers.lbfgs import LBFGS, NEAR_MEMORY
from protochain.minimisers.metrics import NEAR_REFRESH, Solve
from protochain.minimisers.problem import Evaluation, Force, Placement, Space
from protochain.minimisers.restraints import Bound, ChiralityRestraint, SoftRepulsion, Sum, Tethers
from protochain.minimisers.spaces import Cartesian, Torsions
from protochain.minimisers.spring_model import Springs
from protochain.minimisers.stages import Stage
from protochain.minimisers.steps import StrongWolfe
from protochain.minimisers.unthread import unthread_stages
from protochain.minimisers.verdict import rebuilt
from protochain.structure.molecule.model import Structure
from protochain.validation.rings import threaded_rings

STRAINED_TORQUE = 1e5
"""kJ/mol/rad. Starts with larger torques are strained. Fifty prepared crystal and NMR structures without
overlaps have at most 6e4."""

HANDOVER_TORQUE, HANDOVER_TORQUE_ALONE = 1e3, 1e4
"""kJ/mol/rad. Largest torques with which a stage in torsions starts after separation: if all atoms could move
instead, and if they could not. At 1e4, torsions still fling a chain with strained bonds."""

BACKBONE_TETHER = 2000.0
"""kJ/mol/nm^2 on each heavy backbone atom while overlaps are separated, so that side chains yield."""
LARGEST_MOVE = 0.6  # nm, largest move of an atom during separation: the reach of a long side chain.
SPRING = 4184.0
"""kJ/mol/nm^2 on heavy atoms in the first stage with the force field. It is 10 kcal/mol/angstrom^2, as in
AlphaFold's relaxation (Jumper et al., Nature 596:583, 2021, supplement 1.8.6)."""

SPRINGS_ON_BACKBONE = (1000.0, 100.0)
"""kJ/mol/nm^2, in this order, on heavy backbone atoms only: side chains relax before the backbone."""
SPRINGS_IN_TORSIONS = (SPRING, 400.0, 40.0)  # kJ/mol/nm^2, in this order, because torsions have long levers.
_OVERLAP_FORCE = 20.0
_HEAVY_FORCE = 10.0
_SIDE_CHAIN_FORCE = 2.0
"""kJ/mol/nm, RMS forces at which stages end: soft repulsion, springs on heavy atoms, springs on backbone."""
_TORSION_TORQUE = 300.0  # kJ/mol/rad, largest torque at which stages with springs in torsions end.
_PATIENCE = 60  # Evaluations without a lower energy, after which separation ends.


@dataclass(frozen=True, eq=False)
class TetheredModel:
    """Model of the Hessian of tethered atoms, optionally with soft repulsion."""

    tether: Floats  # (na,) kJ/mol/nm^2.
    is_soft: bool = False  # Whether near atoms repel each other as in :class:`SoftRepulsion`.
    refresh_every: int = 20  # Iterations between two computations of the matrix.

    def at(self, space: Space, at: Evaluation) -> Solve:
        """Solver for the model at a point."""
        assert isinstance(space, Torsions | Cartesian)
        return space.stiffness(at, _soft_springs if self.is_soft else None, self.tether)


def _soft_springs(structure: Structure, x: Floats, bonds: int) -> Springs:
    pairs, _ = near_pairs(structure, x, restraints.SOFT_SHARE, max(bonds, 3))
    return Springs(pairs, np.full(len(pairs), restraints.SOFT_STIFFNESS))


def torsion_clash_stages(
    space: Torsions, energy: Energy, tolerance: float, restraint: Force | None, overlap: bool
) -> list[Stage]:
    """Stages that resolve clashes in torsions, then weaken springs in the force field step by step."""
    stage = Stage(space, Descent(LBFGS(), StrongWolfe()), energy, max(_TORSION_TORQUE, tolerance), restraint)
    stages = [_with_springs(stage, strength) for strength in SPRINGS_IN_TORSIONS]
    return [_soft_stage(space, _soft_terms(space.chain.structure), 1.0), *stages] if overlap else stages


def all_atom_clash_stages(
    torsions: Torsions,
    space: Cartesian,
    energy: Energy,
    tolerance: float,
    restraint: Force | None,
    overlap: bool,
) -> list[Stage]:
    """Stages that unthread rings and separate overlaps in all atoms, then minimise in the force field."""
    structure = space.structure
    plan: list[Stage] = []
    threaded = bool(threaded_rings(structure))
    if overlap or threaded:
        bonded, soft_terms = bonded_part(energy), _soft_terms(structure)
        if bonded is None:
            soft = _soft_stage(torsions, soft_terms, 1.0)
        else:
            soft = _soft_stage(space, [bonded, *soft_terms], _OVERLAP_FORCE)
        plan += [*unthread_stages(soft, _where_atoms_overlap), soft] if threaded else [soft]
    stage = Stage(space, Descent(LBFGS(), StrongWolfe()), energy, max(_HEAVY_FORCE, tolerance), restraint)
    settled = replace(stage, tolerance=max(_SIDE_CHAIN_FORCE, tolerance))
    backbone = [_with_springs(settled, k, backbone_atoms(structure)) for k in SPRINGS_ON_BACKBONE]
    return [*plan, _with_springs(stage, SPRING), *backbone]


def unthreading_stages(space: Cartesian, energy: Energy) -> list[Stage]:
    """Stages that unthread rings by moving all atoms, or none if the bonds of an energy are not known."""
    bonded = bonded_part(energy)
    if bonded is None:
        return []
    soft = _soft_stage(space, [bonded, *_soft_terms(space.structure)], _OVERLAP_FORCE)
    return [*unthread_stages(soft, _where_atoms_overlap), _where_atoms_overlap(soft)]


def _where_atoms_overlap(stage: Stage) -> Stage:
    structure = _structure(stage.space)
    return replace(stage, ready=lambda stage, at: bool(overlaps(structure, at.x)))


def backbone_atoms(structure: Structure) -> NDArray[np.bool_]:
    """(na,) bool: heavy atoms of the protein's backbone."""
    return np.isin(structure.atom_name, ("N", "CA", "C", "O")) & ~structure.kept


def soft_tethers(structure: Structure) -> Floats:
    """(na,) float, kJ/mol/nm^2: tethers while overlaps are separated."""
    return read_only(np.where(backbone_atoms(structure), BACKBONE_TETHER, restraints.SOFT_TETHER))


def _soft_terms(structure: Structure) -> list[Force]:
    x = structure.positions
    leashes: list[Force] = [Tethers(x, soft_tethers(structure)), Bound(x, LARGEST_MOVE)]
    return [SoftRepulsion(structure), *leashes, ChiralityRestraint.preserving(structure)]


def _soft_stage(space: Torsions | Cartesian, terms: list[Force], tolerance: float) -> Stage:
    method = Descent(LBFGS(TetheredModel(soft_tethers(_structure(space)), True)), StrongWolfe())
    return Stage(
        space, method, Sum(terms), tolerance, recorded=False, patience=_PATIENCE, name="resolving clashes"
    )


def _with_springs(stage: Stage, strength: float, atoms: NDArray[np.bool_] | None = None) -> Stage:
    """Stage with springs to its initial positions, on all heavy atoms or on some."""
    structure = _structure(stage.space)
    atoms = structure.atom_element != "H" if atoms is None else atoms
    chirality = ChiralityRestraint.preserving(structure)
    fit = partial(_fit_springs, read_only(np.where(atoms, strength, 0.0)), chirality)
    return replace(stage, fit=fit, name="held by springs")


def _fit_springs(weight: Floats, chirality: ChiralityRestraint, stage: Stage, x: Floats) -> Stage:
    parts: list[Force] = [Tethers(x, weight), chirality, *([stage.restraint] if stage.restraint else [])]
    assert isinstance(stage.space, Torsions | Cartesian)
    if stage.space.terms is not None:
        direction = LBFGS(TetheredModel(weight, refresh_every=NEAR_REFRESH), NEAR_MEMORY)
    else:
        direction = LBFGS(
            TetheredModel(weight, refresh_every=20 if isinstance(stage.space, Torsions) else 40)
        )
    return replace(stage, method=Descent(direction, StrongWolfe()), restraint=Sum(parts))


def _structure(space: Space) -> Structure:
    assert isinstance(space, Torsions | Cartesian)
    return space.chain.structure if isinstance(space, Torsions) else space.structure


def run_if_unstrained(stage: Stage, energy: Energy | None = None) -> Stage:
    """Stage in torsions that runs only if no atoms overlap and the largest torque is small enough."""
    fit = None if energy is None else partial(_rebuild_stage, energy)
    return replace(stage, ready=partial(_is_unstrained, energy), fit=fit)


def _is_unstrained(energy: Energy | None, stage: Stage, at: Placement) -> bool:
    if overlaps(_structure(stage.space), at.x):
        return False
    space: Space = stage.space
    if energy is not None:
        space = _torsions_at(space, at.x)
        at = space.place(space.start(at.x))
    torque = space.residual(space.torque(at, (energy or stage.energy)(at.x)[1]))
    return torque <= (HANDOVER_TORQUE_ALONE if energy is None else HANDOVER_TORQUE)


def _rebuild_stage(energy: Energy, stage: Stage, x: Floats) -> Stage:
    space = _torsions_at(stage.space, x)
    return replace(stage, space=space, energy=energy.without_constants(space.chain.rigid_groups, x))


def _torsions_at(space: Space, x: Floats) -> Torsions:
    assert isinstance(space, Torsions)
    return Torsions(rebuilt(space.chain, read_only(x)), space.terms)
