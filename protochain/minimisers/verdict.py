"""What a result is worth, measured apart from the run that made it: OpenMM's Reference platform."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy.sparse import coo_array
from scipy.spatial import cKDTree

from protochain.arrays import Floats
from protochain.articulate import build_chain
from protochain.chain import Chain, Pose, pull_back
from protochain.energies.protocol import Energy
from protochain.minimisers.loop import Stop
from protochain.minimisers.problem import root_scale
from protochain.structure.model import Structure
from protochain.units import ANGSTROM_PER_NM

OVERLAP = 0.5
"""Unbonded atoms closer than this part of the sum of their van der Waals radii overlap. Hydrogen bonds
stay above 0.6."""

_VAN_DER_WAALS = {"H": 0.110, "C": 0.170, "N": 0.155, "O": 0.152, "S": 0.180}
"""nm: Mantina, Chamberlin, Valero, Cramer, Truhlar, J. Phys. Chem. A 113:5806 (2009)."""


class Status(StrEnum):
    """How a run ended, as the judge saw it."""

    CONVERGED = "converged"
    STALLED = "stalled"
    BUDGET = "budget"
    CLASH = "clash"
    NON_FINITE = "non-finite"
    INTERRUPTED = "interrupted"


@dataclass(frozen=True)
class Judgement:
    """Energy and forces of one set of positions, in double precision.

    Parameters
    ----------
    energy : float, kJ/mol
    max_torque : float, kJ/mol/rad
        Over the freedoms of the chain as it stands; a free root's force counts as its moment at 0.1 nm.
    rms_force : float, kJ/mol/nm
        Over all Cartesian components, as OpenMM's minimiser counts it.
    """

    energy: float
    max_torque: float
    rms_force: float


def judge(chain: Chain, energy: Energy, at: Pose) -> Judgement:
    """Judge a pose of a chain on the Reference platform."""
    value, forces = energy.reference(at.x)
    torque = root_scale(chain) * pull_back(chain, at, forces)
    # Forces of atoms on top of one another may have no representable square.
    with np.errstate(over="ignore"):
        return Judgement(value, float(np.max(np.abs(torque))), float(np.sqrt(np.mean(forces**2))))


def rebuilt(chain: Chain, x: Floats) -> Chain:
    """Build a chain with the same hinges on other positions, whose bond lengths and angles may differ."""
    return build_chain(chain.structure.with_positions(x), chain.opened, chain.root)


def worst_overlap(structure: Structure, x: Floats) -> str | None:
    """Name the unbonded pair of atoms that overlaps most, or None.

    Parameters
    ----------
    structure : Structure
    x : (na, 3) float, nm

    Returns
    -------
    str or None
        Both atoms, their distance in angstrom and what it is of their contact distance.
    """
    radius = np.array([_VAN_DER_WAALS.get(element, 0.17) for element in structure.atom_element])
    pairs = cKDTree(x).query_pairs(2 * OVERLAP * radius.max(), output_type="ndarray")
    pairs = pairs[~_within_three_bonds(structure, pairs)]
    if len(pairs) == 0:
        return None
    distance = np.linalg.norm(x[pairs[:, 0]] - x[pairs[:, 1]], axis=1)
    share = distance / radius[pairs].sum(axis=1)
    worst = int(np.argmin(share))
    if share[worst] >= OVERLAP:
        return None
    first, second = (structure.describe(int(atom)) for atom in pairs[worst])
    return (
        f"{first} and {second} are {ANGSTROM_PER_NM * distance[worst]:.2f} angstrom apart, "
        f"{100 * share[worst]:.0f} % of contact"
    )


def _within_three_bonds(structure: Structure, pairs: np.ndarray) -> np.ndarray:
    n = structure.n_atoms
    i, j = structure.bonds.T
    step = coo_array((np.ones(2 * len(i), dtype=np.int32), (np.r_[i, j], np.r_[j, i])), shape=(n, n)).tocsr()
    reach = step + step @ step + step @ step @ step
    return np.asarray(reach[pairs[:, 0], pairs[:, 1]]).ravel() > 0


def verdict(
    stop: Stop, met: bool, measured: str, structure: Structure, x: Floats, n_evaluations: int
) -> tuple[Status, str]:
    """Put the reason a run ended and what the judge measured into a status and a sentence.

    Parameters
    ----------
    stop : Stop
        Why the run ended.
    met : bool
        Whether the judge found the tolerance met.
    measured : str
        The number that shows it.
    structure : Structure
    x : (na, 3) float, nm
    n_evaluations : int

    Returns
    -------
    Status, str
    """
    if met:
        return Status.CONVERGED, f"converged: {measured}"
    if stop is Stop.INTERRUPTED:
        return Status.INTERRUPTED, f"interrupted after {n_evaluations} evaluations: {measured}"
    overlap = worst_overlap(structure, x)
    if overlap:
        return Status.CLASH, f"clash: {overlap}; {measured}"
    if stop is Stop.NON_FINITE:
        return (
            Status.NON_FINITE,
            f"non-finite: {stop.value}; the last structure before it is kept: {measured}",
        )
    if stop is Stop.BUDGET:
        return Status.BUDGET, f"budget: {n_evaluations} evaluations used: {measured}"
    if stop is Stop.TOLERANCE:
        return Status.STALLED, f"stalled: the tolerance was met only above the lowest energy: {measured}"
    return Status.STALLED, f"stalled: {stop.value}: {measured}"
