"""The bonded part of an energy: what holds molecules together while their atoms pass through one another."""

import copy

import openmm

from protochain.energies.factory import by_engine
from protochain.energies.openmm_engine import OpenMMEnergy
from protochain.energies.protocol import Energy

_BONDED = (
    openmm.HarmonicBondForce,
    openmm.HarmonicAngleForce,
    openmm.PeriodicTorsionForce,
    openmm.CustomTorsionForce,
    openmm.CMAPTorsionForce,
)


def bonded_part(energy: Energy) -> Energy | None:
    """Bonds, angles and dihedrals of an energy alone; None if its terms are not known."""
    own: Energy | None = getattr(energy, "bonded", None)
    if own is not None or energy.system is None:
        return own
    system = copy.deepcopy(energy.system)
    for place in reversed(range(system.getNumForces())):
        if not isinstance(system.getForce(place), _BONDED):
            system.removeForce(place)
    by_openmm = OpenMMEnergy(system, "CPU", energy.threads, energy.forcefield, "vacuum", "bonded terms alone")
    return by_engine("auto", by_openmm)
