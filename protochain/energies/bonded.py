"""The bonded part of an energy: molecules stay intact while their atoms pass through one another."""

import copy

import openmm

from protochain.energies.factory import choose_engine
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
    """Bonds, angles and dihedrals of an energy, without nonbonded interactions."""
    # None if the terms are unknown, as for a callable.
    bonded: Energy | None = getattr(energy, "bonded_terms", None)
    if bonded is not None or energy.system is None:
        return bonded
    system = copy.deepcopy(energy.system)
    for index in reversed(range(system.getNumForces())):
        if not isinstance(system.getForce(index), _BONDED):
            system.removeForce(index)
    by_openmm = OpenMMEnergy(system, "CPU", energy.threads, energy.forcefield, "vacuum", "bonded terms alone")
    return choose_engine("auto", by_openmm)
