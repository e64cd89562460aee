"""Potential energies and forces of Cartesian positions, independent of chains."""

from protochain.energies.custom import CustomEnergy
from protochain.energies.decomposed import Decomposed, decomposed
from protochain.energies.factory import build_system, energy
from protochain.energies.native import NativeEnergy, Opening, UnsupportedForceError
from protochain.energies.on_device import devices
from protochain.energies.openmm_engine import OpenMMEnergy, constrain_hydrogens
from protochain.energies.protocol import Energy
from protochain.energies.requested import as_energy

__all__ = [
    "CustomEnergy", "Decomposed", "Energy", "NativeEnergy", "OpenMMEnergy", "Opening",
    "UnsupportedForceError", "as_energy", "build_system", "constrain_hydrogens", "decomposed", "devices",
    "energy",
]  # fmt: skip
