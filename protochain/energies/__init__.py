"""Cartesian positions -> (energy, forces). Knows nothing of chains."""

from protochain.energies.factory import energy
from protochain.energies.native import NativeEnergy, UnsupportedForceError
from protochain.energies.openmm_engine import OpenMMEnergy
from protochain.energies.protocol import Energy

__all__ = ["Energy", "NativeEnergy", "OpenMMEnergy", "UnsupportedForceError", "energy"]
